"""Linear algebra of the second order and of multipliers, on small matrices done densely."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray

from gnc_opt.planning.optimality import kkt_system as null_space
from gnc_opt.planning.optimality.bang_bang_sensitivity import RUNGE_KUTTA_ORDER
from gnc_opt.planning.optimality.kkt_system import (
    NullSpace,
    ProgramLimits,
    ProgramPoint,
    compute_curvature,
    run_lanczos,
)
from gnc_opt.planning.optimality.multiplier_estimate import _ActiveSet, _fit_multipliers
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.verification import critical_cone
from gnc_opt.planning.verification.bang_bang_second_order_conditions import (
    _extrapolate_richardson,
    _fit_switch_order_multipliers,
)
from gnc_opt.planning.verification.critical_cone import CriticalCone
from gnc_opt.planning.verification.reduced_hessian import minimise_curvature

Array = NDArray[np.float64]
RANDOM = np.random.default_rng(5)


def sparse(matrix: Array) -> object:
    return scipy.sparse.csc_array(matrix)


def space_of(jacobian: Array, root: Array, free: Array, size: int) -> NullSpace:
    """Rows scaled to unit gradients, as `NullSpace.with_fixed_variables` leaves them."""
    norms = np.linalg.norm(jacobian, axis=1)
    rows = np.arange(jacobian.shape[0])
    unit = sparse(np.eye(size)[:, free] * root)
    return NullSpace(unit, rows, norms, sparse(jacobian / norms[:, None]))


def symmetric(n: int) -> Array:
    matrix = RANDOM.standard_normal((n, n))
    return matrix + matrix.T


def test_projected_inverse_is_that_of_the_hessian_on_the_null_space() -> None:
    jacobian, hessian = RANDOM.standard_normal((3, 7)), symmetric(7)
    space = space_of(jacobian, np.ones(7), np.arange(7), 7)
    z = scipy.linalg.null_space(jacobian)
    vector = RANDOM.standard_normal(7)
    expected = z @ np.linalg.solve(z.T @ hessian @ z, z.T @ vector)
    np.testing.assert_allclose(space.invert_projected_hessian(sparse(hessian))(vector), expected, rtol=1e-9)


def test_dependent_rows_do_no_harm() -> None:
    """The same row twice; what is projected keeps it as well as if it were there once."""
    row = RANDOM.standard_normal((1, 5))
    space = space_of(np.vstack([row, row]), np.ones(5), np.arange(5), 5)
    vector = RANDOM.standard_normal(5)
    projected = space.invert_projected_hessian(scipy.sparse.eye_array(5))(vector)
    np.testing.assert_allclose(projected, vector - row[0] * (row[0] @ vector) / (row[0] @ row[0]), rtol=1e-9)


def test_variations_are_shares_of_the_metric() -> None:
    """Variables 1, 2 and 4 of 5 vary."""
    root, free = np.array([2.0, 3.0, 5.0]), np.array([1, 2, 4])
    space = space_of(np.ones((1, 3)), root, free, 5)
    variation = space.unit @ np.array([1.0, 10.0, 100.0])
    np.testing.assert_allclose(variation, [0, 2, 30, 0, 500])
    hessian = symmetric(5)
    expected = hessian[np.ix_(free, free)] * np.outer(root, root)
    np.testing.assert_allclose(space.project_to_null_space(sparse(hessian)).toarray(), expected)


def test_curvature_and_its_share_of_its_terms() -> None:
    """d = (1, -1): 1 + 3 - 2 * 1.5 = 1 out of 7."""
    matrix = np.array([[1.0, 1.5], [1.5, 3.0]])
    direction = np.array([1.0, -1.0])
    assert compute_curvature(sparse(matrix), direction) == pytest.approx((1.0, 1 / 7))
    assert compute_curvature(sparse(0 * matrix), direction) == (0.0, 0.0)


@pytest.mark.parametrize("n", [1, 2, 5, 9])
def test_lanczos_of_a_small_matrix_is_complete(n: int) -> None:
    matrix = symmetric(n)
    values, vectors = run_lanczos(lambda v: matrix @ v, 1.0 + np.arange(n), 60)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(matrix), atol=1e-9)
    np.testing.assert_allclose(matrix @ vectors, vectors * values, atol=1e-8)
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(n), atol=1e-9)


def test_lanczos_ends_where_the_start_spans_no_more() -> None:
    """Two eigenvalues take two steps, an eigenvector one, and nothing none."""
    matrix, calls = np.diag([2.0] * 20 + [-3.0] * 20), []

    def operate(v: Array) -> Array:
        calls.append(0)
        return matrix @ v

    assert run_lanczos(operate, np.ones(40), 30)[0] == pytest.approx([-3.0, 2.0])
    assert len(calls) == 2
    values, vectors = run_lanczos(operate, np.eye(40)[0], 30)
    assert values == pytest.approx([2.0]) and vectors.shape == (40, 1)
    values, vectors = run_lanczos(operate, np.zeros(40), 30)
    assert values.shape == (0,) and vectors.shape == (40, 0)


def test_lanczos_takes_no_more_steps_than_allowed_or_than_settle_the_ends() -> None:
    few = run_lanczos(lambda v: np.linspace(0.0, 1.0, 200) * v, np.ones(200), 15)[0]
    assert few.size == 15
    spread = np.concatenate([[-5.0], np.linspace(0.0, 1.0, 200), [4.0]])
    values = run_lanczos(lambda v: spread * v, np.ones(202), 100)[0]
    assert values[[0, -1]] == pytest.approx([-5.0, 4.0], abs=1e-6) and values.size in (10, 20, 30)


def test_extrapolation_takes_away_an_error_of_the_order_of_flows() -> None:
    coarse, fine = 2.0 + 3.0 * 0.2**RUNGE_KUTTA_ORDER, 2.0 + 3.0 * 0.1**RUNGE_KUTTA_ORDER
    assert _extrapolate_richardson(np.array(fine), np.array(coarse)) == pytest.approx(2.0, abs=1e-14)


def test_what_an_order_explains_of_a_gradient() -> None:
    """An order pushes one way only."""
    precedences = np.array([[-1.0, 1.0, 0.0]])
    residual, pushes = _fit_switch_order_multipliers(np.array([-2.0, 2.0, 0.5]), precedences)
    np.testing.assert_allclose(residual, [0.0, 0.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(pushes, [2.0])
    residual, pushes = _fit_switch_order_multipliers(np.array([2.0, -2.0, 0.5]), precedences)
    np.testing.assert_allclose(residual, [2.0, -2.0, 0.5])
    np.testing.assert_allclose(pushes, [0.0])
    residual, pushes = _fit_switch_order_multipliers(np.array([1.0]), np.zeros((0, 1)))
    np.testing.assert_allclose(residual, [1.0])
    assert pushes.shape == (0,)


def test_which_multipliers_a_limit_can_exert() -> None:
    """Of values at the lower, at the upper, at neither, at both limits, with a slack of 1e-5 of the scale."""
    box = Interval(np.array([0.0, 0.0, 0.0, 1.0, 0.0]), np.array([1.0, 1.0, 1.0, 1.0, 1.0]))
    values, scales = np.array([0.9e-3, 1 - 0.9e-3, 0.5, 7.0, 1.1e-3]), np.full(5, 100.0)
    limits = _ActiveSet.determine_active_set(box, values, 1e-5 * scales)
    np.testing.assert_array_equal(limits.lower, [True, False, False, True, False])
    np.testing.assert_array_equal(limits.upper, [False, True, False, True, False])
    np.testing.assert_array_equal(limits.is_at_any_limit, [True, True, False, True, False])
    mask = limits.mask_wrong_multiplier_signs
    np.testing.assert_array_equal(mask(np.ones(5), 1.0), [True, False, False, False, False])
    np.testing.assert_array_equal(mask(-np.ones(5), 1.0), [False, True, False, False, False])
    assert not np.any(mask(np.ones(5), 1e8))


def none_at(n: int, lower: bool = False, upper: bool = False) -> _ActiveSet:
    return _ActiveSet(np.full(n, lower), np.full(n, upper))


def test_limits_that_would_pull_are_let_go() -> None:
    """min z^2 / 2 - g z under the row z <= 0, at z = 0: the multiplier is g if that pushes, else none."""
    matrix, exact = sparse(np.ones((1, 1))), np.zeros(1, dtype=bool)
    held = _fit_multipliers(
        matrix, np.array([-2.0]), exact, np.zeros(1, dtype=bool), none_at(1), none_at(1, upper=True)
    )
    assert held == pytest.approx([2.0])
    free = _fit_multipliers(
        matrix, np.array([2.0]), exact, np.zeros(1, dtype=bool), none_at(1), none_at(1, upper=True)
    )
    assert free == pytest.approx([0.0])
    lower = _fit_multipliers(
        matrix, np.array([2.0]), exact, np.zeros(1, dtype=bool), none_at(1), none_at(1, lower=True)
    )
    assert lower == pytest.approx([-2.0])
    assert _fit_multipliers(
        matrix, np.array([2.0]), exact, np.zeros(1, dtype=bool), none_at(1), none_at(1)
    ) == pytest.approx([0.0])


def test_a_variable_on_its_limit_frees_its_row_while_it_pushes() -> None:
    """Gradients (1, g) and one equality: y = -1 by the free variable, and g - 1 is left to the other's limit."""
    matrix, exact = sparse(np.ones((2, 1))), np.zeros(2, dtype=bool)
    rows = none_at(1, lower=True, upper=True)
    at_lower = _ActiveSet(np.array([False, True]), np.zeros(2, dtype=bool))
    assert _fit_multipliers(
        matrix, np.array([1.0, 3.0]), exact, np.zeros(1, dtype=bool), at_lower, rows
    ) == pytest.approx([-1.0])
    # -(g - 1) > 0 is no multiplier of a lower limit: its row is imposed as well, and the least squares are -0.5.
    assert _fit_multipliers(
        matrix, np.array([1.0, 0.0]), exact, np.zeros(1, dtype=bool), at_lower, rows
    ) == pytest.approx([-0.5])
    at_upper = _ActiveSet(np.zeros(2, dtype=bool), np.array([False, True]))
    assert _fit_multipliers(
        matrix, np.array([1.0, 0.0]), exact, np.zeros(1, dtype=bool), at_upper, rows
    ) == pytest.approx([-1.0])
    assert _fit_multipliers(
        matrix, np.array([1.0, 3.0]), exact, np.zeros(1, dtype=bool), at_upper, rows
    ) == pytest.approx([-2.0])


