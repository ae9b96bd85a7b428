"""Curved initial guesses that avoid singularities of functions and their derivatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from gnc_opt.array_types import GOLDEN_RATIO_FRACTION, Array
from gnc_opt.planning.problem.differentiability_checks import find_nonfinite_function_at_guess
from gnc_opt.planning.problem.guess.initial_guess import build_phase_guess
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.scaling_magnitudes import estimate_state_and_control_magnitudes

MIDPOINT_SHIFT_SHARE = 0.1
"""Displacement of a curved guess at its midpoint, as a share of each state's magnitude."""

FRACTIONS = np.linspace(0.0, 1.0, 33)

P = TypeVar("P", bound=ProblemData)


def with_curved_guess(problem: P) -> P:
    """Return the problem with curved guesses in phases where they make all functions finite; user guesses are kept."""
    for name, phase in problem.phases.items():
        if find_nonfinite_function_at_guess(problem, phase) is None:
            continue
        variation = problem.clone()
        variation.phases[name].guess(**_add_sine_to_state_guess(phase))
        if find_nonfinite_function_at_guess(variation, variation.phases[name]) is None:
            problem = variation
    return problem


def _add_sine_to_state_guess(phase: Phase) -> dict[str, Any]:
    start, layout, box = build_phase_guess(phase, FRACTIONS), phase.model.states, phase.numbers.states
    # Different shares, since r = (a, a) may be singular as well.
    share = MIDPOINT_SHIFT_SHARE * np.cos(2 * np.pi * GOLDEN_RATIO_FRACTION * (1 + np.arange(layout.size)))
    states = start.states + (estimate_state_and_control_magnitudes(phase)[0] * share)[:, None] * np.sin(
        np.pi * FRACTIONS
    )
    states = np.clip(states, box.lower[:, None], np.maximum(box.lower, box.upper)[:, None])
    times = start.times[0] + FRACTIONS * (start.times[1] - start.times[0])

    def build_linear_interpolant(rows: Array) -> Callable[[Array], Array]:
        return lambda t: np.array([np.interp(t, times, row) for row in rows])

    unguessed = [name for name in layout.names if name not in phase.numbers.guess.values]
    return {name: build_linear_interpolant(states[layout.slice(name)]) for name in unguessed}
