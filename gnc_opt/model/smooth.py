"""Smooth stand-ins for functions with kinks."""

from __future__ import annotations

from typing import Any

import casadi as ca

from gnc_opt.arguments import read_positive


def smooth_abs(x: Any, width: float) -> Any:
    """Return the absolute value of each component with its kink rounded off: ``sqrt(x^2 + width^2) - width``.

    It is zero at zero, where its curvature is 1 / width, and less than the absolute value elsewhere, by ``width`` at
    most: the pseudo-Huber function (R. Hartley and A. Zisserman, Multiple View Geometry, Cambridge 2003, A6.8).

    Parameters
    ----------
    x : casadi.SX or float
    width : float
        > 0, in the unit of x.

    Returns
    -------
    casadi.SX or float

    Raises
    ------
    ArgumentError
        The width is not a positive number.

    Examples
    --------
    >>> print(f"{float(go.smooth_abs(-3.0, 1e-3)):.6f} {float(go.smooth_abs(0.0, 1e-3)):.6f}")
    2.999000 0.000000
    """
    small = read_positive(width, "the width of smooth_abs()")
    return ca.sqrt(x**2 + small**2) - small
