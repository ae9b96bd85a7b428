"""Starting trajectories: what the user knows, and a straight line for the rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.model.model import Model
from gnc_opt.problem.guess.values import sample_guess
from gnc_opt.problem.interval import Interval, intersect
from gnc_opt.problem.phase import Phase

PERTURBATION = 0.01
"""Amplitude of the control perturbation of the default guess, as a fraction of the control's range.

A guess on a plane of symmetry can be a saddle of the problem (the planar rendezvous is one), from which
Newton's method cannot leave; the perturbation is smooth, deterministic and independent of the mesh."""

_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@dataclass(frozen=True)
class PhaseStart:
    """The guess of one phase at given fractions: times (2,), states (n, N) and controls (m, N)."""

    times: Array
    states: Array
    controls: Array


def start_phase(leg: Phase, fractions: Array, *, perturbed: bool = True) -> PhaseStart:
    """Return the guess of a phase at the given fractions of its duration, with or without `perturbation`.

    Raises
    ------
    ProblemError
        A guessed array or function has the wrong size.
    """
    times = guess_times(leg)
    at = times[0] + fractions * (times[1] - times[0])
    model, numbers = leg.model, leg.numbers
    first, last = end_values(leg)
    states = first[:, None] + (last - first)[:, None] * fractions
    controls = np.repeat(numbers.controls.middle[:, None], fractions.size, axis=1)
    for vector in leg.vectors:
        if leg.on_sphere(vector):  # at its centre the derivatives of the sphere vanish
            controls[model.controls.slice(vector.direction)] = vector.variable.size**-0.5
    if perturbed:
        controls += perturbation(numbers.controls, fractions)
    for name, value in numbers.guess.values.items():
        what = f"the guess of '{name}' in {leg.where}"
        values = sample_guess(value, leg.guessable[name].size, at, fractions, numbers.guess.time, what)
        if name in model.states:
            states[model.states.slice(name)] = values
        else:
            put_control(model, controls, name, values)
    return PhaseStart(times, states, controls)


def put_control(model: Model, controls: Array, name: str, values: Array) -> None:
    """Write values (size, N) of one control into those of all (m, N); of a composed one, into those of its parts."""
    composed = model.composed_controls.get(name)
    if composed is None:
        controls[model.controls.slice(name)] = values
        return
    for part, own in zip(composed.parts, composed.decompose(values), strict=True):
        place = model.controls.slice(part)
        controls[place] = np.where(np.isnan(own), controls[place], own)


def guess_times(leg: Phase) -> Array:
    """Return guessed initial and final time, shape (2,)."""
    known = leg.numbers.guess.time
    wanted = np.array([np.nan, np.nan]) if known is None else known[[0, -1]]
    initial, final = leg.times()
    t0 = _time_in(initial, wanted[0], default=0.0)
    span = leg.numbers.duration
    least = max(float(span.lower[0]), 0.0)
    usual = least if least > 0 else 1.0
    tf = _time_in(final, wanted[1], default=t0 + usual)
    if tf <= t0 and not final.fixed[0]:
        tf = min(t0 + usual, float(final.upper[0]))
    return np.array([t0, tf])


def end_values(leg: Phase) -> tuple[Array, Array]:
    """Return guessed initial and final states; a free end takes the value of the other one.

    States that are free at both ends stay where a link takes them from, if one does.
    """
    numbers = leg.numbers
    values = []
    for here, there in ((numbers.initial, numbers.final), (numbers.final, numbers.initial)):
        box, other = intersect(here, numbers.states), intersect(there, numbers.states)
        open_here = ~np.isfinite(here.lower) & ~np.isfinite(here.upper)
        known_there = np.isfinite(there.lower) | np.isfinite(there.upper)
        values.append(np.where(open_here & known_there, other.middle, box.middle))
    _hand_over(leg, *values)
    return values[0], values[1]


def _hand_over(leg: Phase, first: Array, last: Array) -> None:
    """Write the guessed ends of earlier phases where a state is free at both ends."""
    numbers = leg.numbers
    ends = np.stack([numbers.initial.lower, numbers.initial.upper, numbers.final.lower, numbers.final.upper])
    free = np.all(~np.isfinite(ends), axis=0)
    for variable in leg.model.states.variables:
        rows, handed = leg.model.states.slice(variable.name), leg.handed_over(variable.name)
        if handed is None or not np.all(free[rows]):
            continue
        before, jump = handed
        end = start_phase(before, np.ones(1), perturbed=False).states[
            before.model.states.slice(variable.name), 0
        ]
        box = numbers.states
        first[rows] = last[rows] = np.clip(end + jump, box.lower[rows], box.upper[rows])


def perturbation(bounds: Interval, fractions: Array) -> Array:
    """Return the control perturbation, shape (m, N)."""
    ranges = bounds.upper - bounds.lower
    amplitude = PERTURBATION * np.where(np.isfinite(ranges), ranges, 1.0)
    channel = 1.0 + np.arange(ranges.size)
    phase = 2 * np.pi * (np.outer(1 + channel % 3, fractions) + (_GOLDEN * channel)[:, None])
    return np.asarray(amplitude[:, None] * np.cos(phase))


def _time_in(interval: Interval, wanted: float, default: float) -> float:
    lower, upper = float(interval.lower[0]), float(interval.upper[0])
    if lower == upper:
        return lower
    if np.isfinite(wanted):
        return float(np.clip(wanted, lower, upper))
    if np.isfinite(lower) and np.isfinite(upper):
        return 0.5 * (lower + upper)
    return float(np.clip(default, lower, upper))
