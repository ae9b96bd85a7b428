"""Linear-quadratic problems whose costates are polynomials, exponentials or sines, against closed forms."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.closed_forms import (
    LINEAR_MESHES,
    SCHEMES,
    SMOOTH_MESHES,
    Truth,
    assert_matches,
    constant,
    integrate,
    solve,
)
from testing.models import dynamics, one_phase

import gnc_opt as go

pytestmark = pytest.mark.parametrize("scheme", SCHEMES)
on_linear_meshes = pytest.mark.parametrize("mesh", LINEAR_MESHES.values(), ids=LINEAR_MESHES)
on_smooth_meshes = pytest.mark.parametrize("mesh", SMOOTH_MESHES.values(), ids=SMOOTH_MESHES)


def double_integrator(final_time: float) -> tuple[go.Problem, go.Phase]:
    cart, *_ = dynamics("cart", "x v", "u", lambda x, v, u: {x: v, v: u})
    problem, leg = one_phase("double integrator", cart, initial=0.0, final=final_time)
    return problem, leg


def integrator(initial: object, final: object) -> tuple[go.Problem, go.Phase]:
    model, *_ = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("integrator", model, initial=initial, final=final)
    return problem, leg


@on_linear_meshes
def test_minimum_energy(mesh: go.Mesh, scheme: str) -> None:
    """Rest to rest over one metre in one second: J = 6, lam_x = -12, lam_v = 12 t - 6, H = -18."""
    problem, leg = double_integrator(1.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    problem.minimize(leg.integral(leg.model.symbol("u") ** 2 / 2))
    solution = solve(problem, mesh, scheme)
    truth = Truth(
        6.0,
        states={"x": lambda t: 3 * t**2 - 2 * t**3, "v": lambda t: 6 * t - 6 * t**2},
        controls={"u": lambda t: 6 - 12 * t},
        costates={"x": constant(-12.0), "v": lambda t: 12 * t - 6},
        hamiltonian=constant(-18.0),
    )
    assert_matches(solution, truth, 1e-9)
    # The multipliers of the boundary values balance the costates: -lam at the start, +lam at the end.
    impulses = solution.phase().state_impulses
    np.testing.assert_allclose(impulses[:, 0], [12.0, 6.0], rtol=1e-9)
    np.testing.assert_allclose(impulses[:, -1], [-12.0, 6.0], rtol=1e-9)


@on_smooth_meshes
def test_scalar_regulator(mesh: go.Mesh, scheme: str) -> None:
    """min 1/2 int x^2 + u^2, x' = u, free end: lam = sinh(T - t) / cosh(T) = tanh(T - t) x (Riccati)."""
    T = 2.0
    problem, leg = integrator(0.0, T)
    leg.initial(x=1.0)
    x, u = leg.model.symbol("x"), leg.model.symbol("u")
    problem.minimize(leg.integral((x**2 + u**2) / 2))
    truth = Truth(
        0.5 * np.tanh(T),
        states={"x": lambda t: np.cosh(T - t) / np.cosh(T)},
        controls={"u": lambda t: -np.sinh(T - t) / np.cosh(T)},
        costates={"x": lambda t: np.sinh(T - t) / np.cosh(T)},
        hamiltonian=constant(0.5 / np.cosh(T) ** 2),
    )
    assert_matches(solve(problem, mesh, scheme), truth, 1e-9)


@on_smooth_meshes
def test_tracking_with_terminal_cost(mesh: go.Mesh, scheme: str) -> None:
    """min 1/2 int (x - sin t)^2 + u^2 + 3/2 (x(T) - 2)^2, x' = u: explicit time, H not constant."""
    T, weight, target = 2.0, 3.0, 2.0
    problem, leg = integrator(0.0, T)
    leg.initial(x=0.5)
    x, u, t = leg.model.symbol("x"), leg.model.symbol("u"), leg.model.time
    running = leg.integral(((x - ca.sin(t)) ** 2 + u**2) / 2)
    problem.minimize(running + weight * (leg.final_state("x") - target) ** 2 / 2)
    # x'' = x - sin t: x = A cosh t + B sinh t + sin(t) / 2; at the end -x'(T) = weight (x(T) - target).
    A = 0.5
    B = (weight * (target - A * np.cosh(T) - np.sin(T) / 2) - A * np.sinh(T) - np.cos(T) / 2) / (
        np.cosh(T) + weight * np.sinh(T)
    )

    def state(t):
        return A * np.cosh(t) + B * np.sinh(t) + np.sin(t) / 2

    def rate(t):
        return A * np.sinh(t) + B * np.cosh(t) + np.cos(t) / 2

    truth = Truth(
        integrate(lambda t: ((state(t) - np.sin(t)) ** 2 + rate(t) ** 2) / 2, 0, T)
        + weight * (state(T) - target) ** 2 / 2,
        states={"x": state},
        controls={"u": rate},
        costates={"x": lambda t: -rate(t)},
        hamiltonian=lambda t: ((state(t) - np.sin(t)) ** 2 - rate(t) ** 2) / 2,
    )
    assert_matches(solve(problem, mesh, scheme), truth, 1e-9)


