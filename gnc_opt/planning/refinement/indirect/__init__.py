"""The Hamiltonian boundary-value problem of a solution."""
