"""Polynomials through samples of known trajectories: values, and the places of jumps and kinks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gnc_opt.planning.optimality.trajectory_fit import (
    FittedPhase,
    Samples,
    _carried,
    _Controls,
    _interpolants,
    _Jump,
    _meeting,
    fit,
)

Array = NDArray[np.float64]


def pushed(t: Array, x: Array, u: Array) -> Array:
    """x' = u, y' = w + t^2."""
    return np.array([u[0], u[1] + t**2]) + 0 * x


def test_runge_kutta_is_exact_for_cubics_in_time() -> None:
    """x' = t^3 from a = (-1, 0.5) to b = (2, 3)."""
    a, b = np.array([-1.0, 0.5]), np.array([2.0, 3.0])
    ends = _carried(np.array([[1.0, 2.0]]), a, b, lambda t, m: np.zeros((1, 2)), lambda t, x, u: t**3 + 0 * x)
    np.testing.assert_allclose(ends, [[1.0, 2.0] + (b**4 - a**4) / 4], rtol=1e-13)


def test_runge_kutta_multiplies_by_the_exponential_series_to_fourth_order() -> None:
    """x' = -2 x + u in four steps over 2 s, u = 3 where the middle of the interval is 1 s."""
    z = -2.0 * 0.5
    factor = (1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24) ** 4
    ends = _carried(
        np.array([[5.0]]),
        np.zeros(1),
        np.full(1, 2.0),
        lambda t, m: 3.0 * m + 0 * t,
        lambda t, x, u: -2 * x + u,
    )
    np.testing.assert_allclose(ends, [[1.5 + 3.5 * factor]], rtol=1e-13)


@pytest.mark.parametrize("n", [2, 3, 4, 7])
def test_interpolants_are_exact_for_polynomials_of_their_degree(n: int) -> None:
    t = np.linspace(1.0, 3.0, n) ** 2
    degree = min(n - 1, 3)
    u = (t - 2.0) ** degree
    smooth, _ = _interpolants(t, u)
    at = np.linspace(1.0, 9.0, 11)
    np.testing.assert_allclose(smooth(at), (at - 2.0) ** degree, atol=1e-9)


def test_where_two_lines_meet() -> None:
    def line(slope: float, zero: float) -> Any:
        return lambda t: slope * (t - zero)

    assert _meeting(line(1.0, 0.0), line(-1.0, 1.0), 0.0, 2.0, 1e-9) == pytest.approx(0.5)
    assert _meeting(line(-1.0, 0.0), line(1.0, 1.0), 0.0, 2.0, 1e-9) == pytest.approx(0.5)
    assert _meeting(line(1.0, 0.0), line(-1.0, 1.0), 0.6, 2.0, 1e-9) is None
    assert _meeting(line(1.0, 0.0), line(1.0, 1.0), 0.0, 2.0, 1e-9) is None
    # Within the slack of an end, at the end.
    assert _meeting(line(1.0, 0.0), line(-1.0, 1.0), 0.49, 2.0, 0.03) == 0.49
    assert _meeting(line(1.0, 0.0), line(-1.0, 1.0), -3.0, 0.51, 0.03) == 0.51
    assert _meeting(line(1.0, 0.0), line(-1.0, 1.0), 0.49, 2.0, 0.01) == pytest.approx(0.5)


# --- the whole --------------------------------------------------------------------------------------------


def flown(t: Array, switches: tuple[float, float] = (0.55, 1.13), levels: Array | None = None) -> Samples:
    """u jumps from 1 to -2, w from 0.5 to 2.5; states from the integrals."""
    (s, r), (a, b, c, d) = switches, (1.0, -2.0, 0.5, 2.5) if levels is None else levels
    u = np.array([np.where(t <= s, a, b), np.where(t <= r, c, d)])
    x = np.array(
        [a * np.minimum(t, s) + b * np.maximum(t - s, 0), c * np.minimum(t, r) + d * np.maximum(t - r, 0)]
    )
    x[1] += t**3 / 3
    return Samples(t, x, u)


def jumps_of(fitted: FittedPhase, t: Array) -> Array:
    """Times of the movable breaks."""
    return t[0] + np.array(fitted.mesh.breaks)[list(fitted.mesh.movable)] * (t[-1] - t[0])


def check(fitted: FittedPhase, switches: tuple[float, float], last: float) -> None:
    """States and controls between the samples are those of `flown`."""
    at = np.linspace(0.0, last, 203)[1:-1]
    exact = flown(at, switches)
    np.testing.assert_allclose(fitted.x(at), exact.x, atol=1e-9)
    np.testing.assert_allclose(fitted.u(at), exact.u, atol=1e-9)


