"""Default initial guess: states linear between known ends of linked phases, controls at the middle of their range."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import GOLDEN_RATIO_FRACTION, Array
from gnc_opt.model.split_and_magnitude_direction_controls import VectorControl
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.planning.problem.bounds import Interval, intersect_bounds
from gnc_opt.planning.problem.constraints import Constraint
from gnc_opt.planning.problem.guess.guess_evaluation import sample_guess
from gnc_opt.planning.problem.phase import Phase

PERTURBATION_SHARE = 0.01
"""Amplitude of the control perturbation of the default guess, as a share of the range; breaks symmetries."""

SUSTAINED = 0.2
"""Share of a vector control's limit above which the linear trajectory requires sustained control."""


@dataclass(frozen=True)
class SampledGuess:
    """Guess of a phase at given fractions: times (2,), states (n, N) and controls (m, N)."""

    times: Array
    states: Array
    controls: Array


def build_phase_guess(phase: Phase, fractions: Array, *, perturbed: bool = True) -> SampledGuess:
    """Return the guess of a phase at fractions of its duration, optionally with `build_control_perturbation`."""
    times = guess_phase_times(phase)
    t = times[0] + fractions * (times[1] - times[0])
    model, numbers = phase.model, phase.numbers
    first, last = guess_boundary_states(phase)
    states = first[:, None] + (last - first)[:, None] * fractions
    controls = np.repeat(numbers.controls.midpoint[:, None], fractions.size, axis=1)
    for vector in phase.vector_controls:
        _guess_constant_vector_control(phase, vector, times, (first, last), controls)
    if perturbed:
        controls += build_control_perturbation(numbers.controls, fractions)
    for name, value in numbers.guess.values.items():
        what = f"the guess of '{name}' in {phase.label}"
        values = sample_guess(value, phase.guessable_names[name].size, t, fractions, numbers.guess.time, what)
        if name in model.states:
            states[model.states.slice(name)] = values
        else:
            set_control_guess(model, controls, name, values)
    return SampledGuess(times, states, controls)


def _guess_constant_vector_control(
    phase: Phase, vector: VectorControl, times: Array, ends: tuple[Array, Array], controls: Array
) -> None:
    """Set a vector control to the constant value with the mean rate between the ends, if large enough and feasible."""
    layout, (first, last), duration = phase.model.controls, ends, times[1] - times[0]
    if phase.has_unit_direction(vector):  # at its centre the derivatives of the sphere vanish
        controls[layout.slice(vector.direction)] = vector.variable.size**-0.5
    if duration <= 0 or controls.shape[1] == 0:
        return
    rate, place = (last - first) / duration, layout.slice(vector.magnitude)
    constant = solve_vector_control_for_rate(
        phase, vector, float(np.mean(times)), 0.5 * (first + last), controls[:, 0], rate
    )
    box = phase.numbers.controls
    largest = float(box.upper[place][0])
    if constant is not None and np.isfinite(largest) and SUSTAINED * largest <= constant[0] <= largest:
        controls[place] = max(constant[0], float(box.lower[place][0]))
        controls[layout.slice(vector.direction)] = constant[1][:, None]


def set_control_guess(model: Model, controls: Array, name: str, values: Array) -> None:
    """Write values (size, N) of a control to all controls (m, N); a composed control sets its parts."""
    composed = model.composed_controls.get(name)
    if composed is None:
        controls[model.controls.slice(name)] = values
        return
    for part, part_values in zip(composed.parts, composed.decompose_control(values), strict=True):
        place = model.controls.slice(part)
        controls[place] = np.where(np.isnan(part_values), controls[place], part_values)


def build_control_perturbation(bounds: Interval, fractions: Array) -> Array:
    """Return the control perturbation, shape (m, N)."""
    ranges = bounds.upper - bounds.lower
    amplitude = PERTURBATION_SHARE * np.where(np.isfinite(ranges), ranges, 1.0)
    channel = 1.0 + np.arange(ranges.size)
    phase = 2 * np.pi * (np.outer(1 + channel % 3, fractions) + (GOLDEN_RATIO_FRACTION * channel)[:, None])
    return np.asarray(amplitude[:, None] * np.cos(phase))


