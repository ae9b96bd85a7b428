r"""Reference magnitudes of the optimality check: control deviation, reach of the states, cost scale.

Every quantity that the check compares with its tolerance is a displacement, a gradient or a change of cost. It is
divided by the value that control variations of the size of the applied controls cause. The section "Scales and
measures" of ``docs/verdict.md`` has the equations and their source: deviations :math:`\Delta_k`, the reach as the
ellipsoid of the controllability Gramian W, and the cost scale C. Without controls, C contains
:math:`\tfrac12 \sum_i |J_{p_i p_i}| p_i^2` of the free parameters.

The measures do not depend on units, origins, moving frames, mixtures of states, ranges or constants in the cost.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from gnc_opt.array_types import Array, Mask
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_batch
from gnc_opt.numerical_tolerances import (
    EQUAL,
    NEGLIGIBLE,
    NOTABLE,
    ROUNDING,
    SMALL,
    TINY,
    max_norm,
    replace_zeros_by_one,
    set_nonfinite_to_zero,
)
from gnc_opt.planning.optimality.controllability_gramian import (
    Ellipsoid,
    Reach,
    compute_control_gramians,
    compute_phase_reachable_sets,
    differentiate_final_state_by_controls,
    differentiate_linked_initial_states,
    linearise_dynamics,
)
from gnc_opt.planning.optimality.cost_and_endpoint_scales import (
    compute_integral_scales,
    compute_parameter_scales,
    estimate_control_deviations,
    scale_inactive_control_deviations,
)
from gnc_opt.planning.problem.hamiltonian_functions import (
    evaluate_endpoint_gradients,
    get_endpoint_value_function,
)
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.scaling_magnitudes import estimate_state_and_control_magnitudes
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_from_nlp_result import bind_parameters
from gnc_opt.planning.solution.state_and_control_scales import SPAN_MIN_SHARE

AFFINE_MIN_COST, CURVED_MIN_COST = 1e-4, 1e-11
"""Smallest scale of a control in which H is affine or curved, relative to the cost scale; smaller ones are rounding."""

ROUGH_STRIDE = 5
"""Interval of samples used for an approximate magnitude."""

SECOND_DIFFERENCE_STEP_SHARE = 1e-4
"""Step of second differences in parameters, relative to their magnitude."""

REACH_SHARES = 1e-1, 1e-2, 1e-3, 1e-4
"""Shares of the reach over which boundary constraints are evaluated too: a power changes little near its zero."""

KINK_STEP_RATIO = 10.0
"""Ratio of two steps whose second differences distinguish kinks from curvature."""


@dataclass(frozen=True, eq=False)
class PhaseScales:
    """Reference magnitudes of a phase.

    Control ``deviation`` (m, n_samples) and ``control_cost`` (m,) of each control's deviation alone; reach of the
    states at the ``start``, in the mean ``along`` the phase, and at the ``end``.
    """

    deviation: Array
    start: Ellipsoid
    along: Ellipsoid
    end: Ellipsoid
    control_cost: Array


@dataclass(frozen=True, eq=False)
class Scales:
    """Reference magnitudes of a solution.

    ``cost`` is the positive cost scale; ``change_of_cost`` includes changes that cancel to first order. ``parameters``
    are deviations of the free parameters. ``links`` are derivatives of the start of a phase in ends of earlier ones, by
    both names; under "" the projection onto its free directions. ``boundary`` are the changes by share of the reach.
    """

    phases: Mapping[str, PhaseScales]
    cost: float
    change_of_cost: float
    parameters: Array
    ends: EndPoints
    reach: Mapping[str, Reach]
    links: Mapping[str, Mapping[str, Array]]
    boundary: Mapping[float, BoundaryChanges]

    @classmethod
    def from_solution(cls, solution: Solution, samples: list[PhaseSamples]) -> Scales:
        """Return the scales of a solution with data from its problem."""
        problem = solution.need_problem("verify")
        nonempty = [s for s in samples if s.has_duration]
        ends = EndPoints.from_solution(solution, samples)
        ordered = sorted(samples, key=lambda s: s.phase.initial_time)
        links = differentiate_linked_initial_states(problem, solution, ordered)
        deviations = {s.phase.name: estimate_control_deviations(s) for s in samples}
        magnitudes = {n: estimate_state_and_control_magnitudes(p)[0] for n, p in problem.phases.items()}

        def compute_reachable_sets(columns: Mapping[str, Array]) -> dict[str, Reach]:
            gramians = compute_control_gramians(links, ordered, deviations, columns)
            phases = {s.phase.name: s for s in samples}
            return {n: compute_phase_reachable_sets(s, gramians[n], magnitudes[n]) for n, s in phases.items()}

        reach = compute_reachable_sets({})
        costs = {s.phase.name: _compute_control_costs(s, deviations[s.phase.name]) for s in samples}
        total = sum(float(np.sum(c)) for c in costs.values())
        curvature = sum(
            max_norm(_compute_hamiltonian_second_differences(s, reach[s.phase.name].along.semi_axes))
            for s in nonempty
        )
        curvature += total + ends.compute_end_cost_curvature(reach)
        smallest = EQUAL * curvature
        resolved = dict(deviations)
        for s in nonempty:
            low = costs[s.phase.name] <= ROUNDING * SMALL * curvature
            resolved[s.phase.name] = scale_inactive_control_deviations(s, resolved[s.phase.name], low, total)
        if any(np.any(resolved[name] != deviations[name]) for name in resolved):
            deviations = resolved
            reach = compute_reachable_sets({})
        cost = sum(_compute_cost_of_joint_control_deviation(s, deviations[s.phase.name]) for s in samples)
        cost += sum(_compute_end_time_shift_cost(s, ends) for s in samples)
        controlled = any(s.phase.controls.size for s in nonempty)
        cost += ends.compute_end_cost_curvature(reach, constrained=not controlled)
        radii = [reach[s.phase.name].along.radius for s in nonempty]
        if cost < SMALL * curvature and not any(np.any(s.control_hessian) for s in nonempty):
            # Along singular arcs controls change the cost only through the states.
            differences = map(_compute_hamiltonian_second_differences, nonempty, map(np.diag, radii))
            cost = curvature + sum(np.sum(np.abs(change)) for change in differences)
            costs = {name: np.full_like(cost_by_control, cost) for name, cost_by_control in costs.items()}
        # Along a state limit controls change the cost only through its multiplier.
        limit_cost = sum(map(_compute_cost_of_state_shift_at_limits, nonempty, radii))
        cost = limit_cost if cost < SMALL * limit_cost else cost
        curvatures = _compute_parameter_curvatures(problem, solution, samples)
        if not controlled:
            cost += 0.5 * float(np.abs(curvatures) @ solution.parameter_values**2)
        cost = max(cost, EQUAL * abs(solution.objective), smallest)
        parameters = _compute_parameter_deviations(problem, solution, curvatures, cost)
        if parameters.size:
            columns = {s.phase.name: linearise_dynamics(s)[-1] * parameters for s in nonempty}
            reach = compute_reachable_sets(columns)
        cost = max(cost, TINY)
        phases = {name: PhaseScales(deviations[name], *reach[name][:3], costs[name]) for name in deviations}
        boundary = {
            step: ends.compute_boundary_changes(reach, parameters, step) for step in (1.0, *REACH_SHARES)
        }
        return cls(phases, cost, curvature, parameters, ends, reach, links, boundary)

    def estimate_control_change_by_costate_gap(self, s: PhaseSamples, gap: Array) -> float:
        """Return the change of low-cost controls due to a costate gap (n,) at the end of a phase, in deviations.

        Relative to the cost scale of all controls, errors of low-cost controls are not visible.
        """
        phase_scales, curv = self.phases[s.phase.name], np.einsum("iij->ij", s.control_hessian) @ s.weights
        shares = phase_scales.control_cost / self.cost
        is_cheap = (shares < AFFINE_MIN_COST) & (shares > CURVED_MIN_COST) & (curv > 0)
        is_cheap &= mask_controls_with_cost_curvature(s)
        if not (np.any(gap) and np.any(is_cheap)):
            return 0.0
        times, response = differentiate_final_state_by_controls(s)
        change = np.einsum("i,imt->mt", gap, response) * s.span / np.where(is_cheap, curv, 1.0)[:, None]
        deviation = np.stack([np.interp(times, s.times, row) for row in phase_scales.deviation])
        relative = np.divide(np.abs(change), deviation, out=np.zeros_like(change), where=deviation > 0)
        largest = float(np.max(np.sqrt(np.mean(relative**2, axis=1)), where=is_cheap, initial=0.0))
        return largest if largest > NOTABLE else 0.0


def sample_control_deviations(s: PhaseSamples, scales: Scales, times: Array) -> Array:
    """Return the deviations of the controls at given times (m, n_times)."""
    rows = [np.interp(times, s.times, row) for row in scales.phases[s.phase.name].deviation]
    return np.reshape(rows, (len(rows), times.size))


def solve_quadratic_step_to_limit(excess: Array, first: Array, second: Array) -> Array:
    """Return the root of a quadratic polynomial with these differences: the share of a step that removes an excess."""
    share = np.where(excess > 0, np.inf, 0.0)
    with np.errstate(invalid="ignore"):
        root = np.sqrt(first**2 + 2.0 * second * excess)
        return np.asarray(np.divide(2.0 * excess, first + root, out=share, where=root > 0))


def _compute_control_costs(s: PhaseSamples, deviation: Array) -> Array:
    """Return the cost of the deviations of each control alone (m,), to first and second order."""
    first = np.abs(set_nonfinite_to_zero(s.switching_functions)) * deviation
    second = 0.5 * np.abs(set_nonfinite_to_zero(np.einsum("iij->ij", s.control_hessian))) * deviation**2
    return np.asarray((first + second) @ s.weights)


def _compute_cost_of_joint_control_deviation(s: PhaseSamples, deviation: Array) -> float:
    """Return the cost of the deviations of all controls; if slope and curvature of H vanish, the size of its terms."""
    curvature = np.abs(set_nonfinite_to_zero(s.control_hessian))
    first = np.sum(np.abs(set_nonfinite_to_zero(s.switching_functions)) * deviation, axis=0) @ s.weights
    second = 0.5 * np.einsum("ijt,it,jt,t->", curvature, deviation, deviation, s.weights)
    slope_parts = s.cost_gradient, s.switching_functions - s.cost_gradient
    slopes = (np.abs(set_nonfinite_to_zero(part)) for part in slope_parts)
    largest_term = max(float(np.sum(v * deviation, axis=0) @ s.weights) for v in slopes)
    change = float(first + second)
    return change if change > NEGLIGIBLE * largest_term else largest_term


def _compute_cost_of_state_shift_at_limits(s: PhaseSamples, displacement: Array) -> float:
    """Return the cost of displacements (n,) against the multipliers of limits, from the rates of the costates."""
    costate_forces = set_nonfinite_to_zero(s.adjoint_residual(s.u, 0.0 * s.mu) - s.state_multiplier)
    return float(displacement @ np.abs(costate_forces) @ s.weights)


def mask_controls_with_cost_curvature(s: PhaseSamples) -> Mask:
    """Return which controls have curvature of the running cost itself, without multipliers (m,)."""
    no_multipliers = np.zeros_like(s.lam), np.zeros_like(s.mu)
    curvature = np.einsum("iij->ij", s.functions.control_hessian(s.times, s.x, s.u, *no_multipliers))
    return np.asarray(np.max(curvature, axis=1) > 0.0)


def _compute_hamiltonian_second_differences(s: PhaseSamples, moves: Array) -> Array:
    """Return half second differences of the integral of H along moves (n,), for two small steps.

    At a kink they grow with the step, elsewhere with its square; the ratio of two steps distinguishes both.
    """
    steps = KINK_STEP_RATIO * SECOND_DIFFERENCE_STEP_SHARE, SECOND_DIFFERENCE_STEP_SHARE
    differences = (compute_hamiltonian_differences(s, moves, step, ROUGH_STRIDE)[1] for step in steps)
    coarse, fine = map(set_nonfinite_to_zero, differences)
    is_smooth = np.abs(coarse) > np.sqrt(KINK_STEP_RATIO) * np.abs(fine)
    return np.asarray(np.where(is_smooth, fine / SECOND_DIFFERENCE_STEP_SHARE, fine))


def compute_hamiltonian_differences(s: PhaseSamples, moves: Array, step: float, stride: int = 1) -> Array:
    """Return central first and half second differences per step of the integral of H along moves (2, n).

    H is taken at every ``stride``-th sample.
    """
    x, u, lam, times = s.x[:, ::stride], s.u[:, ::stride], s.lam[:, ::stride], s.times[::stride]
    count, weights = 2 * moves.shape[1], stride * s.weights[::stride]
    steps = step * np.hstack([moves, -moves])
    states = (x[:, None, :] + steps[:, :, None]).reshape(x.shape[0], -1)
    values = s.functions.hamiltonian(np.tile(times, count), states, np.tile(u, count), np.tile(lam, count))
    change = (values.reshape(count, -1) - s.hamiltonian[::stride]) @ weights
    ahead, behind = change[: count // 2], change[count // 2 :]
    return np.asarray(0.5 * np.stack([ahead - behind, ahead + behind]) / step)


def _compute_end_time_shift_cost(s: PhaseSamples, ends: EndPoints) -> float:
    if s.has_fixed_duration:
        return 0.0
    rate = np.abs(s.functions.weights @ s.functions.integrands(s.times, s.x, s.u)) @ s.weights
    slopes = ends.gradients.initial_time[s.phase.name], ends.gradients.final_time[s.phase.name]
    return float(rate) + s.span * float(sum(map(abs, slopes)))


def _compute_parameter_deviations(
    problem: Problem, solution: Solution, curvatures: Array, cost: float
) -> Array:
    """Return the deviations of the free parameters (n,): equal cost to the controls, else their magnitude."""
    size, unlimited = _compute_parameter_magnitudes(problem, solution), np.full(curvatures.size, np.inf)
    by_cost = np.sqrt(np.divide(2 * cost, curvatures, out=unlimited, where=curvatures > 0))
    return np.asarray(np.where(np.isfinite(by_cost), by_cost, size))


def _compute_parameter_magnitudes(problem: Problem, solution: Solution) -> Array:
    size, width = np.abs(solution.parameter_values), problem.get_parameter_bounds().interval_width_or_zero
    return np.asarray(np.where(size > 0, size, replace_zeros_by_one(width)))


def _compute_parameter_curvatures(problem: Problem, solution: Solution, samples: list[PhaseSamples]) -> Array:
    """Return the second derivatives of the Lagrangian in the free parameters (n,), by differences."""
    values, size = solution.parameter_values, _compute_parameter_magnitudes(problem, solution)
    curvatures = np.zeros(values.size)
    for i in range(values.size):
        step = np.zeros(values.size)
        step[i] = SECOND_DIFFERENCE_STEP_SHARE * size[i]
        slopes = [_differentiate_lagrangian(solution, samples, values + k * step)[i] for k in (1, -1)]
        curvatures[i] = (slopes[0] - slopes[1]) / (2 * step[i])
    return set_nonfinite_to_zero(curvatures)


def _differentiate_lagrangian(solution: Solution, samples: list[PhaseSamples], q: Array) -> Array:
    """Return the derivative of the Lagrangian in the parameters at other parameter values (n,)."""
    problem, ends = solution.need_problem("verify"), {}
    slope = np.zeros(q.size)
    for s in samples:
        functions = bind_parameters(problem, s.phase.name, q, s.functions.weights)
        ends[s.phase.name] = [*s.phase.endpoint_arguments[:5], functions.p]
        slope += functions.parameter_gradient(s.times, s.x, s.u, s.lam, s.mu) @ s.weights
    return slope + evaluate_endpoint_gradients(problem, ends, q, solution.constraint_multipliers).parameters


class BoundaryChanges(NamedTuple):
    """Changes of boundary constraints, then of the initial and final states of each phase (n_rows in all).

    ``gramian`` (n_rows, n_rows) of the first differences, norms ``curvature`` (n_rows,) of the second differences, and
    magnitudes ``terms`` (n_rows,) of which the values are sums.
    """

    gramian: Array
    curvature: Array
    terms: Array


@dataclass(frozen=True, eq=False)
class EndPoints:
    """Cost and boundary constraints as functions of all ends.

    ``values`` are states, times, integrals and parameters of every phase, followed by the free parameters;
    ``gradients`` (`EndGradients`) are without multipliers.
    """

    solution: Solution
    samples: list[PhaseSamples]
    values: list[Array]
    gradients: Any

    @classmethod
    def from_solution(cls, solution: Solution, samples: list[PhaseSamples]) -> EndPoints:
        problem = solution.need_problem("verify")
        ends = {name: phase.endpoint_arguments for name, phase in solution.phases.items()}
        values = [np.atleast_1d(v) for arguments in ends.values() for v in arguments]
        zero_multipliers = np.zeros(solution.constraint_multipliers.size)
        gradients = evaluate_endpoint_gradients(problem, ends, solution.parameter_values, zero_multipliers)
        return cls(solution, samples, [*values, solution.parameter_values], gradients)

    def compute_endpoint_changes(self) -> Array:
        """Return the largest changes of constraints and cost (n_constraints + 1,) over variation scales of the ends.

        They are the reference for vanishing costates, unlike values, which may contain constants.
        """
        spans = []
        for s in self.samples:
            bounds = s.phase.initial_time_bounds, s.phase.final_time_bounds
            spans += [s.state_scale, s.state_scale, *(np.where(b.is_fixed, 0.0, s.span) for b in bounds)]
            spans += [compute_integral_scales(s), np.zeros(s.phase.parameters.size)]
        spans.append(compute_parameter_scales(self.solution))
        first, second = self._compute_endpoint_finite_differences(np.diag(np.concatenate(spans)))
        changes = np.max(np.abs(first) + 0.5 * np.abs(second), axis=1, initial=0.0)
        values = np.append(self.gradients.constraints, self.gradients.cost)
        return np.asarray(np.fmax(changes, SPAN_MIN_SHARE * np.abs(values)))

    def compute_end_cost_curvature(self, reach: Mapping[str, Reach], *, constrained: bool = False) -> float:
        """Return the largest half second difference of the end cost over the reach of the ends.

        With ``constrained``, the boundary constraints and their multipliers are included.
        """
        _, second = self._compute_endpoint_finite_differences(self._list_end_displacements_along_axes(reach))
        change = self._constraint_and_cost_weights @ second if constrained else second[-1]
        return 0.5 * max_norm(change)

    def compute_boundary_changes(
        self, reach: Mapping[str, Reach], parameters: Array, share: float
    ) -> BoundaryChanges:
        """Return the changes over a share of the reach; fixed initial states are independent."""
        moves = [
            self._list_end_displacements_along_axes(reach),
            self._expand_endpoint_displacements({-1: np.diag(parameters)}),
        ]
        for k, s in enumerate(self.samples):
            if not s.has_fixed_duration:
                moves += self._list_end_displacements_along_trajectory(k, s)
        steps, splits = share * np.hstack(moves), np.cumsum([v.size for v in self.values])[:-1]
        first, second = (v[:-1] for v in self._compute_endpoint_finite_differences(steps))
        states = [index for index in range(len(self.values) - 1) if index % 6 < 2]
        rows = np.vstack([first, *(np.split(steps, splits)[index] for index in states)])
        sizes = np.abs(np.concatenate([self.values[index] for index in states]))
        changes = np.diag(SECOND_DIFFERENCE_STEP_SHARE * np.concatenate(self.values))
        term_sizes = np.abs(self._compute_endpoint_finite_differences(changes)[0][:-1])
        term_magnitudes = np.sum(term_sizes, axis=1) / SECOND_DIFFERENCE_STEP_SHARE
        term_magnitudes = np.append(np.fmax(np.abs(self.gradients.constraints), term_magnitudes), sizes)
        starts = [s.phase.initial_bounds.is_fixed * reach[s.phase.name].start.radius for s in self.samples]
        fixed = np.concatenate([np.zeros(first.shape[0]), *(np.append(r, 0.0 * r) for r in starts)])
        curvature = np.pad(np.linalg.norm(second, axis=1), (0, sizes.size))
        return BoundaryChanges(rows @ rows.T + np.diag((share * fixed) ** 2), curvature, term_magnitudes)

    @property
    def _constraint_and_cost_weights(self) -> Array:
        """Multipliers of the constraints, and the sense of the cost."""
        sense = self.solution.need_problem("verify").sense
        return np.append(self.solution.constraint_multipliers, sense)

    def _expand_endpoint_displacements(self, changes: Mapping[int, Array]) -> Array:
        """Return moves of all ends (n_values, n) from those of some of ``values`` (n_k, n), by index."""
        n = next(iter(changes.values())).shape[1]
        moves = [np.zeros((v.size, n)) for v in self.values]
        for k, change in changes.items():
            moves[k] = change
        return np.vstack(moves)

    def _list_end_displacements_along_axes(self, reach: Mapping[str, Reach], *, full: bool = False) -> Array:
        """Return moves of the ends along their principal axes; with ``full``, zero axes have length 1."""
        moves = []
        for k, s in enumerate(self.samples):
            start, end = reach[s.phase.name].start, reach[s.phase.name].end_with_integrals
            free, n = ~s.phase.initial_bounds.is_fixed, s.phase.states.size
            first, last = (e.nonzero_semi_axes if full else e.semi_axes for e in (start, end))
            moves.append(self._expand_endpoint_displacements({6 * k: first[:, free] * free[:, None]}))
            moves.append(self._expand_endpoint_displacements({6 * k + 1: last[:n], 6 * k + 4: last[n:]}))
        return np.hstack(moves)

    def _list_end_displacements_along_trajectory(self, k: int, s: PhaseSamples) -> list[Array]:
        """Return moves of the ends of a phase along its flow, together with their times, over its duration."""
        moves, step = [], SECOND_DIFFERENCE_STEP_SHARE * s.span
        bounds = (s.phase.initial_time_bounds, s.phase.final_time_bounds)
        for sample, index, time_bounds in ((0, 6 * k, bounds[0]), (-1, 6 * k + 1, bounds[1])):
            if not time_bounds.is_fixed[0]:
                rate = s.functions.state_rates(s.times[[sample]], s.x[:, [sample]], s.u[:, [sample]])
                change = {index: set_nonfinite_to_zero(rate) * step, index + 2: np.array([[step]])}
                moves.append(self._expand_endpoint_displacements(change))
        return moves

    def compute_end_lagrangian_differences(
        self, reach: Mapping[str, Reach], parameters: Array, step: float
    ) -> Array:
        """Return slopes and half second differences of the Lagrangian per step over the reach, by direction (2, n)."""
        moves = [
            self._list_end_displacements_along_axes(reach, full=True),
            self._expand_endpoint_displacements({-1: np.diag(parameters)}),
        ]
        for k, s in enumerate(self.samples):
            for index, time_bounds in (
                (6 * k + 2, s.phase.initial_time_bounds),
                (6 * k + 3, s.phase.final_time_bounds),
            ):
                if not time_bounds.is_fixed[0]:
                    moves.append(self._expand_endpoint_displacements({index: np.array([[s.span]])}))
        first, second = self._compute_endpoint_finite_differences(step * np.hstack(moves))
        weights = self._constraint_and_cost_weights
        return np.stack([weights @ first, 0.5 * (weights @ second)]) / step

    def _compute_endpoint_finite_differences(self, moves: Array) -> tuple[Array, Array]:
        """Return central first and second differences (n_constraints + 1, n_moves) of constraints and cost."""
        values, n = np.concatenate(self.values)[:, None], moves.shape[1]
        splits = np.cumsum([v.size for v in self.values])[:-1]
        rows = np.split(np.hstack([values, values + moves, values - moves]), splits)
        nu = np.zeros(self.solution.constraint_multipliers.size)
        with np.errstate(all="ignore"):
            function = get_endpoint_value_function(self.solution.need_problem("verify"))
            results = evaluate_casadi_batch(function, 1 + 2 * n, *rows, nu)
            base, ahead, behind = results[:, :1], results[:, 1 : 1 + n], results[:, 1 + n :]
            first, second = 0.5 * (ahead - behind), ahead + behind - 2 * base
        return set_nonfinite_to_zero(first), set_nonfinite_to_zero(second)
