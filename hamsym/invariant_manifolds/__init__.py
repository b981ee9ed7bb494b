"""Stable and unstable manifolds of equilibria and periodic orbits, and connections of them."""
