"""The independent checker: it proves certificates again, on python-flint alone."""
