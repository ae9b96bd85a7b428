"""Initial point of a solve: variables of the program from the problem's guess or from an earlier solution."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gnc_opt.argument_checks import require_type
from gnc_opt.array_types import Array
from gnc_opt.errors import ProblemError
from gnc_opt.numerical_tolerances import GONE
from gnc_opt.planning.problem.guess.guess_evaluation import VectorizedGuess
from gnc_opt.planning.problem.guess.initial_guess import build_phase_guess
from gnc_opt.planning.problem.guess.singularity_avoidance import with_curved_guess
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.costates import NlpIterate, invert_costate_map
from gnc_opt.planning.solution.phase_solution import PhaseSolution, Signal
from gnc_opt.planning.solution.piecewise_polynomial import Side
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.nlp_layout import PhaseIndices
from gnc_opt.planning.transcription.transcription import Transcription


def choose_initial_variables(transcription: Transcription, problem: Problem) -> Array:
    """Return the variables of a cold start (n_variables,), physical, from the problem's guess."""
    curved = build_nlp_point_from_guess(transcription, with_curved_guess(problem))
    return set_integral_variables_by_quadrature(transcription, problem, curved)


def build_nlp_point_from_guess(transcription: Transcription, problem: Problem) -> Array:
    """Return the problem's guess of all program variables (n_variables,), physical; integrals are zero."""
    x = np.zeros(transcription.n_variables)
    for name, part in transcription.parts.items():
        phase, collocation = problem.phases[name], part.collocation
        boundary_guess = build_phase_guess(phase, np.asarray(collocation.mesh.breaks))
        point_guess = build_phase_guess(phase, collocation.normalised_point_times)
        x[collocation.point_states], x[collocation.point_controls] = point_guess.states, point_guess.controls
        x[collocation.boundary_states] = boundary_guess.states
        free_times = part.times < transcription.n_variables
        breaks = np.asarray(collocation.mesh.breaks)[list(collocation.mesh.arc_breaks)]
        times = boundary_guess.times[0] + breaks * (boundary_guess.times[1] - boundary_guess.times[0])
        x[part.times[free_times]] = times[free_times]
    if problem.parameters.size:
        x[transcription.parameter_indices] = np.concatenate(list(problem.parameter_guess.values()))
    bounds = transcription.get_variable_bounds(problem)
    return np.clip(x, bounds.lower, np.maximum(bounds.lower, bounds.upper))


def set_integral_variables_by_quadrature(transcription: Transcription, problem: Problem, x: Array) -> Array:
    """Set integral variables to the integrals along x, using their rows (integral - quadrature)."""
    integrals = transcription.integral_places
    if not integrals.size:
        return x
    values = transcription.evaluate_nlp_first_derivatives(problem, x)[0]
    x = x.copy()
    x[integrals] -= np.nan_to_num(values[-integrals.size :])
    return x


def build_nlp_point_from_solution(
    transcription: Transcription, problem: Problem, guess: Solution
) -> NlpIterate:
    """Return variables and multipliers from a solution on any mesh; other variables are those of the guess."""
    x = build_nlp_point_from_guess(transcription, problem)
    lam_x, lam_g = np.zeros(transcription.n_variables), np.zeros(transcription.n_constraints)
    for name, part in transcription.parts.items():
        phase = problem.phases[name]
        guess_phase = _get_matching_guess_phase(guess, phase)
        _copy_phase_guess_to_nlp_point(transcription, part, guess_phase, x, lam_x, lam_g)
    for name in problem.parameters.names:
        if name in guess.free_parameters:
            own_rows, guess_rows = problem.parameters.slice(name), guess.free_parameters.slice(name)
            x[transcription.parameter_indices[own_rows]] = guess.parameter_values[guess_rows]
            lam_x[transcription.parameter_indices[own_rows]] = guess.parameter_multipliers[guess_rows]
    _set_boundary_constraint_multipliers(transcription, guess, lam_g)
    bounds = transcription.get_variable_bounds(problem)
    x = np.clip(x, bounds.lower, np.maximum(bounds.lower, bounds.upper))
    return NlpIterate(set_integral_variables_by_quadrature(transcription, problem, x), lam_x, lam_g)


