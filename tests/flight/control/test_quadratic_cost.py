"""Weights of quadratic costs: how they are written, and which are refused."""

from __future__ import annotations

import numpy as np
import pytest
from testing.internals import read_quadratic_cost, read_weight_matrix

from gnc_opt.errors import ArgumentError, DesignError, UnknownNameError
from gnc_opt.model import Layout, Model, Variable

NAN, INF = np.nan, np.inf


def cart(drag: float = 0.0) -> Model:
    model = Model("cart")
    q, v = model.state("q", unit="m"), model.state("v", unit="m/s")
    a, c = model.control("a", unit="N"), model.parameter("c", drag)
    model.ode({q: v, v: a - c * v})
    return model


def test_weights_are_matrices_diagonals_numbers_or_names():
    layout = Layout("state", (Variable("r", 2), Variable("v")))
    assert read_weight_matrix(2.0, layout, "Q").tolist() == np.diag([2.0] * 3).tolist()
    assert read_weight_matrix([1, 2, 3], layout, "Q").tolist() == np.diag([1.0, 2, 3]).tolist()
    assert read_weight_matrix({"r": [1, 2]}, layout, "Q").tolist() == np.diag([1.0, 2, 0]).tolist()
    assert read_weight_matrix({"r": 4, "v": 5}, layout, "Q").tolist() == np.diag([4.0, 4, 5]).tolist()
    full = np.array([[2.0, 1, 0], [1, 3, 0], [0, 0, 1]])
    assert read_weight_matrix(full, layout, "Q").tolist() == full.tolist()
    for value, message in (
        ([1.0, 2.0], "Q is given 2 values"), (np.ones((2, 2)), r"shape \(2, 2\)"),
        (full + np.eye(3, k=1), "not symmetric"),
        (np.diag([1, INF, 1]), "not finite"), ({"r": [1, 2, 3]}, "Q of 'r'"), ({"z": 1.0}, "no state 'z'"),
    ):  # fmt: skip
        with pytest.raises((ArgumentError, DesignError, UnknownNameError), match=message):
            read_weight_matrix(value, layout, "Q")


@pytest.mark.parametrize(
    ("q", "r", "n", "message"),
    [
        ([1.0, -1.0], 1.0, None, "Q of 'v' is -1"), ([[1.0, 2], [2, 1]], 1.0, None, "Q is not positive semidefinite"),
        ([[0.0, 1], [1, 1]], 1.0, None, "Q is not positive semidefinite"),
        ([[0.0, 1e-12], [1e-12, 1]], 1.0, None, "Q is not positive semidefinite"), (1.0, 0.0, None, "R of 'a' is 0"),
        (1.0, 1.0, [[1.0]], r"N has the shape"), (1.0, 1.0, [[NAN], [0.0]], "N has the shape"),
        (1.0, 1.0, [[2.0], [0.0]], r"\[\[Q, N\], \[N', R\]\]"),
    ],
)  # fmt: skip
def test_costs_that_reward_are_refused(q, r, n, message):
    with pytest.raises((ArgumentError, DesignError), match=message):
        read_quadratic_cost(cart(), q, r, n)


def test_costs_at_the_edge_are_not():
    cost = read_quadratic_cost(cart(), [[1.0, 1.0], [1.0, 1.0]], 4.0, [[2.0], [2.0]])
    assert cost.n.tolist() == [[2.0], [2.0]] and read_quadratic_cost(cart(), 0.0, 1.0, None).n.tolist() == [
        [0.0],
        [0.0],
    ]
    assert read_quadratic_cost(cart(), [1e-9, 1e9], 1e-12, None).r.tolist() == [[1e-12]]
    two = Model("two")
    x, u = two.state("x"), two.control("u", 2)
    two.ode({x: u[0] + u[1]})
    with pytest.raises(DesignError, match="R is not positive definite"):
        read_quadratic_cost(two, 1.0, [[1.0, 1.0], [1.0, 1.0]], None)
