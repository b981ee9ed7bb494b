"""Periodic orbits: their search, their families and their proofs."""
