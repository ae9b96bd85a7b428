"""Benchmarks: each prints a table and can write JSON; run them as ``python -m benchmarks.NAME``."""
