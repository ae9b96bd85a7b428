"""Unwrapping of angular controls: whole turns are removed so that consecutive values are nearest to each other.

A solver with long steps may leave points that differ by whole turns. States, cost and multipliers are then correct, but
interpolating polynomials are not.
"""

from __future__ import annotations

import numpy as np

from gnc_opt.array_types import Array, Mask
from gnc_opt.planning.problem.angle_valued_controls import PERIODS, AngleProbe
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.hamiltonian_functions import PhaseFunctions


def unwrap_angles(functions: PhaseFunctions, bounds: Interval, t: Array, x: Array, u: Array) -> Array:
    """Return controls (m, N) with angles shifted by whole periods to be nearest to the previous values.

    Angles that would exceed their bounds, and angles without jumps, are unchanged.

    Parameters
    ----------
    bounds : Interval
        Bounds of the controls (m,).
    t, x, u : array (N,), (n, N), (m, N)
        Times in ascending order, states and controls.
    """
    room = bounds.upper - bounds.lower
    if u.shape[1] < 2 or not np.all(np.isfinite(u)):
        return u
    jumps = np.max(np.abs(np.diff(u, axis=1)), axis=1)
    if not np.any((room > min(PERIODS)) & (jumps > 0.5 * min(PERIODS))):
        return u
    along = AngleProbe(lambda other: functions.stacked_outputs(t, x, other), u)
    angles = {i: period for i in range(room.size) if 0 < (period := along.find_period(i)) < room[i]}
    turned = u.copy()
    for i, period in angles.items():
        angle = _unwrap_angle(u[i], period)
        angle += period * _count_full_turns(angle, bounds.lower[i], bounds.upper[i], period)
        if bounds.lower[i] <= np.min(angle) and np.max(angle) <= bounds.upper[i]:
            turned[i] = angle
    return turned


def find_control_periods(functions: PhaseFunctions, t: Array, x: Array, u: Array, among: Mask) -> Array:
    """Return the periods of controls along a trajectory (m,); 0 for other controls and outside the mask (m,)."""
    if not np.any(among):
        return np.zeros(u.shape[0])
    along = AngleProbe(lambda other: functions.stacked_outputs(t, x, other), u)
    return np.array([along.find_period(i) if wanted else 0.0 for i, wanted in enumerate(among)])


def _count_full_turns(angle: Array, lower: float, upper: float, period: float) -> float:
    """Return the smallest number of whole turns that moves angles (N,) into their bounds; 0 if there is none."""
    least, most = np.ceil((lower - np.min(angle)) / period), np.floor((upper - np.max(angle)) / period)
    return float(np.clip(0.0, least, most)) if least <= most else 0.0


def _unwrap_angle(angle: Array, period: float) -> Array:
    """Return angles (N,), the first within half a period of zero, the others nearest to the previous one."""
    steps = np.diff(angle, prepend=0.0)
    return np.cumsum(steps - period * np.round(steps / period))
