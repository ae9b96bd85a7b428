"""Integrated trajectory for given switching times: states, costates and switching functions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gnc_opt.array_types import Array, Indices
from gnc_opt.planning.optimality.bang_bang_switches import Switches
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.arcs.structure_update import find_violation_interval
from gnc_opt.planning.refinement.switching.newton_step import SwitchStep, simplify_newton_step
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.tolerances import NEGLIGIBLE

STEP_PARTS = 3
"""Parts of every grid step for the estimate of the integration error."""

NEW_ARC_INSET_SHARE = 0.25
"""Distance of a new arc from the ends of the interval with the wrong sign, relative to the interval."""


@dataclass(frozen=True, eq=False)
class SwitchedFlow:
    """A phase integrated on a grid `STEP_PARTS` times as fine as that of a step; ``step`` is the Newton step there."""

    s: PhaseSamples
    switches: Switches
    step: SwitchStep

    @classmethod
    def integrate_phase(
        cls, problem: Problem, s: PhaseSamples, switches: Switches, known: SwitchStep
    ) -> SwitchedFlow | None:
        """Return a phase integrated with the matrices and the grid of a known step; None if it is not finite.

        The switches have converged, or nearly so, on the coarser grid.
        """
        step = simplify_newton_step(problem, s, switches, known, known.steps, STEP_PARTS)
        return None if step is None else cls(s, switches, step)

    @property
    def integration_error(self) -> float:
        """Relative change of the cost due to the coarser grid and the remaining errors of the switching times."""
        return self.step.gain

    def is_accurate(self, accuracy: float) -> bool:
        """Return whether the cost has a relative accuracy and no arc is missing."""
        return self.integration_error < accuracy and self.find_missing_arc is None

    @property
    def grid_times(self) -> Array:
        """Times of the grid (n_steps + 1,)."""
        leg = self.s.leg
        return np.asarray(self.step.flow.states[leg.states.size + leg.integrals.size])

    @property
    def step_times(self) -> Array:
        """Ends of the integration steps (s) with which the trajectory is accurate."""
        return self.grid_times[::STEP_PARTS]

    @property
    def states(self) -> Array:
        """States (n_states, n_steps + 1)."""
        return self.step.flow.states[: self.s.leg.states.size]

    @cached_property
    def costates(self) -> Array:
        """Costates (n_states, n_steps + 1)."""
        return self.step.flow.integrate_adjoint_equation(self.step.adjoint)[: self.s.leg.states.size]

    @cached_property
    def find_missing_arc(self) -> tuple[int, float, float] | None:
        """Return control, start and end of an arc at the largest violation of a sign; None if all signs are right."""
        s, times = self.s, self.grid_times
        controls = np.column_stack([self.step.flow.controls, self.step.flow.controls[:, -1]])
        values = s.functions.switching_functions(times, self.states, controls, self.costates)
        wrong = np.where(controls == s.leg.control_bounds.upper[:, None], values, -values)
        wrong /= np.max(np.abs(values), axis=1, keepdims=True)
        for i in range(wrong.shape[0]):
            mask_near_switches(wrong[i], np.flatnonzero(np.concatenate([[False], np.diff(controls[i]) != 0])))
        i, j = (int(k) for k in np.unravel_index(int(np.argmax(wrong)), wrong.shape))
        if wrong[i, j] < NEGLIGIBLE:
            return None
        start, end = find_violation_interval(times, wrong[i])
        inset = NEW_ARC_INSET_SHARE * (end - start)
        return i, start + inset * (start > times[0]), end - inset * (end < times[-1])


def mask_near_switches(wrong: Array, switches: Indices) -> None:
    """Set sign violations at switches with convergence errors to zero, which are largest at the switch itself."""
    for k in switches:
        most, wrong[k] = abs(wrong[k]) + NEGLIGIBLE, 0.0
        for side in (range(int(k) + 1, wrong.size), range(int(k) - 1, -1, -1)):
            for j in side:
                if not 0 < wrong[j] <= most:
                    break
                wrong[j] = 0.0
