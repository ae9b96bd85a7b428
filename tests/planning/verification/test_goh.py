"""Second order along singular arcs: conjugate times, ends and alternating controls in closed form.

x' = u, z' = x at the least integral of (x^2 - z^2) / 2: in Goh's variable, x itself, z'' = -z, whose solutions from
z = 0 return there after pi, and come to rest after pi / 2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from testing import constructed_solutions as by_hand

import gnc_opt as go
from gnc_opt.planning.verification.goh import CUTS, SINGULAR_SEGMENT_MIN_POINTS, cut, singular_segments
from gnc_opt.planning.verification.reduced_hessian import _partly_singular

NAME = "second order"


def verdict_at_rest(problem: go.Problem, duration: float, samples: int = 9) -> go.Verdict:
    t = np.linspace(0.0, duration, samples)
    return go.verify_trajectory(problem, t, np.zeros((2, samples)), {"u": 0 * t})


def oscillator(duration: float, **final: float) -> go.Problem:
    """The problem above."""
    model = go.Model("oscillator")
    x, z, u = model.state("x"), model.state("z"), model.control("u")
    model.ode({x: u, z: x})
    problem = go.Problem("oscillator")
    leg = problem.phase("leg", model)
    leg.time(0.0, duration)
    leg.initial(x=0.0, z=0.0)
    leg.final(**final)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(0.5 * (x**2 - z**2)))
    return problem


@pytest.mark.parametrize(
    ("final", "conjugate"), [({"x": 0.0, "z": 0.0}, np.pi), ({"z": 0.0}, np.pi), ({}, 0.5 * np.pi)]
)
@pytest.mark.parametrize("share", [0.99, 1.01])
def test_conjugate_times_of_a_totally_singular_arc(
    final: dict[str, float], conjugate: float, share: float
) -> None:
    """Jumps of x at both ends cost nothing, so that its end values do not matter."""
    verdict = verdict_at_rest(oscillator(share * conjugate, **final), share * conjugate)
    assert verdict[NAME].result is (go.ConditionResult.PASS if share < 1 else go.ConditionResult.FAIL), (
        verdict[NAME]
    )
    assert verdict.minimum is (share < 1)
    # First-order conditions and Kelley's condition hold either way.
    assert all(c.result is go.ConditionResult.PASS for c in verdict.conditions if c.name != NAME)


def test_curvature_does_not_depend_on_the_mesh() -> None:
    base, finer = (verdict_at_rest(oscillator(3.0, z=0.0), 3.0, n)[NAME].value for n in (9, 17))
    assert finer == pytest.approx(base, rel=5e-3)


def arrival(x0: float, duration: float) -> tuple[go.Problem, Any, Any, Any]:
    """x falls from x0 to 0 at the rate 1, and z rises from -x0^2 / 2 to 0: there both stay, on a singular arc.

    Backwards from the arc the costate of x grows by s^2 / 2 + s^4 / 24: u = -1 is right.
    """
    problem = oscillator(duration)
    leg = problem.phases["leg"]
    leg.initial(x=x0, z=-0.5 * x0**2)
    t = np.unique(np.concatenate([np.linspace(0.0, x0, 13), np.linspace(x0, duration, 7)]))
    left = np.maximum(x0 - t, 0.0)
    return problem, t, np.stack([left, -0.5 * left**2]), np.where(t < x0, -1.0, 0.0)


@pytest.mark.parametrize(
    ("length", "result"), [(0.98, go.ConditionResult.PASS), (1.02, go.ConditionResult.FAIL)]
)
def test_a_bang_arc_before_takes_nothing_from_the_focal_time(
    length: float, result: go.ConditionResult
) -> None:
    """Only along the singular arc, whose focal time is pi / 2, may u be varied, and when it begins."""
    problem, t, x, u = arrival(0.8, 0.8 + length * 0.5 * np.pi)
    verdict = go.verify_trajectory(problem, t, x, {"u": u})
    assert verdict[NAME].result is result, verdict.explain()
    assert verdict.minimum is (result is go.ConditionResult.PASS)


@pytest.mark.parametrize(
    ("swing", "result"), [(0.9, go.ConditionResult.PASS), (1.1, go.ConditionResult.FAIL)]
)
def test_controls_that_alternate_from_node_to_node_gain_nothing(
    swing: float, result: go.ConditionResult
) -> None:
    """x^2 / 2 + swing t x u is (1 - swing) x^2 / 2 but for what an end that is given adds.

    The quadrature of t x u would take alternating controls for a gain if all of them were varied.
    """
    model = go.Model("swing")
    x, z, u = model.state("x"), model.state("z"), model.control("u")
    model.ode({x: u, z: 0.1 * x})
    problem = go.Problem("swing")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0, z=0.0)
    leg.final(x=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(0.5 * x**2 + swing * model.time * x * u))
    verdict = verdict_at_rest(problem, 1.0)
    assert verdict[NAME].result is verdict["second order"].result is result
    assert verdict.minimum is (result is go.ConditionResult.PASS)


END_COSTS: list[tuple[str, Callable[[Any, Any, Any], Any], go.ConditionResult]] = [
    ("nothing", lambda leg, x, u: 0.0, go.ConditionResult.PASS),
    (
        "what the control does not move at once",
        lambda leg, x, u: leg.final_state("z") ** 2,
        go.ConditionResult.PASS,
    ),
    ("a square", lambda leg, x, u: leg.final_state("x") ** 2, go.ConditionResult.PASS),
    ("the same as an integral", lambda leg, x, u: leg.integral(2 * x * u), go.ConditionResult.PASS),
    ("a negative square", lambda leg, x, u: -(leg.final_state("x") ** 2), go.ConditionResult.FAIL),
    ("a cube", lambda leg, x, u: -(leg.final_state("x") ** 3), go.ConditionResult.INCONCLUSIVE),
    ("a cube as an integral", lambda leg, x, u: -leg.integral(3 * x**2 * u), go.ConditionResult.INCONCLUSIVE),
]


@pytest.mark.parametrize(("cost", "result"), [pytest.param(c, r, id=name) for name, c, r in END_COSTS])
def test_what_the_end_feels_of_a_last_moment(cost: Any, result: go.ConditionResult) -> None:
    """u = 1 for the last w: x^2 / 2 costs w^3 / 6 and x(1)^3 is w^3: the second variation does not tell of it."""
    model = go.Model("last moment")
    x, z, u = model.state("x"), model.state("z"), model.control("u")
    model.ode({x: u, z: 0.1 * x})
    problem = go.Problem("last moment")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0, z=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(0.5 * x**2, "effort") + cost(leg, x, u))
    verdict = verdict_at_rest(problem, 1.0)
    assert verdict[NAME].result is result, verdict[NAME]
    assert verdict.ok is (result is not go.ConditionResult.FAIL)
    if result is go.ConditionResult.INCONCLUSIVE:
        assert "the end depends on what it moves at once" in verdict[NAME].where


def test_a_segment_is_singular_as_a_whole_or_partly() -> None:
    """x' = u with a cost of x alone: u rises from 0 to its bound in the first segment, and is 0.5 in the second."""
    model = go.Model("one")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("one")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    problem.minimize(leg.integral(x))
    one = lambda t, k: np.array([1.0 + 0 * t])  # noqa: E731
    for first, partly in ((lambda t: np.minimum(2 * t, 1.0), True), (lambda t: 0.2 + 0.5 * t, False)):
        s = by_hand.samples(
            problem, one, lambda t, k, f=first: np.array([f(t) if k == 0 else 0.5 + 0 * t]), one,
            weights=(1.0,), breaks=(0.0, 1.0, 2.0), control_bounds=by_hand.interval(-1.0, 1.0),
        )  # fmt: skip
        np.testing.assert_array_equal(singular_segments(s), [[not partly, True]])
        assert _partly_singular(s) is partly


