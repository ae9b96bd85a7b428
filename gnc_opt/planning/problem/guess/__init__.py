"""Initial guesses: user data, default straight lines, simulations and random trajectories."""