@pytest.mark.parametrize("switches", [(0.55, 1.13), (1.13, 0.55), (0.84, 0.91), (0.91, 0.84), (0.5, 1.13)])
def test_jumps_between_samples(switches: tuple[float, float]) -> None:
    """Apart, both between the same two samples, or at a sample."""
    t = np.linspace(0.0, 2.0, 9)
    fitted = fit(flown(t, switches), pushed)
    np.testing.assert_allclose(jumps_of(fitted, t), sorted(switches), atol=1e-9)
    check(fitted, switches, 2.0)
    breaks = np.union1d(t, switches) / 2
    np.testing.assert_allclose(fitted.mesh.breaks, breaks, atol=1e-9)
    np.testing.assert_allclose(fitted.x.breaks, 2 * breaks, atol=1e-9)
    assert fitted.mesh.degrees == (3,) * (breaks.size - 1)


def test_jump_in_the_first_and_in_the_last_interval() -> None:
    t = np.linspace(0.0, 2.0, 9)
    fitted = fit(flown(t, (0.1, 1.9)), pushed)
    np.testing.assert_allclose(jumps_of(fitted, t), [0.1, 1.9], atol=1e-9)
    check(fitted, (0.1, 1.9), 2.0)


def test_jump_at_a_time_given_twice() -> None:
    """Of both controls; before it the samples are left values."""
    t = np.array([0.0, 0.3, 0.7, 0.7, 1.1, 1.6, 2.0])
    early = np.array([True, True, True, False, False, False, False])
    samples = flown(t, (0.7, 0.7))
    u = np.where(early, [[1.0], [0.5]], [[-2.0], [2.5]])
    fitted = fit(Samples(t, samples.x, u), pushed)
    np.testing.assert_allclose(jumps_of(fitted, t), [0.7])
    assert fitted.mesh.breaks == tuple(np.unique(t) / 2)
    check(fitted, (0.7, 0.7), 2.0)


def test_states_that_jump_keep_both_values() -> None:
    """At a time given twice the left polynomial ends with the first, the right one begins with the second."""
    t = np.array([0.0, 0.5, 1.0, 1.0, 1.5, 2.0])
    x = np.where(np.arange(6) < 3, 0.0, 7.0)[None]
    fitted = fit(Samples(t, x, np.zeros((1, 6))), lambda t, x, u: 0 * x)
    assert fitted.x(1.0, "left")[0] == pytest.approx(0.0) and fitted.x(1.0)[0] == pytest.approx(7.0)


def test_few_samples_and_small_steps_have_no_jumps() -> None:
    """Three samples have nothing to compare with, a step of a thousandth of the range is none, nor a smooth change."""
    t = np.array([0.0, 1.0, 2.0])
    assert fit(flown(t), pushed).mesh.movable == ()
    t = np.linspace(0.0, 2.0, 11)
    small = np.where(t <= 0.5, 0.0, 1e-4) + np.where(t <= 1.5, 0.0, 1.0)
    x = np.array([1e-4 * np.maximum(t - 0.5, 0) + np.maximum(t - 1.5, 0)])
    assert len(fit(Samples(t, x, small[None]), lambda t, x, u: u).mesh.movable) == 1
    steep = 0.125 * np.array([9.0**k for k in range(11)])
    assert fit(Samples(t, x, steep[None]), lambda t, x, u: u).mesh.movable == ()


def test_smooth_trajectory_to_third_order() -> None:
    """u = t^2, x = t^3 / 3: splines and Hermite cubics are exact."""
    t = np.array([0.0, 0.3, 0.7, 1.2, 1.6, 2.0, 2.3, 2.5, 2.9])
    fitted = fit(Samples(t, (t**3 / 3)[None], (t**2)[None]), lambda t, x, u: u + 0 * x)
    at = np.linspace(0.0, 2.9, 51)[1:-1]
    np.testing.assert_allclose(fitted.x(at), [at**3 / 3], atol=1e-12)
    np.testing.assert_allclose(fitted.u(at), [at**2], atol=1e-12)
    assert fitted.mesh.movable == ()


def kinked(t: Array, kinks: tuple[float, float]) -> tuple[Array, Array]:
    """u = |t - s|, w = -2 |t - r|, and their integrals."""
    away = np.array([t - kinks[0], t - kinks[1]])
    weights = np.array([[1.0], [-2.0]])
    return weights * np.abs(away), weights * away * np.abs(away) / 2


