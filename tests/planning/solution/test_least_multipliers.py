"""Multipliers of conditions that depend on each other: the least ones, whatever a solver drifted to."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.internals import Attempt

import gnc_opt as go
from gnc_opt.planning.direct.minimum_norm_multipliers import least_multipliers
from gnc_opt.planning.transcription.scheme import GAUSS


def turn(components: int) -> go.Problem:
    """Least w^2 of a unit vector that turns by 1 rad in 1 s; of its end one component is prescribed, or both."""
    model = go.Model("pointer")
    q, w = model.state("q", 2), model.control("w")
    model.ode({q: w * ca.vertcat(-q[1], q[0])})
    problem = go.Problem("turn")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(q=[1.0, 0.0])
    wanted = np.array([np.cos(1.0), np.sin(1.0)])
    problem.constrain("end", leg.final_state("q")[-components:], equals=wanted[-components:])
    leg.guess([0.0, 1.0], q=np.array([[1.0, wanted[0]], [0.0, wanted[1]]]), w=[1.0, 1.0])
    problem.minimize(leg.integral(w**2))
    return problem


def solved(components: int) -> tuple[Any, Any, Any, Any]:
    """Transcription, point, result, and the Jacobian of the rows (dense)."""
    options = go.SolverOptions(tolerance=1e-12)
    attempt = Attempt.prepare(turn(components), {"leg": go.Mesh.uniform(3, 4)}, GAUSS, None, options)
    point = attempt.point(attempt.start)
    result = attempt.solver.solve(point)
    assert result.status.solved
    jacobian = attempt.transcription.nlp.jac_g(result.x, point.p)[1].full()
    return attempt.transcription, point, result, jacobian


@pytest.mark.parametrize("drift", [6e2, 1e4, -1e8])
def test_what_is_not_determined_is_as_small_as_can_be(drift: float) -> None:
    transcription, point, result, jacobian = solved(2)
    fixed = point.lbx == point.ubx
    null = np.linalg.svd(jacobian[:, ~fixed].T)[2][-1]  # |q| = 1 is kept by itself
    np.testing.assert_allclose(jacobian[:, ~fixed].T @ null, 0.0, atol=1e-12)
    lam_x = result.lam_x - drift * np.where(fixed, jacobian.T @ null, 0.0)
    found = least_multipliers(
        transcription, point, replace(result, lam_g=result.lam_g + drift * null, lam_x=lam_x)
    )
    least = result.lam_g - null * (null @ result.lam_g)
    np.testing.assert_allclose(found.lam_g, least, atol=1e-14 * abs(drift) + 1e-10)
    stationary = (
        transcription.nlp.grad_f(result.x, point.p)[1].full()[:, 0] + jacobian.T @ found.lam_g + found.lam_x
    )
    np.testing.assert_allclose(stationary, 0.0, atol=1e-14 * abs(drift) + 1e-9)


def test_large_multipliers_that_are_determined_stay() -> None:
    transcription, point, result, _ = solved(1)
    large = replace(result, lam_g=1e6 * result.lam_g, lam_x=1e6 * result.lam_x)
    assert least_multipliers(transcription, point, large) is large


def test_small_ones_are_left_alone() -> None:
    transcription, point, result, _ = solved(2)
    assert np.max(np.abs(result.lam_g)) < 1e2
    assert least_multipliers(transcription, point, result) is result
