"""Kinks, arcs on state bounds and singular arcs, found by themselves, against closed forms."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from testing.internals import PhaseStructure, SmoothControl
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import ArcKind

FREE, UP = ArcKind.INTERIOR, ArcKind.UPPER


def kinds(solution: go.Solution, channel: str) -> list[ArcKind]:
    return [arc.kind for arc in solution.structure if arc.channel == channel]


def junctions(solution: go.Solution, channel: str) -> list[float]:
    arcs = [arc for arc in solution.structure if arc.channel == channel]
    return [arc.end for arc in arcs[:-1]]


def speed_limited(limit: float, length: float = 1.0) -> go.Problem:
    """Rest to rest over some length in minimum time, |acceleration| <= 1, |speed| <= limit."""
    model, *_ = dynamics("double integrator", "x v", "u", lambda x, v, u: {x: v, v: u})
    problem, leg = one_phase("speed limit", model, 0.0, (0.5, 10.0))
    leg.initial(x=0.0, v=0.0)
    leg.final(x=length, v=0.0)
    leg.bounds(u=(-1.0, 1.0), v=(-limit, limit))
    problem.minimize(leg.final_time)
    return problem


def test_speed_limit() -> None:
    """Bang, cruise at the limit, bang: t_f = |L| / V + V; costates p_x = -1 / V and p_v = V p_x (V - t), 0, ..."""
    limit, length = 0.5, -1.0
    solution = go.solve(speed_limited(limit, length), tol=1e-8)
    t_f, sign = abs(length) / limit + limit, np.sign(length)
    assert solution.objective == pytest.approx(t_f, abs=1e-9)
    assert junctions(solution, "u") == pytest.approx([limit, t_f - limit], abs=1e-8)
    bangs = [ArcKind.UPPER, ArcKind.LOWER] if sign > 0 else [ArcKind.LOWER, ArcKind.UPPER]
    assert kinds(solution, "u") == [bangs[0], ArcKind.CONSTRAINED, bangs[1]]
    (cruise,) = [arc for arc in solution.structure if arc.channel == "v"]
    assert cruise.kind is bangs[0]
    assert (cruise.start, cruise.end) == pytest.approx((limit, t_f - limit), abs=1e-8)
    times = np.linspace(0.0, t_f, 31)
    expected = np.where(times < limit, times - limit, np.where(times > t_f - limit, times - t_f + limit, 0.0))
    np.testing.assert_allclose(solution.costate("v")(times), sign * expected / limit, atol=1e-8)
    np.testing.assert_allclose(solution.costate("x")(times), -sign / limit, atol=1e-8)
    verdict = go.verify(solution, tol=1e-8)
    assert verdict.ok, verdict.explain()


def test_singular_arc_between_bangs() -> None:
    """x' = u, |u| <= 2, min of half the integral of (x - sin t)^2, x(0) = 1, x(3) = 3/2.

    The singular arc is x = sin t, u = cos t; the bangs meet it where 1 - 2 t = sin t and 3/2 - 2 (3 - t) = sin t.
    """
    model, x, _u = dynamics("pursuit", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("pursuit", model, 0.0, 3.0)
    leg.initial(x=1.0)
    leg.final(x=1.5)
    leg.bounds(u=(-2.0, 2.0))
    problem.minimize(0.5 * leg.integral((x - ca.sin(model.time)) ** 2))
    solution = go.solve(problem, tol=1e-8)
    first = brentq(lambda t: 1 - 2 * t - np.sin(t), 0.0, 1.0, xtol=1e-14)
    last = brentq(lambda t: 1.5 - 2 * (3 - t) - np.sin(t), 2.0, 3.0, xtol=1e-14)
    start = quad(lambda t: 0.5 * (1 - 2 * t - np.sin(t)) ** 2, 0.0, first)[0]
    end = quad(lambda t: 0.5 * (1.5 - 2 * (3 - t) - np.sin(t)) ** 2, last, 3.0)[0]
    assert kinds(solution, "u") == [ArcKind.LOWER, ArcKind.SINGULAR, ArcKind.UPPER]
    assert junctions(solution, "u") == pytest.approx([first, last], abs=1e-8)
    assert solution.objective == pytest.approx(start + end, abs=1e-12)
    times = np.linspace(first + 1e-3, last - 1e-3, 40)
    np.testing.assert_allclose(solution.control("u")(times), np.cos(times), atol=1e-6)
    assert go.verify(solution, tol=1e-7).ok


def saturated_regulator() -> go.Problem:
    """x' = u, |u| <= 1, half the integral of x^2 + u^2 over 4 s, x(0) = 3."""
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("saturated regulator", model, 0.0, 4.0)
    leg.initial(x=3.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(0.5 * leg.integral(x**2 + u**2))
    return problem


def test_kink_of_a_saturated_regulator() -> None:
    """Off the bound x = c cosh(T - t), lambda = c sinh(T - t) = 1 at the kink: x0 - t_k = coth(T - t_k)."""
    solution = go.solve(saturated_regulator(), tol=1e-8)
    kink = brentq(lambda t: 3.0 - t - 1 / np.tanh(4.0 - t), 0.5, 3.0, xtol=1e-14)
    bound = 0.5 * ((27.0 - (3.0 - kink) ** 3) / 3 + kink)
    cost = bound + 0.5 * (3.0 - kink) ** 2 * np.tanh(4.0 - kink)
    assert kinds(solution, "u") == [ArcKind.LOWER, ArcKind.INTERIOR]
    assert junctions(solution, "u") == pytest.approx([kink], abs=1e-8)
    assert solution.objective == pytest.approx(cost, abs=1e-10)
    assert solution.costate("x")(0.0) == pytest.approx(1.0 + 3.0 * kink - 0.5 * kink**2, abs=1e-8)
    verdict = go.verify(solution, tol=1e-7)
    assert verdict.ok, verdict.explain()


def test_kink_on_a_mixed_constraint() -> None:
    r"""x' = u from 0 to L in T, least half integral of u^2 with u + x <= a.

    Free with u = c until c (1 + t_k) = a, then x = a - c exp(-(t - t_k)) to x(T) = L; mu = c sinh(t - t_k).
    """
    a, span, length = 2.0, 2.0, 1.5
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("mixed constraint", model, 0.0, span)
    leg.initial(x=0.0)
    leg.final(x=length)
    leg.bounds(u=(-10.0, 10.0))
    leg.path("slope", u + x, upper=a)
    problem.minimize(0.5 * leg.integral(u**2))
    solution = go.solve(problem, tol=1e-8)
    c = brentq(lambda c: a - c * np.exp(-(span - a / c + 1)) - length, 0.7, 0.9, xtol=1e-15)
    kink = a / c - 1
    assert kinds(solution, "u") == [ArcKind.INTERIOR, ArcKind.CONSTRAINED]
    (active,) = [arc for arc in solution.structure if arc.channel == "slope"]
    assert (active.kind, active.end) == (ArcKind.UPPER, span)
    assert active.start == pytest.approx(kink, abs=1e-8)
    assert solution.objective == pytest.approx(
        0.5 * c**2 * (kink + (1 - np.exp(-2 * (span - kink))) / 2), abs=1e-10
    )
    times = np.linspace(kink + 0.01, span, 20)
    mu = solution.phase().path_multiplier(times)[0]
    np.testing.assert_allclose(mu, c * np.sinh(times - kink), atol=1e-7)
    assert go.verify(solution, tol=1e-7).ok


def test_kinks_are_distinguished_from_switches() -> None:
    structure = PhaseStructure((0.0, 1.0, 2.0, 3.0), ((UP, FREE), (UP, UP), (FREE, UP)), (True, False), 2)
    assert not structure.has_only_control_kinks(1)
    assert structure.has_only_control_kinks(2)


def test_a_smooth_control_is_one_polynomial_and_costs_what_it_must() -> None:
    """Rest to rest in unit time: the optimum u = 6 - 12 t is smooth of degree 1; of degree 0 there is none."""
    model, _x, _v, u = dynamics("double integrator", "x v", "u", lambda x, v, u: {x: v, v: u})
    problem, leg = one_phase("smooth", model, 0.0, 1.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(v=0.0)
    problem.minimize(leg.integral(u**2) - 24.0 * leg.final_state("x"))

    def cost(degree: int) -> float:
        smooth = (SmoothControl(0, 0, 4, degree),)
        return go.solve(
            problem.with_fixed_arcs(arcs=np.zeros((1, 4)), smooth=smooth), mesh="4x5", tol=None
        ).objective

    assert cost(0) == pytest.approx(0.0, abs=1e-10)
    assert cost(1) == pytest.approx(-12.0, abs=1e-10)
    assert cost(3) == pytest.approx(-12.0, abs=1e-10)


def test_progress_shows_the_passes_of_the_structure_loop(capsys: pytest.CaptureFixture[str]) -> None:
    solution = go.refine(go.solve(saturated_regulator(), tol=None), progress=True)
    assert solution.structure and solution.history is not None
    shown = capsys.readouterr().err
    assert f"iteration {len(solution.history.passes) - 1}" in shown


def test_held_arcs_are_checked() -> None:
    problem = speed_limited(0.5)
    with pytest.raises(go.ProblemError, match="one column per segment"):
        go.solve(problem.with_fixed_arcs(arcs=[[1, 0]], states=[[0, 0, 0], [0, 1, 0]]), mesh="2x4", tol=None)
    with pytest.raises(go.ProblemError, match="cannot hold 'x'"):
        problem.with_fixed_arcs(arcs=[[1]], states=[[1], [0]])
    with pytest.raises(go.ProblemError, match="2 rows"):
        problem.with_fixed_arcs(arcs=[[1]], states=[[1]])


@pytest.mark.slow
@pytest.mark.parametrize("k", [0.1, -0.2])
def test_a_control_in_which_h_is_not_convex_jumps_between_its_bounds(k: float) -> None:
    """A thrust of u + k u^3 takes 2 / sqrt(1 + k) over 1 m; H is convex in u before the switch, concave behind it."""
    cart, *_ = dynamics("cart", "q v", "u", lambda q, v, u: {q: v, v: u + k * u**3})
    problem, leg = one_phase("rest to rest", cart, 0.0, (0.1, 10.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    found = go.solve(problem)
    assert found.objective == pytest.approx(2 / np.sqrt(1 + k), abs=1e-8)
    assert go.verify(found).ok


@pytest.mark.slow
def test_short_arcs_where_h_is_convex_are_found() -> None:
    """Oscillator to rest, x' = v + e u^2, v' = u - x: costates turn with it, so that all times but one are known.

    H = 1 + ... + lam_x e u^2 + lam_v u, with (lam_x, lam_v) = A (cos, -sin)(t - c): where lam_x > 0, u is between its
    bounds while |tan(t - c)| < 2 e; where lam_x < 0 it jumps, half a turn later.
    """
    e = 0.02
    model, *_ = dynamics("oscillator", "x v", "u", lambda x, v, u: {x: v + e * u**2, v: u - x})
    problem, leg = one_phase("oscillator to rest", model, 0.0, (1.0, 30.0))
    leg.initial(x=7.0, v=0.0)
    leg.final(x=0.0, v=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    found = go.refine(go.solve(problem, tol=None))
    kinds = ["lower", "interior", "upper", "lower", "interior", "upper", "lower"]
    assert [arc.kind.value for arc in found.structure] == kinds
    begins = np.array([arc.start for arc in found.structure])
    turn, half = np.pi, np.arctan(2 * e)
    middle = begins[1] + half
    times = middle + np.array([-half, half, turn, 2 * turn - half, 2 * turn + half, 3 * turn])
    # The cost changes with the third power of what the time of a kink is off.
    np.testing.assert_allclose(begins[1:], times, rtol=0, atol=1e-4)
    assert found.history is not None and found.history.converged and go.verify(found).ok
