"""Robots: arms, quadrotors, vehicles."""
