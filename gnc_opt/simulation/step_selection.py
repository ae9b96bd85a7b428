r"""Number of integration steps of a loop, from the error of its nominal run and from its modes.

The error of the nominal run is estimated with a companion run with half the step. A run at rest has none,
therefore the modes of the plant count too. n Runge-Kutta steps in a time h replace :math:`e^{\lambda h}` by
:math:`R(\lambda h / n)^n`,

.. math:: R(z) = 1 + z + \frac{z^2}{2} + \frac{z^3}{6} + \frac{z^4}{24} + \frac{z^5}{120} + \frac{z^6}{600} ,

and a run adds up the errors that every step makes of the mode as it has decayed.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.2: the stability function of
Dormand and Prince's method of order 5.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.model.model import Model
from gnc_opt.simulation.compiled_loop import CompiledLoop
from gnc_opt.simulation.run_outcome import RunStatus

MAX_SUBSTEPS = 64
"""Integration steps per minor step at most; a plant that needs more is too fast for this step."""

_STABLE = 3.0
"""The Runge-Kutta method damps a real mode up to 3.3 times the inverse of its step."""

_MODE_MAX_ERROR = 1e-6
"""Relative error over the run of a mode that the nominal run does not excite."""

_STABILITY = (1 / 600, 1 / 120, 1 / 24, 1 / 6, 1 / 2, 1.0, 1.0)


def count_stable_steps(modes: Any, length: float) -> int:
    """Return how many steps in a length (s) the fastest of modes (1/s, complex) needs to stay stable."""
    return max(1, int(np.ceil(np.max(np.abs(modes), initial=0.0) * length / _STABLE)))


def count_accurate_steps(modes: Any, length: float, duration: float, asked: float) -> int:
    """Return the steps in a length (s) for the error ``asked`` of a run with decaying modes (1/s, complex).

    If that takes too many, the steps for `_MODE_MAX_ERROR`: a run that excites the modes refines them.
    """
    modes = np.asarray(modes, dtype=complex)
    for wanted, n in itertools.product((asked, _MODE_MAX_ERROR), range(1, MAX_SUBSTEPS + 1)):
        h, count = length / n, duration * n / length
        fade = -np.expm1(np.minimum(modes.real, 0.0) * h)
        lasting = np.where(fade > 0, (1 - (1 - fade) ** count) / np.where(fade > 0, fade, 1.0), count)
        growth = np.exp(modes * h)
        error = np.abs(np.polyval(_STABILITY, modes * h) - growth) / np.maximum(1.0, np.abs(growth))
        if np.max(error * lasting, initial=0.0) <= wanted:
            return n
    return 1


@dataclass(frozen=True)
class StepSelection:
    """What is asked of the integration of a plant.

    Attributes
    ----------
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

    def initial_modes(self, t: float, x: Array, p: Array) -> Array:
        """Return the modes of the plant at the start (n_states,), complex, 1/s; none where a rate is not finite."""
        a, _ = self.plant.linearize(t, x, np.zeros(self.plant.controls.size), p)
        return np.linalg.eigvals(a).astype(complex) if np.all(np.isfinite(a)) else np.zeros(0, complex)

    def select_steps(self, flight_with: Callable[[int], CompiledLoop], modes: Array) -> CompiledLoop:
        """Return the flight with as many integration steps as its accuracy needs."""
        if self.substeps is not None:
            return flight_with(self.substeps)
        substeps = count_stable_steps(modes, self.step)
        if substeps > MAX_SUBSTEPS:
            raise self._too_fast_error(f"cannot follow its mode of {np.max(np.abs(modes)):.3g} rad/s")
        flight = flight_with(substeps)
        duration = float(flight.times[-1] - flight.times[0])
        substeps = max(substeps, count_accurate_steps(modes, self.step, duration, self.asked))
        best, least, stalled = flight, np.inf, 0
        while True:
            flight = flight_with(substeps)
            ending = flight.final(flight.nominal[:, None], [0])
            error, outcome = float(ending.state_error[0]), ending.outcomes[0]
            if np.isnan(error) or outcome.status is RunStatus.NOT_FINITE or error <= 0.1 * self.asked:
                return flight
            stalled = stalled + 1 if error > 0.5 * least else 0
            if error < least:
                best, least = flight, error
            if stalled > 1 or (outcome.status is RunStatus.DIVERGED and substeps >= MAX_SUBSTEPS):
                return best
            if substeps >= MAX_SUBSTEPS:
                if least <= self.asked:
                    return best
                raise self._too_fast_error(
                    f"leave an error of {least:.1e} where {self.asked:.1e} is asked for"
                )
            substeps = min(2 * substeps, MAX_SUBSTEPS)

    def _too_fast_error(self, why: str) -> ArgumentError:
        return ArgumentError(
            f"the plant '{self.plant.name}' is too fast for minor steps of {self.step:g} s: "
            f"{MAX_SUBSTEPS} integration steps in each {why}; give more minor_steps, a coarser accuracy, or substeps."
        )
