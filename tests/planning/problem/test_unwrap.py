"""Angles unwound by hand: whole turns change nothing, and what has no period stays as it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.internals import Interval, compile_phase_functions, unbounded_interval, unwrap_angles

import gnc_opt as go
from gnc_opt.array_types import Array

T = np.linspace(0.0, 1.0, 41)


Rates = Callable[..., list[Any]]


def turned(rates: Rates, u: Array, bounds: Interval | None = None) -> Array:
    """Controls (m, N) that act on rates as told, unwound."""
    model = go.Model("told")
    values = rates(*[model.control(f"u{i}") for i in range(len(u))])
    model.ode({model.state(f"x{i}"): value for i, value in enumerate(values)})
    problem = go.Problem("told")
    problem.phase("leg", model)
    functions = compile_phase_functions(problem, "leg", np.zeros(0), np.zeros(0), np.zeros(0))
    x = np.zeros((len(values), u.shape[1]))
    return unwrap_angles(functions, bounds or unbounded_interval(len(u)), T[: u.shape[1]], x, u)


HEADING: dict[float, Rates] = {
    np.pi: lambda a: [ca.sin(2 * a), ca.cos(2 * a)],
    180.0: lambda a: [ca.sin(a * np.pi / 90), ca.cos(a * np.pi / 90)],
    2 * np.pi: lambda a: [ca.sin(a), ca.cos(a)],
    360.0: lambda a: [ca.sin(a * np.pi / 180), ca.cos(a * np.pi / 180)],
}


@pytest.mark.parametrize("period", HEADING)
def test_a_heading_that_jumps_by_turns_runs_on(period: float) -> None:
    """The sense of an axis, or a direction, that turns back by one and a half periods."""
    smooth = period * (0.4 - 1.5 * T)
    jumps = smooth + period * np.random.default_rng(1).integers(-3, 4, T.size)
    found = turned(HEADING[period], jumps[None, :])
    np.testing.assert_allclose(found[0], smooth, atol=1e-12 * period)


@pytest.mark.parametrize("share", [1e-6, 1e-3])
def test_what_only_nearly_repeats_is_no_angle(share: float) -> None:
    """A heading with a spring that pulls it back: a turn is not nothing."""
    jumps = np.where(T < 0.5, 0.0, 2 * np.pi)[None, :]
    np.testing.assert_array_equal(turned(lambda a: [ca.sin(a) + share * a, ca.cos(a)], jumps), jumps)


def test_what_nothing_depends_on_stays() -> None:
    jumps = np.where(T < 0.5, 0.0, 2 * np.pi) * np.ones((2, 1))
    found = turned(lambda a, b: [ca.sin(a), ca.cos(a)], jumps)
    np.testing.assert_allclose(found[0], 0.0, atol=1e-12)
    np.testing.assert_array_equal(found[1], jumps[1])


@pytest.mark.parametrize(
    ("lower", "upper", "start"),
    [(4.0, 24.0, 2 * np.pi), (-24.0, -4.0, -4 * np.pi), (-1.0, 9.0, 0.0), (-9.0, 1.0, -2 * np.pi)],
)
def test_angles_are_as_few_turns_away_as_their_bounds_let_them(
    lower: float, upper: float, start: float
) -> None:
    """Over one turn, which begins at zero or as many turns from it as bounds ask for."""
    smooth = start + 2 * np.pi * T
    jumps = np.where(T < 0.3, smooth, np.where(T < 0.6, smooth + 2 * np.pi, smooth - 2 * np.pi))
    box = Interval(np.array([lower]), np.array([upper]))
    found = turned(HEADING[2 * np.pi], jumps[None, :], box)
    np.testing.assert_allclose(found[0], smooth, atol=1e-12)


def direction(a: Any, e: Any) -> list[Any]:
    return [ca.cos(e) * ca.cos(a), ca.cos(e) * ca.sin(a), ca.sin(e)]


def test_an_azimuth_runs_on_beside_a_bounded_elevation() -> None:
    azimuth, elevation = 3.0 + T, 1.0 - 0.5 * T
    wrapped = np.array([np.remainder(azimuth + np.pi, 2 * np.pi) - np.pi, elevation])
    box = Interval(np.array([-np.inf, -0.6 * np.pi]), np.array([np.inf, 0.6 * np.pi]))
    found = turned(direction, wrapped, box)
    np.testing.assert_allclose(found, [azimuth, elevation], atol=1e-12)
