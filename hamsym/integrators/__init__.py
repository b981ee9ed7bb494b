"""Time stepping: the table of methods, their coefficients and loops, and scipy's methods."""
