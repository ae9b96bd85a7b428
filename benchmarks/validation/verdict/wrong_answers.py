"""Wrong answers made from right ones: the answer of a changed problem, one flown differently, a changed file."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import scipy

import gnc_opt as go
from benchmarks.validation.verdict.answers import Case
from benchmarks.validation.verdict.statements import (
    FAMILY,
    Array,
    Statement,
    Trajectory,
    build,
    solved,
    trajectory,
    with_limit,
)

LEAST = 1e-4
"""A wrong answer that is off by less does not matter, and does not count as planted."""


@dataclass(frozen=True)
class Planted:
    """A wrong trajectory: its class, what is wrong with it, and the function that makes it."""

    kind: str
    why: str
    make: Callable[[], Trajectory]


def changes(s: Statement) -> Iterator[Planted]:
    """Yield wrong trajectories of a statement."""
    first = next(iter(s.start))
    yield _of("start missed", f"{first} starts 1 % of its way off", _moved(s, "start", first, 0.01))
    for name in s.end:
        yield _of("end missed", f"{name} ends 0.3 % of its way off", _moved(s, "end", name, 0.003))
    for name in s.states:
        if name not in s.end and name not in s.tied:
            yield _of("end not optimal", f"{name} is led to another end", _led(s, name))
    for name in s.limits:
        if name in s.states or s.name not in ("Zermelo", "brachistochrone"):
            share = 0.5 if name in s.states else 1.0
            beyond = with_limit(s, name, 1 + share / 100)
            yield _of("limit exceeded", f"{name} goes {share:g} % beyond its limit", beyond)
            yield _of("limit not used", f"{name} keeps 1 % below its limit", with_limit(s, name, 0.99))
    for name, value in s.numbers.items():
        kind, share = ("weight of an integral", 0.1) if name == "weight" else ("model parameter", 0.02)
        other = replace(s, numbers={**s.numbers, name: (1 + share) * value})
        yield _of(kind, f"{name} is {100 * share:.0f} % larger", other)
    yield Planted("time", "1 % more time than is best, or than there is", partial(_slower, s))
    yield _of("other cost", "the path is not the cheapest", _other_cost(s))
    for channel, name in enumerate(s.controls):
        why = f"{name} is off on a fifth of the flight"
        yield Planted("control perturbed", why, partial(_flown, s, channel))
    yield Planted("control delayed", "all controls come 1 % of the flight late", partial(_delayed, s))
    yield Planted("states off", "states bent by 0.1 %, controls as they were", partial(_bent, s))


def off_by(s: Statement, wrong: Trajectory) -> float:
    """How far a trajectory is from the right one: the largest distance of states, or of controls on average.

    Relative to what each varies by; both are run through in the same shares of their times.
    """
    right = trajectory(solved(s))
    shares = np.linspace(0.0, 1.0, 2001)
    far = [abs(wrong.t[-1] / right.t[-1] - 1)]
    for of, some, others in ((np.max, wrong.x, right.x), (np.mean, wrong.u, right.u)):
        for a, b in zip(some, others, strict=True):
            apart = np.abs(_at(shares, wrong.t, a) - _at(shares, right.t, b))
            far.append(float(of(apart)) / max(np.ptp(b), 1e-3))
    return max(far)


def _at(shares: Array, t: Array, values: Array) -> Array:
    return np.interp(shares, (t - t[0]) / (t[-1] - t[0]), values)


def _of(kind: str, why: str, other: Statement) -> Planted:
    return Planted(kind, why, lambda: trajectory(solved(other)))


def _moved(s: Statement, which: str, name: str, share: float) -> Statement:
    values = dict(getattr(s, which))
    reach = max(abs(s.start.get(name, 0.0) - s.end.get(name, 0.0)), 0.3)
    values[name] += share * reach
    return replace(s, start=values) if which == "start" else replace(s, end=values)


def _led(s: Statement, name: str) -> Statement:
    row = s.states.index(name)
    best = trajectory(solved(s)).x[row]
    return replace(s, end={**s.end, name: float(best[-1] + 0.02 * np.ptp(best))})


def _slower(s: Statement) -> Trajectory:
    longest = 1.01 * trajectory(solved(s)).t[-1]
    return trajectory(solved(replace(s, time=float(longest))))


def _other_cost(s: Statement) -> Statement:
    """Something of the second half of the states weighs in too."""

    def running(x: Any, u: Any, k: Any) -> Any:
        own = 0.0 if s.running is None else s.running(x, u, k)
        return own + 0.5 * getattr(x, s.states[-1]) ** 2 + 0.1 * sum(getattr(u, n) ** 2 for n in s.controls)

    return replace(s, name=f"{s.name} at another cost", running=running)


def _integrated(s: Statement, t: Array, u: Array) -> Trajectory:
    """States under other controls, from the right start."""
    x, v = ca.SX.sym("x", len(s.states)), ca.SX.sym("u", len(s.controls))
    own = SimpleNamespace(**{n: x[i] for i, n in enumerate(s.states)})
    inputs = SimpleNamespace(**{n: v[i] for i, n in enumerate(s.controls)})
    rates = ca.Function("rates", [x, v], [ca.vertcat(*s.rates(own, inputs, SimpleNamespace(**s.numbers)))])
    state = trajectory(solved(s)).x[:, 0]
    states = [state]
    for i in range(t.size - 1):
        if t[i + 1] > t[i]:
            # stages may round beyond the ends
            control = scipy.interpolate.interp1d(t[i : i + 2], u[:, i : i + 2], fill_value="extrapolate")
            flown = scipy.integrate.solve_ivp(
                lambda time, y, c=control: rates(y, c(time)).full().ravel(),
                t[i : i + 2], state, rtol=1e-9, atol=1e-10,
            )  # fmt: skip
            state = flown.y[:, -1]
        states.append(state)
    return Trajectory(t, np.array(states).T, u)


def _limited(s: Statement, u: Array) -> Array:
    limits = [s.limits.get(n, (None, None)) for n in s.controls]
    lower = np.array([[-np.inf if a is None else a] for a, _ in limits])
    upper = np.array([[np.inf if b is None else b] for _, b in limits])
    return np.clip(u, lower, upper)


def _flown(s: Statement, channel: int) -> Trajectory:
    right = trajectory(solved(s))
    t, u = right.t, right.u.copy()
    share = (t - t[0]) / (t[-1] - t[0])
    bump = np.where((share > 0.4) & (share < 0.6), np.sin(np.pi * (share - 0.4) / 0.2) ** 2, 0.0)
    size = 0.05 * max(float(np.ptp(u[channel])), 0.1)
    for sign in (1.0, -1.0):
        u[channel] = right.u[channel] + sign * size * bump
        u = _limited(s, u)
        if np.any(np.abs(u[channel] - right.u[channel]) > 0.1 * size):
            break
    return _integrated(s, t, u)


def _delayed(s: Statement) -> Trajectory:
    right = trajectory(solved(s))
    late = 0.01 * (right.t[-1] - right.t[0])
    even = np.unique(right.t)
    u = np.array([np.interp(np.maximum(even - late, even[0]), right.t, row) for row in right.u])
    return _integrated(s, even, u)


def _bent(s: Statement) -> Trajectory:
    right = trajectory(solved(s))
    share = (right.t - right.t[0]) / (right.t[-1] - right.t[0])
    size = 1e-3 * np.maximum(np.ptp(right.x, axis=1), 0.1)[:, None]
    return Trajectory(right.t, right.x + size * np.sin(np.pi * share) ** 2, right.u)


Edit = Callable[[dict[str, Any], dict[str, Any]], None]


def forged() -> Iterator[Case]:
    """Yield every statement's answer with costates, states or controls changed, and those of other problems."""
    for s in FAMILY:
        for what, why, off, edit in _edits():
            yield Case("forged file", f"{s.name}: {what}", partial(_checked, s, s, edit), why, off)
        for name, value in s.numbers.items():
            other = replace(s, numbers={**s.numbers, name: 1.05 * value})
            why = f"the answer for {name} 5 % larger, under this problem's fingerprint"
            check = partial(_checked, s, other, _same)
            yield Case("forged file", f"{s.name}: {name} of another problem", check, why, 0.05)