def guess_end_states_from_constraint(
    constraint: Constraint, phases: Iterable[Phase], parameters: Any, guess: Mapping[str, Array]
) -> None:
    """Record end values in phases from constraint rows that are affine in a single end state.

    Free parameters have their guesses; ranges are replaced by their middle, inequalities by their limit.
    """
    owners = {
        symbol.element_hash(): (phase, end, name, i)
        for phase in phases
        for end, state in (("initial", phase.initial_state), ("final", phase.final_state))
        for name in phase.model.states.names
        for i, symbol in enumerate(ca.vertsplit(state(name)))
    }
    parameter_hashes = {symbol.element_hash() for symbol in ca.vertsplit(parameters)}
    numbers = np.concatenate([*guess.values(), np.zeros(0)])
    for row, target in zip(ca.vertsplit(constraint.expression), constraint.interval.midpoint, strict=True):
        symbols = [s for s in ca.symvar(row) if s.element_hash() not in parameter_hashes]
        if len(symbols) != 1 or symbols[0].element_hash() not in owners:
            continue
        slope = ca.jacobian(row, symbols[0])
        if ca.depends_on(slope, symbols[0]):
            continue
        at_zero, rate = (
            float(v) for v in ca.Function("f", [symbols[0], parameters], [row, slope])(0.0, numbers)
        )
        value = (target - at_zero) / rate if rate else np.nan
        if np.isfinite(value):
            phase, end, name, i = owners[symbols[0].element_hash()]
            known_end = phase.known_ends.get(
                (end, name), np.full(phase.model.states[name].size, np.nan)
            ).copy()
            known_end[i] = value
            phase.known_ends[end, name] = known_end


def solve_vector_control_for_rate(
    phase: Phase, vector: VectorControl, time: float, x: Array, u: Array, rate: Array
) -> tuple[float, Array] | None:
    r"""Return magnitude and direction of the vector that best produces a given rate; None if undetermined.

    Solves :math:`f(x, 0) + B T = \dot x` by least squares over the affected rates, scaled by the effects.
    """
    layout, size = phase.model.controls, vector.variable.size

    def evaluate_rates(magnitude: float, direction: Array) -> Array:
        controls = u.copy()
        controls[layout.slice(vector.magnitude)], controls[layout.slice(vector.direction)] = (
            magnitude,
            direction,
        )
        return np.asarray(phase.model.f(time, x, controls))

    axes = np.eye(size)
    with np.errstate(all="ignore"):
        effects = np.stack(
            [0.5 * (evaluate_rates(1.0, axis) - evaluate_rates(1.0, -axis)) for axis in axes], axis=1
        )
        missing = rate - evaluate_rates(0.0, axes[0])
    sizes = np.linalg.norm(effects, axis=1)
    if not (np.all(np.isfinite(effects)) and np.all(np.isfinite(missing)) and np.any(sizes > 0)):
        return None
    rows = sizes > 0
    best = np.linalg.lstsq(effects[rows] / sizes[rows, None], missing[rows] / sizes[rows], rcond=None)[0]
    length = float(np.linalg.norm(best))
    return (length, best / length) if length > 0 else None


def guess_phase_times(phase: Phase) -> Array:
    """Return guessed initial and final time (2,); phases without known end share the time to the next one equally."""
    guess_times = phase.numbers.guess.time
    guessed = np.array([np.nan, np.nan]) if guess_times is None else guess_times[[0, -1]]
    initial, final = phase.time_ranges()
    before, after = _find_phases_linked_in_time(phase)
    if before is not None and np.isnan(guessed[0]):
        guessed[0] = guess_phase_times(before)[1]
    t0 = _choose_boundary_time_guess(initial, guessed[0], default=0.0)
    shortest = float(phase.numbers.duration.lower[0])
    default_duration = shortest if shortest > 0 else 1.0
    if np.isnan(guessed[1]) and after is not None and not _has_bounded_phase_times(final):
        default_duration = _share_time_between_phases(after, t0) or default_duration
    tf = _choose_boundary_time_guess(final, guessed[1], default=t0 + default_duration)
    if tf <= t0 and not final.is_fixed[0]:
        tf = min(t0 + default_duration, float(final.upper[0]))
    return np.array([t0, tf])


def _find_phases_linked_in_time(phase: Phase) -> tuple[Phase | None, Phase | None]:
    index = next(k for k, other in enumerate(phase.all_phases) if other.name == phase.name)
    before = (other for other in phase.all_phases[:index] if other.name == phase.preceding_phase)
    after = (other for other in phase.all_phases[index + 1 :] if other.preceding_phase == phase.name)
    return next(before, None), next(after, None)


def _has_bounded_phase_times(time: Interval) -> bool:
    return bool(np.isfinite(time.lower[0]) and np.isfinite(time.upper[0]))


def _share_time_between_phases(phase: Phase | None, start: float) -> float:
    """Return the equal share, s, of each phase in the time from the previous start to the next known end."""
    phases = 1
    while phase is not None:
        phases += 1
        guess_times, final = phase.numbers.guess.time, phase.time_ranges()[1]
        if guess_times is not None or _has_bounded_phase_times(final):
            end = float(guess_times[-1]) if guess_times is not None else float(final.midpoint[0])
            return max(end - start, 0.0) / phases
        phase = _find_phases_linked_in_time(phase)[1]
    return 0.0