def fix_mesh_breaks(phase: PhaseSolution) -> Mesh:
    """Return the mesh of a solution with all breaks fixed at their final positions, without empty segments."""
    breaks = (phase.breaks - phase.breaks[0]) / (phase.breaks[-1] - phase.breaks[0])
    is_nonempty = np.diff(breaks) > GONE
    degrees = tuple(n for n, nonempty in zip(phase.mesh.degrees, is_nonempty, strict=True) if nonempty)
    return Mesh((0.0, *breaks[:-1][is_nonempty][1:], 1.0), degrees)


def _get_matching_guess_phase(guess: Solution, phase: Phase) -> PhaseSolution:
    given = guess.phases.get(phase.name)
    if given is None:
        raise ProblemError(
            f"the guess has no phase '{phase.name}', only {list(guess.phases)}: give one with the same phases."
        )
    kinds = ("states", phase.model.states, given.states), ("controls", phase.model.controls, given.controls)
    for kind, model_layout, guess_layout in kinds:
        if model_layout.labels != guess_layout.labels:
            raise ProblemError(
                f"the guess for {phase.label} has the {kind} {list(guess_layout.labels)}, "
                f"but the model has {list(model_layout.labels)}: use guess_from_solution()."
            )
    return given


def _copy_phase_guess_to_nlp_point(
    transcription: Transcription, part: PhaseIndices, old: PhaseSolution, x: Array, lam_x: Array, lam_g: Array
) -> None:
    collocation = part.collocation
    first, last = old.breaks[[0, -1]]
    points = first + collocation.normalised_point_times * (last - first)
    breaks = first + np.asarray(collocation.mesh.breaks) * (last - first)
    x[collocation.boundary_states] = old.x(breaks)
    # A point at the end of its segment gets the limit from inside: controls and costates may jump there.
    at_end = np.concatenate([rule.points == 1.0 for rule in collocation.collocation_rules])

    def sample_signal_inside_segments(signal: Callable[[Array, Side], Array]) -> Array:
        return np.where(at_end, signal(points, "left"), signal(points, "right"))

    at_boundary = np.isin(collocation.point_states, collocation.boundary_states)
    states = old.x(points)
    x[collocation.point_states[~at_boundary]] = states[~at_boundary]
    x[collocation.point_controls] = sample_signal_inside_segments(old.applied.evaluate_clipped_polynomial)
    free_times = part.times < transcription.n_variables
    times = breaks[list(collocation.mesh.arc_breaks)]
    x[part.times[free_times]] = times[free_times]
    for index, multiplier in zip(part.times[[0, -1]], old.time_multipliers, strict=True):
        if index < transcription.n_variables:
            lam_x[index] = multiplier
    weights = collocation.quadrature_weights * np.diff(times)[collocation.point_arc_indices]
    same_boundaries = slice(None) if collocation.mesh == old.mesh else [0, -1]
    lam_x[collocation.boundary_states[:, same_boundaries]] = old.state_impulses[:, same_boundaries]
    np.add.at(lam_x, collocation.point_states, sample_signal_inside_segments(old.state_multiplier) * weights)
    lam_x[collocation.point_controls] = sample_signal_inside_segments(old.control_multiplier) * weights
    if old.path_labels:
        lam_g[collocation.path_rows] = sample_signal_inside_segments(old.path_multiplier) * weights
    is_same_mesh = collocation.scheme == old.scheme and collocation.mesh == old.mesh
    costates = old.point_costates if is_same_mesh else sample_signal_inside_segments(old.lam)
    multipliers = invert_costate_map(collocation, costates, old.lam(breaks[1:], "left"))
    for rows, values in zip(collocation.dynamics_rows, multipliers, strict=True):
        lam_g[rows] = values


