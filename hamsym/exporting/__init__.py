"""Exports: solutions as files that are evaluated without hamsym."""
