"""Small problems with known answers, stated once and built in any units, with any origin and any scale of the cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

import gnc_opt as go

Array = NDArray[np.float64]
ExpressionDisturbance = Callable[[Any, Any, Any], Any]

SAMPLES = 121
"""Of a trajectory that is checked as arrays; jumps come on top."""


@dataclass(frozen=True)
class Frame:
    """Affine changes: value = origin + unit * what the problem calls it; cost = factor * cost + constant."""

    name: str = "as stated"
    units: Mapping[str, float] = field(default_factory=dict)
    origins: Mapping[str, float] = field(default_factory=dict)
    factor: float = 1.0
    constant: float = 0.0

    def value(self, name: str, stored: Any) -> Any:
        """The value in the statement's own units."""
        return self.origins.get(name, 0.0) + self.units.get(name, 1.0) * stored

    def stored(self, name: str, value: Any) -> Any:
        """What the problem calls a value."""
        return (value - self.origins.get(name, 0.0)) / self.units.get(name, 1.0)


@dataclass(frozen=True)
class Statement:
    """A problem of one phase that starts at t = 0 and lasts a time or between two times (s).

    Functions get x, u and k, the numbers of dynamics and cost, with attributes by name: ``rates(x, u, k)`` of the
    states, integrand ``running(x, u, k)`` and cost of the end ``final(x, t_f, k)``. Start and end are fixed values;
    ``tied`` are states whose ends follow from those of the others; a guess has values from start to end.
    """

    name: str
    states: tuple[str, ...]
    controls: tuple[str, ...]
    rates: ExpressionDisturbance
    start: Mapping[str, float]
    end: Mapping[str, float]
    time: float | tuple[float, float]
    running: ExpressionDisturbance | None = None
    final: ExpressionDisturbance | None = None
    limits: Mapping[str, tuple[float | None, float | None]] = field(default_factory=dict)
    paths: Mapping[str, tuple[ExpressionDisturbance, float | None, float | None]] = field(
        default_factory=dict
    )
    numbers: Mapping[str, float] = field(default_factory=dict)
    guess: Mapping[str, Any] = field(default_factory=dict)
    tied: tuple[str, ...] = ()


def build(s: Statement, frame: Frame | None = None) -> go.Problem:
    """Return a statement as a problem, its variables in the units of a frame."""
    frame = frame or Frame()
    model = go.Model(s.name)
    x = {name: model.state(name) for name in s.states}
    u = {name: model.control(name) for name in s.controls}
    own = SimpleNamespace(**{name: frame.value(name, symbol) for name, symbol in x.items()})
    inputs = SimpleNamespace(**{name: frame.value(name, symbol) for name, symbol in u.items()})
    k = SimpleNamespace(**s.numbers)
    rates = s.rates(own, inputs, k)
    model.ode({x[n]: r / frame.units.get(n, 1.0) for n, r in zip(s.states, rates, strict=True)})
    problem = go.Problem(s.name)
    leg = problem.phase("leg", model)
    leg.time(0.0, s.time)
    leg.initial(**{n: frame.stored(n, v) for n, v in s.start.items()})
    leg.final(**{n: frame.stored(n, v) for n, v in s.end.items()})
    bounds = {n: [None if v is None else frame.stored(n, v) for v in pair] for n, pair in s.limits.items()}
    leg.bounds(**{n: (min(p), max(p)) if None not in p else tuple(p) for n, p in bounds.items()})
    for label, (path, lower, upper) in s.paths.items():
        leg.path(label, path(own, inputs, k), lower=lower, upper=upper)
    cost = frame.constant
    if s.running is not None:
        cost = cost + frame.factor * leg.integral(s.running(own, inputs, k))
    if s.final is not None:
        ends = SimpleNamespace(**{n: frame.value(n, leg.final_state(n)) for n in s.states})
        cost = cost + frame.factor * s.final(ends, leg.final_time, k)
    problem.minimize(cost)
    if s.guess:
        span = s.time[1] if isinstance(s.time, tuple) else s.time
        leg.guess([0.0, span], **{n: frame.stored(n, np.asarray(v)) for n, v in s.guess.items()})
    return problem


