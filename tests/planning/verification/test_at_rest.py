"""Controls that do nothing, and solutions that cost nothing: violations are not measured in shares of rounding."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from testing import constructed_solutions as by_hand
from testing.great_circle import great_circle
from testing.models import dynamics, one_phase
from testing.second_order import second_order_of
from testing.wrong_solutions import added, failed

import gnc_opt as go
from gnc_opt.array_types import Array


def at_rest(*, beside: bool = True, unit: float = 1.0, cost: float = 1.0) -> go.Problem:
    """Least integral of u^2 - x^2 over 2 s from 0 to 0: x = u = 0, a minimum, beside a clock that moves or alone."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    equations = {x: u}
    if beside:
        equations[model.state("clock")] = 1.0 + 0 * u
    model.ode(equations)
    problem, leg = one_phase("at rest", model, 0.0, 2.0)
    leg.initial(**dict.fromkeys(leg.model.states.names, 0.0))
    leg.final(x=0.0)
    problem.minimize(cost * leg.integral((u / unit) ** 2 - (x / unit) ** 2))
    return problem


def with_rounding(solution: go.Solution, size: float) -> go.Solution:
    """Rounding of some size in everything that is zero."""
    for piece, row in (("x", 0), ("u", 0), ("lam", 0)):
        for segment, point in ((0, 1), (1, 2), (2, 0)):
            solution = added(solution, piece, row, (-1) ** segment * size, segment, point)  # type: ignore[arg-type]
    return solution


@pytest.mark.parametrize(("beside", "noise"), [(False, 0.0), (False, 1e-15), (True, 1e-100), (True, 1e-15)])
def test_rounding_about_a_solution_that_costs_nothing_is_no_violation(beside: bool, noise: float) -> None:
    solution = with_rounding(go.solve(at_rest(beside=beside), mesh="4x4", tol=None), noise)
    verdict = go.verify(replace(solution, objective=0.0))
    assert verdict.minimum, verdict.explain()


@pytest.mark.parametrize(("unit", "cost"), [(1e3, 1e-6), (1e-3, 1e6)])
def test_nor_is_it_in_other_units(unit: float, cost: float) -> None:
    verdict = go.verify(go.solve(at_rest(unit=unit, cost=cost), mesh="4x4", tol=None))
    assert verdict.minimum, verdict.explain()


@pytest.mark.parametrize(("piece", "condition"), [("lam", "stationarity"), ("u", "dynamics")])
def test_what_is_no_rounding_fails_there(piece: str, condition: str) -> None:
    solution = go.solve(at_rest(), mesh="4x4", tol=None)
    assert condition in failed(added(solution, piece, 0, 1e-2, 1))  # type: ignore[arg-type]


def test_an_idle_control_is_measured_by_what_the_other_is_worth() -> None:
    """Across the great circle nothing moves; a control along it of arc costs as much as one across."""
    arc = 2.0
    solution = go.solve(great_circle(arc), mesh="4x6", tol=None)
    verdict = go.verify(solution)
    assert verdict.minimum, verdict.explain()
    # The curvature 1 over b's span, arc, in shares of what half of it is worth by the slope arc; a's shares are larger.
    legendre = second_order_of(solution)["Legendre-Clebsch"]
    assert legendre.value == pytest.approx(-(arc**2) / (arc**2 / 2), rel=1e-6)
    assert {"stationarity", "minimum principle"} & failed(added(solution, "lam", 0, 1e-3 * arc, 1))


@pytest.mark.parametrize("bend", [-1.0, 0.0])
def test_an_idle_control_without_curvature_stays_singular_and_a_maximum_fails(bend: float) -> None:
    """w beside a clock that a second control drives: H = b^2 / 2 + bend w^2 / 2 at w = 0."""
    model, _x, _y, w, b = dynamics("beside", "x y", "w b", lambda x, y, w, b: {x: w, y: b})

    def problem(bend: float) -> go.Problem:
        result, leg = one_phase("beside", model, 0.0, 1.0)
        leg.initial(x=0.0, y=0.0)
        leg.final(x=0.0, y=1.0)
        result.minimize(leg.integral(0.5 * b**2 + 0.5 * bend * w**2))
        return result

    parts = second_order_of(replace(go.solve(problem(1.0), mesh="2x3", tol=None), problem=problem(bend)))
    expected = go.ConditionResult.FAIL if bend < 0 else go.ConditionResult.PASS  # b alone curves H
    assert parts["Legendre-Clebsch"].result is expected
    assert (parts["singular arcs"].result is go.ConditionResult.INCONCLUSIVE) == (bend == 0)
    if not bend:
        assert parts["singular arcs"].value == pytest.approx(1.0)
    assert np.isfinite(parts["Legendre-Clebsch"].value)


