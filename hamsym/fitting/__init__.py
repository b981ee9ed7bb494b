"""Fits: parameters and initial states from noisy observations."""
