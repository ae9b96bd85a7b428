"""Views: what they show is where the vehicle is, which way it points and which way it thrusts."""

import casadi as ca
import numpy as np
import pytest
from testing.internals import get_motion_time_span, sample_vehicle_motion

import gnc_opt as go
from gnc_opt.plot import View
from gnc_opt.spacecraft import mrp_rate

RATE = 0.5
"""Of the turn about z, rad/s."""


def turning() -> go.Problem:
    """A body that turns about z at a constant rate while a force along its own x carries it along."""
    model = go.Model("turning body")
    r, v = model.state("r", 3, unit="m"), model.state("v", 3, unit="m/s")
    sigma, q, m = model.state("sigma", 3), model.state("q", 4), model.state("m", unit="kg")
    thrust = model.control("F", 3, unit="N")
    angle = RATE * model.time
    c, s = ca.cos(angle), ca.sin(angle)
    force_L = ca.vertcat(c * thrust[0] - s * thrust[1], s * thrust[0] + c * thrust[1], thrust[2])
    half = RATE / 2
    q_rate = half * ca.vertcat(-q[3], q[2], -q[1], q[0])  # about z
    model.ode({r: v, v: force_L, sigma: mrp_rate(sigma, ca.vertcat(0, 0, RATE)), q: q_rate, m: -1})
    problem = go.Problem("a turn")
    leg = problem.phase("turn", model)
    leg.time(initial=0.0, final=2.0)
    leg.initial(r=0.0, v=0.0, sigma=0.0, q=[1, 0, 0, 0], m=9.0)
    leg.bounds(F=([1, 0, 0], [1, 0, 0]))
    problem.minimize(leg.final_time)
    return problem


def sampled(moved, view, n):
    return sample_vehicle_motion(moved, view, np.linspace(*get_motion_time_span(moved, view), n))


def force(seen):
    return seen.force


@pytest.fixture(scope="module")
def solution():
    return go.solve(turning(), mesh="6x4", tol=None)


@pytest.mark.parametrize("attitude", ["sigma", "q"])
def test_axes_and_force_are_those_of_the_motion(solution, attitude):
    times = np.linspace(0, 2, 9)
    seen = sampled(solution, View("r", attitude, "F"), 9)
    turned = np.stack([np.cos(RATE * times), np.sin(RATE * times), 0 * times])
    assert np.allclose(seen.times, times)
    assert np.allclose(seen.dcm_BL[0], turned, atol=1e-6)  # the body's x in L
    assert np.allclose(force(seen), [[1.0] * 9, [0.0] * 9, [0.0] * 9], atol=1e-6)  # in B
    assert seen.unit == "m"
    # r'' = (cos, sin) of the angle, from rest
    expected = np.stack([1 - np.cos(RATE * times), RATE * times - np.sin(RATE * times), 0 * times]) / RATE**2
    assert np.allclose(seen.position, expected, atol=1e-6)


def test_without_an_attitude_the_force_is_in_the_axes_drawn(solution):
    seen = sampled(solution, View("r", force="F"), 5)
    assert np.allclose(force(seen), [[1.0] * 5, [0.0] * 5, [0.0] * 5])


def test_two_components_lie_in_a_plane_upright():
    model = go.Model("hop")
    x, h = model.state("x", unit="km"), model.state("h", unit="km")
    model.ode({x: 1.0, h: 1 - x})
    problem = go.Problem("hop")
    leg = problem.phase("hop", model)
    leg.time(initial=0.0, final=2.0)
    leg.initial(x=0.0, h=0.0)
    problem.minimize(leg.final_time)
    solution = go.solve(problem, mesh="4x3", tol=None)
    seen = sampled(solution, View(("x", "h")), 3)
    assert np.allclose(seen.position, [[0, 1, 2], [0, 0, 0], [0, 0.5, 0]], atol=1e-7)
    assert seen.unit == "km"
    assert np.allclose(sampled(solution, View("h"), 3).position, [[0] * 3, [0] * 3, [0, 0.5, 0]], atol=1e-7)


def test_phases_follow_one_another():
    model = go.Model("runner")
    r = model.state("r", 2, unit="m")
    model.ode({r: ca.vertcat(1, 0)})
    other = go.Model("clock")
    tick = other.state("tick")
    other.ode({tick: 1.0})
    problem = go.Problem("relay")
    legs = [problem.phase(name, of) for name, of in (("first", model), ("second", model), ("pause", other))]
    for k, leg in enumerate(legs):
        leg.time(initial=1.0 * k, final=1.0 * k + 1)
    legs[0].initial(r=[0, 0])
    legs[1].initial(r=[1, 5])
    legs[2].initial(tick=0)
    problem.minimize(legs[2].final_time)
    seen = sampled(go.solve(problem, mesh="2x3", tol=None), View("r"), 5)
    assert np.allclose(seen.times, [0, 0.5, 1, 1.5, 2])  # the pause has no position
    assert np.allclose(seen.position[[0, 2]], [[0, 0.5, 1, 1.5, 2], [0, 0, 5, 5, 5]], atol=1e-7)


@pytest.mark.parametrize(
    ("view", "message"),
    [
        (View("speed"), "speed"),
        (View("r", force="G"), "G"),
        (View("q"), "position q has 4 components"),
        (View("r[3]"), r"r has no component r\[3\]: it has r\[0\]"),
        (View(("r", "v")), "position r, v has 6 components"),
        (View("r", attitude="m"), r"m has 1 components: give modified Rodrigues parameters \(3\)"),
    ],
)
def test_views_that_do_not_fit_are_refused(solution, view, message):
    with pytest.raises((go.ArgumentError, go.UnknownNameError), match=message):
        sampled(solution, view, 3)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({}, "has neither position nor attitude"),
        ({"position": "r", "keep_out": {"rock": 1.0}}, "keep-out volume 'rock' is not a pair"),
        ({"position": "r", "keep_out": {"rock": ((0, 0), 1.0)}}, "the centre of 'rock' .* three finite"),
        (
            {"position": "r", "keep_out": {"rock": ((0, 0, 0), (1, 1, 0))}},
            "the radius of 'rock' .* length > 0",
        ),
    ],
)
def test_views_that_cannot_be_meant_are_refused_where_they_are_written(wrong, message):
    with pytest.raises(go.ArgumentError, match=message):
        View(**wrong)
