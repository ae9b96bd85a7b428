"""Piecewise polynomials against numpy's Legendre series and against plain calculus."""

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import legendre
from testing.internals import get_collocation_rule

from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.planning.solution.piecewise_polynomial import (
    CACHED_TIMES,
    PiecewisePolynomial,
    subdivide_intervals,
)

BREAKS = np.array([1.0, 2.0, 4.5])


def two_segments() -> PiecewisePolynomial:
    """Row 0: t³; row 1: t in the first segment and -t in the second, so it jumps at t = 2."""
    nodes = (get_collocation_rule("LG", 3).state_nodes, get_collocation_rule("LGL", 5).points)
    times = [times_of(x, k) for k, x in enumerate(nodes)]
    values = tuple(np.array([t**3, sign * t]) for t, sign in zip(times, (1, -1), strict=True))
    return PiecewisePolynomial(BREAKS, nodes, values)


def times_of(nodes: Array, k: int) -> Array:
    return np.asarray(BREAKS[k] + (nodes + 1) / 2 * (BREAKS[k + 1] - BREAKS[k]))


def random_pieces(seed: int) -> tuple[PiecewisePolynomial, list[Array]]:
    """Values at the nodes of each segment, and the same as Legendre series, shape (degree + 1, 2)."""
    rng = np.random.default_rng(seed)
    breaks = rng.uniform(-100, 100) + np.cumsum(rng.uniform(0.1, 10, rng.integers(2, 6)))
    degrees = rng.integers(1, 12, breaks.size - 1)
    nodes = [get_collocation_rule("LG", int(n)).state_nodes for n in degrees]
    series = [rng.uniform(-1, 1, (x.size, 2)) for x in nodes]
    values = tuple(
        np.array(legendre.legval(x, c), dtype=np.float64) for x, c in zip(nodes, series, strict=True)
    )
    return PiecewisePolynomial(breaks, tuple(nodes), values), series


def test_values_inside_and_at_the_ends() -> None:
    curve = two_segments()
    t = np.linspace(1.0, 4.5, 101)
    np.testing.assert_allclose(curve(t), [t**3, np.where(t < 2, t, -t)], rtol=1e-14)
    assert curve(t).shape == (2, 101)
    assert curve([]).shape == (2, 0)
    assert curve([3.0]).shape == (2, 1)
    assert curve(3.0).shape == curve(np.array(3.0)).shape == (2,)
    np.testing.assert_allclose(curve(1), [1.0, 1.0])
    np.testing.assert_allclose(curve(4.5), [91.125, -4.5])


def test_values_do_not_depend_on_the_order_of_times() -> None:
    t = np.array([4.0, 1.0, 3.0, 1.5, 2.0])
    np.testing.assert_array_equal(two_segments()(t), two_segments()(np.sort(t))[:, np.argsort(np.argsort(t))])


def test_signals_on_the_same_grid_have_their_own_values_times_and_sides() -> None:
    """The bases are remembered: no other signal, side or times in the same array may meet them."""
    curve, grid = two_segments(), two_segments()
    other = PiecewisePolynomial(BREAKS, grid.nodes, tuple(2.0 * v for v in grid.values))
    t = np.linspace(1.0, 4.0, 7)
    for side in ("right", "left", "right"):
        expected = [t**3, np.where((t < 2) | ((t == 2) & (side == "left")), t, -t)]
        np.testing.assert_allclose(curve(t, side), expected, rtol=1e-14)
        np.testing.assert_allclose(other(t, side), 2.0 * np.array(expected), rtol=1e-14)
    t += 0.25
    np.testing.assert_allclose(curve(t)[0], t**3, rtol=1e-14)
    shifted = PiecewisePolynomial(BREAKS + 1.0, grid.nodes, grid.values)
    np.testing.assert_allclose(shifted(t + 1.0)[0], t**3, rtol=1e-13)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(curve))(t), curve(t))
    np.testing.assert_array_equal(copy.deepcopy(curve)(t), curve(t))
    many = np.linspace(1.0, 4.5, CACHED_TIMES + 2)
    np.testing.assert_array_equal(curve(many)[:, 1:9], curve(many[1:9]))


def test_segments_with_the_same_nodes_are_distinguished() -> None:
    """Every other segment shares its nodes; each has the power of t that is its number."""
    breaks = np.array([0.0, 1.0, 1.5, 3.0, 3.25])
    nodes = tuple(get_collocation_rule("LG", n).state_nodes for n in (3, 5, 3, 5))
    times = [breaks[k] + (x + 1) / 2 * (breaks[k + 1] - breaks[k]) for k, x in enumerate(nodes)]
    curve = PiecewisePolynomial(breaks, nodes, tuple(t[None, :] ** k for k, t in enumerate(times)))
    t = np.array([3.1, 0.2, 2.9, 1.2, 0.9, 3.2, 1.6])
    np.testing.assert_allclose(curve(t)[0], t ** np.array([3, 0, 2, 1, 0, 3, 2]), rtol=1e-14)


