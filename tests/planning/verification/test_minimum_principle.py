"""The least Hamiltonian: in closed form for controls that enter it affinely, by a search for the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.second_order import second_order_of

import gnc_opt as go
from gnc_opt.planning.problem.interval import Interval


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
    pinned = go.solve(problem.with_bounds(u=(0.0, 0.0)), mesh="2x3", tol=None)
    box = Interval(-np.ones(n), np.ones(n))
    phases = {"leg": replace(pinned.phase(), control_bounds=box)}
    return replace(pinned, phases=phases, problem=problem)


WEIGHTS = 0.1 * np.array([1.0, -2.0, 3.0, -4.0, 5.0, -6.0, 7.0, -8.0])

GAINS: list[tuple[str, int, Any, Any, float]] = [
    ("eight affine controls", 8, lambda u: 1 + ca.dot(ca.DM(WEIGHTS), u), (), 3.6),
    ("affine and a double well", 2, lambda u: 1 + 0.3 * u[0] + (u[1] ** 2 - 1) ** 2, (), 1.3),
    ("affine, in a path", 1, lambda u: 1 + 0.3 * u[0], ((lambda u: u[0], -0.5),), 0.15),
    ("affine, one in a path", 2, lambda u: 1 + u[0] + 0.3 * u[1], ((lambda u: u[1], -0.5),), 1.15),
    ("a product", 2, lambda u: 1 + u[0] * u[1], (), 1.0),
    ("a kink", 1, lambda u: 1 + ca.fmax(ca.fmin(u[0], 1), -0.5 * u[0]), (), 0.0),
    ("a kink that is no minimum", 1, lambda u: 1 - ca.fabs(u[0]), (), 1.0),
]


@pytest.mark.parametrize(
    ("n", "integrand", "paths", "gain"),
    [case[1:5] for case in GAINS],
    ids=[case[0] for case in GAINS],
)
def test_what_other_controls_gain(n: int, integrand: Any, paths: Any, gain: float) -> None:
    """Over 1 s: wherever controls gain alone or together."""
    condition = go.verify(idle(n, integrand, *paths))["minimum principle"]
    assert condition.loss == pytest.approx(gain, rel=1e-5, abs=1e-12)
    assert condition.result is (go.ConditionResult.FAIL if gain else go.ConditionResult.PASS)


def test_a_step_of_h_is_found_though_no_slope_shows_it() -> None:
    """In 15 % of the range H is less by 0.5."""
    step = idle(1, lambda u: 1 - 0.5 * ca.logic_and(u[0] > 0.6, u[0] < 0.9))
    condition = go.verify(step)["minimum principle"]
    assert condition.result is go.ConditionResult.FAIL and condition.loss is not None
    assert 0.0 < condition.loss <= 0.5


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
    right = go.solve(problem.with_guess(a=-1.2), mesh="2x4", tol=None)
    assert right.objective == pytest.approx(0.2, abs=1e-7)
    assert go.verify(right)["minimum principle"].result is go.ConditionResult.PASS
    other = go.solve(problem.with_guess(a=1.2), mesh="2x4", tol=None)  # 0.8: the far side of the ring
    assert go.verify(other)["minimum principle"].result is go.ConditionResult.FAIL


def test_which_controls_are_separable() -> None:
    """Affine, apart from the others and in no path constraint."""
    solution = idle(
        7,
        lambda u: 2 * u[0] + u[1] * u[2] + ca.fabs(u[3]) + u[4] ** 2 + 3 * u[5] + u[6],
        (lambda u: u[5], -0.5),
    )
    apart = solution.functions("leg").separable_controls
    np.testing.assert_array_equal(apart, [True, False, False, False, False, False, True])
    groups = [group.tolist() for group in solution.functions("leg").coupled_controls]
    assert groups == [[1, 2], [3], [4], [5]]


def test_controls_in_one_path_constraint_are_one_group() -> None:
    solution = idle(4, lambda u: ca.dot(u, u), (lambda u: u[0] + u[3], -0.5), (lambda u: u[3] - u[2], -0.5))
    assert [group.tolist() for group in solution.functions("leg").coupled_controls] == [[0, 2, 3], [1]]


def _well(center: float, width: float, depth: float) -> Callable[[Any], Any]:
    return lambda u: 1 + u[0] ** 2 - depth * ca.exp(-(((u[0] - center) / width) ** 2))


@pytest.mark.parametrize("center", [0.3713, -0.617])
@pytest.mark.parametrize("width", [1e-1, 1e-2, 1e-3, 1e-4])
def test_wells_wider_than_the_resolution_are_found(center: float, width: float) -> None:
    """A well of which 2e-4 of the range is below the flown H, beside one that is as narrow but too shallow."""
    condition = go.verify(idle(1, _well(center, width, 1.0)))["minimum principle"]
    assert condition.result is go.ConditionResult.FAIL
    assert condition.loss == pytest.approx(1 - center**2, rel=1e-2)
    if width < 0.1:  # a wide one pulls at the applied control
        shallow = go.verify(idle(1, _well(center, width, 0.9 * center**2)))["minimum principle"]
        assert shallow.result is go.ConditionResult.PASS


def test_a_well_below_the_resolution_is_missed_and_the_meaning_says_so() -> None:
    condition = go.verify(idle(1, _well(0.3713, 1e-8, 1.0)))["minimum principle"]
    assert condition.result is go.ConditionResult.PASS
    assert "is not excluded" in condition.meaning
    convex = go.verify(idle(1, lambda u: 1 + u[0] ** 2))["minimum principle"]
    assert "is not excluded" not in convex.meaning


@pytest.mark.parametrize("stiffness", [1e2, 1e4, 1e6])
def test_stiffly_coupled_actuators_do_not_hide_another_valley(stiffness: float) -> None:
    """One actuator alone only adds stiffness u^2: it takes both to reach d = u - w = 1.2."""

    def coupled(tilt: float) -> Callable[[Any], Any]:
        def integrand(u: Any) -> Any:
            d = u[0] - u[1]
            return 1 + stiffness * (u[0] + u[1]) ** 2 + d**2 * (d - 1.2) ** 2 + tilt * d**3

        return integrand

    assert go.verify(idle(2, coupled(-0.3)))["minimum principle"].result is go.ConditionResult.FAIL
    assert go.verify(idle(2, coupled(0.3)))["minimum principle"].result is go.ConditionResult.PASS


@pytest.mark.parametrize("stiffness", [1.0, 1e2, 1e4, 1e6])
def test_stiffly_coupled_actuators_do_not_hide_a_slope(stiffness: float) -> None:
    """(u - w - 0.3)^2 gains 0.09 over 1 s."""
    solution = idle(2, lambda u: 1 + stiffness * (u[0] + u[1]) ** 2 + (u[0] - u[1] - 0.3) ** 2)
    condition = go.verify(solution)["minimum principle"]
    assert condition.loss == pytest.approx(0.09, rel=1e-4)
    assert condition.result is go.ConditionResult.FAIL


@pytest.mark.parametrize(("bend", "gain"), [(2.0, 1.0), (0.5, 0.0)])
def test_controls_on_a_curve_are_searched_along_it(bend: float, gain: float) -> None:
    """On w = u^2 no lattice meets the curve; along it H is u^2 - bend u^4."""
    on_curve = ((lambda u: u[1] - u[0] ** 2, 0.0), (lambda u: u[0] ** 2 - u[1], 0.0))
    condition = go.verify(idle(2, lambda u: 1 + u[1] - bend * u[1] ** 2, *on_curve))["minimum principle"]
    assert condition.result is (go.ConditionResult.FAIL if gain else go.ConditionResult.PASS)
    assert (condition.value > 0.1) is bool(gain)


def test_wells_beside_an_affine_control_that_moves_nothing_are_saddles_of_plain_size() -> None:
    """-2 u^2 in half of the range: what is varied by its integral is no steeper than that, and gains what H does."""
    condition = second_order_of(idle(2, GAINS[1][2]))["second order"]
    assert condition.result is go.ConditionResult.FAIL and condition.value < 100.0
