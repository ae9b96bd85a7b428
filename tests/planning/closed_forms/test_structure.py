"""What problems are made of, one closed form each: phases, free times, parameters, integrals, paths."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq
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


def integrator(name: str = "integrator") -> go.Model:
    model, *_ = dynamics(name, "x", "u", lambda x, u: {x: u})
    return model


def running(leg: go.Phase, integrand: str) -> object:
    """Return the integral of a named cost of the integrator."""
    x, u = leg.model.symbol("x"), leg.model.symbol("u")
    return leg.integral({"energy": u**2 / 2, "regulator": (x**2 + u**2) / 2, "sum": x**2 + u**2}[integrand])


@on_smooth_meshes
def test_interior_point(mesh: go.Mesh, scheme: str) -> None:
    """x(3/4) = 9/10 between two phases: its multiplier is the costate's jump (PSOPT's interior_point)."""
    model = integrator()
    problem = go.Problem("interior point")
    first, second = problem.phase("first", model), problem.phase("second", model)
    first.time(initial=0.0, final=0.75)
    second.time(initial=0.75, final=1.0)
    first.initial(x=1.0)
    second.final(x=0.75)
    problem.link(first, second, time=False)
    problem.constrain("gate", first.final_state("x"), equals=0.9)
    problem.minimize(running(first, "sum") + running(second, "sum"))
    solution = solve(problem, {"first": mesh, "second": go.Mesh.uniform(2, 7)}, scheme)

    def truth(a: float, b: float, start: float, length: float) -> Truth:
        def rate(t):
            return (-a * np.cosh(start + length - t) + b * np.cosh(t - start)) / np.sinh(length)

        return Truth(
            0.9205314414730035,
            states={
                "x": lambda t: (a * np.sinh(start + length - t) + b * np.sinh(t - start)) / np.sinh(length)
            },
            controls={"u": rate},
            costates={"x": lambda t: -2 * rate(t)},
            hamiltonian=constant((a**2 + b**2 - 2 * a * b * np.cosh(length)) / -(np.sinh(length) ** 2)),
        )

    before, after = truth(1.0, 0.9, 0.0, 0.75), truth(0.9, 0.75, 0.75, 0.25)
    assert_matches(solution, before, 1e-9, "first")
    assert_matches(solution, after, 1e-9, "second")
    at = np.array([0.75])
    jump = before.costates["x"](at) - after.costates["x"](at)
    assert solution.multiplier("gate") == pytest.approx(jump[0], abs=1e-9)


@on_linear_meshes
def test_free_initial_time(mesh: go.Mesh, scheme: str) -> None:
    """min 2 (t_f - t_0) + 1/2 int u^2, t_f = 1: the start is at 1/2, where H = dPhi/dt_0 = -2."""
    problem, leg = one_phase("free start", integrator(), initial=(-3.0, 0.9), final=1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    problem.minimize(running(leg, "energy") + 2 * leg.duration)
    solution = solve(problem, mesh, scheme)
    assert solution.phase().initial_time == pytest.approx(0.5, abs=1e-9)
    truth = Truth(
        2.0,
        states={"x": lambda t: 2 * (t - 0.5)},
        controls={"u": constant(2.0)},
        costates={"x": constant(-2.0)},
        hamiltonian=constant(-2.0),
    )
    assert_matches(solution, truth, 1e-9)


@on_linear_meshes
def test_both_times_free_and_a_least_duration(mesh: go.Mesh, scheme: str) -> None:
    """min (t_0 - 1)^2 + int u^2 / 2 + 2 dt, duration >= 4/5: the limit pushes with -(2 - 1 / (2 T^2))."""
    problem = go.Problem("least duration")
    leg = problem.phase("leg", integrator())
    leg.time(initial=(-5.0, 5.0), final=(-5.0, 9.0), duration=(0.8, None))
    leg.initial(x=0.0)
    leg.final(x=1.0)
    u = leg.model.symbol("u")
    problem.minimize((leg.initial_time - 1) ** 2 + leg.integral(u**2 / 2 + 2))
    solution = solve(problem, mesh, scheme)
    push = 2 - 1 / (2 * 0.8**2)
    truth = Truth(
        1 / 1.6 + 1.6,
        states={"x": lambda t: (t - 1) / 0.8},
        controls={"u": constant(1.25)},
        costates={"x": constant(-1.25)},
        hamiltonian=constant(push),
    )
    assert solution.phase().initial_time == pytest.approx(1.0, abs=1e-9)
    assert_matches(solution, truth, 1e-9)
    assert solution.phase().duration_multiplier == pytest.approx(-push, abs=1e-8)


@on_linear_meshes
def test_final_time_at_its_limit(mesh: go.Mesh, scheme: str) -> None:
    """With t_f <= 2/5 where 1/2 is best, H = dJ/dt_f = 2 - 1/(2 t_f^2) < 0 and the limit pushes with -H."""
    problem, leg = one_phase("late is better", integrator(), initial=0.0, final=(0.1, 0.4))
    leg.initial(x=0.0)
    leg.final(x=1.0)
    problem.minimize(leg.integral(leg.model.symbol("u") ** 2 / 2 + 2))
    solution = solve(problem, mesh, scheme)
    truth = Truth(2.05, costates={"x": constant(-2.5)}, hamiltonian=constant(-1.125))
    assert_matches(solution, truth, 1e-9)
    np.testing.assert_allclose(solution.phase().time_multipliers, [0.0, 1.125], atol=1e-8)


def test_maximisation(scheme: str) -> None:
    """Cake eating: max int exp(-t/20) log c, k' = k/10 - c, k from 1 to 0; costates are those of -J."""
    model, _k, c = dynamics("cake", "k", "c", lambda k, c: {k: 0.1 * k - c})
    problem, leg = one_phase("cake eating", model, initial=0.0, final=10.0)
    leg.initial(k=1.0)
    leg.final(k=0.0)
    leg.bounds(k=(0.0, 10.0), c=(1e-3, 10.0))
    problem.maximize(leg.integral(ca.exp(-0.05 * model.time) * ca.log(c)))
    solution = solve(problem, go.Mesh.uniform(3, 9), scheme)
    c0 = 0.05 / (1 - np.exp(-0.5))

    def cake(t):
        return np.exp(0.1 * t) * (1 - (1 - np.exp(-0.05 * t)) / (1 - np.exp(-0.5)))

    def eaten(t):
        return c0 * np.exp(0.05 * t)

    def costate(t):
        return -np.exp(-0.1 * t) / c0

    truth = Truth(
        -14.430308516987475,
        states={"k": cake},
        controls={"c": eaten},
        costates={"k": costate},
        hamiltonian=lambda t: -np.exp(-0.05 * t) * np.log(eaten(t)) + costate(t) * (0.1 * cake(t) - eaten(t)),
    )
    assert_matches(solution, truth, 1e-8)
    assert solution.maximised


