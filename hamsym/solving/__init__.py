"""The table of methods, and the solution by one of them."""
