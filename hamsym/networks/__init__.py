"""The methods that train a network: optimisers, objective, stopping rules, checkpoints."""
