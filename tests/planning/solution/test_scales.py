"""How far states and controls move on a flight, and what controls could move: closed forms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import cart, functions, interval, phase
from testing.internals import Interval, control_spans, free

import gnc_opt as go
from gnc_opt.arrays import Array
from gnc_opt.model import Layout, Variable
from gnc_opt.planning.solution import scales as spans
from gnc_opt.planning.solution.scales import RESOLUTION, STEERED, end_spans, shared, state_spans

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
    problem = go.Problem("by hand")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    problem.minimize(leg.integral(u[0] ** 2))
    return problem


def found(problem: go.Problem, x: Any, used: Sequence[float], *, u: Any = None, **changes: Any) -> Array:
    lasting = changes.pop("lasting", True)
    push = u or still(*[0.0] * len(used))
    leg = phase(
        problem, x, push, lambda t, k: np.zeros((len(np.ravel(x(np.zeros(1), 0))), t.size)), **changes
    )
    return state_spans(leg, functions(problem, (1.0,)), np.asarray(used), lasting=lasting)


# --- states -----------------------------------------------------------------------------------------------


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
        {"moves": 1, "z": 1, "a": 1, "b": 1, "c": 1, "never": 1}, 1,
        lambda m, z, a, b, c, n, u: [1 + 0 * m, 5 * a, 2 * b, 3 * c, 7 * c - u, 0 * n],
    )  # fmt: skip

    def x(t: Array, k: int) -> Any:
        return [t, 0 * t, 0 * t, 0 * t, 0 * t, 8 + 0 * t]

    assert found(problem, x, [0.5], breaks=BREAKS) == pytest.approx(
        [4.0, 3840.0, 192.0, 24.0, 2.0, 8 * RESOLUTION]
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


def test_one_violent_instant_does_not_count() -> None:
    """x' = m^3 u: 3.375, 15.625 and 64 at the middles of the segments, of which the second counts."""
    problem = built({"m": 1, "x": 1, "y": 1}, 1, lambda m, x, y, u: [1 + 0 * m, m**3 * u, m**3 * x])
    spans_ = found(problem, lambda t, k: [t, 0 * t, 0 * t], [0.5], breaks=BREAKS)
    assert spans_ == pytest.approx([4.0, 4 * 15.625 * 0.5, 4 * 15.625 * 31.25])


def test_hardly_moving_is_still() -> None:
    """By 2e-4 or by 5e-5 of the 2 that a control could move it."""
    problem = built({"m": 1, "x": 1}, 1, lambda m, x, u: [1 + 0 * m, u])
    for moved, span in ((4e-4, 4e-4), (1e-4, 2.0)):
        assert found(problem, lambda t, k, d=moved: [t, d * t], [2.0])[1] == pytest.approx(span)


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


# --- ends -------------------------------------------------------------------------------------------------


def ends(moved: Sequence[float], used: float, *, breaks: Any = (0.0, 0.25, 1.0)) -> Array:
    leg = phase(CART, breaks=breaks)
    return end_spans(leg, functions(CART), np.asarray(moved), np.array([used]))


def test_an_end_is_measured_by_what_controls_move_it() -> None:
    """u T^2 / 2 and u T, exact by midpoints; at most the span, at least `STEERED` of it."""
    assert ends([2.0, 3.0], 0.8) == pytest.approx([0.4, 0.8])
    assert ends([2.0, 3.0], 0.8, breaks=(-1.0, 0.0, 0.5, 2.0)) == pytest.approx([2.0, 2.4])
    assert ends([2.0, 3.0], 8.0) == pytest.approx([2.0, 3.0])
    assert ends([2.0, 3.0], 8e-3) == pytest.approx([2 * STEERED, 3 * STEERED])
    assert ends([2e3, 3e3], 8e-3) == pytest.approx([2e3, 3e3])  # as good as out of reach


def test_what_a_push_does_later_is_what_the_dynamics_make_of_it() -> None:
    """An oscillator: |sin| and |cos| of the phase from the middle of each segment to the end."""
    w = 2.0
    problem = built({"q": 1, "v": 1}, 1, lambda q, v, u: [v, u - w**2 * q])
    edges = np.array([0.0, 0.2, 0.6, 1.4, 2.0])
    leg = phase(problem, still(0.0, 0.0), still(0.0), still(0.0, 0.0), breaks=edges)
    to_go, widths = 2.0 - 0.5 * (edges[:-1] + edges[1:]), np.diff(edges)
    reach = [np.sum(np.abs(np.sin(w * to_go)) / w * widths), np.sum(np.abs(np.cos(w * to_go)) * widths)]
    moved, used = np.array([3.0, 5.0]), np.array([0.1])
    assert end_spans(leg, functions(problem, (1.0,)), moved, used) == pytest.approx(0.1 * np.array(reach))


