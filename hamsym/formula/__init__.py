"""Conversion of text to expressions and back: parser, grammar, limits and printer."""
