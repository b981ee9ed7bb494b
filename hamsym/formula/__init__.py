"""Text to expressions and back: the parser, its grammar and limits, the printer."""
