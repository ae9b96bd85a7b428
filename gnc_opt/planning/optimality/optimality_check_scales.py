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
from typing import Any

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

CHEAP_AFFINE, CHEAP_CURVED = 1e-4, 1e-11
"""Smallest scale of a control in which H is affine or curved, relative to the cost scale; smaller ones are rounding."""

ROUGH_SAMPLES = 5
"""Interval of samples used for an approximate magnitude."""

SECOND_DIFFERENCE_STEP_SHARE = 1e-4
"""Step of second differences in parameters, relative to their magnitude."""

NEARER_SHARES = 1e-1, 1e-2, 1e-3, 1e-4
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
    both names; under "" the projection onto its free directions. ``boundary`` are the Gramian of boundary constraints
    and end states over each share of the reach, second differences, and terms (`EndPoints.compute_boundary_gramian`).
    """

    phases: Mapping[str, PhaseScales]
    cost: float
    change_of_cost: float
    parameters: Array
    ends: EndPoints
    reach: Mapping[str, Reach]
    links: Mapping[str, Mapping[str, Array]]
    boundary: Mapping[float, tuple[Array, Array, Array]]

    @classmethod
    def from_solution(cls, solution: Solution, samples: list[PhaseSamples]) -> Scales:
        """Return the scales of a solution with data from its problem."""
        problem = solution.need_problem("verify")
        lasting = [s for s in samples if s.has_duration]
        ends = EndPoints.from_solution(solution, samples)
        order = sorted(samples, key=lambda s: s.phase.initial_time)
        links = differentiate_linked_initial_states(problem, solution, order)
        deviations = {s.phase.name: estimate_control_deviations(s) for s in samples}
        typical = {n: estimate_state_and_control_magnitudes(p)[0] for n, p in problem.phases.items()}

        def compute_reachable_sets(columns: Mapping[str, Array]) -> dict[str, Reach]:
            gramians = compute_control_gramians(links, order, deviations, columns)
            phases = {s.phase.name: s for s in samples}
            return {n: compute_phase_reachable_sets(s, gramians[n], typical[n]) for n, s in phases.items()}

        reach = compute_reachable_sets({})
        costs = {s.phase.name: _compute_control_costs(s, deviations[s.phase.name]) for s in samples}
        flat = sum(float(np.sum(c)) for c in costs.values())
        changed = sum(
            max_norm(_compute_hamiltonian_second_differences(s, reach[s.phase.name][1].semi_axes))
            for s in lasting
        )
        changed += flat + ends.compute_end_cost_curvature(reach)
        least = EQUAL * changed
        resolved = dict(deviations)
        for s in lasting:
            idle = costs[s.phase.name] <= ROUNDING * SMALL * changed
            resolved[s.phase.name] = scale_inactive_control_deviations(s, resolved[s.phase.name], idle, flat)
        if any(np.any(resolved[name] != deviations[name]) for name in resolved):
            deviations = resolved
            reach = compute_reachable_sets({})
        cost = sum(_compute_cost_of_joint_control_deviation(s, deviations[s.phase.name]) for s in samples)
        cost += sum(_compute_end_time_shift_cost(s, ends) for s in samples)
        controlled = any(s.phase.controls.size for s in lasting)
        cost += ends.compute_end_cost_curvature(reach, constrained=not controlled)
        if cost < SMALL * changed and not any(np.any(s.control_hessian) for s in lasting):
            # Along singular arcs controls change the cost only through the states.
            moves = [np.diag(reach[s.phase.name][1].radius) for s in lasting]
            differences = map(_compute_hamiltonian_second_differences, lasting, moves)
            cost = changed + sum(np.sum(np.abs(change)) for change in differences)
            costs = {name: np.full_like(own, cost) for name, own in costs.items()}
        # Along a state limit controls change the cost only through its multiplier.
        limited = sum(
            _compute_cost_of_state_shift_at_limits(s, reach[s.phase.name][1].radius) for s in lasting
        )
        cost = limited if cost < SMALL * limited else cost
        curvatures = _compute_parameter_curvatures(problem, solution, samples)
        if not controlled:
            cost += 0.5 * float(np.abs(curvatures) @ solution.parameter_values**2)
        cost = max(cost, EQUAL * abs(solution.objective), least)
        parameters = _compute_parameter_deviations(problem, solution, curvatures, cost)
        if parameters.size:
            columns = {s.phase.name: linearise_dynamics(s)[-1] * parameters for s in lasting}
            reach = compute_reachable_sets(columns)
        cost = max(cost, TINY)
        phases = {name: PhaseScales(deviations[name], *reach[name][:3], costs[name]) for name in deviations}
        boundary = {
            step: ends.compute_boundary_gramian(reach, parameters, step) for step in (1.0, *NEARER_SHARES)
        }
        return cls(phases, cost, changed, parameters, ends, reach, links, boundary)

    def estimate_control_change_by_costate_gap(self, s: PhaseSamples, gap: Array) -> float:
        """Return the change of low-cost controls due to a costate gap (n,) at the end of a phase, in deviations.

        Relative to the cost scale of all controls, errors of low-cost controls are not visible.
        """
        own, bends = self.phases[s.phase.name], np.einsum("iij->ij", s.control_hessian) @ s.weights
        shares = own.control_cost / self.cost
        cheap = (shares < CHEAP_AFFINE) & (shares > CHEAP_CURVED) & (bends > 0)
        cheap &= mask_controls_with_cost_curvature(s)
        if not (np.any(gap) and np.any(cheap)):
            return 0.0
        times, response = differentiate_final_state_by_controls(s)
        moved = np.einsum("i,imt->mt", gap, response) * s.span / np.where(cheap, bends, 1.0)[:, None]
        deviation = np.stack([np.interp(times, s.times, row) for row in own.deviation])
        share = np.divide(np.abs(moved), deviation, out=np.zeros_like(moved), where=deviation > 0)
        miss = float(np.max(np.sqrt(np.mean(share**2, axis=1)), where=cheap, initial=0.0))
        return miss if miss > NOTABLE else 0.0


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
    bends = np.abs(set_nonfinite_to_zero(s.control_hessian))
    first = np.sum(np.abs(set_nonfinite_to_zero(s.switching_functions)) * deviation, axis=0) @ s.weights
    second = 0.5 * np.einsum("ijt,it,jt,t->", bends, deviation, deviation, s.weights)
    parts = s.cost_gradient, s.switching_functions - s.cost_gradient
    slopes = (np.abs(set_nonfinite_to_zero(part)) for part in parts)
    terms = max(float(np.sum(v * deviation, axis=0) @ s.weights) for v in slopes)
    change = float(first + second)
    return change if change > NEGLIGIBLE * terms else terms


def _compute_cost_of_state_shift_at_limits(s: PhaseSamples, moved: Array) -> float:
    """Return the cost of displacements (n,) against the multipliers of limits, from the rates of the costates."""
    forces = set_nonfinite_to_zero(s.adjoint_residual(s.u, 0.0 * s.mu) - s.state_multiplier)
    return float(moved @ np.abs(forces) @ s.weights)


def mask_controls_with_cost_curvature(s: PhaseSamples) -> Mask:
    """Return which controls have curvature of the running cost itself, without multipliers (m,)."""
    none = np.zeros_like(s.lam), np.zeros_like(s.mu)
    bends = np.einsum("iij->ij", s.functions.control_hessian(s.times, s.x, s.u, *none))
    return np.asarray(np.max(bends, axis=1) > 0.0)


def _compute_hamiltonian_second_differences(s: PhaseSamples, moves: Array) -> Array:
    """Return half second differences of the integral of H along moves (n,), for two small steps.

    At a kink they grow with the step, elsewhere with its square; the ratio of two steps distinguishes both.
    """
    steps = KINK_STEP_RATIO * SECOND_DIFFERENCE_STEP_SHARE, SECOND_DIFFERENCE_STEP_SHARE
    found = (compute_hamiltonian_differences(s, moves, step, ROUGH_SAMPLES)[1] for step in steps)
    coarse, fine = map(set_nonfinite_to_zero, found)
    smooth = np.abs(coarse) > np.sqrt(KINK_STEP_RATIO) * np.abs(fine)
    return np.asarray(np.where(smooth, fine / SECOND_DIFFERENCE_STEP_SHARE, fine))


def compute_hamiltonian_differences(s: PhaseSamples, moves: Array, step: float, every: int = 1) -> Array:
    """Return central first and half second differences per step of the integral of H along moves (2, n).

    H is taken at every ``every``-th sample.
    """
    x, u, lam, times = s.x[:, ::every], s.u[:, ::every], s.lam[:, ::every], s.times[::every]
    count, weights = 2 * moves.shape[1], every * s.weights[::every]
    moved = step * np.hstack([moves, -moves])
    places = (x[:, None, :] + moved[:, :, None]).reshape(x.shape[0], -1)
    values = s.functions.hamiltonian(np.tile(times, count), places, np.tile(u, count), np.tile(lam, count))
    change = (values.reshape(count, -1) - s.hamiltonian[::every]) @ weights
    ahead, behind = change[: count // 2], change[count // 2 :]
    return np.asarray(0.5 * np.stack([ahead - behind, ahead + behind]) / step)


def _compute_end_time_shift_cost(s: PhaseSamples, ends: EndPoints) -> float:
    if s.has_fixed_duration:
        return 0.0
    rate = np.abs(s.functions.weights @ s.functions.integrands(s.times, s.x, s.u)) @ s.weights
    slopes = ends.gradients.initial_time[s.phase.name], ends.gradients.final_time[s.phase.name]
    return float(rate) + s.span * float(sum(map(abs, slopes)))


# --- parameters -------------------------------------------------------------------------------------------


def _compute_parameter_deviations(
    problem: Problem, solution: Solution, curvatures: Array, cost: float
) -> Array:
    """Return the deviations of the free parameters (n,): equal cost to the controls, else their magnitude."""
    size, found = _compute_parameter_magnitudes(problem, solution), np.full(curvatures.size, np.inf)
    equal = np.sqrt(np.divide(2 * cost, curvatures, out=found, where=curvatures > 0))
    return np.asarray(np.where(np.isfinite(equal), equal, size))


def _compute_parameter_magnitudes(problem: Problem, solution: Solution) -> Array:
    size, extent = np.abs(solution.parameter_values), problem.get_parameter_bounds().interval_width_or_zero
    return np.asarray(np.where(size > 0, size, replace_zeros_by_one(extent)))


def _compute_parameter_curvatures(problem: Problem, solution: Solution, samples: list[PhaseSamples]) -> Array:
    """Return the second derivatives of the Lagrangian in the free parameters (n,), by differences."""
    values, size = solution.parameter_values, _compute_parameter_magnitudes(problem, solution)
    bends = np.zeros(values.size)
    for i in range(values.size):
        step = np.zeros(values.size)
        step[i] = SECOND_DIFFERENCE_STEP_SHARE * size[i]
        slopes = [_differentiate_lagrangian(solution, samples, values + k * step)[i] for k in (1, -1)]
        bends[i] = (slopes[0] - slopes[1]) / (2 * step[i])
    return set_nonfinite_to_zero(bends)


def _differentiate_lagrangian(solution: Solution, samples: list[PhaseSamples], q: Array) -> Array:
    """Return the derivative of the Lagrangian in the parameters at other parameter values (n,)."""
    problem, ends = solution.need_problem("verify"), {}
    slope = np.zeros(q.size)
    for s in samples:
        functions = bind_parameters(problem, s.phase.name, q, s.functions.weights)
        ends[s.phase.name] = [*s.phase.endpoint_arguments[:5], functions.p]
        slope += functions.parameter_gradient(s.times, s.x, s.u, s.lam, s.mu) @ s.weights
    return slope + evaluate_endpoint_gradients(problem, ends, q, solution.constraint_multipliers).parameters


# --- ends -------------------------------------------------------------------------------------------------


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
        nothing = np.zeros(solution.constraint_multipliers.size)
        gradients = evaluate_endpoint_gradients(problem, ends, solution.parameter_values, nothing)
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

    def compute_boundary_gramian(
        self, reach: Mapping[str, Reach], parameters: Array, share: float = 1.0
    ) -> tuple[Array, Array, Array]:
        """Return the Gramian of constraints and end states over a share of the reach, second differences, and terms.

        Rows are the constraints, and the initial and final states of each phase. Fixed initial states are independent.
        """
        moves = [
            self._list_end_displacements_along_axes(reach),
            self._expand_endpoint_displacements({-1: np.diag(parameters)}),
        ]
        for k, s in enumerate(self.samples):
            if not s.has_fixed_duration:
                moves += self._list_end_displacements_along_trajectory(k, s)
        steps, places = share * np.hstack(moves), np.cumsum([v.size for v in self.values])[:-1]
        first, second = (v[:-1] for v in self._compute_endpoint_finite_differences(steps))
        states = [at for at in range(len(self.values) - 1) if at % 6 < 2]
        rows = np.vstack([first, *(np.split(steps, places)[at] for at in states)])
        sizes = np.abs(np.concatenate([self.values[at] for at in states]))
        changes = np.diag(SECOND_DIFFERENCE_STEP_SHARE * np.concatenate(self.values))
        parts = np.abs(self._compute_endpoint_finite_differences(changes)[0][:-1])
        terms = np.sum(parts, axis=1) / SECOND_DIFFERENCE_STEP_SHARE
        terms = np.append(np.fmax(np.abs(self.gradients.constraints), terms), sizes)
        starts = [s.phase.initial_bounds.is_fixed * reach[s.phase.name][0].radius for s in self.samples]
        fixed = np.concatenate([np.zeros(first.shape[0]), *(np.append(r, 0.0 * r) for r in starts)])
        bends = np.pad(np.linalg.norm(second, axis=1), (0, sizes.size))
        return rows @ rows.T + np.diag((share * fixed) ** 2), bends, terms

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

    def _list_end_displacements_along_axes(self, reach: Mapping[str, Reach], *, still: bool = False) -> Array:
        """Return moves of the ends along their principal axes; with ``still``, zero axes have length 1."""
        moves = []
        for k, s in enumerate(self.samples):
            start, _, _, end = reach[s.phase.name]
            free, n = ~s.phase.initial_bounds.is_fixed, s.phase.states.size
            first, last = (e.nonzero_semi_axes if still else e.semi_axes for e in (start, end))
            moves.append(self._expand_endpoint_displacements({6 * k: first[:, free] * free[:, None]}))
            moves.append(self._expand_endpoint_displacements({6 * k + 1: last[:n], 6 * k + 4: last[n:]}))
        return np.hstack(moves)

    def _list_end_displacements_along_trajectory(self, k: int, s: PhaseSamples) -> list[Array]:
        """Return moves of the ends of a phase along its flow, together with their times, over its duration."""
        moves, step = [], SECOND_DIFFERENCE_STEP_SHARE * s.span
        bounds = (s.phase.initial_time_bounds, s.phase.final_time_bounds)
        for at, place, box in ((0, 6 * k, bounds[0]), (-1, 6 * k + 1, bounds[1])):
            if not box.is_fixed[0]:
                rate = s.functions.state_rates(s.times[[at]], s.x[:, [at]], s.u[:, [at]])
                change = {place: set_nonfinite_to_zero(rate) * step, place + 2: np.array([[step]])}
                moves.append(self._expand_endpoint_displacements(change))
        return moves

    def compute_end_lagrangian_differences(
        self, reach: Mapping[str, Reach], parameters: Array, step: float
    ) -> Array:
        """Return slopes and half second differences of the Lagrangian per step over the reach, by direction (2, n)."""
        moves = [
            self._list_end_displacements_along_axes(reach, still=True),
            self._expand_endpoint_displacements({-1: np.diag(parameters)}),
        ]
        for k, s in enumerate(self.samples):
            for place, box in (
                (6 * k + 2, s.phase.initial_time_bounds),
                (6 * k + 3, s.phase.final_time_bounds),
            ):
                if not box.is_fixed[0]:
                    moves.append(self._expand_endpoint_displacements({place: np.array([[s.span]])}))
        first, second = self._compute_endpoint_finite_differences(step * np.hstack(moves))
        weights = self._constraint_and_cost_weights
        return np.stack([weights @ first, 0.5 * (weights @ second)]) / step

    def _compute_endpoint_finite_differences(self, moves: Array) -> tuple[Array, Array]:
        """Return central first and second differences (n_constraints + 1, n_moves) of constraints and cost."""
        here, n = np.concatenate(self.values)[:, None], moves.shape[1]
        places = np.cumsum([v.size for v in self.values])[:-1]
        rows = np.split(np.hstack([here, here + moves, here - moves]), places)
        nu = np.zeros(self.solution.constraint_multipliers.size)
        with np.errstate(all="ignore"):
            function = get_endpoint_value_function(self.solution.need_problem("verify"))
            found = evaluate_casadi_batch(function, 1 + 2 * n, *rows, nu)
            base, ahead, behind = found[:, :1], found[:, 1 : 1 + n], found[:, 1 + n :]
            first, second = 0.5 * (ahead - behind), ahead + behind - 2 * base
        return set_nonfinite_to_zero(first), set_nonfinite_to_zero(second)
