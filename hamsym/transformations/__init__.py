"""Canonical transformations: other coordinates and momenta, and another time."""
