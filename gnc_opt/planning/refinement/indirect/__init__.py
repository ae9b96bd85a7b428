"""The Hamiltonian boundary-value problem, which takes smooth solutions to rounding."""
