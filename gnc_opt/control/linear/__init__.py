"""Linear-quadratic regulators about a state and along a reference, their Riccati equations, weights and margins."""