def program(
    jacobian: Array, hessian: Array, lower: Any, upper: Any, x: Array, bends: tuple[Array, ...] = ()
) -> ProgramPoint:
    """A point without phases; all rows are equalities, and ``bends`` their Hessians."""
    n, m = x.size, len(jacobian)
    box = Interval(np.asarray(lower, float), np.asarray(upper, float))
    rows = Interval(np.zeros(m), np.zeros(m))

    def of_rows(objective: float, multipliers: Array) -> Any:
        return sparse(
            objective * hessian + sum((w * b for w, b in zip(multipliers, bends, strict=False)), 0 * hessian)
        )

    point: Any = SimpleNamespace(
        x=x,
        lam=np.zeros(m),
        constraint_values=np.zeros(m),
        rounding=0.0,
        constraint_jacobian=sparse(jacobian),
        lagrangian_hessian=sparse(hessian),
        hessian_of=of_rows,
        scaling=SimpleNamespace(objective=0.25, variables=np.ones(n)),
        variables=ProgramLimits(box, np.zeros(n, dtype=bool), np.zeros(n), tuple(f"z{i}" for i in range(n))),
        rows=ProgramLimits(rows, np.ones(m, dtype=bool), np.zeros(m), tuple(f"row {i}" for i in range(m))),
        transcription=SimpleNamespace(parts={}, constraint_rows=np.arange(m)),
    )
    return point


