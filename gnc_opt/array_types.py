"""Array types, and a low-discrepancy constant."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""Real numbers."""

Indices: TypeAlias = NDArray[np.int64]
"""Indices and other integers."""

Mask: TypeAlias = NDArray[np.bool_]
"""Boolean mask."""

GOLDEN_RATIO_FRACTION = 0.5 * (5.0**0.5 - 1.0)
"""Fraction of the golden ratio; its multiples modulo 1 are evenly distributed: deterministic perturbations."""
