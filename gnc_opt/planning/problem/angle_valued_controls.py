"""Angular controls: their periods, and the range of their returned values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import AT_LIMIT, EQUAL, ROUNDING
from gnc_opt.planning.problem.bounds import Interval

PERIODS = np.pi, 180.0, 2 * np.pi, 360.0
"""Candidate periods: a full turn in rad and deg; half a turn for functions such as ``sin(2 u)``."""

TEST_SHARE = 0.37
"""Share of a period at which functions of an angle are compared."""


@dataclass(frozen=True)
class UnboundedAngles:
    """Angular controls whose bounds exclude no direction, and the range of their returned values.

    Attributes
    ----------
    lower, upper : array (n_controls,)
        Range of at least one turn; infinite for other controls.
    periods : array (n_controls,)
        0 for controls that are not angles.
    pairs : tuple of (int, int)
        Azimuths and elevations in files of earlier versions.
    """

    lower: Array
    upper: Array
    periods: Array
    pairs: tuple[tuple[int, int], ...] = ()

    @property
    def unbounded_controls(self) -> Array:
        """Controls without bounds in the solver (n_controls,)."""
        return np.isfinite(self.lower)

    def widen_bounds_for_solver(self, bounds: Interval) -> Interval:
        """Return bounds for the solver: angles may exceed their range by one turn, so that they can cross its ends."""
        return Interval(
            np.where(self.unbounded_controls, self.lower - self.periods, bounds.lower),
            np.where(self.unbounded_controls, self.upper + self.periods, bounds.upper),
        )

    def wrap_angles(self, u: Array) -> Array:
        """Return controls (n_controls, ...) with angles shifted by whole periods into their range."""
        u = u.copy()
        for i in np.flatnonzero(self.unbounded_controls):
            lower, upper, period = self.lower[i], self.upper[i], self.periods[i]
            excess = (u[i] - upper, lower - u[i])
            turns_above, turns_below = (np.maximum(np.ceil(e / period - AT_LIMIT), 0.0) for e in excess)
            u[i] = np.clip(u[i] + period * (turns_below - turns_above), lower, upper)
        return u


@dataclass(frozen=True)
class AngleProbe:
    """Detection of angles among the rows of u (n_controls, N), from functions (k, N) of them."""

    values: Callable[[Array], Array]
    u: Array

    @cached_property
    def function_values_without_shift(self) -> Array:
        return self.values(self.u)

    def find_angle_period(self, i: int, candidates: Sequence[float] = PERIODS) -> float:
        """Return the first candidate that is a period of the functions in control i; 0 if there is none."""
        for period in candidates:
            after_turn, elsewhere = (
                self.values(self._shift_control_angle(i, shift)) for shift in (period, TEST_SHARE * period)
            )
            if is_invariant_under_full_turn(self.function_values_without_shift, after_turn, elsewhere):
                return period
        return 0.0

    def _shift_control_angle(self, i: int, shift: float) -> Array:
        u = self.u.copy()
        u[i] += shift
        return u


def is_invariant_under_full_turn(values: Array, after_turn: Array, elsewhere: Array) -> bool:
    """Return whether values (n, N) are equal after a turn but differ elsewhere; NaN is ignored."""
    finite = np.isfinite(values) & np.isfinite(after_turn) & np.isfinite(elsewhere)
    values, after_turn, elsewhere = (np.where(finite, v, 0.0) for v in (values, after_turn, elsewhere))
    variation = np.max(np.abs(elsewhere - values), axis=1)
    change = np.max(np.abs(after_turn - values), axis=1)
    rounding = ROUNDING * np.max(np.abs(values), axis=1)
    return bool(np.any(variation > rounding) and np.all(change <= EQUAL * variation + rounding))
