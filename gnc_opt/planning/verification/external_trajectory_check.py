"""verify_trajectory: optimality check of a trajectory from another tool.

Samples of reformulated problems are converted to the solved controls: parts, magnitudes and directions.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.argument_checks import read_float_array, require_type
from gnc_opt.array_types import Array
from gnc_opt.errors import ProblemError, unknown_name_error
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_batch
from gnc_opt.model.model_variables import Layout
from gnc_opt.model.split_and_magnitude_direction_controls import VectorControl
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.numerical_tolerances import ACTIVE, AT_LIMIT, EQUAL, SAME_TIME, SMALL
from gnc_opt.planning.nlp.nlp_solver_status import Status
from gnc_opt.planning.optimality.multiplier_estimate import estimate_multipliers
from gnc_opt.planning.optimality.trajectory_interpolation import (
    FittedPhase,
    SampledPhase,
    fit_trajectory_polynomials,
)
from gnc_opt.planning.problem.active_constraint_arcs import Arc, ArcKind
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.problem_check import check_unused_controls
from gnc_opt.planning.problem.reformulation import reformulate_problem
from gnc_opt.planning.solution.defects_and_violations import compute_dynamics_residual
from gnc_opt.planning.solution.optimality_verdict import FIRST_ORDER, Condition, ConditionResult, Verdict
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial
from gnc_opt.planning.solution.refinement_history import Statistics
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_from_nlp_result import (
    bind_parameters,
    build_phase_solutions,
    read_phase_parameters,
    unwrap_angles,
)
from gnc_opt.planning.solution.state_and_control_scales import take_largest_variable_component
from gnc_opt.planning.transcription.collocation_families import GAUSS
from gnc_opt.planning.transcription.transcription import transcribe_problem
from gnc_opt.planning.verification.optimality_check import CONDITION_TOLERANCE, verify
from gnc_opt.threads_and_package_versions import limit_to_one_thread


def reformulate_sampled_phase(problem: Problem, phase: Phase, given: SampledPhase, q: Array) -> SampledPhase:
    """Return the samples in the variables of a reformulated phase; q are the first parameters of its problem."""
    given_model = phase.model if phase.control_map is None else phase.control_map.model
    given = _reorder_sampled_variables(given, problem.phases[phase.name].model, given_model)
    if phase.control_map is None:
        return given
    arguments = [*given_model.symbolic_arguments(), problem.parameter_symbols()]
    values = ca.densify(problem.substitute_parameters(phase, phase.control_map.values))
    function = ca.Function("restated", arguments, [values])
    p = read_phase_parameters(problem, problem.phases[phase.name], q)
    with np.errstate(invalid="ignore", divide="ignore"):
        u = evaluate_casadi_batch(function, given.t.size, given.t[None], given.x, given.u, p, q)
    controls = phase.model.controls
    for vector in phase.vector_controls:
        direction = controls.slice(vector.direction)
        u[direction] = _fill_directions_of_zero_vectors(u[controls.slice(vector.magnitude)][0], u[direction])
    return replace(given, u=u)


def _reorder_sampled_variables(samples: SampledPhase, old_model: Model, new_model: Model) -> SampledPhase:
    """Return samples of a model with the same variables, some of which are states instead of controls."""
    if old_model.states.names == new_model.states.names:
        return samples
    by_name = {name: samples.x[old_model.states.slice(name)] for name in old_model.states.names}
    by_name |= {name: samples.u[old_model.controls.slice(name)] for name in old_model.controls.names}
    empty, kinds = np.zeros((0, samples.t.size)), (new_model.states, new_model.controls)
    return SampledPhase(samples.t, *(np.vstack([empty, *(by_name[n] for n in kind.names)]) for kind in kinds))


def _fill_directions_of_zero_vectors(size: Array, direction: Array) -> Array:
    """Return directions (n, n_times) of vectors of a size (n_times,); at size zero the previous (first: next) one."""
    valid = np.flatnonzero((size > AT_LIMIT * np.max(size)) & np.all(np.isfinite(direction), axis=0))
    if not valid.size:
        return np.repeat(np.eye(len(direction))[:, :1], direction.shape[1], axis=1)
    last_valid = np.searchsorted(valid, np.arange(direction.shape[1]), side="right") - 1
    return np.asarray(direction[:, valid[np.maximum(last_valid, 0)]])


MAX_INTERVAL_PARTS = 4
"""Largest number of parts into which sampling intervals are divided, by halving, until the adjoint equation holds;
costates may change faster than states."""

INTERPOLATION_MIN_GROWTH, MAX_HALVINGS, MIN_SAMPLES = 4.0, 5, 8
"""A failure is due to interpolation if it grows by the first number without every second sample, and if the second
number of halvings of the steps would remove it; third: smallest number of samples of a phase for this test."""

SMALLER_DISTANCES = 1e-7, 1e-9
"""Distances, relative to the scales of limits, below which limits are active; tried in turn for feasible trajectories
that are not minima with the default one: samples near limits are closer, and would have multipliers."""

Values = Any
"""Arrays (n, n_times) in the order of the model, or a mapping from names; for several phases a mapping of these."""


@limit_to_one_thread()
def verify_trajectory(
    problem: Problem, t: Values, x: Values, u: Values, p: Values = None, *, tol: float = CONDITION_TOLERANCE
) -> Verdict:
    """Return the verdict on a sampled trajectory of any tool, without multipliers, with all conditions of `verify`.

    Costs with kinks or norms are checked in the controls that `solve` uses: parts, magnitudes and directions.

    Costates and multipliers of the interpolated samples (module `trajectory_interpolation`) are estimated by least
    squares (module `multiplier_estimate`). If none satisfy adjoint equation and transversality, a condition fails.

    Parameters
    ----------
    problem : Problem
    t : array (n_times,), s
        Ascending; at a control jump, repeat the time with the values before and after it. A jump between two samples is
        located from the states. For several phases: a mapping from their names.
    x, u : array (n_states, n_times), (n_controls, n_times), or a mapping from names to (n_times,) or (size, n_times)
        States and controls; split and vector controls by their own name or by those of their parts. For several phases:
        a mapping from their names.
    p : array (n_parameters,) or mapping from names, optional
        Values of the problem's free parameters; required if it has any.
    tol : float
        Tolerance of every condition. Its lower limit is the interpolation error, of fourth order in the sampling
        interval.

    Returns
    -------
    Verdict
        With ``estimated`` true: multipliers are estimates; if they are not unique, a sign may be wrong.

    Raises
    ------
    ProblemError
        Wrong sizes, missing or unknown names, decreasing times, non-finite numbers, or a control without effect.

    Examples
    --------
    >>> import numpy as np
    >>> import gnc_opt as go
    >>> cart = go.Model("cart")
    >>> q, v, a = cart.state("q"), cart.state("v"), cart.control("a")
    >>> cart.ode({q: v, v: a})
    >>> problem = go.Problem("rest to rest")
    >>> leg = problem.phase("leg", cart)
    >>> leg.time(0.0, 1.0)
    >>> leg.initial(q=0.0, v=0.0)
    >>> leg.final(q=1.0, v=0.0)
    >>> problem.minimize(leg.integral(a**2))
    >>> t = np.linspace(0.0, 1.0, 41)
    >>> x = {"q": 3 * t**2 - 2 * t**3, "v": 6 * t - 6 * t**2}
    >>> go.verify_trajectory(problem, t, x, {"a": 6 - 12 * t}).ok
    True
    """
    require_type(problem, Problem, "the first argument of verify_trajectory()", "give problem, t, x and u")
    q = _read_free_parameters(problem, p)
    check_unused_controls(problem)
    samples = _unwrap_sampled_angles(problem, _read_sampled_phases(problem, t, x, u), q)
    verdict, solved = _check_sampled_trajectory(problem, samples, q, tol), reformulate_problem(problem)
    if verdict.minimum or solved is problem or _do_angles_exceed_full_turn(problem, solved, samples):
        return verdict
    restated = {
        name: reformulate_sampled_phase(problem, solved.phases[name], s, q) for name, s in samples.items()
    }
    q = _append_epigraph_parameters(solved, restated, q)
    second = _check_sampled_trajectory(solved, _unwrap_sampled_angles(solved, restated, q), q, tol)
    prefers_stated = (verdict.failed and second.failed) or (verdict.ok and not second.minimum)
    return verdict if prefers_stated else second


def _check_sampled_trajectory(
    problem: Problem, samples: Mapping[str, SampledPhase], q: Array, tol: float
) -> Verdict:
    verdict = verify(_build_sampled_solution(problem, samples, q), tol=tol)
    feasible = all(c not in verdict.failed for c in verdict.condition_groups["feasible"])
    for distance in SMALLER_DISTANCES if feasible and not verdict.minimum else ():
        retry = verify(_build_sampled_solution(problem, samples, q, distance=distance), tol=tol)
        if retry.minimum or (verdict.failed and not retry.failed):
            return replace(retry, estimated=True)
    parts = 1
    while verdict["stationarity"].result is ConditionResult.FAIL and parts < MAX_INTERVAL_PARTS:
        parts *= 2
        verdict = verify(_build_sampled_solution(problem, samples, q, parts), tol=tol)
    verdict = _mark_interpolation_errors_inconclusive(verdict, problem, samples, q, tol, parts)
    return replace(verdict, estimated=True)


def _mark_interpolation_errors_inconclusive(
    verdict: Verdict, problem: Problem, samples: Mapping[str, SampledPhase], q: Array, tol: float, parts: int
) -> Verdict:
    """Return the verdict with failures as inconclusive that denser or more accurate samples would remove.

    Such failures grow if every second sample is omitted, or are defects that cancel between times given twice.
    """
    failed = [c for c in verdict.failed if c.name in FIRST_ORDER]
    dense = {name: phase for name, phase in samples.items() if phase.t.size >= 2 * MIN_SAMPLES}
    if not failed or not dense:
        return verdict
    thinned = {**samples, **{name: _remove_every_second_sample(phase) for name, phase in dense.items()}}
    coarse = verify(_build_sampled_solution(problem, thinned, q, parts), tol=tol)
    remaining = [c for c in failed if not _is_failure_due_to_interpolation(c, coarse[c.name].value / c.value)]
    is_small = all(c.name == "dynamics" and c.value <= np.sqrt(tol) for c in remaining)
    if remaining and not (is_small and _do_defects_cancel_between_repeated_times(problem, samples, q, parts)):
        return verdict
    note = "the samples are too coarse, or inaccurate inside segments: give denser or more accurate ones"
    conditions = tuple(
        replace(c, result=ConditionResult.INCONCLUSIVE, where=f"{c.where}; {note}") if c in failed else c
        for c in verdict.conditions
    )
    return replace(verdict, conditions=conditions)


def _do_defects_cancel_between_repeated_times(
    problem: Problem, samples: Mapping[str, SampledPhase], q: Array, parts: int
) -> bool:
    """Return whether defects affect the cost less at times given twice, the ends of segments of another tool."""
    largest = at_ends = 0.0
    for name, s in _build_sampled_solution(problem, samples, q, parts).samples().items():
        defects = np.sum(s.lam * compute_dynamics_residual(s, s.u), axis=0)
        sums, t = np.abs(np.cumsum(s.integrate_over_segments(defects))), samples[name].t
        ends = np.isin(s.phase.breaks[1:], t[1:][np.diff(t) == 0])
        largest = max(largest, float(np.max(sums)))
        at_ends = max(at_ends, float(np.max(sums[ends] if np.any(ends) else sums)))
    return INTERPOLATION_MIN_GROWTH * at_ends <= largest


def _is_failure_due_to_interpolation(failed: Condition, growth: float) -> bool:
    """Return whether an error grows enough if every second sample is omitted; defects, being integrals, always grow."""
    is_growing = INTERPOLATION_MIN_GROWTH <= growth < np.inf or failed.name == "dynamics"
    return is_growing and failed.value <= failed.tolerance * growth**MAX_HALVINGS


def _remove_every_second_sample(samples: SampledPhase) -> SampledPhase:
    t = samples.t
    is_repeated = np.append(np.diff(t) == 0, False)
    is_kept = np.arange(t.size) % 2 == 0
    is_kept |= is_repeated | np.roll(is_repeated, 1)
    is_kept[[0, -1]] = True
    return SampledPhase(t[is_kept], samples.x[:, is_kept], samples.u[:, is_kept])


def _do_angles_exceed_full_turn(problem: Problem, other: Problem, given: Mapping[str, SampledPhase]) -> bool:
    """Return whether angles exceed bounds of a full turn, which the reformulated problem does not have."""
    for name, phase in other.phases.items():
        if phase.numbers.turns is not None:
            bounds, u = problem.phases[name].numbers.controls, given[name].u
            slack = AT_LIMIT * phase.numbers.turns.periods
            if np.any(u < (bounds.lower - slack)[:, None]) or np.any(u > (bounds.upper + slack)[:, None]):
                return True
    return False


def _append_epigraph_parameters(problem: Problem, samples: Mapping[str, SampledPhase], q: Array) -> Array:
    """Return the parameters, followed by those that replace kinks at the ends, as small as their constraints allow."""
    names = [name for name in problem.parameters.names if not problem.parameters.slice(name).start < q.size]
    if not names:
        return q
    zeros = np.append(q, np.zeros(len(names)))
    q, at_zero = zeros.copy(), _build_sampled_solution(problem, samples, zeros)
    values = dict(zip(at_zero.constraint_labels, at_zero.constraint_values, strict=True))
    for name in names:
        required, raised = [-values[label] for label in problem.constraints[name].labels], zeros.copy()
        rows_of_parameter = problem.parameters.slice(name)
        raised[rows_of_parameter] = max(*required, float(problem.parameter_bounds[name].lower[0]))
        change = abs(_build_sampled_solution(problem, samples, raised).objective - at_zero.objective)
        if change > EQUAL * abs(at_zero.objective):  # otherwise rounding on the kink
            q[rows_of_parameter] = raised[rows_of_parameter]
    return q


def _build_sampled_solution(
    problem: Problem, samples: Mapping[str, SampledPhase], q: Array, parts: int = 1, distance: float = ACTIVE
) -> Solution:
    fitted = {}
    for name, phase in problem.phases.items():
        magnitude = np.max(np.abs(samples[name].u), axis=1)
        smallest = EQUAL * take_largest_variable_component(magnitude, phase.model.controls)
        rates = bind_parameters(problem, name, q).state_rates
        fitted[name] = fit_trajectory_polynomials(samples[name], rates, smallest).split_mesh_segments(parts)
    transcription = transcribe_problem(problem, {name: fit.mesh for name, fit in fitted.items()}, GAUSS)
    iterate = estimate_multipliers(transcription, problem, fitted, q, distance)
    phases, gradients = build_phase_solutions(transcription, problem, iterate)
    phases = {name: _replace_phase_trajectory(phase, fitted[name]) for name, phase in phases.items()}
    return Solution(
        problem_name=problem.name,
        status=Status.ACCEPTABLE,
        objective=gradients.cost,
        maximised=problem.sense < 0,
        phases=phases,
        free_parameters=problem.parameters,
        parameter_values=q,
        parameter_multipliers=iterate.lam_x[transcription.parameter_indices],
        constraint_labels=problem.constraint_labels(),
        constraint_values=gradients.constraints,
        constraint_multipliers=iterate.lam_g[transcription.constraint_rows],
        violations=(),
        statistics=Statistics(0, 0.0, 0.0, 0.0, 0.0),
        provenance={"fingerprint": problem.fingerprint()},
        structure=tuple(arc for phase in phases.values() for arc in _find_arcs_at_control_bounds(phase)),
        problem=problem.frozen(),
    )


def _replace_phase_trajectory(phase: PhaseSolution, fit: FittedPhase) -> PhaseSolution:
    """Return the phase with the trajectory and times of the samples, even if the problem has others."""
    breaks = fit.x.breaks
    return replace(
        phase,
        mesh=fit.mesh,
        x=fit.x,
        u=fit.u,
        lam=PiecewisePolynomial(breaks, phase.lam.nodes, phase.lam.values),
        initial_time=float(breaks[0]),
        final_time=float(breaks[-1]),
    )


def _unwrap_sampled_angles(
    problem: Problem, samples: Mapping[str, SampledPhase], q: Array
) -> dict[str, SampledPhase]:
    unwrapped = {}
    for name, phase in samples.items():
        bounds = problem.phases[name].numbers.controls
        controls = unwrap_angles(bind_parameters(problem, name, q), bounds, phase.t, phase.x, phase.u)
        unwrapped[name] = replace(phase, u=controls)
    return unwrapped


def _find_arcs_at_control_bounds(phase: PhaseSolution) -> list[Arc]:
    """Return the arcs of controls at a bound at all times, between their jumps; none if a control is interior."""
    arcs: list[Arc] = []
    breaks = phase.breaks[list(phase.mesh.arc_breaks)]
    slack = AT_LIMIT * np.maximum(1.0, np.max(np.abs(phase.u(phase.point_times)), axis=1))
    for i, label in enumerate(phase.controls.labels):
        lower, upper = phase.control_bounds.is_near_limits(phase.u(phase.point_times), slack)
        for start, end in itertools.pairwise(breaks):
            inside = (phase.point_times > start) & (phase.point_times < end)
            kinds = {ArcKind.LOWER: lower[i, inside], ArcKind.UPPER: upper[i, inside]}
            kind = next((k for k, at_bound in kinds.items() if np.all(at_bound)), None)
            if kind is None:
                return []
            if arcs and arcs[-1].channel == label and arcs[-1].kind is kind:
                arcs[-1] = replace(arcs[-1], end=float(end))
            else:
                arcs.append(Arc(phase.name, label, kind, float(start), float(end)))
    return arcs if phase.mesh.movable else []


def _read_sampled_phases(problem: Problem, t: Values, x: Values, u: Values) -> dict[str, SampledPhase]:
    names = list(problem.phases)
    if len(names) == 1 and not isinstance(t, Mapping):
        t, x, u = ({names[0]: value} for value in (t, x, u))
    for what, values in (("times", t), ("states", x), ("controls", u)):
        if not isinstance(values, Mapping):
            raise ProblemError(
                f"the {what} of a trajectory of '{problem.name}' must be a mapping from the phases {names}, "
                "since there are several."
            )
        for name in values:
            if name not in names:
                raise unknown_name_error("phase", name, f"problem '{problem.name}'", names)
        missing = [name for name in names if name not in values]
        if missing:
            raise ProblemError(f"the {what} of phase '{missing[0]}' are missing: give them for every phase.")
    return {
        name: _read_sampled_phase(phase, t[name], x[name], u[name]) for name, phase in problem.phases.items()
    }


def _read_sampled_phase(phase: Phase, t: Values, x: Values, u: Values) -> SampledPhase:
    what = f"the times of {phase.label}"
    times = _require_finite_sample(read_float_array(t, what, ProblemError), what)
    if times.ndim != 1 or times.size < 2 or times[0] == times[-1]:
        raise ProblemError(f"{what} have shape {times.shape}: give a vector of two or more.")
    steps = np.diff(times)
    if np.any(steps < 0):
        i = int(np.argmax(steps < 0))
        raise ProblemError(f"{what} decrease from {times[i]:g} to {times[i + 1]:g} s: sort the samples.")
    if np.any((steps[:-1] == 0) & (steps[1:] == 0)) or steps[0] == 0 or steps[-1] == 0:
        raise ProblemError(
            f"{what} repeat one more than twice, or at an end: give a time twice only where a control jumps."
        )
    states = _read_sampled_variables(phase, phase.model.states, x, times.size, "state")
    u = _split_vector_controls(phase, u, times.size)
    controls = _read_sampled_variables(phase, phase.model.controls, u, times.size, "control")
    return _remove_duplicate_samples(SampledPhase(times, states, controls))


def _remove_duplicate_samples(samples: SampledPhase) -> SampledPhase:
    t, u = samples.t, samples.u
    is_close = (np.diff(t) > 0) & (np.diff(t) <= SAME_TIME * (t[-1] - t[0]))
    jumps = np.any(np.abs(np.diff(u, axis=1)) > SMALL * np.ptp(u, axis=1, keepdims=True), axis=0)
    is_kept = np.append(True, ~(is_close & ~jumps))
    times = t.copy()
    times[1:][is_close & jumps] = t[:-1][is_close & jumps]
    return SampledPhase(times[is_kept], samples.x[:, is_kept], u[:, is_kept])


def _split_vector_controls(phase: Phase, u: Values, n_times: int) -> Values:
    """Return controls by name; composed controls as their parts, or as magnitude and direction."""
    if not isinstance(u, Mapping):
        return u
    controls = dict(u)
    for control in phase.model.composed_controls.values():
        if control.name in controls:
            shape, what = (control.variable.size, n_times), f"control '{control.name}' of {phase.label}"
            parts = control.decompose_control(_read_finite_array(controls.pop(control.name), shape, what))
            if isinstance(control, VectorControl):
                parts = parts[0], _fill_directions_of_zero_vectors(parts[0][0], parts[1])
            controls |= zip(control.parts, parts, strict=True)
    return controls


def _read_sampled_variables(phase: Phase, layout: Layout, values: Values, n_times: int, kind: str) -> Array:
    what = f"the {kind}s of {phase.label}"
    if isinstance(values, Mapping):
        for name in values:
            if name not in layout:
                raise unknown_name_error(kind, name, phase.label, layout.names)
        missing = [name for name in layout.names if name not in values]
        if missing:
            raise ProblemError(f"{kind} '{missing[0]}' of {phase.label} is missing: give its samples.")
        rows = [np.zeros((0, n_times))]
        for name in layout.names:
            shape, what = (layout[name].size, n_times), f"{kind} '{name}' of {phase.label}"
            rows.append(_read_finite_array(values[name], shape, what))
        return np.vstack(rows)
    return _read_finite_array(values, (layout.size, n_times), what)


def _read_finite_array(value: Values, shape: tuple[int, int], what: str) -> Array:
    array = read_float_array(value, what, ProblemError)
    if shape[0] == 0 and array.size == 0:
        return np.zeros(shape)
    if shape[0] == 1 and array.shape == shape[1:]:
        array = array[None, :]
    if array.shape != shape:
        raise ProblemError(f"{what} has shape {array.shape} where {shape} is needed: one column per time.")
    return _require_finite_sample(array, what)


def _require_finite_sample(array: Array, what: str) -> Array:
    if not np.all(np.isfinite(array)):
        raise ProblemError(f"{what}: not every number is finite; give a complete trajectory.")
    return array


def _read_free_parameters(problem: Problem, p: Values) -> Array:
    layout, what = problem.parameters, f"the free parameters of '{problem.name}'"
    p = {} if p is None else p
    if isinstance(p, Mapping):
        for name in p:
            if name not in layout:
                raise unknown_name_error("free parameter", name, f"problem '{problem.name}'", layout.names)
        values = layout.stack(p)
        missing = [label for label, value in zip(layout.labels, values, strict=True) if np.isnan(value)]
        if missing:
            raise ProblemError(
                f"free parameter '{missing[0]}' of '{problem.name}' is missing: give its value."
            )
        return _require_finite_sample(values, what)
    values = read_float_array(p, what, ProblemError).ravel()
    if values.size != layout.size:
        raise ProblemError(
            f"{what} are given {values.size} values: give {layout.size}, for {list(layout.names)}."
        )
    return _require_finite_sample(values, what)
