"""hp refinement: iteration of solve, error estimate and mesh improvement until the error is within the tolerance.

Every solve starts from states, controls and multipliers of the previous one. Error estimate:
`gnc_opt.planning.refinement.collocation_error_estimate`. Smooth segments get the degree predicted by the decay of their
Legendre coefficients. Other segments are split at their kinks, or halved. See Liu, Hager & Rao, Journal of the Franklin
Institute 352 (2015), for the detection of discontinuities, and Patterson, Hager & Rao, Optimal Control Applications and
Methods 36 (2015), for the preference of degrees to segments.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.polynomial import legendre

from gnc_opt.array_types import Array, find_sign_changes
from gnc_opt.numerical_tolerances import INNER_TOLERANCE_SHARE, NEGLIGIBLE, NOTABLE, ROUNDING, SAME_TIME, TINY
from gnc_opt.planning.direct.computation_budget import WorkBudget
from gnc_opt.planning.direct.fixed_mesh_solve import WARM_MAX_ITERATIONS, solve_problem_on_mesh
from gnc_opt.planning.nlp import SolverOptions, Status
from gnc_opt.planning.nlp.nlp_solver_options import WARM_MU, compute_final_barrier_parameter
from gnc_opt.planning.problem.bounds import stack_intervals
from gnc_opt.planning.refinement.collocation_error_estimate import (
    PhaseError,
    estimate_segment_errors,
    print_iterations,
    record_iteration,
)
from gnc_opt.planning.solution.refinement_history import (
    Actions,
    History,
    RefinementIteration,
    RefinementStatus,
)
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh

STAGE_ERROR_SHARE = 1e-4
"""Target error of each pass, relative to the error of the previous one."""

NEAR_TOLERANCE_RATIO = 30.0
"""Ratio of target error to tolerance below which the tolerance is the target, which saves a further pass."""


@dataclass(frozen=True, eq=False)
class _MeshSolution:
    solution: Solution
    errors: dict[str, PhaseError]
    record: RefinementIteration

    @classmethod
    def from_solution(cls, solution: Solution, begin: float, actions: Actions) -> _MeshSolution:
        errors = estimate_segment_errors(solution)
        return cls(solution, errors, record_iteration(solution, begin, actions, errors))

    @property
    def largest_finite_error(self) -> float:
        """Largest error of the segments in which all functions are defined."""
        worst = np.concatenate([e.largest_segment_errors for e in self.errors.values()])
        return float(np.max(worst, initial=0.0, where=np.isfinite(worst)))


def refine_mesh(
    solution: Solution,
    *,
    tol: float = 1e-8,
    budget: WorkBudget | None = None,
    options: SolverOptions | None = None,
    progress: bool = False,
) -> tuple[Solution, History]:
    """Return the solution on a mesh on which every segment's error is at most ``tol``, and the history of the passes.

    If the tolerance is not reached, the solution has the smallest error of the objective; ``status`` and ``message`` of
    the history describe the result. Without a budget, work and time are unlimited.
    """
    begin = time.perf_counter()
    refinement = _Refinement(tol, budget or WorkBudget(), options)
    refinement.found.append(_MeshSolution.from_solution(solution, begin, Actions()))
    with print_iterations(solution.problem_name, tol, progress) as show:
        try:
            status = refinement.refine_mesh_until_converged(show)
        except KeyboardInterrupt:
            status = RefinementStatus.INTERRUPTED
    chosen = min(range(len(refinement.found)), key=refinement.rank_mesh_solution)
    best = refinement.found[chosen].record
    status = RefinementStatus.CONVERGED if best.solved and best.error <= tol else status
    message = f"{status.value}: error {best.error:.1e} (tolerance {tol:.1e})"
    message += "" if status is RefinementStatus.CONVERGED else f" at {best.where}. {status.remedy}"
    records, seconds = tuple(each.record for each in refinement.found), time.perf_counter() - begin
    return refinement.found[chosen].solution, History(status, tol, records, chosen, message, seconds)


@dataclass(frozen=True, eq=False)
class _Refinement:
    tol: float
    budget: WorkBudget
    options: SolverOptions | None
    found: list[_MeshSolution] = field(default_factory=list)

    def rank_mesh_solution(self, index: int) -> tuple[bool, float]:
        """Return the sort key: solutions within the tolerance first, then by the error of the objective."""
        solution, record = self.found[index].solution, self.found[index].record
        error = solution.objective_error.absolute_error if record.solved else np.inf
        return not record.solved or record.error > self.tol, error

    def refine_mesh_until_converged(self, show: Callable[[RefinementIteration], None]) -> RefinementStatus:
        """Solve on refined meshes until the error is small enough or a limit is reached; ``show`` gets each record."""
        show(self.found[-1].record)
        for _ in range(self.budget.max_passes):
            if time.perf_counter() > self.budget.deadline:
                return RefinementStatus.INTERRUPTED
            plan = self._plan_next_meshes()
            if isinstance(plan, RefinementStatus):
                return plan
            if self.budget.remaining_work <= 0:
                return RefinementStatus.BUDGET_LIMIT
            status = self._solve_on_refined_meshes(*plan)
            show(self.found[-1].record)
            if status is Status.ITERATION_LIMIT and self.budget.remaining_work <= 0:
                return RefinementStatus.BUDGET_LIMIT
            if not status.solved:
                interrupted = status is Status.INTERRUPTED
                return RefinementStatus.INTERRUPTED if interrupted else RefinementStatus.FAILED
        return RefinementStatus.ITERATION_LIMIT

    def _plan_next_meshes(self) -> tuple[dict[str, Mesh], Actions] | RefinementStatus:
        """Return the next meshes and the changes, or the final status.

        The target error decreases in stages, since small features of a trajectory that still changes are irrelevant. If
        the points do not suffice for a stage, they are assigned to the segments with the largest errors.
        """
        last = self.found[-1]
        if last.record.solved and last.record.error <= self.tol:
            return RefinementStatus.CONVERGED
        stage = max(self.tol, STAGE_ERROR_SHARE * min(last.largest_finite_error, 1.0))
        stage = stage if stage > NEAR_TOLERANCE_RATIO * self.tol else self.tol
        while True:
            planned = {name: build_next_mesh(error, stage) for name, error in last.errors.items()}
            meshes = {name: mesh for name, (mesh, _) in planned.items()}
            if max(mesh.size for mesh in meshes.values()) <= self.budget.max_points:
                break
            stage *= 10.0
            if stage > 0.5 * last.record.error:
                return RefinementStatus.POINT_LIMIT
        if meshes == last.record.meshes:
            return RefinementStatus.STALLED
        return meshes, sum((actions for _, actions in planned.values()), Actions())

    def _solve_on_refined_meshes(self, meshes: dict[str, Mesh], actions: Actions) -> Status:
        """Solve on new meshes with a warm start, then without one if that fails; record the pass."""
        begin, last = time.perf_counter(), self.found[-1].solution
        solution = solve_problem_on_mesh(
            last.need_problem("refine"),
            meshes,
            scheme=last.scheme,
            guess=last,
            options=self._choose_warm_start_options(),
            budget=self.budget.allot_work_budget_share(warm_iterations=WARM_MAX_ITERATIONS),
        )
        self.found.append(_MeshSolution.from_solution(solution, begin, actions))
        return solution.status

    def _choose_warm_start_options(self) -> SolverOptions:
        """Return the options with tolerance and barrier parameter adapted to the error of the solution."""
        options, error = self.options, min(self.found[-1].largest_finite_error, 1.0)
        if options is None:
            finest = min(SolverOptions.tolerance, INNER_TOLERANCE_SHARE * self.tol)
            options = SolverOptions(tolerance=max(finest, INNER_TOLERANCE_SHARE * STAGE_ERROR_SHARE * error))
        if options.mu_init is None:
            # A larger barrier parameter moves a nearly optimal point off its bounds and costs iterations.
            final = compute_final_barrier_parameter(options.tolerance)
            options = replace(options, mu_init=final if error <= NOTABLE else max(WARM_MU * error, final))
        return options


DECAY_RATE_MIN, DECAY_RATE_MAX = 0.02, 2.0
"""Range to which decay rates are clipped, decades per degree."""

SEGMENT_MAX_DEGREE, HALF_MAX_DEGREE = 20, 10
"""Largest degree of a segment, and of the halves of one."""

UNKNOWN_TRAJECTORY_ERROR = 1.0
"""Error above which kinks are not detected, since the trajectory is unknown."""

SMOOTHNESS_MIN_DEGREE = 5
"""Least number of coefficients for a test of smoothness; with fewer, the degree is increased first."""

SWITCH_ESTIMATE_ERROR_SHARE = 0.05
"""Largest error of a switch's estimated time, relative to its segment."""

