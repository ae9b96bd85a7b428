r"""Switching-time problem: finite-dimensional problem induced by a bang-bang control.

Its unknowns :math:`\theta` are, for each phase, the start, one time for every switch of a control, the end and the
initial values, followed by the free parameters. It minimises the cost :math:`\Phi(\theta)` under the conditions
:math:`\underline\psi \le \psi(\theta) \le \overline\psi` on end values, times, durations, parameters, boundary
constraints and linkages. Only active conditions are used. Flows are integrated from switch to switch (module
`integrate_bang_bang_flow`). Unknowns and conditions are dimensionless.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array, Indices, Mask
from gnc_opt.numerical_tolerances import AT_LIMIT, GONE, NEGLIGIBLE, SMALL, TINY
from gnc_opt.planning.optimality.bang_bang_sensitivity import (
    BangBangFlow,
    PiecewiseControl,
    integrate_bang_bang_flow,
)
from gnc_opt.planning.optimality.cost_and_endpoint_scales import (
    compute_parameter_scales,
    compute_state_ranges,
)
from gnc_opt.planning.problem.bounds import Interval, intersect_bounds, stack_intervals
from gnc_opt.planning.problem.hamiltonian_functions import EndGradients, get_endpoint_function
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.phase_trajectory_samples import COSTATE_MIN_SHARE_OF_COST, PhaseSamples
from gnc_opt.planning.solution.solution import Solution


@dataclass(frozen=True)
class Switches:
    """Switches of a phase, including possible switches at its ends.

    If a switching function is zero at a phase end, a switch there is an unknown, with an arc of zero length. ``times``
    (n,) ascend, simultaneous ones are equal (s); ``channels`` (n,) are their controls. ``first`` (n_controls,) are the
    controls before the first switch, ``toggled`` (n_controls,) the sums of both bounds: minus the control they are the
    control after a switch. ``ends`` (2,) are those of the phase (s).
    """

    times: Array
    channels: Indices
    first: Array
    ends: Array
    toggled: Array
    labels: tuple[str, ...]

    @classmethod
    def from_samples(cls, s: PhaseSamples) -> Switches:
        """Return the switches of a phase whose controls are at bounds everywhere."""
        phase = s.phase
        times, channels = find_bound_to_bound_switches(s)
        ends = phase.breaks[[0, -1]]
        at_start, at_end = _find_switching_function_zeros(s, 0), _find_switching_function_zeros(s, -1)
        times = np.concatenate([np.full(at_start.size, ends[0]), times, np.full(at_end.size, ends[1])])
        channels = np.concatenate([at_start, channels, at_end])
        order = np.argsort(times, kind="stable")
        times = _equalise_nearby_switch_times(times[order], GONE * (ends[1] - ends[0]), ends)
        channels = channels[order]
        bounds, after_start = phase.control_bounds, phase.applied(phase.breaks[0])
        at_upper = after_start - bounds.lower > bounds.upper - after_start
        first = np.where(at_upper, bounds.upper, bounds.lower)
        bound_sums = bounds.lower + bounds.upper
        first[at_start] = bound_sums[at_start] - first[at_start]
        labels = tuple(
            f"switch of {phase.controls.labels[i]} at {s.describe_times(t)}"
            for i, t in zip(channels, times, strict=True)
        )
        return cls(times, channels, first, ends, bound_sums, labels)

    @property
    def simultaneous_switch_groups(self) -> list[list[int]]:
        groups = itertools.groupby(range(self.times.size), key=lambda k: self.times[k])
        return [list(group) for _, group in groups]

    @property
    def chronological_switch_order(self) -> tuple[int, ...]:
        return tuple(int(k) for k in np.argsort(self.times, kind="stable"))

    @property
    def n_switch_sequences(self) -> int:
        """Number of possible orders of the switches."""
        return math.prod(math.factorial(len(group)) for group in self.simultaneous_switch_groups)

    def list_switch_sequences(self) -> Iterator[tuple[int, ...]]:
        """Yield all possible orders of the switches."""
        orders = (itertools.permutations(group) for group in self.simultaneous_switch_groups)
        for choice in itertools.product(*orders):
            yield tuple(itertools.chain.from_iterable(choice))

    def build_piecewise_control(self, order: tuple[int, ...]) -> PiecewiseControl:
        """Return the piecewise constant control for a given order of the switches.

        Unknowns are the start (0), the switches (1 to n) and the end (n + 1).
        """
        controls = [self.first]
        for k in order:
            is_toggled = np.arange(self.first.size) == self.channels[k]
            controls.append(np.where(is_toggled, self.toggled - controls[-1], controls[-1]))
        boundaries = [0, *(1 + k for k in order), self.times.size + 1]
        times = np.concatenate([self.ends[:1], self.times[list(order)], self.ends[1:]])
        return PiecewiseControl(times, np.stack(controls, axis=1), np.asarray(boundaries))

    def build_switch_sequence_constraints(self, order: tuple[int, ...]) -> Array:
        """Return the combinations of unknowns that must be >= 0 for the order to hold, (n_conditions, n + 2)."""
        pieces = self.build_piecewise_control(order)
        rows = []
        for k in np.flatnonzero(np.diff(pieces.times) == 0):
            row = np.zeros(self.times.size + 2)
            row[pieces.unknowns[[k, k + 1]]] = -1.0, 1.0
            rows.append(row)
        return np.reshape(rows, (len(rows), self.times.size + 2))


def find_bound_to_bound_switches(s: PhaseSamples) -> tuple[Array, Indices]:
    """Return times (s) and controls of the bound-to-bound jumps at segment boundaries."""
    phase = s.phase
    breaks = phase.breaks[1:-1]
    jumps = np.abs(phase.applied(breaks) - phase.applied(breaks, "left"))
    width = phase.control_bounds.upper - phase.control_bounds.lower
    with np.errstate(invalid="ignore"):
        is_switch = jumps > (1 - AT_LIMIT) * width[:, None]
    is_switch &= (np.isfinite(width) & (width > 0))[:, None]
    k, i = np.nonzero(is_switch.T)
    return breaks[k], i


def _find_switching_function_zeros(s: PhaseSamples, sample: int) -> Indices:
    bounds = s.phase.control_bounds
    is_zero = np.abs(s.relative_control_gradient[:, sample]) < NEGLIGIBLE
    return np.flatnonzero(is_zero & (bounds.upper > bounds.lower))


def _equalise_nearby_switch_times(times: Array, tolerance: float, ends: Array) -> Array:
    """Return sorted times with nearly equal ones made equal, including the ends."""
    times = times.copy()
    for k in range(1, times.size):
        if times[k] - times[k - 1] < tolerance:
            times[k] = times[k - 1]
    times[times - ends[0] < tolerance] = ends[0]
    times[ends[1] - times < tolerance] = ends[1]
    return times


FLOW_REFINEMENTS = (1, 2, 4, 8, 16, 32)
"""Largest refinement of the flow's steps until it reaches the final state of the solution. Order and error of an
integration are known only if it resolves the dynamics."""

DYNAMICS_TOO_FAST = "dynamics too fast for the finest steps of the flow from switch to switch"
"""Reason why a condition on the induced problem is not checked."""


@dataclass(frozen=True)
class SwitchUnknowns:
    """Unknowns of the switching-time problem, with the ``scale`` of each (n,).

    ``cost_changes`` (n,) are those for a change by the scale: the largest switching function, H or costate times it.
    By phase, ``columns`` are the indices of the unknowns of its flow (start, switches, end, free initial values, free
    parameters), and ``free_start`` the rows of the free initial values. Fixed times and parameters are not ``free``.
    """

    labels: tuple[str, ...]
    scale: Array
    cost_changes: Array
    columns: Mapping[str, Indices]
    free_start: Mapping[str, Indices]
    free: Mask

    @classmethod
    def from_switches(
        cls, solution: Solution, samples: list[PhaseSamples], switches: Mapping[str, Switches]
    ) -> SwitchUnknowns:
        labels: list[str] = []
        scale: list[float] = []
        cost_changes: list[float] = []
        free: list[bool] = []
        columns_by_phase: dict[str, Indices] = {}
        free_rows: dict[str, Indices] = {}
        for s in samples:
            phase, first_column = s.phase, len(labels)
            free_rows[phase.name] = np.flatnonzero(~phase.initial_bounds.is_fixed)
            times = ("initial time", *switches[phase.name].labels, "final time")
            labels += [f"phase {phase.name}, {time}" for time in times]
            labels += [f"phase {phase.name}, initial {phase.states.labels[i]}" for i in free_rows[phase.name]]
            rows, start_scale = free_rows[phase.name], compute_state_ranges(s)[free_rows[phase.name]]
            is_constant = start_scale > s.state_scale[rows]
            start_cost_changes = np.where(is_constant, np.abs(s.lam[rows, 0]) * start_scale, 0.0)
            scale += [s.span] * len(times) + list(start_scale)
            largest = np.max(np.abs(s.control_gradient), axis=1) * s.control_scale
            floor = TINY + COSTATE_MIN_SHARE_OF_COST * s.hamiltonian_scale
            at_switches = np.maximum(largest, floor)[switches[phase.name].channels]
            cost_changes += list(s.span * np.pad(at_switches, 1, constant_values=s.hamiltonian_scale))
            cost_changes += list(np.maximum(s.cost_scale, start_cost_changes))
            free += [not phase.initial_time_bounds.is_fixed[0], *[True] * (len(times) - 2)]
            free += [not phase.final_time_bounds.is_fixed[0], *[True] * free_rows[phase.name].size]
            columns_by_phase[phase.name] = np.arange(first_column, len(labels))
        problem = solution.need_problem("verify")
        common = len(labels) + np.arange(solution.parameter_values.size)
        labels += [f"parameter {label}" for label in solution.free_parameters.labels]
        scale += list(compute_parameter_scales(solution))
        free += list(~problem.get_parameter_bounds().is_fixed)
        cost_changes += [max(s.cost_scale for s in samples)] * common.size
        columns = {name: np.concatenate([c, common]) for name, c in columns_by_phase.items()}
        sizes = np.asarray(scale), np.asarray(cost_changes)
        return cls(tuple(labels), *sizes, columns, free_rows, np.asarray(free, dtype=bool))


@dataclass(frozen=True)
class EndConditions:
    """End conditions: ``values`` (k,) of end values, boundary constraints, then others, with their ``limits``.

    ``jacobian`` (k, n) is that in the scaled unknowns; ``multipliers`` (k,) those of the solution, zero without effect.
    """

    values: Array
    limits: Interval
    jacobian: Array
    multipliers: Array

    @property
    def active_limits(self) -> tuple[Mask, Mask]:
        """Return which conditions are at their lower, and at their upper limit."""
        return self.limits.is_near_limits(self.values, AT_LIMIT * np.sum(np.abs(self.jacobian), axis=1))


@dataclass(frozen=True, eq=False)
class SwitchingTimeProblem:
    """Switching-time problem for one order of the switches; ``gradient`` (n,): of the cost in the scaled unknowns."""

    unknowns: SwitchUnknowns
    gradient: Array
    conditions: EndConditions
    _samples: list[PhaseSamples]
    _flows: Mapping[str, BangBangFlow]
    _at_ends: Callable[[Array], tuple[Array, ...]]
    _changes: Array
    _n_constraints: int

    @classmethod
    def from_integrated_controls(
        cls,
        solution: Solution,
        samples: list[PhaseSamples],
        ends: EndGradients,
        unknowns: SwitchUnknowns,
        pieces: Mapping[str, PiecewiseControl],
        refinement: int,
    ) -> SwitchingTimeProblem:
        """Return the problem, integrated with the solution's controls (pieces by phase) and differentiated."""
        problem = solution.need_problem("verify")
        flows = {}
        for s in samples:
            data = (problem, s, pieces[s.phase.name], unknowns.free_start[s.phase.name])
            grid, flow = _choose_integration_grid(*data)
            if refinement > 1:
                flow = integrate_bang_bang_flow(*data, refinement * grid)
            flows[s.phase.name] = flow
        with np.errstate(over="ignore", invalid="ignore"):  # see `is_finite`
            changes = _differentiate_boundary_states(samples, unknowns, flows)
        derivatives = problem.memoize("end derivatives", lambda: build_endpoint_derivative_function(problem))
        sizes = [(flows[s.phase.name], _count_augmented_states(s)) for s in samples]
        boundary = [values[:size] for flow, size in sizes for values in (flow.initial, flow.final_state)]
        arguments = (*boundary, *(s.functions.p for s in samples), solution.parameter_values)

        def evaluate_derivatives(nu: Array) -> tuple[Array, ...]:
            return tuple(v.full() for v in derivatives(*arguments, nu))

        n_constraints = solution.constraint_multipliers.size
        slope, jacobian, _ = evaluate_derivatives(np.zeros(n_constraints))
        by_unknowns = jacobian @ changes
        conditions = _collect_boundary_conditions(solution, samples, ends, unknowns, changes, by_unknowns)
        gradient = slope.ravel() @ changes
        return cls(
            unknowns, gradient, conditions, samples, flows, evaluate_derivatives, changes, n_constraints
        )

    @property
    def is_finite(self) -> bool:
        """Whether flow and derivatives are finite; dynamics may be too fast for the finest steps."""
        return bool(np.isfinite(self.gradient).all() and np.isfinite(self.conditions.jacobian).all())

    def compute_lagrangian_hessian(self, multipliers: Array) -> tuple[Array, float]:
        """Return the Hessian (n, n) of L = cost + multipliers @ values, and the magnitude of its terms."""
        n_states = sum(s.phase.states.size for s in self._samples)
        # Only end values and boundary constraints are nonlinear.
        on_states, nu = np.split(multipliers[: n_states + self._n_constraints], [n_states])
        slope, _, curvature = self._at_ends(nu)
        terms, row, state = [self._changes.T @ curvature @ self._changes], 0, 0
        for s in self._samples:
            flow, n, size = self._flows[s.phase.name], s.phase.states.size, _count_augmented_states(s)
            adjoint = np.zeros(flow.final_state.size)
            adjoint[:size] = slope[row + size : row + 2 * size, 0]
            adjoint[:n] += on_states[state : state + n]
            indices, term = self.unknowns.columns[s.phase.name], np.zeros_like(terms[0])
            scale = self.unknowns.scale[indices]
            term[np.ix_(indices, indices)] = flow.compute_adjoint_hessian(adjoint) * np.outer(scale, scale)
            terms.append(term)
            row, state = row + 2 * size, state + n
        return np.asarray(np.sum(terms, axis=0)), float(sum(np.linalg.norm(t) for t in terms))


