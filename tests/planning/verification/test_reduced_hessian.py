"""Second order of smooth problems: minima pass, saddles and maxima that satisfy every first-order condition fail."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from testing.great_circle import great_circle, regulator

import gnc_opt as go
from gnc_opt.planning import ConditionResult
from gnc_opt.planning.verification.reduced_hessian import lanczos

PASS, FAIL, UNTOLD = ConditionResult.PASS, ConditionResult.FAIL, ConditionResult.INCONCLUSIVE


def second_order(solution: go.Solution) -> go.Condition:
    return go.verify(solution)["second order"]


@pytest.mark.parametrize("phases", [1, 2])
@pytest.mark.parametrize(("arc", "result"), [(0.5, PASS), (0.98, PASS), (1.02, FAIL), (1.5, FAIL)], ids=str)
def test_great_circle_is_shortest_up_to_half_the_sphere(
    arc: float, result: ConditionResult, phases: int
) -> None:
    solution = go.solve(great_circle(arc * np.pi, phases), mesh="4x6", tol=None)
    assert {c.name for c in go.verify(solution).failed} <= {"second order"}
    assert solution.objective == pytest.approx(0.5 * (arc * np.pi) ** 2)
    condition = second_order(solution)
    assert condition.result is result, condition
    # Bulging by theta = e sin(pi t) costs e^2 / 4 (pi^2 - arc^2): the curvature changes its sign at half the sphere.
    assert np.sign(condition.value) == np.sign(arc - 1)


@pytest.fixture(scope="module")
def at_rest() -> go.Solution:
    return go.solve(regulator(1.0), mesh="4x5", tol=None)


@pytest.mark.parametrize(("share", "result"), [(0.97, PASS), (1.0, UNTOLD), (1.03, FAIL), (4.5, FAIL)])
def test_regulator_before_and_past_its_conjugate_point(
    at_rest: go.Solution, share: float, result: ConditionResult
) -> None:
    """At the conjugate point itself sin(pi t) costs nothing, and no test of the second order can tell."""
    condition = second_order(replace(at_rest, problem=regulator(share * np.pi**2)))
    assert condition.result is result, condition


def test_gain_is_what_the_step_gains(at_rest: go.Solution) -> None:
    """The worst variation is close to sin(pi t): a step of 0.1 of u gains 0.05^2 / 2 (weight / pi^2 - 1) cos^2."""
    condition = second_order(replace(at_rest, problem=regulator(2 * np.pi**2)))
    gain = float(condition.where.split("gains ")[1].split(" ")[0])
    assert gain == pytest.approx(0.1**2 * 0.5, rel=0.05)


def slow_disc(shallow: float) -> go.Problem:
    """Minimum time across a disc where everything is slow; straight through is stationary by symmetry."""
    model = go.Model("slow disc")
    x, y, heading = model.state("x"), model.state("y"), model.control("heading")
    speed = 1 - shallow * ca.exp(-4 * (x**2 + y**2))
    model.ode({x: speed * ca.cos(heading), y: speed * ca.sin(heading)})
    problem = go.Problem("slow disc")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.1, 20.0))
    leg.initial(x=-1.0, y=0.0)
    leg.final(x=1.0, y=0.0)
    leg.bounds(heading=(-1.5, 1.5))
    problem.minimize(leg.final_time)
    return problem


@pytest.mark.parametrize(("shallow", "result"), [(0.1, PASS), (0.8, FAIL)])
def test_straight_through_a_slow_disc(shallow: float, result: ConditionResult) -> None:
    """Round a deep one is faster: 2.72 s instead of 4.17 s."""
    straight = go.solve(slow_disc(shallow).with_bounds(y=(-1e-9, 1e-9)), mesh="10x5", tol=None)
    condition = second_order(replace(straight, problem=slow_disc(shallow)))
    assert condition.result is result, condition


def designed(cost: object, *, lower: float | None = None) -> go.Solution:
    """A cost in two free parameters, from (0, 0), beside an integrator that does nothing."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("two parameters")
    k, m = (problem.parameter(name, lower=lower, upper=1.0, guess=0.0) for name in ("k", "m"))
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    problem.minimize(leg.integral(u**2) + k**2 + m**2)
    solution = go.solve(problem, mesh="2x3", tol=None)
    other = go.Problem("two parameters")
    k, m = (other.parameter(name, lower=lower, upper=1.0, guess=0.0) for name in ("k", "m"))
    leg = other.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    other.minimize(leg.integral(u**2) + cost(k, m))  # type: ignore[operator]
    return replace(solution, problem=other, parameter_values=np.zeros(2), objective=0.0)


