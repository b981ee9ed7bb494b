"""Jinja2 templates of the generated modules, one file per backend (package data of hamsym)."""
