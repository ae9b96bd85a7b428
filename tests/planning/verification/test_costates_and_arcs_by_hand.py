"""Costates and arcs constructed by hand: affine controls, arcs on limits, jumps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from testing import constructed_solutions as by_hand
from testing.given_scales import given_scales
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.numerical_tolerances import ACTIVE, AT_LIMIT
from gnc_opt.planning import ConditionResult
from gnc_opt.planning.optimality.active_state_constraints import compute_free_control_directions
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.verification import feasibility, goh_transformation
from gnc_opt.planning.verification import minimum_principle as controls
from gnc_opt.planning.verification import singular_arcs as singular
from gnc_opt.planning.verification.bang_bang_second_order_conditions import (
    _compute_switching_sign_violation,
    _find_switching_function_touching_zero,
)
from gnc_opt.planning.verification.costate_conditions import (
    _check_costate_jumps_at_state_bounds,
    _check_time_transversality,
    check_adjoint_equation,
    check_complementarity,
    check_parameter_stationarity,
    check_transversality,
)
from gnc_opt.planning.verification.goh_transformation import mask_singular_segments
from gnc_opt.planning.verification.singular_arcs import SingularArc, analyse_singular_arcs
from gnc_opt.planning.verification.solution_data_check import get_endpoint_gradients, recompute_stored_data

# Controls between their bounds, by hand: which arcs are singular, what determines them, what misses its
# minimum.


Array = NDArray[np.float64]
TOLERANCE = 1e-5


def pair(bend: float = 0.0, cost: float = 1.0) -> go.Problem:
    """x' = u, y' = w at ``cost`` times the integral of x + bend u^2 / 2 + w^2 / 2; a path p = x + y."""
    model, x, y, u, w = dynamics("pair", "x y", "u w", lambda x, y, u, w: {x: u, y: w})
    problem, leg = one_phase("pair", model, 0.0, 2.0)
    leg.path("p", x + y, upper=100.0)
    problem.minimize(leg.integral(cost * (x + bend * u**2 / 2 + w**2 / 2)))
    return problem


@pytest.mark.parametrize(("sign", "wrong"), [(1.0, 0.0), (-1.0, 1.0)])
def test_sign_of_a_switching_function_between_unequal_bounds(sign: float, wrong: float) -> None:
    """u falls from 1 to 0 at 1 s, where its switching function t - 1 changes its sign; as a share of H."""
    s = by_hand.samples(
        pair(),
        lambda t, k: np.array([1 + t, 2 - t]),
        lambda t, k: np.array([1.0 - k + 0 * t, 0 * t]),
        lambda t, k: np.array([sign * (t - 1), 0 * t]),
        weights=(0.0,),
        breaks=(0.0, 1.0, 2.0),
        control_bounds=by_hand.interval([0.0, -3.0], [1.0, 3.0]),
    )
    violation = _compute_switching_sign_violation(s, 0, np.array([1.0]), 1.0)
    assert violation == pytest.approx(wrong, abs=1e-9)


@pytest.mark.parametrize("pull", [(1.0, -2.0, 1.0), (1.1, -2.0, 1.0), (1e-9, 1e-9)])
def test_a_switching_function_that_touches_zero_is_found_where_it_does(pull: tuple[float, ...]) -> None:
    """At the upper bound it is -(t - 1)^2, below that, or falls, with a rounding error where segments meet."""
    s = by_hand.samples(
        pair(),
        lambda t, k: np.array([1 + t, 2 - t]),
        lambda t, k: np.array([1.0 + 0 * t, 0 * t]),
        lambda t, k: np.array([1e-20 * k - np.polynomial.Polynomial(pull)(t), 0 * t]),
        weights=(0.0,),
        breaks=(0.0, 1.0, 3.0),
        control_bounds=by_hand.interval([0.0, -3.0], [1.0, 3.0]),
    )
    found = _find_switching_function_touching_zero(s)
    assert found == ("phase leg, t = 1 s, u: zero between switches" if pull[0] == 1.0 else "")


BOX = by_hand.interval([-1.0, -3.0], [1.0, 3.0])


def flown(
    problem: go.Problem | None = None,
    *,
    u: tuple[float, float] = (1.0, 0.0),
    lam: tuple[float, float] = (-1.0, 0.0),
    cost: float = 1.0,
    **changes: Any,
) -> PhaseSamples:
    """u and its costate, one value per segment; w = t - 1 with the costate 1 - t, over 2 s that part at 0.5 s."""
    return by_hand.samples(
        pair(cost=cost) if problem is None else problem,
        lambda t, k: np.array([1 + t, 2 - t]),
        lambda t, k: np.array([u[k] + 0 * t, t - 1]),
        lambda t, k: cost * np.array([lam[k] + 0 * t, 1 - t]),
        weights=(1.0,),
        **({"breaks": (0.0, 0.5, 2.0), "control_bounds": BOX} | changes),
    )


@pytest.fixture
def arcs(monkeypatch: pytest.MonkeyPatch) -> Any:
    """What is asked about arcs: singular controls, regular ones, first and last time."""

    def judge(problem: Any, s: PhaseSamples, channels: Array, regular: Array, here: Array, tol: float) -> Any:
        assert tol == TOLERANCE and np.all(np.diff(here) == 1)
        return channels.tolist(), regular.tolist(), float(s.times[here[0]]), float(s.times[here[-1]])

    monkeypatch.setattr(singular, "_analyse_singular_arc", judge)
    none: Any = None
    return lambda s: analyse_singular_arcs(
        none, s, *controls.mask_undetermined_controls(s, TOLERANCE), TOLERANCE
    )


LATE = [([0], [1], 0.5, 2.0)]
"""u is singular in the second segment, w is not."""


def test_a_singular_arc_is_between_bounds_without_slope_and_curvature(arcs: Any) -> None:
    assert arcs(flown()) == LATE
    assert arcs(flown(u=(0.3, 0.0))) == LATE  # a slope of -1 before it
    assert arcs(flown(u=(-1.0, 0.0), lam=(0.0, 0.0))) == LATE  # no slope, on the lower bound
    assert arcs(flown(u=(1.0, 0.0), lam=(0.0, 0.0))) == LATE  # on the upper bound
    assert arcs(flown(u=(0.5, 0.0), lam=(0.0, 0.0))) == [([0], [1], 0.0, 2.0)]
    assert arcs(flown(u=(1.0, 1.0))) == []
    assert arcs(flown(lam=(-1.0, 0.1))) == []


def test_segments_on_which_a_control_is_singular() -> None:
    assert mask_singular_segments(flown()).tolist() == [[False, True], [False, False]]
    assert mask_singular_segments(flown(u=(0.5, 0.0), lam=(0.0, 0.0))).tolist() == [
        [True, True],
        [False, False],
    ]


def test_near_a_bound_is_a_hundredth_of_the_range(arcs: Any) -> None:
    for value, between in ((0.985, False), (0.975, True), (-0.985, False), (-0.975, True)):
        assert arcs(flown(u=(1.0, value))) == (LATE if between else [])


@pytest.mark.parametrize("cost", [1.0, 1e6, 1e-6])
def test_slope_and_curvature_vanish_in_shares_of_the_hamiltonian(arcs: Any, cost: float) -> None:
    """Over the range that u is worth having, in any unit of the cost."""
    straight, bent = flown(cost=cost), flown(pair(TOLERANCE, cost), cost=cost)
    sloping = straight.hamiltonian_change_by_control[0] / straight.control_span[0] / cost
    bending = bent.hamiltonian_change_by_control[0] / bent.control_span[0] ** 2 / cost
    for factor, told in ((0.9, True), (1.2, False)):
        problem = pair(factor * TOLERANCE * bending, cost)
        found = arcs(flown(problem, cost=cost))
        assert (found == LATE) is told, found
        for sign in (1.0, -1.0):
            slope = sign * factor * TOLERANCE * sloping
            assert (arcs(flown(lam=(-1.0, slope), cost=cost)) == LATE) is told


def test_controls_that_limits_determine_are_not_singular(arcs: Any) -> None:
    """A path at its limit that pushes by a ten-thousandth of the cost over the phase of 2 s."""
    base = flown()
    least = 1e-4 * base.cost_scale / (base.path_scale[0] * 2.0)
    for factor, told in ((0.9, LATE), (1.1, [])):
        for sign in (1.0, -1.0):
            mu = sign * factor * least
            for limit, found in ((3.0, told), (4.0, LATE)):  # x + y = 3 all along
                path = Interval(np.array([-np.inf]), np.array([limit]))
                s = flown(paths=lambda t, k, mu=mu: np.array([mu + 0 * t]), path_bounds=path)
                assert arcs(s) == found


def test_what_other_controls_do_divides_arcs(arcs: Any) -> None:
    """Where w is on its bound, it is regular no more; u is singular all along."""
    for breaks, found in (
        ((0.0, 0.5, 2.0), [([0], [1], 0.0, 0.5), ([0], [], 0.5, 2.0)]),
        ((0.0, 0.5, 1.0, 2.0), [([0], [1], 0.0, 0.5), ([0], [], 0.5, 1.0), ([0], [1], 1.0, 2.0)]),
    ):
        s = by_hand.samples(
            pair(),
            lambda t, k: np.array([1 + t, 2 - t]),
            lambda t, k: np.array([0 * t, -3.0 * (k == 1) + 0 * t]),
            lambda t, k: np.array([0 * t, 1 - t]),
            weights=(1.0,),
            breaks=breaks,
            control_bounds=BOX,
        )
        assert arcs(s) == found


def test_arcs_of_few_samples_are_switches(arcs: Any) -> None:
    """u is farther than a hundredth of its range from its bound at the first one or two of 15 samples: for an instant
    only, or for longer than the 1e-4 of the phase over which a switch may be smeared."""
    times = flown(breaks=(0.0, 2.0)).times
    for n, told in ((1, False), (2, True)):
        steep = 0.02 / ((times[n - 1] - 2) * (times[n] - 2))
        s = by_hand.samples(
            pair(),
            lambda t, k: np.array([1 + t, 2 - t]),
            lambda t, k, c=steep: np.array([1 - c * (2 - t) ** 2, 0 * t]),
            lambda t, k: np.array([0 * t, 1 - t]),
            weights=(1.0,),
            breaks=(0.0, 2.0),
            control_bounds=BOX,
        )
        assert arcs(s) == ([([0], [1], 0.0, times[n - 1])] if told else [])


@pytest.mark.parametrize(("sign", "why"), [(1.0, ""), (-1.0, "")])
def test_an_arc_that_fails_needs_no_excuse(sign: float, why: str) -> None:
    """x' = u at the cost of sign x^2: K = 2 sign over the ranges 2 of u and 1.5 s, in shares of H."""
    model, x, _u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("integrator", model, 0.0, 2.0)
    problem.minimize(leg.integral(sign * x**2))
    s = by_hand.samples(
        problem,
        lambda t, k: np.array([0 * t]),
        lambda t, k: np.array([1.0 - k + 0 * t]),
        lambda t, k: np.array([k - 1.0 + 0 * t]),
        weights=(1.0,),
        breaks=(0.0, 0.5, 2.0),
        control_bounds=by_hand.interval(-1.0, 1.0),
    )
    (arc,) = analyse_singular_arcs(problem, s, *controls.mask_undetermined_controls(s, TOLERANCE), TOLERANCE)
    expected = sign * 2.0 * 4.0 * 1.5**2 / s.hamiltonian_scale
    assert arc == SingularArc("phase leg, u from 0.5 to 2 s", 1, pytest.approx(expected), why)
    assert np.array_equal(np.arange(*arc.samples), np.flatnonzero(s.segments == 1))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_sign_of_an_arc_of_second_order(sign: float) -> None:
    """x'' = u at the cost of sign x^2: the fourth derivative of H_u is 2 sign u, over the ranges 2 of u and 3 s."""
    model, x, *_ = dynamics("cart", "x y", "u", lambda x, y, u: {x: y, y: u})
    problem, leg = one_phase("cart", model, 0.0, 3.0)
    problem.minimize(leg.integral(sign * x**2))
    none = [lambda t, k, rows=rows: np.zeros((rows, t.size)) for rows in (2, 1, 2)]
    s = by_hand.samples(
        problem, *none, weights=(1.0,), breaks=(0.0, 3.0), control_bounds=by_hand.interval(-1.0, 1.0)
    )
    (arc,) = analyse_singular_arcs(problem, s, *controls.mask_undetermined_controls(s, TOLERANCE), TOLERANCE)
    expected = sign * 2.0 * 4.0 * 3.0**4 / s.hamiltonian_scale
    assert (arc.order, arc.least) == (2, pytest.approx(expected))


