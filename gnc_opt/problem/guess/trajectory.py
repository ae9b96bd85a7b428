"""Starting trajectories: what the user knows, and straight lines for the rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.model.composed import VectorControl
from gnc_opt.model.model import Model
from gnc_opt.problem.guess.balance import balanced
from gnc_opt.problem.guess.ends import end_values, guess_times
from gnc_opt.problem.guess.values import sample_guess
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.phase import Phase

PERTURBATION = 0.01
"""Amplitude of the control perturbation of the default guess, as a fraction of the control's range.

A guess on a plane of symmetry can be a saddle of the problem (the planar rendezvous is one), from which
Newton's method cannot leave; the perturbation is smooth, deterministic and independent of the mesh."""

SUSTAINED = 0.2
"""Share of what a vector control can give from which on the straight line between the ends asks for it all along."""

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
        _aim(leg, vector, times, (first, last), controls)
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


def _aim(leg: Phase, vector: VectorControl, times: Array, ends: tuple[Array, Array], controls: Array) -> None:
    """Let a vector control, at all times, be what half way between the ends the rate from one to the other asks for.

    Where that is sustained thrust. If it is more than the vector can give, no flight is near to the straight line; if
    it is little, pulses will do, and nothing is told of when.
    """
    layout, (first, last), duration = leg.model.controls, ends, times[1] - times[0]
    if leg.on_sphere(vector):  # at its centre the derivatives of the sphere vanish
        controls[layout.slice(vector.direction)] = vector.variable.size**-0.5
    if duration <= 0 or controls.shape[1] == 0:
        return
    rate, place = (last - first) / duration, layout.slice(vector.magnitude)
    found = balanced(leg, vector, float(np.mean(times)), 0.5 * (first + last), controls[:, 0], rate)
    box = leg.numbers.controls
    most = float(box.upper[place][0])
    if found is not None and np.isfinite(most) and SUSTAINED * most <= found[0] <= most:
        controls[place] = max(found[0], float(box.lower[place][0]))
        controls[layout.slice(vector.direction)] = found[1][:, None]


def put_control(model: Model, controls: Array, name: str, values: Array) -> None:
    """Write values (size, N) of one control into those of all (m, N); of a composed one, into those of its parts."""
    composed = model.composed_controls.get(name)
    if composed is None:
        controls[model.controls.slice(name)] = values
        return
    for part, own in zip(composed.parts, composed.decompose(values), strict=True):
        place = model.controls.slice(part)
        controls[place] = np.where(np.isnan(own), controls[place], own)


def perturbation(bounds: Interval, fractions: Array) -> Array:
    """Return the control perturbation, shape (m, N)."""
    ranges = bounds.upper - bounds.lower
    amplitude = PERTURBATION * np.where(np.isfinite(ranges), ranges, 1.0)
    channel = 1.0 + np.arange(ranges.size)
    phase = 2 * np.pi * (np.outer(1 + channel % 3, fractions) + (_GOLDEN * channel)[:, None])
    return np.asarray(amplitude[:, None] * np.cos(phase))
