"""Lower bounds: what a part of a problem costs by itself, and the problems that bound themselves."""

import math
import sys
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.planning import Verdict
from gnc_opt.planning.study.lower_bounds import CONVEX, LINEAR_TIME_OPTIMAL, theorem_of
from gnc_opt.planning.study.relaxation import relaxations
from gnc_opt.report import summary_dict


def two_carts(first: float, second: float, drag: float = 0.2) -> go.Problem:
    """Rest to rest at one time, the first cart without drag: alone it takes 2 sqrt(distance)."""
    carts = go.Model("carts")
    q, v, a = carts.state("q", 2, unit="m"), carts.state("v", 2, unit="m/s"), carts.control("a", 2)
    carts.ode({q: v, v: ca.vertcat(a[0], a[1] - drag * v[1] ** 3)})
    problem = go.Problem("two carts arrive together")
    leg = problem.phase("leg", carts)
    leg.time(0.0, (0.1, 20.0))
    leg.initial(q=[first, second], v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=([-1.0, -1.0], [1.0, 1.0]))
    problem.minimize(leg.final_time)
    return problem


@pytest.fixture(scope="module")
def together() -> go.Solution:
    return go.lower_bound(go.solve(two_carts(4.0, 1.0)))


def test_the_slower_of_two_decoupled_carts_bounds_both_and_is_attained(together: go.Solution) -> None:
    assert together.bound is not None
    assert together.bound.states == ("q[0]", "v[0]")
    assert together.bound.theorem == LINEAR_TIME_OPTIMAL and together.bound.certified
    assert together.bound.value == pytest.approx(2.0 * math.sqrt(4.0), abs=1e-8)
    assert together.gap == pytest.approx(0.0, abs=1e-8)


def test_a_solution_the_verdict_and_their_reports_tell_the_bound(together: go.Solution) -> None:
    assert "bound        at least 4 by q[0], v[0] (global, linear and time-optimal)" in str(together)
    verdict = go.verify(together)
    assert verdict.bound is together.bound and verdict.gap == together.gap
    assert "from the global optimum" in verdict.headline
    told = summary_dict(together)["bound"]
    assert told == {
        "value": together.bound.value,
        "gap": together.gap,
        "states": ["q[0]", "v[0]"],
        "certified": True,
        "theorem": LINEAR_TIME_OPTIMAL,
    }


def test_the_gap_is_that_of_the_objective_at_hand(together: go.Solution) -> None:
    assert replace(together, objective=5.0).gap == pytest.approx((5.0 - 4.0) / 5.0, abs=1e-8)
    assert replace(together, objective=-5.0, maximised=True).gap == pytest.approx(9.0 / 5.0, abs=1e-8)
    assert replace(together, bound=None).gap is None


def test_files_keep_no_bound(together: go.Solution, tmp_path) -> None:
    known = go.load(together.save(tmp_path / "plan.npz"), problem=two_carts(4.0, 1.0))
    assert known.bound is None and known.gap is None
    assert "bound" not in {line.split()[0] for line in str(known).splitlines()}


def test_a_part_that_others_wait_for_leaves_a_gap() -> None:
    """The cart with drag is slower: no theorem speaks for it, but the other one's 2 s hold for both."""
    bounded = go.lower_bound(go.solve(two_carts(1.0, 4.0)))
    assert bounded.bound is not None
    assert bounded.bound.certified and bounded.bound.value == pytest.approx(2.0, abs=1e-8)
    assert bounded.objective > 4.0
    assert bounded.gap == pytest.approx(1.0 - 2.0 / bounded.objective, abs=1e-7)


def follower() -> go.Problem:
    """A pendulum in the least time, and a cart that its angle pushes: the pendulum needs no cart."""
    model = go.Model("pendulum and cart")
    angle, rate, q, torque = (
        model.state("angle"),
        model.state("rate"),
        model.state("q"),
        model.control("torque"),
    )
    model.ode({angle: rate, rate: torque - ca.sin(angle), q: ca.sin(angle)})
    problem = go.Problem("swing")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.1, 20.0))
    leg.initial(angle=1.0, rate=0.0, q=0.0)
    leg.final(angle=0.0, rate=0.0)
    leg.bounds(torque=(-2.0, 2.0))
    problem.minimize(leg.final_time)
    return problem


def test_a_part_that_no_theorem_certifies_is_said_to_be_a_local_minimum() -> None:
    bounded = go.lower_bound(go.solve(follower()))
    assert bounded.bound is not None
    assert bounded.bound.states == ("angle", "rate")
    assert not bounded.bound.certified and bounded.bound.theorem == ""
    assert bounded.gap == pytest.approx(0.0, abs=1e-8)
    assert "no bound if another is lower" in str(bounded.bound)
    assert go.verify(bounded).headline.endswith("from a local minimum of a relaxation")


