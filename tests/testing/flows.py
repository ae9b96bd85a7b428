"""High-order integration of equations of motion for conservation tests."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from gnc_opt.array_types import Array


def flow(
    rate: Callable[[float, Array], ArrayLike], x: ArrayLike, times: ArrayLike, tol: float = 1e-13
) -> Array:
    """Return the states (n, n_times) of ``dx/dt = rate(t, x)`` by DOP853."""
    span = np.asarray(times, dtype=float)
    found = solve_ivp(
        rate, (span[0], span[-1]), np.asarray(x, dtype=float), "DOP853", span, rtol=tol, atol=1e-14
    )
    assert found.success, found.message
    return np.asarray(found.y)
