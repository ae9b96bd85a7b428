"""Jumps that a flight crosses, kinks on which it rests, tables that it leaves: outside of the theorems, and named."""

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning.solution.optimality_verdict import Condition
from gnc_opt.planning.verification.nonsmooth_points import (
    KinkPoint,
    _find_longest_interval_on_kink,
    mark_condition_inconclusive_at_kink,
)

pytestmark = pytest.mark.filterwarnings("ignore::gnc_opt.ProblemWarning")

WIND = 0.3
"""Headwind beyond q = 0.5."""


def cart(model_name: str, rate) -> tuple[go.Model, go.Model]:
    model = go.Model(model_name)
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: rate(q, v, a, model.time)})
    return model, a


def stepped(rate) -> go.Problem:
    """From rest to rest in 2 s with the least effort."""
    model, a = cart("cart", rate)
    problem, leg = one_phase("through a step", model, 0.0, 2.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    problem.minimize(leg.integral(a**2))
    return problem


def pieces() -> go.Problem:
    """The same through the headwind, with a phase on each side of where it begins."""
    before, first_push = cart("still air", lambda q, v, a, t: a)
    beyond, second_push = cart("headwind", lambda q, v, a, t: a - WIND)
    problem = go.Problem("piece by piece")
    first, second = problem.phase("first", before), problem.phase("second", beyond)
    first.time(0.0, (0.2, 1.8))
    second.time((0.2, 1.8), 2.0)
    first.initial(q=0.0, v=0.0)
    first.final(q=0.5)
    second.final(q=1.0, v=0.0)
    problem.link(first, second)
    problem.minimize(first.integral(first_push**2) + second.integral(second_push**2))
    return problem


@pytest.fixture(scope="module")
def through() -> go.Solution:
    return go.solve(stepped(lambda q, v, a, t: a - WIND * ca.if_else(q > 0.5, 1.0, 0.0)), throw=False)


@pytest.fixture(scope="module")
def piecewise() -> go.Solution:
    return go.solve(pieces())


@pytest.mark.slow
def test_a_jump_that_a_flight_crosses_is_named_and_nothing_beyond_it_is_said(through: go.Solution) -> None:
    verdict = go.verify(through)
    told = verdict["kinks"]
    assert told.result is go.ConditionResult.INCONCLUSIVE and not verdict.ok and not verdict.failed
    assert "a comparison makes dx/dt or an integrand jump" in told.where
    crossing = float(told.where.split("t = ")[1].split(" s")[0])
    assert through.state("q")(crossing) == pytest.approx(0.5, abs=1e-5)
    assert told.value == pytest.approx(
        WIND * 2.0 / np.ptp(through.state("v")(np.linspace(0, 2, 401))), rel=1e-3
    )


def test_a_phase_on_each_side_makes_the_costates_jump_and_costs_less(
    through: go.Solution, piecewise: go.Solution
) -> None:
    verdict = go.verify(piecewise)
    assert verdict.minimum
    assert verdict["kinks"].result is go.ConditionResult.PASS
    assert piecewise.objective < through.objective - 1e-4
    lam = [piecewise.phase(name).lam for name in ("first", "second")]
    middle = piecewise.phase("first").final_time
    speed = piecewise.state("v", "first")(middle)
    jump = lam[0](middle, "left")[0] - lam[1](middle, "right")[0]
    # H is continuous: lambda_q v + lambda_v f; the jump of f by the wind is made up for by lambda_q.
    assert jump * speed == pytest.approx(-WIND * lam[1](middle, "right")[1], abs=1e-6)


def test_samples_of_the_right_flight_are_not_called_wrong(piecewise: go.Solution) -> None:
    switch = piecewise.phase("first").final_time
    t = np.concatenate([np.linspace(0.0, switch, 41), np.linspace(switch, 2.0, 41)[1:]])
    names = np.where(t <= switch, "first", "second")
    values = {n: [piecewise.state(n, p)(x) for x, p in zip(t, names, strict=True)] for n in ("q", "v")}
    push = [piecewise.control("a", p)(x) for x, p in zip(t, names, strict=True)]
    problem = stepped(lambda q, v, a, t: a - WIND * ca.if_else(q > 0.5, 1.0, 0.0))
    verdict = go.verify_trajectory(problem, t, values, {"a": push})
    assert not {"stationarity"} & {c.name for c in verdict.failed}
    assert verdict["kinks"].result is go.ConditionResult.INCONCLUSIVE


def test_a_wrong_end_fails_all_the_same(through: go.Solution) -> None:
    problem = stepped(lambda q, v, a, t: a - WIND * ca.if_else(q > 0.5, 1.0, 0.0))
    t = np.linspace(0.0, 2.0, 81)
    values = {n: through.state(n)(t) for n in ("q", "v")}
    verdict = go.verify_trajectory(problem.with_final(q=1.01), t, values, {"a": through.control("a")(t)})
    assert "boundary conditions" in {c.name for c in verdict.failed}


@pytest.mark.parametrize(
    "rate",
    [
        lambda q, v, a, t: a - 0.3 * v * ca.fabs(v),  # a kink of the second derivative, met at rest
        lambda q, v, a, t: a - 0.3 * ca.sign(v),  # friction jumps at rest, where the flight begins and ends
        lambda q, v, a, t: a - ca.if_else(q > 7.0, 1.0, 0.0),  # never met
        lambda q, v, a, t: a - 0.2 * ca.fmax(q - 0.5, 0.0),  # a kink in passing
    ],
)
def test_what_is_not_crossed_or_does_not_jump_is_checked(rate) -> None:
    verdict = go.verify(go.solve(stepped(rate), throw=False))
    assert verdict["kinks"].result is go.ConditionResult.PASS
    assert verdict.ok


@pytest.mark.slow
def test_a_flight_that_rests_on_a_kink_is_left_open() -> None:
    """It goes to y = 0, waits and returns; |y| has any slope there, and CasADi's is none."""
    model, y, u = dynamics("waits", "y", "u", lambda y, u: {y: u})
    problem, leg = one_phase("down, rest, up", model, 0.0, 4.0)
    leg.initial(y=1.0)
    leg.final(y=1.0)
    problem.minimize(leg.integral(u**2 + 4.0 * ca.fabs(y)))
    t = np.linspace(0.0, 4.0, 41)
    down = np.minimum(t, 1.0)
    side = np.where(t <= 2.0, down, np.minimum(4.0 - t, 1.0))
    # u^2 = 4 y while it moves: y = (1 - t)^2
    values = (1.0 - side) ** 2
    push = np.where(t <= 1.0, -2.0 * (1.0 - t), np.where(t >= 3.0, 2.0 * (t - 3.0), 0.0))
    verdict = go.verify_trajectory(problem, t, {"y": values}, {"u": push})
    assert verdict["kinks"].result is go.ConditionResult.INCONCLUSIVE
    assert "stays on the kink of fabs, 5" in verdict["kinks"].where
    assert not verdict.failed and not verdict.minimum


@pytest.mark.parametrize(
    ("of_rate", "jump", "value"),
    [(True, 0.06, 0.24), (False, 0.3, 2.4), (False, 1.3e-6, 1.04e-5), (False, 1.2e-6, 0.0)],
)
def test_a_jump_counts_relative_to_the_motion_or_to_the_cost(
    of_rate: bool, jump: float, value: float
) -> None:
    """y = t / 4 with the costate -0.5: jumps at y = 0.5 over 4 Ms, of the rate relative to 1, of the cost to 0.5."""
    mega = 1e6

    def step(y: Any, here: bool) -> Any:
        return jump * ca.if_else(y > 0.5, 1.0, 0.0) if here else 0.0

    model, y, u = dynamics("step", "y", "u", lambda y, u: {y: (u + step(y, of_rate)) / mega})
    problem, leg = one_phase("step", model, 0.0, 4.0 * mega)
    leg.initial(y=0.0)
    leg.final(y=1.0)
    problem.minimize(leg.integral((u**2 + step(y, not of_rate)) / mega))
    t = np.array([0.0, 1.0, 2.0, 2.0, 3.0, 4.0])
    verdict = go.verify_trajectory(problem, mega * t, t / 4, 0.25 - np.repeat([0.0, jump * of_rate], 3))
    kinks = verdict["kinks"]
    assert kinks.value == pytest.approx(value, rel=1e-6) and kinks.tolerance == 0.0
    assert (kinks.result is go.ConditionResult.INCONCLUSIVE) == (value > 0)
    assert ("t = 2e+06 s: a comparison makes dx/dt or an integrand jump" in kinks.where) == (value > 0)
    assert of_rate or (not verdict.failed and verdict.ok == (value == 0))


@pytest.mark.parametrize("order", ["control, state", "state, control", "control"])
def test_kinks_in_states_are_reported_before_kinks_in_controls(order: str) -> None:
    problem, cost, names = go.Problem("two kinks"), 0.0, order.split(", ")
    for name in names:
        model, y, z, u = dynamics(name, "y z", "u", lambda y, z, u: {y: u, z: ca.fabs(u)})
        leg = problem.phase(name, model)
        leg.time(0.0, 1.0)
        leg.initial(y=0.0, z=0.0)
        cost += leg.integral(u**2 + 4.0 * ca.fabs(y)) if name == "state" else leg.integral(u**2 + z)
    problem.minimize(cost)
    t = np.linspace(0.0, 1.0, 5)
    given = (dict.fromkeys(names, value) for value in (t, np.zeros((2, 5)), 0 * t))
    kinks = go.verify_trajectory(problem, *given)["kinks"]
    first = "state" if "state" in names else "control"
    assert kinks.where.startswith(f"from phase {first}, t = 0 s: stays on the kink of fabs, 100.0 %")


@pytest.mark.parametrize(
    ("top", "outside", "result"), [(0.5, "linear", "INCONCLUSIVE"), (2.0, "linear", "PASS")]
)
def test_flight_outside_of_a_table_is_a_condition(top, outside, result) -> None:
    model, y, u = dynamics("hop", "y", "u", lambda y, u: {y: u})
    price = go.table(np.linspace(0.0, top, 6), np.linspace(0.0, top, 6) ** 2, outside=outside, name="price")
    problem, leg = one_phase("hop", model, 0.0, 1.0)
    leg.initial(y=0.0)
    leg.final(y=1.0)
    problem.minimize(leg.integral(u**2 + price(y)))
    verdict = go.verify(go.solve(problem))
    told = verdict["limits"]
    assert told.result is go.ConditionResult[result]
    assert verdict.ok and verdict.minimum is (result == "PASS")
    assert told.value == pytest.approx(max(0.0, 1.0 - top) / top, abs=1e-9)
    assert ("'price' evaluated outside" in told.where) is (result != "PASS")


@pytest.mark.parametrize("where", ["cost", "boundary constraint", "neither"])
def test_a_table_at_the_ends_is_checked(where: str) -> None:
    """x(1) = 1.5 is optimal, but the data of the table end at 1."""
    model, _x, u = dynamics("hop", "x", "u", lambda x, u: {x: u})
    price = go.table(np.linspace(0.0, 1.0, 6), np.linspace(1.0, 1.5, 6), outside="error", name="price")
    problem, leg = one_phase("hop", model, 0.0, 1.0)
    leg.initial(x=0.5)
    end = price(leg.final_state("x"))
    if where == "boundary constraint":
        problem.constrain("price", end, lower=1.75)
    problem.minimize(leg.integral(u**2) - (4.0 * end if where == "cost" else 0.0))
    t = np.linspace(0.0, 1.0, 5)
    told = go.verify_trajectory(problem, t, 0.5 + t, 1.0 + 0.0 * t)["limits"]
    assert (told.result is go.ConditionResult.FAIL) == (where != "neither")
    if where != "neither":
        assert told.value == pytest.approx(0.5)
        assert "outside in the cost or a boundary constraint: 1.5, beyond 0 to 1" in told.where


@pytest.mark.parametrize("reach", [1.0, 1e3])
def test_a_concave_kink_does_not_enlarge_the_scale_by_which_it_is_measured(reach: float) -> None:
    """Without effort nothing but -|x| costs: x = 0 is the worst path, and its second difference is no curvature."""
    model = go.Model("kink")
    x, y, u = model.state("x"), model.state("y"), model.control("u")
    model.ode({x: u, y: -ca.fabs(x)})
    problem, leg = one_phase("kink", model, 0.0, 1.0)
    leg.initial(x=0.0, y=0.0)
    leg.bounds(u=(-reach, reach))
    problem.minimize(leg.final_state("y"))
    t = np.linspace(0.0, 1.0, 61)
    verdict = go.verify_trajectory(problem, t, {"x": 0 * t, "y": 0 * t}, {"u": 0 * t})
    assert verdict["kinks"].result.value == "FAIL"


def rotated(x: Any, y: Any) -> Any:
    a, b = x * np.cos(0.6) + y * np.sin(0.6), y * np.cos(0.6) - x * np.sin(0.6)
    return 0.8 * ca.fabs(a) + 0.8 * ca.fabs(b) - 1.2 * ca.fmax(ca.fabs(a), ca.fabs(b))


@pytest.mark.parametrize("place", ["end", "parameters", "integrand"])
@pytest.mark.parametrize(
    ("kinks", "result"),
    [
        (lambda x, y: 100 * ca.fabs(x + y) - ca.fabs(x - y), "FAIL"),
        (lambda x, y: 1.5 * ca.fmax(ca.fabs(x), ca.fabs(y)) - ca.fabs(x) - ca.fabs(y), "FAIL"),
        (rotated, "FAIL"),
        (lambda x, y: 100 * ca.fabs(x - y) - ca.fabs(x + y), "FAIL"),
        (lambda x, y: ca.fabs(x + y) + 2 * ca.fabs(x - 2 * y), "PASS"),
        (lambda x, y: ca.fabs(x) + ca.fabs(y) - 0.9 * ca.fmax(ca.fabs(x), ca.fabs(y)), "INCONCLUSIVE"),
    ],
)
def test_kinks_that_meet(kinks: Any, result: str, place: str) -> None:
    """At x = y = 0 the cost decreases along x = -y, x = y or rotated axes; or is convex; or neither."""
    model, x, y, u, w = dynamics("plane", "x y", "u w", lambda x, y, u, w: {x: u, y: w})
    problem, leg = one_phase("plane", model, 0.0, 1.0)
    leg.initial(x=0.0, y=0.0)
    a, b = (problem.parameter(name, lower=-1.0, upper=1.0, guess=0.0) for name in ("a", "b"))
    at = {"end": (leg.final_state("x"), leg.final_state("y")), "parameters": (a, b), "integrand": (x, y)}
    told = kinks(*at[place])
    cost = leg.integral(u**2 + w**2) + a**2 + b**2
    problem.minimize(cost + (leg.integral(told) if place == "integrand" else told))
    t = np.linspace(0.0, 1.0, 11)
    none = {"a": 0.0, "b": 0.0}
    verdict = go.verify_trajectory(problem, t, {"x": 0 * t, "y": 0 * t}, {"u": 0 * t, "w": 0 * t}, none)
    assert verdict["kinks"].result is go.ConditionResult[result]
    assert verdict.ok == (result != "FAIL")


@pytest.mark.parametrize(
    ("name", "of_states", "fails"),
    [("minimum principle", False, True), ("minimum principle", True, False), ("stationarity", False, False)],
)
def test_only_values_of_the_hamiltonian_fail_at_kinks_and_of_controls_alone(
    name: str, of_states: bool, fails: bool
) -> None:
    failed = Condition(name, go.ConditionResult.FAIL, 1.0, 0.0, "here", "meaning")
    kink = KinkPoint(0.0, "there", jump=False, of_states=of_states)
    found = mark_condition_inconclusive_at_kink(failed, kink)
    assert (found.result is go.ConditionResult.FAIL) == fails


@pytest.mark.parametrize(
    ("of_states", "share", "word"), [((False, True), 0.25, "b"), ((False, False), 0.5, "a")]
)
def test_the_longest_rest_on_a_kink_in_shares_of_the_phase(
    of_states: tuple[bool, bool], share: float, word: str
) -> None:
    """Of 8 s, one argument is at zero from sample 1 for 4 s, the other one from sample 3 for 2 s."""
    s: Any = SimpleNamespace(weights=np.full(4, 2.0), span=8.0, describe_sample=lambda j: f"sample {j}")
    kinks: Any = SimpleNamespace(is_state_dependent=np.array(of_states), words=("a", "b"))
    values = np.array([[5.0, 0.0, 2e-6, 9.0], [1.0, -1.0, 1.0, 9e-7]])
    found = _find_longest_interval_on_kink(s, kinks, values)
    begin = {"a": 1, "b": 3}[word]
    where = f"from sample {begin}: stays on the kink of {word}, {100 * share:.1f} % of the phase"
    assert found == KinkPoint(share, where, False, any(of_states))
    assert _find_longest_interval_on_kink(s, kinks, values + 1e-4) is None
