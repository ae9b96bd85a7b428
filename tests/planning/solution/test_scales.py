"""Reference magnitudes of states and controls, and controls without effect."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.constructed_solutions import cart, functions, interval, phase
from testing.internals import Interval, compile_phase_functions, compute_control_scales, unbounded_interval
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.array_types import Array, Mask
from gnc_opt.planning.solution.state_and_control_scales import (
    SPAN_MIN_SHARE,
    compute_state_scales,
    mask_inactive_controls,
)

# How far states and controls move on a flight, and what controls could move: closed forms.


CART = cart()
BREAKS = (1.0, 2.0, 3.0, 5.0)  # middles at 1.5, 2.5 and 4


def still(*values: float) -> Any:
    return lambda t, k: [value + 0 * t for value in values]


def built(states: dict[str, int], controls: int, rates: Any) -> go.Problem:
    """A problem whose rates are given by a function of its states and controls."""
    model = go.Model("by hand")
    x = [model.state(name, size) for name, size in states.items()]
    u = [model.control(f"u{i}") for i in range(controls)]
    model.ode(dict(zip(x, rates(*x, *u), strict=True)))
    problem, leg = one_phase("by hand", model, 0.0, 1.0)
    problem.minimize(leg.integral(u[0] ** 2))
    return problem


def found(problem: go.Problem, x: Any, used: Sequence[float], *, u: Any = None, **changes: Any) -> Array:
    lasting = changes.pop("lasting", True)
    push = u or still(*[0.0] * len(used))
    leg = phase(
        problem, x, push, lambda t, k: np.zeros((len(np.ravel(x(np.zeros(1), 0))), t.size)), **changes
    )
    return compute_state_scales(leg, functions(problem, (1.0,)), np.asarray(used), lasting=lasting)


def test_what_moves_spans_how_far_it_gets_from_its_start() -> None:
    """From 3 up by 1 and down by 2 (not 3 from peak to peak), the components of a vector together."""
    problem = built({"r": 2, "s": 1}, 1, lambda r, s, u: [[u, u], u])

    def there_and_back(t: Array, k: int) -> Any:
        return [3 + 4 * t * (1 - t) - 2 * t**4, 7 + 0.5 * t, 100 - 0.25 * t]

    assert found(problem, there_and_back, [1e-9]) == pytest.approx([2.0, 2.0, 0.25])
    assert found(problem, there_and_back, [1e-9], lasting=False) == pytest.approx([7.5, 7.5, 100.0])
    assert found(problem, still(3.0, -4.0, 1e-7), [5.0]) == pytest.approx([4.0, 4.0, 1.0])  # nothing moves


def test_what_is_still_spans_what_controls_could_move() -> None:
    """c' = u, b' = 3 c, a' = 2 b and z' = 5 a over 4 s with a control of 1/2: each link times 4 s and its rate."""
    problem = built(
        {"moves": 1, "z": 1, "a": 1, "b": 1, "c": 1, "never": 1},
        1,
        lambda m, z, a, b, c, n, u: [1 + 0 * m, 5 * a, 2 * b, 3 * c, 7 * c - u, 0 * n],
    )

    def x(t: Array, k: int) -> Any:
        return [t, 0 * t, 0 * t, 0 * t, 0 * t, 8 + 0 * t]

    assert found(problem, x, [0.5], breaks=BREAKS) == pytest.approx(
        [4.0, 3840.0, 192.0, 24.0, 2.0, 8 * SPAN_MIN_SHARE]
    )
    # A control that moves counts by its mean deviation from its mean: 3 of a ramp from 11 to -1.
    ramp = found(problem, x, [12.0], u=lambda t, k: 14 - 3 * t, breaks=BREAKS)
    assert ramp[4] == pytest.approx(4 * 3.0, rel=1e-9)
    idle = found(problem, x, [12e6 / 2], u=lambda t, k: 14 - 3 * t, breaks=BREAKS)
    assert idle[4] == pytest.approx(4 * 6e6)


def test_the_shorter_and_the_longer_way_of_a_control() -> None:
    """b' = 3 c + 0.001 u directly, or twelvefold through c; what has a way of its own is not followed further."""
    problem = built(
        {"m": 1, "a": 1, "b": 1, "c": 1}, 1, lambda m, a, b, c, u: [1 + 0 * m, 2 * b, 3 * c - 1e-3 * u, u]
    )
    spans_ = found(problem, lambda t, k: [t, 0 * t, 0 * t, 0 * t], [0.5], breaks=BREAKS)
    assert spans_ == pytest.approx([4.0, 4 * 2 * 0.002, 24.0, 2.0])


@pytest.mark.parametrize(
    ("boxes", "span"),
    [
        ({}, 1.0),
        ({"state_bounds": (-3.0, 2.0)}, 5.0),
        ({"initial_bounds": (-1.0, 3.0), "final_bounds": (0.0, 7.0)}, 4.0),
        ({"initial_bounds": (0.0, 0.0), "final_bounds": (0.0, 7.0)}, 7.0),
        ({"state_bounds": (0.0, np.inf), "initial_bounds": (0.0, 6.0), "final_bounds": (0.0, 7.0)}, 6.0),
    ],
)
def test_what_nothing_moves_has_the_width_of_its_limits(boxes: dict[str, Any], span: float) -> None:
    problem = built({"m": 1, "x": 1}, 1, lambda m, x, u: [1 + 0 * m, 0 * x])
    limits = {name: interval([0.0, low], [0.0, up]) for name, (low, up) in boxes.items()}
    assert found(problem, lambda t, k: [t, 0 * t], [1.0], **limits)[1] == pytest.approx(span)


