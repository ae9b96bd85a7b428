r"""How many integration steps a flight takes: as many as it needs by its own estimates of its error.

Modes: how many integration steps the modes of a plant ask for.

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

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.model.model import Model
from gnc_opt.simulation.compiled_loop import Flight
from gnc_opt.simulation.dormand_prince import linear_error
from gnc_opt.simulation.final_values import Ending

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


_MARGIN = 1.1
"""Integration steps that were reckoned from an estimate of the error are made more numerous by this factor."""

_SPARE = 10.0
"""How many times as large as that of the run that is looked at the error of dispersed ones may be expected."""

_STILL = 0.01
"""A state that has moved by less, relative to max(1, |x|), may have stood still."""


@dataclass(frozen=True)
class Accuracy:
    """What is asked of the integration of a plant.

    Attributes
    ----------
    plant : Model
    step : float
        Minor step, s.
    asked : float
        Largest error over a run, relative to max(1, \\|x\\|) per state.
    substeps : int, optional
        Integration steps per minor step, if they are given.
    """

    plant: Model
    step: float
    asked: float
    substeps: int | None

    def modes(self, t: float, x: Array, p: Array) -> Array:
        """Return the modes of the plant at the start (n_states,), complex, 1/s; none where a rate is not finite."""
        a, _ = self.plant.linearize(t, x, np.zeros(self.plant.controls.size), p)
        # the run itself will say what is not finite
        return np.linalg.eigvals(a).astype(complex) if np.all(np.isfinite(a)) else np.zeros(0, complex)

    def reached(self, flight_with: Callable[[int], Flight], start: Array, modes: Array) -> Flight:
        """Return the flight with as many integration steps as its accuracy needs.

        Those that the run that is looked at needs; if it ends where it has begun, at rest, say, it tells little, and
        its modes tell what a motion beside it will need.

        Parameters
        ----------
        flight_with : function
            Returns it with so many integration steps per minor step.
        start : array (n_parameters, 1)
            Of the run that is looked at.
        modes : array (n_states,)
            Of the plant at its start, 1/s.
        """
        growth, before = 1.0, None
        substeps = self.substeps or steps_to_be_stable(modes, self.step)
        if self.substeps is None and substeps > MAX_SUBSTEPS:
            raise self._too_fast(f"cannot follow its mode of {np.max(np.abs(modes)):.3g} rad/s")
        while True:
            flight = flight_with(substeps)
            ending = flight.final(start, [0])
            # a run that leaves the finite numbers is not one whose accuracy could be had by more steps
            if not np.isfinite(ending.integration_error[0]) or ending.outcomes[0].not_finite:
                return flight
            if substeps >= MAX_SUBSTEPS and ending.outcomes[0].diverged:
                return flight  # also when integrated as finely as can be: that is what is to be told
            if before is None and self.substeps is None and _returned(flight, ending, start):
                duration = float(flight.times[-1] - flight.times[0])
                needed = steps_for_run(modes, self.step, duration, self.asked)
                if needed > substeps:
                    substeps = needed
                    continue
            local = _local_error(ending)
            if before is not None:
                growth = max(growth, grown(before[0], ending, before[1], before[2] / substeps))
            if local <= self.asked or self.substeps is not None:
                finer = flight_with(substeps + 1).final(start, [0])
                growth = max(growth, grown(ending, finer, local, substeps / (substeps + 1)))
            before, flight = (ending, local, substeps), replace(flight, growth=growth)
            error = growth * local
            if self.substeps is not None:
                return flight
            if error <= self.asked:
                spare = self._needed(substeps, _SPARE * error, 1.0)
                return flight if spare <= substeps else replace(flight_with(spare), growth=growth)
            if substeps >= MAX_SUBSTEPS and local <= self.asked:
                return flight  # errors grow: runs are flagged
            if substeps >= MAX_SUBSTEPS:
                raise self._too_fast(f"leave an error of {error:.1e} where {self.asked:.1e} is asked for")
            substeps = max(substeps + 1, self._needed(substeps, error, _MARGIN))

    def _needed(self, substeps: int, error: float, margin: float) -> int:
        """Return how many integration steps bring an error down to what is asked."""
        # the local error of the embedded fourth-order solution, summed over a run, falls with h^4
        return int(min(MAX_SUBSTEPS, np.ceil(substeps * (error / self.asked) ** 0.25 * margin)))

    def _too_fast(self, why: str) -> ArgumentError:
        return ArgumentError(
            f"the plant '{self.plant.name}' is too fast for minor steps of {self.step:g} s: "
            f"{MAX_SUBSTEPS} integration steps in each {why}; give more minor_steps, a coarser accuracy, or substeps."
        )


def _returned(flight: Flight, ending: Ending, start: Array) -> bool:
    """Whether a run ends where it has begun."""
    begun = np.concatenate([start[flight.layout.slice(f"initial.{name}")] for name in flight.states.names])
    moved = np.abs(ending.states - begun) / np.maximum(1.0, np.abs(begun))
    return bool(np.max(moved, initial=0.0) < _STILL)


def _local_error(ending: Ending) -> float:
    """Return the sum of the local errors of a run, times its growth."""
    return float((ending.integration_error - ending.averaging_error - ending.instant_error)[0])


def grown(coarse: Ending, fine: Ending, local: float, ratio: float) -> float:
    """Return by how much the local errors of a run have grown until its end, from the same run with shorter steps.

    ``local`` is the sum of local errors of the coarse run, ``ratio`` that of the lengths of the steps, below 1. The
    error at the end falls with the fifth power of the step. What is rounding of it does not fall, and a relay that has
    turned the other way meanwhile leaves the runs no farther apart than it can: where either may be, the largest of
    several comparisons is nearest to the truth.
    """
    if not local > 0 or not np.all(np.isfinite(fine.states)):
        return 1.0
    apart = np.abs(coarse.states - fine.states) / np.maximum(1.0, np.abs(fine.states))
    return max(1.0, float(np.max(apart)) / ((1 - ratio**5) * local))
