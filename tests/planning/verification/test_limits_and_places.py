"""Limits that are held, and where samples and violations lie."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.internals import SampledPhase, reformulate_problem
from testing.models import dynamics, one_phase
from testing.second_order import second_order_of
from testing.wrong_solutions import bang_bang, double_integrator, energy, moved, scaled, with_leg

import gnc_opt as go
from gnc_opt.planning.optimality.active_state_constraints import compute_free_control_directions
from gnc_opt.planning.optimality.optimality_check_scales import Scales
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial
from gnc_opt.planning.verification.external_trajectory_check import reformulate_sampled_phase
from gnc_opt.planning.verification.feasibility import check_trajectory_limits
from gnc_opt.planning.verification.optimality_check import CONDITION_TOLERANCE
from gnc_opt.planning.verification.solution_data_check import recompute_stored_data

# Limits are judged by what they allow: a distance, found between the samples, however the constraint is
# written.


RADIUS = 10.0
FREE = -1e30
"""A lower limit that no value comes near to: solutions ignore it, until another is put in its place."""


def fly_by(
    miss: float,
    length: float,
    time: float,
    keep_out: Callable[[Any], Any] | None = None,
    origin: float = 0.0,
    limit: float = RADIUS**2,
) -> go.Problem:
    """A straight flight of 10 km that passes a point at a distance; ``origin`` (m) is where that is."""
    model, r, _v, a = dynamics("chaser", "r:3 v:3", "a:3", lambda r, v, a: {r: v, v: a})
    problem, leg = one_phase("fly-by", model, 0.0, 1000.0 * time)
    leg.initial(r=np.array([origin - 5000.0, miss, 0.0]) * length, v=0.0)
    leg.final(r=np.array([origin + 5000.0, miss, 0.0]) * length, v=0.0)
    if keep_out is not None:
        square = ((r[0] - origin * length) ** 2 + r[1] ** 2 + r[2] ** 2) / length**2
        leg.path("keep_out", keep_out(square), lower=limit)
    problem.minimize(leg.integral((a[0] ** 2 + a[1] ** 2 + a[2] ** 2) / length**2 * time**3))
    return problem


@cache
def flown(miss: float, length: float, time: float, origin: float) -> go.Solution:
    return go.solve(fly_by(miss, length, time, origin=origin), tol=None)


def flown_by(
    form: Callable[[Any], Any], limit: float, miss: float, length: float, time: float, origin: float = 0.0
) -> go.Condition:
    """Judge the straight flight against a lower limit on form(r^2) that the solver did not know of.

    ``length`` and ``time`` are how many of the units in use one metre and one second are; ``form`` takes m^2.
    """
    solution = flown(miss, length, time, origin)
    limited = with_leg(
        solution,
        path_labels=("keep_out",),
        path_bounds=Interval(np.array([limit]), np.array([np.inf])),
        path_multipliers=np.zeros((1, solution.phase().point_times.size)),
    )
    judged = recompute_stored_data(replace(limited, problem=fly_by(miss, length, time, form, origin, limit)))
    samples = list(judged.samples().values())
    scales = Scales.from_solution(judged, samples)
    return check_trajectory_limits(judged, samples, scales, CONDITION_TOLERANCE)


FORMS: dict[str, tuple[Callable[[Any], Any], float]] = {
    "square": (lambda square: square, RADIUS**2),
    "distance": (lambda square: ca.sqrt(square), RADIUS),
    "shifted share": (lambda square: square / RADIUS**2 - 1.0, 0.0),
    "inverse": (lambda square: -(RADIUS**2) / square, -1.0),
}
UNITS = {"m, s": (1.0, 1.0), "km, min": (1e-3, 1 / 60), "mm, ms": (1e3, 1e3)}


@pytest.mark.parametrize(("form", "units"), [*((form, "m, s") for form in FORMS), ("inverse", "km, min")])
def test_flight_through_a_small_sphere_fails_in_every_form_and_unit(form: str, units: str) -> None:
    """1 m inside of 10 m: a depth of 1 m to first order, as the curvature of the forms allows."""
    through, grazing, outside = (flown_by(*FORMS[form], miss, *UNITS[units]) for miss in (0.0, 9.0, 10.001))
    assert through.result is grazing.result is go.ConditionResult.FAIL
    assert (outside.result, outside.value) == (go.ConditionResult.PASS, 0.0)


@pytest.mark.parametrize("miss", [0.0, 9.0])
def test_flight_far_from_the_origin_fails_too(miss: float) -> None:
    """Coordinates of 7000 km, as in orbit: the depth of 1 m is 1e-7 of them, the sphere's width decides."""
    assert (
        flown_by(lambda square: square, RADIUS**2, miss, 1.0, 1.0, origin=7e6).result
        is go.ConditionResult.FAIL
    )


