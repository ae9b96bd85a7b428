"""Estimators: the states that a law feeds back, from what sensors measure."""
