"""Summaries of solutions and trajectories as text."""
