"""Quadrature tables against an independent truth: power-series Legendre polynomials in 100-digit decimals."""

import math
from collections.abc import Callable
from decimal import Context, Decimal, getcontext, localcontext
from functools import cache, wraps
from math import comb
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import legendre
from testing.internals import Scheme

from gnc_opt.planning.transcription.quadrature import (
    MAX_POINTS,
    Array,
    _build_collocation_rule,
    _compute_decimal_quadrature_rule,
    build_differentiation_matrix,
    build_lagrange_interpolation_matrix,
    compute_barycentric_weights,
    get_collocation_points,
    get_collocation_rule,
    get_quadrature_weights,
)

SCHEMES: tuple[Scheme, ...] = ("LG", "LGR", "LGL")
FEWEST = {"LG": 1, "LGR": 1, "LGL": 2}
EXACT_DEGREE = {"LG": -1, "LGR": -2, "LGL": -3}  # to be added to 2 n
ALL = [(s, n) for s in SCHEMES for n in range(FEWEST[s], MAX_POINTS + 1)]
SOME = [(s, n) for s in SCHEMES for n in (1, 2, 3, 5, 8, 16, 33, 64) if n >= FEWEST[s]]


def each_rule(test: Callable[[Scheme, int], None]) -> Callable[[Scheme], None]:
    """Run a test for every number of points of a scheme."""

    @pytest.mark.parametrize("scheme", SCHEMES)
    @wraps(test, assigned=("__name__", "__doc__"), updated=())
    def for_every_number_of_points(scheme: Scheme) -> None:
        for n in range(FEWEST[scheme], MAX_POINTS + 1):
            test(scheme, n)

    del for_every_number_of_points.__wrapped__  # type: ignore[attr-defined]
    return for_every_number_of_points


some_rules = pytest.mark.parametrize(("scheme", "n"), SOME)
any_rule = st.sampled_from(ALL)


def precisely() -> Any:
    return localcontext(Context(prec=100))


