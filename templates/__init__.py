"""Templates of the generated modules, and the loops of the integrators (data of hamsym)."""
