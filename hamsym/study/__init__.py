"""Studies of many runs: sweeps over settings and seeds, comparisons with integrators."""