@dataclass(frozen=True)
class Trajectory:
    """Samples in the statement's own units; a time given twice is a jump."""

    t: Array
    x: Array
    u: Array


@cache
def _solved(key: str) -> go.Solution:
    return go.solve(build(_KNOWN[key]), tol=1e-8)


_KNOWN: dict[str, Statement] = {}


def solved(s: Statement) -> go.Solution:
    """Return the solution of a statement as stated, refined; solved once."""
    key = f"{s.name} {dict(s.start)} {dict(s.end)} {s.time} {dict(s.limits)} {dict(s.numbers)}"
    _KNOWN.setdefault(key, s)
    return _solved(key)


def trajectory(solution: go.Solution, n: int = SAMPLES) -> Trajectory:
    """Return samples of a solution, from both sides of its switches."""
    leg = solution.phase()
    jumps = leg.breaks[list(leg.mesh.movable)]
    even = np.linspace(leg.breaks[0], leg.breaks[-1], n)
    apart = np.min(np.abs(even[:, None] - np.append(jumps, np.inf)), axis=1) > 1e-9 * leg.duration
    t = np.sort(np.concatenate([even[apart], jumps, jumps]))
    first = np.append(np.diff(t) == 0, False)
    x, u = leg.x(t), leg.applied(t)
    x[:, first], u[:, first] = leg.x(t[first], "left"), leg.applied(t[first], "left")
    return Trajectory(t, x, u)


def in_frame(s: Statement, flown: Trajectory, frame: Frame) -> tuple[Array, Array, Array]:
    """Return (t, x, u) as the problem of a frame calls them."""
    x = np.array([frame.stored(n, row) for n, row in zip(s.states, flown.x, strict=True)])
    u = np.array([frame.stored(n, row) for n, row in zip(s.controls, flown.u, strict=True)])
    return flown.t, x, u.reshape(len(s.controls), -1)


def frames(s: Statement, seed: int) -> list[Frame]:
    """Frames of a statement: as stated; other units; another origin; a constant in the cost; a scaled cost."""
    rng = np.random.default_rng([seed, sum(map(ord, s.name))])
    names = (*s.states, *s.controls)
    units = {n: float(10.0 ** rng.uniform(-4, 4)) for n in names}
    far = {n: float(rng.choice([-1, 1]) * 10.0 ** rng.uniform(3, 6)) for n in names}
    return [
        Frame(),
        Frame("other units", units=units),
        Frame("other origin", origins=far),
        Frame("constant cost", constant=float(10.0 ** rng.uniform(3, 6))),
        Frame("scaled cost", factor=float(10.0 ** rng.uniform(-4, 4))),
    ]


# --- the family --------------------------------------------------------------------------------------------


def _cart(x: Any, u: Any, k: Any) -> list[Any]:
    return [x.v, u.a / k.mass]


_REST = {"q": 0.0, "v": 0.0}
_CART: dict[str, Any] = {"states": ("q", "v"), "controls": ("a",), "rates": _cart, "numbers": {"mass": 1.0}}


def _half_square(x: Any, u: Any, k: Any) -> Any:
    return 0.5 * u.a**2


def _time(x: Any, t: Any, k: Any) -> Any:
    return t


