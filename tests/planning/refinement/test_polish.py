"""Indirect polish against closed forms, published values and the verdict at 1e-9."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq
from testing.models import dynamics, one_phase
from testing.nonlinear_problems import orbit_raising, reorientation, van_der_pol

import gnc_opt as go
from gnc_opt.planning import solve_indirect

VERDICT = 1e-9
"""Tolerance of every condition; the direct solutions that polish starts from miss it by orders of magnitude."""


def double_integrator() -> tuple[go.Model, object]:
    model, _q, _v, a = dynamics("double integrator", "q v", "a", lambda q, v, a: {q: v, v: a})
    return model, a


def brachistochrone(bounded: bool) -> go.Problem:
    bead = go.Model("bead")
    x, y, v = bead.state("x"), bead.state("y"), bead.state("v")
    angle = bead.control("angle")
    bead.ode({x: v * ca.sin(angle), y: v * ca.cos(angle), v: 9.81 * ca.cos(angle)})
    problem, leg = one_phase("brachistochrone", bead, initial=0.0, final=(0.1, 10.0))
    leg.initial(x=0.0, y=0.0, v=0.0)
    leg.final(x=2.0, y=1.0)
    if bounded:
        leg.bounds(angle=(-0.5, 3.0))
    leg.guess(angle=(0.1, 1.4), x=(0.0, 2.0), y=(0.0, 1.0), v=(0.0, 4.0))
    problem.minimize(leg.final_time)
    return problem


@pytest.mark.parametrize("bounded", [True, False])
def test_brachistochrone_is_a_cycloid(bounded: bool) -> None:
    """x = r (phi - sin phi), y = r (1 - cos phi), angle = phi / 2; without bounds the solver adds whole turns."""
    phi = brentq(lambda p: (p - np.sin(p)) / (1 - np.cos(p)) - 2.0, 0.1, 6.0, xtol=1e-15, rtol=1e-15)
    radius = 1.0 / (1 - np.cos(phi))
    time = phi * np.sqrt(radius / 9.81)
    solution = solve_indirect(go.solve(brachistochrone(bounded), mesh="5x4", tol=None))
    assert solution.objective == pytest.approx(time, rel=1e-12)
    t = np.linspace(0.0, time * (1 - 1e-12), 57)
    turned = phi * t / time
    for name, exact in (("x", radius * (turned - np.sin(turned))), ("y", radius * (1 - np.cos(turned)))):
        np.testing.assert_allclose(solution.state(name)(t), exact, rtol=0, atol=1e-10)
    whole = 2 * np.pi * np.round(solution.control("angle")(0.0) / (2 * np.pi))
    np.testing.assert_allclose(solution.control("angle")(t) - whole, turned / 2, rtol=0, atol=1e-10)
    assert go.verify(solution, tol=VERDICT).ok


def test_scalar_regulator() -> None:
    """Minimise the integral of (x^2 + u^2)/2 over [0, 1] from 1: lambda = P x, P = tanh(1 - t)."""
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("scalar LQ", model, initial=0.0, final=1.0)
    leg.initial(x=1.0)
    problem.minimize(leg.integral((x**2 + u**2) / 2))
    solution = solve_indirect(go.solve(problem, mesh="2x2", tol=None))
    t = np.linspace(0.0, 1.0, 33)
    state = np.cosh(1 - t) / np.cosh(1)
    assert solution.objective == pytest.approx(np.tanh(1) / 2, abs=1e-13)
    np.testing.assert_allclose(solution.state("x")(t), state, rtol=0, atol=1e-12)
    np.testing.assert_allclose(solution.costate("x")(t), np.tanh(1 - t) * state, rtol=0, atol=1e-12)
    np.testing.assert_allclose(solution.control("u")(t), -np.tanh(1 - t) * state, rtol=0, atol=1e-12)


@pytest.mark.parametrize("scheme", ["LG", "LGL"])
def test_least_energy_transfer(scheme: str) -> None:
    """From rest at 1 to rest at 0 in 1 s: a = -6 + 12 t, J = 6."""
    model, a = double_integrator()
    problem, leg = one_phase("least energy", model, initial=0.0, final=1.0)
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    problem.minimize(leg.integral(a**2 / 2))
    solution = solve_indirect(go.solve(problem, mesh="3x3", scheme=scheme, tol=None))
    assert solution.objective == pytest.approx(6.0, abs=1e-12)
    assert solution.phase().scheme == "LG"
    t = np.linspace(0.0, 1.0, 21)
    np.testing.assert_allclose(solution.control("a")(t), -6 + 12 * t, atol=1e-11)
    np.testing.assert_allclose(solution.costate("q")(t), 12.0, atol=1e-11)
    assert go.sensitivity(solution, initial="q").objective == pytest.approx(12.0, rel=1e-11)


def test_orbit_raising() -> None:
    """Bryson & Ho's maximisation; 1.52527770065 is an independent indirect solution."""
    solution = solve_indirect(go.solve(orbit_raising(), mesh="8x4", tol=None))
    assert solution.objective == pytest.approx(1.52527770065, abs=1e-11)
    assert go.verify(solution, tol=VERDICT).ok
    assert "indirect" in solution.provenance["polished"]
    assert abs(solution.constraint_values[0] - 1.0) < 1e-13


@pytest.mark.parametrize("build", [van_der_pol, reorientation])
def test_unbounded_problems_pass_a_tight_verdict(build: object) -> None:
    direct = go.solve(build(), mesh="6x4", tol=None)
    assert not go.verify(direct, tol=VERDICT).ok
    solution = solve_indirect(direct)
    assert go.verify(solution, tol=VERDICT).ok, str(go.verify(solution, tol=VERDICT))
    assert solution.quality.max_defect < 1e-10
    assert solution.objective == pytest.approx(direct.objective, rel=1e-4)


