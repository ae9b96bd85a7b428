r"""Bang-bang plan: initial controls and switching times of a solution, and the prediction of its final state.

The controls are constant between the switches. The states are integrated by the fourth-order Runge-Kutta method with a
fixed number of steps per arc. From a state x at t this gives

.. math:: \psi(\tau; t, x) = x(t_f) \ominus x_f, \qquad \nabla_\tau (\nu^T \psi),

with the switching times and the final time :math:`t_f` in :math:`\tau`; entries before t have no effect.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.control.reference_trajectory import Reference
from gnc_opt.control.sampled_data_discretization import sort_symbolic_times
from gnc_opt.errors import DesignError
from gnc_opt.model.casadi_function_evaluation import take_runge_kutta_step
from gnc_opt.planning.problem.active_constraint_arcs import Arc
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.solution import Solution


@dataclass(frozen=True)
class RegulatedEnd:
    """Final part of the trajectory (length in s), tracked by a regulator with a reserved share of the controls."""

    length: float
    reserve: float


@dataclass(frozen=True, eq=False)
class PlanPrediction:
    """Symbolic prediction of a switching plan, with ``steps`` Runge-Kutta steps per arc."""

    plan: SwitchingPlan
    ending: RegulatedEnd
    steps: int
    _unknowns: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_unknowns", self.plan.times.size)

    def evaluate_controls(self, s: Any, tau: Any) -> Any:
        """Return the controls (SX) at time s, for s before the end."""
        late = s > tau[-1] - self.ending.length
        return self.plan.evaluate_controls(s, tau) * (1 - self.ending.reserve * late)

    def average_controls_over_step(self, begin: Any, length: float, tau: Any) -> Any:
        """Return the mean controls (SX) over a step; after the end the trim control of the final state."""
        late = _compute_remaining_step_fraction(begin, length, tau[-1] - self.ending.length)
        over, rest = (
            _compute_remaining_step_fraction(begin, length, tau[-1]),
            self.plan.reference.control_after_final_time,
        )
        before = self.plan.average_controls_over_step(begin, length, tau) * (1 - self.ending.reserve * late)
        return before * (1 - over) + ca.DM(rest) * over

    @cached_property
    def terminal_conditions_function(self) -> Any:
        """Return ``(t, x, tau, nu) -> (psi, gradient of nu' psi)``, columns."""
        model = self.plan.reference.model
        t, x, tau = ca.SX.sym("t"), ca.SX.sym("x", model.states.size), ca.SX.sym("tau", self._unknowns)
        nu, after = ca.SX.sym("nu", model.errors.size), x
        for begin, end in itertools.pairwise(self._list_arc_boundary_times(t, tau)):
            after = self._constant_control_propagation_function(
                begin, after, self.evaluate_controls(0.5 * (begin + end), tau), end - begin
            )
        psi = model.state_error_expression(after, ca.SX(self.plan.final_state))
        return ca.Function("ends", [t, x, tau, nu], [psi, ca.jtimes(psi, tau, nu, True)])

    @cached_property
    def planned_state_function(self) -> Any:
        """Return ``(t, tau) -> x``: planned state at t, by backward integration; the final state after the end."""
        t, tau = ca.SX.sym("t"), ca.SX.sym("tau", self._unknowns)
        x = ca.SX(self.plan.final_state)
        for begin, end in reversed(list(itertools.pairwise(self._list_arc_boundary_times(t, tau)))):
            x = self._constant_control_propagation_function(
                end, x, self.evaluate_controls(0.5 * (begin + end), tau), begin - end
            )
        return ca.Function("reference", [t, tau], [x])

    def _list_arc_boundary_times(self, t: Any, tau: Any) -> list[Any]:
        """Return the times from t to the end between which the controls are constant."""
        end = ca.fmax(tau[-1], t)
        inner = [*ca.vertsplit(tau)[:-1], *([tau[-1] - self.ending.length] if self.ending.reserve else [])]
        return [t, *sort_symbolic_times([ca.fmin(ca.fmax(s, t), end) for s in inner]), end]

    @cached_property
    def _constant_control_propagation_function(self) -> Any:
        """Return ``(t, x, u, length) -> x`` for constant controls."""
        model = self.plan.reference.model
        t, x, u, length = (
            ca.SX.sym(n, size) for n, size in (("t", 1), ("x", model.states.size), ("u", model.controls.size), ("l", 1))
        )  # fmt: skip

        def evaluate_dynamics(at: Any, state: Any, control: Any) -> Any:
            return model.function(at, state, control, model.parameter_values)

        h, now, after = length / self.steps, t, x
        for _ in range(self.steps):
            now, after = now + h, take_runge_kutta_step(evaluate_dynamics, now, h, after, [u] * 3)
        return ca.Function("arc", [t, x, u, length], [after])


def _compute_remaining_step_fraction(begin: Any, length: float, since: Any) -> Any:
    return ca.fmin(1, ca.fmax(0, (begin + length - since) / length))


@dataclass(frozen=True, eq=False)
class SwitchingPlan:
    """Bang-bang plan: ``first`` controls (n_controls,), ``jumps`` of ``channels``, ``times`` (s), the last is t_f."""

    reference: Reference
    first: Array
    channels: tuple[int, ...]
    jumps: Array
    times: Array

    @property
    def initial_time(self) -> float:
        """Initial time, s."""
        return self.reference.initial_time

    @property
    def initial_state(self) -> Array:
        """Planned initial state (n_states,)."""
        return self.reference.x(self.reference.initial_time)

    @property
    def final_state(self) -> Array:
        """Planned final state (n_states,)."""
        return self.reference.x(self.reference.final_time)

    def evaluate_controls(self, s: Any, times: Any) -> Any:
        """Return the controls (SX) at time s for given switching times; each is right-continuous."""
        u = ca.vertsplit(ca.SX(self.first))
        for k, (channel, jump) in enumerate(zip(self.channels, self.jumps, strict=True)):
            u[channel] += jump * (s > times[k])
        return ca.vertcat(*u)

    def average_controls_over_step(self, begin: Any, length: float, times: Any) -> Any:
        """Return the mean controls (SX) over a step, without the final time."""
        u = ca.vertsplit(ca.SX(self.first))
        for k, (channel, jump) in enumerate(zip(self.channels, self.jumps, strict=True)):
            u[channel] += jump * ca.fmin(1, ca.fmax(0, (begin + length - times[k]) / length))
        return ca.vertcat(*u)

    @classmethod
    def from_bang_bang_solution(cls, solution: Solution) -> SwitchingPlan:
        """Return the plan of a bang-bang solution with one phase, free final time and fixed final states."""
        reference = Reference(solution)
        name = solution.problem_name
        if len(solution.phases) != 1:
            raise DesignError(f"the plan '{name}' has {len(solution.phases)} phases: plan in one.")
        (phase,) = solution.phases.values()
        if phase.path_labels or solution.need_problem("follow").constraints:
            raise DesignError(
                f"the plan '{name}' has constraints other than limits of controls, which the guidance does not "
                "support: track it with design_tvlqr() or design_mpc()."
            )
        loose = [
            label
            for label, fixed in zip(phase.states.labels, phase.final_bounds.is_fixed, strict=True)
            if not fixed
        ]
        if loose:
            raise DesignError(f"the plan '{name}' does not fix '{loose[0]}' at the end: use final().")
        if phase.final_time_bounds.is_fixed[0] or phase.duration_bounds.is_fixed[0]:
            raise DesignError(
                f"the plan '{name}' has a fixed final time: make the final time free and minimise it."
            )
        first, switches = _find_bang_bang_switches(solution, phase)
        return cls(
            reference,
            first,
            tuple(channel for _, channel, _ in switches),
            np.array([jump for *_, jump in switches]),
            np.array([*(time for time, *_ in switches), phase.final_time]),
        )


def _find_bang_bang_switches(
    solution: Solution, phase: PhaseSolution
) -> tuple[Array, list[tuple[float, int, float]]]:
    """Return the initial controls, and the time, channel and jump of each switch."""

    def get_control_bound(arc: Arc, channel: int) -> float:
        return float(phase.control_bounds.get_limit_by_sign(arc.kind.sign)[channel])

    first, switches = np.zeros(phase.controls.size), []
    for channel, label in enumerate(phase.controls.labels):
        arcs = [arc for arc in solution.structure if arc.channel == label]
        inner = next((arc for arc in arcs if not arc.kind.is_at_limit), None)
        if not arcs or inner is not None:
            where = f" from {inner.start:g} s to {inner.end:g} s" if inner is not None else ""
            raise DesignError(
                f"'{label}' of the plan '{solution.problem_name}' is not at its limits{where}: refine the "
                "solution, or track it with design_tvlqr() if it is not bang-bang."
            )
        first[channel] = get_control_bound(arcs[0], channel)
        switches += [
            (
                float(after.start),
                channel,
                get_control_bound(after, channel) - get_control_bound(before, channel),
            )
            for before, after in itertools.pairwise(arcs)
        ]
    return first, sorted(switches)