@pytest.fixture
def metric(monkeypatch: pytest.MonkeyPatch) -> Array:
    weights = np.array([1.0, 4.0, 0.25, 1.0, 2.0])
    monkeypatch.setattr(null_space, "compute_variation_norm_weights", lambda transcription: weights)
    return weights


def test_least_curvature_is_an_eigenvalue_of_the_reduced_hessian(metric: Array) -> None:
    """Of five variables one is held, and one row; variations are measured by the weights."""
    jacobian, free_box = np.array([[1.0, 2.0, 0.0, -1.0, 3.0]]), np.full(5, 9.0)
    hessian = np.diag([4.0, 3.0, 2.0, -4.0, 5.0]) + 0.5
    point = program(jacobian, hessian, -free_box, free_box, np.zeros(5))
    held = np.array([False, False, True, False, False, True])
    found = minimise_curvature(point, held)
    free = ~held[:5]
    root = 1 / np.sqrt(metric[free])
    scaled = hessian[np.ix_(free, free)] * np.outer(root, root)
    z = scipy.linalg.null_space(jacobian[:, free] * root)
    values, vectors = np.linalg.eigh(z.T @ scaled @ z)
    typical = np.median(np.linalg.norm(scaled, axis=1))
    assert found.value == pytest.approx(values[0] / typical, rel=1e-4) and values[0] < 0
    direction = np.zeros(5)
    direction[free] = root * (z @ vectors[:, 0])
    largest = np.max(np.abs(direction))
    np.testing.assert_allclose(np.abs(found.direction), np.abs(direction) / largest, atol=2e-3)
    assert found.gain == pytest.approx(-0.5 * values[0] * (0.1 / largest) ** 2 / 0.25, rel=2e-3)
    unit = z @ vectors[:, 0]
    assert found.share == pytest.approx(values[0] / (np.abs(unit) @ np.abs(scaled) @ np.abs(unit)), rel=2e-3)


