"""The control as it can be flown: within its bounds everywhere, with the impulse of the collocation polynomial."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from testing.internals import Interval, PiecewisePolynomial, collocation_rule

from gnc_opt.planning.solution.saturated_control import SaturatedControl

BREAKS = np.array([0.0, 1.0, 3.0])


def flown(values: list[list[float]], lower: float, upper: float) -> SaturatedControl:
    """One channel on two segments of three Gauss points."""
    rules = (collocation_rule("LG", 3),) * 2
    nodal = tuple(np.array([v]) for v in values)
    polynomial = PiecewisePolynomial(BREAKS, tuple(r.points for r in rules), nodal)
    return SaturatedControl(polynomial, Interval(np.array([lower]), np.array([upper])), rules)


def impulse(signal: SaturatedControl, k: int) -> float:
    left, right = BREAKS[k], BREAKS[k + 1]
    inside = [t for t in signal.jumps if left < t < right]
    return float(quad(lambda t: signal(t)[0], left, right, points=inside or None, epsabs=1e-13)[0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("other", [3.0, np.inf])
def test_overshoot_and_undershoot_are_held_alike(sign: float, other: float) -> None:
    """Nodes 0, 0, 1 of a control that must not be negative, and their mirror image: a dip between the nodes."""
    values = [[0.0, 0.0, sign], [0.5 * sign, 0.6 * sign, 0.7 * sign]]
    signal = flown(values, *sorted([0.0, sign * other]))
    times = np.linspace(0.0, 3.0, 601)
    assert np.min(sign * signal.polynomial(times)) < -0.05  # or the test tests nothing
    assert signal.held.tolist() == [[True, False]]
    assert np.min(sign * signal(times)) == 0.0
    for k, mean in enumerate((sign * 5 / 18, sign * 0.6)):  # Gauss weights 5, 8, 5 of 18
        assert impulse(signal, k) == pytest.approx(mean * (BREAKS[k + 1] - BREAKS[k]), abs=1e-12)


def test_cells_are_as_long_as_the_weights_and_the_side_decides_on_their_edges() -> None:
    signal = flown([[0.0, 1.0, 0.0], [0.5, 0.5, 0.5]], 0.0, 1.0)
    edges = np.array([0.0, 5 / 18, 13 / 18, 1.0])
    assert signal.jumps == pytest.approx([*edges, 3.0], abs=1e-14)
    middles = 0.5 * (edges[1:] + edges[:-1])
    assert signal(middles)[0] == pytest.approx([0.0, 1.0, 0.0], abs=0)
    inner = signal.jumps[1:4]
    assert signal(inner, "left")[0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-14)
    assert signal(inner, "right")[0] == pytest.approx([1.0, 0.0, 0.5], abs=1e-14)
    assert signal(3.0)[0] == pytest.approx(0.5)


@pytest.mark.parametrize("first", [True, False])
def test_a_jump_at_a_boundary_counts_for_the_segment_on_its_side(first: bool) -> None:
    """Nodes 0, 0, 1 end above 1 and 1, 0, 0 begin there; the other segment, at 1/2, is flown as it is."""
    over = [0.0, 0.0, 1.0] if first else [1.0, 0.0, 0.0]
    pieces = [over, [0.5] * 3] if first else [[0.5] * 3, over]
    signal = flown(pieces, -1.0, 1.0)
    assert signal.polynomial(1.0, "left" if first else "right")[0] > 1.2
    assert signal.held.tolist() == [[first, not first]]


def test_rounding_beyond_a_bound_is_clipped_and_not_held() -> None:
    signal = flown([[1.0 + 1e-9, 1.0, 1.0], [-1e-9, 0.0, 0.0]], 0.0, 1.0)
    assert not signal.held.any()
    assert np.max(signal(np.linspace(0.0, 1.0, 50))) == 1.0
    assert np.min(signal(np.linspace(1.0, 3.0, 50), "left")) == 0.0


@pytest.mark.parametrize("value", [0.0, 0.7, -3e5])
def test_rounding_of_a_fixed_control_is_no_overshoot(value: float) -> None:
    """A control with equal bounds has no range that its rounding could be a share of."""
    off = 1e-15 * max(abs(value), 1.0)
    signal = flown([[value, value + off, value], [value - off, value, value]], value, value)
    assert not signal.held.any()
    assert signal(np.linspace(0.0, 3.0, 31)) == pytest.approx(value, abs=0)
    missed = flown([[value, value + 1e-3 * max(abs(value), 1.0), value], [value] * 3], value, value)
    assert missed.held.tolist() == [[True, False]]


def test_each_channel_is_held_by_itself() -> None:
    """The first one overshoots at 1 in the first segment, the second one at -2 in the last, the third one nowhere."""
    rules = (collocation_rule("LG", 3),) * 2
    nodal = (
        np.array([[0.0, 0.0, 1.0], [0.5, 0.4, 0.3], [0.1, 0.2, 0.3]]),
        np.array([[0.5, 0.6, 0.7], [-2.0, 0.0, 0.0], [0.3, 0.2, 0.1]]),
    )
    polynomial = PiecewisePolynomial(BREAKS, tuple(r.points for r in rules), nodal)
    bounds = Interval(np.array([0.0, -2.0, -np.inf]), np.array([1.0, 2.0, np.inf]))
    signal = SaturatedControl(polynomial, bounds, rules)
    assert signal.held.tolist() == [[True, False], [False, True], [False, False]]
    cells = np.array([0.0, 5 / 18, 13 / 18, 1.0])
    assert signal.jumps == pytest.approx([*cells, *(1 + 2 * cells[1:])], abs=1e-14)
    middles = np.array([*(0.5 * (cells[1:] + cells[:-1])), *(1 + cells[1:] + cells[:-1])])
    found, free = signal(middles), polynomial(middles)
    assert found[0] == pytest.approx([0.0, 0.0, 1.0, *free[0, 3:]])
    assert found[1] == pytest.approx([*free[1, :3], -2.0, 0.0, 0.0])
    assert found[2] == pytest.approx(free[2])
    shuffled = np.array([4, 0, 5, 3, 1, 2])
    assert signal(middles[shuffled]) == pytest.approx(found[:, shuffled])


def test_at_a_jump_the_right_hand_value_is_meant() -> None:
    signal = flown([[0.25] * 3, [0.75] * 3], 0.0, 0.5)
    assert signal(1.0).tolist() == [0.5] == signal.clipped(1.0).tolist()
    before = pytest.approx([0.25], rel=1e-15)
    assert signal(1.0, "left") == before == signal.clipped(1.0, "left")
