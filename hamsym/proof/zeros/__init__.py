"""Proven zeros: equilibria, roots of polynomials and spectra."""