@cache
def power_series(degree: int) -> list[Decimal]:
    """Coefficients of P_degree in ascending powers, from its explicit sum."""
    with precisely():
        series = [Decimal(0)] * (degree + 1)
        for k in range(degree // 2 + 1):
            series[degree - 2 * k] = (
                Decimal((-1) ** k * comb(degree, k) * comb(2 * degree - 2 * k, degree)) / 2**degree
            )
        return series


def slope_of(series: list[Decimal]) -> list[Decimal]:
    return [k * c for k, c in enumerate(series)][1:]


def horner(series: list[Decimal], x: Decimal) -> Decimal:
    value = Decimal(0)
    for c in reversed(series):
        value = value * x + c
    return value


def legendre_at(degree: int, x: Decimal) -> Decimal:
    return horner(power_series(degree), x)


@cache
def nodal_series(scheme: Scheme, n: int) -> list[Decimal]:
    """A polynomial whose simple roots are the points: P_n, P_n + P_{n-1}, or (1 - x²) P'_{n-1}."""
    with precisely():
        if scheme == "LG":
            return power_series(n)
        if scheme == "LGR":
            return [a + b for a, b in zip(power_series(n), [*power_series(n - 1), Decimal(0)], strict=True)]
        slope = slope_of(power_series(n - 1))
        return [
            a - b
            for a, b in zip([*slope, Decimal(0), Decimal(0)], [Decimal(0), Decimal(0), *slope], strict=True)
        ]


@cache
def true_points(scheme: Scheme, n: int) -> list[Decimal]:
    series = nodal_series(scheme, n)
    with precisely():
        slope = slope_of(series)
        roots = [Decimal(float(x)) for x in get_collocation_points(scheme, n)]
        for _ in range(3):
            roots = [x - horner(series, x) / horner(slope, x) for x in roots]
        return roots


@cache
def true_state_nodes(scheme: Scheme, n: int) -> list[Decimal]:
    x = true_points(scheme, n)
    if scheme == "LG":
        return [Decimal(-1), *x]
    if scheme == "LGR":
        return [*x, Decimal(1)]
    with precisely():
        return sorted([*x, (x[n // 2 - 1 + n % 2] + x[n // 2 + n % 2]) / 2])


def true_weight(scheme: Scheme, n: int, x: Decimal) -> Decimal:
    if scheme == "LG":
        return 2 / ((1 - x * x) * horner(slope_of(power_series(n)), x) ** 2)
    square = legendre_at(n - 1, x) ** 2
    return (1 - x) / (n * n * square) if scheme == "LGR" else 2 / (n * (n - 1) * square)


def product(values: Any) -> Decimal:
    return math.prod(values, start=Decimal(1))


@cache
def tables_at_points(scheme: Scheme, n: int) -> tuple[Array, Array]:
    return legendre_tables(true_points(scheme, n), n)


def legendre_tables(x: list[Decimal], degree: int) -> tuple[Array, Array]:
    """P_k and P'_k, k = 0 ... degree, at ``x``; rounded once, shapes (degree + 1, len(x))."""
    with precisely():
        nodes = np.array(x, dtype=object)
        p, d = [nodes * 0 + 1, nodes], [nodes * 0, nodes * 0 + 1]
        for k in range(1, degree):
            p.append(((2 * k + 1) * nodes * p[k] - k * p[k - 1]) / (k + 1))
            d.append(d[k - 1] + (2 * k + 1) * p[k])
        return np.array(p[: degree + 1], dtype=float), np.array(d[: degree + 1], dtype=float)


@each_rule
def test_points_are_the_floats_nearest_to_the_roots(scheme: Scheme, n: int) -> None:
    series = nodal_series(scheme, n)
    x = get_collocation_points(scheme, n)
    assert x.shape == (n,) and np.all(np.diff(x) > 0)
    with precisely():
        for node in map(float, x):
            below, above = ((Decimal(node) + Decimal(math.nextafter(node, way))) / 2 for way in (-2.0, 2.0))
            assert horner(series, below) * horner(series, above) < 0


@some_rules
def test_weights_are_the_floats_nearest_to_the_closed_forms(scheme: Scheme, n: int) -> None:
    with precisely():
        truth = [float(true_weight(scheme, n, x)) for x in true_points(scheme, n)]
    np.testing.assert_array_equal(get_quadrature_weights(scheme, n), truth)


@each_rule
def test_quadrature_is_exact_up_to_its_degree_and_no_further(scheme: Scheme, n: int) -> None:
    degree = 2 * n + EXACT_DEGREE[scheme]
    sums = legendre.legvander(get_collocation_points(scheme, n), degree + 1).T @ get_quadrature_weights(
        scheme, n
    )
    np.testing.assert_allclose(sums[: degree + 1], [2.0] + [0.0] * degree, atol=5e-15)
    assert abs(sums[degree + 1]) > 1e-3


@some_rules
def test_state_nodes(scheme: Scheme, n: int) -> None:
    rule = get_collocation_rule(scheme, n)
    np.testing.assert_array_equal(rule.state_nodes, [float(x) for x in true_state_nodes(scheme, n)])
    assert rule.state_nodes.shape == (n + 1,) and np.all(np.diff(rule.state_nodes) > 0)
    assert np.isin(rule.points, rule.state_nodes).all()
    gaps = np.diff(rule.points)
    if scheme == "LGL":
        (extra,) = np.setdiff1d(rule.state_nodes, rule.points)
        assert gaps[np.searchsorted(rule.points, extra) - 1] == pytest.approx(gaps.max(), rel=1e-14)


@some_rules
def test_differentiation_is_exact_up_to_degree_n(scheme: Scheme, n: int) -> None:
    rule = get_collocation_rule(scheme, n)
    p, _ = legendre_tables(true_state_nodes(scheme, n), n)
    _, d = tables_at_points(scheme, n)
    bound = 1e-14 * np.abs(rule.differentiation).sum(axis=1)[:, None]  # |P_k| <= 1
    assert np.all(np.abs(rule.differentiation @ p.T - d.T) <= bound)


@some_rules
def test_differentiation_entries_are_correctly_rounded(scheme: Scheme, n: int) -> None:
    nodes = true_state_nodes(scheme, n)
    collocated = [k for k, x in enumerate(nodes) if x in set(true_points(scheme, n))]
    with precisely():
        below = [product(x - y for y in nodes if y is not x) for x in nodes]

        def entry(i: int, j: int) -> Decimal:
            x = nodes[i]
            others = [y for k, y in enumerate(nodes) if k not in (i, j)]
            return (
                sum((1 / (x - y) for y in others), Decimal(0))
                if i == j
                else product(x - y for y in others) / below[j]
            )

        truth = [[float(entry(i, j)) for j in range(n + 1)] for i in collocated]
    np.testing.assert_array_equal(get_collocation_rule(scheme, n).differentiation, truth)


@some_rules
def test_integration_entries_are_correctly_rounded(scheme: Scheme, n: int) -> None:
    x = true_points(scheme, n)
    series = nodal_series(scheme, n)
    with precisely():
        slope = slope_of(series)

        def integrals_of_basis(j: int) -> list[float]:
            quotient = [series[-1]]  # synthetic division by (x - x_j), descending powers
            for c in series[-2:0:-1]:
                quotient.append(c + x[j] * quotient[-1])
            primitive = [Decimal(0)] + [c / (k + 1) for k, c in enumerate(reversed(quotient))]
            start, scale = horner(primitive, Decimal(-1)), horner(slope, x[j])
            return [float((horner(primitive, node) - start) / scale) for node in x]

        truth = np.array([integrals_of_basis(j) for j in range(n)]).T
    np.testing.assert_array_equal(get_collocation_rule(scheme, n).integration, truth)


@some_rules
def test_integration_is_exact_up_to_degree_n_minus_one(scheme: Scheme, n: int) -> None:
    rule = get_collocation_rule(scheme, n)
    p, _ = tables_at_points(scheme, n)
    expected = [rule.points + 1] + [(p[k + 1] - p[k - 1]) / (2 * k + 1) for k in range(1, n)]
    np.testing.assert_allclose(rule.integration @ p[:n].T, np.transpose(expected), rtol=0, atol=5e-15)
    if scheme == "LGL":
        np.testing.assert_array_equal(rule.integration[-1], rule.weights)
    if scheme != "LG":
        np.testing.assert_array_equal(rule.integration[0], np.zeros(n))


@some_rules
def test_integrate_to_agrees_with_the_tables(scheme: Scheme, n: int) -> None:
    rule = get_collocation_rule(scheme, n)
    np.testing.assert_allclose(
        rule.build_integration_matrix(rule.points), rule.integration, rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(
        rule.build_integration_matrix([-1.0, 1.0]), [np.zeros(n), rule.weights], rtol=0, atol=1e-14
    )


@some_rules
def test_end_values(scheme: Scheme, n: int) -> None:
    nodes = true_state_nodes(scheme, n)
    with precisely():
        ratios = [[((1 - y) / (x - y)) for y in nodes if y is not x] for x in nodes]
        truth = [float(product(row)) for row in ratios]
    rule = get_collocation_rule(scheme, n)
    np.testing.assert_array_equal(rule.end_values, truth)
    if scheme != "LG":
        np.testing.assert_array_equal(rule.end_values, np.eye(n + 1)[-1])


@given(any_rule, st.lists(st.floats(-1, 1), min_size=1, max_size=5), st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_integrate_to_integrates_any_polynomial(
    case: tuple[Scheme, int], tau: list[float], seed: int
) -> None:
    scheme, n = case
    series = np.random.default_rng(seed).uniform(-1, 1, n)
    values = legendre.legval(get_collocation_points(scheme, n), series)
    exact = legendre.legval(np.array(tau), legendre.legint(series, lbnd=-1))
    np.testing.assert_allclose(
        get_collocation_rule(scheme, n).build_integration_matrix(tau) @ values, exact, rtol=0, atol=1e-13
    )


def test_barycentric_weights_of_equidistant_nodes_are_binomials() -> None:
    for n in (1, 2, 3, 10, 65, 400):
        expected = [
            float(Decimal((-1) ** (n - 1 - k) * comb(n - 1, k)) / comb(n - 1, (n - 1) // 2)) for k in range(n)
        ]
        np.testing.assert_allclose(compute_barycentric_weights(np.arange(n)), expected, rtol=1e-15)


@given(any_rule, st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_interpolation_and_differentiation_of_any_polynomial(case: tuple[Scheme, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    nodes = get_collocation_rule(*case).state_nodes
    series = rng.uniform(-1, 1, nodes.size)
    at = np.concatenate([rng.uniform(-1, 1, 20), nodes, [-1.0, 1.0]])
    values, scale = legendre.legval(nodes, series), np.abs(series).sum()
    error = build_lagrange_interpolation_matrix(nodes, at) @ values - legendre.legval(at, series)
    assert np.max(np.abs(error)) < 1e-12 * scale
    slope = legendre.legval(at, legendre.legder(series))
    slope_error = build_differentiation_matrix(nodes, at) @ values - slope
    assert np.max(np.abs(slope_error)) < 1e-12 * nodes.size**2 * scale


def test_interpolation_is_exact_at_nodes_and_stable_beside_them() -> None:
    nodes = get_collocation_rule("LG", 7).state_nodes
    np.testing.assert_array_equal(build_lagrange_interpolation_matrix(nodes, nodes), np.eye(8))
    beside = np.concatenate([np.nextafter(nodes, 2), nodes[1:] - 1e-300, [5e-324]])
    matrix = build_lagrange_interpolation_matrix(nodes, beside)
    assert np.all(np.isfinite(matrix))
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, rtol=1e-14)
    assert build_lagrange_interpolation_matrix(nodes, 0.3).shape == (1, 8)
    assert build_lagrange_interpolation_matrix(nodes, []).shape == (0, 8)
    np.testing.assert_array_equal(build_lagrange_interpolation_matrix([0.2], [0.1, 0.2]), [[1.0], [1.0]])


@pytest.mark.parametrize("nodes", [[], [0.0, 0.0], [0.0, np.nan], [[0.0, 1.0]]])
def test_bad_nodes_are_refused(nodes: list[Any]) -> None:
    with pytest.raises(ValueError, match="nodes"):
        compute_barycentric_weights(nodes)


def test_rules_are_shared_and_read_only() -> None:
    rule = get_collocation_rule("LGR", 4)
    assert get_collocation_rule("LGR", np.int64(4)) is rule  # type: ignore[arg-type]
    for name in ("points", "weights", "state_nodes", "differentiation", "end_values", "integration"):
        table = getattr(rule, name)
        assert table.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            table[0] = 0.0
    assert rule.build_integration_matrix(0.5).shape == (1, 4)


def test_the_decimal_context_of_the_caller_neither_matters_nor_changes() -> None:
    nodes = np.linspace(0.0, 1.0, 11) ** 2
    exact = [float(1 / product(Decimal(x) - Decimal(y) for y in nodes if y != x)) for x in nodes]
    with localcontext(Context(prec=5)):
        before = repr(getcontext())
        scaled = compute_barycentric_weights(nodes)
        table = _build_collocation_rule.__wrapped__("LGL", 9).differentiation
        x, w = _compute_decimal_quadrature_rule.__wrapped__("LG", 9)
        assert repr(getcontext()) == before
    np.testing.assert_allclose(scaled, exact / np.max(np.abs(exact)), rtol=1e-14)
    np.testing.assert_array_equal(table, get_collocation_rule("LGL", 9).differentiation)
    np.testing.assert_array_equal(x.astype(float), get_collocation_points("LG", 9))
    np.testing.assert_array_equal(w.astype(float), get_quadrature_weights("LG", 9))


@pytest.mark.parametrize(
    ("scheme", "n", "message"),
    [
        ("LGX", 3, "unknown scheme 'LGX': did you mean 'LG"),
        ("radau", 3, "did you mean 'LGR'"),
        ("lobato", 3, "did you mean 'LGL'"),
        ("simpson", 3, "choose LG"),
        (None, 3, "unknown scheme None"),
        (["LG"], 3, "unknown scheme"),
        ("LG", 0, "LG has no rule with 0 points: use an integer from 1 to 64"),
        ("LGR", -2, "LGR has no rule with -2"),
        ("LGL", 1, "LGL has no rule with 1 points: use an integer from 2 to 64"),
        ("LG", 65, "more segments"),
        ("LG", 3.0, "no rule with 3.0"),
        ("LG", True, "no rule with True"),
        ("LG", "3", "no rule with '3'"),
    ],
)
def test_bad_requests_say_what_to_do(scheme: Any, n: Any, message: str) -> None:
    for request in (get_collocation_rule, get_collocation_points, get_quadrature_weights):
        with pytest.raises(ValueError, match=message):
            request(scheme, n)
