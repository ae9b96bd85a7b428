"""Observed convergence in degree on one segment, against a closed form."""

from __future__ import annotations

import numpy as np
import pytest
from testing.closed_forms import SCHEMES
from testing.models import dynamics, one_phase

import gnc_opt as go

HORIZON = 2.0


def regulator() -> go.Problem:
    """min 1/2 int x^2 + u^2 over 2 s, x' = u, x(0) = 1: x = cosh(2 - t) / cosh 2, u = x', lam = -u."""
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("scalar regulator", model, initial=0.0, final=HORIZON)
    leg.initial(x=1.0)
    problem.minimize(leg.integral((x**2 + u**2) / 2))
    return problem


def errors(scheme: str, degree: int) -> dict[str, float]:
    """Return the largest errors on one segment relative to the largest exact value."""
    solution = go.solve(
        regulator(),
        mesh=go.Mesh.uniform(1, degree),
        scheme=scheme,
        options=go.SolverOptions(tolerance=1e-11),
        tol=None,
    )
    leg = solution.phase()
    times = np.linspace(0.0, HORIZON, 201)
    state = np.cosh(HORIZON - times) / np.cosh(HORIZON)
    costate = np.sinh(HORIZON - times) / np.cosh(HORIZON)
    wrong_costate = np.abs(leg.costate("x")(times) - costate) / costate[0]
    return {
        "state": float(np.max(np.abs(leg.state("x")(times) - state))),
        "control": float(np.max(np.abs(leg.control("u")(times) + costate)) / costate[0]),
        "costate": float(np.max(wrong_costate)),
        "initial costate": float(wrong_costate[0]),
        "objective": abs(solution.objective / (np.tanh(HORIZON) / 2) - 1),
    }


@pytest.mark.parametrize("scheme", SCHEMES)
def test_errors_fall_faster_than_any_power_of_the_degree(scheme: str) -> None:
    """From 4 to 8 points every error falls by 400 at least; a fixed order p would give 2^p, so p > 8."""
    first, last = errors(scheme, 4), errors(scheme, 8)
    for quantity, error in last.items():
        assert error < max(first[quantity] / 400, 1e-9), (quantity, first[quantity], error)
    assert last["state"] < 2e-7 and last["control"] < 5e-6 and last["costate"] < 3e-8


@pytest.mark.parametrize("scheme", SCHEMES)
def test_initial_costate_converges_twice_as_fast(scheme: str) -> None:
    """lam(t0) is the derivative of the discrete optimal cost: its error is about the square of the others."""
    found = errors(scheme, 5)
    assert found["initial costate"] < 20 * found["control"] ** 2
    assert found["objective"] < 20 * found["control"] ** 2
