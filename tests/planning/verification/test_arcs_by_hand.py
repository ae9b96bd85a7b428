"""Controls between their bounds, by hand: which arcs are singular, what determines them, what misses its minimum."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from testing import constructed_solutions as by_hand
from testing.given_scales import given_scales

import gnc_opt as go
from gnc_opt.planning import ConditionResult
from gnc_opt.planning.optimality.active_set import left_free
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.verification import control_conditions as controls
from gnc_opt.planning.verification import singular_arcs as singular
from gnc_opt.planning.verification.singular_arcs import SingularArc, singular_arcs
from gnc_opt.tolerances import ACTIVE

Array = NDArray[np.float64]
TOLERANCE = 1e-5


def pair(bend: float = 0.0, cost: float = 1.0) -> go.Problem:
    """x' = u, y' = w at ``cost`` times the integral of x + bend u^2 / 2 + w^2 / 2; a path p = x + y."""
    model = go.Model("pair")
    x, y = model.state("x"), model.state("y")
    u, w = model.control("u"), model.control("w")
    model.ode({x: u, y: w})
    problem = go.Problem("pair")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    leg.path("p", x + y, upper=100.0)
    problem.minimize(leg.integral(cost * (x + bend * u**2 / 2 + w**2 / 2)))
    return problem


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

    monkeypatch.setattr(singular, "_judge", judge)
    none: Any = None
    return lambda s: singular_arcs(none, s, *controls.undetermined(s, TOLERANCE), TOLERANCE)


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


def test_near_a_bound_is_a_hundredth_of_the_range(arcs: Any) -> None:
    for value, between in ((0.985, False), (0.975, True), (-0.985, False), (-0.975, True)):
        assert arcs(flown(u=(1.0, value))) == (LATE if between else [])


@pytest.mark.parametrize("cost", [1.0, 1e6, 1e-6])
def test_slope_and_curvature_vanish_in_shares_of_the_hamiltonian(arcs: Any, cost: float) -> None:
    """Over the range that u is worth having, in any unit of the cost."""
    straight, bent = flown(cost=cost), flown(pair(TOLERANCE, cost), cost=cost)
    sloping = straight.control_worth[0] / straight.control_span[0] / cost
    bending = bent.control_worth[0] / bent.control_span[0] ** 2 / cost
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


@pytest.mark.parametrize(
    ("sign", "why"), [(1.0, ""), (-1.0, "")]
)  # fmt: skip
def test_an_arc_that_fails_needs_no_excuse(sign: float, why: str) -> None:
    """x' = u at the cost of sign x^2: K = 2 sign over the ranges 2 of u and 1.5 s, in shares of H."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("integrator")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
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
    (arc,) = singular_arcs(problem, s, *controls.undetermined(s, TOLERANCE), TOLERANCE)
    expected = sign * 2.0 * 4.0 * 1.5**2 / s.hamiltonian_scale
    assert arc == SingularArc("phase leg, u from 0.5 s to 2 s", 1, pytest.approx(expected), why)


def test_controls_that_curve_h_together_are_not_affine() -> None:
    """u w has no curvature in either: where both rest at zero, the arc's first derivative is of order zero."""
    model = go.Model("pair")
    x, y = model.state("x"), model.state("y")
    u, w = model.control("u"), model.control("w")
    model.ode({x: u, y: w})
    problem = go.Problem("pair")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    problem.minimize(leg.integral(x + u * w))
    s = by_hand.samples(
        problem,
        lambda t, k: np.array([1 + t, 2 - t]),
        lambda t, k: np.zeros((2, t.size)),
        lambda t, k: np.zeros((2, t.size)),
        weights=(1.0,),
        breaks=(0.0, 2.0),
        control_bounds=BOX,
    )
    (arc,) = singular_arcs(problem, s, *controls.undetermined(s, TOLERANCE), TOLERANCE)
    assert arc == SingularArc("phase leg, u, w from 0 s to 2 s", 0, 0.0, singular.NOT_AFFINE)


# --- what active constraints take -------------------------------------------------------------------------


def test_directions_that_constraints_take_are_measured_in_the_controls_units() -> None:
    """3 u + w x + x = c along: in units (2, 0.5) what is left is orthogonal to (6, 0.5 x)."""
    model = go.Model("pair")
    x, y = model.state("x"), model.state("y")
    u, w = model.control("u"), model.control("w")
    model.ode({x: u, y: w})
    problem = go.Problem("pair")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
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
    for j, basis in enumerate(left_free(s, every, np.array([2.0, 0.5]))):
        if s.segments[j] == 0:  # the limit is half away
            np.testing.assert_allclose(basis, np.eye(2))
        else:
            assert basis.shape == (2, 1)
            row = np.array([6.0, 0.5 * (1 + s.times[j])])
            assert np.linalg.norm(basis) == pytest.approx(1.0) and abs(row @ basis[:, 0]) < 1e-12
    alone = every.copy()
    alone[0] = False
    assert [b.shape for b in left_free(s, alone, np.ones(2))] == [(2, 1 - k) for k in s.segments]


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
        for j, basis in enumerate(left_free(s, every, np.ones(2))):
            if told and s.segments[j] == 1:
                assert basis.shape == (2, 1) and abs(basis[channel, 0]) < 1e-12
            else:
                np.testing.assert_allclose(basis, np.eye(2))
    touched = samples(5.0, 0.0, segment=0)  # it pushes at the end of the first segment only, where it touches
    assert all(b.shape == (2, 2) for b in left_free(touched, every, np.ones(2)))