def test_the_side_decides_at_a_break() -> None:
    curve = two_segments()
    assert curve(2.0)[1] == pytest.approx(-2.0)
    assert curve(2.0, side="left")[1] == pytest.approx(2.0)
    for side in ("left", "right"):
        assert curve(np.array([1.0, 4.5]), side)[1] == pytest.approx([1.0, -4.5])
    with pytest.raises(ValueError, match="'left' or 'right'"):
        curve(2.0, side="middle")  # type: ignore[arg-type]


def test_nodes_are_returned_exactly() -> None:
    curve = PiecewisePolynomial([0.0, 2.0], ([-1.0, 0.0, 1.0],), ([[0.1, 0.7, 0.3]],))  # type: ignore[arg-type]
    np.testing.assert_array_equal(curve([0.0, 1.0, 2.0]), [[0.1, 0.7, 0.3]])


def test_rounding_beyond_the_ends_is_clamped() -> None:
    curve = two_segments()
    np.testing.assert_array_equal(curve([1.0 - 1e-13, 4.5 + 1e-12]), curve([1.0, 4.5]))


@pytest.mark.parametrize("t", [0.999999, 4.50001, np.nan, np.inf, -np.inf, [2.0, np.nan], [3.0, 7.0]])
def test_times_outside_are_refused(t: Any) -> None:
    named = str(np.atleast_1d(t)[-1])
    with pytest.raises(ValueError, match=rf"time {named} is outside the span 1.0 to 4.5 "):
        two_segments()(t)


def test_a_table_of_times_is_refused() -> None:
    with pytest.raises(ValueError, match="scalar or a vector"):
        two_segments()(np.ones((2, 2)))


def test_derivative_is_exact() -> None:
    t = np.linspace(1.0, 4.5, 51)
    slope = two_segments().derivative()
    np.testing.assert_allclose(slope(t), [3 * t**2, np.where(t < 2, 1.0, -1.0)], rtol=1e-12)
    np.testing.assert_allclose(slope.derivative()(t)[0], 6 * t, rtol=1e-11)


def test_constants_from_a_single_node() -> None:
    steps = PiecewisePolynomial([0.0, 1.0, 3.0], ([0.0], [0.5]), ([[2.0]], [[-1.0]]))  # type: ignore[arg-type]
    np.testing.assert_array_equal(steps([0.0, 0.9, 1.0, 3.0]), [[2.0, 2.0, -1.0, -1.0]])
    np.testing.assert_array_equal(steps.derivative()([0.0, 2.0]), [[0.0, 0.0]])


def test_parts_of_intervals_cover_the_span_once() -> None:
    np.testing.assert_allclose(subdivide_intervals(BREAKS, 2), [1.0, 1.5, 2.0, 3.25, 4.5])
    np.testing.assert_array_equal(subdivide_intervals(BREAKS, 1), BREAKS)
    dense = subdivide_intervals(BREAKS, 37)
    assert np.all(np.diff(dense) > 0) and np.isin(BREAKS, dense).all()


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_random_pieces_match_their_series(seed: int) -> None:
    curve, series = random_pieces(seed)
    rates = 2 / np.diff(curve.breaks)
    slope = curve.derivative()
    for k, c in enumerate(series):
        tau = np.linspace(-0.99, 0.99, 7)
        t = curve.breaks[k] + (tau + 1) / rates[k]
        np.testing.assert_allclose(curve(t), legendre.legval(tau, c), rtol=0, atol=1e-10)
        np.testing.assert_allclose(
            slope(t), rates[k] * legendre.legval(tau, legendre.legder(c)), rtol=0, atol=1e-7
        )


