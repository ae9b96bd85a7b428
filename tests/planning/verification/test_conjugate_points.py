"""Conjugate times of smooth extremals are the known ones, and say what the reduced Hessian says."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq
from testing.great_circle import great_circle, regulator

import gnc_opt as go
from gnc_opt.planning import Condition, ConditionResult
from gnc_opt.planning.verification.conjugate_points import conjugate_points
from gnc_opt.planning.verification.engine import _agreed
from gnc_opt.planning.verification.recomputed import from_problem


def judged(solution: go.Solution) -> list[go.Condition]:
    told = from_problem(solution)
    return conjugate_points(told, list(told.samples().values()))


def first_time(condition: go.Condition) -> float:
    return float(condition.where.split("t = ")[1].split(" ")[0])


@pytest.fixture(scope="module")
def at_rest() -> go.Solution:
    return go.solve(regulator(1.0), mesh="4x5", tol=None)


@pytest.mark.parametrize("share", [0.5, 0.99, 1.01, 1.5, 9.5])
def test_regulator_is_conjugate_after_half_a_period(at_rest: go.Solution, share: float) -> None:
    """x'' = -k x from 0 is at 0 again after pi / sqrt(k), whether or not it is for the third time at the end."""
    solution = replace(at_rest, problem=regulator(share * np.pi**2))
    (condition,) = judged(solution)
    verdict = go.verify(solution)
    assert verdict["conjugate points"] == condition
    assert condition.result is (ConditionResult.PASS if share < 1 else ConditionResult.FAIL)
    assert condition.result is verdict["second order"].result
    if share > 1:
        assert first_time(condition) == pytest.approx(1 / np.sqrt(share), abs=1e-4)
        assert condition.value == pytest.approx(1 - 1 / np.sqrt(share), abs=1e-4)


@pytest.mark.parametrize("arc", [0.98, 1.02, 1.5])
def test_great_circle_is_conjugate_at_the_other_pole(arc: float) -> None:
    (condition,) = judged(go.solve(great_circle(arc * np.pi), mesh="4x6", tol=None))
    assert condition.result is (ConditionResult.PASS if arc < 1 else ConditionResult.FAIL)
    if arc > 1:
        assert first_time(condition) == pytest.approx(1 / arc, abs=1e-4)


@pytest.mark.parametrize(
    ("least", "most", "result"), [(0.5, 1.0, ConditionResult.PASS), (0.05, 0.3, ConditionResult.FAIL)]
)
def test_the_deep_one_of_two_catenaries_is_no_least_film(
    least: float, most: float, result: ConditionResult
) -> None:
    """Between rings of radius 1, 0.8 apart: r = c cosh((x - 0.4) / c), of which the deep one has a conjugate point.

    That is where a tangent of the catenary meets the one at its start on the axis of the film (Bliss, Calculus of
    Variations, 1925, section 43): f(x) = x - c coth(x / c), about the middle, is the same at both.
    """
    c = brentq(lambda c: c * np.cosh(0.4 / c) - 1, least, most)
    film = go.Model("film")
    r, slope = film.state("r"), film.control("slope")
    film.ode({r: slope})
    problem = go.Problem("soap film")
    leg = problem.phase("leg", film)
    leg.time(0.0, 0.8)
    leg.initial(r=1.0)
    leg.final(r=1.0)
    problem.minimize(leg.integral(r * ca.sqrt(1 + slope**2)))
    t = 0.4 + c * np.arcsinh(np.linspace(-1, 1, 161) * np.sinh(0.4 / c))
    t[[0, -1]] = 0.0, 0.8
    verdict = go.verify_trajectory(
        problem, t, {"r": c * np.cosh((t - 0.4) / c)}, {"slope": np.sinh((t - 0.4) / c)}
    )
    assert verdict["conjugate points"].result is verdict["second order"].result is result
    assert verdict.minimum == (result is ConditionResult.PASS)
    if result is ConditionResult.FAIL:

        def meets(x: float) -> float:
            return float(x - c / np.tanh(x / c))

        conjugate = 0.4 + brentq(lambda x: meets(x) - meets(-0.4), 1e-3, 0.4)
        assert first_time(verdict["conjugate points"]) == pytest.approx(conjugate, abs=1e-4)


def oscillators(duration: float) -> go.Problem:
    """Several oscillators of one frequency, whose conjugate points coincide: the determinant touches zero only."""
    model = go.Model("oscillators")
    x, u = model.state("x", 2), model.control("u", 2)
    k = model.parameter("k", 1.0)
    model.ode({x: u})
    problem = go.Problem("oscillators")
    leg = problem.phase("leg", model)
    leg.time(0.0, duration)
    leg.initial(x=[0.0, 0.0])
    leg.final(x=[0.0, 0.0])
    leg.scale(x=[1.0, 1.0], u=[1.0, 1.0])
    problem.minimize(leg.integral(u[0] ** 2 + u[1] ** 2 - k * (x[0] ** 2 + x[1] ** 2)))
    return problem


def test_conjugate_points_that_coincide_are_seen() -> None:
    short = go.solve(oscillators(4.0).with_parameters(k=0.1), mesh="4x5", tol=None)
    (condition,) = judged(replace(short, problem=oscillators(4.0)))
    assert condition.result is ConditionResult.FAIL
    assert first_time(condition) == pytest.approx(np.pi, abs=1e-3)


@pytest.mark.parametrize("spring", [0.0, 1.0, -0.5])
@pytest.mark.parametrize("free", ["start", "end"])
def test_a_free_end_is_focal_earlier(at_rest: go.Solution, free: str, spring: float) -> None:
    """x = cos(w t) + spring / w sin(w t) away from an end where x costs spring x^2: its zero, first at pi / (2 w)."""
    w = 2.2
    problem = regulator(w**2)
    leg = problem.phases["leg"]
    (leg.initial if free == "start" else leg.final)(x=None)
    problem.cost += spring * (leg.initial_state("x") if free == "start" else leg.final_state("x")) ** 2
    solution = replace(at_rest, problem=problem)
    (condition,) = judged(solution)
    zero = (0.5 * np.pi + np.arctan(spring / w)) / w
    assert condition.result is (ConditionResult.FAIL if zero < 1 else ConditionResult.PASS)
    assert condition.result is go.verify(solution)["second order"].result
    assert condition.where.endswith(free)
    assert first_time(condition) == pytest.approx(zero if free == "start" else 1 - zero, abs=1e-3)


def equator(k: float) -> go.Problem:
    """In minimum time along the equator of a sphere of radius 1 / k, beside a clock and a mirror.

    Variations in a given time are at right angles to the costates, and x^2 + y^2 of the mirror never changes.
    """
    model = go.Model("ship")
    latitude, longitude, course = model.state("latitude"), model.state("longitude"), model.control("course")
    clock, x, y = model.state("clock"), model.state("x"), model.state("y")
    turn = ca.sin(course) + 0.5
    rates = {latitude: ca.sin(course), longitude: ca.cos(course) / ca.cos(k * latitude)}
    model.ode({**rates, clock: 1.0 + 0.3 * latitude, x: -turn * y, y: turn * x})
    problem = go.Problem("equator")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.1, 10.0))
    leg.initial(latitude=0.0, longitude=0.0, clock=0.0, x=1.0, y=0.0)
    leg.final(latitude=0.0, longitude=1.0)
    leg.guess([0.0, 1.0], longitude=[0.0, 1.0], course=0.0, clock=[0.0, 1.0])
    problem.minimize(leg.final_time)
    return problem


@pytest.fixture(scope="module")
def eastwards() -> go.Solution:
    return go.solve(equator(1.0), mesh="3x6")


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_directions_that_controls_never_move_are_not_conjugate(eastwards: go.Solution, share: float) -> None:
    (condition,) = judged(replace(eastwards, problem=equator(share * np.pi)))
    assert condition.result is (ConditionResult.PASS if share < 1 else ConditionResult.FAIL)
    if share > 1:
        assert first_time(condition) == pytest.approx(1 - 1 / share, abs=1e-3)
        assert condition.where.endswith("end")  # where the clock is free


def test_what_is_not_smooth_is_not_judged() -> None:
    """An integral that is prescribed, a singular control."""
    problem = regulator(1.0)
    leg = problem.phases["leg"]
    problem.constrain("integral", leg.integral(leg.model.symbol("x")), equals=0.1)
    assert judged(go.solve(problem, mesh="4x5", tol=None)) == []
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("singular")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(x**2))
    assert judged(go.solve(problem, mesh="4x5", tol=None)) == []


@pytest.mark.parametrize("curvature", list(ConditionResult))
def test_a_conjugate_time_that_the_second_order_denies_is_not_told(curvature: ConditionResult) -> None:
    past = Condition("conjugate points", ConditionResult.FAIL, 0.1, 0.0, "t = 2 s", "")
    judged = _agreed(past, Condition("second order", curvature, 0.0, 0.0, "", ""))
    assert judged.result is (
        ConditionResult.INCONCLUSIVE if curvature is ConditionResult.PASS else ConditionResult.FAIL
    )
    none = Condition("conjugate points", ConditionResult.PASS, 0.0, 0.0, "none", "")
    assert _agreed(none, Condition("second order", curvature, 0.0, 0.0, "", "")) is none


@pytest.mark.parametrize("fourth", [1.0, -1.0])
def test_an_end_that_is_just_the_focal_point_cannot_be_told(fourth: float) -> None:
    """u^2 / 2 over 1 s against x_f^2 / 2: only the fourth power of x_f says whether rest is a minimum."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("end that bends")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    end = leg.final_state("x")
    problem.minimize(leg.integral(u**2 / 2) - end**2 / 2 + fourth * end**4)
    t = np.linspace(0.0, 1.0, 21)
    verdict = go.verify_trajectory(problem, t, 0 * t, 0 * t)
    assert {c.name for c in verdict.inconclusive} == {"conjugate points", "second order"}
    assert verdict.ok and not verdict.minimum