def test_value_that_is_no_number_fails() -> None:
    """The logarithm has none within 1 km of the point."""
    condition = flown_by(lambda square: ca.log(square - 1e6), -1e3, 9.0, 1.0, 1.0)
    assert condition.result is go.ConditionResult.FAIL
    assert condition.value == np.inf


def test_default_solution_through_the_centre_fails() -> None:
    """The solver's own answer: no node lies within the sphere."""
    problem = fly_by(0.0, 1.0, 1.0, lambda square: square)
    condition = go.verify(go.solve(problem, tol=None))["limits"]
    assert condition.result is go.ConditionResult.FAIL
    assert condition.where.startswith("phase leg, t = 500 s, keep_out = ")
    assert condition.where.endswith(" (at least 100)")


@cache
def passing(point: float) -> go.Solution:
    """Minimum energy over 1 m with a path quantity (q - point)^2, on segments without a boundary in the middle."""
    model = double_integrator()
    problem, leg = one_phase("minimum energy", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(v=(-5.0, 5.0))
    leg.path("gap", (model.symbol("q") - point) ** 2, lower=FREE)
    problem.minimize(0.5 * leg.integral(model.symbol("a") ** 2))
    return go.solve(problem, mesh="3x5", tol=None)


@pytest.mark.parametrize("gap", [1e-3, 1e-4, 1e-5])
def test_narrow_dip_between_two_samples_is_found(gap: float) -> None:
    """The square has no gradient in its middle: no distance restores it."""
    solution = with_leg(passing(0.31), path_bounds=Interval(np.array([gap**2]), np.array([np.inf])))
    sampled = solution.samples()["leg"]
    assert np.min(np.abs(sampled.x[0] - 0.31)) > 1.001e-3, "a sample sees the dip: choose another point"
    condition = go.verify(solution)["limits"]
    assert condition.result is go.ConditionResult.FAIL
    beside = with_leg(passing(1.1), path_bounds=Interval(np.array([0.0999**2]), np.array([np.inf])))
    assert go.verify(beside)["limits"].value == 0.0


def test_top_of_a_state_between_samples_is_found() -> None:
    """The speed peaks at 1.5 m/s in the middle, a few 1e-3 above all samples."""
    solution = passing(0.31)
    assert np.max(solution.samples()["leg"].x[1]) < 1.5 - 1e-4
    bounds = Interval(np.array([-9.0, -9.0]), np.array([9.0, 1.5 - 1e-4]))
    assert go.verify(with_leg(solution, state_bounds=bounds))["limits"].value == pytest.approx(
        1e-4 / 1.5, rel=0.5
    )


@pytest.mark.parametrize("span", [0.15, 3e-3, 1e-6])
@pytest.mark.parametrize("kind", ["path_bounds", "state_bounds"])
def test_a_narrow_range_is_left_by_shares_of_what_moves(kind: str, span: float) -> None:
    """A speed from 0 to 1.5 is to stay in a range near its top; a hundred widths of the range are the largest scale."""
    top, free = 1.5 - 1e-3, np.array([9.0])
    low, high = np.array([top - span]), np.array([top])
    box = (
        Interval(low, high)
        if kind == "path_bounds"
        else Interval(np.append(-free, low), np.append(free, high))
    )
    condition = go.verify(with_leg(energy(), **{kind: box}))["limits"]
    assert condition.value == pytest.approx((top - span) / min(1.5, 100 * span), rel=1e-3)


@pytest.mark.parametrize("peak", [1e3, 1e6])
def test_a_limit_counts_in_shares_of_the_deviation_at_its_time(peak: float) -> None:
    """u is ``peak`` for 3 ms at first, and 1.5 later, where 1 is allowed."""
    t = np.union1d(np.linspace(0.0, 0.02, 241), np.linspace(0.0, 1.0, 81))
    model, *_ = dynamics("clock", "x", "u", lambda x, u: {x: 1.0})
    problem, leg = one_phase("spike", model, 0.0, 1.0)
    leg.initial(x=0.0)
    u, spike = model.symbol("u"), peak * ca.exp(-((model.time / 3e-3) ** 2))
    leg.path("limit", u - 10 * spike, upper=1.0)
    problem.minimize(leg.integral((u - spike - 1.5) ** 2 + 1))
    verdict = go.verify_trajectory(problem, t, t[None], peak * np.exp(-((t / 3e-3) ** 2))[None] + 1.5)
    assert verdict["limits"].result is go.ConditionResult.FAIL


def test_what_no_state_can_restore_counts_in_shares_of_its_values() -> None:
    """A limit on time alone: 1 s where 0.9 is allowed."""
    model = double_integrator()
    problem, leg = one_phase("clock", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.path("clock", model.time, lower=FREE)
    problem.minimize(0.5 * leg.integral(model.symbol("a") ** 2))
    late = with_leg(go.solve(problem, tol=None), path_bounds=Interval(np.array([-np.inf]), np.array([0.9])))
    condition = go.verify(late)["limits"]
    assert condition.result is go.ConditionResult.FAIL


def test_rounding_beyond_a_limit_passes() -> None:
    """A limit on the speed 1e-7 of its size below the top."""
    tight = with_leg(energy(), path_bounds=Interval(np.array([-np.inf]), np.array([1.5 * (1 - 1e-7)])))
    condition = go.verify(tight)["limits"]
    assert condition.result is go.ConditionResult.PASS
    assert condition.value == pytest.approx(1e-7, rel=1e-2)


# Controls that active constraints determine are not singular; those that they merely touch are.


PASS, UNTOLD = go.ConditionResult.PASS, go.ConditionResult.INCONCLUSIVE


def curvature(solution: go.Solution) -> set[go.ConditionResult]:
    found = second_order_of(solution)
    return {found[name].result for name in ("Legendre-Clebsch", "singular arcs")}


def along_a_slope(unit: float, *, others: int = 0) -> go.Solution:
    """The farthest x of x' = u under u + x <= 1: u = exp(-t), which H, affine in u, does not determine."""
    model = go.Model("slope")
    x, u = model.state("x"), model.control("u")
    equations = {x: u}
    if others:
        equations[model.state("y")] = model.control("w")
    model.ode(equations)
    problem, leg = one_phase("slope", model, 0.0, 1.0)
    leg.initial(**dict.fromkeys(model.states.names, 0.0))
    if others:
        leg.final(y=0.0)
        leg.bounds(w=(-1.0, 1.0))
    leg.bounds(u=(-5.0 * unit, 5.0 * unit))
    leg.path("sum", u + x, upper=unit)
    problem.maximize(leg.final_state("x"))
    return go.solve(problem, mesh="2x10", tol=None)


@pytest.mark.parametrize("unit", [1.0, 1e4, 1e-4])
def test_a_control_fixed_by_a_mixed_constraint_is_not_singular(unit: float) -> None:
    solution = along_a_slope(unit)
    assert solution.objective == pytest.approx((1 - np.exp(-1)) * unit, rel=1e-6)
    assert curvature(solution) == {PASS}


def test_another_control_beside_it_stays_singular() -> None:
    condition = second_order_of(along_a_slope(1.0, others=1))["singular arcs"]
    assert condition.result is UNTOLD and ", w, " in condition.where


def cruise(order: int, *, by_path: bool = False) -> go.Solution:
    """A chain of integrators that starts on a ceiling of its first state and must stay there as long as it pays."""
    model = go.Model("chain")
    states = [model.state(f"x{k}") for k in range(order)]
    u = model.control("u")
    model.ode(dict(zip(states, [*states[1:], u], strict=True)))
    problem, leg = one_phase("cruise", model, 0.0, 1.0)
    leg.initial(**dict.fromkeys(model.states.names, 0.0))
    leg.bounds(u=(-1.0, 1.0))
    if by_path:
        leg.path("ceiling", states[0], upper=0.0)
    else:
        leg.bounds(x0=(None, 0.0))
    problem.maximize(leg.integral(states[0]))
    return go.solve(problem, mesh="3x5", tol=None)


@pytest.mark.parametrize("by_path", [False, True])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_order_of_a_state_constraint_is_found(order: int, by_path: bool) -> None:
    solution = cruise(order, by_path=by_path)
    leg = solution.phase()
    assert np.allclose(np.hstack(leg.x.values), 0.0, atol=1e-6)
    solution = scaled(scaled(solution, "x", 0.0), "u", 0.0)
    s = PhaseSamples.from_phase(with_pushes(solution, by_path, 1.0).phase(), solution.phase_functions("leg"))
    inside = np.ones((1, s.times.size), dtype=bool)
    assert all(basis.shape == (1, 0) for basis in compute_free_control_directions(s, inside, np.ones(1)))
    idle = PhaseSamples.from_phase(
        with_pushes(solution, by_path, 0.0).phase(), solution.phase_functions("leg")
    )
    assert all(basis.shape == (1, 1) for basis in compute_free_control_directions(idle, inside, np.ones(1)))


def with_pushes(solution: go.Solution, by_path: bool, size: float) -> go.Solution:
    """The same with another multiplier of the ceiling throughout."""
    name = "path_multipliers" if by_path else "state_multipliers"
    values = np.zeros_like(getattr(solution.phase(), name))
    values[0] = size
    return with_leg(solution, **{name: values})


def test_arc_along_a_ceiling_is_checked() -> None:
    assert curvature(cruise(1)) == {PASS}


# Of several axes and several phases the verdict names the one that offends, and when.


E = 1e-2


@cache
def two_axes() -> go.Solution:
    """Rest to rest along two axes, 1 m and 2 m, in two phases of 1 s each, with the least energy."""
    model, _q, _v, _a = dynamics("two axes", "q:2 v:2", "a:2", lambda q, v, a: {q: v, v: a})
    problem = go.Problem("there and back")
    there, back = problem.phase("there", model), problem.phase("back", model)
    there.time(0.0, 1.0)
    back.time(1.0, 2.0)
    there.initial(q=[0.0, 0.0], v=[0.0, 0.0])
    there.final(q=[1.0, 2.0], v=[0.0, 0.0])
    back.initial(q=[1.0, 2.0], v=[0.0, 0.0])
    back.final(q=[0.0, 0.0], v=[0.0, 0.0])
    energy = []
    for leg in (there, back):
        leg.bounds(a=([-30.0, -30.0], [30.0, 30.0]), v=([-9.0, -9.0], [9.0, 9.0]))
        energy.append(leg.integral(model.symbol("a")[0] ** 2 + model.symbol("a")[1] ** 2))
    problem.minimize(0.5 * (energy[0] + energy[1]))
    return go.solve(problem, mesh={"there": go.Mesh.uniform(4, 5), "back": go.Mesh.uniform(4, 5)}, tol=None)


def changed(phase: str, **fields: object) -> go.Solution:
    solution = two_axes()
    return with_leg(solution, phase, **fields)


def added(phase: str, piece: str, row: int, amount: float, segment: int) -> go.Solution:
    """Add a number to a row of states, controls or costates in one segment."""
    polynomial: PiecewisePolynomial = getattr(two_axes().phases[phase], piece)
    values = [v.copy() for v in polynomial.values]
    values[segment][row] += amount
    return changed(phase, **{piece: PiecewisePolynomial(polynomial.breaks, polynomial.nodes, tuple(values))})


def limited(phase: str, field: str, row: int, upper: float) -> go.Solution:
    box: Interval = getattr(two_axes().phases[phase], field)
    limits = box.upper.copy()
    limits[row] = upper
    return changed(phase, **{field: Interval(box.lower, limits)})


def multiplied(phase: str, field: str, row: int, column: int) -> go.Solution:
    values = getattr(two_axes().phases[phase], field)
    return changed(phase, **{field: moved(values, (row, column), 5.0)})


PLACES: list[tuple[str, Callable[[], go.Solution], str, tuple[float, float] | None]] = [
    ("dynamics", lambda: added("there", "u", 0, E, 2), "phase there, segment 3 (0.5 to 0.75 s), v[0]", None),
    ("dynamics", lambda: added("back", "u", 1, E, 1), "phase back, segment 2 (1.25 to 1.5 s), v[1]", None),
    ("limits", lambda: limited("there", "state_bounds", 3, 2.9), "phase there", (0.4, 0.6)),
    (
        "dynamics",
        lambda: limited("back", "control_bounds", 0, 5.9),
        "phase back, segment 4 (1.75 to 2 s)",
        None,
    ),
    ("stationarity", lambda: added("back", "lam", 3, E, 2), "phase back", (1.5, 1.75)),
    ("stationarity", lambda: added("there", "lam", 1, 5.0, 3), "phase there", (0.75, 0.8)),
    ("stationarity", lambda: added("there", "u", 1, E, 2), "phase there", (0.5, 0.75)),
    ("stationarity", lambda: added("back", "lam", 2, E, 0), "phase back", (1.0, 1.25)),
    ("minimum principle", lambda: added("back", "u", 0, 10.0, 3), "phase back", (1.75, 2.0)),
    ("active set", lambda: multiplied("there", "control_multipliers", 1, 7), "phase there", (0.25, 0.5)),
    ("active set", lambda: multiplied("back", "state_multipliers", 2, 12), "phase back", (1.5, 1.75)),
    ("active set", lambda: multiplied("back", "state_impulses", 3, 1), "phase back", (1.25, 1.25)),
]
LABELS = ["", "", "v[1]", "[0]", "v[1]", "q[1]", "a[1]", "a[0]", "", "a[1]", "v[0]", "v[1]"]


@pytest.mark.parametrize(("name", "wrong", "start", "span", "label"),
                         [(*place, label) for place, label in zip(PLACES, LABELS, strict=True)])  # fmt: skip
def test_place(
    name: str, wrong: Callable[[], go.Solution], start: str, span: tuple[float, float] | None, label: str
) -> None:
    assert go.verify(two_axes()).ok
    condition = go.verify(wrong())[name]
    assert condition.result is go.ConditionResult.FAIL
    assert condition.where.startswith(start) and label in condition.where
    if span is not None:
        time = float(condition.where.split("t = ")[1].split(" s")[0])
        assert span[0] - 1e-9 <= time <= span[1] + 1e-9


@pytest.mark.parametrize("phase", ["there", "back"])
@pytest.mark.parametrize("row", [0, 1, 2, 3])
def test_end_of_the_phase_and_component_that_is_missed(phase: str, row: int) -> None:
    leg = two_axes().phases[phase]
    shift = E * (np.arange(4) == row)
    box = Interval(leg.final_bounds.lower + shift, leg.final_bounds.upper + shift)
    condition = go.verify(changed(phase, final_bounds=box))["boundary conditions"]
    label = ("q[0]", "q[1]", "v[0]", "v[1]")[row]
    assert condition.where == f"phase {phase}, end, {label} off by {E:.3g}"


def test_switching_functions_at_one_time_and_many_of_one_control_and_of_several() -> None:
    """dH/da = a + lam_v vanishes along both axes; of the minimum time it is lam_v = 1 - t."""
    times = np.array([0.1, 0.6, 0.9])
    assert two_axes().switching_function("a", times, "there").shape == (2, 3)  # type: ignore[union-attr]
    assert two_axes().switching_function("a", times, "there") == pytest.approx(np.zeros((2, 3)), abs=1e-6)
    assert two_axes().switching_function("a", 0.6, "there") == pytest.approx(np.zeros(2), abs=1e-6)
    assert bang_bang().switching_function("a", times) == pytest.approx(1 - times, abs=1e-7)
    assert bang_bang().switching_function("a", 0.25) == pytest.approx(0.75, abs=1e-7)
    assert np.ndim(bang_bang().switching_function("a", 0.25)) == 0


# Foreign trajectories that rest on kinks of their cost: judged in the controls that a default call solves
# for.


_TIME = 2.5
_COSTS = {
    "fabs": lambda a: ca.fabs(a[0]) + ca.fabs(a[1]),
    "dear forth": lambda a: ca.if_else(a[0] > 0, 2 * a[0], -0.5 * a[0]) + ca.fabs(a[1]),
    "sqrt": lambda a: ca.sqrt(a[0] ** 2 + a[1] ** 2),
    "norm_2": ca.norm_2,
}


def _problem(cost: str) -> tuple[go.Problem, go.Phase]:
    """Rest to rest over (1, 0) with the least fuel."""
    model, _q, _v, a = dynamics("leg", "q:2 v:2", "a:2", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("fuel", model, 0.0, _TIME)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=[1.0, 0.0], v=0.0)
    if cost in ("fabs", "dear forth"):
        leg.bounds(a=([-1.0, -1.0], [1.0, 1.0]))
    else:
        leg.path("thrust", ca.sumsqr(a), upper=1.0)
    problem.minimize(leg.integral(_COSTS[cost](a)))
    return problem, leg


def _flight(push: float) -> tuple[Any, Any, Any]:
    """ContactNodes, coast, push back: the stronger, the less fuel. push s (T - s) = 1."""
    s = (_TIME - np.sqrt(_TIME**2 - 4 / push)) / 2
    ends = np.array([0.0, s, _TIME - s, _TIME])
    t = np.concatenate([np.linspace(a, b, 6) for a, b in itertools.pairwise(ends)])
    arc = np.repeat(np.arange(3), 6)
    q = np.choose(arc, [push * t**2 / 2, push * s * (t - s / 2), 1 - push * (_TIME - t) ** 2 / 2])
    v = np.choose(arc, [push * t, push * s + 0 * t, push * (_TIME - t)])
    u = np.choose(arc, [push + 0 * t, 0 * t, -push + 0 * t])
    return t, np.array([q, 0 * t, v, 0 * t]), np.array([u, 0 * t])


@pytest.mark.slow
@pytest.mark.parametrize("cost", ["dear forth", "sqrt"])
def test_a_coast_of_least_fuel_is_checked_however_its_cost_is_written(cost: str) -> None:
    problem, _ = _problem(cost)
    right, wrong = (go.verify_trajectory(problem, *_flight(push)) for push in (1.0, 0.99))
    assert right.ok, right.explain()
    assert wrong.failed
    assert right.estimated


@pytest.mark.parametrize(
    ("price", "ends", "result"),
    [
        (3.0, (1.0, 0.6), True),
        (3.0, (1.0 + 1e-15, 0.6), True),
        (1.9, (1.0, 0.6), False),
        (3.0, (1.0, 0.65), False),
    ],
)
def test_ends_on_or_beside_the_kinks_of_their_cost_are_a_minimum(
    price: float, ends: tuple[float, float], result: bool
) -> None:
    """end^2 + price |end - 1| has its minimum at 1 for price >= 2, else at price / 2."""
    model, _x, u = dynamics("leg", "x:2", "u:2", lambda x, u: {x: u})
    problem, leg = one_phase("soft end", model, 0.0, 1.0)
    leg.initial(x=0.0)
    x = leg.final_state("x")
    problem.minimize(leg.integral(ca.sumsqr(u)) + price * ca.fabs(x[0] - 1) + 1.2 * ca.fabs(x[1] - 1))
    t, rates = np.linspace(0.0, 1.0, 5), np.array(ends)[:, None]
    verdict = go.verify_trajectory(problem, t, rates * t, rates + 0 * t)
    assert verdict.minimum is result and bool(verdict.failed) is not result, verdict.explain()


@pytest.mark.parametrize("cost", ["fabs", "dear forth", "sqrt"])
def test_samples_in_other_controls_are_those_that_were_stated(cost: str) -> None:
    """What is solved for makes up what was stated, also where nothing pushes."""
    problem, _ = _problem(cost)
    twin = reformulate_problem(problem)
    u = np.random.default_rng(3).uniform(-1.0, 1.0, (2, 9))
    u[:, 4:6] = 0.0
    t = np.linspace(0.0, 1.0, 9)
    given, restated = SampledPhase(t, np.zeros((4, 9)), u), twin.phases["leg"]
    own, restatement = reformulate_sampled_phase(problem, restated, given, np.zeros(0)), restated.control_map
    assert restatement is not None
    controls = twin.phases["leg"].model.symbols("control")
    assert np.all(np.isfinite(own.u))
    back = ca.Function("back", [controls], [restatement.solved]).map(9)(own.u)
    np.testing.assert_allclose(back.full(), u, atol=1e-14)


def test_the_given_start_of_an_uncontrolled_state_is_kept_for_a_free_final_time() -> None:
    """A target at 300 m/s starts 1 m nearer than given; 12 d^2 / t^3 is least at 500 s for that distance."""
    ahead, speed, lasts = 999.0, 300.0, 500.0
    model, *_ = dynamics("chase", "x v y w", "a", lambda x, v, y, w, a: {x: v, v: a, y: w, w: 0 * w})
    for given, ok in ((ahead, True), (ahead + 1.0, False)):
        problem, leg = one_phase("chase", model, 0.0, (50.0, 2000.0))
        leg.initial(x=0.0, v=speed, y=given, w=speed)
        problem.constrain("place", leg.final_state("x") - leg.final_state("y"), equals=0.0)
        problem.constrain("speed", leg.final_state("v") - leg.final_state("w"), equals=0.0)
        effort = lasts**4 / 36 / ahead**2 * leg.integral(model.symbol("a") ** 2)
        problem.minimize(effort + leg.final_time)
        t = np.linspace(0, lasts, 121)
        s = t / lasts
        x = speed * t + ahead * (3 * s**2 - 2 * s**3)
        v = speed + ahead * (6 * s - 6 * s**2) / lasts
        states = {"x": x, "v": v, "y": ahead + speed * t, "w": speed + 0 * t}
        verdict = go.verify_trajectory(problem, t, states, {"a": ahead * (6 - 12 * s) / lasts**2})
        assert verdict.ok is ok, verdict.explain()


@pytest.mark.parametrize(("start", "ok"), [(1.0, True), (1.5, False)])
def test_a_range_of_starts_is_kept_in_a_moving_frame(start: float, ok: bool) -> None:
    """At 7500 m/s over 100 s, x(0) in 0 to 1 m; 1.5 m is nearer to the target."""
    speed, lasts, way = 7500.0, 100.0, 100.0 - start
    model, *_ = dynamics("cart", "x v", "a", lambda x, v, a: {x: v, v: a})
    problem, leg = one_phase("cart", model, 0.0, lasts)
    leg.initial(x=(0.0, 1.0), v=speed)
    leg.final(x=speed * lasts + 100.0, v=speed)
    problem.minimize(leg.integral(model.symbol("a") ** 2))
    t = np.linspace(0, lasts, 61)
    s = t / lasts
    x = {"x": speed * t + start + way * (3 * s**2 - 2 * s**3), "v": speed + way * (6 * s - 6 * s**2) / lasts}
    verdict = go.verify_trajectory(problem, t, x, {"a": way * (6 - 12 * s) / lasts**2})
    assert verdict.ok is ok, verdict.explain()


@pytest.mark.parametrize(("value", "ok"), [(0.0, True), (-0.5, False)])
def test_a_parameter_keeps_its_range_though_it_hardly_costs(value: float, ok: bool) -> None:
    model, *_ = dynamics("way", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("way", model, 0.0, 1.0)
    p = problem.parameter("p", lower=0.0, upper=10.0, guess=1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    problem.minimize(leg.integral(model.symbol("u") ** 2) + 1e-10 * (p + 0.5) ** 2)
    t = np.linspace(0, 1, 31)
    verdict = go.verify_trajectory(problem, t, {"x": t}, {"u": 1 + 0 * t}, {"p": value})
    assert verdict.ok is ok, verdict.explain()
