"""Measured initial states slightly beyond a bound, as estimated on an active state constraint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import ROUNDING
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem

START_EXCESS_MAX_SHARE = 0.02
"""Largest violation, as a share of the state's range (or of its single bound), that is moved to the bound."""


def clip_initial_states_to_bounds(problem: Problem) -> tuple[Problem, str]:
    """Return a problem with initial states slightly beyond a bound moved to it, and a description of these states.

    Parameters
    ----------
    problem : Problem

    Returns
    -------
    Problem
        The given problem if no state is changed.
    str
        For example ``v = 0.7 (given 0.0003 beyond)``; empty if no state is changed.
    """
    clipped, texts = problem, list[str]()
    for name, phase in problem.phases.items():
        lower, indices = _clip_initial_states_of_phase(phase)
        if indices:
            clipped = clipped.clone()
            upper = np.where(phase.numbers.initial.is_fixed, lower, phase.numbers.initial.upper)
            clipped.get_phase(name).numbers = replace(phase.numbers, initial=Interval(lower, upper))
            for i in indices:
                excess = abs(float(phase.numbers.initial.lower[i] - lower[i]))
                texts.append(f"{phase.model.states.labels[i]} = {lower[i]:.7g} (given {excess:.2g} beyond)")
    return clipped, ", ".join(texts)


def _clip_initial_states_of_phase(phase: Phase) -> tuple[Array, list[int]]:
    """Return lower limits of the initial states (n,), and the indices of the states moved to a bound.

    Violations at rounding level are not changed.
    """
    box, initial = phase.numbers.states, phase.numbers.initial
    width, size = box.upper - box.lower, np.where(np.isfinite(box.lower), box.lower, box.upper)
    scale = np.where(np.isfinite(width), width, np.where(np.isfinite(size), np.abs(size), 0.0))
    fixed = np.where(initial.is_fixed, initial.lower, 0.0)
    clipped = np.clip(fixed, box.lower, box.upper)
    excess = np.where(initial.is_fixed, np.abs(fixed - clipped), 0.0)
    slightly = (excess > ROUNDING * (1.0 + np.abs(clipped))) & (excess <= START_EXCESS_MAX_SHARE * scale)
    return np.where(slightly, clipped, initial.lower), [int(i) for i in np.flatnonzero(slightly)]
