"""The arrays that everything is computed with."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""Real numbers."""

Indices: TypeAlias = NDArray[np.int64]
"""Places in other arrays, and other whole numbers."""

Mask: TypeAlias = NDArray[np.bool_]
"""Which entries are meant."""

GOLDEN_RATIO_FRACTION = 0.5 * (5.0**0.5 - 1.0)
"""Its multiples, modulo 1, are spread evenly over [0, 1) however many there are: deterministic perturbations."""
