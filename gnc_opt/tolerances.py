"""Shared tolerances: zero, equal, same time, at a limit, finite."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arrays import Array

ROUNDING = 1e-12
"""Results below this share of their operands are rounding (some thousand times that of double precision):
singular values relative to the largest, sums whose terms cancel, eigenvalues at zero, asymmetries.
"""

NEGLIGIBLE, SMALL, NOTABLE = 1e-6, 1e-3, 1e-2
"""Levels of a dimensionless effect: below the first it is ignored, below the second an error of the mesh may cause it,
above the third it changes the result.
"""

AT_LIMIT = 1e-6
"""A value this close to its limit, relative to its range or size, is on it: interior-point iterates are at
most about this far from it at any solver tolerance in use.
"""

BRANCH_ENDED = 1e-6
"""A quantity that never exceeds this is scaled by 1, so that violations are not relative to rounding errors.
"""

EQUAL = 1e-9
"""Numbers that differ by less than this, relative to their size, are equal: values of expressions that say the same."""

ACTIVE = 1e-5
"""A constraint this close to its limit, relative to its size, may push, and takes directions from the controls."""

CONVEX = 1e-6
"""Second derivative of H in controls, over their ranges and in shares of H, from which H is strictly convex in them."""

JUNCTION_OFFSET_SHARE = 1e-4
"""Distance from a switch or a junction over which a slope is taken, as a share of the adjacent segment."""

SHORTEST = 1e-9
"""Durations (s) below this have vanished; what has no length is drawn and divided by this."""

RANK = 1e-9
"""Singular values of constraint gradients below this, relative to the largest, are those of dependent constraints."""

TINY = float(np.finfo(float).tiny)
"""Smallest normal number: keeps a division or a logarithm of zero finite and changes nothing else."""

CONSTANT = 1e-8
"""A and B that change less than this along a reference, relative to their size, count as constant: as good as the
references that a solver returns."""

GONE = 1e-7
"""A piece or a segment shorter than this share of its phase has vanished."""

SAME_TIME = 1e-9
"""Times that differ by less than this, relative to the step or the span at hand, are one: a jump and its two sides,
an end and what rounding makes of it, two lengths of a control step."""

STEP_SLACK = 1e-6
"""Share of a control step by which a time may lie before its beginning, or beyond its end, and still count as in it: a
clock that adds up steps for hours is late by rounding, and so is the quotient of a long time and a short step."""

LARGEST = 1e30
"""Measurements above this are taken for none, as those are that are not a number: the powers that a law takes of them
would leave the range of doubles."""

PLAUSIBLE = 1e15
"""Size of a state beyond which a run has diverged, in any unit: a hundred times as far as Neptune, in
metres."""


def nonzero_magnitude(values: ArrayLike, otherwise: ArrayLike = 1.0) -> Array:
    """Return magnitudes to divide by: the given ones, or others where those have `BRANCH_ENDED`."""
    sizes = np.asarray(values, dtype=float)
    return np.where(sizes > BRANCH_ENDED, sizes, otherwise)


def are_equal(found: Array, expected: Array) -> bool:
    """Whether two matrices of a linearization are equal within `CONSTANT`; false for NaN."""
    change = np.max(np.abs(found - expected), initial=0.0)
    return bool(change <= CONSTANT * np.max(np.abs(expected), initial=0.0))


def are_dependent(singular_values: ArrayLike) -> bool:
    """Whether singular values (largest first) are those of a matrix with dependent rows or columns."""
    values = np.asarray(singular_values)
    return bool(values[-1] <= ROUNDING * values[0])
