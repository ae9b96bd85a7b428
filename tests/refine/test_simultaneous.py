"""Costates where several controls switch at once: those of the continuous problem, whatever a program returns."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.refine.structure.simultaneous import _backwards, settle_costates
from gnc_opt.solution.polynomial import PiecewisePolynomial

WORTH = np.array([1.0, 2.0, 3.0])
AREA, REST = 0, 1  # rows of the constraints


@cache
def together() -> go.Solution:
    """Three carts from rest to rest, as far as they get in at most 2 s, |a| <= 1; metres are worth 1, 2 and 3.

    Each switches at T/2: lam_q = -w and lam_v = w (t - T/2). The first one is told to stop by the integral of its
    acceleration, the second one by its final speed, the third one by a boundary constraint. One metre costs v at the
    end of it, so T has the multiplier w T/2 of each.
    """
    model = go.Model("carts")
    q, v, a = model.state("q", 3), model.state("v", 3), model.control("a", 3)
    model.ode({q: v, v: a})
    problem = go.Problem("together")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.5, 2.0))
    leg.initial(q=0.0, v=0.0)
    leg.bounds(a=([-1.0] * 3, [1.0] * 3))
    leg.final(v=([-9.0, 0.0, -9.0], [9.0, 0.0, 9.0]))
    problem.constrain("area", leg.integral(a[0]), equals=0.0)
    problem.constrain("rest", leg.final_state("v")[2], equals=0.0)
    end = leg.final_state("q")
    problem.minimize(-sum(WORTH[i] * end[i] for i in range(3)))
    refined = go.refine(go.solve(problem, mesh="6x3", tol=None), structure="bang-bang")
    assert refined.history is not None and refined.history.converged
    return refined


def check(solution: go.Solution) -> None:
    leg = solution.phase()
    t = np.linspace(0.0, 2.0, 9)
    slopes = WORTH[:, None] * (t - 1.0)
    slopes[0] -= 1.0  # what the integral's weight does for the first one: lam_v = 0 at the end
    expected = np.vstack([np.repeat(-WORTH[:, None], 9, axis=1), slopes])
    np.testing.assert_allclose(leg.lam(t), expected, atol=2e-6)
    np.testing.assert_allclose(leg.lam_start, leg.lam(leg.breaks[:-1]), atol=2e-6)
    np.testing.assert_allclose(leg.lam_end, leg.lam(leg.breaks[1:], "left"), atol=2e-6)
    np.testing.assert_allclose(leg.point_costates, leg.lam(leg.point_times), atol=2e-6)
    assert solution.constraint_multipliers == pytest.approx([1.0, 3.0], abs=2e-6)
    assert leg.integral_weights == pytest.approx([1.0], abs=2e-6)
    switching = WORTH[:, None] * (leg.point_times - 1.0)
    np.testing.assert_allclose(leg.control_multipliers, -switching, atol=1e-5)
    assert leg.time_multipliers[1] == pytest.approx(6.0, abs=1e-5)
    # Multipliers of given end values are what the costates are there.
    np.testing.assert_allclose(leg.state_impulses[:, 0], -leg.lam_start[:, 0], atol=1e-5)
    assert leg.state_impulses[4, -1] == pytest.approx(2.0, abs=1e-5)
    np.testing.assert_allclose(leg.state_impulses[[0, 1, 2, 3, 5], -1], 0.0, atol=1e-5)


def drifted(solution: go.Solution, change: np.ndarray) -> go.Solution:
    """What a program may return as well: changes of the three switching functions that add up to zero."""
    leg = solution.phase()
    rows = np.array([0.0, 0.0, 0.0, 0.0, change[1], change[2]])[:, None]
    impulses = leg.state_impulses.copy()
    impulses[:, 0] -= rows[:, 0]
    impulses[4, -1] += change[1]
    other = replace(
        leg,
        lam=PiecewisePolynomial(leg.lam.breaks, leg.lam.nodes, tuple(v + rows for v in leg.lam.values)),
        lam_start=leg.lam_start + rows,
        lam_end=leg.lam_end + rows,
        point_costates=leg.point_costates + rows,
        control_multipliers=leg.control_multipliers - change[:, None],
        integral_weights=leg.integral_weights + change[0],
        state_impulses=impulses,
    )
    nu = solution.constraint_multipliers + change[[0, 2]]
    return replace(solution, phases={"leg": other}, constraint_multipliers=nu)


def test_every_switching_function_vanishes_at_its_switch() -> None:
    assert together().objective == pytest.approx(-6.0, abs=1e-9)
    check(together())


@pytest.mark.parametrize("change", [(0.5, -0.5, 0.0), (0.5, 0.0, -0.5), (-0.25, 1.0, -0.75)])
def test_whatever_the_program_returned(change: tuple[float, ...]) -> None:
    wrong = drifted(together(), np.array(change))
    with pytest.raises(AssertionError):
        check(wrong)
    check(settle_costates(wrong))


def test_switches_one_by_one_are_left_as_they_are() -> None:
    model = go.Model("cart")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    problem = go.Problem("alone")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.5, 9.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    alone = go.refine(go.solve(problem, mesh="5x3", tol=None), structure="bang-bang")
    assert settle_costates(alone) is alone
    regular = go.solve(problem, mesh="5x3", tol=None)  # switches within segments: not bang-bang
    assert settle_costates(regular) is regular


def test_the_adjoint_equation_backwards() -> None:
    """lam_v' = -lam_q, lam_q' = 0, whatever the segments: from (2, 3) at 2 s, lam_v = 3 + 2 (2 - t)."""
    leg = together().phase()
    (s,) = together().samples().values()
    final = np.array([2.0, 0.0, 1.0, 3.0, -1.0, 0.0])
    seen = []
    for k, run in _backwards(leg, replace(s.functions, weights=np.zeros(1)), final):
        seen.append(k)
        t = np.linspace(leg.breaks[k], leg.breaks[k + 1], 5)
        expected = [2 + 0 * t, 0 * t, 1 + 0 * t, 3 + 2 * (2 - t), -1 + 0 * t, 2 - t]
        np.testing.assert_allclose(run(t), expected, atol=1e-9)
    assert seen == list(reversed(range(leg.mesh.segments)))
