"""Guesses: what users give, straight lines for the rest, and random trajectories."""
