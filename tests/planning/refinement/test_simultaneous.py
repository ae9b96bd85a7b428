"""Costates where several controls switch at once: those of the continuous problem, whatever a program returns."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.constructed_solutions import interval, phase, solution
from testing.internals import PiecewisePolynomial

import gnc_opt as go
from gnc_opt.arrays import Array
from gnc_opt.planning.refinement.switching.costates import _backwards, settle_costates

WORTH = np.array([1.0, 2.0, 3.0])


def carts(braking: float) -> go.Problem:
    """Three carts from rest to rest, as far as they get in at most 2 s, |a| <= 1; metres are worth 1, 2 and 3.

    The first one is told to stop by the integral of its acceleration, the second one by its final speed, the third one
    by a boundary constraint, which lets it go on by so many m/s for every second less, in a wind as strong that turns
    after 1 s.
    """
    model = go.Model("carts")
    q, v, a = model.state("q", 3), model.state("v", 3), model.control("a", 3)
    model.ode({q: v, v: a + ca.vertcat(0.0, 0.0, braking * (model.time - 1.0))})
    problem = go.Problem("together")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.5, 2.0))
    leg.initial(q=0.0, v=0.0)
    leg.bounds(a=([-1.0] * 3, [1.0] * 3))
    leg.final(v=([-9.0, 0.0, -9.0], [9.0, 0.0, 9.0]))
    problem.constrain("area", leg.integral(a[0]), equals=0.0)
    problem.constrain("rest", leg.final_state("v")[2] + braking * (leg.final_time - 2.0), equals=0.0)
    end = leg.final_state("q")
    problem.minimize(-sum(WORTH[i] * end[i] for i in range(3)))
    return problem


CARTS, BRAKED = carts(0.0), carts(0.5)


def together(push: float = 1.0, braking: float = 0.0) -> go.Solution:
    """The optimum: each switches at T/2, lam_q = -w and lam_v = w (t - T/2), but -w where the integral has the rest.

    One second more is worth w T/2 of each, less what the third one has to brake more, by itself and against the wind. A
    push of less than 1 is between the limits.
    """
    problem = BRAKED if braking else CARTS

    def x(t: Array, k: int) -> Any:
        q, v = (t - 1 + 0.5 - (t - 1) ** 2 / 2, 2 - t) if k else (t**2 / 2, t)
        return [q, q, q + braking * (t**3 / 6 - t**2 / 2), v, v, v + braking * (t**2 / 2 - t)]

    def lam(t: Array, k: int) -> Any:
        return [*(-w + 0 * t for w in WORTH), t - 2, 2 * (t - 1), 3 * (t - 1)]

    box = problem.get_phase().numbers
    given: dict[str, Any] = {"initial_bounds": box.initial, "final_bounds": box.final}
    bare = phase(
        problem, x, lambda t, k: [push * (1 - 2 * k) + 0 * t] * 3, lam, breaks=(0.0, 1.0, 2.0), degree=3
    )
    impulses = np.zeros((6, 3))
    impulses[:, 0], impulses[4, 2] = -bare.lam_start[:, 0], 2.0
    leg = replace(
        bare, **given, mesh=go.Mesh((0.0, 0.5, 1.0), (3, 3), (1,)), control_bounds=box.controls,
        final_time_bounds=interval(0.5, 2.0), control_multipliers=-WORTH[:, None] * (bare.point_times - 1),
        state_impulses=impulses, time_multipliers=np.array([0.0, 6.0 - 6.0 * braking]), integral_weights=np.ones(1),
    )  # fmt: skip
    return solution(
        problem, leg, objective=-6.0, constraint_labels=("area", "rest"), constraint_values=np.zeros(2),
        constraint_multipliers=np.array([1.0, 3.0]),
    )  # fmt: skip


def check(found: go.Solution, braking: float = 0.0) -> None:
    leg = found.phase()
    t = np.linspace(0.0, 2.0, 9)
    slopes = WORTH[:, None] * (t - 1.0)
    slopes[0] -= 1.0  # what the integral's weight does for the first one: lam_v = 0 at the end
    expected = np.vstack([np.repeat(-WORTH[:, None], 9, axis=1), slopes])
    np.testing.assert_allclose(leg.lam(t), expected, atol=2e-6)
    np.testing.assert_allclose(leg.lam_start, leg.lam(leg.breaks[:-1]), atol=2e-6)
    np.testing.assert_allclose(leg.lam_end, leg.lam(leg.breaks[1:], "left"), atol=2e-6)
    np.testing.assert_allclose(leg.point_costates, leg.lam(leg.point_times), atol=2e-6)
    assert found.constraint_multipliers == pytest.approx([1.0, 3.0], abs=2e-6)
    assert leg.integral_weights == pytest.approx([1.0], abs=2e-6)
    switching = WORTH[:, None] * (leg.point_times - 1.0)
    np.testing.assert_allclose(leg.control_multipliers, -switching, atol=1e-5)
    assert leg.time_multipliers[1] == pytest.approx(6.0 - 6.0 * braking, abs=1e-5)
    # Multipliers of given end values are what the costates are there.
    np.testing.assert_allclose(leg.state_impulses[:, 0], -leg.lam_start[:, 0], atol=1e-5)
    assert leg.state_impulses[4, -1] == pytest.approx(2.0, abs=1e-5)
    np.testing.assert_allclose(leg.state_impulses[[0, 1, 2, 3, 5], -1], 0.0, atol=1e-5)


def drifted(found: go.Solution, change: np.ndarray, braking: float = 0.0) -> go.Solution:
    """What a program may return as well: changes of the three switching functions that add up to zero."""
    leg = found.phase()
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
        time_multipliers=leg.time_multipliers - np.array([0.0, 2.0 * braking * change[2]]),
    )
    nu = found.constraint_multipliers + change[[0, 2]]
    return replace(found, phases={"leg": other}, constraint_multipliers=nu)


def test_costates_that_are_right_stay_so() -> None:
    check(together())
    check(settle_costates(together()))


@pytest.mark.parametrize("change", [(0.5, -0.5, 0.0), (0.5, 0.0, -0.5), (-0.25, 1.0, -0.75)])
@pytest.mark.parametrize("braking", [0.0, 0.5])
def test_whatever_the_program_returned(change: tuple[float, ...], braking: float) -> None:
    wrong = drifted(together(braking=braking), np.array(change), braking)
    with pytest.raises(AssertionError):
        check(wrong, braking)
    check(settle_costates(wrong), braking)


def test_what_has_no_simultaneous_switches_is_left_as_it_is() -> None:
    between = together(push=0.5)  # not bang-bang
    assert settle_costates(between) is between
    model = go.Model("cart")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    problem = go.Problem("alone")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(-leg.final_state("q"))
    one = phase(
        problem, lambda t, k: [t - 1 + 0.5 - (t - 1) ** 2 / 2, 2 - t] if k else [t**2 / 2, t],
        lambda t, k: 1 - 2 * k + 0 * t, lambda t, k: [-1 + 0 * t, t - 1], breaks=(0.0, 1.0, 2.0), degree=3,
        control_bounds=interval(-1.0, 1.0), initial_bounds=interval([0, 0], [0, 0]),
        final_bounds=interval([-np.inf, 0], [np.inf, 0]),
    )  # fmt: skip
    alone = solution(problem, one, objective=-1.0)
    assert settle_costates(alone) is alone


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
