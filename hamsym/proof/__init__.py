"""Proofs of a solution's error in ball arithmetic, and their certificates."""
