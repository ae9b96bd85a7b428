"""Quantiles of the chi-square distribution."""

from __future__ import annotations

import scipy


def chi_square(freedom: float, probability: float) -> float:
    """Return the value that chi-square with so many degrees of freedom does not exceed with a probability.

    Parameters
    ----------
    freedom : float
        > 0.
    probability : float
        In [0, 1).
    """
    return float(2 * scipy.special.gammaincinv(freedom / 2, probability))
