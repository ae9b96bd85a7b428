"""Redundant bounds: bounds of components of constant-length vectors, and bounds of monotone states.

At the unit quaternion (1, 0, 0, 0) the bound 1 and the length have the same gradient. The bound of a monotone state at
one end of a phase implies the bound in between, whose multiplier is then not unique.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array, Indices, Mask
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.interval_arithmetic import compute_ranges
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.problem_expressions import build_phase_function
from gnc_opt.tolerances import NOTABLE, ROUNDING

LOOSE = 0.1
"""Share of a state's bounds and initial value by which redundant bounds are relaxed."""


def loosen_bounds(leg: Phase) -> Interval:
    """Return slightly relaxed bounds of the states of a phase."""
    bounds, initial = leg.numbers.states, leg.numbers.initial
    reach = np.abs([bounds.lower, bounds.upper, initial.lower, initial.upper])
    room = LOOSE * np.max(np.where(np.isfinite(reach), reach, 0.0), axis=0)
    return Interval(bounds.lower - room, bounds.upper + room)


def find_monotone_states(problem: ProblemData, leg: Phase) -> tuple[Mask, Mask]:
    """Return which bounded states never decrease and which never increase, for all controls and `loosen_bounds`."""
    numbers = leg.numbers
    bounded = np.isfinite(numbers.states.lower) | np.isfinite(numbers.states.upper)
    rows, rates = problem.cache(
        ("rates by controls", leg.name), lambda: _build_control_dependent_rates(problem, leg)
    )
    if not np.any(bounded[rows]):
        return _make_empty_mask(leg), _make_empty_mask(leg)
    values, times = leg.model.parameter_values, leg.time_ranges()
    ranges = [
        Interval(times[0].lower, times[1].upper),
        loosen_bounds(leg),
        numbers.controls,
        Interval(values, values),
        problem.parameter_interval(),
    ]
    asked = (bounded.tobytes(), *(end.tobytes() for box in ranges for end in (box.lower, box.upper)))
    place = ("one way", leg.name)
    known: tuple[Any, Mask, Mask] | None = problem.builds.get(place)
    if known is None or known[0] != asked:
        rising, falling, rate = _make_empty_mask(leg), _make_empty_mask(leg), compute_ranges(rates, ranges)
        rising[rows], falling[rows] = bounded[rows] & (rate.lower == 0), bounded[rows] & (rate.upper == 0)
        problem.builds[place] = known = (asked, rising, falling)
    return known[1:]


def _make_empty_mask(leg: Phase) -> Mask:
    return np.zeros(leg.model.states.size, dtype=bool)


def _build_control_dependent_rates(problem: ProblemData, leg: Phase) -> tuple[Array, Any]:
    rates = leg.model.derivative()
    rows = np.unique(np.array(ca.jacobian_sparsity(rates, leg.model.symbols("control")).row(), dtype=int))
    return rows, build_phase_function(problem, leg, "rates", rates[rows.tolist()])


def find_implied_bounds(problem: ProblemData, leg: Phase) -> tuple[Mask, Mask]:
    """Return which lower and upper bounds of states (n_states,) are implied by the constant length of a vector."""
    idle = np.zeros((2, leg.model.states.size), dtype=bool)
    bounds = leg.numbers.states
    for places in _group_vector_states(leg):
        length = _find_vector_length_at_end(leg, places)
        least, most = length * (1.0 - ROUNDING), length * (1.0 + NOTABLE)
        below, above = -bounds.lower[places], bounds.upper[places]
        lower, upper = (least <= below) & (below <= most), (least <= above) & (above <= most)
        if length > 0 and np.any(lower | upper) and _is_vector_norm_constant(problem, leg, places, length):
            idle[0, places], idle[1, places] = lower, upper
    return idle[0], idle[1]


def _group_vector_states(leg: Phase) -> list[Indices]:
    """Return the indices of state vectors; scalar states with equal symmetric bounds form a vector."""
    states, bounds = leg.model.states, leg.numbers.states
    found, alike = [], dict[float, list[int]]()
    for variable in states.variables:
        places = np.arange(states.size)[states.slice(variable.name)]
        if places.size > 1:
            found.append(places)
        elif np.isfinite(bounds.upper[places[0]]) and bounds.lower[places[0]] == -bounds.upper[places[0]]:
            alike.setdefault(float(bounds.upper[places[0]]), []).append(int(places[0]))
    return found + [np.array(places) for places in alike.values() if len(places) > 1]


def _find_vector_length_at_end(leg: Phase, places: Indices) -> float:
    """Return the length of a vector at a fixed end of the phase; NaN if neither end is fixed."""
    for value in (leg.numbers.initial, leg.numbers.final):
        if np.all(value.is_fixed[places]):
            return float(np.linalg.norm(value.lower[places]))
    return np.nan


def _is_vector_norm_constant(problem: ProblemData, leg: Phase, places: Indices, length: float) -> bool:
    """Return whether the length of a vector is constant for all values of the other variables."""

    def build_length_rate_function() -> Any:
        rows = places.tolist()
        products = leg.model.symbols("state")[rows] * leg.model.derivative()[rows]
        return build_phase_function(problem, leg, "along_itself", products)

    terms = problem.cache(("rate along itself", leg.name, places.tobytes()), build_length_rate_function)
    random = np.random.default_rng(5)
    free = problem.parameter_interval().lower.size
    for _ in range(8):
        x = random.uniform(0.5, 1.5, leg.model.states.size)
        x[places] = random.standard_normal(places.size)
        x[places] *= length / np.linalg.norm(x[places])
        u = random.uniform(0.5, 1.5, leg.model.controls.size)
        t, q = random.uniform(0.5, 1.5), random.uniform(0.5, 1.5, free)
        values = np.asarray(terms(t, x, u, leg.model.parameter_values, q)).ravel()
        if not abs(values.sum()) <= ROUNDING * np.abs(values).sum():
            return False
    return True
