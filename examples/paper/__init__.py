"""Experiments of the paper, one script each; `hamsym reproduce` runs them.

Mattheakis, Sondak, Dogra & Protopapas, "Hamiltonian neural networks for solving equations of
motion", Physical Review E 105, 065305 (2022).
"""
