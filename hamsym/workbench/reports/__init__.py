"""Reports of solutions in one file of HTML."""
