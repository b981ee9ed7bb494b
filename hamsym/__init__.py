from hamsym.hamiltonian import Hamiltonian