KINK_ERROR_FACTOR = 2.0
"""Error of a kink's estimated time over the square of the length of its interval, both relative to the phase."""

SEGMENT_MAX_KINKS = 3
"""Largest number of kinks in one segment; more indicate chatter or noise."""


def build_next_mesh(error: PhaseError, tol: float) -> tuple[Mesh, Actions]:
    """Return the next mesh of a phase, with unchanged segments up to errors of ``tol``, and the numbers of changes."""
    phase, largest_errors, raised, split = error.samples.phase, error.largest_segment_errors, 0, 0
    decades = error.compute_required_error_reduction(INNER_TOLERANCE_SHARE * tol)
    added_points = np.ceil(decades / _fit_legendre_decay_rates(error))
    mu = find_active_constraint_multipliers(error)
    times, degrees = [float(phase.breaks[0])], list[int]()
    for k, degree in enumerate(phase.mesh.degrees):
        refined = [(float(phase.breaks[k + 1]), degree)]
        if largest_errors[k] > tol and phase.breaks[k + 1] - phase.breaks[k] >= SAME_TIME * phase.duration:
            refined = _refine_segment(error, k, mu, max(1, int(added_points[k])))
            raised, split = raised + (len(refined) == 1), split + (len(refined) > 1)
        times += [end for end, _ in refined]
        degrees += [degree for _, degree in refined]
    return Mesh.at_times(times, degrees), Actions(raised, split)


