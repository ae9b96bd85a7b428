"""Controls that do nothing, by hand: where a factor of what they do is on a bound that makes it zero."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.internals import phase_functions

import gnc_opt as go
from gnc_opt.arrays import Array, Mask
from gnc_opt.planning.solution.scales import without_effect

N = 8
T, OFF = np.linspace(0.0, 1.0, N), np.arange(N) < 3


def idle(
    rate: Callable[..., Any], u: Array, scale: list[float], *, path: bool = False, lower: float = 0.0
) -> Mask:
    """Of a throttle within [lower, 1], angles within [-9, 9], and what these do to a state or a path constraint."""
    model = go.Model("told")
    controls = [model.control(f"u{i}") for i in range(len(u))]
    x = model.state("x")
    effect = rate(*controls)
    model.ode({x: 0.0 if path else effect})
    problem = go.Problem("told")
    leg = problem.phase("leg", model)
    leg.bounds(u0=(lower, 1.0), **{f"u{i}": (-9.0, 9.0) for i in range(1, len(u))})
    if path:
        leg.path("effect", effect, upper=1.0)
    functions = phase_functions(problem, "leg", np.zeros(0), np.zeros(0), np.zeros(0))
    return without_effect(functions, leg.numbers.controls, T, np.zeros((1, N)), u, np.array(scale))


def flown(*others: float, off: float = 0.0) -> Array:
    return np.array([np.where(OFF, off, 0.8), *(np.full(N, value) for value in others)])


@pytest.mark.parametrize("path", [False, True])
def test_an_angle_is_idle_while_the_engine_is_off(path: bool) -> None:
    found = idle(lambda a, b: a * ca.sin(b), flown(0.3), [1.0, 1.0], path=path)
    np.testing.assert_array_equal(found, [np.zeros(N, dtype=bool), OFF])


@pytest.mark.parametrize(("left", "is_idle"), [(1e-8, True), (1e-4, False)])
def test_what_is_left_of_an_engine_that_is_off_may_be_rounding_of_the_solver(
    left: float, is_idle: bool
) -> None:
    """Relative to what the angle does where the engine burns."""
    found = idle(lambda a, b: 1e5 * a * ca.sin(b), flown(0.3, off=left), [1.0, 1.0], lower=left)
    np.testing.assert_array_equal(found[1], OFF & is_idle)


def test_an_upper_bound_can_switch_off_as_well() -> None:
    found = idle(lambda a, b: (1.0 - a) * ca.sin(b), np.where(flown(0.3) == 0.0, 1.0, flown(0.3)), [1.0, 1.0])
    np.testing.assert_array_equal(found[1], OFF)


def test_an_angle_on_its_bound_is_on_it() -> None:
    u = flown(0.3)
    u[1, 0] = 9.0
    np.testing.assert_array_equal(
        idle(lambda a, b: a * ca.sin(b), u, [1.0, 1.0])[1], OFF & (np.arange(N) > 0)
    )


def test_a_full_turn_or_a_place_of_no_slope_is_not_idle() -> None:
    """One of both steps is a turn; the slope is zero at 90 degrees; the engine is at its least, and on."""
    for turn in (0.37, 0.61):
        found = idle(
            lambda a, b, turn=turn: (1 + a) * ca.sin(2 * np.pi * b / turn), flown(0.25 * turn), [1.0, 1.0]
        )
        assert not np.any(found)


def test_a_factor_that_is_zero_by_chance_is_not_one_on_a_bound() -> None:
    """A product of both angles, one of which is zero between its bounds while the throttle is off."""
    assert not np.any(idle(lambda a, b, c: (1 + a) * b * c, flown(0.0, 0.4), [1.0, 1.0, 1.0]))


def test_a_factor_that_is_zero_beside_a_bound_is_not_one_on_it() -> None:
    assert not np.any(idle(lambda a, b: (a - 1e-4) * ca.sin(b), flown(0.3, off=1e-4), [1.0, 1.0]))


def test_what_others_between_their_bounds_do_is_not_counted_as_done_by_one() -> None:
    """A second angle that acts by itself, and would, if it were moved with the first one."""
    found = idle(lambda a, b, c: a * ca.sin(b) + ca.sin(c) * (2 + a), flown(0.3, 0.4), [1.0, 1.0, 1.0])
    np.testing.assert_array_equal(found, [np.zeros(N, dtype=bool), OFF, np.zeros(N, dtype=bool)])


def test_controls_that_act_by_themselves_are_not_idle() -> None:
    """A sum of both: nothing that one does depends on the other."""
    assert not np.any(idle(lambda a, b: a + b**2 * 1e-9, flown(0.0), [1.0, 1.0]))
