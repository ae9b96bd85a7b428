"""Poles: polynomials with given ones, and those of sampled loops as rates."""

from __future__ import annotations

from typing import Any

import numpy as np

from gnc_opt.arrays import Array

_CONJUGATE = 1e-9
"""Poles typed as conjugate pairs may differ by this, relative to each coefficient of their polynomial."""


def real_polynomial(poles: Any) -> Array | None:
    """Return the coefficients (n + 1,) of the polynomial with these roots, highest order first.

    ``None`` if they are not in conjugate pairs.
    """
    polynomial = np.atleast_1d(np.poly(poles))
    if np.any(np.abs(polynomial.imag) > _CONJUGATE * np.abs(polynomial)):
        return None
    return np.asarray(polynomial.real, dtype=float)


_ROUNDING = float(np.finfo(float).eps)


def continuous_poles(poles: Any, dt: float | None) -> Any:
    """Return poles as rates (1/s): ``ln(z)/dt`` for those of a loop sampled with dt (s), minus infinity for z = 0.

    What is as small as rounding beside the unit circle is zero: a plant that rests long before the next step.
    """
    if dt is None:
        return poles
    sampled = np.asarray(poles, dtype=complex)
    rates, there = np.full(sampled.shape, complex(-np.inf)), np.abs(sampled) > _ROUNDING
    rates[there] = np.log(sampled[there]) / dt
    return rates
