"""State constraints of a phase (path constraints and state bounds) with their time derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array, Mask
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_function
from gnc_opt.numerical_tolerances import AT_LIMIT, NOTABLE, SMALL
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind
from gnc_opt.planning.problem.bounds import Interval, stack_intervals
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.state_constraint_order import ConstraintOrder, get_constraint_order
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples

TOUCH_MAX_ORDER = 3
"""Largest order of a state constraint."""


@dataclass(frozen=True, eq=False)
class StateConstraints:
    """Path constraints and states of a phase as functions of the state, with time derivatives.

    Rows are path constraints, followed by states.
    """

    problem: Problem
    samples: PhaseSamples

    @property
    def n_rows(self) -> int:
        return len(self.samples.leg.path_labels) + self.samples.leg.states.size

    @cached_property
    def row_bounds(self) -> Interval:
        return stack_intervals([self.samples.leg.path_bounds, self.samples.leg.state_bounds])

    def list_finite_limits(self, row: int) -> list[tuple[ArcKind, float]]:
        box = self.row_bounds
        both = (ArcKind.LOWER, float(box.lower[row])), (ArcKind.UPPER, float(box.upper[row]))
        return [(kind, limit) for kind, limit in both if np.isfinite(limit)]

    @property
    def row_scales(self) -> Array:
        """Variation of each row along the phase."""
        return np.concatenate([self.samples.path_scale, self.samples.state_scale])

    def get_contact_order(self, row: int) -> int:
        """Return the order of a row with possible contacts, else 0."""
        if not self.row_bounds.lower[row] < self.row_bounds.upper[row]:
            return 0
        if not np.isfinite([self.row_bounds.lower[row], self.row_bounds.upper[row]]).any():
            return 0
        order = self.get_constraint_order(row).order or 0
        return order if order <= TOUCH_MAX_ORDER else 0

    def rank_control_effects(self, row: int) -> tuple[tuple[int, int], ...]:
        """Return the controls that can keep a row at its limit, and the signs of their effects on it; 0 if it varies.

        They are sorted by their smallest effect on the first derivative with controls.
        """
        found = {c: self._compute_control_effect(row, c) for c in self.get_constraint_order(row).controls}
        order = sorted(found, key=lambda c: float(np.min(np.abs(found[c]))), reverse=True)
        signs = {c: int(np.sign(v[0])) if np.all(v * v[0] > 0) else 0 for c, v in found.items()}
        return tuple((c, signs[c]) for c in order)

    def _compute_control_effect(self, row: int, control: int) -> Array:
        """Return the effect of a control on the first derivative with controls, at the samples nearest to limits."""
        s, order = self.samples, self.get_contact_order(row)
        distance = np.min(
            [
                np.abs(self.evaluate_constraints(s.times, s.x, s.u)[row] - at)
                for _, at in self.list_finite_limits(row)
            ],
            axis=0,
        )
        near = distance <= max(NOTABLE * self.row_scales[row], np.min(distance))
        times, x, u = s.times[near], s.x[:, near], s.u[:, near]
        moved = u.copy()
        moved[control] += SMALL * s.control_scale[control]
        return self.evaluate_time_derivative(row, order, times, x, moved) - self.evaluate_time_derivative(
            row, order, times, x, u
        )

    def get_constraint_order(self, row: int) -> ConstraintOrder:
        return get_constraint_order(self.problem, self.problem.phases[self.samples.leg.name], row)

    def evaluate_constraints(self, times: Array, x: Array, u: Array) -> Array:
        """Return the values of all rows, (n_rows, n_times)."""
        return np.vstack([self.samples.functions.path_constraints(times, x, u), x])

    def is_near_limits(self, values: Array) -> Mask:
        """Return whether rows are at their lower and at their upper limit (2, n_rows, n_times)."""
        near = np.stack(self.row_bounds.is_near_limits(values, AT_LIMIT * self.row_scales))
        return np.asarray(near & ~self.row_bounds.is_fixed[:, None])

    def compute_costate_jumps(self, times: Array, x: Array, u: Array) -> Array:
        """Return the costate jumps along the gradient of each row, in units of the cost (n_rows, n_times)."""
        s = self.samples
        units = np.repeat(np.eye(x.shape[0])[:, :, None], times.size, axis=2)
        by_state = np.concatenate([s.functions.path_state_jacobian(times, x, u), units])
        gradients = by_state * s.state_scale[:, None]
        jumps = (s.leg.lam(times, "left") - s.leg.lam(times, "right")) * s.state_scale[:, None]
        sizes = np.linalg.norm(gradients, axis=1)
        along = np.einsum("ijk,jk->ik", gradients, jumps)
        return np.asarray(np.divide(along, sizes, out=np.zeros_like(sizes), where=sizes > 0))

    def evaluate_time_derivative(self, row: int, k: int, times: Any, x: Array, u: Array) -> Array:
        """Return the k-th derivative of a row along the dynamics, shape of times."""
        name, f = self.samples.leg.name, self.samples.functions
        function = self.problem.memoize(
            ("derivative", name, row, k), lambda: self._build_derivative_function(row, k)
        )
        return np.asarray(evaluate_casadi_function(function, times, x, u, f.p, f.q)[0])

    def _build_derivative_function(self, row: int, k: int) -> Any:
        leg = self.problem.phases[self.samples.leg.name]
        t, x, u, p = leg.model.arguments()
        expression = self.get_constraint_order(row).derivatives[k]
        return ca.Function(
            "derivative", [t, x, u, p, self.problem.parameter_symbols()], [ca.densify(expression)]
        )
