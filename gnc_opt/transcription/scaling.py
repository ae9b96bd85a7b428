"""Automatic scaling from bounds, guess and the size of the dynamics.

Variables are divided by typical magnitudes; dynamics rows by those of their state; other rows and the
objective by the norm of their scaled gradient at and near the guess. Answers are returned in physical units and
do not depend on any of this; the conditioning of the program does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gnc_opt.model.evaluation import evaluate
from gnc_opt.model.layout import Array, Layout
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.problem import Problem
from gnc_opt.transcription.guess import PhaseStart, start_phase
from gnc_opt.transcription.transcription import Transcription

NEARBY = 0.1
"""How far from the guess, in typical magnitudes, gradients are looked at besides at the guess itself.

A guess may by chance be stationary, as the perfect track of a tracking cost is: the gradient there is rounding,
and its inverse no scale. Results are insensitive to the distance (0.01 to 1)."""

FARTHEST = 10.0
"""How much larger than its guess a state without bounds may be taken to be."""

_SAMPLES = np.linspace(0.0, 1.0, 9)
_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


@dataclass(frozen=True)
class Scaling:
    """Magnitudes by which the program is divided.

    Attributes
    ----------
    variables : array (n_variables,)
        scaled variable = physical variable / variables.
    rows : array (n_constraints,)
        scaled row = physical row * rows.
    objective : float
        scaled objective = physical objective * objective.
    """

    variables: Array
    rows: Array
    objective: float


def scale_variables(
    transcription: Transcription, problem: Problem, start: Array, *, overridden: bool = True
) -> Array:
    """Return the typical magnitude of every variable, shape (n_variables,), as the user says or as found."""
    scales = np.ones(transcription.n_variables)
    for name, part in transcription.parts.items():
        states, controls = phase_magnitudes(problem.phases[name], overridden=overridden)
        collocation = part.collocation
        scales[collocation.boundary_states] = states[:, None]
        scales[collocation.point_states] = states[:, None]
        scales[collocation.point_controls] = controls[:, None]
        span = max(abs(start_phase(problem.phases[name], _SAMPLES).times[1]), 1e-3)
        free_times = part.times[part.times < transcription.n_variables]
        scales[free_times] = span
    for places, interval in ((transcription.parameter_places, problem.parameter_interval()),):
        scales[places] = _from_bounds(interval, np.abs(start[places]))
    return scales


def phase_magnitudes(leg: Phase, *, overridden: bool = True) -> tuple[Array, Array]:
    """Return typical magnitudes of states (n,) and controls (m,) of a phase.

    In this order: the user's scale, the model's nominal value, finite bounds, the guess and, for states, what the
    dynamics do to them over the phase: all of it where the guess is zero, at most `FARTHEST` times the guess elsewhere
    (stiff dynamics at a poor guess point far beyond where the state will ever go).
    """
    start = start_phase(leg, _SAMPLES, perturbed=False)
    numbers = leg.numbers
    controls = _from_bounds(numbers.controls, np.max(np.abs(start.controls), axis=1, initial=0.0))
    if overridden:
        _override(controls, leg.model.controls, numbers.scales)
    reach = np.max(np.abs(start.states), axis=1, initial=0.0)
    drift = _drift(leg, start, controls)
    reach = np.where(reach > 0, np.clip(drift, reach, FARTHEST * reach), drift)
    states = _from_bounds(numbers.states, reach)
    if overridden:
        _override(states, leg.model.states, numbers.scales)
    return states, controls


def _drift(leg: Phase, start: PhaseStart, magnitudes: Array) -> Array:
    """Return how far the dynamics move each state: controls at their bounds, as guessed, or else of their magnitude."""
    bounds = leg.numbers.controls
    times = start.times[0] + _SAMPLES * (start.times[1] - start.times[0])
    rates = [np.zeros(leg.model.states.size)]
    guessed = np.any(start.controls != 0, axis=1)
    for limit, usual in ((bounds.lower, -magnitudes), (bounds.upper, magnitudes)):
        endless = np.where(guessed[:, None], start.controls, usual[:, None])
        controls = np.where(np.isfinite(limit)[:, None], limit[:, None], endless)
        f = evaluate(leg.model.function, times, start.states, controls, leg.model.parameter_values)
        rates.append(np.max(np.abs(np.where(np.isfinite(f), f, 0.0)), axis=1))
    return np.asarray(0.5 * np.max(rates, axis=0) * (start.times[1] - start.times[0]))


def _from_bounds(interval: Interval, reach: Array) -> Array:
    """Return the larger finite bound, else the reach, else 1."""
    bounded = np.isfinite(interval.lower) & np.isfinite(interval.upper)
    limits = np.maximum(
        np.abs(np.where(bounded, interval.lower, 0.0)), np.abs(np.where(bounded, interval.upper, 0.0))
    )
    scales = np.where(bounded & (limits > 0), limits, reach)
    return np.where(scales > 0, scales, 1.0)


def _override(scales: Array, layout: Layout, user: Mapping[str, Array]) -> None:
    for variable in layout.variables:
        if variable.name in user:
            scales[layout.slice(variable.name)] = user[variable.name]
        elif variable.nominal is not None:
            scales[layout.slice(variable.name)] = variable.nominal


def scale_rows(
    transcription: Transcription, problem: Problem, start: Array, scales: Array
) -> tuple[Array, float]:
    """Return row scales (n_constraints,) and the objective's scale.

    Parameters
    ----------
    start, scales : array (n_variables,)
        The guess and the typical magnitudes of the variables, physical.
    """
    gradient, nonzeros = _derivatives(transcription, problem, start)
    rows, columns = transcription.constraints.jacobian_pattern
    norms = np.zeros(transcription.n_constraints)
    np.maximum.at(norms, rows, nonzeros * scales[columns])
    factors = 1.0 / np.where(norms > 0, norms, 1.0)
    steepest = float(np.max(gradient * scales))
    for part in transcription.parts.values():
        state_scales = scales[part.collocation.boundary_states[:, 0]]
        for place in part.collocation.dynamics_rows:
            factors[place] = 1.0 / state_scales[:, None]
    return factors, 1.0 / steepest if steepest > 0 else 1.0


def _derivatives(transcription: Transcription, problem: Problem, start: Array) -> tuple[Array, Array]:
    """Largest magnitudes, at and near the guess, of objective gradient (n_variables,) and Jacobian nonzeros."""
    box = transcription.variable_interval(problem)
    usual = scale_variables(transcription, problem, start, overridden=False)
    size = np.where(start != 0, np.minimum(np.abs(start), usual), usual)
    offset = NEARBY * size * np.cos(_GOLDEN_ANGLE * np.arange(start.size))
    gradient, nonzeros = np.zeros(start.size), np.zeros(transcription.constraints.jacobian_pattern[0].size)
    for point in (start, start + offset):
        inside = np.clip(point, box.lower, np.maximum(box.lower, box.upper))
        _, slope, jacobian = transcription.evaluate(problem, inside)
        gradient, nonzeros = np.maximum(gradient, _size(slope)), np.maximum(nonzeros, _size(jacobian))
    return gradient, nonzeros


def _size(values: Array) -> Array:
    return np.where(np.isfinite(values), np.abs(values), 0.0)
