"""Evaluation of model functions: columns and repeated operations."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from gnc_opt.model.casadi_function_evaluation import (
    BLOCK,
    NUMPY_MAX_OPERATIONS,
    VectorizedFunction,
    evaluate_casadi_batch,
    evaluate_casadi_function,
    iterate_discrete_time_map,
)

# Evaluating CasADi functions many times: the same numbers as one by one, whatever the blocks.


x, p, none = ca.SX.sym("x", 3), ca.SX.sym("p", 2), ca.SX.sym("none", 0)
DENSE = ca.Function("dense", [x, none, p], [ca.vertcat(x[0] * p[0], ca.sin(x[1]) + p[1], x[2] ** 2, 7)])
SPARSE = ca.Function("sparse", [x, none, p], [ca.vertcat(ca.SX(1, 1), x[0] * p[1], ca.SX(1, 1), x[2])])


@pytest.mark.parametrize("function", [DENSE, SPARSE])
@pytest.mark.parametrize("n", [0, 1, 2, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK + 5])
def test_columns_are_those_of_single_evaluations(function: ca.Function, n: int) -> None:
    rng = np.random.default_rng(n)
    columns, kept = rng.normal(size=(3, n)), rng.normal(size=2)
    found = evaluate_casadi_batch(function, n, columns, np.zeros(0), kept)
    assert found.shape == (4, n)
    for k in range(n):
        assert np.array_equal(found[:, k], function(columns[:, k], np.zeros(0), kept).full()[:, 0])


def test_what_stays_the_same_may_also_be_repeated() -> None:
    columns, kept = np.arange(60.0).reshape(3, 20), np.array([2.0, -1.0])
    repeated = evaluate_casadi_batch(DENSE, 20, columns, np.zeros((0, 20)), np.tile(kept[:, None], 20))
    assert np.array_equal(repeated, evaluate_casadi_batch(DENSE, 20, columns, np.zeros(0), kept))


def test_a_chain_goes_on_from_what_it_gave() -> None:
    """Fibonacci's numbers, and what is added at each step."""
    pair, added = ca.SX.sym("pair", 2), ca.SX.sym("added")
    step = ca.Function("step", [pair, added], [ca.vertcat(pair[1], pair[0] + pair[1] + added)])
    start = np.array([0.0, 1.0])
    found = iterate_discrete_time_map(step, start, np.zeros((1, 10)))
    assert found[0].tolist() == [0, 1, 1, 2, 3, 5, 8, 13, 21, 34, 55]
    assert iterate_discrete_time_map(step, start, np.array([[0.0, 3.0]]))[1].tolist() == [1, 1, 5]
    assert start.tolist() == [0.0, 1.0]


# CasADi functions by NumPy are the same functions.


COLUMNS = 200


def function(*expressions: ca.SX, of: tuple[ca.SX, ...]) -> ca.Function:
    return ca.Function("f", list(of), [ca.densify(ca.vertcat(*expressions))])


def arguments(rng: np.random.Generator) -> list[np.ndarray]:
    return [rng.uniform(-2, 2, (1, COLUMNS)), rng.uniform(-2, 2, (2, COLUMNS)), rng.uniform(-2, 2, 2)]


T, X, P = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("p", 2)
A, B = X[0], X[1]


@pytest.mark.parametrize(
    "expression",
    [
        A + B * T - P[0] / B,
        ca.vertcat(-A, 2 * B, 1 / T, A**2, ca.fabs(B)),
        ca.vertcat(ca.exp(A), ca.log(B), ca.sqrt(T), A**1.7, A**B, ca.constpow(B, 3)),
        ca.vertcat(ca.sin(A), ca.cos(B), ca.tan(T), ca.asin(A), ca.acos(B), ca.atan(T), ca.atan2(A, B)),
        ca.vertcat(ca.sinh(A), ca.cosh(B), ca.tanh(T), ca.fmin(A, B), ca.fmax(A, P[1]), ca.hypot(A, B)),
        ca.vertcat(0, 3.5, P[1], T),
    ],
    ids=str,
)
def test_operations_are_casadis_numbers_that_are_none_included(expression: ca.SX) -> None:
    f = function(expression, of=(T, X, P))
    given = arguments(np.random.default_rng(1))
    programme = VectorizedFunction.from_casadi_function(f)
    assert programme is not None
    np.testing.assert_allclose(
        programme(COLUMNS, *given), evaluate_casadi_batch(f, COLUMNS, *given), rtol=1e-14
    )


def test_registers_that_serve_twice_and_derivatives() -> None:
    """A Hessian of some length, whose intermediate results CasADi keeps in a few places."""
    long = ca.sin(A * B) ** 2 * ca.exp(-T * A) / (1 + B**2) + ca.sqrt(1 + A**4) * ca.cos(P[0] * B)
    f = function(ca.vec(ca.hessian(long, X)[0]), ca.gradient(long, X), of=(T, X, P))
    given = arguments(np.random.default_rng(2))
    programme = VectorizedFunction.from_casadi_function(f)
    assert programme is not None and programme.registers < len(programme.steps) / 2
    np.testing.assert_allclose(
        programme(COLUMNS, *given), evaluate_casadi_batch(f, COLUMNS, *given), rtol=1e-12, atol=1e-14
    )


def test_what_is_not_read_is_left_to_casadi() -> None:
    kinked = function(ca.if_else(A > 0, A, B), of=(T, X, P))
    endless = A
    for _ in range(NUMPY_MAX_OPERATIONS):
        endless = ca.sin(endless)
    assert VectorizedFunction.from_casadi_function(kinked) is None
    assert VectorizedFunction.from_casadi_function(function(endless, of=(T, X, P))) is None
    t, x, p = arguments(np.random.default_rng(3))
    found = evaluate_casadi_function(
        kinked, t[0], x, p, programme=lambda: VectorizedFunction.from_casadi_function(kinked)
    )
    np.testing.assert_array_equal(found[0], np.where(x[0] > 0, x[0], x[1]))
