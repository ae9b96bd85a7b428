"""Conversion of solver results to solutions: times, integrals, covector mapping."""

from __future__ import annotations

from typing import Any

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.model.split_and_magnitude_direction_controls import UnitVectorControl
from gnc_opt.numerical_tolerances import AT_LIMIT, ROUNDING, SHORTEST
from gnc_opt.planning.problem.angle_valued_controls import PERIODS, AngleProbe
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.hamiltonian_functions import (
    EndGradients,
    PhaseFunctions,
    compile_phase_functions,
    evaluate_endpoint_gradients,
)
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.costates import (
    NlpIterate,
    PhaseCostates,
    compute_costates_at_collocation_points,
    correct_constraint_arc_costates,
    split_duplicate_multipliers,
)
from gnc_opt.planning.solution.phase_solution import PhaseSolution, interpolate_point_values
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial
from gnc_opt.planning.transcription.collocation import PhaseCollocation
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.nlp_layout import PhaseIndices
from gnc_opt.planning.transcription.transcription import Transcription


def read_phase_parameters(problem: Problem, phase: Phase, q: Array) -> Array:
    """Return the model parameters of a phase, with optimised ones from q (n,) or (n, n_columns)."""
    p = phase.model.parameter_values
    p = p if q.ndim == 1 else np.repeat(p[:, None], q.shape[1], axis=1)
    for name in problem.parameters.names:
        if name in phase.model.parameters:
            p[phase.model.parameters.slice(name)] = q[problem.parameters.slice(name)]
    return p


def bind_parameters(problem: Problem, name: str, q: Array, weights: Array | None = None) -> PhaseFunctions:
    """Return the functions of a phase for free parameter values; without ``weights`` all integral weights are 0."""
    phase = problem.phases[name]
    weights = np.zeros(len(phase.integrands)) if weights is None else weights
    return compile_phase_functions(problem, name, read_phase_parameters(problem, phase, q), q, weights)


def copy_problem_data_to_solution(problem: Problem, phase: Phase, q: Array) -> dict[str, Any]:
    """Return the data of the problem in the solution of a phase: names, limits, parameters."""
    initial_time, final_time = phase.time_ranges()
    return {
        "states": phase.model.states,
        "controls": phase.model.controls,
        "model_parameters": phase.model.parameters,
        "path_labels": phase.path_labels,
        "integral_labels": tuple(phase.integrands),
        "parameters": read_phase_parameters(problem, phase, q),
        "state_bounds": phase.numbers.states,
        "control_bounds": phase.numbers.controls,
        "path_bounds": phase.get_path_bounds(),
        "initial_bounds": phase.numbers.initial,
        "final_bounds": phase.numbers.final,
        "initial_time_bounds": initial_time,
        "final_time_bounds": final_time,
        "duration_bounds": phase.numbers.duration,
    }


def build_phase_solutions(
    transcription: Transcription, problem: Problem, iterate: NlpIterate
) -> tuple[dict[str, PhaseSolution], EndGradients]:
    """Return the solution of every phase, and the end-point gradients."""
    q = iterate.x[transcription.parameter_indices]
    nu = iterate.lam_g[transcription.constraint_rows]
    integrals: dict[str, Array] = {}
    ends: dict[str, list[Any]] = {}
    for name, part in transcription.parts.items():
        states = iterate.x[part.collocation.boundary_states]
        anchors, spans, trajectory = _read_collocation_points(transcription, problem, part, iterate.x)
        integrands = bind_parameters(problem, name, q).integrands(*trajectory)
        integrals[name] = np.asarray(integrands @ (part.collocation.quadrature_weights * spans))
        p = read_phase_parameters(problem, problem.phases[name], q)
        ends[name] = [states[:, 0], states[:, -1], anchors[0], anchors[-1], integrals[name], p]
    gradients = evaluate_endpoint_gradients(problem, ends, q, nu)
    phases = {
        name: _build_phase_solution(transcription, problem, part, iterate, integrals[name], gradients)
        for name, part in transcription.parts.items()
    }
    return phases, gradients


