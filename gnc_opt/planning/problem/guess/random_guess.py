"""Random guesses for `multistart`: times, revolutions of angles, state perturbations, bang-bang controls."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.model.model_variables import Layout
from gnc_opt.planning.problem.angle_valued_controls import PERIODS
from gnc_opt.planning.problem.bounds import Interval, intersect_bounds
from gnc_opt.planning.problem.guess.initial_guess import build_phase_guess, guess_phase_times
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.redundant_bounds import build_angle_invariance_test
from gnc_opt.planning.problem.scaling_magnitudes import estimate_state_and_control_magnitudes

DURATION_MAX_RATIO = 10.0
"""Largest factor between a random and the guessed duration; log-uniform over two decades, within bounds."""

KNOWN_DURATION_MAX_RATIO = 1.4
"""Largest factor if the duration is known from another solution."""

AMPLITUDE_RANGE = (0.03, 1.0)
"""Range of a start's amplitude (log-uniform), as a share of the magnitude of each state."""

PERTURBATION_MIN_AMPLITUDE = 0.2
"""Smallest amplitude of a start with about the duration of a known solution."""

N_WAVES = 4
"""Number of sine waves in a smooth perturbation; wave k has an amplitude of order 1/k."""

FRACTIONS = np.linspace(0.0, 1.0, 65)


def does_start_keep_guess_shape(index: int) -> bool:
    """Return whether a start keeps the shape of the problem's guess, as every fourth one does."""
    return index % 4 == 2


def with_random_guess(
    problem: Problem, seed: int, index: int, durations: Mapping[str, float] | None = None
) -> Problem:
    """Return the problem with a random guess that depends only on ``seed`` and ``index``; index 0 is its own guess.

    Free times are drawn over decades, or near ``durations`` (s, by phase) of another solution; free parameters within
    their bounds. Angles with a free end make the number of revolutions that fits the duration at the guessed rate, or
    one more or less. Starts without `does_start_keep_guess_shape` have smooth state perturbations between fixed ends,
    and bang-bang or smooth controls.
    """
    if index == 0:
        return problem
    rng = np.random.default_rng([seed, index])
    variation, shift = problem, 0.0
    turned_angles: dict[str, float] = {}
    for name, phase in problem.phases.items():
        duration = (durations or {}).get(name)
        guessed = guess_phase_times(phase)
        times = _draw_random_times(phase, rng, shift, duration)
        shift = times[1] - guessed[1]
        start = build_phase_guess(phase, FRACTIONS)
        ratio = (times[1] - times[0]) / max(guessed[1] - guessed[0], np.finfo(float).tiny)
        states, controls = (
            start.states + _draw_random_revolutions(problem, phase, rng, ratio, turned_angles),
            start.controls,
        )
        if duration is not None or not does_start_keep_guess_shape(index):
            magnitudes = estimate_state_and_control_magnitudes(phase)
            min_amplitude = 0.0 if duration is None else PERTURBATION_MIN_AMPLITUDE
            states = _draw_random_states(phase, states, magnitudes[0], rng, min_amplitude)
            controls = _draw_random_controls(
                phase.numbers.controls, controls, magnitudes[1], rng, duration is not None
            )
        values = _split_values_by_variable(phase.model.states, states) | _split_values_by_variable(
            phase.model.controls, controls
        )
        variation = variation.with_guess(name, time=times[0] + FRACTIONS * (times[1] - times[0]), **values)
    return _draw_random_parameters(variation, rng)


def find_periods_of_angular_states(problem: Problem, phase: Phase) -> Array:
    """Return the period of each state (n_states,): one turn for angles, 0 for others."""

    def find_angle_periods() -> Array:
        probe = build_angle_invariance_test(problem, phase, of_states=True)
        return np.array([probe.find_angle_period(i, PERIODS) for i in range(phase.model.states.size)])

    return problem.memoize(("angular states", phase.name), find_angle_periods)


def _draw_random_revolutions(
    problem: Problem, phase: Phase, rng: np.random.Generator, ratio: float, turned_angles: dict[str, float]
) -> Array:
    """Return angles to be added to states (n_states, n_fractions); ``turned_angles`` links the phases."""
    numbers, periods = phase.numbers, find_periods_of_angular_states(problem, phase)
    first, last = (intersect_bounds(end, numbers.states) for end in (numbers.initial, numbers.final))
    guess = build_phase_guess(phase, FRACTIONS[[0, -1]]).states
    revolutions = np.zeros((periods.size, FRACTIONS.size))
    for i in np.flatnonzero(periods > 0):
        label, period, (guessed_first, guessed_last) = phase.model.states.labels[i], periods[i], guess[i]
        start, end = turned_angles.get(label), 0.0
        if first.is_fixed[i]:
            start = 0.0
        elif start is None:
            first_angle = guessed_first + period * rng.uniform(-0.5, 0.5)
            start = float(np.clip(first_angle, first.lower[i], first.upper[i])) - guessed_first
        if not last.is_fixed[i]:
            n_turns = round((guessed_last - guessed_first) / period * (ratio - 1.0)) + rng.integers(-1, 2)
            limits = (last.lower[i], last.upper[i])
            min_turns, max_turns = ((limit - guessed_last - start) / period for limit in limits)
            end = start + period * (
                float(np.clip(n_turns, np.ceil(min_turns), np.floor(max_turns)))
                if min_turns < max_turns
                else 0.0
            )
        revolutions[i] = start + (end - start) * FRACTIONS
        turned_angles[label] = end
    return revolutions


