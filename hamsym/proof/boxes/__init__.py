"""Certificates of flow maps: over boxes of starts and parameters."""
