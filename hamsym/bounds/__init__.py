"""Bounds between the sampled times."""