def test_a_relaxation_that_costs_more_than_the_flight_is_no_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """The flight is one of its trajectories: its minimum was a local one."""
    solution = go.solve(follower(), tol=None)
    dear = replace(go.solve(follower()), objective=solution.objective * 1.1)
    monkeypatch.setattr(sys.modules["gnc_opt.planning.study.lower_bounds"], "solve", lambda *_, **__: dear)
    assert go.lower_bound(solution).bound is None


def test_what_hangs_together_has_no_bound() -> None:
    model = go.Model("pendulum")
    angle, rate, torque = model.state("angle"), model.state("rate"), model.control("torque")
    model.ode({angle: rate, rate: torque - ca.sin(angle)})
    problem = go.Problem("effort")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(angle=1.0, rate=0.0)
    leg.final(angle=0.0)
    problem.minimize(leg.integral(torque**2) + leg.final_state("rate") ** 2)
    bounded = go.lower_bound(go.solve(problem))
    assert bounded.bound is None and bounded.gap is None
    assert "bound" not in {line.split()[0] for line in str(bounded).splitlines()}


def cart(**given) -> tuple[go.Problem, go.Phase]:
    model = go.Model("cart")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a + given.get("wind", 0.0) * model.time + given.get("lift", 0.0) * v**2})
    problem = go.Problem("cart")
    leg = problem.phase("leg", model)
    leg.time(0.0, given.get("time", (0.1, 10.0)))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=given.get("speed", 0.0))
    leg.bounds(a=given.get("push", (-1.0, 1.0)), v=given.get("speeds"))
    if "path" in given:
        leg.path("limit", given["path"](q, v, a), upper=0.0)
    problem.minimize(
        leg.final_time if "time" not in given or isinstance(given["time"], tuple) else leg.integral(a**2)
    )
    return problem, leg


@pytest.mark.parametrize(
    ("given", "theorem"),
    [
        ({}, LINEAR_TIME_OPTIMAL),
        ({"speeds": (-0.6, None)}, LINEAR_TIME_OPTIMAL),
        ({"path": lambda q, v, a: q + v**2 - 3.0}, LINEAR_TIME_OPTIMAL),
        ({"time": 3.0}, CONVEX),
        ({"speed": -0.5}, ""),  # it cannot stay where it arrives
        ({"time": (3.0, 10.0)}, ""),  # the time is at its limit: nothing is least there
        ({"lift": 0.1}, ""),
        ({"wind": 0.05}, ""),
        ({"path": lambda q, v, a: q - v**2 - 3.0}, ""),  # a set that is not convex
        ({"path": lambda q, v, a: q * a - 3.0}, ""),
    ],
)
def test_only_what_the_hypotheses_hold_for_is_certified(given, theorem) -> None:
    solution = go.solve(cart(**given)[0], tol=None)
    assert theorem_of(solution, Verdict("taken for an extremal", ())) == theorem


def test_what_is_not_ok_is_not_certified() -> None:
    solution = go.solve(cart()[0])
    problem = solution.problem
    assert problem is not None
    late = replace(solution, objective=solution.objective * 1.01)
    assert theorem_of(solution, go.verify(solution))
    assert not theorem_of(late, go.verify(late))


def test_a_payoff_is_bounded_from_above() -> None:
    """The swing's height limits the cart, not the other way round: alone it would rise to 1."""
    model = go.Model("riser")
    y, z, u = model.state("y"), model.state("z"), model.control("u")
    model.ode({y: u, z: y**2 + ca.sin(z)})
    problem = go.Problem("as high as possible")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(y=0.0, z=0.0)
    leg.bounds(u=(-1.0, 1.0), z=(None, 0.2))
    problem.maximize(leg.final_state("y"))
    bounded = go.lower_bound(go.solve(problem))
    assert bounded.bound is not None and bounded.bound.states == ("y",)
    assert bounded.bound.value == pytest.approx(1.0, abs=1e-7)
    assert bounded.objective < 0.99
    assert bounded.gap == pytest.approx(1.0 / bounded.objective - 1.0, abs=1e-6)
    assert "at most" in str(bounded) and "by y (" in str(bounded)


# --- what is left of a problem --------------------------------------------------------------------------