def _split_values_by_variable(layout: Layout, rows: Array) -> dict[str, Any]:
    return {name: rows[layout.slice(name)] for name in layout.names}


def _draw_random_times(
    phase: Phase, rng: np.random.Generator, shift: float, known_duration: float | None = None
) -> Array:
    """Return initial and final time (2,); a free initial time equals the end of the previous phase."""
    first, last = guess_phase_times(phase)
    initial, final = phase.time_ranges()
    span, max_ratio, box = last - first, DURATION_MAX_RATIO, phase.numbers.duration
    if known_duration:
        span, max_ratio = known_duration, KNOWN_DURATION_MAX_RATIO
    share = rng.uniform()
    if not initial.is_fixed[0]:
        first = float(np.clip(first + shift, initial.lower[0], initial.upper[0]))
    if final.is_fixed[0]:
        if initial.is_fixed[0]:
            return np.array([first, last])
        limits = (last - initial.upper[0], last - initial.lower[0])
    else:
        limits = (final.lower[0] - first, final.upper[0] - first)
    lower, upper = max(box.lower[0], limits[0], 0.0), min(box.upper[0], limits[1])
    shortest, longest = max(lower, span / max_ratio), min(upper, span * max_ratio)
    duration = (
        shortest * (longest / shortest) ** share if shortest < longest else max(lower, min(span, upper))
    )
    duration = duration if duration > 0 else span
    return np.array([last - duration, last] if final.is_fixed[0] else [first, first + duration])


def _draw_random_states(
    phase: Phase, linear: Array, magnitudes: Array, rng: np.random.Generator, min_amplitude: float
) -> Array:
    """Return states (n_states, n_fractions) with smooth random perturbations, zero at fixed ends."""
    numbers = phase.numbers
    smallest, largest = max(min_amplitude, AMPLITUDE_RANGE[0]), AMPLITUDE_RANGE[1]
    amplitude = magnitudes * smallest * (largest / smallest) ** rng.uniform()
    states = linear + amplitude[:, None] * _draw_smooth_signals(magnitudes.size, rng)
    offsets = amplitude * rng.normal(size=(2, magnitudes.size))
    for end, offset, ramp in (
        (numbers.initial, offsets[0], 1 - FRACTIONS),
        (numbers.final, offsets[1], FRACTIONS),
    ):
        states += np.where(intersect_bounds(end, numbers.states).is_fixed, 0.0, offset)[:, None] * ramp
    return _clip_values_to_bounds(states, numbers.states)


def _draw_random_controls(
    box: Interval, guess: Array, magnitudes: Array, rng: np.random.Generator, bang_bang: bool
) -> Array:
    """Return bang-bang patterns of full amplitude, or such patterns or smooth waves of random amplitude."""
    bounded = np.isfinite(box.lower) & np.isfinite(box.upper)
    middle = np.where(bounded[:, None], box.midpoint[:, None], guess)
    radius = np.where(bounded, 0.5 * (box.upper - box.lower), magnitudes)
    if bang_bang or rng.uniform() < 0.5:
        pattern = (
            np.stack([_draw_bang_bang_pattern(rng) for _ in range(radius.size)]) if radius.size else guess
        )
    else:
        pattern = _draw_smooth_signals(radius.size, rng)
    level = 1.0 if bang_bang else rng.uniform(0.3, 1.0)
    return _clip_values_to_bounds(middle + level * radius[:, None] * pattern, box)


def _draw_bang_bang_pattern(rng: np.random.Generator) -> Array:
    switches = np.sort(rng.uniform(size=rng.integers(0, 5)))
    sign = rng.choice((-1.0, 1.0))
    return np.asarray(sign * (-1.0) ** np.searchsorted(switches, FRACTIONS))


def _draw_smooth_signals(size: int, rng: np.random.Generator) -> Array:
    """Return smooth random signals (size, n_fractions) of order one that vanish at both ends."""
    k = np.arange(1, N_WAVES + 1)
    return np.asarray((rng.normal(size=(size, N_WAVES)) / k) @ np.sin(np.pi * np.outer(k, FRACTIONS)))


def _clip_values_to_bounds(values: Array, box: Interval) -> Array:
    return np.clip(values, box.lower[:, None], box.upper[:, None])


def _draw_random_parameters(problem: Problem, rng: np.random.Generator) -> Problem:
    """Return the problem with random guesses of free parameters: within finite bounds, else about their guess."""
    guesses: dict[str, Array] = {}
    for name, box in problem.parameter_bounds.items():
        guess = problem.parameter_guess[name]
        bounded = np.isfinite(box.lower) & np.isfinite(box.upper)
        lower, upper = (np.where(bounded, end, 0.0) for end in (box.lower, box.upper))
        near_guess = guess + np.maximum(np.abs(guess), 1.0) * rng.normal(size=guess.size)
        drawn = np.where(bounded, rng.uniform(lower, upper), near_guess)
        guesses[name] = np.clip(drawn, box.lower, box.upper)
    return problem.with_parameter_guess(**guesses)