def sled(rest: float, friction: float) -> go.Solution:
    """From rest to rest over 1 m in minimum time against Coulomb friction of 0.2 m/s^2, |a| <= 1: v' = 0.8, then -1.2.

    The switch is at sqrt(3 / 2) s, the end at 5 / sqrt(6) s; H = -1 gives the costates. ``rest`` is the velocity that
    rounding leaves at both ends; ``friction`` is that of the problem by which it is judged.
    """
    model, *_ = dynamics("sled", "q v", "a", lambda q, v, a: {q: v, v: a - friction * ca.sign(v)})
    problem, leg = one_phase("sled", model, 0.0, (0.1, 10.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    switch, end = np.sqrt(1.5), 5 / np.sqrt(6)

    def states(t: Array, k: int) -> Array:
        last = end - t
        return np.array([0.4 * t**2, rest + 0.8 * t] if k == 0 else [1 - 0.6 * last**2, rest + 1.2 * last])

    flown = by_hand.phase(
        problem,
        states,
        lambda t, k: np.array([1.0 - 2 * k + 0 * t]),
        lambda t, k: np.array([-1 / (0.8 * switch) + 0 * t, -1.25 + t / (0.8 * switch)]),
        breaks=(0.0, switch, end),
    )
    return by_hand.solution(problem, flown, objective=end)


@pytest.mark.parametrize("rest", [-1e-12, 0.0, 1e-12])
def test_friction_at_rest_is_that_of_the_motion(rest: float) -> None:
    """The sign of a velocity that is rounding must not decide: at both ends friction acts as beside them."""
    verdict = go.verify(sled(rest, 0.2))
    amiss = {c.name for c in (*verdict.failed, *verdict.inconclusive)}
    assert amiss == {"cost"}, verdict.explain()  # limits, which a trajectory by hand does not keep
    assert {"dynamics", "stationarity"} <= {c.name for c in go.verify(sled(rest, 0.2002)).failed}


@pytest.mark.parametrize(("noise", "size"), [(1e-30, 1e6), (1e-9, 1e-6)])
def test_a_cost_that_many_controls_bring_to_zero_is_flat_and_not_a_maximum(noise: float, size: float) -> None:
    """A pendulum can be brought to rest in many ways: costates and what they bend by are rounding, of any sign."""
    model, *_ = dynamics("pendulum", "q v", "a", lambda q, v, a: {q: v, v: a - ca.sin(q)})
    problem, leg = one_phase("pendulum", model, 0.0, 2.0)
    leg.initial(q=1.0, v=0.0)
    leg.bounds(a=(-20.0, 20.0))
    problem.minimize(size * (leg.final_state("q") ** 2 + leg.final_state("v") ** 2))
    solution = go.solve(problem, mesh="4x4", tol=None)
    assert solution.objective < 1e-12 * size
    lam = solution.phase().lam
    rough = tuple(
        noise * size * np.cos(np.arange(v.size) + k).reshape(v.shape) for k, v in enumerate(lam.values)
    )
    leg_solution = replace(solution.phase(), lam=replace(lam, values=rough))
    for sign in (1.0, -1.0):
        values = tuple(sign * v for v in rough)
        turned = replace(leg_solution, lam=replace(lam, values=values))
        condition = go.verify(replace(solution, phases={"leg": turned}))["second order"]
        assert condition.result is go.ConditionResult.INCONCLUSIVE, condition
        assert "cannot be distinguished from zero" in condition.where


@pytest.mark.slow
def test_a_flight_that_needs_no_control_has_reference_scales() -> None:
    """Thrown by itself from floor to floor: controls, costates and the push of the floor are rounding."""
    model, _h, _v, a = dynamics("ball", "h v", "a", lambda h, v, a: {h: v, v: a - 1.0})
    problem, leg = one_phase("throw", model, 0.0, 1.0)
    leg.initial(h=0.0)
    leg.final(h=0.0)
    leg.bounds(h=(0.0, None))
    problem.minimize(leg.integral(a**2))
    verdict = go.verify(go.solve(problem, mesh="5x4", tol=None))
    assert verdict.minimum, verdict.explain()
    t = np.linspace(0.0, 1.0, 41)
    pushed = {"h": 0.51 * t * (1 - t), "v": 0.51 - 1.02 * t}
    assert not go.verify_trajectory(problem, t, pushed, {"a": 0 * t - 0.02}).ok


@pytest.mark.parametrize(("unit", "origin"), [(1.0, 0.0), (1e4, 0.0), (1.0, 1e5)])
@pytest.mark.parametrize(("coupling", "best"), [(1.5, True), (2.5, False)])
def test_a_constant_push_without_limits_has_a_reference_scale(
    unit: float, origin: float, coupling: float, best: bool
) -> None:
    """(u - 1)^2 + k^2 + c k s, s being how far the end is off 1: a minimum at u = 1, k = 0 for c < 2, else a saddle."""
    model, _x, u = dynamics("pushed", "x", "u", lambda x, u: {x: u - origin})
    problem = go.Problem("pushed")
    k = problem.parameter("k", lower=-5.0, upper=5.0, guess=0.0)
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    off = leg.final_state("x") / unit - 1.0
    problem.minimize(leg.integral(((u - origin) / unit - 1.0) ** 2) + k**2 + coupling * k * off)
    t = np.linspace(0.0, 1.0, 11)
    verdict = go.verify_trajectory(problem, t, [unit * t], 0 * t + origin + unit, {"k": 0.0})
    assert verdict.minimum is best and verdict.ok is best, verdict.explain()


@pytest.mark.parametrize("noise", [1e-300, 1e-16, 1e-8])
def test_an_idle_axis_and_an_uncontrolled_state_may_contain_rounding_errors(noise: float) -> None:
    """Rest to rest along x with least effort; y, its rate and control, and a constant c are rounding errors."""
    model, *_ = dynamics(
        "axes", "x y v w c", "a b", lambda x, y, v, w, c, a, b: {x: v, y: w, v: a, w: b, c: 0 * c}
    )
    problem, leg = one_phase("axes", model, 0.0, 1.0)
    leg.initial(x=0.0, y=0.0, v=0.0, w=0.0, c=0.0)
    leg.final(x=1.0, y=0.0, v=0.0, w=0.0)
    problem.minimize(leg.integral(model.symbol("a") ** 2 + model.symbol("b") ** 2))
    t = np.linspace(0, 1, 61)
    y, w, b = np.random.default_rng(0).standard_normal((3, t.size)) * noise
    c = min(noise, 1e-16) * np.sin(7 * t)
    y[[0, -1]] = w[[0, -1]] = c[0] = 0.0
    x = {"x": 3 * t**2 - 2 * t**3, "y": y, "v": 6 * t - 6 * t**2, "w": w, "c": c}
    verdict = go.verify_trajectory(problem, t, x, {"a": 6 - 12 * t, "b": b})
    assert verdict.minimum, verdict.explain()


@pytest.mark.parametrize("price", [2.0, 0.1])
def test_a_kink_that_only_an_idle_control_reaches_is_found(price: float) -> None:
    """Least effort from x = 0 to 1 less k |y(1)|: y(1) = k / 2 costs k^2 / 4 less than y = 0."""
    model, *_ = dynamics("plane", "x y", "u w", lambda x, y, u, w: {x: u, y: w})
    problem, leg = one_phase("plane", model, 0.0, 1.0)
    leg.initial(x=0.0, y=0.0)
    leg.final(x=1.0)
    effort = leg.integral(model.symbol("u") ** 2 + model.symbol("w") ** 2)
    problem.minimize(effort - price * ca.fabs(leg.final_state("y")))
    t = np.linspace(0, 1, 61)
    verdict = go.verify_trajectory(problem, t, {"x": t, "y": 0 * t}, {"u": 1 + 0 * t, "w": 0 * t})
    assert [c.name for c in verdict.failed] == ["kinks"], verdict.explain()


@pytest.mark.parametrize("bound", [30.0, 3000.0])
def test_a_heading_whose_effect_vanishes_at_its_value_is_not_at_rest(bound: float) -> None:
    """x' = cos h + 0.4 cos 2h, most x: h = pi is the better of its neighbours with -0.6, h = 0 attains 1.4."""
    model = go.Model("heading")
    x, h = model.state("x"), model.control("h")
    model.ode({x: ca.cos(h) + 0.4 * ca.cos(2 * h)})
    problem, leg = one_phase("heading", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(h=(-bound, bound))
    problem.maximize(leg.final_state("x"))
    t = np.linspace(0.0, 1.0, 61)
    verdict = go.verify_trajectory(problem, t, {"x": -0.6 * t}, {"h": np.full(t.size, np.pi)})
    assert verdict["minimum principle"].result is go.ConditionResult.FAIL
