"""Representations of results in notebooks."""
