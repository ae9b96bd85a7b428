"""Correct solutions of problems with closed forms, and ways of making them a little wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import gnc_opt as go
from gnc_opt.planning import Arc, ArcKind
from testing.internals import Interval, PiecewisePolynomial, Scheme
from testing.models import double_integrator, dynamics, one_phase

Array = NDArray[np.float64]
Piece = Literal["x", "u", "lam"]


@cache
def energy() -> go.Solution:
    """Rest to rest in 1 s with the least energy: a = 6 - 12 t, every limit far away."""
    model = double_integrator()
    problem, leg = one_phase("minimum energy", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(a=(-10.0, 10.0), v=(-5.0, 5.5))
    leg.path("speed", model.symbol("v"), upper=5.0)
    problem.constrain("reach", leg.final_state("q"), upper=5.0)
    problem.minimize(0.5 * leg.integral(model.symbol("a") ** 2))
    return go.solve(problem, mesh="4x5", tol=None)


@cache
def free_time(final: float | None = None) -> go.Solution:
    """The same with t_f + energy as the cost: t_f^4 = 18; ``final`` fixes another time."""
    model = double_integrator()
    problem, leg = one_phase("time and energy", model, 0.0, (0.5, 10.0) if final is None else final)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    problem.minimize(leg.final_time + 0.5 * leg.integral(model.symbol("a") ** 2))
    return go.solve(problem, mesh="4x5", tol=None)


@cache
def bang_bang() -> go.Solution:
    """Rest to rest over 1 m in minimum time: t_f = 2 s, one switch at 1 s, optimised."""
    problem, leg = one_phase("minimum time", double_integrator(), 0.0, (0.1, 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    mesh = go.Mesh.at_times([0.0, 0.9, 2.0], 5, movable=True)
    return go.refine(go.solve(problem.with_fixed_arcs(arcs=[[-1, 1]]), mesh=mesh, tol=None))


@cache
def ceiling(
    scheme: Scheme = "LG", *, path: bool = False, breaks: tuple[float, ...] = (0.3, 0.7), degree: int = 5
) -> go.Solution:
    """Bryson and Denham's problem, q <= 0.1: an arc from 0.3 s to 0.7 s; q's costate jumps from 200/9 to 0 to -200/9.

    Unless told otherwise, segment boundaries lie at the ends of the arc. The limit is a state bound or, with ``path``,
    a path constraint.
    """
    model = double_integrator()
    problem, leg = one_phase("ceiling", model, 0.0, 1.0)
    leg.initial(q=0.0, v=1.0)
    leg.final(q=0.0, v=-1.0)
    if path:
        leg.path("ceiling", model.symbol("q"), upper=0.1)
    else:
        leg.bounds(q=(None, 0.1))
    problem.minimize(0.5 * leg.integral(model.symbol("a") ** 2))
    mesh = go.Mesh((0.0, *breaks, 1.0), (degree,) * (len(breaks) + 1))
    return go.solve(problem, mesh=mesh, scheme=scheme, options=go.SolverOptions(tolerance=1e-11), tol=None)


@cache
def mixed_limit() -> go.Solution:
    """x' = u, min of the integral of (u - 2)^2 / 2 under u + x <= 1, active throughout: x = 1 - exp(-t)."""
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("mixed limit", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.path("limit", u + x, upper=1.0)
    problem.minimize(leg.integral(0.5 * (u - 2) ** 2))
    return go.solve(problem, mesh="4x6", options=go.SolverOptions(tolerance=1e-11), tol=None)


def design_problem(most: float = 5.0) -> go.Problem:
    """Minimum energy with a free parameter k that costs (k - 1)^2 and is weighed by the end value: k = 1.5."""
    model = double_integrator()
    problem = go.Problem("designed")
    k = problem.parameter("k", lower=0.0, upper=most)
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    problem.minimize(0.5 * leg.integral(model.symbol("a") ** 2) + (k - 1) ** 2 - k * leg.final_state("q"))
    return problem


@cache
def designed() -> go.Solution:
    """The solution of `design_problem`."""
    return go.solve(design_problem(), mesh="4x5", tol=None)


@cache
def nothing_to_gain() -> go.Solution:
    """x_f^2 is zero at its least, for many controls: costates vanish."""
    model, *_ = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("nothing to gain", model, 0.0, 1.0)
    leg.initial(x=1.0)
    leg.bounds(u=(-2.0, 2.0))
    problem.minimize(leg.final_state("x") ** 2)
    return go.solve(problem, mesh="3x4", tol=None)


@cache
def nowhere_to_go(start: float = 0.0) -> go.Solution:
    """Minimum time from a point to itself: the phase has no length."""
    model = double_integrator()
    problem, leg = one_phase("nowhere to go", model, start, (start, start + 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    return go.solve(problem, mesh="3x4", throw=False, tol=None)


@cache
def two_valleys(tilt: float) -> go.Solution:
    """min of the integral of (u^2 - 1)^2 + tilt u: the valley at u = 1 is the shallower one if tilt > 0."""
    model, _x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("two valleys", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-2.0, 2.0))
    problem.minimize(leg.integral((u**2 - 1) ** 2 + tilt * u))
    one = go.solve(problem.with_bounds(u=(0.5, 2.0)), mesh="3x4", tol=None)
    box = Interval(np.array([-2.0]), np.array([2.0]))
    return replace(with_leg(one, control_bounds=box), problem=problem)


@cache
def hilltop(steepness: float) -> go.Solution:
    """min of the integral of 1 - steepness u^2 / 2 + u^4, held at u = 0: a maximum of H."""
    model, _x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("hilltop", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(1 - 0.5 * steepness * u**2 + u**4))
    one = go.solve(problem.with_bounds(u=(0.0, 0.0)), mesh="3x4", tol=None)
    box = Interval(np.array([-1.0]), np.array([1.0]))
    return replace(with_leg(one, control_bounds=box), problem=problem)


@cache
def one_switch(
    bend: float, at: float = 1.0, more: Callable[[go.Problem, go.Phase], Any] = lambda problem, leg: 0.0
) -> go.Solution:
    """x' = u, |u| <= 1 over 2 s; u switches from 1 to -1 at 1 s, an extremal for every bend, a minimum for bend < 1.

    The cost is x_f plus the integral of (bend / 3 - 1) x - bend x^2 / 3. The costate rises through zero at 1 s, and
    as a function of the switch time the cost has the second derivative 2 - 2 bend there. ``more`` may constrain the
    problem and add to its cost, and the switch may be ``at`` a wrong time.
    """
    model, x, _u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("one switch", model, 0.0, 2.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-1.0, 1.0))
    cost = leg.integral((bend / 3 - 1) * x - bend / 3 * x**2) + leg.final_state("x")
    problem.minimize(cost + more(problem, leg))
    held = go.solve(
        problem.with_fixed_arcs(arcs=[[1, -1]]), mesh=go.Mesh.at_times([0.0, at, 2.0], 4), tol=None
    )
    arcs = (Arc("leg", "u", ArcKind.UPPER, 0.0, at), Arc("leg", "u", ArcKind.LOWER, at, 2.0))
    return replace(with_leg(held, mesh=go.Mesh.at_times([0.0, at, 2.0], 4, movable=True)), structure=arcs)


def singular_problem(stiffness: float) -> go.Problem:
    """x' = u, |u| <= 1, and r' = w, from rest to x = 0, r = 1 at the cost of stiffness x^2 (1 + r) + w^2 / 2."""
    model, x, r, _u, w = dynamics("beside", "x r", "u w", lambda x, r, u, w: {x: u, r: w})
    problem, leg = one_phase("beside", model, 0.0, 1.0)
    leg.initial(x=0.0, r=0.0)
    leg.final(x=0.0, r=1.0)
    leg.bounds(u=(-1.0, 1.0), w=(-5.0, 5.0))
    problem.minimize(leg.integral(stiffness * x**2 * (1 + r) + 0.5 * w**2))
    return problem


@cache
def singular() -> go.Solution:
    """x = 0 throughout, on a singular arc, whatever the stiffness; a minimum if that is positive."""
    return go.solve(singular_problem(1.0), mesh="2x4", tol=None)


LIMITS = {
    **{f"{end}_bounds": end for end in ("initial", "final", "initial_time", "final_time", "duration")},
    "state_bounds": "states",
    "control_bounds": "controls",
}
"""Limits in the solution of a phase, and what they are called in its problem."""


def with_leg(solution: go.Solution, phase: str | None = None, /, **changes: Any) -> go.Solution:
    """Replace fields of a phase, or of the only one; limits are replaced in its problem too."""
    leg = solution.phase(phase)
    if "lam" in changes:
        ends = {
            "lam_start": changes["lam"](leg.breaks[:-1], "right"),
            "lam_end": changes["lam"](leg.breaks[1:], "left"),
            "point_costates": changes["lam"](leg.point_times),
        }
        changes = ends | changes
    problem = solution.need_problem("change").with_bounds(leg.name)
    stated = problem.get_phase(leg.name)
    numbers = {LIMITS[name]: box for name, box in changes.items() if name in LIMITS}
    stated.numbers = replace(stated.numbers, **numbers)
    if "path_bounds" in changes:
        ends, first = changes["path_bounds"], 0
        for name, path in stated.paths.items():
            rows = slice(first, first + path.size)
            stated.paths[name] = replace(path, interval=Interval(ends.lower[rows], ends.upper[rows]))
            first += path.size
    return replace(solution, problem=problem, phases={**solution.phases, leg.name: replace(leg, **changes)})


def forged(solution: go.Solution, **changes: Any) -> go.Solution:
    """Replace fields of the only phase, and leave its problem as it is."""
    leg = solution.phase()
    return replace(solution, phases={leg.name: replace(leg, **changes)})


def shifted(box: Interval, amount: float) -> Interval:
    """Both limits moved."""
    return Interval(box.lower + amount, box.upper + amount)


def upper(box: Interval, row: int, value: float) -> Interval:
    """One upper limit replaced."""
    limits = box.upper.copy()
    limits[row] = value
    return Interval(box.lower, limits)


def added(
    solution: go.Solution,
    piece: Piece,
    row: int,
    amount: float,
    segment: int | None = None,
    node: int | None = None,
) -> go.Solution:
    """Add a number to a component of states, controls or costates: everywhere, in a segment, or at one of its nodes."""
    polynomial: PiecewisePolynomial = getattr(solution.phase(), piece)
    values = [v.copy() for v in polynomial.values]
    for k in range(len(values)) if segment is None else [segment]:
        values[k][row, slice(None) if node is None else node] += amount
    return with_leg(
        solution, **{piece: PiecewisePolynomial(polynomial.breaks, polynomial.nodes, tuple(values))}
    )


def scaled(solution: go.Solution, piece: Piece, factor: float, segment: int | None = None) -> go.Solution:
    """Multiply states, controls or costates, everywhere or in a segment."""
    polynomial: PiecewisePolynomial = getattr(solution.phase(), piece)
    factors = [factor if segment in (None, k) else 1.0 for k in range(len(polynomial.values))]
    values = tuple(f * v for f, v in zip(factors, polynomial.values, strict=True))
    return with_leg(solution, **{piece: PiecewisePolynomial(polynomial.breaks, polynomial.nodes, values)})


def moved(values: Array, place: tuple[int, int], amount: float) -> Array:
    """A copy with one entry changed."""
    result = values.copy()
    result[place] += amount
    return result


def failed(solution: go.Solution) -> set[str]:
    """The conditions that fail."""
    return {c.name for c in go.verify(solution).failed}