@pytest.mark.parametrize(
    ("cost", "lower", "result"),
    [
        (lambda k, m: k**2 + m**2 + k * m, None, PASS),
        (lambda k, m: k**2 + m**2 + 3 * k * m, None, FAIL),
        (lambda k, m: k**2, None, UNTOLD),
        # On a bound that does not push, only one side of it counts: the cost is copositive, or it is not.
        (lambda k, m: k**2 - m**2, 0.0, FAIL),
        (lambda k, m: k**2 + m**2 - 3 * k * m, 0.0, FAIL),
        (lambda k, m: k**2 + m**2 + 3 * k * m, 0.0, UNTOLD),
        (lambda k, m: k + m - k**2 - m**2, 0.0, PASS),
    ],
)
def test_free_parameters_take_part(cost: object, lower: float | None, result: ConditionResult) -> None:
    condition = second_order(designed(cost, lower=lower))
    assert condition.result is result, condition


def test_an_inactive_constraint_takes_no_direction(at_rest: go.Solution) -> None:
    """x(1) <= 5 and an integral of x below 5 hold nothing; equalities would."""
    for active, result in ((False, FAIL), (True, PASS)):
        problem = regulator(1.5 * np.pi**2)
        leg = problem.phases["leg"]
        x = leg.model.symbol("x")
        # The worst variation, sin(pi t), has an integral; those without need four times the weight.
        problem.constrain("integral", leg.integral(x), **({"equals": 0.0} if active else {"upper": 5.0}))
        held = go.solve(problem.with_parameters(k=1.0), mesh="4x5", tol=None)
        condition = second_order(replace(held, problem=problem))
        assert condition.result is result, condition


def test_curvature_does_not_depend_on_units_of_the_cost() -> None:
    """Nor does the sign depend on what is added to it."""
    values = []
    for factor, constant in ((1.0, 0.0), (1e-4, 0.0), (1e4, 1e6)):
        problem = great_circle(0.9 * np.pi)
        problem.cost = factor * problem.cost + constant
        values.append(second_order(go.solve(problem, mesh="4x6", tol=None)).value)
    np.testing.assert_allclose(values, values[0], rtol=1e-4)


@pytest.mark.parametrize("end, result", [(2.0, PASS), (-2.0, FAIL)])
def test_curvature_in_a_control_that_rests_does_not_depend_on_its_unit(
    end: float, result: ConditionResult
) -> None:
    """Out of a circle of radius 2 from 1/2 beside its middle: straight ahead is best, by the far side worst.

    The other control is zero all along, and H curves in it by 2e-8 of what one unit of it could tell.
    """
    found, t = [], np.linspace(0.0, 1.0, 21)
    for unit in (1.0, 1e4):
        model = go.Model("plane")
        x, y, u, w = model.state("x"), model.state("y"), model.control("u"), model.control("w")
        model.ode({x: u, y: w})
        problem = go.Problem("out of a circle")
        leg = problem.phase("leg", model)
        leg.time(0.0, 1.0)
        leg.initial(x=0.5 * unit, y=0.0)
        radius2 = leg.final_state("x") ** 2 + leg.final_state("y") ** 2
        problem.constrain("out", radius2 / unit**2, lower=4.0)
        problem.minimize(leg.integral(u**2 + w**2) / unit**2)
        states = {"x": unit * (0.5 + (end - 0.5) * t), "y": 0 * t}
        verdict = go.verify_trajectory(problem, t, states, {"u": unit * (end - 0.5) + 0 * t, "w": 0 * t})
        found.append(verdict["second order"])
    assert [c.result for c in found] == [result, result]
    assert found[1].value == pytest.approx(found[0].value, rel=1e-6)


def test_simple_solutions_are_varied_on_richer_meshes() -> None:
    """Refined, x = 0 needs a mesh with as many conditions as unknowns only, which leaves nothing to vary."""
    solution = replace(go.solve(regulator(1.0), mesh="1x2", tol=None), problem=regulator(1.5 * np.pi**2))
    assert second_order(solution).result is FAIL


def test_lanczos_finds_both_ends_of_a_spectrum() -> None:
    values = np.concatenate([[-3.0], np.linspace(0.0, 1.0, 300), [2.0]])
    turned = np.linalg.qr(np.random.default_rng(1).standard_normal((values.size, values.size)))[0]
    matrix = turned @ np.diag(values) @ turned.T
    found, vectors = lanczos(lambda v: matrix @ v, np.ones(values.size), 80)
    assert found[0] == pytest.approx(-3.0, abs=1e-7) and found[-1] == pytest.approx(2.0, abs=1e-7)
    np.testing.assert_allclose(matrix @ vectors[:, 0], found[0] * vectors[:, 0], atol=1e-3)


