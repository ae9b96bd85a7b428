r"""Modes: how many integration steps the modes of a plant ask for.

How finely a loop is integrated is decided by its nominal run. At rest that run has no error, however few the steps, and
what moves beside it may have a large one; a light mode of 20 rad/s even turns into a growing one with one step in
0.1 s. So modes are asked themselves. n steps of the Runge-Kutta method in a time h make of :math:`e^{\lambda h}` the
power :math:`R(\lambda h / n)^n`,

.. math:: R(z) = 1 + z + \frac{z^2}{2} + \frac{z^3}{6} + \frac{z^4}{24} + \frac{z^5}{120} + \frac{z^6}{600} ,

and a run adds up the estimates of its errors that every step makes of the mode as it has decayed.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.2: the stability function of
Dormand and Prince's method of order 5.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gnc_opt.simulation.integrate import linear_error

MAX_SUBSTEPS = 64
"""Integration steps per minor step at most; a plant that needs more is too fast for this step."""

_STABLE = 3.0
"""The Runge-Kutta method damps a real mode up to 3.3 times the inverse of its step."""

_STABILITY = (1 / 600, 1 / 120, 1 / 24, 1 / 6, 1 / 2, 1.0, 1.0)


def steps_to_be_stable(modes: Any, length: float) -> int:
    """Return how many steps in a length (s) the fastest of modes (1/s, complex) needs to stay stable."""
    return max(1, int(np.ceil(np.max(np.abs(modes), initial=0.0) * length / _STABLE)))


def steps_for_modes(modes: Any, length: float, asked: float) -> int:
    """Return how many steps in a length (s) modes (1/s, complex) need, `MAX_SUBSTEPS` at most.

    ``asked`` is the error over the length, relative to the larger one of 1 and the size of the mode after it.
    """
    z = np.asarray(modes, dtype=complex) * length
    truth = np.exp(z)
    for n in range(1, MAX_SUBSTEPS):
        with np.errstate(over="ignore", invalid="ignore"):
            error = np.abs(np.polyval(_STABILITY, z / n) ** n - truth)
        if np.all(error <= asked * np.maximum(1.0, np.abs(truth))):
            return n
    return MAX_SUBSTEPS


def steps_for_run(modes: Any, length: float, duration: float, asked: float) -> int:
    """Return how many steps in a length (s) a run needs in which modes (1/s, complex) of size 1 are let go; 1 if not
    even `MAX_SUBSTEPS` do.

    ``asked`` is the sum of its estimated errors over the duration (s). Modes that grow count as if they stayed: how
    they let errors grow is seen elsewhere.
    """
    modes = np.asarray(modes, dtype=complex)
    for n in range(1, MAX_SUBSTEPS + 1):
        h, count = length / n, duration * n / length
        fade = -np.expm1(np.minimum(modes.real, 0.0) * h)
        lasting = np.where(fade > 0, (1 - (1 - fade) ** count) / np.where(fade > 0, fade, 1.0), count)
        if np.max(linear_error(modes * h) * lasting, initial=0.0) <= asked:
            return n
    return 1
