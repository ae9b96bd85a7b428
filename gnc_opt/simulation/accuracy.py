"""How many integration steps a flight takes: as many as it needs by its own estimates of its error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.model.model import Model
from gnc_opt.simulation.ending import Ending
from gnc_opt.simulation.flight import Flight
from gnc_opt.simulation.modes import MAX_SUBSTEPS, steps_for_run, steps_to_be_stable

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
