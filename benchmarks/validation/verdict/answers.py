"""Right answers in closed form and, beside each, one that only looks like it: in any units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import gnc_opt as go
from benchmarks.validation.verdict.statements import Array

SCALES = ((1.0, 1.0), (1e4, 1e-6), (1e-4, 1e6))
"""Unit of the states, and factor of the cost."""
T = np.linspace(0.0, 1.0, 61)
"""Samples of a second, or of a share of the way."""
ONE = np.ones(T.size)

Rates: TypeAlias = Callable[..., list[Any]]
Make: TypeAlias = Callable[[float, float, bool], "Answer"]


@dataclass(frozen=True)
class Answer:
    """A trajectory as samples and the problem that it is an answer of; several phases as mappings."""

    problem: go.Problem
    t: Any
    x: Any
    u: Any
    p: Any = None

    def check(self) -> go.Verdict:
        """By `go.verify_trajectory`."""
        return go.verify_trajectory(self.problem, self.t, self.x, self.u, self.p)


@dataclass(frozen=True)
class Case:
    """A solution to check; ``why`` it is wrong is empty if it is correct.

    ``off``: what a wrong one loses, relative to the cost (infinite if there is no least cost), or a relative distance.
    ``first_order``: whether a wrong one violates necessary conditions of first order. If only sufficient ones fail, a
    verdict that claims no more than the former is inconclusive, not a wrong pass.
    """

    kind: str
    name: str
    check: Callable[[], go.Verdict]
    why: str = ""
    off: float | Callable[[], float] = 0.0
    first_order: bool = True

    @property
    def wrong(self) -> bool:
        """Whether the solution is planted as a wrong one."""
        return bool(self.why)


@dataclass(frozen=True)
class Pair:
    """A correct answer and a wrong one: ``make(unit of the states, factor of the cost, whether wrong)``; see `Case`."""

    name: str
    why: str
    off: float
    first_order: bool
    make: Make
    kind: str


class Pairs(list[Pair]):
    """The pairs of a module: each is added by a decorator of the function that makes its answers."""

    def __init__(self, kind: str = "beside a closed form") -> None:
        super().__init__()
        self.kind = kind

    def add(
        self, name: str, why: str, off: float, *, first_order: bool = True, kind: str = ""
    ) -> Callable[[Make], Make]:
        """Return the decorator; the arguments are those of `PlantPair`."""

        def added(make: Make) -> Make:
            self.append(Pair(name, why, off, first_order, make, kind or self.kind))
            return make

        return added


# --- stating a problem ----------------------------------------------------------------------------------


def phase_of(
    problem: go.Problem, name: str, states: str, controls: str, rates: Rates, time: Any
) -> tuple[go.Phase, list[Any], list[Any]]:
    """Return a phase of a model of its own, its states and its controls."""
    model = go.Model(name)
    x, u = [model.state(n) for n in states.split()], [model.control(n) for n in controls.split()]
    model.ode(dict(zip(x, rates(*x, *u), strict=True)))
    leg = problem.phase(name, model)
    leg.time(*time)
    return leg, x, u


def one_phase(
    name: str, states: str, controls: str, rates: Rates, time: Any
) -> tuple[go.Problem, go.Phase, list[Any], list[Any]]:
    """Return a problem of one phase, that phase, its states and its controls."""
    problem = go.Problem(name)
    return problem, *phase_of(problem, "leg", states, controls, rates, time)


def integrator(
    unit: float, time: Any = (0.0, 1.0), start: Any = 0.0, end: Any = None
) -> tuple[go.Problem, go.Phase, Any, Any]:
    """A point on a line, and its speed; the ends are in units, numbers or pairs of bounds, None if they are free."""
    problem, leg, (x,), (u,) = one_phase("line", "x", "u", lambda x, u: [u], time)
    _set_ends(leg, unit, {"x": start}, {"x": end})
    return problem, leg, x, u


def line(
    unit: float, time: Any = (0.0, 1.0), start: Any = 0.0, end: Any = None
) -> tuple[go.Problem, go.Phase, Any, Any]:
    """`integrator` with place and speed in units."""
    problem, leg, x, u = integrator(unit, time, start, end)
    return problem, leg, x / unit, u / unit


def cart(
    unit: float, time: Any, start: Any = (0.0, 0.0), end: Any = (None, None)
) -> tuple[go.Problem, go.Phase, tuple[Any, Any], Any]:
    """A point on a line, its speed, and its acceleration; place and speed at the ends are in units, as of `line`."""
    problem, leg, (q, v), (a,) = one_phase("cart", "q v", "a", lambda q, v, a: [v, a], time)
    _set_ends(leg, unit, dict(zip("qv", start, strict=True)), dict(zip("qv", end, strict=True)))
    return problem, leg, (q, v), a


def _set_ends(leg: go.Phase, unit: float, start: dict[str, Any], end: dict[str, Any]) -> None:
    for fix, values in ((leg.initial, start), (leg.final, end)):
        fix(**{name: _scaled(unit, value) for name, value in values.items() if value is not None})


def _scaled(unit: float, value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(None if bound is None else unit * bound for bound in value)
    return unit * value


def plane(
    unit: float, time: Any = (0.0, 1.0), start: Any = (0.0, 0.0), end: Any = (None, None)
) -> tuple[go.Problem, go.Phase, tuple[Any, Any], tuple[Any, Any]]:
    """A point in the plane, and its velocity, both in units; ends as of `line`."""
    problem, leg, (x, y), (u, w) = one_phase("plane", "x y", "u w", lambda x, y, u, w: [u, w], time)
    _set_ends(leg, unit, dict(zip("xy", start, strict=True)), dict(zip("xy", end, strict=True)))
    return problem, leg, (x / unit, y / unit), (u / unit, w / unit)


def rest_to_rest(t: Array = T, bend: float = 0.0) -> tuple[Array, Array, Array]:
    """Place, speed and force of the least effort from rest to rest over 1 in 1 s, and with a bump that costs more."""
    place = 3 * t**2 - 2 * t**3 + bend * t**2 * (1 - t) ** 2
    speed = 6 * t - 6 * t**2 + bend * (2 * t - 6 * t**2 + 4 * t**3)
    return place, speed, 6 - 12 * t + bend * (2 - 12 * t + 12 * t**2)


def one_push_each_way() -> tuple[Array, Array, Array, Array]:
    """Times, place, speed and force from rest to rest over 1 in 1 s with the least peak of the force."""
    t, arc = arcs(0.5, 0.5)
    left = np.minimum(t, 1 - t)
    return t, np.where(arc == 0, 2 * left**2, 1 - 2 * left**2), 4 * left, np.where(arc == 0, 4.0, -4.0)


def trapezium(top: float, push: float) -> tuple[Array, Array, Array, Array]:
    """Times, place, speed and force from rest to rest over 1, at a speed ``top``, reached and left by ``push``."""
    rise = top / push
    last = 1 / top + rise
    t, arc = arcs(rise, last - 2 * rise, rise)
    way = np.choose(arc, [push * t**2 / 2, top * (t - rise / 2), 1 - push * (last - t) ** 2 / 2])
    speed = np.choose(arc, [push * t, top + 0 * t, push * (last - t)])
    return t, way, speed, np.choose(arc, [push, 0.0, -push])


def arcs(*durations: float) -> tuple[Array, NDArray[np.int64]]:
    """Times of arcs one after the other, both ends of each included, and which arc each is of."""
    ends = np.cumsum([0.0, *durations])
    times = np.concatenate([np.linspace(a, b, 21) for a, b in pairwise(ends)])
    return times, np.repeat(np.arange(len(durations)), 21)
