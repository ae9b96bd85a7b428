"""Shared numerical tolerances: zero, equality, equal times, active limits, finite values."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.array_types import Array

ROUNDING = 1e-12
"""Rounding level relative to the operands (some 1000 machine epsilons): singular values relative to the largest, sums
with cancellation, zero eigenvalues, asymmetries."""

NEGLIGIBLE, MINOR, SMALL, NOTABLE = 1e-6, 1e-4, 1e-3, 1e-2
"""Levels of a dimensionless effect: negligible below the first; without visible change of the result below the second;
possibly a discretisation error below the third; a relevant change of the result above the fourth."""

AT_LIMIT = 1e-6
"""Distance to a limit, relative to its range or magnitude, below which the limit is active; interior-point iterates
have about this distance at any usual solver tolerance."""

MAGNITUDE_FLOOR = 1e-6
"""Magnitude below which a quantity is scaled by 1, so that violations are not relative to rounding."""

EQUAL = 1e-9
"""Relative difference below which numbers are equal, for equivalent expressions."""

ACTIVE = 1e-5
"""Distance to a limit, relative to its magnitude, below which a constraint may be active and restrict the controls."""

CONVEX = 1e-6
"""Smallest second derivative of a strictly convex H in the controls, over their ranges, as a share of H."""

JUNCTION_OFFSET_SHARE = 1e-4
"""Distance from a switch or a junction over which a slope is evaluated, as a share of the adjacent segment."""

SHORTEST = 1e-9
"""Duration (s) below which an interval counts as empty; also used as its length in plots and divisions."""

RANK = 1e-9
"""Singular value of constraint gradients, relative to the largest, below which constraints are dependent."""

INNER_TOLERANCE_SHARE = 0.1
"""Tolerance of an inner computation, as a share of the tolerance of the result for which it is made."""

TINY = float(np.finfo(float).tiny)
"""Smallest normal number: avoids division by zero and log(0) without other effects."""

CONSTANT = 1e-8
"""Relative change of A and B along a reference below which they are constant; accuracy of references."""

GONE = 1e-7
"""Share of its phase below which an arc or a segment counts as empty."""

SAME_TIME = 1e-9
"""Difference of times, relative to the step or interval, below which they are equal: both sides of a jump, a rounded
end, two lengths of a control step."""

STEP_SLACK = 1e-6
"""Share of a control step by which a time may lie outside the step and still belong to it, because sums of many steps
and quotients of long times and short steps are rounded."""

LARGEST = 1e30
"""Magnitude above which a measurement is treated as missing, like NaN, because powers of it in a law would overflow."""

PLAUSIBLE = 1e15
"""Magnitude of a state above which a run has diverged, in any unit; in metres 100 times the distance of Neptune."""


def replace_tiny_by_one(values: ArrayLike) -> Array:
    """Return magnitudes for divisions: the given ones, or 1 for those below `MAGNITUDE_FLOOR`."""
    sizes = np.asarray(values, dtype=float)
    return np.where(sizes > MAGNITUDE_FLOOR, sizes, 1.0)


def replace_zeros_by_one(magnitudes: Array) -> Array:
    """Return magnitudes as divisors: 1 for those that are not positive."""
    return np.where(magnitudes > 0, magnitudes, 1.0)


def max_norm(values: ArrayLike) -> float:
    """Return the largest magnitude of the values; 0 without values."""
    return float(np.max(np.abs(values), initial=0.0))


def set_nonfinite_to_zero(values: Array) -> Array:
    """Return the values with 0 for those that are not finite."""
    return np.where(np.isfinite(values), values, 0.0)


def are_jacobians_equal(found: Array, expected: Array) -> bool:
    """Return whether two Jacobians are equal within `CONSTANT`; false for NaN."""
    change = max_norm(found - expected)
    return bool(change <= CONSTANT * max_norm(expected))


def is_rank_deficient(singular_values: ArrayLike) -> bool:
    """Return whether singular values (largest first) belong to a matrix with dependent rows or columns."""
    values = np.asarray(singular_values)
    return bool(values[-1] <= ROUNDING * values[0])
