"""Costates along arcs of state constraints: the points' polynomials are kept, what rows lay elsewhere is not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import functions, phase
from testing.internals import Held

import gnc_opt as go
from gnc_opt.arrays import Array
from gnc_opt.planning import ArcKind
from gnc_opt.planning.solution.costates import settle_held_paths

LOW, FREE, UP, LEFT = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.RELEASED


def plane() -> go.Problem:
    """q' = v, v' = a; paths on v + a, on q v, whose gradient turns along the flight, and on q."""
    model = go.Model("plane")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    problem = go.Problem("plane")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    for label, value in (("mixed", v + a), ("product", q * v), ("height", q)):
        leg.path(label, value, upper=9.0)
    problem.minimize(leg.integral(a**2))
    return problem


PLANE = plane()
FUNCTIONS = functions(PLANE, (1.0,))


def states(t: Array, k: int) -> Any:
    return [1 + t + 10 * k, 2 - t + 0 * k]


def costates(t: Array, k: int) -> Any:
    return [t**2 + k, t**3 - k]


def leg(**changes: Any) -> go.PhaseSolution:
    """Three segments, their costates' ends off by 5 and 7."""
    here = phase(
        PLANE, states, lambda t, k: 0 * t, costates, breaks=(0.0, 0.25, 0.5, 1.0),
        paths=lambda t, k: [3 + 0 * t, 4 + 0 * t, 5 + 0 * t],
    )  # fmt: skip
    off = np.array([[5.0], [7.0]])
    values: dict[str, Any] = {"lam_start": here.lam_start + off, "lam_end": here.lam_end - off}
    return phase(
        PLANE, states, lambda t, k: 0 * t, costates, breaks=(0.0, 0.25, 0.5, 1.0),
        paths=lambda t, k: [3 + 0 * t, 4 + 0 * t, 5 + 0 * t], **(values | changes),
    )  # fmt: skip


def held(*rows: tuple[ArcKind, ...]) -> Held:
    return Held(((FREE,) * 3,), paths=rows)


def test_the_ends_continue_the_points_along_the_gradient_of_what_is_held() -> None:
    """q v is held along the second segment: its gradient is (v, q), from within the segment."""
    before = leg()
    after = settle_held_paths(before, held((FREE,) * 3, (FREE, UP, FREE), (FREE,) * 3), FUNCTIONS)
    for ends, old, time, off in (
        ("lam_start", before.lam_start, 0.25, 1),
        ("lam_end", before.lam_end, 0.5, -1),
    ):
        q, v = states(np.array(time), 1)
        gradient, missing = np.array([v, q]), -off * np.array([5.0, 7.0])
        expected = old.copy()
        expected[:, 1] += gradient * (gradient @ missing) / (gradient @ gradient)
        assert getattr(after, ends) == pytest.approx(expected)
    last = after.lam.values[1][:, -1]
    assert last == pytest.approx(after.lam_end[:, 1]) and not np.allclose(last, before.lam.values[1][:, -1])
    for k in (0, 2):
        assert np.array_equal(after.lam.values[k], before.lam.values[k])
    assert np.array_equal(after.lam.values[1][:, :-1], before.lam.values[1][:, :-1])


def test_two_that_are_held_explain_all_that_is_missing() -> None:
    before = leg()
    after = settle_held_paths(before, held((FREE,) * 3, (FREE, FREE, LOW), (FREE, FREE, UP)), FUNCTIONS)
    exact = [np.ravel(costates(np.array(t), 2)) for t in (0.5, 1.0)]
    assert after.lam_start[:, 2] == pytest.approx(exact[0]) and after.lam_end[:, 2] == pytest.approx(exact[1])
    assert np.array_equal(after.lam_start[:, :2], before.lam_start[:, :2])


def test_the_density_is_what_the_adjoint_equation_leaves() -> None:
    """lam_q' = -(mu_q + v mu_qv): with lam_q = t^2 and mu_qv = 4 then mu_q = -2 t - 4 (2 - t), where q is held."""
    before = leg(lam_end=leg().lam_end + np.array([[5.0], [7.0]]))  # ends that are right
    after = settle_held_paths(before, held((UP,) * 3, (FREE,) * 3, (LOW, LEFT, UP)), FUNCTIONS)
    t = before.point_times
    expected = np.where((t > 0.25) & (t < 0.5), 5.0, -2 * t - 4 * (2 - t))
    assert after.path_multipliers[2] == pytest.approx(expected, abs=1e-9)
    assert np.array_equal(after.path_multipliers[:2], before.path_multipliers[:2])


def test_what_is_not_held_is_left_alone() -> None:
    before = leg()
    nothing = (FREE, LEFT, FREE)
    for kinds in (
        None,
        Held(((FREE,) * 3,)),
        held(nothing, nothing, nothing),
        held((UP,) * 3, nothing, nothing),
    ):
        assert settle_held_paths(before, kinds, FUNCTIONS) is before  # mixed ones are the controls' business
    radau = phase(PLANE, states, lambda t, k: 0 * t, costates, breaks=(0.0, 0.25, 0.5, 1.0), scheme="LGR")
    assert settle_held_paths(radau, held(nothing, (UP,) * 3, nothing), FUNCTIONS) is radau
