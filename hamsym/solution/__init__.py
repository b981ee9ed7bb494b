"""A trajectory as a function of time, with its residual, energy, error and events."""
