"""Measured starts: initial states that are slightly beyond a bound, as estimates along a limit are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem

START_EXCESS_MAX_SHARE = 0.02
"""Share of the range of a state (of its bound, where there is only one) by which a start beyond it counts as on it."""


def with_start_on_bounds(problem: Problem) -> tuple[Problem, str]:
    """Return a problem with given initial states that are slightly beyond a bound on it, and which they are.

    Parameters
    ----------
    problem : Problem

    Returns
    -------
    Problem
        The given one if no state is.
    str
        Such as ``v = 0.7 (given 0.7003)``; empty if no state is.
    """
    moved, texts = problem, list[str]()
    for name, leg in problem.phases.items():
        kept, places = _start_on_bounds(leg)
        if places:
            moved = moved.clone()
            upper = np.where(leg.numbers.initial.fixed, kept, leg.numbers.initial.upper)
            moved.get_phase(name).numbers = replace(leg.numbers, initial=Interval(kept, upper))
            given = leg.numbers.initial.lower
            texts += [f"{leg.model.states.labels[i]} = {kept[i]:.7g} (given {given[i]:.7g})" for i in places]
    return moved, ", ".join(texts)


def _start_on_bounds(leg: Phase) -> tuple[Array, list[int]]:
    """Return initial states of a phase with those slightly beyond a bound on it, and the places of these."""
    box, initial = leg.numbers.states, leg.numbers.initial
    width, sizes = (
        box.upper - box.lower,
        np.where(np.isfinite(box.lower), np.abs(box.lower), np.abs(box.upper)),
    )
    slack = START_EXCESS_MAX_SHARE * np.where(
        np.isfinite(width), width, np.where(np.isfinite(sizes), sizes, 0.0)
    )
    given = np.where(initial.fixed, initial.lower, 0.0)
    kept = np.clip(given, box.lower, box.upper)
    excess = np.where(initial.fixed, np.abs(given - kept), 0.0)
    places = [int(i) for i in np.flatnonzero((excess > 0) & (excess <= slack))]
    return np.where(np.isin(np.arange(kept.size), places), kept, initial.lower), places