def _refine_segment(error: PhaseError, k: int, mu: Array, added_points: int) -> list[tuple[float, int]]:
    """Return ends (s) and degrees of the new segments in segment k, which otherwise needs ``added_points`` points.

    New segments with a kink have degree 3, adjacent ones at most 6, and halves at most `HALF_MAX_DEGREE`.
    """
    phase, largest_error = error.samples.phase, float(error.largest_segment_errors[k])
    degree, (left, right) = phase.mesh.degrees[k], map(float, phase.breaks[k : k + 2])
    kinks = find_kinks_in_segment(error, k, mu) if largest_error < UNKNOWN_TRAJECTORY_ERROR else []
    breaks = choose_mesh_breaks_around_kinks(error, k, kinks) if kinks else []
    if len(breaks) > 2:
        centres = [0.5 * (a + b) for a, b in itertools.pairwise(breaks)]
        has_kink = [any(kink.start <= t <= kink.end for kink in kinks) for t in centres]
        new_degrees = [3 if contains else min(degree, 6) for contains in has_kink]
        return list(zip(breaks[1:], new_degrees, strict=True))
    degree_needed = degree + added_points
    if degree < SMOOTHNESS_MIN_DEGREE and largest_error < NOTABLE:
        degree_needed = min(degree_needed, 2 * degree)
    if degree_needed <= SEGMENT_MAX_DEGREE:
        return [(right, min(degree_needed, 2 * degree + 2))]
    half_degree = min(degree, HALF_MAX_DEGREE)
    return [(0.5 * (left + right), half_degree), (right, half_degree)]


def _fit_legendre_decay_rates(error: PhaseError) -> Array:
    """Return the decay rates of the Legendre coefficients of rates, integrands and controls (K,), decades per degree.

    They are the rates of the envelopes (Liu, Hager & Rao, IEEE Transactions on Control Systems Technology 26, 2018).
    """
    s, phase, functions = error.samples, error.samples.phase, error.samples.functions
    signals = np.concatenate(
        [
            functions.state_rates(*phase.point_trajectory) / s.state_scale[:, None],
            functions.integrands(*phase.point_trajectory) / error.integral_scale[:, None],
            np.hstack(phase.u.values) / s.control_scale[:, None] / phase.duration,
        ]
    )
    pieces = np.split(signals, phase.mesh.point_offsets[1:-1], axis=1)
    rules = phase.collocation_rules
    return np.array([_fit_decay_rate_of_segment(v, r.points) for v, r in zip(pieces, rules, strict=True)])


