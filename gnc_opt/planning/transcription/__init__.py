"""Transcription of optimal control problems to nonlinear programs by direct collocation."""
