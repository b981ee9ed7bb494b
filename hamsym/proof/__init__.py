"""Proofs: enclosures of exact solutions, bounds on the errors of neural ones, certificates."""
