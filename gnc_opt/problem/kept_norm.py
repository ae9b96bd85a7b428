"""Vectors of states whose length the dynamics keep: unit quaternions, directions, spinning momenta.

A bound that no vector of that length passes says nothing. Yet a quaternion that begins at rest, (1, 0, 0, 0), with
bounds of 1 begins on a bound, whose gradient is that of the length: no step leads to the inside, and an interior point
method, which lives there, wanders for thousands of iterations. Such bounds are dropped. (Wider ones leave an inside.)
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Indices, Mask
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.statement import Statement

PLACES, SEED = 8, 5
"""Points at random on the sphere, with other states and controls at random, at which the length has no rate: what
vanishes at them vanishes everywhere, but for functions made to deceive."""

ROUNDING = 1e-12
"""Share of its terms within which a rate is none, and of a length by which a bound may fall short of it."""

ROOM = 1e-2
"""Share of a length by which a bound of it may exceed it."""


def idle_bounds(problem: Statement, leg: Phase) -> tuple[Mask, Mask]:
    """Return which lower and which upper bounds of states are the length that a vector of them keeps.

    Vectors are those that are declared as such, and what scalars that share their bounds make together.
    """
    idle = np.zeros((2, leg.model.states.size), dtype=bool)
    bounds = leg.numbers.states
    for places in _vectors(leg):
        length = _first_length(leg, places)
        least, most = length * (1.0 - ROUNDING), length * (1.0 + ROOM)
        below, above = -bounds.lower[places], bounds.upper[places]
        lower, upper = (least <= below) & (below <= most), (least <= above) & (above <= most)
        if length > 0 and np.any(lower | upper) and _kept(problem, leg, places, length):
            idle[0, places], idle[1, places] = lower, upper
    return idle[0], idle[1]


def _vectors(leg: Phase) -> list[Indices]:
    """Return the places of the vectors among the states; of scalars those with the same bounds to both sides."""
    states, bounds = leg.model.states, leg.numbers.states
    found, alike = [], dict[float, list[int]]()
    for variable in states.variables:
        places = np.arange(states.size)[states.slice(variable.name)]
        if places.size > 1:
            found.append(places)
        elif np.isfinite(bounds.upper[places[0]]) and bounds.lower[places[0]] == -bounds.upper[places[0]]:
            alike.setdefault(float(bounds.upper[places[0]]), []).append(int(places[0]))
    return found + [np.array(places) for places in alike.values() if len(places) > 1]


def _first_length(leg: Phase, places: Indices) -> float:
    """Return the length that a vector begins with, here or in a phase that hands it over; NaN if that is open."""
    for value in (leg.numbers.initial, leg.numbers.final):
        if np.all(value.fixed[places]):
            return float(np.linalg.norm(value.lower[places]))
    names = {name for name in leg.model.states.names if np.isin(places, _places(leg, name)).any()}
    if len(names) != 1:
        return np.nan
    (name,) = names
    before, jump = leg.handed_over(name) or (None, np.zeros(0))
    return np.nan if before is None or np.any(jump) else _first_length(before, _places(before, name))


def _places(leg: Phase, name: str) -> Indices:
    return np.arange(leg.model.states.size)[leg.model.states.slice(name)]


def _kept(problem: Statement, leg: Phase, places: Indices, length: float) -> bool:
    """Whether a vector of a length has no rate along itself, whatever everything else is."""
    terms = problem.once(
        ("rate along itself", leg.name, places.tobytes()), lambda: _terms(problem, leg, places)
    )
    random = np.random.default_rng(SEED)
    free = problem.parameter_interval().lower.size
    for _ in range(PLACES):
        x = random.uniform(0.5, 1.5, leg.model.states.size)
        x[places] = random.standard_normal(places.size)
        x[places] *= length / np.linalg.norm(x[places])
        u = random.uniform(0.5, 1.5, leg.model.controls.size)
        t, q = random.uniform(0.5, 1.5), random.uniform(0.5, 1.5, free)
        values = np.asarray(terms(t, x, u, leg.model.parameter_values, q)).ravel()
        if not abs(values.sum()) <= ROUNDING * np.abs(values).sum():
            return False
    return True


def _terms(problem: Statement, leg: Phase, places: Indices) -> Any:
    """Return the products of a vector's components and their rates, as a function."""
    t, x, u, p = leg.model.arguments()
    rows = places.tolist()
    rates = problem.bind(leg, leg.model.derivative())
    products = ca.densify(x[rows] * rates[rows])
    return ca.Function("along_itself", [t, x, u, p, problem.parameter_symbols()], [products])
