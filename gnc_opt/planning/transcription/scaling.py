"""Automatic scaling of the nonlinear program from bounds, guess and magnitude of the dynamics.

Variables are divided by typical magnitudes, dynamics rows by those of their state. Other rows and the objective are
divided by the norm of their scaled gradient at and near the guess.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import replace_zeros_by_one, set_nonfinite_to_zero
from gnc_opt.planning.problem.guess.initial_guess import guess_phase_times
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.scaling_magnitudes import (
    choose_scaling_magnitudes_from_bounds,
    estimate_state_and_control_magnitudes,
)
from gnc_opt.planning.transcription.transcription import Transcription

NEARBY_SHIFT = 0.1
"""Distance from the guess, in typical magnitudes, of a second gradient evaluation, since gradients may vanish there."""

LIMIT_MAX_DISTANCE = 10.0
"""Largest scaled distance of the guess from a limit; used for gradients that nearly vanish at the guess."""

_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


@dataclass(frozen=True)
class Scaling:
    """Scales: variables are divided by ``variables``; rows and objective are multiplied by theirs."""

    variables: Array
    rows: Array
    objective: float


def choose_variable_scales(
    transcription: Transcription, problem: Problem, start: Array, *, overridden: bool = True
) -> Array:
    """Return the typical magnitudes of the variables, shape (n_variables,), optionally overridden by the user."""
    scales = np.ones(transcription.n_variables)
    for name, part in transcription.parts.items():
        states, controls = estimate_state_and_control_magnitudes(problem.phases[name], overridden=overridden)
        collocation = part.collocation
        scales[collocation.boundary_states] = states[:, None]
        scales[collocation.point_states] = states[:, None]
        scales[collocation.point_controls] = controls[:, None]
        span = max(abs(guess_phase_times(problem.phases[name])[1]), 1e-3)
        free_times = part.times[part.times < transcription.n_variables]
        scales[free_times] = span
    places = transcription.parameter_indices
    scales[places] = choose_scaling_magnitudes_from_bounds(
        problem.get_parameter_bounds(), np.abs(start[places])
    )
    return scales


def choose_row_scales(
    transcription: Transcription, problem: Problem, start: Array, scales: Array
) -> tuple[Array, float]:
    """Return row scales (n_constraints,) and the scale of the objective for a guess and scaled variables."""
    gradient, nonzeros, room = _compute_jacobian_magnitudes(transcription, problem, start)
    rows, columns = transcription.constraints.jacobian_pattern
    norms = np.zeros(transcription.n_constraints)
    np.maximum.at(norms, rows, nonzeros * scales[columns])
    factors = 1.0 / np.maximum(replace_zeros_by_one(norms), room / LIMIT_MAX_DISTANCE)
    steepest = float(np.max(gradient * scales))
    for part in transcription.parts.values():
        state_scales = scales[part.collocation.boundary_states[:, 0]]
        for place in part.collocation.dynamics_rows:
            factors[place] = 1.0 / state_scales[:, None]
    return factors, 1.0 / steepest if steepest > 0 else 1.0


def _compute_jacobian_magnitudes(
    transcription: Transcription, problem: Problem, start: Array
) -> tuple[Array, Array, Array]:
    """Return the largest magnitudes of objective gradient and Jacobian nonzeros near the guess, and the rows' slack."""
    box = transcription.get_variable_bounds(problem)
    usual = choose_variable_scales(transcription, problem, start, overridden=False)
    size = np.where(start != 0, np.minimum(np.abs(start), usual), usual)
    offset = NEARBY_SHIFT * size * np.cos(_GOLDEN_ANGLE * np.arange(start.size))
    gradient, nonzeros = np.zeros(start.size), np.zeros(transcription.constraints.jacobian_pattern[0].size)
    limits, room = transcription.get_constraint_bounds(problem), np.zeros(transcription.n_constraints)
    for point in (start, start + offset):
        inside = np.clip(point, box.lower, np.maximum(box.lower, box.upper))
        values, slope, jacobian = transcription.evaluate_nlp_first_derivatives(problem, inside)
        gradient = np.maximum(gradient, np.abs(set_nonfinite_to_zero(slope)))
        nonzeros = np.maximum(nonzeros, np.abs(set_nonfinite_to_zero(jacobian)))
        room = np.maximum(
            room, set_nonfinite_to_zero(np.minimum(values - limits.lower, limits.upper - values))
        )
    return gradient, nonzeros, room
