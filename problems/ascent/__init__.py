"""Ascent: launchers and sounding rockets."""
