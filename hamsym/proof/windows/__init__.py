"""Enclosures of trajectories and certificates of solutions, on windows of time."""
