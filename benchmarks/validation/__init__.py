"""Validation: computed answers against published or independently computed values."""