# --- what the controls miss -------------------------------------------------------------------------------


def test_no_control_between_its_bounds_is_a_sufficient_pass() -> None:
    box = by_hand.interval([1.0, 2.0], [1.0, 2.0])
    s = flown(u=(1.0, 1.0), control_bounds=by_hand.interval([-1.0, -9.0], [1.0, 9.0]))
    s = PhaseSamples.of(replace(s.leg, control_bounds=box), s.functions)
    condition = controls.legendre_clebsch([s], TOLERANCE, [controls.undetermined(s, TOLERANCE)[0]])
    assert condition.result is ConditionResult.PASS and condition.sufficient
    assert (condition.value, condition.tolerance, condition.where) == (
        0.0,
        0.0,
        "no control between its bounds",
    )


@pytest.mark.parametrize("bend", [2.0, 0.0, -2.0])
def test_least_curvature_over_the_spans(bend: float) -> None:
    """bend u^2 / 2 + w^2 / 2 + u w / 2, along the flight and in shares of what half the spans are worth."""
    model = go.Model("pair")
    x, y = model.state("x"), model.state("y")
    u, w = model.control("u"), model.control("w")
    model.ode({x: u, y: w})
    problem = go.Problem("pair")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    problem.minimize(leg.integral(bend * u**2 / 2 + w**2 / 2 + u * w / 2 * ca.exp(-model.time)))
    s = flown(
        problem, u=(0.5, -0.5), lam=(-1.0, 0.5), control_bounds=by_hand.interval([-9.0, -9.0], [9.0, 9.0])
    )
    unit = s.control_span / np.sqrt(s.control_worth)
    least = []
    for t in s.times:
        hessian = np.array([[bend, np.exp(-t) / 2], [np.exp(-t) / 2, 1.0]]) * np.outer(unit, unit)
        least.append(np.linalg.eigvalsh(hessian)[0])
    condition = controls.legendre_clebsch([s], TOLERANCE, [controls.undetermined(s, TOLERANCE)[0]])
    assert condition.value == pytest.approx(-min(least), rel=1e-9) and condition.tolerance == -TOLERANCE
    assert (
        condition.result is (ConditionResult.PASS if min(least) > 0 else ConditionResult.FAIL)
        and condition.sufficient
    )
    assert condition.where.startswith("phase leg, t = 0 s")


def test_share_of_its_span_by_which_a_control_misses_its_minimum() -> None:
    """Slope over curvature: of w it is (t - 1) + (1 - t) = 0 and then 0.3; u has none."""
    problem = pair()
    s = by_hand.samples(
        problem,
        lambda t, k: np.array([1 + t, 2 - t]),
        lambda t, k: np.array([0 * t, t - 1]),
        lambda t, k: np.array([1 + 0 * t, 1 - t + 0.3 * k]),
        weights=(1.0,),
        breaks=(0.0, 0.5, 2.0),
        control_bounds=BOX,
    )
    miss = controls._miss(s, given_scales([s], deviation=2.0))
    assert np.all(np.isinf(miss[0]))
    np.testing.assert_allclose(miss[1], np.where(s.segments == 1, 0.3 / 2.0, 0.0), atol=1e-12)
    curvature = controls._curvature(s)
    np.testing.assert_allclose(curvature[1], s.control_span[1] ** 2 / s.control_worth[1])
    np.testing.assert_allclose(curvature[0], 0.0)


@pytest.mark.parametrize(
    ("value", "slope", "room"),
    [
        (0.25, 2.0, 1.25),
        (0.25, -2.0, 0.75),
        (1.0, -2.0, 0.0),
        (1.0, 2.0, 2.0),
        (-1.0, 2.0, 0.0),
        (-1.0, -2.0, 2.0),
    ],
)
def test_loss_is_slope_times_room_of_the_control(value: float, slope: float, room: float) -> None:
    """To the bound to which the slope points, at most the span."""
    s = flown(u=(value, value), lam=(slope, slope))
    loss, on_bound = controls._range_losses(s)
    np.testing.assert_allclose(loss[0], 2.0 * min(room, s.control_span[0]), atol=1e-9)
    assert np.all(on_bound[0] == (abs(value) == 1.0)) and not np.any(on_bound[1])
