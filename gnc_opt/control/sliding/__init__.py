"""Sliding modes: surfaces, reaching laws, observers, and what refuses a design."""
