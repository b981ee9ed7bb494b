"""Code generation: equations to source text and callables, and the cache of compiled code."""
