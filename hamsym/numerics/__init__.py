"""Numerical methods that take arrays and functions: collocation, tangent maps, roots, scales."""
