"""Guessed ends of phases: when they begin and end, and the straight lines that states follow along linked phases."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.problem.guess.values import sample_guess
from gnc_opt.problem.interval import Interval, intersect
from gnc_opt.problem.phase import Phase


def guess_times(leg: Phase) -> Array:
    """Return guessed initial and final time, shape (2,).

    A phase whose start is linked to the end of another one begins there. An end of which nothing is told shares the
    time up to the next one of which something is, evenly with the phases in between.
    """
    known = leg.numbers.guess.time
    wanted = np.array([np.nan, np.nan]) if known is None else known[[0, -1]]
    initial, final = leg.times()
    before, after = leg.in_time
    if before is not None and np.isnan(wanted[0]):
        wanted[0] = guess_times(before)[1]
    t0 = _time_in(initial, wanted[0], default=0.0)
    span = leg.numbers.duration
    least = max(float(span.lower[0]), 0.0)
    usual = least if least > 0 else 1.0
    if np.isnan(wanted[1]) and after is not None and not _is_told(final):
        usual = _share(after, t0) or usual
    tf = _time_in(final, wanted[1], default=t0 + usual)
    if tf <= t0 and not final.fixed[0]:
        tf = min(t0 + usual, float(final.upper[0]))
    return np.array([t0, tf])


def _is_told(time: Interval) -> bool:
    return bool(np.isfinite(time.lower[0]) and np.isfinite(time.upper[0]))


def _share(leg: Phase | None, start: float) -> float:
    """Return what each phase takes of the time from a start, in the phase before a given one, to the next end told."""
    phases = 1
    while leg is not None:
        phases += 1
        own, final = leg.numbers.guess.time, leg.times()[1]
        if own is not None or _is_told(final):
            end = float(own[-1]) if own is not None else float(final.middle[0])
            return max(end - start, 0.0) / phases
        leg = leg.in_time[1]
    return 0.0


def _time_in(interval: Interval, wanted: float, default: float) -> float:
    lower, upper = float(interval.lower[0]), float(interval.upper[0])
    if lower == upper:
        return lower
    if np.isfinite(wanted):
        return float(np.clip(wanted, lower, upper))
    if np.isfinite(lower) and np.isfinite(upper):
        return 0.5 * (lower + upper)
    return float(np.clip(default, lower, upper))


def end_values(leg: Phase) -> tuple[Array, Array]:
    """Return guessed initial and final states, each (n,).

    A state that is open at an end is what boundary constraints tell of it there, or else on a straight line between the
    next values that are known before and after it, in this phase or in those that links join to it; beyond the first
    and the last one it stays. Where none is known it is in the middle of its bounds.
    """
    first, last = np.zeros((2, leg.model.states.size))
    for name in leg.model.states.names:
        rows = leg.model.states.slice(name)
        first[rows], last[rows] = _along(_chain(leg, name), leg)
    return first, last


@dataclass(frozen=True, eq=False)
class _Link:
    """A state in one phase of a chain: what is known at its ends (NaN: nothing), its bounds, and the jump into it."""

    leg: Phase
    start: Array
    end: Array
    box: Interval
    duration: float
    jump: Array

    @classmethod
    def of(cls, leg: Phase, name: str) -> _Link:
        numbers, rows, times = leg.numbers, leg.model.states.slice(name), guess_times(leg)
        box = Interval(numbers.states.lower[rows], numbers.states.upper[rows])
        guess = np.full((box.lower.size, 2), np.nan)
        if name in numbers.guess.values:
            what = f"the guess of '{name}' in {leg.where}"
            value, ends = numbers.guess.values[name], np.array([0.0, 1.0])
            guess = sample_guess(value, box.lower.size, times, ends, numbers.guess.time, what)
        known = []
        for end, stated, guessed in zip(
            ("initial", "final"), (numbers.initial, numbers.final), guess.T, strict=True
        ):
            here = Interval(stated.lower[rows], stated.upper[rows])
            limited = np.isfinite(here.lower) | np.isfinite(here.upper)
            told = np.clip(leg.told.get((end, name), np.full_like(guessed, np.nan)), box.lower, box.upper)
            open_end = np.where(np.isnan(guessed), told, guessed)
            known.append(np.where(limited, intersect(here, box).middle, open_end))
        handed = leg.handed_over(name)
        jump = np.zeros(box.lower.size) if handed is None else handed[1]
        return cls(leg, known[0], known[1], box, float(times[1] - times[0]), jump)


def _chain(leg: Phase, name: str) -> list[_Link]:
    """Return the phases that links join to one in a state, in their order."""
    chain = [leg]
    while handed := chain[0].handed_over(name):
        chain.insert(0, handed[0])
    while following := [p for p in leg.siblings if (p.handed_over(name) or (None,))[0] is chain[-1]]:
        chain.append(following[0])
    return [_Link.of(phase, name) for phase in chain]


def _along(chain: list[_Link], leg: Phase) -> tuple[Array, Array]:
    """Return the guessed ends of a state in one phase of a chain."""
    first = last = np.full_like(chain[0].start, np.nan)
    for index, link in enumerate(chain):
        ahead, time = _ahead(chain[index:])
        begin = np.where(np.isnan(last), ahead, last + link.jump)
        begin = np.where(np.isnan(begin), link.box.middle, np.clip(begin, link.box.lower, link.box.upper))
        first = np.where(np.isnan(link.start), begin, link.start)
        share = np.divide(link.duration, time, out=np.ones_like(time), where=time > 0)
        reached = np.where(np.isnan(ahead), first, first + share * (ahead - first))
        reached = np.clip(reached, link.box.lower, link.box.upper)
        last = np.where(np.isnan(link.end), reached, link.end)
        if link.leg is leg:
            break
    return first, last


def _ahead(chain: list[_Link]) -> tuple[Array, Array]:
    """Return the next known value after the start of a chain, without the jumps up to it, and in what time it comes."""
    value, time = np.full_like(chain[-1].end, np.nan), np.zeros(chain[-1].end.size)
    for link, later in zip(reversed(chain), (None, *reversed(chain[1:])), strict=True):
        if later is not None:
            here = ~np.isnan(later.start)
            value = np.where(here, later.start, value) - later.jump
            time = np.where(here, 0.0, time)
        here = ~np.isnan(link.end)
        value, time = np.where(here, link.end, value), np.where(here, 0.0, time) + link.duration
    return value, time