@pytest.mark.parametrize(("limit", "push", "held"), [(1.0, 0.3, True), (1.0, 0.0, False), (2.0, 0.0, False)])
def test_a_control_that_a_state_limit_determines_is_not_singular(
    limit: float, push: float, held: bool
) -> None:
    """x' = u along x = 1: with a multiplier the limit x <= 1 keeps u at 0, without one H has to."""
    model = go.Model("one")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("one")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    problem.minimize(leg.integral(-push * x))
    s = by_hand.samples(
        problem, lambda t, k: np.array([1.0 + 0 * t]), lambda t, k: np.array([0 * t]), lambda t, k: np.array([0 * t]),
        weights=(1.0,), breaks=(0.0, 1.0, 2.0), control_bounds=by_hand.interval(-1.0, 1.0),
        state_bounds=by_hand.interval(-1.0, limit), states=lambda t, k: np.array([push + 0 * t]),
    )  # fmt: skip
    np.testing.assert_array_equal(singular_segments(s), [[not held, not held]])
    assert not _partly_singular(s)


def test_singular_segments_are_cut_and_movable_boundaries_stay() -> None:
    mesh = go.Mesh((0.0, 0.2, 0.5, 1.0), (3, 8, 4), (1, 2))
    finer = cut(mesh, np.array([False, True, False]))
    first, last = CUTS
    n = len(first + last) + 1
    assert finer.degrees == (3, *[8] * n, 4) and finer.movable == (1, 1 + n)
    np.testing.assert_allclose(finer.breaks[1 : 2 + n], [0.2, *(0.2 + 0.3 * np.array(first + last)), 0.5])
    assert cut(mesh, np.array([True, False, False])).degrees[:n] == (SINGULAR_SEGMENT_MIN_POINTS,) * n
    # an arc of several segments is narrow at its ends, not wherever the mesh has a boundary
    arc = cut(mesh, np.array([False, True, True]))
    np.testing.assert_allclose(
        arc.breaks, [0.0, 0.2, *(0.2 + 0.3 * np.array(first)), 0.5, *(0.5 + 0.5 * np.array(last)), 1.0]
    )
    assert arc.degrees == (3, 8, 8, 8, *[SINGULAR_SEGMENT_MIN_POINTS] * 3) and arc.movable == (1, 4)
    assert cut(mesh, np.zeros(3, dtype=bool)) == mesh


def test_an_end_that_curves_downwards_fails_where_nothing_else_curves() -> None:
    """From rest any way gains x(1)^2, and u^4 takes less of it; H does not curve at zero, and nothing was told."""
    model = go.Model("last moment")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("last moment")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    problem.minimize(leg.integral(u**4) - leg.final_state("x") ** 2)
    t = np.linspace(0.0, 1.0, 9)
    verdict = go.verify_trajectory(problem, t, 0 * t, 0 * t)
    assert verdict[NAME].result is go.ConditionResult.FAIL, verdict[NAME]
