"""The least Hamiltonian: in closed form for controls that enter it affinely, on a grid for the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.problem.interval import Interval


def idle(n: int, integrand: Callable[[Any], Any], *paths: tuple[Callable[[Any], Any], float]) -> go.Solution:
    """All of n controls are zero where |u| <= 1 and the integrand alone decides: H is the integrand."""
    model = go.Model("still")
    x, u = model.state("x"), model.control("u", n)
    model.ode({x: 0 * u[0]})
    problem = go.Problem("idle")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=([-1.0] * n, [1.0] * n))
    for k, (path, lower) in enumerate(paths):
        leg.path(f"gate {k}", path(u), lower=lower)
    problem.minimize(leg.integral(integrand(u)))
    pinned = go.solve(problem.with_bounds(u=(0.0, 0.0)), mesh="2x3")
    box = Interval(-np.ones(n), np.ones(n))
    phases = {"leg": replace(pinned.phase(), control_bounds=box)}
    return replace(pinned, phases=phases, problem=problem)


WEIGHTS = 0.1 * np.array([1.0, -2.0, 3.0, -4.0, 5.0, -6.0, 7.0, -8.0])

GAINS = [
    ("eight affine controls", 8, lambda u: 1 + ca.dot(ca.DM(WEIGHTS), u), (), 3.6, 3.6),
    ("affine and a double well", 2, lambda u: 1 + 0.3 * u[0] + (u[1] ** 2 - 1) ** 2, (), 1.3, 2.3),
    ("affine, in a path", 1, lambda u: 1 + 0.3 * u[0], ((lambda u: u[0], -0.5),), 0.15, 0.3),
    ("affine, one in a path", 2, lambda u: 1 + u[0] + 0.3 * u[1], ((lambda u: u[1], -0.5),), 1.15, 1.3),
    ("a product", 2, lambda u: 1 + u[0] * u[1], (), 1.0, 1.0),
    ("a kink", 1, lambda u: 1 + ca.fabs(u[0]), (), 0.0, 1.0),
    ("a kink that is no minimum", 1, lambda u: 1 - ca.fabs(u[0]), (), 1.0, 0.0),
    ("a step", 1, lambda u: 1 - 0.5 * ca.logic_and(u[0] > 0.6, u[0] < 0.9), (), 0.5, 0.0),
]


@pytest.mark.parametrize(
    ("n", "integrand", "paths", "gain", "worth"),
    [case[1:] for case in GAINS],
    ids=[case[0] for case in GAINS],
)
def test_what_other_controls_gain(n: int, integrand: Any, paths: Any, gain: float, worth: float) -> None:
    """Beside what half the range is worth by H's slope, or curvature: wherever controls gain alone or together."""
    condition = go.verify(idle(n, integrand, *paths))["minimum principle"]
    assert condition.value == pytest.approx(gain / (worth + gain), rel=1e-5, abs=1e-12)
    assert condition.result is (go.Result.FAIL if gain else go.Result.PASS)


def test_controls_that_a_limit_forbids_are_no_choice_where_its_gradient_vanishes() -> None:
    """|a| >= 1 written as a^2 >= 1: a = 0 would cost less, and is as forbidden as any a in between."""
    model = go.Model("integrator")
    q, a = model.state("q"), model.control("a")
    model.ode({q: a})
    problem = go.Problem("annulus")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(q=0.0)
    leg.bounds(a=(-3.0, 3.0))
    leg.path("annulus", a**2, lower=1.0)
    problem.minimize(0.5 * leg.integral(a**2) + 0.3 * leg.final_state("q"))
    right = go.solve(problem.with_guess(a=-1.2), mesh="2x4")
    assert right.objective == pytest.approx(0.2, abs=1e-7)
    assert go.verify(right)["minimum principle"].result is go.Result.PASS
    other = go.solve(problem.with_guess(a=1.2), mesh="2x4")  # 0.8: the far side of the ring
    assert go.verify(other)["minimum principle"].result is go.Result.FAIL


def test_which_controls_are_separable() -> None:
    """Affine, apart from the others and in no path constraint."""
    solution = idle(
        7,
        lambda u: 2 * u[0] + u[1] * u[2] + ca.fabs(u[3]) + u[4] ** 2 + 3 * u[5] + u[6],
        (lambda u: u[5], -0.5),
    )
    apart = solution.functions("leg").separable_controls
    np.testing.assert_array_equal(apart, [True, False, False, False, False, False, True])
