"""Array types, runs of equal values, changes of sign, and a low-discrepancy constant."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, TypeAlias

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


def compute_interval_midpoints(edges: Array) -> Array:
    """Return the middles of the cells between edges (n_cells + 1,)."""
    return 0.5 * (edges[:-1] + edges[1:])


def find_equal_value_intervals(values: NDArray[Any]) -> list[tuple[int, int]]:
    """Return first and end index of every run of samples with equal values (n_samples,) or (n_rows, n_samples)."""
    rows = np.atleast_2d(values)
    changes = np.any(rows[:, 1:] != rows[:, :-1], axis=0)
    return list(pairwise([0, *(int(k) for k in np.flatnonzero(changes) + 1), rows.shape[1]]))


def find_sign_changes(values: Array) -> Indices:
    """Return the samples (n_samples,) after which the sign is the opposite one; zeros have none."""
    return np.flatnonzero(np.abs(np.diff(np.sign(values))) == 2)


def find_true_value_intervals(here: Mask) -> list[tuple[int, int]]:
    """Return first and end index of every run of True values."""
    return [(first, last) for first, last in find_equal_value_intervals(here) if np.any(here[first:last])]