def _choose_boundary_time_guess(interval: Interval, guess: float, default: float) -> float:
    lower, upper = float(interval.lower[0]), float(interval.upper[0])
    if lower == upper:
        return lower
    if np.isfinite(guess):
        return float(np.clip(guess, lower, upper))
    if np.isfinite(lower) and np.isfinite(upper):
        return 0.5 * (lower + upper)
    return float(np.clip(default, lower, upper))


def guess_boundary_states(phase: Phase) -> tuple[Array, Array]:
    """Return guessed initial and final states, each (n,).

    A free end state is interpolated linearly between the nearest known values in linked phases, and extrapolated as a
    constant. Without known values it is the middle of its bounds.
    """
    first, last = np.zeros((2, phase.model.states.size))
    for name in phase.model.states.names:
        rows = phase.model.states.slice(name)
        first[rows], last[rows] = _guess_linked_states(_find_linked_phases(phase, name), phase)
    return first, last


@dataclass(frozen=True, eq=False)
class _LinkedState:
    """State in one phase of a chain: known end values (NaN: unknown), bounds, and the jump at its start."""

    phase: Phase
    start: Array
    end: Array
    box: Interval
    duration: float
    jump: Array

    @classmethod
    def from_phase(cls, phase: Phase, name: str) -> _LinkedState:
        numbers, rows, times = phase.numbers, phase.model.states.slice(name), guess_phase_times(phase)
        box = numbers.states.select_components(rows)
        guess = np.full((box.lower.size, 2), np.nan)
        if name in numbers.guess.values:
            what = f"the guess of '{name}' in {phase.label}"
            value, ends = numbers.guess.values[name], np.array([0.0, 1.0])
            guess = sample_guess(value, box.lower.size, times, ends, numbers.guess.time, what)
        values = []
        for end, end_bounds, guessed in zip(
            ("initial", "final"), (numbers.initial, numbers.final), guess.T, strict=True
        ):
            bounds = end_bounds.select_components(rows)
            limited = np.isfinite(bounds.lower) | np.isfinite(bounds.upper)
            constrained = np.clip(
                phase.known_ends.get((end, name), np.full_like(guessed, np.nan)), box.lower, box.upper
            )
            open_end = np.where(np.isnan(guessed), constrained, guessed)
            values.append(np.where(limited, intersect_bounds(bounds, box).midpoint, open_end))
        link = phase.find_linked_phase(name)
        jump = np.zeros(box.lower.size) if link is None else link[1]
        return cls(phase, values[0], values[1], box, float(times[1] - times[0]), jump)


def _find_linked_phases(phase: Phase, name: str) -> list[_LinkedState]:
    chain = [phase]
    while link := chain[0].find_linked_phase(name):
        chain.insert(0, link[0])
    while following := [
        p for p in phase.all_phases if (p.find_linked_phase(name) or (None,))[0] is chain[-1]
    ]:
        chain.append(following[0])
    return [_LinkedState.from_phase(linked, name) for linked in chain]


def _guess_linked_states(chain: list[_LinkedState], phase: Phase) -> tuple[Array, Array]:
    """Return initial and final values (n,) of a state in one phase of a chain, interpolated between known values."""
    first = last = np.full_like(chain[0].start, np.nan)
    for index, link in enumerate(chain):
        next_known, time_to_next = _find_next_known_linked_state(chain[index:])
        start = np.where(np.isnan(last), next_known, last + link.jump)
        start = np.where(np.isnan(start), link.box.midpoint, np.clip(start, link.box.lower, link.box.upper))
        first = np.where(np.isnan(link.start), start, link.start)
        share = np.divide(link.duration, time_to_next, out=np.ones_like(time_to_next), where=time_to_next > 0)
        final = np.where(np.isnan(next_known), first, first + share * (next_known - first))
        final = np.clip(final, link.box.lower, link.box.upper)
        last = np.where(np.isnan(link.end), final, link.end)
        if link.phase is phase:
            break
    return first, last


def _find_next_known_linked_state(chain: list[_LinkedState]) -> tuple[Array, Array]:
    """Return the next known value after the start of a chain, without the jumps before it, and the time to it."""
    value, time = np.full_like(chain[-1].end, np.nan), np.zeros(chain[-1].end.size)
    for link, next_link in zip(reversed(chain), (None, *reversed(chain[1:])), strict=True):
        if next_link is not None:
            is_known = ~np.isnan(next_link.start)
            value = np.where(is_known, next_link.start, value) - next_link.jump
            time = np.where(is_known, 0.0, time)
        is_known = ~np.isnan(link.end)
        value, time = np.where(is_known, link.end, value), np.where(is_known, 0.0, time) + link.duration
    return value, time
