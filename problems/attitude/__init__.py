"""Attitude: reorientation and momentum."""
