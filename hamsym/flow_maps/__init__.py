"""Flow maps: one closed form of all trajectories that start in a box."""
