r"""Number of integration steps of a loop, from the error of the nominal run and from the modes of the plant.

A companion run with half the step size gives the error of the nominal run. As an equilibrium has none, the plant's
modes are used too. n Runge-Kutta steps over a time h replace :math:`e^{\lambda h}` by
:math:`R(\lambda h / n)^n`,

.. math:: R(z) = 1 + z + \frac{z^2}{2} + \frac{z^3}{6} + \frac{z^4}{24} + \frac{z^5}{120} + \frac{z^6}{600} ,

and the error of a run is the sum of the errors of all steps for the decaying mode.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.2: the stability function of
Dormand and Prince's method of order 5.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.numerical_tolerances import max_norm, replace_zeros_by_one
from gnc_opt.simulation.compiled_closed_loop import CompiledLoop
from gnc_opt.simulation.simulation_run_outcome import RunStatus

MAX_SUBSTEPS = 64
"""Largest number of integration steps per minor step; a plant that needs more is too fast for it."""

_STABLE = 3.0
"""Stability limit of the Runge-Kutta method for a real mode, in units of the inverse step."""

_MODE_MAX_ERROR = 1e-6
"""Permitted relative error over the run for a mode that the nominal run does not excite."""

_STABILITY = (1 / 600, 1 / 120, 1 / 24, 1 / 6, 1 / 2, 1.0, 1.0)


def count_steps_for_stable_modes(modes: Any, length: float) -> int:
    """Return the number of steps in a length (s) for which the fastest mode (1/s, complex) is stable."""
    return max(1, int(np.ceil(max_norm(modes) * length / _STABLE)))


def count_steps_for_accuracy(modes: Any, length: float, duration: float, max_error: float) -> int:
    """Return the number of steps in a length (s) for an error below ``max_error`` with decaying modes (1/s, complex).

    If that exceeds the limit, the number for `_MODE_MAX_ERROR`; runs that excite the modes then refine it.
    """
    modes = np.asarray(modes, dtype=complex)
    for required, n in itertools.product((max_error, _MODE_MAX_ERROR), range(1, MAX_SUBSTEPS + 1)):
        h, count = length / n, duration * n / length
        fade = -np.expm1(np.minimum(modes.real, 0.0) * h)
        lasting = np.where(fade > 0, (1 - (1 - fade) ** count) / replace_zeros_by_one(fade), count)
        growth = np.exp(modes * h)
        error = np.abs(np.polyval(_STABILITY, modes * h) - growth) / np.maximum(1.0, np.abs(growth))
        if np.max(error * lasting, initial=0.0) <= required:
            return n
    return 1


@dataclass(frozen=True)
class StepSelection:
    """Accuracy requirement of the integration, and selection of its number of steps.

    Attributes
    ----------
    step : float
        Minor step, s.
    max_error : float
        Largest permitted error over a run, relative to max(1, \\|x\\|) per state.
    substeps : int, optional
        Given number of integration steps per minor step, if any.
    """

    plant: Model
    step: float
    max_error: float
    substeps: int | None

    def compute_initial_plant_eigenvalues(self, t: float, x: Array, p: Array) -> Array:
        """Return the initial modes of the plant (n_states,), complex, 1/s; empty if a rate is not finite."""
        a, _ = self.plant.linearize(t, x, np.zeros(self.plant.controls.size), p)
        return np.linalg.eigvals(a).astype(complex) if np.all(np.isfinite(a)) else np.zeros(0, complex)

    def select_integration_steps(
        self, compile_with_substeps: Callable[[int], CompiledLoop], modes: Array, duration: float
    ) -> CompiledLoop:
        """Return the compiled loop with the number of steps that its accuracy requires over a duration (s)."""
        if self.substeps is not None:
            return compile_with_substeps(self.substeps)
        substeps = count_steps_for_stable_modes(modes, self.step)
        if substeps > MAX_SUBSTEPS:
            raise self._build_stiff_plant_error(
                f"cannot follow its mode of {np.max(np.abs(modes)):.3g} rad/s"
            )
        substeps = max(substeps, count_steps_for_accuracy(modes, self.step, duration, self.max_error))
        compiled_loop = best = compile_with_substeps(substeps)
        smallest, stalled = np.inf, 0
        while True:
            ending = compiled_loop.final_values(compiled_loop.nominal[:, None], [0])
            error, outcome = float(ending.state_error[0]), ending.outcomes[0]
            if np.isnan(error) or outcome.status is RunStatus.NOT_FINITE or error <= 0.1 * self.max_error:
                return compiled_loop
            stalled = stalled + 1 if error > 0.5 * smallest else 0
            if error < smallest:
                best, smallest = compiled_loop, error
            if stalled > 1 or (outcome.status is RunStatus.DIVERGED and substeps >= MAX_SUBSTEPS):
                return best
            if substeps >= MAX_SUBSTEPS:
                if smallest <= self.max_error:
                    return best
                raise self._build_stiff_plant_error(
                    f"leave an error of {smallest:.1e} where {self.max_error:.1e} is required"
                )
            substeps = min(2 * substeps, MAX_SUBSTEPS)
            compiled_loop = compile_with_substeps(substeps)

    def _build_stiff_plant_error(self, why: str) -> ArgumentError:
        return ArgumentError(
            f"the plant '{self.plant.name}' is too fast for minor steps of {self.step:g} s: "
            f"{MAX_SUBSTEPS} integration steps in each {why}; give more minor_steps, a coarser accuracy, or substeps."
        )
