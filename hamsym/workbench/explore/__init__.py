"""A page in the browser: type a Hamiltonian, move sliders, see and keep what follows."""
