"""The methods that train a network: optimizers, objective, stopping rules."""