@on_linear_meshes
@pytest.mark.parametrize("limit", [None, 0.25])
def test_parameter(limit: float | None, mesh: go.Mesh, scheme: str) -> None:
    """x' = u + p, x from 0 to 1, min 1/2 int u^2 + p^2 / 2: p = 1/2; a limit of 1/4 pushes with 1/2."""
    model = go.Model("drift")
    x, u, p = model.state("x"), model.control("u"), model.parameter("p", 0.0)
    model.ode({x: u + p})
    problem, leg = one_phase("drift", model, initial=0.0, final=1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    free = problem.parameter("p", lower=-1.0, upper=1.0 if limit is None else limit, guess=0.1)
    problem.minimize(free**2 / 2 + leg.integral(u**2 / 2))
    solution = solve(problem, mesh, scheme)
    best = 0.5 if limit is None else limit
    truth = Truth(
        best**2 / 2 + (1 - best) ** 2 / 2,
        states={"x": lambda t: t},
        controls={"u": constant(1 - best)},
        costates={"x": constant(best - 1)},
        hamiltonian=constant((1 - best) ** 2 / 2 - (1 - best)),
    )
    assert_matches(solution, truth, 1e-9)
    assert solution.parameter("p") == pytest.approx(best, abs=1e-9)
    # Stationarity: dJ/dp + int lam dt + multiplier = 0.
    np.testing.assert_allclose(solution.parameter_multipliers, 1 - 2 * best, atol=1e-9)


@on_smooth_meshes
def test_parameter_within_the_dynamics(mesh: go.Mesh, scheme: str) -> None:
    """Reactions a -> b -> c: the rate k that leaves most b after one second; no control."""
    model = go.Model("reactions")
    a, b, k = model.state("a"), model.state("b"), model.parameter("k", 1.0)
    model.ode({a: -k * a, b: k * a - b})
    problem, leg = one_phase("most b", model, initial=0.0, final=1.0)
    leg.initial(a=1.0, b=0.0)
    problem.parameter("k", lower=1.5, upper=10.0, guess=2.0)
    problem.maximize(leg.final_state("b"))
    solution = solve(problem, mesh, scheme)

    def yield_slope(rate: float) -> float:
        return -(np.exp(-1) - np.exp(-rate)) / (rate - 1) ** 2 + rate / (rate - 1) * np.exp(-rate)

    k_best = brentq(yield_slope, 1.5, 10.0, xtol=1e-14)
    ratio = k_best / (k_best - 1)
    truth = Truth(
        ratio * (np.exp(-1) - np.exp(-k_best)),
        states={
            "a": lambda t: np.exp(-k_best * t),
            "b": lambda t: ratio * (np.exp(-t) - np.exp(-k_best * t)),
        },
        costates={
            "a": lambda t: -ratio * (np.exp(t - 1) - np.exp(k_best * (t - 1))),
            "b": lambda t: -np.exp(t - 1),
        },
        hamiltonian=constant(ratio * k_best * (np.exp(-1) - np.exp(-k_best)) - k_best * np.exp(-1)),
    )
    assert_matches(solution, truth, 1e-8)
    assert solution.parameter("k") == pytest.approx(k_best, abs=1e-8)


@on_smooth_meshes
@pytest.mark.parametrize("power", [0.5, 2.0])
def test_power_of_an_integral(power: float, mesh: go.Mesh, scheme: str) -> None:
    """A cost I^p has the trajectory of I, and costates and H of I times dJ/dI = p I^(p - 1)."""
    T = 2.0
    problem, leg = one_phase("power of an integral", integrator(), initial=0.0, final=T)
    leg.initial(x=1.0)
    problem.minimize(running(leg, "regulator") ** power)
    solution = solve(problem, mesh, scheme)
    best = np.tanh(T) / 2
    weight = power * best ** (power - 1)
    truth = Truth(
        best**power,
        states={"x": lambda t: np.cosh(T - t) / np.cosh(T)},
        controls={"u": lambda t: -np.sinh(T - t) / np.cosh(T)},
        costates={"x": lambda t: weight * np.sinh(T - t) / np.cosh(T)},
        hamiltonian=constant(weight * 0.5 / np.cosh(T) ** 2),
    )
    assert_matches(solution, truth, 1e-9)
    np.testing.assert_allclose(solution.phase().integral_weights, weight, rtol=1e-9)


@on_linear_meshes
def test_nonlinear_constraint_on_an_integral(mesh: go.Mesh, scheme: str) -> None:
    """The isoperimetric problem with A^2 = 1 instead of A = 1: the multiplier -12 is divided by 2 A."""
    problem, leg = one_phase("squared area", integrator(), initial=0.0, final=1.0)
    leg.initial(x=0.0)
    leg.final(x=0.0)
    leg.guess(x=lambda t: t * (1 - t))
    area = leg.integral(leg.model.symbol("x"), name="area")
    problem.constrain("area", area**2, equals=1.0)
    problem.minimize(running(leg, "energy"))
    solution = solve(problem, mesh, scheme)
    truth = Truth(
        6.0,
        states={"x": lambda t: 6 * t * (1 - t)},
        costates={"x": lambda t: 12 * t - 6},
        hamiltonian=constant(-18.0),
    )
    assert_matches(solution, truth, 1e-8)
    assert solution.multiplier("area") == pytest.approx(-6.0, abs=1e-8)


@on_smooth_meshes
def test_path_equality_of_controls(mesh: go.Mesh, scheme: str) -> None:
    """x' = u + w, u - w = sin t, min 1/2 int u^2 + w^2: multiplier -sin(t) / 2."""
    model, _x, u, w = dynamics("two controls", "x", "u w", lambda x, u, w: {x: u + w})
    problem, leg = one_phase("shared effort", model, initial=0.0, final=1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    leg.path("difference", u - w - ca.sin(model.time), equals=0.0)
    problem.minimize(leg.integral((u**2 + w**2) / 2))
    truth = Truth(
        integrate(lambda t: (1 + np.sin(t) ** 2) / 4, 0, 1),
        states={"x": lambda t: t},
        controls={"u": lambda t: (1 + np.sin(t)) / 2, "w": lambda t: (1 - np.sin(t)) / 2},
        costates={"x": constant(-0.5)},
        hamiltonian=lambda t: (1 + np.sin(t) ** 2) / 4 - 0.5,
        path_multipliers=lambda t: -np.sin(t) / 2,
    )
    assert_matches(solve(problem, mesh, scheme), truth, 1e-9)


@on_smooth_meshes
def test_path_equality_with_a_state(mesh: go.Mesh, scheme: str) -> None:
    """x' = u + w with w = x prescribed by a path constraint: lam' = mu, an unstable regulator, x'' = 2 x."""
    T, root = 1.0, np.sqrt(2.0)
    model, x, u, w = dynamics("two controls", "x", "u w", lambda x, u, w: {x: u + w})
    problem, leg = one_phase("prescribed", model, initial=0.0, final=T)
    leg.initial(x=1.0)
    leg.path("prescribed", w - x, equals=0.0)
    problem.minimize(leg.integral((u**2 + w**2) / 2))
    C, S = np.cosh(root * T), np.sinh(root * T)
    B = (C - root * S) / (root * C - S)

    def state(t):
        return np.cosh(root * t) + B * np.sinh(root * t)

    def costate(t):
        return state(t) - root * (np.sinh(root * t) + B * np.cosh(root * t))

    truth = Truth(
        integrate(lambda t: (state(t) ** 2 + costate(t) ** 2) / 2, 0, T),
        states={"x": state},
        controls={"u": lambda t: -costate(t), "w": state},
        costates={"x": costate},
        hamiltonian=constant((1 + costate(np.zeros(1))[0] * (2 - costate(np.zeros(1))[0])) / 2),
        path_multipliers=lambda t: -state(t) - costate(t),
    )
    assert_matches(solve(problem, mesh, scheme), truth, 1e-9)


@on_smooth_meshes
def test_active_mixed_inequality(mesh: go.Mesh, scheme: str) -> None:
    """max x(1), x' = u <= 1 - x all the way: x = 1 - exp(-t), lam = -exp(t - 1), mu = exp(t - 1)."""
    problem, leg = one_phase("ever slower", integrator(), initial=0.0, final=1.0)
    leg.initial(x=0.0)
    leg.path("limit", leg.model.symbol("u") + leg.model.symbol("x"), upper=1.0)
    problem.maximize(leg.final_state("x"))
    truth = Truth(
        1 - np.exp(-1),
        states={"x": lambda t: 1 - np.exp(-t)},
        controls={"u": lambda t: np.exp(-t)},
        costates={"x": lambda t: -np.exp(t - 1)},
        hamiltonian=constant(-np.exp(-1)),
        path_multipliers=lambda t: np.exp(t - 1),
    )
    assert_matches(solve(problem, mesh, scheme, tolerance=1e-11), truth, 1e-9)