def test_free_initial_time_and_nonlinear_functions_of_integrals() -> None:
    model, a = double_integrator()
    q = model.symbol("q")
    problem, leg = one_phase("root of energy", model, initial=(-5.0, 5.0), final=3.0)
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    energy, moment = leg.integral(a**2 / 2), leg.integral(q**2 * a)
    problem.constrain("moment", moment, equals=-0.5)
    problem.minimize(ca.sqrt(energy) + 0.3 * leg.duration**2)
    solution = solve_indirect(go.solve(problem, mesh="6x4", tol=None))
    verdict = go.verify(solution, tol=VERDICT)
    assert verdict.ok, str(verdict)
    leg_solution = solution.phase()
    assert leg_solution.integrals[1] == pytest.approx(-0.5, abs=1e-13)
    assert leg_solution.integral_weights[0] == pytest.approx(
        0.5 / np.sqrt(leg_solution.integrals[0]), rel=1e-12
    )


def test_two_phases_and_an_optimised_parameter() -> None:
    model = go.Model("spring")
    q, v, force = model.state("q"), model.state("v"), model.control("force")
    stiffness = model.parameter("stiffness", 1.0)
    model.ode({q: v, v: force - stiffness * ca.sin(q)})
    problem = go.Problem("tuned spring")
    first, second = problem.phase("first", model), problem.phase("second", model)
    first.time(initial=0.0, final=1.0)
    second.time(initial=1.0, final=(1.2, 5.0))
    first.initial(q=0.0, v=1.0)
    second.final(v=0.5)
    k = problem.parameter("stiffness", lower=0.05, upper=5.0, guess=1.0)
    problem.link(first, second)  # its time row joins two fixed times: no multiplier can be found for it
    effort = first.integral(force**2) + second.integral(force**2 + 0.1 * q**2)
    problem.maximize(second.final_state("q") - effort - 0.05 / k - 0.1 * second.final_time**2)
    direct = go.solve(problem, mesh="5x3", tol=None)
    solution = solve_indirect(direct)
    verdict = go.verify(solution, tol=VERDICT)
    assert verdict.ok, str(verdict)
    assert solution.parameter("stiffness") == pytest.approx(direct.parameter("stiffness"), rel=1e-3)
    jump = solution.costate("q", "first")(1.0, "left") - solution.costate("q", "second")(1.0)
    assert abs(jump) < 1e-11


def test_a_polished_solution_is_an_ordinary_one(tmp_path: Path) -> None:
    problem = van_der_pol()
    solution = solve_indirect(go.solve(problem, mesh="6x4", tol=None))
    loaded = go.load(solution.save(tmp_path / "polished.npz"), problem=problem)
    assert loaded.objective == solution.objective
    again = go.solve(problem, guess=solution, options=go.SolverOptions(tolerance=1e-10))
    assert again.objective == pytest.approx(solution.objective, rel=1e-11)
    assert again.phase().mesh == solution.phase().mesh


def test_refusals_name_the_culprit() -> None:
    model, _ = double_integrator()
    problem, leg = one_phase("minimum time", model, initial=0.0, final=(0.1, 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    bang = go.solve(problem, tol=None)
    with pytest.raises(go.GncOptError, match=r"control 'a' is at its limit at t = .*structure='auto'"):
        solve_indirect(bang)
    with pytest.raises(go.GncOptError, match="without its problem"):
        solve_indirect(replace(bang, problem=None))
    with pytest.raises(go.ArgumentError, match=r"solve_indirect\(\) got"):
        solve_indirect(problem)
    with pytest.raises(go.GncOptError, match="the tolerance of solve_indirect"):
        solve_indirect(bang, tol=0.0)


def test_singular_control_is_refused() -> None:
    model, x, _u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("tracking", model, initial=0.0, final=2.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral((x - 0.3 * model.time) ** 2))
    with pytest.raises(go.GncOptError, match=r"no positive curvature in control 'u' at t = "):
        solve_indirect(go.solve(problem, tol=None))


def test_active_path_constraint_and_state_bound_are_refused() -> None:
    """Bryson & Denham: q <= 0.1 while the velocity is turned round."""
    for kind in ("path constraint 'ceiling'", "state 'q'"):
        model, a = double_integrator()
        problem, leg = one_phase("ceiling", model, initial=0.0, final=1.0)
        leg.initial(q=0.0, v=1.0)
        leg.final(q=0.0, v=-1.0)
        if kind.startswith("path"):
            leg.path("ceiling", model.symbol("q"), upper=0.1)
        else:
            leg.bounds(q=(None, 0.1))
        problem.minimize(leg.integral(a**2 / 2))
        with pytest.raises(go.GncOptError, match=f"{kind} is at its limit at t = "):
            solve_indirect(go.solve(problem, tol=None))


def test_a_control_that_is_zero_all_along_is_determined_too() -> None:
    """It has no magnitude; what it is measured by must not depend on the others' either."""
    model, _x, _y, u, w = dynamics("two", "x y", "u w", lambda x, y, u, w: {x: u, y: w})
    problem, leg = one_phase("one of two", model, 0.0, 1.0)
    leg.initial(x=0.0, y=0.0)
    leg.final(x=1e4, y=0.0)
    problem.minimize(leg.integral(0.5 * (u**2 + w**2)))
    solution = solve_indirect(go.solve(problem, mesh="2x4", tol=None))
    assert solution.objective == pytest.approx(0.5e8, rel=1e-12)
    assert go.verify(solution, tol=VERDICT).ok
