"""Saddle points: against dense algebra; what is not determined, and what contradicts itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy

import gnc_opt as go
from gnc_opt.planning.optimality import kkt as saddle
from gnc_opt.planning.optimality.kkt import FREE, SaddlePoint

RNG = np.random.default_rng(3)


def system(hessian: Any, rows: Any, labels: str = "abcdefgh") -> SaddlePoint:
    hessian, rows = np.atleast_2d(np.asarray(hessian, float)), np.atleast_2d(np.asarray(rows, float))
    return SaddlePoint(scipy.sparse.csc_array(dense(hessian, rows)), len(hessian), list(labels), "by hand")


def dense(hessian: Any, rows: Any) -> Any:
    return np.block([[hessian, np.transpose(rows)], [rows, np.zeros((len(rows), len(rows)))]])


def test_a_badly_scaled_system_is_solved_as_a_dense_one() -> None:
    """Rows that differ by 1e4 in size; the answer is known beforehand."""
    rough = RNG.standard_normal((5, 5))
    size = 10.0 ** np.array([0, 2, -2, 1, -1])
    hessian = (rough @ rough.T + np.eye(5)) * np.outer(size, size)
    rows = RNG.standard_normal((2, 5)) * size
    matrix, wanted = dense(hessian, rows), RNG.standard_normal(7)
    found = system(hessian, rows)
    assert not found.redundant
    assert found.solve(matrix @ wanted) == pytest.approx(wanted, rel=1e-9)


def test_redundant_rows_are_borne_and_the_answer_is_as_sharp_as_without_them() -> None:
    """x = (1, 2) is the least of |x|^2 / 2 - 5 x_1 + 3 x_2 where x_1 + x_2 = 3, stated once, twice, and doubled."""
    for rows in ([[1, 1]], [[1, 1], [1, 1]], [[1, 1], [-2, -2], [1, 1]]):
        found = system(np.eye(2), rows)
        assert bool(found.redundant) is (len(rows) > 1)
        limits = 3 * np.asarray(rows, float)[:, 0]
        solved = found.solve(np.concatenate([[5.0, -3.0], limits]))
        x, multipliers = solved[:2], solved[2:]
        assert x == pytest.approx([5.5, -2.5], abs=1e-12)
        assert x + np.asarray(rows).T @ multipliers == pytest.approx([5.0, -3.0], abs=1e-12)


def test_rows_that_are_nearly_the_same_are_not_redundant() -> None:
    """They differ by 1e-4: two conditions, two multipliers."""
    rows = np.array([[1.0, 1.0], [1.0, 1.0001]])
    found = system(np.eye(2), rows)
    assert not found.redundant
    wanted = np.array([1.0, 2.0, 3.0, 4.0])
    assert found.solve(dense(np.eye(2), rows) @ wanted) == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize(
    ("hessian", "rows", "culprit"),
    [
        (np.diag([1.0, 0.0, 2.0]), [[1.0, 0.0, 1.0]], "b"),  # structurally singular
        ([[2, 0, 0], [0, 1, 1], [0, 1, 1]], [[1.0, 0.0, 0.0]], "b|c"),
        (
            [[1, 0, 0], [0, 1, 0.25], [0, 0.25, 0.0625]],
            [[1.0, 0.0, 0.0]],
            "c",
        ),  # c moves four times as far as b
    ],
)
def test_what_nothing_determines_is_named(hessian: Any, rows: Any, culprit: str) -> None:
    with pytest.raises(go.GncOptError, match=f"'by hand' do not determine '({culprit})'"):
        system(hessian, rows)


@pytest.mark.parametrize("share", [0.3, 1 / 3, 0.9, 1.1])
def test_what_is_singular_but_for_rounding_is_told_from_its_condition(share: float) -> None:
    """(a + share b)^2 / 2 leaves a line open; its last pivot is rounding, not zero."""
    matrix = np.array([[1.0, share], [share, share * share]])
    with pytest.raises(go.GncOptError, match=r"do not determine '(a|b)'"):
        SaddlePoint(scipy.sparse.csc_array(matrix), 2, ["a", "b"], "by hand")


def test_a_free_direction_shows_among_redundant_rows_too() -> None:
    """Two equal rows hold a; nothing holds b + c."""
    with pytest.raises(go.GncOptError, match=r"do not determine '(b|c)'"):
        system([[1, 0, 0], [0, 1, -1], [0, -1, 1]], [[1.0, 0, 0], [1.0, 0, 0]])
    assert FREE < 1.0


def test_rows_that_contradict_each_other_are_named() -> None:
    found = system(np.eye(2), [[1, 1], [1, 1]])
    assert np.all(np.isfinite(found.solve(np.array([0.0, 0.0, 2.0, 2.0]))))
    with pytest.raises(go.GncOptError, match=r"leave no room for its constraints, at '(c|d)'"):
        found.solve(np.array([0.0, 0.0, 2.0, 2.001]))
    # A difference of rounding is none.
    assert found.solve(np.array([0.0, 0.0, 2.0, 2.0 + 1e-9]))[:2] == pytest.approx([1.0, 1.0], abs=1e-6)
    assert found.solve(np.zeros(4)) == pytest.approx(np.zeros(4))


def test_a_single_unknown() -> None:
    found = SaddlePoint(scipy.sparse.csc_array(np.array([[4.0]])), 1, ["a"], "by hand")
    assert not found.redundant and found.solve(np.array([2.0])).tolist() == [0.5]


def test_scale_factors_bring_the_largest_entry_of_every_row_to_one() -> None:
    rough = RNG.standard_normal((6, 6))
    size = 10.0 ** np.array([0, 6, -6, 3, -3, 1])
    matrix = (rough + rough.T) * np.outer(size, size)
    matrix[2] = matrix[:, 2] = 0.0
    scale = saddle._equilibrate(scipy.sparse.csc_array(matrix))
    largest = np.max(np.abs(scale[:, None] * matrix * scale), axis=1)
    assert scale[2] == 1.0 and np.all(scale > 0)
    assert np.all(largest <= 1.02) and np.all(np.delete(largest, 2) > 0.3)
    diagonal = scipy.sparse.csc_array(np.diag([1e8, -1e-8, 4.0]))
    assert saddle._equilibrate(diagonal) == pytest.approx([1e-4, 1e4, 0.5])
