"""Equations to source text and callables: names, bodies, printers, the cache of compiled code."""
