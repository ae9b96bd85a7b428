"""Typical magnitudes of the states and controls of a phase."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_function
from gnc_opt.model.model_variables import Layout
from gnc_opt.numerical_tolerances import ROUNDING, SMALL, replace_zeros_by_one, set_nonfinite_to_zero
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.guess.initial_guess import SampledGuess, build_phase_guess
from gnc_opt.planning.problem.phase import Phase

UNBOUNDED_STATE_MAX_RATIO = 10.0
"""Largest ratio of the magnitude of an unbounded state to its guess."""

SAMPLE_FRACTIONS = np.linspace(0.0, 1.0, 9)
"""Fractions of a phase at which guess and dynamics are evaluated."""

GUESS_OFFSET_SHARE = 0.01
"""Displacement from the guess, as a share of the magnitude of each state."""


def estimate_state_and_control_magnitudes(phase: Phase, *, overridden: bool = True) -> tuple[Array, Array]:
    """Return typical magnitudes of states (n,) and controls (m,) of a phase.

    The first available of: the user's scale, the nominal value, finite bounds, the guess. States may be larger by the
    motion that the dynamics cause, at most `UNBOUNDED_STATE_MAX_RATIO` times the guess.
    """
    start = build_phase_guess(phase, SAMPLE_FRACTIONS, perturbed=False)
    numbers = phase.numbers
    controls = choose_scaling_magnitudes_from_bounds(
        numbers.controls, np.max(np.abs(start.controls), axis=1, initial=0.0)
    )
    if overridden:
        _overwrite_scales_by_user_input(controls, phase.model.controls, numbers.scales)
    magnitudes = np.max(np.abs(start.states), axis=1, initial=0.0)
    drift = _estimate_state_change_over_phase(phase, start, controls)
    drift_beside_guess = _estimate_state_change_over_phase(
        phase, replace(start, states=start.states + GUESS_OFFSET_SHARE * magnitudes[:, None]), controls
    )
    drift = np.where(drift > ROUNDING * drift_beside_guess, drift, drift_beside_guess)
    extended = np.clip(drift, magnitudes, UNBOUNDED_STATE_MAX_RATIO * magnitudes)
    magnitudes = np.where(magnitudes > ROUNDING * drift_beside_guess, extended, drift)
    states = choose_scaling_magnitudes_from_bounds(numbers.states, magnitudes)
    if overridden:
        _overwrite_scales_by_user_input(states, phase.model.states, numbers.scales)
    return states, controls


def _estimate_state_change_over_phase(phase: Phase, start: SampledGuess, magnitudes: Array) -> Array:
    """Return the motion of each state with controls at their bounds, at the guess, or at their magnitudes."""
    bounds = phase.numbers.controls
    times = start.times[0] + SAMPLE_FRACTIONS * (start.times[1] - start.times[0])
    rates = [np.zeros(phase.model.states.size)]
    guessed = np.any(start.controls != 0, axis=1)
    for limit, typical in ((bounds.lower, -magnitudes), (bounds.upper, magnitudes)):
        unlimited = np.where(guessed[:, None], start.controls, typical[:, None])
        controls = np.where(np.isfinite(limit)[:, None], limit[:, None], unlimited)
        f = evaluate_casadi_function(
            phase.model.function, times, start.states, controls, phase.model.parameter_values
        )
        rates.append(np.max(np.abs(set_nonfinite_to_zero(f)), axis=1))
    joint, single = np.max(rates, axis=0), _estimate_state_rate_changes(phase, start, times, magnitudes)
    # Below this share the effects of several controls at their bounds cancel.
    rate = np.where(joint > SMALL * single, joint, single)
    return np.asarray(0.5 * rate * (start.times[1] - start.times[0]))


def _estimate_state_rate_changes(phase: Phase, start: SampledGuess, times: Array, magnitudes: Array) -> Array:
    """Return the largest change of each state's rate by a single control of its magnitude, (n,)."""
    count, guess = magnitudes.size, start.controls
    controls = np.hstack([guess + change[:, None] for change in (0.0 * magnitudes, *np.diag(magnitudes))])
    f = evaluate_casadi_function(
        phase.model.function,
        np.tile(times, count + 1),
        np.tile(start.states, count + 1),
        controls,
        phase.model.parameter_values,
    )
    f = set_nonfinite_to_zero(f).reshape(len(f), count + 1, times.size)
    return np.asarray(np.max(np.abs(f[:, 1:] - f[:, :1]), axis=(1, 2), initial=0.0))


def choose_scaling_magnitudes_from_bounds(interval: Interval, unbounded: Array) -> Array:
    """Return typical magnitudes: the larger of two finite bounds, else ``unbounded``, else 1."""
    bounded = np.isfinite(interval.lower) & np.isfinite(interval.upper)
    limits = np.maximum(
        np.abs(np.where(bounded, interval.lower, 0.0)), np.abs(np.where(bounded, interval.upper, 0.0))
    )
    scales = np.where(bounded & (limits > 0), limits, unbounded)
    return replace_zeros_by_one(scales)


def _overwrite_scales_by_user_input(scales: Array, layout: Layout, user: Mapping[str, Array]) -> None:
    for variable in layout.variables:
        if variable.name in user:
            scales[layout.slice(variable.name)] = user[variable.name]
        elif variable.nominal is not None:
            scales[layout.slice(variable.name)] = variable.nominal