def controls(
    flown: Any,
    pull: Any,
    curvature: Any,
    bounds: Interval | None = None,
    rows: int = 1,
    terms: float = 0.0,
    asked: float = 0.0,
) -> Array:
    model = go.Model("controls")
    x = model.state("x")
    u = model.control("u", rows)
    model.ode({x: u if rows == 1 else u[0]})
    problem, leg = one_phase("controls", model, 0.0, 1.0)
    problem.minimize(leg.integral(x**2))
    box = bounds or unbounded_interval(rows)
    here = phase(problem, still(0.0), still(*[0.0] * rows), still(0.0), control_bounds=box)
    given = (np.atleast_2d(np.asarray(v, float)) for v in (flown, pull, curvature))
    return compute_control_scales(here, *given, terms, asked)


@pytest.mark.parametrize(
    ("flown", "pull", "curvature", "bounds", "span"),
    [
        ([-1.0, 4.0, 2.0], 0.0, 0.0, (-np.inf, np.inf), 5.0),  # moved
        ([-1.0, 4.0, 2.0], 0.0, 0.0, (-2.0, 2.0), 4.0),  # at most its range
        ([3.0, 3.0, 3.0], [2.0, -6.0, 1.0], [0.5, 1.5, -3.0], (-np.inf, np.inf), 2.0),  # pulled
        ([3.0, 4.0, 3.0], [2.0, -6.0, 1.0], [0.5, 1.5, -3.0], (-np.inf, np.inf), 2.0),  # farther than moved
        ([3.0, 3.0, 3.0], 0.0, 0.0, (1.0, 8.0), 7.0),  # idle: its range
        ([3.0, 3.0, 3.0 + 1e-4], 0.0, 0.0, (1.0, 8.0), 1e-4),  # not idle
        ([3.0, 3.0, 3.0 + 2e-6], 0.0, 0.0, (1.0, 8.0), 7.0),
        ([3.0, 3.0, 3.0], 0.0, 0.0, (2.9, 3.1), 0.2),  # however narrow that is beside its size
        ([3.0, -3.0, -4.0], 0.0, 0.0, (5.0, 5.0), 7.0),  # a range without width is none
        ([-3.0, -3.0, -3.0], 0.0, 0.0, (-np.inf, np.inf), 3 * SPAN_MIN_SHARE),
        ([0.0, 0.0, 0.0], 0.0, 0.0, (-np.inf, np.inf), 1.0),
        ([0.0, 0.0, 0.0], 0.0, 0.0, (-np.inf, 3.0), 1.0),
    ],
)
def test_how_far_a_control_moves(
    flown: Any, pull: Any, curvature: Any, bounds: tuple[float, float], span: float
) -> None:
    given = (flown, np.broadcast_to(pull, 3), np.broadcast_to(curvature, 3))
    assert controls(*given, interval(*bounds)) == pytest.approx([span], rel=1e-6)


@pytest.mark.parametrize(
    ("size", "bounds", "pull", "span"),
    [
        (1e-12, (-np.inf, np.inf), 0.0, 5.0),  # rounding beside what the flight does by itself
        (1e-12, (-np.inf, np.inf), 1e-3, 5e-4),  # costates move it
        (1e-3, (-np.inf, np.inf), 0.0, 1e-3),  # a little thrust that never changes
        (80.0, (-np.inf, np.inf), 0.0, 5.0),  # counted from far away
        (1e-12, (-3.0, 3.0), 0.0, 6.0),  # its range
    ],
)
def test_a_control_that_nothing_moves_is_measured_by_what_the_flight_does_or_by_itself(
    size: float, bounds: tuple[float, float], pull: float, span: float
) -> None:
    flown, pulls, bends = ([[value] * 2] for value in (size, pull, 2.0))
    found_ = controls(flown, pulls, bends, interval(*bounds), asked=5.0)
    assert found_ == pytest.approx([span], rel=1e-6)


# Controls that do nothing, by hand: where a factor of what they do is on a bound that makes it zero.


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
    functions = compile_phase_functions(problem, "leg", np.zeros(0), np.zeros(0), np.zeros(0))
    return mask_inactive_controls(functions, leg.numbers.controls, T, np.zeros((1, N)), u, np.array(scale))


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


def test_the_length_of_a_direction_is_no_effect() -> None:
    """A direction whose thruster is off acts on its own norm only."""
    model = go.Model("thruster")
    size, direction = model.control("size"), model.control("direction")
    x = model.state("x")
    model.ode({x: size * direction})
    problem = go.Problem("thruster")
    leg = problem.phase("leg", model)
    leg.bounds(size=(0.0, 1.0), direction=(-1.0, 1.0))
    leg.path("norm", direction**2, upper=1.0)
    functions = compile_phase_functions(problem, "leg", np.zeros(0), np.zeros(0), np.zeros(0))
    arguments = functions, leg.numbers.controls, T, np.zeros((1, N)), flown(0.3), np.ones(2)
    assert not np.any(mask_inactive_controls(*arguments))
    np.testing.assert_array_equal(mask_inactive_controls(*arguments, {1: 0})[1], OFF)