def _checked(s: Statement, answered: Statement, edit: Edit) -> go.Verdict:
    problem = build(s)
    with tempfile.TemporaryDirectory() as folder:
        file = solved(answered).save(Path(folder) / "answer.npz")
        with np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name].copy() for name in archive.files}
        header = json.loads(str(arrays.pop("header")))
        header["solution"]["fields"]["provenance"]["map"]["fingerprint"] = solved(s).provenance["fingerprint"]
        edit(header, arrays)
        changed = Path(folder) / "forged.npz"
        np.savez_compressed(changed, header=np.array(json.dumps(header)), **arrays)
        return go.verify(go.load(changed, problem=problem))


def _same(header: dict[str, Any], arrays: dict[str, Any]) -> None:
    """Nothing is changed but the fingerprint."""


def _edits() -> Iterator[tuple[str, str, float, Edit]]:
    for field, what in (("lam", "costates"), ("x", "states"), ("u", "controls")):
        yield f"{what} scaled", f"{what} 1 % larger", 0.01, _on(field, lambda v: 1.01 * v)
    yield "costates of another sign", "costates reversed", 2.0, _on("lam", lambda v: -v)
    yield "costates missing", "a costate is not a number", 1.0, _on("lam", _spoiled)


def _spoiled(values: Any) -> Any:
    values = values.copy()
    values.flat[values.size // 2] = np.nan
    return values


def _on(field: str, change: Callable[[Any], Any]) -> Edit:
    """Change the values of a polynomial of the phase."""

    def edit(header: dict[str, Any], arrays: dict[str, Any]) -> None:
        name = f"phases.leg.{field}.values"
        arrays[name] = change(arrays[name])

    return edit