def _set_boundary_constraint_multipliers(transcription: Transcription, guess: Solution, lam_g: Array) -> None:
    """Set multipliers of boundary constraints, durations and integral definitions (-dJ/dI)."""
    values = zip(guess.constraint_labels, guess.constraint_multipliers, strict=True)
    multipliers = {f"constraint {label}": float(multiplier) for label, multiplier in values}
    for name, phase in guess.phases.items():
        multipliers[f"duration of phase {name}"] = phase.duration_multiplier
        for label, weight in zip(phase.integral_labels, phase.integral_weights, strict=True):
            multipliers[f"integral {label}, phase {name}"] = -float(weight)
    for label, row in transcription.boundary_constraint_row_indices.items():
        lam_g[row] = multipliers.get(label, 0.0)


def guess_from_solution(problem: Problem, solution: Solution) -> Problem:
    """Return the problem with the trajectory of another problem's solution as its guess, as far as variables agree.

    Use it for the solution of a simpler problem with fewer states, another model or other phases. (With the same
    phases, states and controls use ``solve(problem, guess=solution)``, which includes the multipliers.)

    Parameters
    ----------
    problem : Problem
    solution : Solution
        Phases are matched by name (single phases always); states, controls and free parameters by name and size.
        Missing quantities are guessed.

    Returns
    -------
    Problem
        See ``Problem.with_guess``.

    Raises
    ------
    ProblemError
        The two have no phase, or no state and no control, in common.

    Examples
    --------
    >>> nearby = go.guess_from_solution(problem.with_initial(q=1.1), solution)
    >>> print(f"{go.solve(nearby, tol=1e-6).objective:.4f}")
    2.0976
    """
    hint = "write guess_from_solution(problem, solution)"
    require_type(problem, Problem, "the argument of guess_from_solution()", hint)
    require_type(solution, Solution, "the solution of guess_from_solution()", "give a result of solve()")
    matching = {name: solution.phases[name] for name in problem.phases if name in solution.phases}
    if len(problem.phases) == len(solution.phases) == 1:
        matching = dict(zip(problem.phases, solution.phases.values(), strict=True))
    guessed = problem
    for name, phase in matching.items():
        guessed = _replace_phase_guess(guessed, name, phase)
    if guessed is problem:
        raise ProblemError(
            f"problem '{problem.name}' and the solution of '{solution.problem_name}' have no phase with states or "
            "controls of the same names: rename them, or use guess_from_data()."
        )
    free_parameters, parameters = solution.free_parameters, problem.parameters
    parameter_values = {
        v.name: solution.parameter_values[free_parameters.slice(v.name)]
        for v in parameters.variables
        if v.name in free_parameters and free_parameters[v.name].size == v.size
    }
    return guessed.with_parameter_guess(**parameter_values) if parameter_values else guessed


def _replace_phase_guess(problem: Problem, name: str, phase: PhaseSolution) -> Problem:
    """Return the problem with the trajectory of one phase as its guess; unchanged without common variables."""
    names = (*phase.states.names, *phase.controls.names, *(c.name for c in phase.composed_controls))
    signals = {name: phase.saturated_control(name) for name in names}
    values = {
        v.name: _convert_signal_to_guess(phase, signals[v.name])
        for v in problem.phases[name].guessable_names.values()
        if v.name in signals and len(signals[v.name].labels) == v.size
    }
    return problem.with_guess(name, phase.breaks[[0, -1]], **values) if values else problem


def _convert_signal_to_guess(phase: PhaseSolution, signal: Signal) -> VectorizedGuess:
    """Return a signal as a guess that can be evaluated slightly outside the phase."""
    first, last = phase.breaks[[0, -1]]
    return VectorizedGuess(lambda times: np.atleast_2d(signal(np.clip(times, first, last))))