@pytest.mark.parametrize("kinks", [(0.93, 2.04), (2.04, 0.93), (1.0, 2.04), (0.93, 2.0)])
def test_kinks_lie_where_both_sides_meet(kinks: tuple[float, float]) -> None:
    """Between samples or at one; they are no jumps, whose times might be varied."""
    t = np.linspace(0.0, 3.0, 31)
    u, x = kinked(t, kinks)
    fitted = fit(Samples(t, x, u), lambda t, x, u: u + 0 * x)
    at = np.linspace(0.0, 3.0, 211)[1:-1]
    u, x = kinked(at, kinks)
    np.testing.assert_allclose(fitted.u(at), u, atol=1e-9)
    np.testing.assert_allclose(fitted.x(at), x, atol=1e-9)
    np.testing.assert_allclose(3 * np.array(fitted.mesh.breaks), np.union1d(t, kinks), atol=1e-9)
    assert fitted.mesh.movable == ()


def test_two_kinks_of_one_control() -> None:
    """The first is found beside a spline that ripples at the second: 0.27 to the power of the samples between."""
    t = np.linspace(0.0, 3.0, 31)
    u, x = (
        np.abs(t - 0.93) - 2 * np.abs(t - 2.04),
        (t - 0.93) * np.abs(t - 0.93) / 2 - (t - 2.04) * np.abs(t - 2.04),
    )
    fitted = fit(Samples(t, x[None], u[None]), lambda t, x, u: u + 0 * x)
    np.testing.assert_allclose(3 * np.array(fitted.mesh.breaks), np.union1d(t, [0.93, 2.04]), atol=1e-5)


def test_kink_after_a_jump_of_the_same_control() -> None:
    """Counted from the jump's own samples; another control has neither."""
    t = np.linspace(0.0, 3.0, 31)
    u = np.where(t <= 0.95, 5.0, np.abs(t - 2.04))
    after = 0.5 * (t - 2.04) * np.abs(t - 2.04) + 0.5 * 1.09**2
    x = np.where(t <= 0.95, 5 * t, 5 * 0.95 + after)
    both = Samples(t, np.array([t**2 / 2, x]), np.array([t, u]))
    fitted = fit(both, lambda t, x, u: u + 0 * x)
    np.testing.assert_allclose(jumps_of(fitted, t), [0.95], atol=1e-7)
    np.testing.assert_allclose(3 * np.array(fitted.mesh.breaks), np.union1d(t, [0.95, 2.04]), atol=1e-7)
    at = np.array([0.97, 1.5, 2.02, 2.05, 2.95])
    np.testing.assert_allclose(fitted.u(at), [at, np.abs(at - 2.04)], atol=1e-6)


def test_the_interpolant_is_the_one_that_carries_the_states() -> None:
    """Beside a kink that is not located, splines ripple; where the control is smooth, they are the closer ones."""
    t = np.array([0.0, 0.4, 0.8, 1.2, 1.6, 2.0, 2.4])
    s = 1.2
    u, x = np.maximum(t - s, 0.0), np.maximum(t - s, 0.0) ** 2 / 2
    samples = Samples(t, np.array([x, t]), u[None])  # time says nothing of either
    controls = _Controls(samples, [])
    controls.choose(samples, lambda t, x, u: np.array([u[0], 1 + 0 * t]))
    at = np.array([0.2, 0.6])
    assert np.max(np.abs(_interpolants(t, u)[0](at))) > 1e-3  # the ripples
    np.testing.assert_allclose(controls(at, at)[0], 0.0, atol=1e-12)
    smooth = Samples(t, np.array([t**4 / 4]), (t**3)[None])
    controls = _Controls(smooth, [])
    controls.choose(smooth, lambda t, x, u: u + 0 * x)
    np.testing.assert_allclose(controls(at, at)[0], at**3, atol=1e-12)


def test_controls_are_those_of_the_piece_in_whose_middle_they_are_asked() -> None:
    t = np.linspace(0.0, 4.0, 9)
    u = np.array([np.where(t <= 1.5, 1.0, 2.0), t])
    controls = _Controls(Samples(t, u, u), [_Jump(3, 1.7, (0,))])
    np.testing.assert_allclose(controls(1.6, 1.6), [[1.0], [1.6]])
    np.testing.assert_allclose(controls(1.6, 1.8), [[2.0], [1.6]])
    np.testing.assert_allclose(controls([1.0, 3.0], [1.6, 1.8]), [[1.0, 2.0], [1.0, 3.0]])
