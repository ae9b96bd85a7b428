"""Phases in a sequence: times and states handed over, masses dropped, what cannot be meant."""

import math
from typing import Any

import numpy as np
import pytest
from testing.internals import guess_boundary_states, guess_phase_times
from testing.models import dynamics

import gnc_opt as go


def cart(problem: go.Problem, name: str, limit: tuple[float, float]) -> go.Phase:
    model, *_ = dynamics("cart", "x v", "u", lambda x, v, u: {x: v, v: u})
    leg = problem.phase(name, model)
    leg.bounds(u=limit)
    return leg


@pytest.mark.slow
def test_push_coast_brake_is_the_closed_form() -> None:
    """1 m from rest to rest in 3 s with |u| <= 1: fuel 3 - sqrt(5), coast from (3 - sqrt(5)) / 2 s."""
    problem = go.Problem("move")
    push, _, brake = (
        cart(problem, name, limit)
        for name, limit in (("push", (0.0, 1.0)), ("coast", (0.0, 0.0)), ("brake", (-1.0, 0.0)))
    )
    problem.sequence(
        push, "coast", brake, durations={"push": (0.0, 2.0), "coast": (0.0, 3.0), "brake": (0.0, 2.0)}
    )
    push.initial(x=0.0, v=0.0)
    brake.final(x=1.0, v=0.0)
    problem.constrain("time", brake.final_time, equals=3.0)
    u = [leg.model.symbol("u") for leg in (push, brake)]
    problem.minimize(push.integral(u[0]) - brake.integral(u[1]))
    solution = go.solve(problem, tol=1e-8, check=False)
    assert solution.objective == pytest.approx(3 - math.sqrt(5), abs=1e-8)
    found = solution.phases
    assert found["coast"].initial_time == pytest.approx(found["push"].final_time, abs=1e-12)
    assert found["coast"].x(found["coast"].initial_time) == pytest.approx(
        found["push"].x(found["push"].final_time)
    )


def rocket(problem: go.Problem, name: str) -> go.Phase:
    model = go.Model("stage")
    v, m, thrust = model.state("v"), model.state("m"), model.control("thrust")
    model.ode({v: thrust / m, m: -thrust / 3000.0})
    leg = problem.phase(name, model)
    leg.bounds(thrust=(0.0, 1e5))
    return leg


def test_stages_that_are_dropped_obey_the_rocket_equation() -> None:
    """Two stages of 5 t and 1.5 t dry 1 t and 0.3 t below 0.5 t: Delta v = c (ln m0/m1 + ln m2/m3)."""
    problem = go.Problem("two stages")
    first, second = rocket(problem, "first"), rocket(problem, "second")
    problem.sequence(
        first, second, durations={"first": (1.0, 200.0), "second": (1.0, 200.0)}, drops={"first": {"m": 1e3}}
    )
    first.initial(v=0.0, m=7e3)
    first.final(m=3e3)
    second.final(m=0.8e3)
    problem.minimize(second.final_time)  # full thrust throughout
    solution = go.solve(problem, mesh="8x4", tol=None)
    assert solution.phases["second"].x(solution.phases["second"].initial_time)[1] == pytest.approx(2e3)
    gained = float(solution.state("v", "second")(solution.phases["second"].final_time))
    assert gained == pytest.approx(3000.0 * (math.log(7 / 3) + math.log(2 / 0.8)), rel=1e-5)


def test_times_and_their_guesses() -> None:
    problem = go.Problem("times")
    a, b = rocket(problem, "a"), rocket(problem, "b")
    problem.sequence(a, b, durations={"a": 10.0, "b": (5.0, 15.0)}, start=100.0)
    assert [float(t.lower[0]) for t in (*a.time_ranges(), *b.time_ranges())] == [100.0, 110.0, 110.0, 115.0]
    assert [float(t.upper[0]) for t in (*a.time_ranges(), *b.time_ranges())] == [100.0, 110.0, 110.0, 125.0]
    problem = go.Problem("free times")
    a, b = rocket(problem, "a"), rocket(problem, "b")
    problem.sequence(a, b)
    assert np.isinf(b.time_ranges()[1].upper[0]) and b.time_ranges()[1].lower[0] == 0.0


@pytest.mark.parametrize(
    ("finals", "expected"),
    [
        ((None, None, 12.0), [0, 4, 8, 12]),
        ((None, (2.0, 8.0), None), [0, 2.5, 5, 6]),
        (((0.0, 10.0), (0.0, 10.0), (0.0, 10.0)), [0, 5, 6, 7]),
        ((None, None, None), [0, 1, 2, 3]),
    ],
)
@pytest.mark.parametrize("start", [None, (0.0, None), (0.0, 100.0)])
def test_guessed_times_of_linked_phases_follow_each_other(
    finals: Any, expected: list[float], start: Any
) -> None:
    """Each begins where the one before ends; ends of which nothing is told are even steps to the next that is."""
    problem = go.Problem("linked")
    legs = [rocket(problem, name) for name in ("a", "b", "c")]
    for leg, final in zip(legs, finals, strict=True):
        leg.time(initial=0.0 if leg is legs[0] else start, final=final)
    problem.link(legs[0], legs[1])
    problem.link(legs[1], legs[2])
    times = np.array([guess_phase_times(leg) for leg in legs])
    np.testing.assert_allclose([*times[:, 0], times[-1, 1]], expected, rtol=1e-14)
    np.testing.assert_allclose(times[1:, 0], times[:-1, 1], rtol=1e-14)
    legs[1].guess(time=[20.0, 30.0], v=[0.0, 1.0])  # what users say stays
    assert guess_phase_times(legs[1])[0] == 20.0


