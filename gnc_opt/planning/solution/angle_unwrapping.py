"""Unwrapping of angular controls: whole turns are removed so that consecutive values are nearest to each other.

A solver with long steps may leave points that differ by whole turns. States, cost and multipliers are then correct, but
interpolating polynomials are not. (a, e) and (a + half a turn, half a turn - e) are also the same direction.
"""

from __future__ import annotations

import itertools

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
    pairs = [pair for pair in itertools.permutations(angles, 2) if _are_direction_angles(along, pair, angles)]
    turned = u.copy()
    for i, j in pairs:
        turned[[i, j]] = _unwrap_directions(u[[i, j]], angles[i], angles[j])
    for i in angles.keys() - set(itertools.chain(*pairs)):
        turned[i] = _unwrap_angle(u[i], angles[i])
        turned[i] += angles[i] * _count_full_turns(turned[i], bounds.lower[i], bounds.upper[i], angles[i])
    inside = np.all((turned >= bounds.lower[:, None]) & (turned <= bounds.upper[:, None]), axis=1)
    if not all(inside[i] and inside[j] for i, j in pairs):
        inside[list(itertools.chain(*pairs))] = False
    return np.where(inside[:, None], turned, u)


def find_control_periods(functions: PhaseFunctions, t: Array, x: Array, u: Array, among: Mask) -> Array:
    """Return the periods of controls along a trajectory (m,); 0 for other controls and outside the mask (m,)."""
    if not np.any(among):
        return np.zeros(u.shape[0])
    along = AngleProbe(lambda other: functions.stacked_outputs(t, x, other), u)
    return np.array([along.find_period(i) if wanted else 0.0 for i, wanted in enumerate(among)])


def _are_direction_angles(along: AngleProbe, pair: tuple[int, int], periods: dict[int, float]) -> bool:
    """Return whether two angles are azimuth and elevation, the latter within a quarter of a turn."""
    azimuth, elevation = pair
    return along.is_mirrored(azimuth, elevation, 0.5 * periods[azimuth], 0.25 * periods[elevation])


def _count_full_turns(angle: Array, lower: float, upper: float, period: float) -> float:
    """Return the smallest number of whole turns that moves angles (N,) into their bounds; 0 if there is none."""
    least, most = np.ceil((lower - np.min(angle)) / period), np.floor((upper - np.max(angle)) / period)
    return float(np.clip(0.0, least, most)) if least <= most else 0.0


def _unwrap_angle(angle: Array, period: float) -> Array:
    """Return angles (N,), the first within half a period of zero, the others nearest to the previous one."""
    steps = np.diff(angle, prepend=0.0)
    return np.cumsum(steps - period * np.round(steps / period))


def _unwrap_directions(angles: Array, *periods: float) -> Array:
    """Return azimuths and elevations (2, N) of the same directions, each nearest to the previous one."""
    turn, found, last = np.array(periods), np.empty_like(angles), np.zeros(2)
    for k, (azimuth, elevation) in enumerate(angles.T):
        ways = np.array([[azimuth, elevation], [azimuth + 0.5 * turn[0], 0.5 * turn[1] - elevation]])
        ways -= turn * np.round((ways - last) / turn)
        distance = np.sum(np.abs(ways - last) / turn, axis=1)
        last = found[:, k] = ways[1 if distance[1] < distance[0] else 0]
    return found