def test_the_arrays_are_copies_and_read_only() -> None:
    breaks, nodes, values = np.array([0.0, 1.0]), np.array([-1.0, 1.0]), np.array([[0.0, 1.0]])
    curve = PiecewisePolynomial(breaks, (nodes,), (values,))
    values[0, 0] = 9.0
    assert curve(0.0)[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        curve.values[0][0, 0] = 1.0


@pytest.mark.parametrize(
    ("breaks", "nodes", "values", "message"),
    [
        ([0.0], [], [], "breaks"),
        ([0.0, 0.0], [[0.0]], [[[1.0]]], "strictly increasing"),
        ([0.0, np.nan], [[0.0]], [[[1.0]]], "finite"),
        ([0.0, 1.0, 2.0], [[0.0]], [[[1.0]]], "2 segments"),
        ([0.0, 1.0], [[0.0, 0.0]], [[[1.0, 1.0]]], "segment 0: need 1 to 128 distinct nodes"),
        ([0.0, 1.0], [[1.5]], [[[1.0]]], "distinct nodes"),
        ([0.0, 1.0], [[0.5, -1.5]], [[[1.0, 2.0]]], "distinct nodes"),
        ([0.0, 1.0], [[np.nan]], [[[1.0]]], "distinct nodes"),
        ([0.0, 1.0], [[0.0]], [[1.0]], r"values have shape \(1,\)"),
        ([0.0, 1.0], [[0.0, 1.0]], [[[1.0]]], r"need \(components, 2\)"),
        ([0.0, 1.0, 2.0], [[0.0], [0.0]], [[[1.0]], [[1.0], [2.0]]], "segment 1"),
    ],
)
def test_pieces_that_do_not_fit_are_refused(breaks: Any, nodes: Any, values: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PiecewisePolynomial(breaks, tuple(nodes), tuple(values))


def test_the_same_places_of_all_segments_are_evaluated_from_within_each() -> None:
    nodes = (np.array([-0.5, 0.5]), np.array([-1.0, 0.0, 1.0]), np.array([-0.5, 0.5]))
    values = (np.array([[0.0, 1.0]]), np.array([[1.0, 0.0, 1.0]]), np.array([[5.0, 5.0]]))
    signal = PiecewisePolynomial(np.array([0.0, 1.0, 3.0, 4.0]), nodes, values)
    found = signal.evaluate_at_normalised_times([-1.0, 0.0, 1.0])
    assert found[0] == pytest.approx(np.array([[-0.5, 0.5, 1.5], [1.0, 0.0, 1.0], [5.0, 5.0, 5.0]]))
    assert signal([0.5, 1.0, 2.5, 3.0])[0] == pytest.approx([0.5, 1.0, 0.25, 5.0])
    assert signal([1.0, 3.0], "left")[0] == pytest.approx([1.5, 1.0])


def test_whole_numbers_are_numbers() -> None:
    """t^2 on [0, 2] and 8 - 2 t on [2, 4], all given as integers."""
    signal = PiecewisePolynomial(
        [0, 2, 4],  # type: ignore[arg-type]
        ([-1, 0, 1], [-1, 1]),  # type: ignore[arg-type]
        ([[0, 1, 4]], [[4, 0]]),  # type: ignore[arg-type]
    )
    assert all(array.dtype == float for array in (signal.breaks, *signal.nodes, *signal.values))
    for array in (signal.breaks, *signal.nodes, *signal.values):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 1.0
    assert signal([0.5, 1.5, 3.0])[0] == pytest.approx([0.25, 2.25, 2.0])
    assert signal.derivative()([0.5, 3.0])[0] == pytest.approx([1.0, -2.0])


@pytest.mark.parametrize("start", [-1e6, 1e6 - 1.0, 0.0])
def test_rounding_of_times_is_a_share_of_their_size(start: float) -> None:
    """t - start over 1 s: half a thousandth of a billionth of the times outside is rounding, five times that is not."""
    size = max(abs(start), abs(start + 1.0))
    signal = PiecewisePolynomial(
        np.array([start, start + 1.0]), (np.array([-1.0, 1.0]),), (np.array([[0.0, 1.0]]),)
    )
    assert signal(start - 5e-13 * size)[0] == 0.0 and signal(start + 1.0 + 5e-13 * size)[0] == 1.0
    for wrong in (start - 5e-12 * size, start + 1.0 + 5e-12 * size):
        with pytest.raises(ArgumentError, match="outside the span"):
            signal([start + 0.5, wrong])


@pytest.mark.parametrize(
    ("nodes", "good"),
    [
        (np.linspace(-1, 1, 128), True),
        (np.linspace(-1, 1, 129), False),
        (np.array([0.5]), True),
        (np.array([-1.5, 0.0]), False),
        (np.array([0.0, 1.5]), False),
        (np.array([0.5, 0.5]), False),
        (np.zeros(0), False),
    ],
)
def test_nodes_are_few_distinct_and_within_their_segment(nodes: Array, good: bool) -> None:
    def made() -> PiecewisePolynomial:
        usual = np.array([-1.0, 1.0])
        values = (np.zeros((1, 2)), np.ones((1, nodes.size)))
        return PiecewisePolynomial(np.array([0.0, 1.0, 2.0]), (usual, nodes), values)

    if good:
        assert made()(1.75)[0] == pytest.approx(1.0)
    else:
        with pytest.raises(ArgumentError, match="segment 1: need 1 to 128 distinct nodes"):
            made()