@pytest.mark.parametrize("share", [1.0, 1e-3])
def test_controls_that_curve_h_together_are_not_affine(share: float) -> None:
    """u w has no curvature in either: where both rest at zero, the arc's first derivative is of order zero."""
    model, x, _y, u, w = dynamics("pair", "x y", "u w", lambda x, y, u, w: {x: u, y: w})
    problem, leg = one_phase("pair", model, 0.0, 2.0)
    problem.minimize(leg.integral(x + share * u * w))
    s = by_hand.samples(
        problem,
        lambda t, k: np.array([1 + t, 2 - t]),
        lambda t, k: np.zeros((2, t.size)),
        lambda t, k: np.zeros((2, t.size)),
        weights=(1.0,),
        breaks=(0.0, 2.0),
        control_bounds=BOX,
    )
    (arc,) = analyse_singular_arcs(problem, s, *controls.mask_undetermined_controls(s, TOLERANCE), TOLERANCE)
    assert arc == SingularArc("phase leg, u, w from 0 to 2 s", 0, 0.0, singular.NOT_AFFINE)


def test_directions_that_constraints_take_are_measured_in_the_controls_units() -> None:
    """3 u + w x + x = c along: in units (2, 0.5) what is left is orthogonal to (6, 0.5 x)."""
    model, x, _y, u, w = dynamics("pair", "x y", "u w", lambda x, y, u, w: {x: u, y: w})
    problem, leg = one_phase("pair", model, 0.0, 2.0)
    leg.path("p", 3 * u + w * x + x, upper=7.0)
    problem.minimize(leg.final_state("x"))
    s = by_hand.samples(
        problem,
        lambda t, k: np.array([1 + t, t]),
        lambda t, k: np.array([(7 - 0.5 * (k == 0) - 2 * (1 + t)) / 3, 1 + 0 * t]),
        lambda t, k: np.array([1 + t, t]),
        weights=(),
        breaks=(0.0, 0.5, 2.0),
    )
    every = np.ones((2, s.times.size), dtype=bool)
    for j, basis in enumerate(compute_free_control_directions(s, every, np.array([2.0, 0.5]))):
        if s.segments[j] == 0:  # the limit is half away
            np.testing.assert_allclose(basis, np.eye(2))
        else:
            assert basis.shape == (2, 1)
            row = np.array([6.0, 0.5 * (1 + s.times[j])])
            assert np.linalg.norm(basis) == pytest.approx(1.0) and abs(row @ basis[:, 0]) < 1e-12
    alone = every.copy()
    alone[0] = False
    assert [b.shape for b in compute_free_control_directions(s, alone, np.ones(2))] == [
        (2, 1 - k) for k in s.segments
    ]


