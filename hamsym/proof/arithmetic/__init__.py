"""Numbers with proven radii: balls, models, and the programs that evaluate H in them."""