def _choose_integration_grid(
    problem: Problem, s: PhaseSamples, pieces: PiecewiseControl, free_start: Indices
) -> tuple[int, BangBangFlow]:
    """Return the step refinement with which the flow reaches the final state of the solution, and the flow."""
    end = s.phase.x(s.phase.breaks[-1])
    flows = []
    for refinement in FLOW_REFINEMENTS:
        flows.append(integrate_bang_bang_flow(problem, s, pieces, free_start, refinement))
        if np.all(np.abs(flows[-1].final_state[: end.size] - end) < SMALL * s.state_scale):
            return refinement, flows[-1]
    chosen = 0 if np.isfinite(flows[0].final_state).all() else -1
    return FLOW_REFINEMENTS[chosen], flows[chosen]


def _count_augmented_states(s: PhaseSamples) -> int:
    return s.phase.states.size + s.phase.integrals.size + 1


def _differentiate_boundary_states(
    samples: list[PhaseSamples], unknowns: SwitchUnknowns, flows: Mapping[str, BangBangFlow]
) -> Array:
    """Return derivatives of initial and final states of all flows, then of the free parameters, in scaled unknowns."""
    rows = []
    for s in samples:
        flow, columns = flows[s.phase.name], unknowns.columns[s.phase.name]
        for sensitivity in (flow.initial_sensitivity, flow.final_state_sensitivity):
            block = np.zeros((_count_augmented_states(s), unknowns.scale.size))
            block[:, columns] = sensitivity[: _count_augmented_states(s)] * unknowns.scale[columns]
            rows.append(block)
    parameters = np.arange(unknowns.scale.size - samples[0].functions.q.size, unknowns.scale.size)
    rows.append(np.diag(unknowns.scale)[parameters])
    return np.vstack(rows)