@pytest.mark.parametrize(("row", "channel"), [(0, 0), (1, 1)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_state_limit_takes_its_control_where_it_pushes_for_a_while(
    row: int, channel: int, side: float
) -> None:
    """In the second segment one state rests at 1, to a hundred-thousandth of the 1 that it moves; of two, only it."""

    def states(t: Array, k: int) -> Array:
        x = np.array([t, t])
        x[row] = np.where(k == 0, side * (1 - (1 - 2 * t)), side)
        return x

    def samples(push: float, off: float, segment: int = 1) -> PhaseSamples:
        z = np.zeros((2, 1))
        z[row] = push
        lower, upper = np.full(2, -99.0), np.full(2, 99.0)
        if side > 0:
            upper[row] = 1.0 + off
        else:
            lower[row] = -1.0 - off
        return by_hand.samples(
            pair(),
            states,
            lambda t, k: np.array([2.0 - 2 * k + 0 * t, 1.0 + 0 * t]),
            lambda t, k: np.array([1 + t, 1 - t]),
            states=lambda t, k: z * (k == segment) + 0 * t,
            weights=(1.0,),
            breaks=(0.0, 0.5, 2.0),
            state_bounds=by_hand.interval(lower, upper),
        )

    base = samples(0.0, 0.0)
    every = np.ones((2, base.times.size), dtype=bool)
    least = 1e-4 * base.cost_scale / 2.0 / base.state_scale[row]
    moved = ACTIVE * base.state_scale[row]
    for push, off, told in (
        (1.1 * least, 0.0, True),
        (-1.1 * least, 0.0, True),
        (0.9 * least, 0.0, False),
        (1.1 * least, 0.9 * moved, True),
        (1.1 * least, 1.1 * moved, False),
    ):
        s = samples(push, off)
        for j, basis in enumerate(compute_free_control_directions(s, every, np.ones(2))):
            if told and s.segments[j] == 1:
                assert basis.shape == (2, 1) and abs(basis[channel, 0]) < 1e-12
            else:
                np.testing.assert_allclose(basis, np.eye(2))
    touched = samples(5.0, 0.0, segment=0)  # it pushes at the end of the first segment only, where it touches
    assert all(b.shape == (2, 2) for b in compute_free_control_directions(touched, every, np.ones(2)))


def test_no_control_between_its_bounds_is_a_sufficient_pass() -> None:
    box = by_hand.interval([1.0, 2.0], [1.0, 2.0])
    s = flown(u=(1.0, 1.0), control_bounds=by_hand.interval([-1.0, -9.0], [1.0, 9.0]))
    s = PhaseSamples.from_phase(replace(s.phase, control_bounds=box), s.functions)
    condition = controls.check_legendre_clebsch(
        [s], TOLERANCE, [controls.mask_undetermined_controls(s, TOLERANCE)[0]]
    )
    assert condition.result is ConditionResult.PASS and condition.sufficient
    assert (condition.value, condition.tolerance, condition.where) == (
        0.0,
        0.0,
        "no control between its limits",
    )


@pytest.mark.parametrize("bend", [2.0, 0.0, -2.0])
def test_least_curvature_over_the_spans(bend: float) -> None:
    """bend u^2 / 2 + w^2 / 2 + u w / 2, along the flight and in shares of what half the spans are worth."""
    model, _x, _y, u, w = dynamics("pair", "x y", "u w", lambda x, y, u, w: {x: u, y: w})
    problem, leg = one_phase("pair", model, 0.0, 2.0)
    problem.minimize(leg.integral(bend * u**2 / 2 + w**2 / 2 + u * w / 2 * ca.exp(-model.time)))
    s = flown(
        problem, u=(0.5, -0.5), lam=(-1.0, 0.5), control_bounds=by_hand.interval([-9.0, -9.0], [9.0, 9.0])
    )
    unit = s.control_span / np.sqrt(s.hamiltonian_change_by_control)
    least = []
    for t in s.times:
        hessian = np.array([[bend, np.exp(-t) / 2], [np.exp(-t) / 2, 1.0]]) * np.outer(unit, unit)
        least.append(np.linalg.eigvalsh(hessian)[0])
    condition = controls.check_legendre_clebsch(
        [s], TOLERANCE, [controls.mask_undetermined_controls(s, TOLERANCE)[0]]
    )
    assert condition.value == pytest.approx(-min(least), rel=1e-9) and condition.tolerance == -TOLERANCE
    assert condition.result is (ConditionResult.PASS if min(least) > 0 else ConditionResult.FAIL)
    assert condition.sufficient
    assert condition.where.startswith("phase leg, t = 0 s")


@pytest.mark.parametrize(
    ("off", "step", "lam", "value", "words"),
    [
        ((0.0, 0.5), 0.0, 0.1, 0.75 / 2, ("segment 2", "x")),
        ((0.8, -0.2), 0.0, 0.1, 0.4 / 2, ("segment 1", "x")),
        ((0.0, 0.0), 0.6, 0.1, 0.6 / 2, ("segment 1", "x")),
        ((0.0, 0.5), 0.0, 10.0, 7.5 / 4, ("segment 2", "effect on the cost")),
        ((0.8, 0.2), 0.0, -10.0, 7.0 / 4, ("segment 2", "effect on the cost")),
        ((0.8, -0.2), 0.0, 10.0, 4.0 / 4, ("segment 1", "effect on the cost")),
        ((4e-4, 0.0), 0.0, 0.1, 2e-4 / 2, ("segment 1", "x")),
    ],
)
def test_defects_are_displacements_or_their_effect_on_the_cost(
    off: tuple[float, float], step: float, lam: float, value: float, words: tuple[str, ...]
) -> None:
    """x' = u + off over 0.5 s and 1.5 s, with a step between: over the reach 2, or times lam over the cost 4."""
    model, _x, u = dynamics("one", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("one", model, 0.0, 2.0)
    problem.minimize(leg.integral(u**2))
    s = by_hand.samples(
        problem,
        lambda t, k: np.array([t + step * k]),
        lambda t, k: np.array([1.0 - off[k] + 0 * t]),
        lambda t, k: np.array([lam + 0 * t]),
        weights=(1.0,),
        breaks=(0.0, 0.5, 2.0),
        control_bounds=by_hand.interval(-9.0, 9.0),
    )
    found = feasibility.check_dynamics([s], given_scales([s], cost=4.0, radius=2.0), 1e-8)
    assert found.value == pytest.approx(value, rel=1e-6) and found.result is ConditionResult.FAIL
    assert all(word in found.where for word in words) and "switch" not in found.where


@pytest.mark.parametrize(
    ("order", "least", "why", "curved"),
    [
        (0, 0.0, singular.NOT_AFFINE, True),
        (0, 0.0, f"{singular.TOO_LARGE} 4", False),
        (0, 0.0, singular.COUPLED, False),
        (0, -1e-3, f"{singular.COUPLED}, and both curve", True),
        (1, 0.0, "K of order 1 is singular", False),
        (0, -0.5, "", False),  # Goh's condition fails
    ],
)
def test_arcs_with_curvature_in_the_controls_are_not_varied_by_integrals(
    order: int, least: float, why: str, curved: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    s = flown()
    late = int(np.argmax(s.segments == 1)), s.times.size
    arc = singular.SingularArc("place", order, least, why, channels=(1,), samples=late)
    monkeypatch.setattr(goh_transformation, "analyse_singular_arcs", lambda *_: [arc])
    found = goh_transformation._mask_segments_with_control_curvature(pair(), s)
    np.testing.assert_array_equal(found, [[False, False], [False, curved]])


@pytest.mark.parametrize(
    ("value", "slope", "room"),
    [
        (0.25, 2.0, 1.25),
        (0.25, -2.0, 0.75),
        (1.0, -2.0, 0.0),
        (1.0, 2.0, 2.0),
        (-1.0, 2.0, 0.0),
        (-1.0, -2.0, 2.0),
        (1.0 - 1.5e-6, -2.0, 0.0),
        (1.0 - 2.5e-6, -2.0, 2.5e-6),
    ],
)
def test_loss_is_slope_times_room_of_the_control(value: float, slope: float, room: float) -> None:
    """To the bound to which the slope points, at most the span; a bound is reached within 1e-6 of the range 2."""
    s = flown(u=(value, value), lam=(slope, slope))
    loss, on_bound = controls._estimate_hamiltonian_decreases(s, s.control_span[:, None], s.control_scale)
    np.testing.assert_allclose(loss[0], 2.0 * min(room, s.control_span[0]), atol=1e-9)
    assert np.all(on_bound[0] == (abs(value) > 1.0 - 2e-6)) and not np.any(on_bound[1])


# Figures of trajectories given by hand, with switches or smooth, in two phases that do not begin at zero,
# are shares.
#
# Neither trajectory obeys anything: every condition has something to tell. In other units, mirrored, from other origins
# and later, it tells the same of the same places.


@dataclass(frozen=True)
class Units:
    """How many of the new units one old unit is, for q, v, a, b, time and cost; and where the old origins are."""

    unit: tuple[float, ...] = (1.0,) * 6
    origin: tuple[float, ...] = (0.0,) * 6

    def new(self, i: int, old: Any) -> Any:
        return (old + self.origin[i]) * self.unit[i]

    def old(self, i: int, new: Any) -> Any:
        return new / self.unit[i] - self.origin[i]

    def range(self, i: int, low: float, high: float) -> tuple[float, float]:
        ends = sorted((self.new(i, low), self.new(i, high)))
        return ends[0], ends[1]


Q, V, A, B, T, COST = range(6)
OTHERS = {
    "mixed": Units((50.0, 0.04, 0.2, 30.0, 1.0, 1.0)),
    "elsewhere": Units(origin=(0.0, 0.0, 0.0, 0.0, 70.0, 9.0)),
    "all": Units((-3.0, 0.2, 7.0, -0.5, 0.1, 8.0), (3.0, -7.0, 2.0, 5.0, -40.0, -200.0)),
}


def problem_in(units: Units, smooth: bool) -> go.Problem:
    """q' = v + b / 5, v' = a - sin(q) / 10 + t / 20; linked phases, one of which is limited along the way."""
    model = go.Model("cart")
    states, inputs = (model.state("q"), model.state("v")), (model.control("a"), model.control("b"))
    q, v, a, b = (units.old(i, s) for i, s in enumerate((*states, *inputs)))
    t = units.old(T, model.time)
    rates = v + b / 5, a - ca.sin(q) / 10 + t / 20
    speed = [units.unit[i] / units.unit[T] for i in (Q, V)]
    model.ode({state: rate * s for state, rate, s in zip(states, rates, speed, strict=True)})
    problem = go.Problem("by hand")
    first, second = problem.phase("first", model), problem.phase("second", model)
    first.time(units.new(T, 0.3), units.range(T, 1.0, 2.0))
    second.time(units.range(T, 1.0, 2.0), units.range(T, 2.0, 5.0))
    costs = []
    for leg in (first, second):
        leg.bounds(a=units.range(A, -1.0, 1.0), b=units.range(B, 0.0, 3.0), v=units.range(V, -0.5, 1.2))
        leg.path("sum", q + v / 2, upper=1.9)
        running = (a**2 + b**2 / 7 if smooth else 0.1 * a + b / 5) + q**2 / 3
        costs.append(leg.integral(running * units.unit[COST] / units.unit[T]))
    first.initial(q=units.new(Q, 0.1))
    second.final(v=units.range(V, -0.1, 0.2))
    meeting = [
        units.old(i, second.initial_state(n)) - units.old(i, first.final_state(n)) for i, n in enumerate("qv")
    ]
    problem.constrain("meet", ca.vertcat(*meeting), equals=np.zeros(2))
    problem.constrain(
        "one after the other", (second.initial_time - first.final_time) / units.unit[T], equals=0.0
    )
    far = units.old(Q, second.final_state("q"))
    problem.constrain("far", far**2, lower=1.0, upper=9.0)
    price = 0.7 * units.old(T, second.final_time) + (far - 1.0) ** 2 + units.origin[COST]
    problem.minimize(costs[0] + costs[1] + price * units.unit[COST])
    return problem


Signal = Callable[[Array, int], Any]
BREAKS = {"first": (0.3, 0.6, 1.3), "second": (1.3, 1.7, 2.2, 3.0)}

SIGNALS: dict[bool, dict[str, tuple[Signal, Signal, Signal]]] = {
    False: {
        "first": (
            lambda t, k: np.array([0.1 + 0.5 * t, 0.3 + 0.1 * t**2]),
            lambda t, k: np.array([[1.0, -1.0][k] + 0 * t, [0.0, 3.0][k] + 0 * t]),
            lambda t, k: np.array([-0.4 + 0.1 * t, t - 0.7]),
        ),
        "second": (
            lambda t, k: np.array([0.2 + 0.45 * t, 0.4 + 0.2 * t - 0.06 * t**2]),
            lambda t, k: np.array([[-1.0, 1.0, 1.0][k] + 0 * t, [3.0, 3.0, 0.0][k] + 0 * t]),
            lambda t, k: np.array([-3.1 + t, 1.6 - t]),
        ),
    },
    True: {
        "first": (
            lambda t, k: np.array([0.1 + 0.5 * (t - 0.3), 0.5 + 0.3 * np.sin(t)]),
            lambda t, k: np.array([0.5 - 0.3 * t, 1.0 + t / 3]),
            lambda t, k: np.array([-1.1 + 0.1 * t, -1.0 + 0.6 * t + 0.05 * k]),
        ),
        "second": (
            lambda t, k: np.array(
                [0.1 + 0.5 * (t - 0.3), [0.9 + 0.75 * (t - 1.3), 1.2 + 0 * t, 1.2 - (t - 2.2) ** 2][k]]
            ),
            lambda t, k: np.array([0.4 - 0.2 * t, 1.2 + 0.1 * t]),
            lambda t, k: np.array([-1.3 + 0.2 * t, -0.8 + 0.3 * t - 0.1 * k]),
        ),
    },
}


def solution_in(units: Units, smooth: bool) -> go.Solution:
    """The trajectory in other units; multipliers push at the limit of v in the second phase."""
    problem = problem_in(units, smooth)
    legs = [leg_in(units, problem, name, smooth) for name in BREAKS]
    constraints = np.array([0.2, -0.1, 0.3, 0.001])
    bare = by_hand.solution(
        problem,
        *legs,
        objective=units.unit[COST] * (4.0 + units.origin[COST]),
        constraint_labels=problem.constraint_labels(),
        constraint_values=np.zeros(4),
        constraint_multipliers=units.unit[COST] * constraints,
    )
    return recompute_stored_data(bare)


def leg_in(units: Units, problem: go.Problem, name: str, smooth: bool) -> Any:
    cost, time = units.unit[COST], units.unit[T]
    x, u, lam = SIGNALS[smooth][name]
    state = np.array(units.unit[:2])[:, None]

    def of(signal: Signal, unit: Any, origin: Any) -> Signal:
        return lambda t, k: (signal(units.old(T, t), k) + np.array(origin)[:, None]) * np.array(unit)[:, None]

    pushes = np.array([0.0, 0.6])[:, None] * (cost / time / state)

    def pushing(t: Array, k: int) -> Array:
        return pushes * (smooth and name == "second" and k == 1) + 0 * t

    edges = tuple(units.new(T, t) for t in BREAKS[name])
    single = go.Problem("one")  # `by_hand.phase` reads a problem of one phase
    leg = problem.phases[name]
    single.phases[name] = leg
    values = by_hand.phase(
        single,
        of(x, units.unit[:2], units.origin[:2]),
        of(u, units.unit[2:4], units.origin[2:4]),
        of(lam, cost / np.array(units.unit[:2]), (0.0, 0.0)),
        breaks=edges,
        states=pushing,
        paths=lambda t, k: np.array([smooth * 0.01 * cost / time + 0 * t]),
    )
    inner = np.zeros_like(values.state_impulses)
    inner[:, 1] = 0.02 * cost / np.array(units.unit[:2])
    points = values.point_times.size
    return replace(
        values,
        state_impulses=inner,
        control_multipliers=np.full((2, points), 0.03) * cost / time / np.array(units.unit[2:4])[:, None],
        duration_multiplier=0.04 * cost / time,
    )


@cache
def usual(smooth: bool) -> go.Verdict:
    return go.verify(solution_in(Units(), smooth))


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("units", OTHERS.values(), ids=OTHERS)
def test_figures_of_a_trajectory_in_other_units(units: Units, smooth: bool) -> None:
    other = go.verify(solution_in(units, smooth))
    for condition in usual(smooth).conditions:
        twin = other[condition.name]
        assert twin.result is condition.result, condition.name
        if (
            condition.name != "second order" or not smooth
        ):  # whose sign counts: its variations are shares of sizes
            same = pytest.approx(condition.value, rel=1e-6, abs=1e-9, nan_ok=True)
            assert twin.value == same, (condition, twin)


@pytest.mark.parametrize("smooth", [False, True])
def test_every_condition_has_a_value(smooth: bool) -> None:
    silent = {c.name for c in usual(smooth).conditions if not abs(c.value) > 1e-6}
    never = {"limits", "cost", "kinks", "second order", "switching times"}
    assert silent <= never | ({"active set"} if smooth else {"stationarity", "second order"})


# Transversality, impulses, complementarity and the adjoint equation on trajectories given by hand.


FREE = by_hand.interval(-np.inf, np.inf)


def drifting(paths: bool = False) -> go.Problem:
    """x' = (1, u), and perhaps c = x_0 + 3 u and d = x_1."""
    model, x, u = dynamics("drift", "x:2", "u", lambda x, u: {x: ca.vertcat(1, u)})
    problem, leg = one_phase("drift", model, 0.0, 2.0)
    if paths:
        leg.path("mixed", x[0] + 3 * u, upper=100.0)
        leg.path("pure", x[1], upper=100.0)
    problem.minimize(3 * leg.final_state("x")[0] + 4 * leg.initial_state("x")[1] ** 2)
    return problem


def drift(problem: go.Problem, begin: float = 0.0, **changes: Any) -> PhaseSamples:
    """x = (1 + t, 2 - t^2), u = -2 t and costates (3 - t, 1 + 2 t) over 2 s, counted from the start."""
    values = {"breaks": (begin, begin + 0.5, begin + 2.0)} | changes
    lam = values.pop("lam", lambda t, k: np.array([3 - t, 1 + 2 * t]))
    return by_hand.samples(
        problem,
        lambda t, k: np.array([1 + t - begin, 2 - (t - begin) ** 2]),
        lambda t, k: np.array([-2 * (t - begin)]),
        lambda t, k: lam(t - begin, k),
        weights=(),
        **values,
    )


@pytest.mark.parametrize(("end", "off"), [("initial", 0.9), ("final", 0.9), ("initial", 1.1), ("final", 1.1)])
def test_a_free_time_is_at_its_limit_in_shares_of_the_range_of_its_limits(end: str, off: float) -> None:
    """Between -998 s - d and 1000 s, or -1000 s and -998 s + d: a time is within a millionth of 2000 s of its limit."""
    slack, begin = off * AT_LIMIT * 2000.0, -1000.0
    limits = (begin - slack, 1000.0) if end == "initial" else (-3000.0, begin + 2.0 + slack)
    changes: dict[str, Any] = {f"{end}_time_bounds": by_hand.interval(*limits)}
    # Of H = lam_0 + lam_1 u the initial value is 3 + 0, which a lower limit of the initial time cannot explain.
    sign = -1.0 if end == "initial" else 1.0
    s = drift(drifting(), begin, **changes, lam=lambda t, k: sign * np.array([3 - t, 1 + 2 * t]))
    ends = get_endpoint_gradients(by_hand.solution(drifting(), s.phase))
    found = _check_time_transversality(s, ends, np.zeros(2), given_scales([s], cost=4.0))
    level = 3.0 if end == "initial" else abs(1.0 - 5.0 * 4.0)
    if off > 1:
        assert found.value == pytest.approx(level * 2.0 / 4.0, rel=1e-9)  # over the 2 s, of a cost of 4
        assert found.where == f"phase leg, H at its {'start' if end == 'initial' else 'end'}"
    else:
        assert found.value == 0.0


@pytest.mark.parametrize(
    ("multiplier", "most", "value"), [(0.7, 3.0, 0.35), (0.7, 2.0, 0.0), (-0.7, 2.0, 0.35)]
)
def test_a_multiplier_of_the_duration_needs_an_active_bound(
    multiplier: float, most: float, value: float
) -> None:
    """Of the 2 s, over a cost of 4; a positive one needs the upper bound."""
    bounds = by_hand.interval(-np.inf, most)
    s = drift(drifting(), duration_bounds=bounds, duration_multiplier=multiplier)
    ends = get_endpoint_gradients(by_hand.solution(drifting(), s.phase))
    found = _check_time_transversality(s, ends, np.zeros(2), given_scales([s], cost=4.0))
    assert found.value == pytest.approx(value)


@pytest.mark.parametrize(
    ("end", "row", "bounds", "gap"),
    [
        # lam(0) = -d cost / dx(0) = (0, -16) where free; 3 and 1 are there.
        ("initial", 0, (-9.0, 9.0), 3.0),
        ("initial", 1, (-9.0, 9.0), 17.0),
        ("initial", 0, (1.0, 9.0), 0.0),  # lam(0) > 0 pushes from below
        ("initial", 0, (-9.0, 1.0), 3.0),
        # lam(2) = d cost / dx(2) = (3, 0); 1 and 5 are there.
        ("final", 0, (-9.0, 9.0), -2.0),
        ("final", 1, (-9.0, 9.0), 5.0),
        ("final", 1, (-9.0, -2.0), 0.0),  # the multiplier lam - d cost > 0 pushes from above
        ("final", 1, (-2.0, 9.0), 5.0),
        ("final", 0, (3.0, 9.0), 0.0),
        ("final", 0, (-9.0, 3.0), -2.0),
    ],
)
def test_costates_at_free_ends(end: str, row: int, bounds: tuple[float, float], gap: float) -> None:
    given = {"initial": np.array([1.0, 2.0]), "final": np.array([3.0, -2.0])}[end]
    lower, upper = given.copy(), given.copy()
    lower[row], upper[row] = bounds
    other = "final" if end == "initial" else "initial"
    fixed = {"initial": np.array([1.0, 2.0]), "final": np.array([3.0, -2.0])}[other]
    changes = {
        f"{end}_bounds": by_hand.interval(lower, upper),
        f"{other}_bounds": by_hand.interval(fixed, fixed),
    }
    s = drift(drifting(), **changes)
    scales = given_scales([s], cost=4.0, radius=3.0)
    ends = get_endpoint_gradients(by_hand.solution(drifting(), s.phase))
    condition = check_transversality([s], ends, scales)
    assert condition.value == pytest.approx(abs(gap) * 3.0 / 4.0, rel=1e-9)
    if gap:
        assert condition.where == f"phase leg, {'start' if end == 'initial' else 'end'}, costate of x[{row}]"
        # A limit along the whole phase exerts what one of the end does.
        along = by_hand.interval([-99.0, -99.0], [99.0, 99.0])
        along.lower[row], along.upper[row] = given[row] if gap < 0 else -99.0, given[row] if gap > 0 else 99.0
        if end == "initial":
            along.lower[row], along.upper[row] = given[row], 99.0
        held = PhaseSamples.from_phase(replace(s.phase, state_bounds=along), s.functions)
        ends = get_endpoint_gradients(by_hand.solution(drifting(), held.phase))
        assert check_transversality([held], ends, scales).value == 0.0


@pytest.mark.parametrize(
    ("impulse", "beside", "left"),
    [
        (-1.5, 2.0, 0.0),
        (-3.0, 2.0, 1.0),
        (1.0, 2.0, 1.0),
        (1.5, -2.0, 0.0),
        (3.0, -2.0, 1.0),
        (-1.0, -2.0, 1.0),
    ],
)
def test_impulses_that_a_push_beside_them_makes_up_for(impulse: float, beside: float, left: float) -> None:
    """200 over half a hundredth of 2 s is 2, of the other sign; the second state is 9 away from its limits."""
    impulses = np.zeros((2, 3))
    impulses[1, 1] = impulse
    s = drift(
        drifting(),
        state_impulses=impulses,
        states=lambda t, k: np.array([0 * t, 100.0 * beside + 0 * t]),
        state_bounds=by_hand.interval([-99.0, 1.75 - 9.0], [99.0, 1.75 + 9.0]),
    )
    found = _check_costate_jumps_at_state_bounds(s, given_scales([s], cost=4.0, radius=3.0))
    assert found.value == pytest.approx(left * 3.0 / 4.0, abs=1e-12)
    assert not left or found.where == "phase leg, t = 0.5 s, impulse on x[1]"


def test_impulses_need_the_limit_that_exerts_them() -> None:
    """x_0 is at its upper limit of 1.5 at the break: > 0 is right there, < 0 is off by the room to the lower one."""
    for impulse, room in ((2.0, 0.0), (-2.0, 0.25)):
        impulses = np.zeros((2, 3))
        impulses[0, [0, 1, 2]] = 7.0, impulse, 7.0  # those at the ends are for transversality
        limits = by_hand.interval([1.25, -99.0], [1.5, 99.0])
        s = drift(drifting(), state_impulses=impulses, state_bounds=limits)
        assert _check_costate_jumps_at_state_bounds(s, given_scales([s], 4.0)).value == pytest.approx(
            2.0 * room / 4.0, abs=1e-12
        )
    lone = drift(drifting(), breaks=(0.0, 2.0), state_impulses=np.full((2, 2), 5.0))
    assert _check_costate_jumps_at_state_bounds(lone, given_scales([lone])).value == 0.0


@pytest.mark.parametrize("name", ["mixed", "pure", "u", "x[0]"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_multipliers_away_from_limits_count_by_room_share_and_worth(name: str, sign: float) -> None:
    """At the fifth of eight points, with limits 0.1 above and 0.2 below what is there."""
    problem = drifting(paths=True)
    base = drift(problem)
    j = 4
    t = base.phase.point_times[j]
    value = {"mixed": 1 + t - 6 * t, "pure": 2 - t**2, "u": -2 * t, "x[0]": 1 + t}[name]
    row = {"mixed": 0, "pure": 1, "u": 0, "x[0]": 0}[name]
    kind, n = {"mixed": ("path", 2), "pure": ("path", 2), "u": ("control", 1), "x[0]": ("state", 2)}[name]
    lower, upper, multipliers = np.full(n, -99.0), np.full(n, 99.0), np.zeros((n, 8))
    lower[row], upper[row], multipliers[row, j] = value - 0.2, value + 0.1, sign * 5.0
    leg = replace(
        base.phase, **{f"{kind}_bounds": by_hand.interval(lower, upper), f"{kind}_multipliers": multipliers}
    )
    s = PhaseSamples.from_phase(leg, base.functions)
    solution = by_hand.solution(problem, leg)
    ends = get_endpoint_gradients(solution)
    condition = check_complementarity(solution, [s], ends, given_scales([s], cost=4.0))
    lasts = leg.collocation_rules[1].weights[j - 4] / 2 * 1.5
    room = 0.1 if sign > 0 else 0.2
    assert condition.value == pytest.approx(5.0 * room * lasts / 4.0, rel=1e-9)
    assert condition.where == f"phase leg, t = {t:.6g} s, multiplier of {name}"


def test_multipliers_of_boundary_constraints_away_from_limits() -> None:
    """Room 0.5 up and 0.25 down, no more than what the flight changes it; in shares of the largest worth of states."""
    problem = drifting()
    leg = problem.get_phase()
    problem.constrain("a", leg.final_state("x")[0], lower=2.75, upper=3.5)
    problem.constrain("b", leg.final_state("x")[1], upper=-2.0)
    s = drift(problem)
    for nu, amount, expected in ((2.0, 9.0, 1.0), (-2.0, 9.0, 0.5), (2.0, 0.3, 0.6), (-2.0, 0.2, 0.4)):
        solution = by_hand.solution(
            problem, s.phase, constraint_labels=("a", "b"), constraint_multipliers=np.array([nu, 7.0])
        )
        rows = ([amount, 1.0], [0.0, 0.0], [1.0, 1.0])
        scales = given_scales([s], cost=4.0, constraints=rows)
        found = check_complementarity(solution, [s], get_endpoint_gradients(solution), scales)
        assert found.value == pytest.approx(expected / 4.0, rel=1e-9)
        assert found.where == "multiplier of constraint a"


def test_adjoint_equation_segment_by_segment_and_at_jumps() -> None:
    """lam_0' = lam_1' = 0 is right: costates (3 - a t, 1) leave a times the segment, and jump by b."""
    for slope, jump in ((0.5, 0.0), (0.0, 0.25), (0.0, -0.25)):
        s = drift(drifting(), lam=lambda t, k, a=slope, b=jump: np.array([3 - a * t, 1.0 + b * k + 0 * t]))
        condition = check_adjoint_equation([s], given_scales([s], cost=4.0, radius=3.0), 1e-6)
        violation = slope * 1.5 if slope else abs(jump)
        assert condition.value == pytest.approx(violation * 3.0 / 4.0, rel=1e-9)
        where = (
            "segment 2 (0.5 to 2 s), adjoint equation of x[0]"
            if slope
            else "t = 0.5 s, jump of the costate of x[1]"
        )
        assert condition.where == f"phase leg, {where}"
    right = drift(drifting(), breaks=(0.0, 2.0), lam=lambda t, k: np.array([3.0 + 0 * t, 1.0 + 0 * t]))
    assert check_adjoint_equation([right], given_scales([right]), 1e-6).value == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("value", "slope", "amount", "left"),
    [
        (1.0, 3.0, 4.0, 0.75),  # between its limits
        (1.0, -3.0, 4.0, 0.75),
        (0.0, 3.0, 4.0, 0.0),  # at the lower one, which pushes upwards
        (0.0, -3.0, 4.0, 0.75),
        (5.0, -3.0, 4.0, 0.0),
        (5.0, 3.0, 4.0, 0.75),
        (1.0, 0.0, 1.0, 0.0),  # nothing depends on it
    ],
)
def test_a_parameter_is_stationary_or_pushes_at_its_limit(
    value: float, slope: float, amount: float, left: float
) -> None:
    """In shares of what the cost changes by it, 0 <= k <= 5; of a trajectory that does not know of it."""
    problem = go.Problem("k")
    model, *_ = dynamics("one", "x", "u", lambda x, u: {x: u})
    k = problem.parameter("k", lower=0.0, upper=5.0)
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    problem.minimize(leg.final_state("x") + slope * k)
    one = (lambda t, k: np.array([t]),) * 3
    solution = by_hand.solution(problem, by_hand.phase(problem, *one), parameter_values=np.array([value]))
    found = check_parameter_stationarity(
        solution, [], get_endpoint_gradients(solution), given_scales([], cost=amount, parameters=[1.0])
    )
    assert found.value == pytest.approx(left) and found.where == "parameter k"


def test_a_final_limit_that_is_reached_pays_for_its_costate() -> None:
    """Least u^2 / 2 less 2 x(1) with x(1) <= 1: u = 1, costate -1, 1 per metre by the limit, whatever comes before."""
    model = go.Model("runner")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("runner")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=(None, 1.0))
    problem.minimize(leg.integral(u**2 / 2) - 2 * leg.final_state("x"))
    verdict = go.verify(go.solve(problem, mesh="1x3", tol=None))
    assert verdict["stationarity"].result is go.ConditionResult.PASS