def mirror(bend: float, unit: float = 1.0, cost: float = 1.0) -> go.Verdict:
    """From (-1, 0) to (1, 0) over the mirror y = 1 - bend x^2, at its middle: Fermat's stationary time.

    The ellipse with these foci through (0, 1) bends by 1/4: a mirror that bends more is nearer beside its middle.
    """
    problem = go.Problem("mirror")
    legs = []
    for name in ("towards_", "away"):
        model = go.Model(name)
        x, y, heading = model.state("x"), model.state("y"), model.control("heading")
        model.ode({x: unit * ca.cos(heading), y: unit * ca.sin(heading)})
        legs.append(problem.phase(name, model))
    legs[0].time(0.0, (0.5, 5.0))
    legs[1].time((0.5, 5.0), (1.0, 10.0))
    legs[0].initial(x=-unit, y=0.0)
    legs[1].final(x=unit, y=0.0)
    problem.link(*legs)
    x, y = (legs[0].final_state(name) / unit for name in ("x", "y"))
    problem.constrain("mirror", y + bend * x**2, lower=1.0, upper=1.0)
    problem.minimize(cost * legs[1].final_time)
    way, none = unit * np.linspace(0.0, 1.0, 11), np.zeros(11)
    t = way / unit * np.sqrt(2)
    return go.verify_trajectory(
        problem,
        {"towards_": t, "away": np.sqrt(2) + t},
        {"towards_": [way - unit, way], "away": [way, unit - way]},
        {"towards_": none + np.pi / 4, "away": none - np.pi / 4},
    )


@pytest.mark.parametrize(("unit", "cost"), [(1.0, 1.0), (1e3, 1e-6), (1e-3, 1e6)])
@pytest.mark.parametrize(("bend", "result"), [(-0.3, PASS), (0.2, PASS), (0.3, FAIL), (1.0, FAIL)])
def test_a_mirror_is_left_where_it_was_reached_first_unless_it_bends_too_much(
    bend: float, result: ConditionResult, unit: float, cost: float
) -> None:
    verdict = mirror(bend, unit, cost)
    assert verdict.minimum is (result is PASS), verdict.explain()
    assert [c.name for c in verdict.failed] == ([] if result is PASS else ["second order"])


@pytest.mark.parametrize("stated", ["path", "parameter"])
def test_an_arc_on_a_path_constraint_is_held_where_it_begins(stated: str) -> None:
    """As high as possible on average below 0.8, at 1 at most: up to the ceiling in 0.8 s, and 0.48 in all.

    Between the points of the arc a variation would gain that vanishes at all of them.
    """
    model = go.Model("rise")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("rise")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-1.0, 1.0))
    ceiling = problem.parameter("p", lower=0.0, upper=0.8, guess=0.5) if stated == "parameter" else 0.8
    leg.path("ceiling", x - ceiling, upper=0.0)
    problem.maximize(leg.integral(x))
    t = np.array([*np.linspace(0.0, 0.8, 9), *np.linspace(0.8, 1.0, 5)])
    push = np.repeat([1.0, 0.0], [9, 5])
    verdict = go.verify_trajectory(
        problem, t, np.minimum(t, 0.8), push, [0.8] if stated == "parameter" else None
    )
    assert verdict.minimum, verdict.explain()


@pytest.mark.parametrize(("product", "minimum"), [(1.0, True), (3.5, False)])
def test_a_saddle_far_steeper_than_the_middle_row_is_seen(product: float, minimum: bool) -> None:
    """p^2 / 2 + r^2 + product p r, and a speed in 1e-4 of its unit beside it: as steep as 1e8 middle rows."""
    cart = go.Model("cart")
    x, u = cart.state("x"), cart.control("u")
    cart.ode({x: u})
    problem = go.Problem("saddle")
    leg = problem.phase("leg", cart)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=0.0)
    p, r = (problem.parameter(name, lower=-9.0, upper=9.0, guess=0.3) for name in ("p", "r"))
    problem.minimize(leg.integral((1e-4 * u - p) ** 2) + 0.5 * p**2 + r**2 + product * p * r)
    t = np.linspace(0.0, 1.0, 11)
    verdict = go.verify_trajectory(problem, t, [0 * t], [0 * t], [0.0, 0.0])
    assert verdict.minimum == minimum
    assert (verdict["second order"].result is FAIL) != minimum
