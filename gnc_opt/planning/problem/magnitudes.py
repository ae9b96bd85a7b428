"""Typical magnitudes of the states and controls of a phase."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array, Mask
from gnc_opt.model.evaluation import evaluate
from gnc_opt.model.variables import Layout
from gnc_opt.planning.problem.guess.initial_guess import PhaseStart, phase_guess
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.tolerances import ROUNDING

SIZES = np.logspace(-8, 12, 161)
"""Trial magnitudes: eight per decade."""


def path_reach(leg: Phase, times: Array, start: PhaseStart, wanted: Mask) -> Array:
    """Return the typical control magnitude (m,) that path constraints allow ``wanted`` (m,) ones, 0 for others.

    It is the smallest size, of either sign, beyond which a constraint satisfied at zero control is violated, at the
    guessed state where that size is largest.
    """
    reach, box = np.zeros(wanted.size), leg.path_interval()
    if not leg.paths or not np.any(wanted):
        return reach
    function = leg.once("paths", lambda: _path_function(leg))
    n = times.size
    for i in np.flatnonzero(wanted):
        trials = np.concatenate([[0.0], SIZES, -SIZES])
        controls = np.zeros(
            (wanted.size, trials.size, n)
        )  # not as guessed: on a sphere no component moves alone
        controls[i] = trials[:, None]
        values = evaluate(
            function,
            np.tile(times, trials.size),
            np.tile(start.states, trials.size),
            controls.reshape(wanted.size, -1),
            leg.model.parameter_values,
        ).reshape(box.lower.size, trials.size, n)
        broken = (values < box.lower[:, None, None]) | (values > box.upper[:, None, None])
        later = np.any(broken & ~broken[:, :1], axis=0)[1:]
        sizes = np.min(np.where(later, np.tile(SIZES, 2)[:, None], np.inf), axis=0)
        reach[i] = max(sizes[(sizes > SIZES[0]) & np.isfinite(sizes)], default=0.0)
    return reach


def _path_function(leg: Phase) -> Any:
    """A function of (t, x, u, p) to all path constraints, NaN where they are of free parameters, too."""
    arguments = leg.model.arguments()
    expression = leg.path_expression()
    own = {s.element_hash() for a in arguments for s in ca.vertsplit(a)}
    foreign = [s for s in ca.symvar(expression) if s.element_hash() not in own]
    if foreign:
        expression = ca.substitute(expression, ca.vertcat(*foreign), ca.SX.nan(len(foreign)))
    return ca.Function("paths", [*arguments], [ca.densify(expression)])


UNBOUNDED_STATE_MAX_RATIO = 10.0
"""How much larger than its guess a state without bounds may be taken to be."""

SAMPLES = np.linspace(0.0, 1.0, 9)
"""Where guess and dynamics are looked at, as fractions of a phase."""

CANCELLATION_SHARE = 1e-3
"""Share of the effect of one control alone below which several, all at their bounds, cancel each other."""

GUESS_OFFSET_SHARE = 0.01
"""Displacement from the guess, as a share of each state's magnitude there."""


def phase_magnitudes(leg: Phase, *, overridden: bool = True) -> tuple[Array, Array]:
    """Return typical magnitudes of states (n,) and controls (m,) of a phase.

    The first of: the user's scale, the nominal value, finite bounds, the guess; for controls without any, what path
    constraints allow; for states, how far the dynamics move them, at most `UNBOUNDED_STATE_MAX_RATIO` times the guess.
    """
    start = phase_guess(leg, SAMPLES, perturbed=False)
    numbers = leg.numbers
    controls = typical_magnitudes(numbers.controls, _control_reach(leg, start))
    if overridden:
        _apply_given_scales(controls, leg.model.controls, numbers.scales)
    reach = np.max(np.abs(start.states), axis=1, initial=0.0)
    drift = _state_motion(leg, start, controls)
    beside = _state_motion(
        leg, replace(start, states=start.states + GUESS_OFFSET_SHARE * reach[:, None]), controls
    )
    drift = np.where(drift > ROUNDING * beside, drift, beside)
    reach = np.where(
        reach > ROUNDING * beside, np.clip(drift, reach, UNBOUNDED_STATE_MAX_RATIO * reach), drift
    )
    states = typical_magnitudes(numbers.states, reach)
    if overridden:
        _apply_given_scales(states, leg.model.states, numbers.scales)
    return states, controls


def _control_reach(leg: Phase, start: PhaseStart) -> Array:
    """Return how large controls are guessed to be, or may be if the guess does not say, (m,)."""
    guessed, bounds = np.max(np.abs(start.controls), axis=1, initial=0.0), leg.numbers.controls
    bounded = np.isfinite(bounds.lower) & np.isfinite(bounds.upper)
    times = start.times[0] + SAMPLES * (start.times[1] - start.times[0])
    return np.where(guessed > 0, guessed, path_reach(leg, times, start, ~bounded & (guessed == 0)))


def _state_motion(leg: Phase, start: PhaseStart, magnitudes: Array) -> Array:
    """Return how far the dynamics move each state: controls at their bounds, as guessed, or else of their magnitude."""
    bounds = leg.numbers.controls
    times = start.times[0] + SAMPLES * (start.times[1] - start.times[0])
    rates = [np.zeros(leg.model.states.size)]
    guessed = np.any(start.controls != 0, axis=1)
    for limit, usual in ((bounds.lower, -magnitudes), (bounds.upper, magnitudes)):
        endless = np.where(guessed[:, None], start.controls, usual[:, None])
        controls = np.where(np.isfinite(limit)[:, None], limit[:, None], endless)
        f = evaluate(leg.model.function, times, start.states, controls, leg.model.parameter_values)
        rates.append(np.max(np.abs(np.where(np.isfinite(f), f, 0.0)), axis=1))
    together, alone = np.max(rates, axis=0), _motion_by_control(leg, start, times, magnitudes)
    rate = np.where(together > CANCELLATION_SHARE * alone, together, alone)
    return np.asarray(0.5 * rate * (start.times[1] - start.times[0]))


def _motion_by_control(leg: Phase, start: PhaseStart, times: Array, magnitudes: Array) -> Array:
    """Return by how much one control alone, of its magnitude, changes the rate of each state at most, (n,)."""
    count, base = magnitudes.size, start.controls
    moved = np.hstack([base + change[:, None] for change in (0.0 * magnitudes, *np.diag(magnitudes))])
    f = evaluate(
        leg.model.function,
        np.tile(times, count + 1),
        np.tile(start.states, count + 1),
        moved,
        leg.model.parameter_values,
    )
    f = np.where(np.isfinite(f), f, 0.0).reshape(len(f), count + 1, times.size)
    return np.asarray(np.max(np.abs(f[:, 1:] - f[:, :1]), axis=(1, 2), initial=0.0))


def typical_magnitudes(interval: Interval, reach: Array) -> Array:
    """Return typical magnitudes: the larger of two finite bounds, else the reach, else 1."""
    bounded = np.isfinite(interval.lower) & np.isfinite(interval.upper)
    limits = np.maximum(
        np.abs(np.where(bounded, interval.lower, 0.0)), np.abs(np.where(bounded, interval.upper, 0.0))
    )
    scales = np.where(bounded & (limits > 0), limits, reach)
    return np.where(scales > 0, scales, 1.0)


def _apply_given_scales(scales: Array, layout: Layout, user: Mapping[str, Array]) -> None:
    for variable in layout.variables:
        if variable.name in user:
            scales[layout.slice(variable.name)] = user[variable.name]
        elif variable.nominal is not None:
            scales[layout.slice(variable.name)] = variable.nominal
