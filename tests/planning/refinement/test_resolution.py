"""How finely pieces are collocated along a known flight: from Legendre series by hand."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import legendre
from testing.constructed_solutions import cart, phase, samples, solution
from testing.internals import ARC_MAX_DEGREE, MAX_SEGMENTS, PhaseStructure, Plan, Resolution

from gnc_opt.planning import ArcKind
from gnc_opt.planning.refinement.arcs import resolution as r

LOW, UP, FREE = ArcKind.LOWER, ArcKind.UPPER, ArcKind.INTERIOR
MOST = 1e-9


def row(rest: float, at: int = ARC_MAX_DEGREE) -> Any:
    """What n points leave: a tenth for each point up to some number, then as much again."""
    return np.array([rest * 10.0 ** (at - min(n, at)) for n in range(r.TERMS)])


def never(breaks: Any) -> Any:
    raise AssertionError("no segment was to be halved")


def test_the_fewest_points_that_leave_little_enough() -> None:
    for fewest in (r.PIECE_MIN_POINTS, r.PIECE_MIN_POINTS + 1, ARC_MAX_DEGREE - 1, ARC_MAX_DEGREE):
        found = r._resolution(never, row(MOST, fewest), 0.0, 1.0, MOST)
        assert found == Resolution(1, fewest)
    assert r._resolution(never, row(MOST, r.PIECE_MIN_POINTS - 2), 0.0, 1.0, MOST) == Resolution(
        1, r.PIECE_MIN_POINTS
    )
    assert r._resolution(never, 0 * row(1.0), 0.0, 1.0, MOST) == Resolution(1, r.PIECE_MIN_POINTS)


def test_segments_are_halved_where_they_are_steep_as_long_as_that_helps() -> None:
    """What is left falls like the fourth power of the length, and only the last quarter is steep."""
    asked: list[Any] = []

    def left(breaks: Any) -> Any:
        asked.append(breaks.tolist())
        return np.array(
            [
                row(256 * MOST * ((end - start) / 8) ** 4 if end > 8.0 else 1e-3 * MOST)
                for start, end in itertools.pairwise(breaks)
            ]
        )

    found = r._resolution(left, row(256 * MOST), 2.0, 10.0, MOST)
    assert found == Resolution(3, ARC_MAX_DEGREE, edges=(0.5, 0.75))
    assert asked == [[2.0, 6.0, 10.0], [6.0, 8.0, 10.0]]


def test_segments_that_are_all_alike_are_equal() -> None:
    found = r._resolution(
        lambda b: np.tile(row(4096 * MOST * (b[1] - b[0]) ** 4), (2, 1)), row(9.0), 0.0, 1.0, MOST
    )
    assert found.segments == 8 and found.shares == pytest.approx(np.linspace(0.0, 1.0, 9))


def test_the_worst_segment_says_how_many_points_all_have() -> None:
    rows = np.array([row(1e-3 * MOST, ARC_MAX_DEGREE - 1), row(MOST, ARC_MAX_DEGREE - 2)])
    found = r._resolution(lambda b: rows, row(1e3 * MOST), 0.0, 1.0, MOST)
    assert found == Resolution(2, ARC_MAX_DEGREE - 2, edges=(0.5,))


@pytest.mark.parametrize(("share", "segments"), [(0.99, 2), (1.0, 1), (1.01, 1)])
def test_what_halving_hardly_helps_is_left(share: float, segments: int) -> None:
    worst = [1.0]

    def left(breaks: Any) -> Any:
        worst.append(worst[-1] * (share * r.HALVING_GAIN_RATIO if len(worst) == 1 else 1.0))
        return np.tile(row(worst[-1]), (breaks.size - 1, 1))

    assert r._resolution(left, row(1.0), 0.0, 1.0, MOST).segments == segments


def test_pieces_have_so_many_segments_at_most() -> None:
    found = r._resolution(
        lambda b: np.tile(row((b[1] - b[0]) ** 4), (b.size - 1, 1)), row(1.0), 0.0, 1.0, 0.0
    )
    assert found.segments == MAX_SEGMENTS and found.degree == ARC_MAX_DEGREE


# --- series of a flight -----------------------------------------------------------------------------------


def bent(t: Any, k: int) -> Any:
    """v = 3 t^5, so that q' has a term of degree 5 along a segment; the control follows."""
    return np.array([0.5 * t**6, 3 * t**5])


FLIGHT = cart()
LEG = phase(FLIGHT, bent, lambda t, k: [15 * t**4], lambda t, k: [0 * t, 0 * t], breaks=(0.0, 1.0), degree=7)
SAMPLES = samples(
    FLIGHT, bent, lambda t, k: [15 * t**4], lambda t, k: [0 * t, 0 * t], breaks=(0.0, 1.0), degree=7, weights=(0.0,)
)  # fmt: skip


def test_terms_that_points_leave_out_are_those_of_the_slopes() -> None:
    """Of q' = 3 t^5 and v' = 15 t^4 in shares of the states, times the length: sums of |terms| from the n-th on."""
    left = r._left_out(SAMPLES, solution(FLIGHT, LEG))
    breaks = np.array([0.2, 0.6, 1.0])
    found = left(breaks)
    assert found.shape == (2, r.TERMS)
    for k, (start, end) in enumerate(((0.2, 0.6), (0.6, 1.0))):
        t = np.polynomial.Polynomial([0.5 * (start + end), 0.5 * (end - start)])
        expected = np.zeros(r.TERMS)
        for slope, scale in ((3 * t**5, SAMPLES.state_scale[0]), (15 * t**4, SAMPLES.state_scale[1])):
            terms = np.abs(legendre.poly2leg(slope.coef)) / scale
            expected = np.maximum(expected, np.pad(terms, (0, r.TERMS - terms.size)))
        expected = np.cumsum((end - start) * expected[::-1])[::-1]
        assert found[k] == pytest.approx(expected, abs=1e-12)


def test_each_piece_gets_what_it_needs() -> None:
    """A piece along which slopes are of degree 5 needs six points; a short one fewer."""
    structure = PhaseStructure((0.0, 0.999, 1.0), ((UP,) + (FREE,) * 4, (LOW,) + (FREE,) * 4), (), 1, 2)
    plan = Plan(structure, (Resolution(3, 5), Resolution(2, 9)), 7.0)
    found = r.resolved(plan, SAMPLES, solution(FLIGHT, LEG), 1e-9)
    assert found.resolutions == (Resolution(1, 6), Resolution(1, r.PIECE_MIN_POINTS))
    assert found.structure == structure and found.points == 7.0
    left = r._left_out(SAMPLES, solution(FLIGHT, LEG))(np.array([0.0, 0.999]))[0]
    for share, points in ((1.001, 5), (0.999, 6)):
        tol = share * left[5] / r.RESOLUTION_TOLERANCE_SHARE
        assert r.resolved(plan, SAMPLES, solution(FLIGHT, LEG), tol).resolutions[0] == Resolution(1, points)
