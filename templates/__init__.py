"""Templates of the generated modules, and loops of the integrators (package data of hamsym)."""
