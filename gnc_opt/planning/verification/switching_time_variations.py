r"""Shifted trajectory: second-order changes of the cost by integration with shifted control jumps.

Second-order conditions of bang-bang arcs require switches that are simple, distinct and inside phases. Here every jump
of a control component is shifted individually, also across phase boundaries and for coincident jumps, and the
trajectory is integrated. Along directions that satisfy the end conditions to first order, composed of jumps, regular
controls :math:`\delta u \sim q^2 B^T \Phi(t_f, t)^T e_i`, free initial states, times and parameters, the Lagrangian

.. math:: J + \nu^T \psi + (\lambda - \Phi_x)^T \Delta x_f + \int \mu^T c + z^T x\,dt
          + \sum_k \eta_k \max_t g_k(t, x)

must not decrease to second order, evaluated at two steps. Shifts are measured by :math:`1/\sqrt{L_{kk}}`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_batch, take_runge_kutta_step
from gnc_opt.numerical_tolerances import (
    AT_LIMIT,
    EQUAL,
    MINOR,
    NEGLIGIBLE,
    NOTABLE,
    RANK,
    SAME_TIME,
    SMALL,
    TINY,
)
from gnc_opt.planning.optimality.controllability_gramian import (
    differentiate_final_state_by_controls,
    subdivide_mesh_segments,
)
from gnc_opt.planning.optimality.optimality_check_scales import Scales
from gnc_opt.planning.problem.bounds import Interval, stack_intervals
from gnc_opt.planning.problem.hamiltonian_functions import (
    EndGradients,
    PhaseFunctions,
    get_endpoint_value_function,
)
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.defects_and_violations import Worst
from gnc_opt.planning.solution.phase_trajectory_samples import COSTATE_MIN_SHARE_OF_COST, PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_from_nlp_result import bind_parameters
from gnc_opt.planning.solution.solution_summary import time_unit
from gnc_opt.planning.verification.active_limits_and_touch_points import (
    compute_touch_point_lagrangian,
    evaluate_active_limit_gradients,
    find_costate_jumps,
    mask_controls_set_by_active_limits,
    mask_limits_with_multipliers,
)

SHIFT_STEP_SHARE = 0.02
"""Larger step, as a share of the shorter arc next to a jump."""

SLOPE_STEP_SHARE, MAX_CHANGE = 0.01, 0.1
"""Steps for slopes, relative to the larger step; largest change of the end conditions by a step, relative to range."""

DECREASE_RATIOS = (0.1, 0.6)
"""Ratios of the decreases at a step and half of it that indicate second order."""


@dataclass(frozen=True)
class Jump:
    """Jump of a control; ``shorter_arc`` (s) of both sides; ``beyond``: phase after a jump at a phase boundary."""

    phase: str
    time: float
    channel: int
    before: float
    after: float
    shorter_arc: float = np.inf
    beyond: str = ""


@dataclass(frozen=True, eq=False)
class ShiftedTrajectory:
    """Trajectory with shifted jumps, by phases in order of time (``samples``)."""

    solution: Solution
    samples: list[PhaseSamples]
    ends: EndGradients
    scales: Scales
    jumps: list[Jump]

    @cached_property
    def control_variations(self) -> list[tuple[str, Array, Array]]:
        """Control variations: phase, times, (m, n_times)."""
        problem = self.solution.need_problem("verify")
        return [shape for s in self.samples for shape in _list_control_variations(problem, s, self.scales)]

    @cached_property
    def end_and_parameter_variations(self) -> list[tuple[str, str, Array]]:
        """Variations "start", "times" or "parameters": kind, phase, step."""
        return _build_end_and_parameter_variations(self.solution, self.samples, self.scales)

    def find_second_order_cost_decrease(self) -> tuple[Worst, bool] | None:
        """Return the direction of the largest second-order decrease of the Lagrangian, and whether it is certain."""
        n, m = len(self.jumps), len(self.control_variations) + len(self.end_and_parameter_variations)
        slope_steps = SLOPE_STEP_SHARE * np.eye(n + m)
        values, violations = self.integrate_lagrangian_changes(np.hstack([slope_steps, -slope_steps]))
        if not np.all(np.isfinite(values)):
            return None
        slopes = 0.5 * (violations[:, : n + m] - violations[:, n + m :]) / SLOPE_STEP_SHARE
        # With unstable dynamics, full steps exceed the range of the second-order expansion.
        steps = 1 / np.maximum(1, np.max(np.abs(slopes), axis=0, initial=0.0) / MAX_CHANGE)
        slopes *= steps
        basis = steps[:, None] * _find_directions_keeping_end_conditions(slopes[:, :n], slopes[:, n:])
        if not np.any(basis[:n]):
            return None
        pairs = itertools.combinations(basis.T, 2)
        moves = np.array([*basis.T, *(a + b for a, b in pairs)]).T
        values, _ = self.integrate_lagrangian_changes(np.hstack([moves, -moves]))
        half = 0.5 * (values[: moves.shape[1]] + values[moves.shape[1] :])
        return self._compute_second_order_cost_decrease(*_draw_unit_directions(basis, half), steps)

    def _compute_second_order_cost_decrease(
        self, directions: Array, magnitudes: Array, steps: Array
    ) -> tuple[Worst, bool] | None:
        """Return the largest second-order decrease along directions (n_unknowns, n), the second half negative."""
        n = len(self.jumps)
        largest = np.max(np.abs(directions) / steps[:, None], axis=0)
        directions, magnitudes = directions / largest, magnitudes / largest**2
        count = directions.shape[1]
        values, violations = self.integrate_lagrangian_changes(np.hstack([directions, 0.5 * directions]))
        coarse, fine = -values[:count], -values[count:]
        ratio = np.divide(fine, coarse, out=np.zeros(count), where=coarse > 0)
        sizes = np.linalg.norm(violations, axis=0)
        valid = sizes[count:] <= 0.35 * sizes[:count] + 1e-9
        threshold = SMALL * np.maximum(COSTATE_MIN_SHARE_OF_COST * self.scales.cost, 0.25 * magnitudes)
        certain = (ratio >= DECREASE_RATIOS[0]) & (ratio <= DECREASE_RATIOS[1]) & valid & (fine > threshold)
        # Means of both signs have no first-order errors, so smaller decreases of second order are certain.
        mean, half = (0.5 * (v + np.roll(v, count // 2)) for v in (coarse, fine))
        quadratic = (np.abs(mean - 4 * half) <= 0.1 * mean) & valid & np.roll(valid, count // 2)
        quadratic &= half > EQUAL * max(self.scales.cost, abs(self.solution.objective))
        certain |= quadratic & (half > 0.25 * MINOR * magnitudes)
        possible = quadratic & (half > 0.25 * NEGLIGIBLE * magnitudes)
        if not np.any(certain | possible):
            return None
        best = int(np.argmax(np.where(certain if np.any(certain) else possible, coarse, 0.0)))
        largest_shifts, unit = np.argsort(-np.abs(directions[:n, best]))[:2], time_unit(self.solution)
        shifts = [
            f"phase {jump.phase}, {self.solution.phases[jump.phase].controls.labels[jump.channel]} at t = "
            f"{jump.time:.6g} {unit} by {amount * SHIFT_STEP_SHARE * jump.shorter_arc:+.2g} {unit}"
            for jump, amount in ((self.jumps[k], directions[k, best]) for k in largest_shifts)
            if abs(amount) > SMALL
        ]
        location = (
            f"switch of {', '.join(shifts)}"
            if shifts
            else "free initial states, times and parameters, no switch"
        )
        location += "" if certain[best] else ": the decrease may be an error of the multipliers"
        return Worst(float(coarse[best]) / self.scales.cost, location), bool(certain[best])

    def integrate_lagrangian_changes(self, amounts: Array) -> tuple[Array, Array]:
        """Return changes of L (n_columns,) and of active end conditions for amounts (n_unknowns, n_columns)."""
        count = amounts.shape[1] + 1
        # The last column is the reference trajectory with the same steps.
        amounts = np.hstack([amounts, np.zeros((amounts.shape[0], 1))])
        lagrangian, rows = np.zeros(count), []
        finals: dict[str, Array] = {}
        end_values: dict[str, list[Array]] = {}
        q = self.solution.parameter_values
        q = q[:, None] + self._sum_variations_of_quantity("parameters", "", amounts, q.size)
        for s in self.samples:
            phase, name = s.phase, s.phase.name
            initial_states = phase.x(phase.breaks[0])[:, None] + self._sum_variations_of_quantity(
                "start", name, amounts, phase.states.size
            )
            for later, by_end in self.scales.links.get(name, {}).items():
                if later in finals:
                    initial_states = initial_states + by_end @ (finals[later] - finals[later][:, -1:])
            shifted = self._shift_switching_times_of_phase(s, amounts, q)
            x, integrals, limit_terms, active_rows = shifted.integrate_phase(initial_states, self.scales.cost)
            rows += active_rows
            finals[name] = x
            lagrangian += limit_terms
            end_values[name] = [initial_states, x, *shifted.times[:, None], integrals, shifted.functions.p]
            gap = s.lam[:, -1] - self.ends.final_state[name]
            lagrangian += gap @ (x - x[:, -1:])
            radius = self.scales.phases[name].end.radius
            rows.append(_scale_changes_at_active_limits(x, phase.final_bounds, radius, s.state_scale))
        arguments = [value for name in self.solution.phases for value in end_values[name]]
        problem = self.solution.need_problem("verify")
        nu = np.zeros(self.solution.constraint_multipliers.size)
        values = evaluate_casadi_batch(get_endpoint_value_function(problem), count, *arguments, q, nu)
        psi, cost = values[:-1], problem.sense * values[-1]
        lagrangian += cost + self.solution.constraint_multipliers @ psi
        # Links of times are not reached by controls.
        changes = np.max(np.abs(psi - psi[:, -1:]), axis=1) / SHIFT_STEP_SHARE / np.max(np.abs(amounts))
        scales = np.sqrt(np.diag(self.scales.boundary[1.0].gramian))[: nu.size]
        box = problem.get_boundary_constraint_bounds()
        violations = np.vstack([*rows, _scale_changes_at_active_limits(psi, box, scales, changes)])
        return (lagrangian - lagrangian[-1])[:-1], violations[:, :-1]

    def _sum_variations_of_quantity(self, kind: str, phase: str, amounts: Array, size: int) -> Array:
        total = np.zeros((size, amounts.shape[1]))
        rows = amounts[len(self.jumps) + len(self.control_variations) :]
        for (*key, step), row in zip(self.end_and_parameter_variations, rows, strict=True):
            total += np.outer(step, row) if key == [kind, phase] else 0.0
        return total

    def _shift_switching_times_of_phase(self, s: PhaseSamples, amounts: Array, q: Array) -> _ShiftedPhase:
        """Return a phase for amounts (n_unknowns, n_columns) and free parameters (n, n_columns)."""
        name, problem = s.phase.name, self.solution.need_problem("verify")
        jumps = [
            (jump, jump.time + SHIFT_STEP_SHARE * jump.shorter_arc * shifts)
            for jump, shifts in zip(self.jumps, amounts, strict=False)
            if name in (jump.phase, jump.beyond)
        ]
        regular = zip(self.control_variations, amounts[len(self.jumps) :], strict=False)
        variations = [(t, shape, n) for (phase, t, shape), n in regular if phase == name and np.any(n)]
        functions = bind_parameters(problem, name, q, s.functions.weights) if q.size else s.functions
        times = s.phase.breaks[[0, -1], None] + self._sum_variations_of_quantity("times", name, amounts, 2)
        return _ShiftedPhase(problem, s, functions, jumps, variations, times)


@dataclass(frozen=True, eq=False)
class _ShiftedPhase:
    """Phase with shifted jumps and varied controls, one column for each set of amounts.

    ``jumps`` are control jumps with shifted times (n_columns,), ``variations`` times, control variations (m, n_times)
    and amounts (n_columns,), ``times`` (2, n_columns) start and end of the phase.
    """

    problem: Problem
    samples: PhaseSamples
    functions: PhaseFunctions
    jumps: list[tuple[Jump, Array]]
    variations: list[tuple[Array, Array, Array]]
    times: Array

    @cached_property
    def mesh_cell_edges(self) -> Array:
        """Mesh cell edges outside the windows around jumps, in which columns have different times."""
        cells = subdivide_mesh_segments(self.samples.phase.breaks)
        windows = [(np.min(times), np.max(times)) for times in self.times]
        for jump, _ in self.jumps:
            step = SHIFT_STEP_SHARE * jump.shorter_arc
            windows.append((jump.time - step, jump.time + step))
        in_window = np.any([(cells > first) & (cells < last) for first, last in windows], axis=0)
        return np.unique([*cells[~in_window], *np.clip(windows, cells[0], cells[-1]).ravel()])

    @cached_property
    def step_times(self) -> Array:
        """Ends of the integration steps (n_nodes, n_columns)."""
        fixed = [
            *self.mesh_cell_edges,
            *(jump.time for jump, _ in self.jumps),
            *find_costate_jumps(self.samples),
        ]
        rows = [np.full(self.times.shape[1], time) for time in fixed] + [shifted for _, shifted in self.jumps]
        return np.sort(np.clip([*rows, *self.times], *self.times), axis=0)

    @cached_property
    def steps_equal_in_all_columns(self) -> Array:
        """Return which steps are equal in all columns (n_steps,)."""
        is_common = np.all(self.step_times == self.step_times[:, :1], axis=1)
        return np.asarray(is_common[:-1] & is_common[1:])

    @cached_property
    def applied_controls(self) -> Array:
        """Applied controls at start, middle and end of the common steps (m, n_common, 3)."""
        first, last = (
            times[self.steps_equal_in_all_columns]
            for times in (self.step_times[:-1, 0], self.step_times[1:, 0])
        )
        edges = np.stack([first, 0.5 * (first + last), last], axis=1)
        values = _evaluate_applied_controls(self.samples.phase, edges.ravel(), np.repeat(edges[:, 1], 3))
        return values.reshape(-1, *edges.shape)

    def evaluate_shifted_controls(self, step: int) -> list[Array]:
        """Return the controls at start, middle and end of a step, (m, n_columns) each."""
        a, b = self.step_times[step], self.step_times[step + 1]
        middle = 0.5 * (a + b)
        index = int(np.count_nonzero(self.steps_equal_in_all_columns[:step]))
        controls = []
        for k, t in enumerate((a, middle, b)):
            if self.steps_equal_in_all_columns[step]:
                u = np.repeat(self.applied_controls[:, index, [k]], a.size, axis=1)
            else:
                u = _evaluate_applied_controls(self.samples.phase, t, middle)
            for jump, shifted in self.jumps:
                u[jump.channel, (middle > jump.time) & (middle < shifted)] = jump.before
                u[jump.channel, (middle < jump.time) & (middle > shifted)] = jump.after
            for times, shape, amounts in self.variations:
                u = u + amounts * np.stack([np.interp(t, times, row) for row in shape])
            controls.append(u)
        return controls

    @cached_property
    def _has_active_limits(self) -> bool:
        return bool(np.any(self.samples.mu)) or bool(np.any(self.samples.state_multiplier))

    def evaluate_rates(self, t: Array, y: Array, u: Array) -> Array:
        """Return the rates of states, integrals and the terms of active limits in the Lagrangian."""
        phase = self.samples.phase
        n, n_paths = phase.states.size, len(phase.path_labels)
        states = y[:n]
        values = self.functions.evaluate_rates_paths_and_integrands(t, states, u)
        limit_terms, t = np.zeros(t.size), np.clip(t, *phase.breaks[[0, -1]])
        if self._has_active_limits:
            limit_terms = np.sum(phase.path_multiplier(t) * values[n : n + n_paths], axis=0)
            limit_terms += np.sum(phase.state_multiplier(t) * states, axis=0)
        return np.concatenate([values[:n], values[n + n_paths :], limit_terms[None]])

    def integrate_phase(self, x: Array, cost: float) -> tuple[Array, Array, Array, list[Array]]:
        """Return the results of an integration from states (n, n_columns); the last column is the reference.

        Final states (n, n_columns), integrals (n_integrals, n_columns), contributions of active limits and costate
        jumps to the Lagrangian (n_columns,), and violations of active limits relative to the cost scale ``cost``.
        """
        phase, n = self.samples.phase, x.shape[0]
        y = np.concatenate([x, np.zeros((phase.integrals.size + 1, x.shape[1]))])
        limits = evaluate_active_limit_gradients(self.samples, self.mesh_cell_edges)
        jumps = find_costate_jumps(self.samples)
        states = {time: np.repeat(x[:, -1:], x.shape[1], axis=1) for time in {*limits, *jumps}}
        for k, (a, b) in enumerate(itertools.pairwise(self.step_times)):
            if np.array_equal(a, b):
                continue
            y = take_runge_kutta_step(self.evaluate_rates, a, b - a, y, self.evaluate_shifted_controls(k))
            for time in states.keys() & set(b.tolist()):
                states[time][:, b == time] = y[:n, b == time]
        touch_terms = [
            compute_touch_point_lagrangian(self.problem, self.samples, self.functions, t, jump, states[t])
            for t, jump in jumps.items()
        ]
        violations = [term / cost for term in touch_terms] + [
            gradient @ (states[t] - states[t][:, -1:]) for t, rows in limits.items() for gradient in rows
        ]
        return y[:n], y[n:-1], y[-1] + np.sum(touch_terms, axis=0), [row[None] for row in violations]


def _evaluate_applied_controls(phase: Any, t: Array, middle: Array) -> Array:
    offset = SAME_TIME * (phase.breaks[-1] - phase.breaks[0])
    shifted_times = np.where(t < middle, t + offset, np.where(t > middle, t - offset, t))
    return np.array(phase.applied(np.clip(shifted_times, phase.breaks[0], phase.breaks[-1])))


def _list_control_variations(
    problem: Problem, s: PhaseSamples, scales: Scales
) -> list[tuple[str, Array, Array]]:
    """Return variations of unconstrained controls that move the end of a phase in each of its directions."""
    phase, sizes = s.phase, scales.phases[s.phase.name]
    times, response = differentiate_final_state_by_controls(s)
    u = phase.applied(times)
    deviation = np.stack([np.interp(times, s.times, row) for row in sizes.deviation]) if u.shape[0] else u
    peak = np.max(sizes.deviation, axis=1)
    lower, upper = phase.control_bounds.is_near_limits(u, NOTABLE * peak)
    interior = ~(lower | upper)
    interior &= ~mask_controls_set_by_active_limits(problem, s, times)
    shapes = response * (deviation**2 * interior)
    variations = []
    for shape in shapes:
        largest = np.max(np.abs(shape) / np.maximum(peak, TINY)[:, None], initial=0.0)
        if 0 < largest < np.inf:  # the response of unstable dynamics may overflow
            variations.append((phase.name, times, SHIFT_STEP_SHARE * shape / largest))
    return variations


def _has_active_limits(s: PhaseSamples) -> bool:
    paths = s.functions.path_constraints(s.times, s.x, s.u)[:, [0, -1]]
    at_ends = np.logical_or(*s.phase.path_bounds.is_near_limits(paths, AT_LIMIT * s.path_scale))
    return bool(np.any(mask_limits_with_multipliers(s, s.times)) or np.any(at_ends[s.pure_state_constraints]))


def _build_end_and_parameter_variations(
    solution: Solution, samples: list[PhaseSamples], scales: Scales
) -> list[tuple[str, str, Array]]:
    """Return steps of free parameters, free initial states and free times that are not at limits."""
    box, sizes = solution.need_problem("verify").get_parameter_bounds(), scales.parameters
    steps = _list_free_variations("parameters", "", box, solution.parameter_values, np.diag(sizes), sizes)
    for s in samples:
        phase, name, spans = s.phase, s.phase.name, np.full(2, s.span)
        if _has_active_limits(s):
            continue  # with limits at fixed times, the curvature of touch points is missing
        radius = scales.phases[name].start.radius
        starts = (scales.links[name][""] * radius).T
        steps += _list_free_variations(
            "start", name, phase.initial_bounds, phase.x(phase.breaks[0]), starts, radius
        )
        if not np.any(phase.duration_bounds.is_near_limits(spans[:1], AT_LIMIT * spans[:1])):
            box = stack_intervals([phase.initial_time_bounds, phase.final_time_bounds])
            steps += _list_free_variations("times", name, box, phase.breaks[[0, -1]], np.diag(spans), spans)
    return steps


def _list_free_variations(
    kind: str, phase: str, bounds: Interval, values: Array, rows: Array, scale: Array
) -> list[tuple[str, str, Array]]:
    """Return steps along the rows (k, n) that change values (n,), none of which is at a limit."""
    at_limit = bounds.is_fixed | np.logical_or(*bounds.is_near_limits(values, AT_LIMIT * scale))
    chosen = [row for row in rows if np.any(row) and not np.any(row[at_limit])]
    return [(kind, phase, SHIFT_STEP_SHARE * row) for row in chosen]


def _scale_changes_at_active_limits(values: Array, bounds: Interval, scale: Array, unreached: Array) -> Array:
    """Return the changes of active values (n, n_columns) from the last column, in shares of their reach.

    Those without reach are in shares of ``unreached`` (n,).
    """
    size = np.maximum(np.where(scale > 0, scale, unreached), TINY)
    active = bounds.is_fixed | np.logical_or(*bounds.is_near_limits(values[:, -1], AT_LIMIT * size))
    return np.asarray((values - values[:, -1:])[active] / size[active, None])


def _find_directions_keeping_end_conditions(shifts: Array, other_shifts: Array) -> Array:
    """Return a basis (n_unknowns, d) that preserves the end conditions, from their slopes: jumps with their
    corrections, followed by directions without jumps."""
    inverse = np.linalg.pinv(other_shifts, rcond=NEGLIGIBLE)
    norms = np.maximum(np.linalg.norm(shifts, axis=0), NEGLIGIBLE)
    free = (
        _find_null_space((shifts - other_shifts @ (inverse @ shifts)) / norms, NOTABLE)
        / norms[:, None]
        * np.min(norms)
    )
    without_jumps = _find_null_space(other_shifts, RANK)
    zeros = np.zeros((free.shape[0], without_jumps.shape[1]))
    return np.block([[free, zeros], [-inverse @ shifts @ free, without_jumps]])


def _draw_unit_directions(basis: Array, half: Array) -> tuple[Array, Array]:
    """Return directions (n_unknowns, n) in the span of a basis, and the magnitudes of their terms (n,).

    ``half`` are half second differences of the Lagrangian along its unit vectors, and along the sums of all pairs.
    """
    d = basis.shape[1]
    pairs = list(itertools.combinations(range(d), 2))
    hessian = np.diag(2 * half[:d])
    for k, (i, j) in enumerate(pairs):
        hessian[i, j] = hessian[j, i] = half[d + k] - half[i] - half[j]
    diagonal = np.abs(np.diag(hessian))
    smallest = SMALL * np.max(diagonal)
    scale = np.sqrt(smallest / np.maximum(diagonal, smallest)) if smallest > 0 else np.ones(d)
    unit = np.eye(d)
    directions = [*unit, *(unit[i] + s * unit[j] for i, j in pairs for s in (1, -1))]
    vector = np.linalg.eigh(hessian * scale * scale[:, None])[1][:, 0]
    directions.append(vector / np.max(np.abs(vector)))
    chosen = scale[:, None] * np.array([*directions, *(-v for v in directions)]).T
    return basis @ chosen, diagonal @ chosen**2


def _find_null_space(rows: Array, threshold: float) -> Array:
    """Return an orthonormal basis (n, d) of the directions with relative changes of the rows below ``threshold``."""
    _, sizes, basis = np.linalg.svd(rows, full_matrices=True)
    rank = int(np.sum(sizes > threshold))
    return np.asarray(basis[rank:].T)