def _collect_boundary_conditions(
    solution: Solution,
    samples: list[PhaseSamples],
    ends: EndGradients,
    unknowns: SwitchUnknowns,
    changes: Array,
    of_constraints: Array,
) -> EndConditions:
    problem = solution.need_problem("verify")
    of_states: list[EndConditions] = []
    limits: list[EndConditions] = []
    row = 0
    for s in samples:
        phase, name, size, n = s.phase, s.phase.name, _count_augmented_states(s), s.phase.states.size
        start, end = changes[row : row + size], changes[row + size : row + 2 * size]
        bounds = intersect_bounds(phase.final_bounds, phase.state_bounds)
        of_states.append(EndConditions(s.x[:, -1], bounds, end[:n], s.lam[:, -1] - ends.final_state[name]))
        rows, bounds = unknowns.free_start[name], intersect_bounds(phase.initial_bounds, phase.state_bounds)
        multipliers = -(s.lam[:, 0] + ends.initial_state[name])[rows]
        limits.append(EndConditions(s.x[rows, 0], bounds.select_components(rows), start[rows], multipliers))
        times = np.array([phase.initial_time, phase.final_time, phase.duration])
        jacobian = np.stack([start[-1], end[-1], end[-1] - start[-1]])
        boxes = [phase.initial_time_bounds, phase.final_time_bounds, phase.duration_bounds]
        limits.append(EndConditions(times, stack_intervals(boxes), jacobian, np.zeros(3)))
        row += 2 * size
    bounds, multipliers = problem.get_boundary_constraint_bounds(), solution.constraint_multipliers
    of_states.append(EndConditions(ends.constraints, bounds, of_constraints, multipliers))
    q = solution.parameter_values
    limits.append(EndConditions(q, problem.get_parameter_bounds(), changes[row:], np.zeros(q.size)))
    all_conditions = [*of_states, *limits]
    return EndConditions(
        np.concatenate([rows.values for rows in all_conditions]),
        stack_intervals([rows.limits for rows in all_conditions]),
        np.vstack([rows.jacobian for rows in all_conditions]),
        np.concatenate([rows.multipliers for rows in all_conditions]),
    )


