"""Many trajectories of one Hamiltonian, solved and evaluated together."""
