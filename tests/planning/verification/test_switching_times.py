"""Shifted switches: a switch beside an arc held by a state limit of second order."""

from __future__ import annotations

import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning.verification.switching_times import find_jumps

HEIGHT = 0.25
"""Upper limit of q, below 1/3: the arc of least effort follows it from t = 3 HEIGHT on (Bryson and Denham, 1963)."""


def switched(share: float, time: float) -> go.Verdict:
    """Verdict on a bang-bang u beside the limited double integrator.

    J = int a^2 + (t - time) u dt - share / 2 (x(2) - 2 time + 2)^2: shifting the switch by d changes the cost by
    (1 - 2 share) d^2, so that the stated switch is a minimum below share = 1/2.
    """
    model = go.Model("cart and switch")
    x, q, v = model.state("x"), model.state("q"), model.state("v")
    u, a = model.control("u"), model.control("a")
    model.ode({x: u, q: v, v: a})
    problem, leg = one_phase("cart and switch", model, 0.0, 2.0)
    leg.initial(x=0.0, q=0.0, v=1.0)
    leg.final(q=0.0, v=-1.0)
    leg.bounds(u=(-1, 1), q=(None, HEIGHT))
    end = leg.final_state("x") - (2 * time - 2)
    problem.minimize(leg.integral(a**2) + leg.integral((model.time - time) * u) - share / 2 * end**2)
    entry = 3 * HEIGHT
    t = np.unique(np.concatenate([np.linspace(0, 2, 81), [time, entry, 2 - entry]]))
    t = np.sort(np.append(t, time))
    first = np.arange(t.size) <= np.searchsorted(t, time)
    s = np.minimum(np.minimum(t, 2 - t) / entry, 1.0)
    states = {
        "x": np.where(first, t, 2 * time - t),
        "q": HEIGHT * (1 - (1 - s) ** 3),
        "v": (1 - s) ** 2 * np.where(t > 1, -1, 1),
    }
    controls = {"u": np.where(first, 1.0, -1.0), "a": -2 * (1 - s) / entry}
    return go.verify_trajectory(problem, t, states, controls)


@pytest.mark.slow
@pytest.mark.parametrize("time", [0.5])
def test_a_switch_beside_an_arc_at_a_state_limit(time: float) -> None:
    assert switched(0.45, time).minimum
    assert not switched(0.55, time).ok


def touching(share: float, as_path: bool) -> go.Verdict:
    """Verdict on the same switch at 0.6 beside a touch of q at 1, of the limit 0.4: a minimum below share = 1/2."""
    model = go.Model("touch and switch")
    x, q, v = model.state("x"), model.state("q"), model.state("v")
    u, a = model.control("u"), model.control("a")
    model.ode({x: u, q: v, v: a})
    problem, leg = one_phase("touch and switch", model, 0.0, 2.0)
    leg.initial(x=0.0, q=0.0, v=1.0)
    leg.final(q=0.0, v=-1.0)
    leg.bounds(u=(-1, 1))
    if as_path:
        leg.path("ceiling", q, upper=0.4)
    else:
        leg.bounds(q=(None, 0.4))
    end = leg.final_state("x") + 0.8
    problem.minimize(leg.integral(a**2) + leg.integral((model.time - 0.6) * u) - share / 2 * end**2)
    t = np.sort(np.append(np.linspace(0, 2, 41), 0.6))
    first = np.arange(t.size) <= np.searchsorted(t, 0.6)
    s = np.minimum(t, 2 - t)
    states = {
        "x": np.where(first, t, 1.2 - t),
        "q": s - 0.8 * s**2 + 0.2 * s**3,
        "v": (1 - 1.6 * s + 0.6 * s**2) * np.where(t > 1, -1, 1),
    }
    controls = {"u": np.where(first, 1.0, -1.0), "a": -1.6 + 1.2 * s}
    return go.verify_trajectory(problem, t, states, controls)


@pytest.mark.slow
@pytest.mark.parametrize("as_path", [False, True])
def test_a_touch_stays_at_the_peak_when_a_switch_moves(as_path: bool) -> None:
    """The mesh stretches with the switch: a touch held at a node of it would be off the peak."""
    assert touching(0.49, as_path).minimum
    assert not touching(0.51, as_path).ok


def test_the_place_counts_switches_and_names_the_second_order() -> None:
    """Rest to rest in minimum time has one switch."""
    model, *_ = dynamics("double integrator", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("rest to rest", model, initial=0.0, final=(0.1, 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    condition = go.verify(go.solve(problem))["switching times"]
    assert condition.where == "1 switch: see second order"


@pytest.mark.parametrize(
    ("name", "gap", "count"), [("a", 0.0, 1), ("b", 0.0, 0), ("a", 0.5, 0)], ids=["same", "other", "later"]
)
def test_a_jump_between_phases_is_that_of_one_control_at_one_time(name: str, gap: float, count: int) -> None:
    """Full thrust, then full brakes: a switch if the control is the same and the phases follow each other."""
    problem = go.Problem("two legs")
    legs = []
    for label, control, begin in (("first", "a", 0.0), ("second", name, 1.0 + gap)):
        model, *_ = dynamics(label, "x", control, lambda x, u: {x: u})
        leg = problem.phase(label, model)
        leg.time(begin, begin + 1.0)
        leg.initial(x=0.0)
        leg.bounds(**{control: (-1.0, 1.0)})
        legs.append(leg)
    problem.maximize(legs[0].final_state("x") - legs[1].final_state("x"))
    solution = go.solve(problem, mesh="2x3", tol=None)
    jumps = find_jumps(list(solution.samples().values()))
    assert [jump.beyond for jump in jumps] == ["second"] * count


@pytest.mark.parametrize(("pause", "jumps"), [(0.0, 1), (0.5, 0)])
def test_a_control_jumps_between_phases_that_follow_each_other_without_a_pause(
    pause: float, jumps: int
) -> None:
    """Up at full rate for 1 s, then down: one switch at the boundary, none if the second phase begins later."""
    problem, legs = go.Problem("up and down"), []
    for name, start in (("up", 0.0), ("down", 1.0 + pause)):
        model = go.Model(name)
        x, u = model.state("x"), model.control("u")
        model.ode({x: u})
        leg = problem.phase(name, model)
        leg.time(start, start + 1.0)
        leg.initial(x=0.0)
        leg.bounds(u=(-1.0, 1.0))
        legs.append(leg)
    problem.minimize(legs[1].final_state("x") - legs[0].final_state("x"))
    samples = go.solve(problem, mesh="2x3", tol=None).samples()
    found = find_jumps(list(samples.values()))
    assert [(jump.phase, jump.time, jump.channel, jump.beyond) for jump in found] == [
        ("up", 1.0, 0, "down")
    ] * jumps