def test_states_linked_in_other_units_are_warned_of(recwarn: pytest.WarningsRecorder) -> None:
    problem = go.Problem("units")
    legs = []
    for name, unit in (("a", "m"), ("b", "km"), ("c", "km"), ("d", "")):
        model = go.Model(name)
        x, u = model.state("x", unit=unit), model.control("u")
        model.ode({x: u})
        legs.append(problem.phase(name, model))
    problem.link(legs[1], legs[2])
    problem.link(legs[2], legs[3])
    assert not recwarn.list
    with pytest.warns(
        go.ProblemWarning, match=r"link_a_b .* links 'x' in m to km, but units are not converted"
    ):
        problem.link(legs[0], legs[1])


def test_times_that_are_not_linked_are_guessed_alone() -> None:
    problem = go.Problem("apart")
    legs = [rocket(problem, name) for name in ("a", "b")]
    legs[0].time(initial=0.0, final=7.0)
    legs[1].time(initial=None, final=None)
    problem.link(*legs, time=False)
    assert guess_phase_times(legs[1]).tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda p: p.sequence("a"), "give two phases or more"),
        (lambda p: p.sequence("a", "a"), "each once"),
        (lambda p: p.sequence("a", "c"), "no phase 'c'"),
        (lambda p: p.sequence("a", "b", durations={"c": 1.0}), "no phase 'c'"),
        (lambda p: p.sequence("a", "b", drops={"b": {"m": 1.0}}), "no phase 'b'"),
        (lambda p: p.sequence("a", "b", drops={"a": {"mass": 1.0}}), "no state 'mass'"),
        (lambda p: p.sequence("a", "b", drops={"a": {"m": "much"}}), "not a number"),
        (lambda p: p.sequence("a", "b", drops={"a": 5.0}), "drops"),
        (lambda p: p.sequence("a", "b", durations={"a": (5.0, 1.0)}), "duration of phase 'a'"),
        (lambda p: p.sequence("a", "b", durations={"a": -1.0}), "duration of phase 'a'"),
    ],
)
def test_mistakes_get_a_sentence(call: Any, message: str) -> None:
    problem = go.Problem("wrong")
    rocket(problem, "a"), rocket(problem, "b")
    with pytest.raises(go.GncOptError, match=message):
        call(problem)


def test_guessed_states_go_straight_between_waypoints_in_the_times_of_the_phases() -> None:
    """Per component; a start that is not known takes the next value; jumps are left out of the line."""
    problem = go.Problem("waypoints")
    legs = []
    for name in ("a", "b", "c", "d"):
        model, _r, _u = dynamics(name, "r:2", "u:2", lambda r, u: {r: u})
        legs.append(problem.phase(name, model))
    problem.sequence(*legs, durations={"a": 1.0, "b": 3.0, "c": 2.0, "d": 1.0})
    legs[0].initial(r=[0.0, None])
    legs[1].final(r=[8.0, 5.0])
    legs[2].initial(r=[None, 7.0])
    legs[3].final(r=[2.0, None])
    ends = [np.stack(guess_boundary_states(leg)) for leg in legs]
    np.testing.assert_allclose([[a[0], b[0]] for a, b in ends], [[0, 2], [2, 8], [8, 4], [4, 2]], rtol=1e-14)
    np.testing.assert_allclose([[a[1], b[1]] for a, b in ends], [[5, 5], [5, 5], [7, 7], [7, 7]], rtol=1e-14)
    problem = go.Problem("a jump on the way")
    first, second = rocket(problem, "first"), rocket(problem, "second")
    problem.sequence(first, second, durations={"first": 1.0, "second": 1.0}, drops={"first": {"m": 10.0}})
    first.initial(v=0.0, m=100.0)
    second.final(v=5.0, m=50.0)
    assert [leg_end[1] for leg in (first, second) for leg_end in guess_boundary_states(leg)] == [
        100.0,
        80.0,
        70.0,
        50.0,
    ]


def test_a_link_back_hands_nothing_over() -> None:
    """A periodic flight is linked to itself: its guess begins where the phase says, and does not go round."""
    model, *_ = dynamics("cart", "x", "u", lambda x, u: {x: u})
    problem = go.Problem("round")
    first, second = (problem.phase(name, model) for name in ("first", "second"))
    first.time(initial=0.0, final=1.0)
    second.time(initial=1.0, final=2.0)
    problem.link(first, second)
    problem.link(second, first, time=False)
    assert [guess_boundary_states(leg)[0].tolist() for leg in (first, second)] == [[0.0], [0.0]]


def test_a_coast_without_controls_beside_arcs_of_bangs() -> None:
    """1 m from rest to rest at |u| <= 1, with 0.6 s of drifting in between at v: v^2 + 0.6 v = 1."""
    problem = go.Problem("push, drift and brake")
    legs = []
    for name in ("push", "drift", "brake"):
        model = go.Model(name)
        x, v = model.state("x"), model.state("v")
        model.ode({x: v, v: 0.0 if name == "drift" else model.control("u")})
        legs.append(problem.phase(name, model))
        if name != "drift":
            legs[-1].bounds(u=(-1.0, 1.0))
    problem.sequence(*legs, durations={"push": (0.2, 3.0), "drift": 0.6, "brake": (0.2, 3.0)})
    legs[0].initial(x=0.0, v=0.0)
    legs[2].final(x=1.0, v=0.0)
    problem.minimize(legs[2].final_time)
    speed = (-0.6 + math.sqrt(0.6**2 + 4.0)) / 2  # v^2 + 0.6 v = 1
    solution = go.solve(problem)
    assert solution.objective == pytest.approx(2 * speed + 0.6, abs=1e-8)
    assert solution.history is not None and solution.history.status is go.RefinementStatus.CONVERGED
    assert all(arc.phase != "drift" for arc in solution.structure)
