"""Time stepping: the table of methods, their coefficients, and adaptive methods of scipy."""