def _fit_decay_rate_of_segment(values: Array, tau: Array) -> float:
    n = tau.size
    if n < 3 or not np.all(np.isfinite(values)):
        return DECAY_RATE_MIN
    coefficients = np.abs(np.linalg.solve(legendre.legvander(tau, n - 1), values.T))
    sizes = np.max(coefficients, axis=1)
    envelope = np.maximum.accumulate(sizes[::-1])[::-1][1 if n > 5 else 0 :]
    floor = ROUNDING * max(float(np.max(sizes)), TINY)
    resolved = envelope[: max(2, int(np.searchsorted(-envelope, -floor)))]
    slope = np.polyfit(np.arange(resolved.size), np.log10(np.maximum(resolved, floor)), 1)[0]
    return float(np.clip(-slope, DECAY_RATE_MIN, DECAY_RATE_MAX))


@dataclass(frozen=True)
class Kink:
    """Time interval that contains a kink or a jump of the trajectory."""

    start: float
    end: float


def find_kinks_in_segment(error: PhaseError, k: int, mu: Array) -> list[Kink]:
    """Return the ordered, disjoint kinks in segment k; none if they cannot be distinguished from noise.

    ``mu`` (rows, N) are the `find_active_constraint_multipliers` of the phase.
    """
    kinks = _find_control_switches(error, k) or _find_active_constraint_kinks(error, k, mu)
    merged: list[Kink] = []
    for kink in sorted(kinks, key=lambda kink: kink.start):
        if merged and kink.start <= merged[-1].end:
            merged[-1] = Kink(merged[-1].start, max(kink.end, merged[-1].end))
        else:
            merged.append(kink)
    return merged if len(merged) <= SEGMENT_MAX_KINKS else []


def _find_control_switches(error: PhaseError, k: int) -> list[Kink]:
    """Return the zeros of dH/du with a control on its bound: it leaves the bound, or jumps to the other one."""
    samples = error.samples
    phase, bounds = samples.phase, samples.phase.control_bounds
    in_segment = np.flatnonzero(samples.segments == k)
    times = samples.times[in_segment]
    margin = SWITCH_ESTIMATE_ERROR_SHARE * (times[-1] - times[0])
    kinks, gradient = list[Kink](), samples.functions.control_gradient
    for i in range(phase.controls.size):
        scale = samples.control_scale[i]
        for bound in {float(bounds.lower[i]), float(bounds.upper[i])}:
            if np.min(np.abs(samples.u_polynomial[i, in_segment] - bound)) < 0.1 * scale:
                u = phase.applied.evaluate_clipped_polynomial(times)
                u[i] = bound
                slopes = gradient(times, phase.x(times), u, phase.lam(times), phase.path_multiplier(times))[i]
                values = slopes * (scale / samples.hamiltonian_scale)
                if np.max(values) > NEGLIGIBLE and np.min(values) < -NEGLIGIBLE:
                    crossings = find_sign_changes(values)
                    fraction = values[crossings] / (values[crossings] - values[crossings + 1])
                    roots = times[crossings] + fraction * (times[crossings + 1] - times[crossings])
                    kinks += [Kink(float(t - margin), float(t + margin)) for t in roots]
    return kinks


def _find_active_constraint_kinks(error: PhaseError, k: int, mu: Array) -> list[Kink]:
    """Return kinks between neighbouring points at which bounds or path constraints become active or inactive."""
    phase = error.samples.phase
    points, offsets = phase.point_times, phase.mesh.point_offsets
    first, last = max(offsets[k] - 1, 0), min(offsets[k + 1], points.size - 1)
    left, right = float(phase.breaks[k]), float(phase.breaks[k + 1])
    kinks = []
    for row in mu[:, first : last + 1]:
        times = points[first : last + 1]
        for j in np.flatnonzero(np.sign(row[1:]) != np.sign(row[:-1])):
            start, end = _bracket_activation_time(times, row, int(j), phase.duration)
            kinks.append(Kink(max(start, left), min(end, right)))
    return [kink for kink in kinks if kink.end > kink.start]