def test_the_dynamics_of_each_segment_in_their_order() -> None:
    """q' = s v and v' = u with s = t: a push at t moves q by (T^2 - t^2) / 2, here s constant along a segment."""
    problem = built({"q": 1, "v": 1, "s": 1}, 1, lambda q, v, s, u: [s * v, u, 1 + 0 * s])
    edges = np.array([1.0, 2.0, 4.0])
    leg = phase(problem, lambda t, k: [0 * t, 0 * t, t], still(0.0), still(0.0, 0.0, 0.0), breaks=edges)
    reached = end_spans(leg, functions(problem, (1.0,)), np.array([100.0, 100.0, 3.0]), np.array([1.0]))
    # From the middle of the first: 0.5 s at 1.5 and 2 s at 3; of the second: 1 s at 3, for 2 s.
    assert reached == pytest.approx([(0.75 + 6.0) * 1 + 3.0 * 2, 3.0, 3.0])


def test_components_of_a_vector_share_their_reach_and_no_number_is_no_reach() -> None:
    problem = built({"r": 2, "n": 1}, 1, lambda r, n, u: [[u, 0 * u], n**0.5 * u])
    leg = phase(problem, still(0.0, 0.0, -1.0), still(0.0), still(0.0, 0.0, 0.0))
    moved = np.array([4.0, 4.0, 1.0])
    assert end_spans(leg, functions(problem, (1.0,)), moved, np.array([0.5])) is moved
    leg = phase(problem, still(0.0, 0.0, 4.0), still(0.0), still(0.0, 0.0, 0.0))
    assert end_spans(leg, functions(problem, (1.0,)), moved, np.array([0.2])) == pytest.approx(
        [0.2, 0.2, 0.4]
    )


# --- controls ---------------------------------------------------------------------------------------------


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
    problem = go.Problem("controls")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    problem.minimize(leg.integral(x**2))
    box = bounds or free(rows)
    here = phase(problem, still(0.0), still(*[0.0] * rows), still(0.0), control_bounds=box)
    given = (np.atleast_2d(np.asarray(v, float)) for v in (flown, pull, curvature))
    return control_spans(here, *given, terms, asked)


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
        ([-3.0, -3.0, -3.0], 0.0, 0.0, (-np.inf, np.inf), 3 * RESOLUTION),
        ([0.0, 0.0, 0.0], 0.0, 0.0, (-np.inf, np.inf), 1.0),
        ([0.0, 0.0, 0.0], 0.0, 0.0, (-np.inf, 3.0), 1.0),
    ],
)
def test_how_far_a_control_moves(
    flown: Any, pull: Any, curvature: Any, bounds: tuple[float, float], span: float
) -> None:
    given = (flown, np.broadcast_to(pull, 3), np.broadcast_to(curvature, 3))
    assert controls(*given, interval(*bounds)) == pytest.approx([span], rel=1e-6)


@pytest.mark.parametrize(("level", "span"), [(0.0, 0.5), (3.0, 0.5), (3e6, 0.3), (1e9, 100.0)])
def test_where_all_controls_are_idle_what_the_costates_add_to_h_counts(level: float, span: float) -> None:
    """A heading along a straight line: H'' = 8 makes 2 of half a radian, whatever it is counted from."""
    for flown in ([level] * 3, [level * (1 + 1e-9), level, level]):
        assert controls(flown, np.zeros(3), 8 * np.ones(3), terms=2.0) == pytest.approx([span], rel=1e-6)
    assert controls([level, level + 20.0, level], np.zeros(3), 8 * np.ones(3), terms=2.0) == pytest.approx(
        [max(20.0, RESOLUTION * level)]
    )


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


def test_what_a_control_would_have_to_be_to_do_what_the_flight_does() -> None:
    """A cart that rolls 6 m in 2 s while its speed falls by 4: a push of 2; the throttle pushes three times as much."""
    problem = built({"q": 1, "v": 1}, 2, lambda q, v, a, throttle: [v, a + 3.0 * throttle])
    leg = phase(problem, lambda t, k: [3 * t, -2 * t], still(0.0, 0.0), still(0.0, 0.0), breaks=(0.0, 2.0))
    assert spans.steering(leg, functions(problem, (1.0,))) == pytest.approx([2.0, 2.0 / 3.0])


def test_components_of_a_control_share_their_span() -> None:
    zero = np.zeros((2, 2))
    assert controls([[0.0, 3.0], [1.0, 2.0]], zero, zero, rows=2) == pytest.approx([3.0, 3.0])


def test_components_share_the_largest_that_is_a_number() -> None:
    layout = Layout("state", (Variable("a", 2), Variable("b"), Variable("c", 2)))
    given = np.array([1.0, 5.0, np.inf, np.nan, 2.0])
    assert shared(given, layout).tolist() == [5.0, 5.0, 0.0, 2.0, 2.0]
    assert np.isnan(given[3])


def test_the_first_positive_of_several() -> None:
    taken = spans._otherwise(np.array([0.0, 2.0, 0.0]), np.array([0.0, 9.0, 4.0]), np.array([7.0, 9.0, 9.0]))
    assert taken.tolist() == [7.0, 2.0, 4.0]
