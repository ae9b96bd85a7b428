"""Derivatives of a solution with respect to the data of its problem."""
