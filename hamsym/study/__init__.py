"""Many runs: sweeps over settings and seeds, comparisons with integrators."""
