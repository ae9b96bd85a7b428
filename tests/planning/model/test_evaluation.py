"""Evaluating CasADi functions many times: the same numbers as one by one, whatever the blocks."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from gnc_opt.model.evaluation import BLOCK, evaluate_chain, evaluate_columns

x, p, none = ca.SX.sym("x", 3), ca.SX.sym("p", 2), ca.SX.sym("none", 0)
DENSE = ca.Function("dense", [x, none, p], [ca.vertcat(x[0] * p[0], ca.sin(x[1]) + p[1], x[2] ** 2, 7)])
SPARSE = ca.Function("sparse", [x, none, p], [ca.vertcat(ca.SX(1, 1), x[0] * p[1], ca.SX(1, 1), x[2])])


@pytest.mark.parametrize("function", [DENSE, SPARSE])
@pytest.mark.parametrize("n", [0, 1, 2, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK + 5])
def test_columns_are_those_of_single_evaluations(function: ca.Function, n: int) -> None:
    rng = np.random.default_rng(n)
    columns, kept = rng.normal(size=(3, n)), rng.normal(size=2)
    found = evaluate_columns(function, n, columns, np.zeros(0), kept)
    assert found.shape == (4, n)
    for k in range(n):
        assert np.array_equal(found[:, k], function(columns[:, k], np.zeros(0), kept).full()[:, 0])


def test_what_stays_the_same_may_also_be_repeated() -> None:
    columns, kept = np.arange(60.0).reshape(3, 20), np.array([2.0, -1.0])
    repeated = evaluate_columns(DENSE, 20, columns, np.zeros((0, 20)), np.tile(kept[:, None], 20))
    assert np.array_equal(repeated, evaluate_columns(DENSE, 20, columns, np.zeros(0), kept))


def test_a_chain_goes_on_from_what_it_gave() -> None:
    """Fibonacci's numbers, and what is added at each step."""
    pair, added = ca.SX.sym("pair", 2), ca.SX.sym("added")
    step = ca.Function("step", [pair, added], [ca.vertcat(pair[1], pair[0] + pair[1] + added)])
    start = np.array([0.0, 1.0])
    found = evaluate_chain(step, start, np.zeros((1, 10)))
    assert found[0].tolist() == [0, 1, 1, 2, 3, 5, 8, 13, 21, 34, 55]
    assert evaluate_chain(step, start, np.array([[0.0, 3.0]]))[1].tolist() == [1, 1, 5]
    assert start.tolist() == [0.0, 1.0]