def unwrap_angle_controls(transcription: Transcription, problem: Problem, variables: Array) -> Array:
    """Return the variables with unwrapped angular controls."""
    q = variables[transcription.parameter_indices]
    unwrapped = variables.copy()
    for name, part in transcription.parts.items():
        functions, bounds = bind_parameters(problem, name, q), problem.phases[name].numbers.controls
        trajectory = _read_collocation_points(transcription, problem, part, variables)[2]
        unwrapped[part.collocation.point_controls] = unwrap_angles(functions, bounds, *trajectory)
    return unwrapped


def unwrap_angles(functions: PhaseFunctions, bounds: Interval, t: Array, x: Array, u: Array) -> Array:
    """Return controls (m, N) with angles shifted by whole periods to be nearest to the previous values.

    A solver with long steps may leave points that differ by whole turns. States, cost and multipliers are then correct,
    but interpolating polynomials are not. Angles that would exceed their bounds are unchanged. Times ascend.
    """
    widths = bounds.upper - bounds.lower
    if u.shape[1] < 2 or not np.all(np.isfinite(u)):
        return u
    jumps = np.max(np.abs(np.diff(u, axis=1)), axis=1)
    if not np.any((widths > min(PERIODS)) & (jumps > 0.5 * min(PERIODS))):
        return u
    probe = AngleProbe(lambda other: functions.evaluate_rates_paths_and_integrands(t, x, other), u)
    angles = {i: period for i in range(widths.size) if 0 < (period := probe.find_angle_period(i)) < widths[i]}
    unwrapped = u.copy()
    for i, period in angles.items():
        angle = np.unwrap(np.append(0.0, u[i]), period=period)[1:]
        fewest = np.ceil((bounds.lower[i] - np.min(angle)) / period)
        most = np.floor((bounds.upper[i] - np.max(angle)) / period)
        if fewest <= most:  # the smallest number of whole turns that moves the angles into their bounds
            unwrapped[i] = angle + period * np.clip(0.0, fewest, most)
    return unwrapped


def _read_collocation_points(
    transcription: Transcription, problem: Problem, part: PhaseIndices, variables: Array
) -> tuple[Array, Array, tuple[Array, Array, Array]]:
    """Return the anchor times, the durations of the arcs of the points (N,), and times, states and controls there."""
    collocation, arcs = part.collocation, part.collocation.point_arc_indices
    anchors = np.concatenate([variables, transcription.list_fixed_phase_times(problem)])[part.times]
    spans = np.diff(anchors)[arcs]
    times = anchors[arcs] + collocation.normalised_times_in_arcs * spans
    return anchors, spans, (times, variables[collocation.point_states], variables[collocation.point_controls])


def _fix_movable_mesh_breaks(mesh: Mesh, anchors: Array) -> tuple[Mesh, Array]:
    """Return the mesh with movable breaks at their final positions, and all boundary times (K + 1,)."""
    # Far from t = 0, the shortest segment must still have distinct boundary times.
    shortest = SHORTEST + ROUNDING * float(np.max(np.abs(anchors))) / float(np.min(mesh.arc_widths))
    spans = np.maximum(np.diff(anchors), shortest)
    starts = anchors[0] + np.concatenate([[0.0], np.cumsum(spans)])
    breaks = np.append(starts[mesh.segment_arcs] + mesh.arc_starts * spans[mesh.segment_arcs], starts[-1])
    if not mesh.movable:
        return mesh, breaks
    fractions = (breaks - breaks[0]) / (breaks[-1] - breaks[0])
    return Mesh(tuple(fractions), mesh.degrees, mesh.movable), breaks