def test_least_curvature_of_what_curves_upwards_and_of_nothing(metric: Array) -> None:
    jacobian, wide = np.array([[1.0, 2.0, 0.0, -1.0, 3.0]]), np.full(5, 9.0)
    point = program(jacobian, np.diag(metric * [3.0, 5.0, 2.0, 7.0, 1.0]), -wide, wide, np.zeros(5))
    loose = minimise_curvature(point, np.array([False] * 5 + [False]))
    assert loose.value == pytest.approx(1.0 / 3.0, rel=1e-4)  # the rows are 1, 2, 3, 5 and 7
    assert np.argmax(np.abs(loose.direction)) == 4
    point.rounding = 6.0  # rows of less than that are none
    assert minimise_curvature(point, np.array([False] * 6)).value == pytest.approx(1.0 / 6.0, rel=1e-4)
    point.rounding = 0.0
    assert loose.is_positive and loose.gain < 0
    assert np.isnan(minimise_curvature(point, np.array([True] * 5 + [False])).value)
    bare = program(jacobian, np.diag(metric * [3.0, 5.0, 0.0, 7.0, -1.0]), -wide, wide, np.zeros(5))
    assert minimise_curvature(bare, np.zeros(6, dtype=bool)).value == pytest.approx(-1.0 / 4.0, rel=1e-4)
    one = minimise_curvature(
        point, np.array([True, True, False, True, True, True])
    )  # the row says nothing of z2
    assert one.value == pytest.approx(1.0)
    assert np.isnan(minimise_curvature(point, np.array([False, True, True, True, True, True])).value)


@pytest.mark.parametrize(("amount", "told"), [(4.9e4, True), (5.1e4, False)])
def test_a_step_that_gains_only_rounding_is_not_reported_to_curve_downwards(
    metric: Array, amount: float, told: bool
) -> None:
    """-z3^2 / 2 takes 0.005 off the scaled cost for a step of 0.1: 1e-7 of 5e4."""
    wide = np.full(5, 9.0)
    point = program(np.ones((1, 5)), np.diag(metric * [3.0, 5.0, 2.0, -1.0, 1.0]), -wide, wide, np.zeros(5))
    point.rounding = 1e-4 * amount
    found = minimise_curvature(point, np.zeros(6, dtype=bool))
    assert found.gain == pytest.approx(0.005 / 0.25, rel=1e-6)
    assert found.value == pytest.approx(-1 / point.rounding, rel=1e-4)
    assert found.is_negative(1e-4) is told


