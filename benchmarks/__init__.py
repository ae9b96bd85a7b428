"""Benchmarks: each prints a table and can write JSON; run them as ``python -m benchmarks.NAME``."""

import os

# One thread, so that times can be compared; linear algebra libraries read this when they are loaded.
os.environ["OMP_NUM_THREADS"] = "1"