@on_smooth_meshes
def test_periodic_regulator(mesh: go.Mesh, scheme: str) -> None:
    """x' = -x + u + cos t, x(2 pi) = x(0): lam = cos(t) / 3, and the multiplier of periodicity is lam(0)."""
    model = go.Model("driven")
    x, u = model.state("x"), model.control("u")
    model.ode({x: -x + u + ca.cos(model.time)})
    problem, leg = one_phase("periodic", model, initial=0.0, final=2 * np.pi)
    problem.constrain("periodic", leg.final_state("x") - leg.initial_state("x"), equals=0.0)
    problem.minimize(leg.integral((x**2 + u**2) / 2))
    finer = go.Mesh(mesh.breaks, tuple(n + 4 for n in mesh.degrees))
    solution = solve(problem, finer, scheme)

    def state(t):
        return (np.sin(t) + np.cos(t)) / 3

    def costate(t):
        return np.cos(t) / 3

    truth = Truth(
        np.pi / 6,
        states={"x": state},
        controls={"u": lambda t: -costate(t)},
        costates={"x": costate},
        hamiltonian=lambda t: (
            (state(t) ** 2 + costate(t) ** 2) / 2 + costate(t) * (np.cos(t) - state(t) - costate(t))
        ),
    )
    assert_matches(solution, truth, 1e-9)
    assert solution.multiplier("periodic") == pytest.approx(1 / 3, abs=1e-9)


@on_linear_meshes
def test_isoperimetric(mesh: go.Mesh, scheme: str) -> None:
    """min 1/2 int u^2 with int x = 1, x(0) = x(1) = 0: J = 6 A^2, so the multiplier of (A - 1) is -12."""
    problem, leg = integrator(0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=0.0)
    x, u = leg.model.symbol("x"), leg.model.symbol("u")
    problem.minimize(leg.integral(u**2 / 2))
    problem.constrain("area", leg.integral(x, name="area"), equals=1.0)
    solution = solve(problem, mesh, scheme)
    truth = Truth(
        6.0,
        states={"x": lambda t: 6 * t * (1 - t)},
        controls={"u": lambda t: 6 - 12 * t},
        costates={"x": lambda t: 12 * t - 6},
        hamiltonian=constant(-18.0),
    )
    assert_matches(solution, truth, 1e-9)
    assert solution.multiplier("area") == pytest.approx(-12.0, abs=1e-9)
    assert solution.phase().integral("area") == pytest.approx(1.0, abs=1e-12)


@on_smooth_meshes
def test_free_initial_state(mesh: go.Mesh, scheme: str) -> None:
    """A cost 2 (x(0) - 3)^2 on the free initial state: lam(0) = -4 (x(0) - 3)."""
    T, weight, wish = 2.0, 4.0, 3.0
    problem, leg = integrator(0.0, T)
    x, u = leg.model.symbol("x"), leg.model.symbol("u")
    problem.minimize(weight * (leg.initial_state("x") - wish) ** 2 / 2 + leg.integral((x**2 + u**2) / 2))
    first = weight * wish / (weight + np.tanh(T))
    truth = Truth(
        weight * (first - wish) ** 2 / 2 + first**2 * np.tanh(T) / 2,
        states={"x": lambda t: first * np.cosh(T - t) / np.cosh(T)},
        controls={"u": lambda t: -first * np.sinh(T - t) / np.cosh(T)},
        costates={"x": lambda t: first * np.sinh(T - t) / np.cosh(T)},
        hamiltonian=constant(0.5 * (first / np.cosh(T)) ** 2),
    )
    assert_matches(solve(problem, mesh, scheme), truth, 1e-9)


@on_smooth_meshes
def test_initial_state_in_a_range(mesh: go.Mesh, scheme: str) -> None:
    """x(0) in [1/2, 2]: it takes 1/2, and the range pushes with -lam(0) (a lower limit: negative)."""
    T = 2.0
    problem, leg = integrator(0.0, T)
    leg.initial(x=(0.5, 2.0))
    x, u = leg.model.symbol("x"), leg.model.symbol("u")
    problem.minimize(leg.integral((x**2 + u**2) / 2))
    solution = solve(problem, mesh, scheme)
    truth = Truth(
        np.tanh(T) / 8,
        states={"x": lambda t: 0.5 * np.cosh(T - t) / np.cosh(T)},
        costates={"x": lambda t: 0.5 * np.sinh(T - t) / np.cosh(T)},
        hamiltonian=constant(0.125 / np.cosh(T) ** 2),
    )
    assert_matches(solution, truth, 1e-9)
    assert solution.phase().state_impulses[0, 0] == pytest.approx(-0.5 * np.tanh(T), abs=1e-9)