def build_endpoint_derivative_function(problem: Problem) -> Any:
    """Return gradient of cost and constraints with multipliers, Jacobian of the constraints, and Hessian.

    The result is a CasADi Function of the ends of all phases, model parameters, q, nu; derivatives: ends and q.
    """
    ends = get_endpoint_function(problem)
    starts, finals, arguments, parameters = [], [], [], []
    for k in range(len(problem.phases)):
        x0, xf, t0, tf, integrals, p = (ca.SX.sym("v", ends.size1_in(6 * k + i)) for i in range(6))
        starts.append(ca.vertcat(x0, ca.SX.sym("unused", integrals.shape[0]), t0))
        finals.append(ca.vertcat(xf, integrals, tf))
        arguments += [x0, xf, t0, tf, integrals, p]
        parameters.append(p)
    q, nu = (ca.SX.sym("v", ends.size1_in(6 * len(problem.phases) + i)) for i in range(2))
    cost, constraints, *_ = ends(*arguments, q, nu)
    boundary = [v for pair in zip(starts, finals, strict=True) for v in pair]
    variables = ca.vertcat(*boundary, q)
    hessian, gradient = ca.hessian(problem.sense * cost + ca.dot(nu, constraints), variables)
    jacobian = ca.jacobian(constraints, variables)
    return ca.Function("end_derivatives", [*boundary, *parameters, q, nu], [gradient, jacobian, hessian])