def _bracket_activation_time(times: Array, mu: Array, j: int, duration: float) -> tuple[float, float]:
    """Return the times between which a constraint multiplier ``mu`` starts, ends or changes sign, after point j."""
    start, end = float(times[j]), float(times[j + 1])
    brackets = [(a, b) for a, b in ((j, j + 1), (j - 1, j + 1), (j, j + 2)) if a >= 0 and b < times.size]
    brackets = [(a, b) for a, b in brackets if mu[a] * mu[b] < 0]
    if brackets:
        a, b = brackets[0]
        start, end = float(times[a]), float(times[b])
    else:
        a, b = (j - 1, j) if mu[j + 1] == 0 else (j + 1, j + 2)
        if a < 0 or b >= times.size or mu[a] * mu[b] <= 0 or mu[a] == mu[b]:
            return start, end
    zero = float(times[a] - mu[a] * (times[b] - times[a]) / (mu[b] - mu[a]))
    margin = min(SWITCH_ESTIMATE_ERROR_SHARE, KINK_ERROR_FACTOR * (end - start) / duration) * (end - start)
    return (max(start, zero - margin), min(end, zero + margin)) if start < zero < end else (start, end)


def find_active_constraint_multipliers(error: PhaseError) -> Array:
    """Return the multipliers of active bounds and path constraints at the points, (rows, N), relative to H."""
    s, phase = error.samples, error.samples.phase
    times, x, u = phase.point_trajectory
    values = np.vstack([x, u, s.functions.path_constraints(times, x, u)])
    limits = stack_intervals([phase.state_bounds, phase.control_bounds, phase.path_bounds])
    multipliers = np.vstack([phase.state_multipliers, phase.control_multipliers, phase.path_multipliers])
    scale = np.concatenate([s.state_scale, s.control_scale, error.path_scale])[:, None]
    distance = np.minimum(values - limits.lower[:, None], limits.upper[:, None] - values)
    scaled = multipliers * scale / s.hamiltonian_scale
    is_inequality = (limits.lower < limits.upper)[:, None]
    return np.where(is_inequality & (np.abs(scaled) > np.maximum(distance / scale, NEGLIGIBLE)), scaled, 0.0)


def choose_mesh_breaks_around_kinks(error: PhaseError, k: int, kinks: list[Kink]) -> list[float]:
    """Return boundaries that enclose the kinks of segment k or coincide with them, including its own ends.

    If a kink is not located within half the segment, the largest excess of a limit is a boundary, too.
    """
    phase = error.samples.phase
    left, right = float(phase.breaks[k]), float(phase.breaks[k + 1])
    shortest = min(0.02 * (right - left), 0.5 * min(kink.end - kink.start for kink in kinks))
    shortest = max(shortest, SAME_TIME * phase.duration)
    breaks, edges = [left], list[float]()
    for kink in kinks:
        is_wide = kink.end - kink.start > NEGLIGIBLE * phase.duration
        edges += [kink.start, kink.end] if is_wide else [0.5 * (kink.start + kink.end)]
    if max(kink.end - kink.start for kink in kinks) > 0.5 * (right - left):
        edges += _locate_largest_violation(error, k)
    for edge in sorted(edges):
        if edge - breaks[-1] > shortest and right - edge > shortest:
            breaks.append(edge)
    return [*breaks, right]


def _locate_largest_violation(error: PhaseError, k: int) -> list[float]:
    """Return the time of the largest excess of states and path constraints in segment k, if it dominates the errors."""
    s, phase, in_segment = error.samples, error.samples.phase, error.samples.segments == k
    paths = s.functions.path_constraints(s.times[in_segment], s.x[:, in_segment], s.u[:, in_segment])
    of_states = phase.state_bounds.compute_bound_violation(s.x[:, in_segment]) / s.state_scale[:, None]
    of_paths = phase.path_bounds.compute_bound_violation(paths) / error.path_scale[:, None]
    excess = np.max(np.vstack([of_states, of_paths]), axis=0)
    dominates = 2.0 * np.max(excess) > error.largest_segment_errors[k]
    return [float(s.times[in_segment][np.argmax(excess)])] if dominates else []