def test_what_is_held_and_what_may_leave_to_one_side() -> None:
    """z0 free, z1 and z2 pushed to their lower and upper limit, z3 at one without a push, z4 given."""
    lower, upper = [-9.0, 0.0, -9.0, 0.0, 2.0], [9.0, 9.0, 1.0, 9.0, 2.0]
    point: Any = program(np.zeros((1, 5)), np.eye(5), lower, upper, np.array([1.0, 0.0, 1.0, 1e-7, 2.0]))
    point.multiplier_densities = np.array([0.0, -0.5, 0.5, -1e-8, 0.0]), np.zeros(1)
    cone = CriticalCone.from_program_point(point)
    np.testing.assert_array_equal(cone.strong, [False, True, True, False, True, True])
    np.testing.assert_array_equal(cone.weak, [False, False, False, True, False, False])
    inwards, outwards = np.eye(5)[3], -np.eye(5)[3]
    assert cone.is_direction_in_cone(inwards, []) and not cone.is_direction_in_cone(outwards, [])
    assert cone.is_direction_in_cone(0.009 * outwards, []) and cone.is_direction_in_cone(np.eye(5)[0], [])
    point.variables = replace(
        point.variables, box=Interval(np.array(lower), np.array([9.0, 9.0, 1.0, 1e-6, 2.0]))
    )
    point.x = np.array([1.0, 0.0, 1.0, 9e-7, 2.0])
    nearer = CriticalCone.from_program_point(point)  # to the upper limit
    assert nearer.weak[3] and nearer.is_direction_in_cone(outwards, [])
    assert not nearer.is_direction_in_cone(inwards, [])


@pytest.mark.parametrize(("first", "fixed"), [(0, False), (1, True), (2, False), (4, False)])
def test_a_limit_with_a_multiplier_holds_its_line(
    first: int, fixed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """z3 without a multiplier at the lower limit 0, beside z0 free, z1 and z2 with one at 0 and at 1, z4 given."""
    lower, upper = [-9.0, 0.0, -9.0, 0.0, 0.0], [9.0, 9.0, 1.0, 9.0, 0.0]
    point: Any = program(np.zeros((1, 5)), np.eye(5), lower, upper, np.array([1e-7, 0.0, 1.0, 1e-7, 0.0]))
    point.multiplier_densities = np.array([0.0, -0.5, 0.5, -1e-8, 0.0]), np.zeros(1)
    lines = [np.array([first, 3])], []
    monkeypatch.setattr(critical_cone, "_list_nlp_variables_along_segments", lambda _: lines)
    cone = CriticalCone.from_program_point(point)
    assert cone.strong[3] is np.bool_(fixed) and cone.weak[3] is np.bool_(not fixed)


def test_peaks_of_integrated_variations_do_not_count(metric: Array) -> None:
    """z0 = v0 + 2 v1: along v1, which curves downwards, z1 has the size 1."""
    wide, unit = np.full(5, 9.0), np.eye(5)
    unit[0, 1] = 2.0
    point = program(np.zeros((0, 5)), np.diag([0.1, -10.0, 5.0, 5.0, 5.0]), -wide, wide, np.zeros(5))
    found = minimise_curvature(point, np.zeros(5, dtype=bool), sparse(unit))
    np.testing.assert_allclose(np.abs(found.direction[:2]), [2.0, 1.0], rtol=0.02)
    assert found.gain == pytest.approx(0.5 * 9.6 * 0.1**2 / 0.25, rel=0.02)
    assert found.value == pytest.approx(-9.6 / 2.5, rel=0.02)  # relative to rows of single variables
    unit[1, 0] = 1e-13  # where every quantity depends on several variations, all of them count
    point = program(np.zeros((0, 5)), np.diag([-10.0, 0.0, 5.0, 5.0, 5.0]), -wide, wide, np.zeros(5))
    held = np.array([False, False, True, True, True])
    found = minimise_curvature(point, held, sparse(unit[:, :2] @ [[0.5, 0.0], [0.0, 1e-14]]))
    assert np.max(np.abs(found.direction)) == pytest.approx(1.0)