def staged() -> go.Problem:
    """Two phases of a vector each, whose last component drives another state; a free parameter, shared limits."""
    model = go.Model("stage")
    r, v, w = model.state("r", 3, unit="m"), model.state("v", 3, nominal=[1.0, 2.0, 3.0]), model.state("w")
    a, k = model.control("a", 3), model.parameter("k", [1.0, 2.0, 3.0])
    model.parameter("b", [5.0, 7.0])
    gain = model.symbol("b")[1]
    model.ode({r: v, v: k * a, w: v[2] * ca.cos(w) * gain})
    problem = go.Problem("two stages")
    free = problem.parameter("k", 3, lower=0.5, upper=4.0, guess=[1.0, 2.0, 3.0])
    first, second = problem.phase("first", model), problem.phase("second", model)
    first.time(0.0, (0.5, 5.0))
    second.time((0.5, 5.0), (1.0, 9.0))
    first.initial(r=[3.0, 1.0, 0.0], v=0.0, w=0.0)
    second.final(r=0.0, v=0.0)
    for leg in (first, second):
        leg.bounds(r=([-4.0, -5.0, -6.0], [4.0, 5.0, 6.0]))
        leg.path("thrust", ca.sumsqr(a[:2]), upper=1.0)
        leg.path("band", ca.vertcat(v[0] - 9.0, v[2] + w), upper=0.0)
    problem.link(first, second)
    problem.constrain("waypoint", first.final_state("r")[0] + first.final_state("r")[1], upper=3.5)
    problem.minimize(second.final_time + 0.1 * free[0])
    return problem


def test_a_relaxation_states_all_that_concerns_its_states_and_nothing_else() -> None:
    in_plane, other = relaxations(staged())
    assert np.flatnonzero(in_plane.states["first"]).tolist() == [0, 1, 3, 4]  # the waypoint ties two axes
    assert np.flatnonzero(other.states["second"]).tolist() == [2, 5, 6]  # the band ties w to the third
    problem = in_plane.problem
    first, second = problem.phases.values()
    assert first.model.states.labels == ("r[0]", "r[1]", "v[0]", "v[1]")
    assert first.model.states["v"].nominal == (1.0, 2.0)
    assert first.model.controls.size == 2
    assert first.model.parameters.names == ("k",) and problem.parameters.names == ("k",)
    assert first.path_labels == ("thrust", "band 0")
    np.testing.assert_array_equal(second.numbers.final.lower, np.zeros(4))
    np.testing.assert_array_equal(first.numbers.states.upper[:2], [4.0, 5.0])
    assert not any("_w" in label for label in problem.constraint_labels())
    assert (
        "waypoint" in problem.constraint_labels() and "link_first_second_time" in problem.constraint_labels()
    )
    problem.check()
    assert other.problem.get_phase("first").model.parameter_values.tolist() == [1.0, 2.0, 3.0, 7.0]
    assert other.problem.get_phase("first").path_labels == ("band 1",)
    other.problem.check()


def test_ties_by_constraints_may_be_cut_where_that_alone_frees_a_part() -> None:
    """The heading needs no position; the corridor in which both stand goes, and with it the position."""
    model = go.Model("rover")
    x, heading, turn = model.state("x"), model.state("heading"), model.control("turn")
    model.ode({x: ca.cos(heading), heading: turn})
    problem = go.Problem("turn")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.1, 9.0))
    leg.initial(x=0.0, heading=0.0)
    leg.final(heading=2.0)
    leg.bounds(turn=(-1.0, 1.0))
    leg.path("corridor", x + heading, upper=5.0)
    problem.minimize(leg.final_time)
    (only,) = relaxations(problem)
    assert only.problem.get_phase().model.states.names == ("heading",)
    assert only.problem.get_phase().path_labels == ()


def test_a_cost_that_needs_all_states_leaves_no_relaxation() -> None:
    _, leg = cart(time=3.0)
    weighed = go.Problem("weighed")
    other = weighed.phase("leg", leg.model)
    other.time(0.0, 1.0)
    weighed.minimize(other.final_state("q"))
    assert relaxations(weighed) == []


@pytest.mark.parametrize(("given", "said"), [(3, "lower_bound"), ("x", "lower_bound")])
def test_bad_input_is_refused(given, said) -> None:
    with pytest.raises(go.GncOptError, match=said):
        go.lower_bound(given)


@pytest.mark.parametrize("tol", [0.0, -1.0, math.nan, "fine"])
def test_a_tolerance_is_positive(together: go.Solution, tol) -> None:
    with pytest.raises(go.GncOptError, match="tolerance of lower_bound"):
        go.lower_bound(together, tol=tol)