FAMILY: tuple[Statement, ...] = (
    Statement("least energy", **_CART, start=_REST, end={"q": 1.0, "v": 0.0}, time=1.0, running=_half_square),
    Statement(
        "least energy, force limited", **_CART, start=_REST, end={"q": 1.0, "v": 0.0}, time=1.0,
        running=_half_square, limits={"a": (-4.5, 4.5)},
    ),
    Statement(
        "least energy, speed limited", **_CART, start=_REST, end={"q": 1.0, "v": 0.0}, time=1.0,
        running=_half_square, limits={"v": (None, 1.3)},
    ),
    Statement(
        "least time", **_CART, start={"q": 1.0, "v": 0.0}, end=_REST, time=(0.1, 10.0), final=_time,
        limits={"a": (-1.0, 1.0)},
    ),
    Statement(
        "least time of an oscillator", ("q", "v"), ("a",), lambda x, u, k: [x.v, u.a / k.mass - x.q],
        {"q": 1.5, "v": 0.5}, _REST, (0.1, 20.0), final=_time, limits={"a": (-1.0, 1.0)}, numbers={"mass": 1.0},
    ),
    Statement(
        "time and energy", **_CART, start=_REST, end={"q": 1.0, "v": 0.0}, time=(0.5, 10.0),
        running=_half_square, final=_time,
    ),
    Statement(
        "soft end", **_CART, start=_REST, end={}, time=1.0, running=_half_square,
        final=lambda x, t, k: 20.0 * (x.q - 1) ** 2 + 2.0 * x.v**2,
    ),
    Statement(
        "regulator", ("x",), ("u",), lambda x, u, k: [k.rate * x.x + u.u], {"x": 1.0}, {}, 2.0,
        running=lambda x, u, k: k.weight * x.x**2 + u.u**2, numbers={"rate": 0.5, "weight": 2.0},
    ),
    Statement(
        "van der Pol", ("x", "y"), ("u",), lambda x, u, k: [x.y, k.damping * (1 - x.x**2) * x.y - x.x + u.u],
        {"x": 1.0, "y": 0.0}, {}, 4.0, running=lambda x, u, k: x.x**2 + x.y**2 + k.weight * u.u**2,
        numbers={"damping": 1.0, "weight": 1.0},
    ),
    Statement(
        "Zermelo", ("x", "y"), ("theta",), lambda x, u, k: [ca.cos(u.theta) - k.shear * x.y, ca.sin(u.theta)],
        {"x": 3.66, "y": -1.86}, {"x": 0.0, "y": 0.0}, (0.5, 20.0), final=_time,
        limits={"theta": (-2 * np.pi, 2 * np.pi)}, numbers={"shear": 1.0}, guess={"theta": [2.4, 2.4]},
    ),
    Statement(
        "brachistochrone", ("x", "y", "v"), ("theta",),
        lambda x, u, k: [x.v * ca.sin(u.theta), x.v * ca.cos(u.theta), k.gravity * ca.cos(u.theta)],
        {"x": 0.0, "y": 0.0, "v": 0.5}, {"x": 2.0, "y": 1.0}, (0.1, 10.0), final=_time,
        limits={"theta": (-1.0, 2.5)}, numbers={"gravity": 9.81},
        tied=("v",),
    ),
    Statement(
        "least fuel", ("q", "v"), ("forward", "backward"), lambda x, u, k: [x.v, (u.forward - u.backward) / k.mass],
        _REST, {"q": 1.0, "v": 0.0}, 3.0, running=lambda x, u, k: u.forward + u.backward,
        limits={"forward": (0.0, 1.0), "backward": (0.0, 1.0)}, numbers={"mass": 1.0},
    ),
    Statement(
        "soft landing", ("h", "v"), ("a",), lambda x, u, k: [x.v, u.a / k.mass - 1.5], {"h": 10.0, "v": -2.0},
        {"h": 0.0, "v": 0.0}, (0.1, 20.0), running=lambda x, u, k: u.a, limits={"a": (0.0, 3.0)},
        numbers={"mass": 1.0},
    ),
    Statement(
        "spinning body", ("p", "q", "r"), ("a", "b", "c"),
        lambda x, u, k: [k.ratio * x.q * x.r + u.a, -0.5 * x.p * x.r + u.b, 0.2 * x.p * x.q + u.c],
        {"p": 1.0, "q": 0.6, "r": -0.4}, {"p": 0.0, "q": 0.0, "r": 0.0}, 2.0,
        running=lambda x, u, k: u.a**2 + 2 * u.b**2 + u.c**2, numbers={"ratio": 0.8},
    ),
)  # fmt: skip
"""Solutions that are strict local minima, and were found as such by independent means: closed forms, or convexity."""


def with_limit(s: Statement, name: str, factor: float) -> Statement:
    """Return a statement with a limit's bounds multiplied."""
    lower, upper = s.limits[name]
    scaled = tuple(None if v is None else factor * v for v in (lower, upper))
    return replace(s, limits={**s.limits, name: scaled})
