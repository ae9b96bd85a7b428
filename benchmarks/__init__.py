"""Measurements: `performance` answers what users ask, `validation` whether the results are right."""

import os

# One thread, so that times can be compared; linear algebra libraries read this when they are loaded.
os.environ["OMP_NUM_THREADS"] = "1"
