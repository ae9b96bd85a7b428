"""Angles: periods of angular controls and the range in which their values are returned."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.tolerances import AT_LIMIT, EQUAL, ROUNDING

PERIODS = np.pi, 180.0, 2 * np.pi, 360.0
"""Turns in radians and degrees; half a turn where only its double counts, as with ``sin(2 u)``."""

ELSEWHERE = 0.37
"""A share of a period by which a function of an angle changes."""


@dataclass(frozen=True)
class Turns:
    """Angular controls without excluded directions, and the range of their returned values.

    Attributes
    ----------
    lower, upper : array (n_controls,)
        One turn at least; infinite for other controls.
    periods : array (n_controls,)
        0 for controls that are not angles.
    pairs : tuple of (int, int)
        In files of earlier versions: azimuths and elevations.
    """

    lower: Array
    upper: Array
    periods: Array
    pairs: tuple[tuple[int, int], ...] = ()

    @property
    def free_controls(self) -> Array:
        """Which controls have lost their bounds (n_controls,)."""
        return np.isfinite(self.lower)

    def solver_bounds(self, bounds: Interval) -> Interval:
        """Return bounds for a solver: angles may leave their range by one turn, so that they can cross its ends."""
        return Interval(
            np.where(self.free_controls, self.lower - self.periods, bounds.lower),
            np.where(self.free_controls, self.upper + self.periods, bounds.upper),
        )

    def wrap_angles(self, u: Array) -> Array:
        """Return controls (n_controls, ...) with angles moved into their range, except for rounding."""
        u = u.copy()
        for i in np.flatnonzero(self.free_controls):
            low, high, period = self.lower[i], self.upper[i], self.periods[i]
            beyond = np.ceil((u[i] - high) / period - AT_LIMIT), np.ceil((low - u[i]) / period - AT_LIMIT)
            above, below = (np.maximum(turns, 0.0) for turns in beyond)
            u[i] = np.clip(u[i] + period * (below - above), low, high)
        return u


@dataclass(frozen=True)
class AngleProbe:
    """Finds which rows of u (n_controls, N) are angles, from functions (k, N) of them."""

    values: Callable[[Array], Array]
    u: Array

    @cached_property
    def sampled_values(self) -> Array:
        return self.values(self.u)

    def find_period(self, i: int, candidates: Sequence[float] = PERIODS) -> float:
        """Return the first candidate that is a period of the functions in a control, 0 if none is."""
        for period in candidates:
            turned, elsewhere = (
                self.values(self._evaluate_shifted_angle(i, by)) for by in (period, ELSEWHERE * period)
            )
            if is_periodic(self.sampled_values, turned, elsewhere):
                return period
        return 0.0

    def is_mirrored(self, azimuth: int, elevation: int, half_turn: float, end: float) -> bool:
        """Whether half a turn of the azimuth cancels a reflection of the elevation at an end of its range."""
        away = self._evaluate_shifted_angle(azimuth, half_turn)
        reflected = away.copy()
        reflected[elevation] = 2.0 * end - reflected[elevation]
        return is_periodic(self.sampled_values, self.values(reflected), self.values(away))

    def _evaluate_shifted_angle(self, i: int, by: float) -> Array:
        u = self.u.copy()
        u[i] += by
        return u


def is_periodic(here: Array, turned: Array, elsewhere: Array) -> bool:
    """Whether values (n, N) are the same after a turn, which they are not elsewhere; unknown ones are not looked at."""
    known = np.isfinite(here) & np.isfinite(turned) & np.isfinite(elsewhere)
    here, turned, elsewhere = (np.where(known, values, 0.0) for values in (here, turned, elsewhere))
    changes = np.max(np.abs(elsewhere - here), axis=1)
    changed = np.max(np.abs(turned - here), axis=1)
    rounding = ROUNDING * np.max(np.abs(here), axis=1)
    return bool(np.any(changes > rounding) and np.all(changed <= EQUAL * changes + rounding))
