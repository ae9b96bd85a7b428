"""Linear-quadratic problems whose costates are polynomials, exponentials or sines, against closed forms."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.closed_forms import (
    SCHEMES,
    SMOOTH_MESHES,
    Truth,
    assert_matches,
    constant,
    solve,
)
from testing.models import dynamics, one_phase

import gnc_opt as go

pytestmark = pytest.mark.parametrize("scheme", SCHEMES)
on_smooth_meshes = pytest.mark.parametrize("mesh", SMOOTH_MESHES.values(), ids=SMOOTH_MESHES)


def integrator(initial: object, final: object) -> tuple[go.Problem, go.Phase]:
    model, *_ = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("integrator", model, initial=initial, final=final)
    return problem, leg


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
