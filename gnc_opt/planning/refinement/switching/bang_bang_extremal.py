"""Integrated trajectory for given switching times: states, costates and switching functions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gnc_opt.array_types import Array, Indices, compute_midpoints
from gnc_opt.planning.optimality.bang_bang_switches import Switches
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.arcs.structure_update import find_violation_interval
from gnc_opt.planning.refinement.switching.newton_step import SwitchStep, simplify_newton_step
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.tolerances import NEGLIGIBLE

STEP_PARTS = 3
"""Parts of every grid step: values and rates at four times define a polynomial of degree 7."""

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
        """Return an integrated phase; None if it is not finite.

        Parameters
        ----------
        switches : Switches
            Converged, or nearly so, on the coarser grid.
        known : SwitchStep
            Step whose matrices and grid are used.
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
    def states(self) -> Array:
        """States (n_states, n_steps + 1)."""
        return self.step.flow.states[: self.s.leg.states.size]

    @cached_property
    def costates(self) -> Array:
        """Costates (n_states, n_steps + 1)."""
        return self.step.flow.integrate_adjoint_equation(self.step.adjoint)[: self.s.leg.states.size]

    def build_solution(self, known: Solution) -> Solution:
        """Return the trajectory as a solution, with costates and multipliers, and with the objective of ``known``."""
        s, leg, n = self.s, self.s.leg, self.s.leg.states.size
        first = STEP_PARTS * np.flatnonzero(np.diff(self.grid_times[::STEP_PARTS]) > 0)
        at = first[:, None] + np.arange(STEP_PARTS + 1)
        breaks, controls = (
            np.append(self.grid_times[first], self.grid_times[-1]),
            self.step.flow.controls[:, first],
        )
        held, flat = np.repeat(controls, STEP_PARTS + 1, axis=1), at.ravel()
        x, lam, nothing = (
            self.states[:, flat],
            self.costates[:, flat],
            np.zeros((len(leg.path_labels), flat.size)),
        )
        rates = s.functions.state_rates(self.grid_times[flat], x, held)
        forces = -s.functions.state_gradient(self.grid_times[flat], x, held, lam, nothing)
        of_x, of_lam = (_interpolate_hermite(breaks, v, r) for v, r in ((x, rates), (lam, forces)))
        middles = compute_midpoints(breaks)
        grown = replace(
            leg,
            mesh=Mesh(tuple((breaks - breaks[0]) / (breaks[-1] - breaks[0])), (1,) * first.size),
            initial_time=float(breaks[0]),
            final_time=float(breaks[-1]),
            x=of_x,
            u=PiecewisePolynomial(breaks, (np.zeros(1),) * first.size, tuple(controls.T[:, :, None])),
            lam=of_lam,
            lam_start=self.costates[:, at[:, 0]],
            lam_end=self.costates[:, at[:, -1]],
            point_costates=of_lam(middles),
            path_multipliers=np.zeros((len(leg.path_labels), first.size)),
            state_multipliers=np.zeros((n, first.size)),
            control_multipliers=np.zeros(controls.shape),
            state_impulses=np.zeros((n, first.size + 1)),
            integrals=self.step.flow.final_state[n : n + leg.integrals.size],
        )
        nu = self.step.multipliers[int(np.sum(leg.final_bounds.is_fixed)) :]
        return replace(known, phases={leg.name: grown}, constraint_multipliers=nu)

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


def _compute_hermite_basis() -> tuple[Array, Array]:
    """Return nodes on [-1, 1], and Hermite basis values there for values and rates at -1, -1/3, 1/3, 1."""
    n = 2 * (STEP_PARTS + 1)
    nodes, given = -np.cos(np.pi * np.arange(n) / (n - 1)), np.linspace(-1.0, 1.0, STEP_PARTS + 1)
    chebyshev = np.polynomial.chebyshev
    rates = np.stack([chebyshev.chebval(given, chebyshev.chebder(row)) for row in np.eye(n)], axis=1)
    values = chebyshev.chebvander(given, n - 1)
    basis = chebyshev.chebvander(nodes, n - 1) @ np.linalg.inv(np.vstack([values, rates]))
    return nodes, np.asarray(basis)


_NODES, _BASIS = _compute_hermite_basis()


def _interpolate_hermite(breaks: Array, values: Array, rates: Array) -> PiecewisePolynomial:
    """Return polynomials through values and rates, (n, K * 4), at the ends and at thirds of every segment."""
    halves, rows = 0.5 * np.diff(breaks), values.shape[0]
    here = values.reshape(rows, halves.size, -1), rates.reshape(rows, halves.size, -1) * halves[:, None]
    found = np.concatenate(here, axis=2) @ _BASIS.T
    return PiecewisePolynomial(breaks, (_NODES,) * halves.size, tuple(found.transpose(1, 0, 2)))


def mask_near_switches(wrong: Array, switches: Indices) -> None:
    """Set sign violations at switches with convergence errors to zero, which are largest at the switch itself."""
    for k in switches:
        most, wrong[k] = abs(wrong[k]) + NEGLIGIBLE, 0.0
        for side in (range(int(k) + 1, wrong.size), range(int(k) - 1, -1, -1)):
            for j in side:
                if not 0 < wrong[j] <= most:
                    break
                wrong[j] = 0.0
