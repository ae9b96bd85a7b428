"""What counts as zero, as equal, as the same time and as a number: for all controllers alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arrays import Array

ROUNDING = 1e-12
"""What is smaller than this, relative to the numbers that it is made of, is rounding (some thousand times that of
double precision): singular values beside the largest, sums whose terms cancel, eigenvalues at zero, asymmetries."""

TINY = float(np.finfo(float).tiny)
"""Smallest normal number: keeps a division or a logarithm of zero finite and changes nothing else."""

CONSTANT = 1e-8
"""A and B that change less than this along a reference, relative to their size, count as constant: as good as the
references that a solver returns."""

SAME_TIME = 1e-9
"""Times that differ by less than this, relative to the step or the span at hand, are one: a jump and its two sides,
an end and what rounding makes of it, two lengths of a control step."""

STEP_SLACK = 1e-6
"""Share of a control step by which a time may lie before its beginning and still count as in it: a clock that adds up
steps for hours is late by rounding."""

LARGEST = 1e30
"""Measurements above this are taken for none, as those are that are not a number: the powers that a law takes of them
would leave the range of doubles."""


def alike(found: Array, expected: Array) -> bool:
    """Whether two matrices of a linearization are the same but for `CONSTANT`; false for what is not a number."""
    change = np.max(np.abs(found - expected), initial=0.0)
    return bool(change <= CONSTANT * np.max(np.abs(expected), initial=0.0))


def dependent(singular_values: ArrayLike) -> bool:
    """Whether singular values (largest first) are those of a matrix with dependent rows or columns."""
    values = np.asarray(singular_values)
    return bool(values[-1] <= ROUNDING * values[0])