def _build_phase_solution(
    transcription: Transcription,
    problem: Problem,
    part: PhaseIndices,
    iterate: NlpIterate,
    integrals: Array,
    gradients: EndGradients,
) -> PhaseSolution:
    phase, collocation = problem.phases[part.name], part.collocation
    q = iterate.x[transcription.parameter_indices]
    anchors, spans, (times, x, u) = _read_collocation_points(transcription, problem, part, iterate.x)
    functions = bind_parameters(problem, part.name, q, gradients.integrals[part.name])
    lam = compute_costates_at_collocation_points(collocation, iterate.lam_g)
    weights = collocation.quadrature_weights * np.maximum(spans, SHORTEST)
    paths = iterate.lam_g[collocation.path_rows] / weights
    mixed = functions.mixed_path_constraints
    paths = split_duplicate_multipliers(collocation, paths, weights, mixed)
    rates = functions.state_rates(times, x, u)
    gradient = functions.state_gradient(times, x, u, lam, paths)
    mesh, breaks = _fix_movable_mesh_breaks(collocation.mesh, anchors)
    mixed_gradient = functions.state_gradient(times, x, u, lam, np.where(mixed[:, None], paths, 0.0))
    pure_part = gradient - mixed_gradient
    costates = PhaseCostates.from_multipliers(collocation, iterate, weights, gradient, pure_part)
    aligned = _align_directions_with_primer_vector(phase, functions, times, x, u, lam)
    solution = PhaseSolution(
        name=part.name,
        scheme=collocation.scheme,
        mesh=mesh,
        initial_time=float(anchors[0]),
        final_time=float(anchors[-1]),
        x=build_state_polynomial(collocation, breaks, iterate.x, rates * spans),
        u=interpolate_point_values(breaks, collocation.collocation_rules, aligned),
        lam=costates.build_costate_polynomial(breaks),
        lam_start=costates.start,
        lam_end=costates.end,
        point_costates=costates.lam,
        path_multipliers=paths,
        state_multipliers=costates.densities,
        control_multipliers=iterate.lam_x[collocation.point_controls] / weights,
        state_impulses=costates.impulses,
        time_multipliers=np.append(iterate.lam_x, [0.0])[np.minimum(part.times[[0, -1]], iterate.lam_x.size)],
        duration_multiplier=transcription.get_duration_multiplier(part.name, iterate.lam_g),
        integrals=integrals,
        integral_weights=gradients.integrals[part.name],
        composed_controls=tuple(phase.model.composed_controls.values()),
        turns=phase.numbers.turns,
        **copy_problem_data_to_solution(problem, phase, q),
    )
    return correct_constraint_arc_costates(solution, phase.numbers.arcs, functions)


def _align_directions_with_primer_vector(
    phase: Phase, functions: PhaseFunctions, times: Array, x: Array, u: Array, lam: Array
) -> Array:
    """Return controls with directions proportional to the primer, within the limit, where a magnitude is zero."""
    layout, aligned = phase.model.controls, u.copy(order="K")
    units = {c.parts for c in phase.model.composed_controls.values() if isinstance(c, UnitVectorControl)}
    for vector in (v for v in phase.vector_controls if v.parts[1:] in units):
        size, direction = layout.slice(vector.magnitude), layout.slice(vector.direction)
        zero = np.flatnonzero(u[size][0] <= AT_LIMIT * np.max(u[size]))
        thrusting = u[:, zero].copy()
        thrusting[size] = 1.0
        primer = functions.switching_functions(times[zero], x[:, zero], thrusting, lam[:, zero])[direction]
        largest = np.max(np.linalg.norm(primer, axis=0), initial=0.0)
        aligned[direction, zero] = -0.5 * primer / largest if largest > 0 else u[direction, zero]
    return aligned


def build_state_polynomial(
    collocation: PhaseCollocation, breaks: Array, variables: Array, scaled_rates: Array
) -> PiecewisePolynomial:
    """Return the state polynomial of the scheme; ``scaled_rates`` (n_states, N) are dx/dt times the arc duration."""
    nodes, values = [], []
    for k, rule in enumerate(collocation.collocation_rules):
        states = variables[collocation.index_segment_states(k)]
        if collocation.family.has_dynamics_row_at_segment_end:
            states = states[:, :-1]
        if collocation.family.ends_at_point:
            rates = scaled_rates[:, collocation.mesh.point_offsets[k] : collocation.mesh.point_offsets[k + 1]]
            is_extra_node = ~np.isin(rule.state_nodes, rule.points)
            integration = rule.build_integration_matrix(rule.state_nodes[is_extra_node])
            increments = states[:, [0]] + 0.5 * collocation.mesh.arc_widths[k] * rates @ integration.T
            all_states = np.empty((states.shape[0], rule.n + 1))
            all_states[:, ~is_extra_node], all_states[:, is_extra_node] = states, increments
            states = all_states
        nodes.append(rule.state_nodes)
        values.append(states)
    return PiecewisePolynomial(breaks, tuple(nodes), tuple(values))
