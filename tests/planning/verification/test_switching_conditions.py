"""Switches, bang-bang flows and singular arcs: conditions of first and second order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy
from testing import constructed_solutions as by_hand
from testing.internals import PhaseSamples, check_strict_bang_bang_property, explain_why_not_bang_bang
from testing.models import dynamics, one_phase
from testing.second_order import of_samples, second_order_of
from testing.wrong_solutions import singular_problem

import gnc_opt as go
from gnc_opt.array_types import Array, Indices
from gnc_opt.numerical_tolerances import NEGLIGIBLE
from gnc_opt.planning import ConditionResult
from gnc_opt.planning.optimality.bang_bang_sensitivity import (
    FLOW_INITIAL_STEPS,
    RUNGE_KUTTA_ORDER,
    BangBangFlow,
    PiecewiseControl,
    integrate_bang_bang_flow,
)
from gnc_opt.planning.optimality.cost_and_endpoint_scales import (
    find_lasting_minimum_sample,
    remove_short_intervals_from_mask,
)
from gnc_opt.planning.optimality.switching_time_problem import Switches, _equalise_nearby_switch_times
from gnc_opt.planning.verification.bang_bang_second_order_conditions import is_bang_bang
from gnc_opt.planning.verification.goh_transformation import (
    ARC_END_CUTS,
    SINGULAR_SEGMENT_MIN_POINTS,
    _mask_segments_without_active_limits,
    mask_singular_segments,
    refine_mesh_at_singular_arc_ends,
)
from gnc_opt.planning.verification.reduced_hessian import (
    _find_bang_bang_control,
    _has_partly_singular_segment,
    _increase_mesh_degrees_for_variations,
    build_critical_cone,
)
from gnc_opt.planning.verification.solution_data_check import recompute_stored_data
from problems import rendezvous

# Switches of bang-bang controls by hand: where they are, in which orders they come, and how steeply.


Slopes = tuple[Callable[[Any], Any], ...]

ENDS = np.array([0.0, 0.8, 1.4, 2.0])
"""u is 1, -1, 1 between them; w is -2, -2, 3."""

U = ((1.0, -1.0, 1.0), (-2.0, -2.0, 3.0))


def two_ways() -> go.Problem:
    model = go.Model("two ways")
    x, y, z = model.state("x"), model.state("y"), model.state("z")
    u, w, v = model.control("u"), model.control("w"), model.control("v")
    model.ode({x: u, y: w, z: v})
    problem, leg = one_phase("two ways", model, 0.0, 2.0)
    problem.minimize(leg.final_state("x"))
    return problem


def flight(
    of_u: Slopes,
    of_w: Slopes,
    controls: Any = U,
    upper: float = 1.0,
    level: float = 1.0,
    second: float = 1.0,
    cost: float = 1.0,
) -> PhaseSamples:
    """Switching functions of u and w segment by segment; a third control, v, rests at the bound ``upper``.

    ``second`` and ``cost`` are the units of time and of the costates.
    """

    def costates(t: Any, k: int) -> Any:
        t = t / second
        return cost * np.stack([of_u[k](t) + 0 * t, of_w[k](t) + 0 * t, -level + 0 * t])

    def pushes(t: Any, k: int) -> Any:
        return np.stack([controls[0][k] + 0 * t, controls[1][k] + 0 * t, upper + 0 * t])

    def states(t: Any, k: int) -> Any:
        return np.stack([t, t, t])

    bounds = by_hand.interval([-1.0, -2.0, 0.0], [1.0, 3.0, upper])
    return by_hand.samples(
        two_ways(), states, pushes, costates, weights=(), breaks=second * ENDS, control_bounds=bounds
    )


def arch(c: float) -> Callable[[Any], Any]:
    """Slope 0.6 c at 0.8 s, steeper at 1.4 s."""
    return lambda t: c * (t - 0.8) * (1.4 - t) * (t + 0.2)


def line(slope: float, zero: float) -> Callable[[Any], Any]:
    return lambda t: slope * (t - zero)


FALLS = (line(-7.0, 1.4),) * 3


@pytest.mark.parametrize(
    ("slopes", "least", "time"),
    [((5.0, 10.0, 2.0), 2.0, 1.4), ((5.0, 2.0, 3.0), 1.2, 0.8), ((1.0, 10.0, 2.0), 1.0, 0.8)],
)
def test_least_slope_on_either_side_of_a_switch(
    slopes: tuple[float, float, float], least: float, time: float
) -> None:
    """Over 2 s and the range 2 of u, in shares of H."""
    before, between, after = slopes
    s = flight((line(before, 0.8), arch(between), line(-after, 1.4)), FALLS)
    condition = check_strict_bang_bang_property([s])
    assert condition.result is ConditionResult.PASS and condition.sufficient
    assert condition.value == pytest.approx(-least * 2.0 * 2.0 / s.hamiltonian_scale, rel=1e-3)
    assert condition.tolerance == -NEGLIGIBLE
    assert condition.where == f"phase leg, t = {time:g} s, u"


def test_slope_of_the_wrong_sign() -> None:
    """All are; that of w over its range of 5 is the steepest."""
    s = flight((line(-5.0, 0.8), arch(-10.0), line(2.0, 1.4)), (line(7.0, 1.4),) * 3)
    condition = check_strict_bang_bang_property([s])
    assert condition.result is ConditionResult.FAIL
    assert condition.value == pytest.approx(7.0 * 5.0 * 2.0 / s.hamiltonian_scale, rel=1e-3)
    assert condition.where == "phase leg, t = 1.4 s, w"


def test_the_worst_of_several_phases_counts() -> None:
    """The least slope of all, whichever comes first."""
    good = flight((line(5.0, 0.8), arch(10.0), line(-5.0, 1.4)), FALLS)
    bad = flight((line(-5.0, 0.8), arch(-10.0), line(2.0, 1.4)), FALLS)
    for pair in ([good, bad], [bad, good]):
        assert check_strict_bang_bang_property(pair).result is ConditionResult.FAIL
    assert check_strict_bang_bang_property([good, good]).result is ConditionResult.PASS


def test_a_slope_of_zero_is_not_reported() -> None:
    """A cubic zero has the right sign on both sides, and no slope."""
    flat = flight((lambda t: 5 * (t - 0.8) ** 3, arch(10.0), line(-5.0, 1.4)), FALLS)
    condition = check_strict_bang_bang_property([flat])
    assert condition.result is ConditionResult.INCONCLUSIVE and condition.where == "phase leg, t = 0.8 s, u"


@pytest.mark.parametrize(
    ("slope", "result"), [(1.4e-5, ConditionResult.INCONCLUSIVE), (5e-5, ConditionResult.FAIL)]
)
def test_a_slope_of_the_wrong_sign_that_is_worth_nothing_is_not_reported(
    slope: float, result: ConditionResult
) -> None:
    """The first one makes 2e-6 of H per phase and 8e-7 of H up to the switch: zero within the errors of costates."""
    s = flight((line(-slope, 0.8), arch(-slope), line(-5.0, 1.4)), FALLS)
    condition = check_strict_bang_bang_property([s])
    assert condition.result is result
    assert condition.value == pytest.approx(slope * 2.0 * 2.0 / s.hamiltonian_scale, rel=1e-3)
    assert condition.where.startswith("phase leg, t = 0.8 s, u")


def touching(t: Any) -> Any:
    return 100 * (t - 0.8) * (1.4 - t) * (t - 1.1) ** 2


def test_zero_that_is_touched_between_switches() -> None:
    s = flight((line(5.0, 0.8), touching, line(-5.0, 1.4)), FALLS)
    condition = check_strict_bang_bang_property([s])
    assert (condition.result, condition.value, condition.tolerance) == (
        ConditionResult.INCONCLUSIVE,
        0.0,
        0.0,
    )
    assert condition.where == "phase leg, t = 1.1 s, u: zero between switches" and condition.sufficient
    # A slope of the wrong sign weighs more.
    assert (
        check_strict_bang_bang_property([flight((line(-5.0, 0.8), touching, line(-5.0, 1.4)), FALLS)]).result
        is ConditionResult.FAIL
    )


@pytest.mark.parametrize(("second", "cost"), [(1e-3, 1e8), (1e4, 1e-8)])
def test_slopes_and_touches_do_not_depend_on_units(second: float, cost: float) -> None:
    units = {"second": second, "cost": cost}
    touch, slopes = (line(5.0, 0.8), touching, line(-5.0, 1.4)), (line(5.0, 0.8), arch(10.0), line(-2.0, 1.4))
    assert (
        check_strict_bang_bang_property([flight(touch, FALLS, **units)]).result
        is ConditionResult.INCONCLUSIVE
    )
    assert check_strict_bang_bang_property([flight(slopes, FALLS, **units)]).value == pytest.approx(
        check_strict_bang_bang_property([flight(slopes, FALLS)]).value, rel=1e-6
    )


def test_a_zero_right_beside_its_own_switch_is_checked_by_its_slope() -> None:
    """The first sample after 0.8 s lies less than a ten-thousandth of the phase beyond it."""
    ends = np.array([0.0, 0.8, 0.81, 2.0])
    s = flight((line(5.0, 0.8),) * 3, FALLS)
    beside = by_hand.samples(
        two_ways(),
        lambda t, k: np.stack([t, t, t]),
        lambda t, k: np.stack([1 - 2.0 * (k > 0) + 0 * t, -2 + 0 * t, 1 + 0 * t]),
        lambda t, k: np.stack(
            [5 * (t - 0.8) if k != 1 else 5 * (t - 0.8) * (t - 0.80008) ** 2, 9 - t, -1 + 0 * t]
        ),
        weights=(),
        breaks=ends,
        control_bounds=s.phase.control_bounds,
    )
    assert np.min(np.diff(beside.times[beside.segments == 1])) < 1e-4 * 2.0
    assert "touches" not in check_strict_bang_bang_property([beside]).where


def test_zero_that_is_touched_where_another_control_switches() -> None:
    """u stays at -1 while w switches at 1.4 s."""
    once = ((1.0, -1.0, -1.0), (-2.0, -2.0, 3.0))
    touch = (line(5.0, 0.8), lambda t: 5 * (t - 0.8) * (1.4 - t) ** 2, lambda t: 5 * (t - 1.4) ** 2)
    condition = check_strict_bang_bang_property([flight(touch, FALLS, once)])
    assert condition.result is ConditionResult.INCONCLUSIVE
    assert condition.where == "phase leg, t = 1.4 s, u: zero between switches"


def test_touched_without_any_switch() -> None:
    still = ((-1.0,) * 3, (-2.0,) * 3)
    away, touch = (lambda t: 1.0 + 0 * t,) * 3, (lambda t: (t - 1.1) ** 2,) * 3
    assert (
        check_strict_bang_bang_property([flight(touch, away, still)]).result is ConditionResult.INCONCLUSIVE
    )
    condition = check_strict_bang_bang_property([flight(away, away, still)])
    assert (condition.result, condition.value, condition.tolerance) == (ConditionResult.PASS, 0.0, 0.0)
    assert condition.where == "no switch between control limits" and condition.sufficient


def test_what_touches_zero_matters_only_for_a_control_with_a_range_and_on_it() -> None:
    """v has no range and a switching function of zero; u is between its bounds in a segment."""
    crossing = (line(5.0, 0.8), arch(10.0), line(-5.0, 1.4))
    assert (
        check_strict_bang_bang_property([flight(crossing, FALLS, upper=0.0, level=0.0)]).result
        is ConditionResult.PASS
    )
    between = ((1.0, 0.5, 1.0), (-2.0, -2.0, 3.0))
    away = (lambda t: t, lambda t: (t - 1.1) ** 2, lambda t: t)
    assert check_strict_bang_bang_property([flight(away, FALLS, between)]).result is ConditionResult.PASS


def test_switches_and_those_that_may_come_in_from_the_ends() -> None:
    """w's switching function vanishes at the end, u's at the start."""
    late = (line(-7.0, 1.4), line(-7.0, 1.4), lambda t: 7 * (t - 1.4) * (t - 2.0))
    switches = Switches.from_samples(flight((line(5.0, 0.8), arch(10.0), line(-5.0, 1.4)), late))
    np.testing.assert_allclose(switches.times, [0.8, 1.4, 1.4, 2.0])
    np.testing.assert_array_equal(switches.channels, [0, 0, 1, 1])
    np.testing.assert_allclose(switches.first, [1.0, -2.0, 1.0])
    np.testing.assert_allclose(switches.toggled, [0.0, 1.0, 1.0])
    np.testing.assert_allclose(switches.ends, [0.0, 2.0])
    assert switches.labels[2] == "switch of w at 1.4 s"
    early = (lambda t: 5 * t * (t - 0.8), arch(10.0), line(-5.0, 1.4))
    switches = Switches.from_samples(flight(early, FALLS))
    np.testing.assert_allclose(switches.times, [0.0, 0.8, 1.4, 1.4])
    np.testing.assert_array_equal(switches.channels, [0, 0, 0, 1])
    np.testing.assert_allclose(switches.first, [-1.0, -2.0, 1.0])
    none = Switches.from_samples(flight(early, FALLS, ((-1.0,) * 3, (-2.0,) * 3), upper=0.0, level=0.0))
    np.testing.assert_array_equal(none.channels, [0])  # v has nothing to switch between


def test_orders_pieces_and_precedences() -> None:
    late = (line(-7.0, 1.4), line(-7.0, 1.4), lambda t: 7 * (t - 1.4) * (t - 2.0))
    switches = Switches.from_samples(flight((line(5.0, 0.8), arch(10.0), line(-5.0, 1.4)), late))
    assert switches.simultaneous_switch_groups == [[0], [1, 2], [3]] and switches.n_switch_sequences == 2
    assert list(switches.list_switch_sequences()) == [(0, 1, 2, 3), (0, 2, 1, 3)]
    pieces = switches.build_piecewise_control((0, 2, 1, 3))
    np.testing.assert_allclose(pieces.times, [0.0, 0.8, 1.4, 1.4, 2.0, 2.0])
    np.testing.assert_array_equal(pieces.unknowns, [0, 1, 3, 2, 4, 5])
    np.testing.assert_allclose(pieces.controls[0], [1, -1, -1, 1, 1])
    np.testing.assert_allclose(pieces.controls[1], [-2, -2, 3, 3, -2])
    np.testing.assert_allclose(
        switches.build_switch_sequence_constraints((0, 2, 1, 3)), [[0, 0, 1, -1, 0, 0], [0, 0, 0, 0, -1, 1]]
    )
    np.testing.assert_allclose(
        switches.build_switch_sequence_constraints((0, 1, 2, 3)), [[0, 0, -1, 1, 0, 0], [0, 0, 0, 0, -1, 1]]
    )
    single = Switches.from_samples(
        flight((line(5.0, 0.8), arch(10.0), line(-5.0, 1.4)), (line(-7.0, 3.0),) * 3, (U[0], (-2.0,) * 3))
    )
    assert single.build_switch_sequence_constraints((0, 1)).shape == (0, 4)


def test_times_that_are_nearly_equal_are_made_equal() -> None:
    unit = 2.0**-20
    times = 2.0 + unit * np.array([0.5, 300.0, 300.5, 301.0, 600.0, 601.0])
    before = times.copy()
    joined = _equalise_nearby_switch_times(times, unit, 2.0 + unit * np.array([0.0, 601.5]))
    np.testing.assert_array_equal((joined - 2.0) / unit, [0.0, 300.0, 300.0, 301.0, 600.0, 601.5])
    np.testing.assert_array_equal(times, before)


STRAIGHT = (line(5.0, 0.8), arch(10.0), line(-5.0, 1.4))


def test_controls_that_jump_from_bound_to_bound_are_named() -> None:
    """H is straight in all controls; w does not jump if it stays, nor does what has no curvature in between."""
    once = ((-1.0, -1.0, -1.0), (-2.0, -2.0, 3.0))
    late = "switching times are not variables of the mesh"
    assert _find_bang_bang_control([flight(STRAIGHT, FALLS)]) == f"phase leg, u: {late}"
    assert _find_bang_bang_control([flight(STRAIGHT, FALLS, once)]) == f"phase leg, w: {late}"
    assert _find_bang_bang_control([flight(STRAIGHT, FALLS, ((-1.0,) * 3, (-2.0,) * 3))]) == ""
    between = ((-1.0, 0.5, -1.0), (-2.0, 0.0, -2.0))
    assert _find_bang_bang_control([flight(STRAIGHT, FALLS, between)]) == ""
    assert not _has_partly_singular_segment(flight(STRAIGHT, FALLS, between))  # but all along a segment
    assert not _has_partly_singular_segment(flight(STRAIGHT, FALLS))


@pytest.mark.parametrize("cost", [1e-9, 1e9])
@pytest.mark.parametrize("bend", [-1.0, 0.0, 1e-8, 1e-4, 1.0])
def test_straight_is_what_does_not_curve_upwards(bend: float, cost: float) -> None:
    """H = u + bend u^2 / 2 at the bound of u, in some unit of the cost; a millionth of H is straight."""
    model, _x, u = dynamics("bent", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("bent", model, 0.0, 1.0)
    problem.minimize(leg.integral(cost * (0.5 * bend * u**2 + u)))
    s = by_hand.samples(
        problem,
        lambda t, k: np.array([t]),
        lambda t, k: np.array([1 - 2.0 * k + 0 * t]),
        lambda t, k: np.array([0 * t]),
        weights=(1.0,),
        control_bounds=by_hand.interval(-1.0, 1.0),
    )
    assert bool(_find_bang_bang_control([s])) is (bend <= 1e-8)
    mesh = go.Mesh(s.phase.mesh.breaks, s.phase.mesh.degrees, (1,))  # the switching time is a variable
    assert not _find_bang_bang_control([replace(s, phase=replace(s.phase, mesh=mesh))])


def test_simple_meshes_get_thirty_points() -> None:
    assert _increase_mesh_degrees_for_variations(go.Mesh((0.0, 1.0), (4,))).degrees == (30,)
    fine = _increase_mesh_degrees_for_variations(go.Mesh((0.0, 0.2, 0.5, 0.7, 1.0), (5, 9, 3, 8), (1, 3)))
    assert (
        fine.degrees == (8, 9, 8, 8) and fine.movable == (1, 3) and fine.breaks == (0.0, 0.2, 0.5, 0.7, 1.0)
    )


def test_obstacles_are_reported_by_their_phase() -> None:
    s = flight(STRAIGHT, FALLS)
    assert explain_why_not_bang_bang([s]) == "" and is_bang_bang([s]) and not is_bang_bang([])
    between = flight(STRAIGHT, FALLS, ((1.0, 0.25, 1.0), U[1]))
    text = "phase leg, t = 0.8 s, u: the control is between its limits"
    assert explain_why_not_bang_bang([s, between]) == text
    assert not is_bang_bang([s, between])
    short = replace(s.phase, final_time=s.phase.initial_time, final_time_bounds=by_hand.interval(0.0, 9.0))
    text = explain_why_not_bang_bang([PhaseSamples.from_phase(short, s.functions)])
    assert text == "phase leg has no length"


# First and second derivatives of bang-bang flows in switch times and start values.


DIFFERENCES = {
    1: {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12},
    2: {-2: -1 / 12, -1: 4 / 3, 0: -5 / 2, 1: 4 / 3, 2: -1 / 12},
}
"""Weights of the central differences of fourth order, by order of the derivative."""


@dataclass
class Case:
    """A solution on a mesh of pieces, and which start values are unknowns."""

    solution: go.Solution
    free_start: Indices

    def __post_init__(self) -> None:
        leg = self.solution.phase()
        self.phase, self.functions = leg, self.solution.phase_functions(leg.name)
        self.samples = PhaseSamples.from_phase(leg, self.functions)
        self.times = leg.breaks
        self.controls = leg.applied(0.5 * (self.times[1:] + self.times[:-1]))
        self.unknowns = np.concatenate([self.times, leg.x(self.times[0])[self.free_start]])

    def flow(self, refinement: int = 4, steps: int = FLOW_INITIAL_STEPS) -> BangBangFlow:
        assert self.solution.problem is not None
        pieces = PiecewiseControl(self.times, self.controls, np.arange(self.times.size))
        asked = (self.solution.problem, self.samples, pieces, self.free_start)
        return integrate_bang_bang_flow(*asked, refinement, steps)

    def flown_end(self, unknowns: Array) -> Array:
        """States, integrals and time at the end by DOP853."""
        times, start = np.split(unknowns, [self.times.size])
        y = np.concatenate([self.phase.x(self.times[0]), np.zeros(self.phase.integrals.size)])
        y[self.free_start] = start
        n, rates = self.phase.states.size, self.functions.buffered_state_rates()
        for k, (left, right) in enumerate(pairwise(times)):

            def rate(t: float, y: Array, u: Array = self.controls[:, k]) -> Array:
                costs = self.functions.integrands(t, y[:n], u) if y.size > n else y[n:]
                return np.concatenate([rates(t, y[:n], u), costs])

            run = scipy.integrate.solve_ivp(rate, (left, right), y, method="DOP853", rtol=1e-12, atol=1e-9)
            y = run.y[:, -1]
        return np.append(y, times[-1])

    def derivative(self, order: int, direction: Array, step: float = 5e-3) -> Array:
        weights = DIFFERENCES[order]
        ends = [w * self.flown_end(self.unknowns + i * step * direction) for i, w in weights.items()]
        return np.asarray(np.sum(ends, axis=0) / step**order)


def van_der_pol() -> Case:
    """Van der Pol's oscillator with a slow drive, a cost that depends on time and a free start value."""
    model = go.Model("driven oscillator")
    x, v, u = model.state("x"), model.state("v"), model.control("u")
    model.ode({x: v, v: (1 - x**2) * v - x + u + 0.2 * model.time * x})
    problem, leg = one_phase("driven oscillator", model, 0.5, 2.5)
    leg.initial(x=1.0)
    leg.bounds(u=(-1.0, 1.0), v=(-0.5, 0.5))
    problem.minimize(leg.integral(x**2 + leg.model.time * v) + leg.final_state("v"))
    mesh = go.Mesh.at_times([0.5, 1.1, 1.6, 2.5], 6)
    return Case(any_point(problem.with_fixed_arcs(arcs=[[-1, 1, -1]]), mesh), np.array([1]))


def double_integrator() -> Case:
    model, *_ = dynamics("double integrator", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("rest to rest", model, 0.0, (0.1, 100.0))
    leg.initial(q=100.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    mesh = go.Mesh.at_times([0.0, 10.0, 20.0], 5)
    return Case(go.solve(problem.with_fixed_arcs(arcs=[[-1, 1]]), mesh=mesh, tol=None), np.array([0, 1]))


def six_degrees_of_freedom() -> Case:
    arcs, mesh = rendezvous.switch_arcs(1), rendezvous.switch_mesh(1)
    return Case(any_point(rendezvous.build(1).with_fixed_arcs(arcs=arcs), mesh), np.array([1, 11]))


def any_point(problem: go.Problem, mesh: go.Mesh) -> go.Solution:
    """The derivatives belong to the flow, optimal or not."""
    return go.solve(problem, mesh=mesh, options=go.SolverOptions(max_iterations=1), throw=False, tol=None)


def test_double_integrator_in_closed_form() -> None:
    """With a = -1 until s, then 1: v = v0 - (s - t0) + (tf - s), q = q0 + v0 T - T^2 / 2 + (tf - s)^2."""
    flow = double_integrator().flow()
    np.testing.assert_allclose(flow.final_state, [0.0, 0.0, 20.0], atol=1e-9)
    slopes = [[20.0, -20.0, 0.0, 1.0, 20.0], [1.0, -2.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0, 0.0]]
    np.testing.assert_allclose(flow.final_state_sensitivity, slopes, atol=1e-9)
    position = [
        [-1.0, 0.0, 1.0, 0.0, -1.0],
        [0.0, 2.0, -2.0, 0.0, 0.0],
        [1.0, -2.0, 1.0, 0.0, 1.0],
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [-1.0, 0.0, 1.0, 0.0, 0.0],
    ]
    np.testing.assert_allclose(flow.compute_adjoint_hessian(np.array([1.0, 0.0, 0.0])), position, atol=1e-9)
    np.testing.assert_allclose(flow.compute_adjoint_hessian(np.array([0.0, 1.0, 1.0])), 0.0, atol=1e-9)


@pytest.mark.parametrize("build", [van_der_pol, six_degrees_of_freedom])
def test_derivatives_are_those_of_an_independent_integration(build: Callable[[], Case]) -> None:
    """Differences of DOP853 along a random direction in all unknowns, to 1e-6 of the largest derivative."""
    case, random = build(), np.random.default_rng(3)
    flow, adjoint = case.flow(), random.normal(size=case.flow().final_state.size)
    assert flow.initial_sensitivity.shape == (flow.final_state.size, case.unknowns.size)
    direction = random.normal(size=case.unknowns.size)
    direction /= np.linalg.norm(direction)
    slope, curvature = flow.final_state_sensitivity, flow.compute_adjoint_hessian(adjoint)
    np.testing.assert_allclose(flow.final_state, case.flown_end(case.unknowns), atol=1e-6)
    first, second = case.derivative(1, direction), adjoint @ case.derivative(2, direction)
    np.testing.assert_allclose(slope @ direction, first, atol=1e-6 * np.max(np.abs(slope)))
    np.testing.assert_allclose(
        direction @ curvature @ direction, second, atol=1e-6 * np.max(np.abs(curvature))
    )
    np.testing.assert_allclose(
        flow.compute_adjoint_gradient(adjoint),
        adjoint @ slope,
        rtol=1e-10,
        atol=1e-12 * np.max(np.abs(slope)),
    )


def test_half_the_width_of_steps_leaves_a_256th_of_the_error() -> None:
    """On two grids that are not yet at rounding; half an order either way."""
    case = van_der_pol()
    coarse, fine, best = (case.flow(n, 3).final_state for n in (4, 8, 30))
    ratio = np.linalg.norm(coarse - best) / np.linalg.norm(fine - best)
    assert 2 ** (RUNGE_KUTTA_ORDER - 0.7) < ratio < 2 ** (RUNGE_KUTTA_ORDER + 1.5)


# Singular arcs: Goh's condition and the generalised Legendre-Clebsch condition, against hand-made
# derivatives.


NAME = "generalised Legendre-Clebsch"
TIMES = np.linspace(0.0, 1.0, 11)


def judged(problem: go.Problem) -> go.Condition:
    """Of the trajectory that rests at zero."""
    leg = next(iter(problem.phases.values()))
    x = np.zeros((leg.model.states.size, TIMES.size))
    u = np.zeros((leg.model.controls.size, TIMES.size))
    return second_order_of(of_samples(problem, TIMES, x, u))[NAME]


def chain(order: int, sign: float) -> go.Problem:
    """The integral of sign y^2 / 2, with y the ``order``-th integral of u: H_u's derivative of order 2k is +-u."""
    model = go.Model("chain")
    y = model.state("y")
    rest = [model.state(f"y{i}") for i in range(1, order)]
    u = model.control("u")
    model.ode(dict(zip([y, *rest], [*rest, u], strict=True)))
    problem, leg = one_phase("chain of integrators", model, 0.0, 1.0)
    leg.initial(**dict.fromkeys(model.states.names, 0.0))
    leg.final(**dict.fromkeys(model.states.names, 0.0))
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(0.5 * sign * y**2))
    return problem


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize(
    ("sign", "result"), [(1.0, go.ConditionResult.PASS), (-1.0, go.ConditionResult.FAIL)]
)
def test_order_and_sign_of_a_chain_of_integrators(
    order: int, sign: float, result: go.ConditionResult
) -> None:
    """(-1)^k d/du d^2k/dt^2k H_u is the sign of the cost."""
    condition = judged(chain(order, sign))
    assert condition.result is result
    assert np.sign(condition.value) == -sign
    assert f"order {order}" in condition.where


def test_an_order_beyond_those_looked_for_is_not_reported() -> None:
    condition = judged(chain(4, -1.0))
    assert condition.result is go.ConditionResult.INCONCLUSIVE
    assert "no derivative up to order 6" in condition.where


def plane(gyration: float, weights: tuple[float, float] = (1.0, 1.0)) -> go.Problem:
    """Two controls move x and y, whose squares cost; an area swept by both costs, too, and need not come back.

    The rate of z is x w - y u: the bracket of the two controls' fields is along z, whose costate is ``gyration``.
    """
    model = go.Model("plane")
    x, y, z = model.state("x"), model.state("y"), model.state("z")
    u, w = model.control("u"), model.control("w")
    model.ode({x: u, y: w, z: x * w - y * u})
    problem, leg = one_phase("plane", model, 0.0, 1.0)
    leg.initial(x=0.0, y=0.0, z=0.0)
    leg.bounds(u=(-1.0, 1.0), w=(-1.0, 1.0))
    a, b = weights
    problem.minimize(leg.integral(0.5 * (a * x**2 + b * y**2)) + gyration * leg.final_state("z"))
    return problem


def test_two_singular_controls_form_a_matrix() -> None:
    assert judged(plane(0.0)).result is go.ConditionResult.PASS
    assert judged(plane(0.0, (1.0, -1.0))).result is go.ConditionResult.FAIL
    # One control is of the first order and the other of none: neither PASS nor FAIL.
    assert judged(plane(0.0, (1.0, 0.0))).result is go.ConditionResult.INCONCLUSIVE


def test_gohs_condition() -> None:
    """Circling to and fro gains gyration times the area at once, though each control alone is without reproach."""
    condition = judged(plane(0.5))
    assert condition.result is go.ConditionResult.FAIL and "Goh" in condition.where


@pytest.mark.parametrize(
    ("stiffness", "result"), [(0.5, go.ConditionResult.PASS), (-0.5, go.ConditionResult.FAIL)]
)
def test_beside_a_control_that_the_hamiltonian_determines(
    stiffness: float, result: go.ConditionResult
) -> None:
    """r and w move along the arc, x rests; K is the cost's coefficient of x^2 times 2."""
    problem = singular_problem(stiffness)
    states, controls = np.stack([0 * TIMES, TIMES]), np.stack([0 * TIMES, 1 + 0 * TIMES])
    condition = second_order_of(of_samples(problem, TIMES, states, controls))[NAME]
    assert condition.result is result, condition
    # H's terms amount to |lam_r w| = 1, as w^2 / 2 is constant; and 1 + r is least at the start.
    assert condition.value == pytest.approx(-2 * stiffness * 2**2 * (1 if stiffness > 0 else 2), rel=1e-4)


def test_no_singular_arc() -> None:
    model, _x, u = dynamics("regular", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("regular", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    problem.minimize(leg.integral(0.5 * u**2))
    condition = second_order_of(go.solve(problem, mesh="1x4", tol=None))[NAME]
    assert (condition.result, condition.where) == (go.ConditionResult.PASS, "no singular arc")


def aly_chan() -> go.Problem:
    """x' = y, y' = u; least z = (y^2 - x^2) / 2 integrated: u = -sin t all along, and the costate of y is 0."""
    model = go.Model("Aly and Chan")
    x, y, z, u = model.state("x"), model.state("y"), model.state("z"), model.control("u")
    model.ode({x: y, y: u, z: 0.5 * (y**2 - x**2)})
    problem, leg = one_phase("Aly and Chan", model, 0.0, 0.5 * np.pi)
    leg.initial(x=0.0, y=1.0, z=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.final_state("z"))
    return problem


def along_the_arc(gradient: float) -> go.Solution:
    """The closed form, with a costate of y that is off by a cosine."""
    problem = aly_chan()
    leg = by_hand.phase(
        problem,
        lambda t, k: np.array([np.sin(t), np.cos(t), np.sin(2 * t) / 4]),
        lambda t, k: -np.sin([t]),
        lambda t, k: np.array([-np.cos(t), gradient * np.cos(3 * t), 1 + 0 * t]),
        breaks=np.linspace(0.0, 0.5 * np.pi, 4),
        degree=10,
    )
    return by_hand.solution(problem, leg)


@pytest.mark.parametrize(("gradient", "right"), [(1e-8, True), (3e-6, True), (3e-4, False), (1e-2, False)])
def test_rounding_of_costates_that_vanish_is_no_violation(gradient: float, right: bool) -> None:
    """What cancels in the rate of the costate of y moves it by up to pi: that is what it is measured against."""
    solution = along_the_arc(gradient)
    verdict = go.verify(solution)
    told = {c.name: c.result for c in verdict.conditions}
    passed = [told[name] is go.ConditionResult.PASS for name in ("stationarity", "minimum principle")]
    assert all(passed) if right else not any(passed), verdict.explain()
    if right:
        parts = second_order_of(solution)
        assert parts["singular arcs"].result is parts[NAME].result is go.ConditionResult.PASS
        # y = A cos t after a jump costs nothing for any A: the end is the focal point.
        assert told["second order"] is go.ConditionResult.INCONCLUSIVE


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1e-8])
def test_a_path_constraint_that_determines_a_control_does_so_in_any_unit(factor: float) -> None:
    """x is to stay at 1 or above at the least of its integral: along the limit the slope of u is zero, and u no arc."""
    model, x, *_ = dynamics("wall", "x y", "u", lambda x, y, u: {x: u, y: 1.0})
    problem, leg = one_phase("wall", model, 0.0, 1.0)
    leg.initial(x=1.0, y=0.0)
    leg.bounds(u=(-1.0, 1.0))
    leg.path("wall", factor * x, lower=factor)
    problem.minimize(leg.integral(x) + leg.final_state("y"))
    solution = go.solve(problem, mesh="2x4")
    assert second_order_of(solution)[NAME].where == "no singular arc"


def coupled(coupling: float, start: float = 1.0) -> go.Problem:
    """x' = u at the least integral of (x^2 + v^2) / 2 + e u v: least in v at v = -e u, where -(e u)^2 / 2 is left."""
    model, x, u, v = dynamics("coupled", "x", "u v", lambda x, u, v: {x: u})
    problem, leg = one_phase("coupled", model, 0.0, 1.0 + 7.0 * start)
    leg.initial(x=start)
    leg.bounds(u=(-1.0, 1.0), v=(-1.0, 1.0))
    problem.minimize(leg.integral(0.5 * (x**2 + v**2) + coupling * u * v))
    return problem


@pytest.mark.parametrize(
    ("coupling", "result"),
    [
        (5e-4, go.ConditionResult.INCONCLUSIVE),
        (1e-3, go.ConditionResult.INCONCLUSIVE),
        (0.1, go.ConditionResult.FAIL),
    ],
)
def test_a_coupling_with_a_control_that_is_determined_curves_downwards(
    coupling: float, result: go.ConditionResult
) -> None:
    """By (2 e)^2 over the range of u, where H amounts to 1 / 2 + e. Pulses of u, with v = -e u, gain e^2 / 2."""
    condition = judged(coupled(coupling, start=0.0))
    assert condition.result is result and "H has negative curvature along both" in condition.where
    assert condition.value == pytest.approx((2 * coupling) ** 2 / (0.5 + coupling), rel=1e-6)


def test_a_coupled_arc_is_ok_within_the_tolerance_and_no_minimum() -> None:
    verdict = go.verify(go.solve(coupled(5e-4)))
    assert verdict.ok and not verdict.minimum
    assert verdict["second order"].result is go.ConditionResult.INCONCLUSIVE


@pytest.mark.slow
def test_a_control_that_loses_its_grip_before_a_free_end_is_no_singular_arc() -> None:
    """The furthest x by g' = exp(-16 t) cos b: b = 0. H curves in b by (1 - t) exp(-16 t), which decays."""
    model = go.Model("grip")
    x, g, b = model.state("x"), model.state("g"), model.control("b")
    clock = model.state("clock")
    model.ode({x: g, g: ca.exp(-16 * clock) * ca.cos(b), clock: 1.0})
    problem, leg = one_phase("grip", model, 0.0, 1.0)
    leg.initial(x=0.0, g=0.0, clock=0.0)
    leg.bounds(b=(0.0, np.pi))
    problem.maximize(leg.final_state("x"))
    solution = go.solve(problem)
    assert solution.objective == pytest.approx((1.0 - (1.0 - np.exp(-16.0)) / 16) / 16, rel=1e-8)
    verdict = go.verify(solution)
    assert verdict.ok, verdict.explain()


def test_a_switch_smeared_by_a_polynomial_is_no_arc() -> None:
    times = np.linspace(0.0, 1.0, 100001)
    inside = np.array([(times > 0.3) & (times < 0.30005), (times > 0.3) & (times < 0.301)])
    assert not np.any(remove_short_intervals_from_mask(times, inside)[0])
    np.testing.assert_array_equal(remove_short_intervals_from_mask(times, inside)[1], inside[1])


@pytest.mark.slow
def test_a_dip_counts_if_it_lasts() -> None:
    times = np.linspace(0.0, 1.0, 100_001)
    values = 3.0 + np.abs(times - 0.5)
    values[(times > 0.3) & (times < 0.30005)] = -2.0
    lasting = np.abs(times - 0.7) < 1e-3
    values[lasting] = -1.0 + 100.0 * np.abs(times[lasting] - 0.7)
    k = find_lasting_minimum_sample(times, values)
    # Half of 1e-4 to either side of the trough it has risen by 0.005.
    assert values[k] == pytest.approx(-0.995, abs=1e-3) and times[k] == pytest.approx(0.7, abs=1e-4)
    coarse = np.linspace(0.0, 1.0, 11)
    assert find_lasting_minimum_sample(coarse, np.cos(2 * np.pi * coarse)) == 5
    assert times[find_lasting_minimum_sample(times, np.where(times > 0.99985, -1.0, 0.0))] > 0.99985
    assert times[find_lasting_minimum_sample(times, np.where(times > 0.99995, -1.0, 0.0))] < 0.99995


# Second order along singular arcs: conjugate times, ends and alternating controls in closed form.
#
# x' = u, z' = x at the least integral of (x^2 - z^2) / 2: in Goh's variable, x itself, z'' = -z, whose solutions from
# z = 0 return there after pi, and come to rest after pi / 2.


NAME_GOH = "second order"


def verdict_at_rest(problem: go.Problem, duration: float, samples: int = 9) -> go.Verdict:
    t = np.linspace(0.0, duration, samples)
    return go.verify_trajectory(problem, t, np.zeros((2, samples)), {"u": 0 * t})


def oscillator(duration: float, **final: float) -> go.Problem:
    """The problem above."""
    model, x, z, _u = dynamics("oscillator", "x z", "u", lambda x, z, u: {x: u, z: x})
    problem, leg = one_phase("oscillator", model, 0.0, duration)
    leg.initial(x=0.0, z=0.0)
    leg.final(**final)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(0.5 * (x**2 - z**2)))
    return problem


@pytest.mark.parametrize(
    ("final", "conjugate"), [({"x": 0.0, "z": 0.0}, np.pi), ({"z": 0.0}, np.pi), ({}, 0.5 * np.pi)]
)
@pytest.mark.parametrize("share", [0.99, 1.01])
def test_conjugate_times_of_a_totally_singular_arc(
    final: dict[str, float], conjugate: float, share: float
) -> None:
    """Jumps of x at both ends cost nothing, so that its end values do not matter."""
    verdict = verdict_at_rest(oscillator(share * conjugate, **final), share * conjugate)
    assert verdict[NAME_GOH].result is (go.ConditionResult.PASS if share < 1 else go.ConditionResult.FAIL), (
        verdict[NAME_GOH]
    )
    assert verdict.minimum is (share < 1)
    # First-order conditions and Kelley's condition hold either way.
    assert all(c.result is go.ConditionResult.PASS for c in verdict.conditions if c.name != NAME_GOH)


def test_curvature_does_not_depend_on_the_mesh() -> None:
    base, finer = (verdict_at_rest(oscillator(3.0, z=0.0), 3.0, n)[NAME_GOH].value for n in (9, 17))
    assert finer == pytest.approx(base, rel=5e-3)


def arrival(x0: float, duration: float) -> tuple[go.Problem, Any, Any, Any]:
    """x falls from x0 to 0 at the rate 1, and z rises from -x0^2 / 2 to 0: there both stay, on a singular arc.

    Backwards from the arc the costate of x grows by s^2 / 2 + s^4 / 24: u = -1 is right.
    """
    problem = oscillator(duration)
    leg = problem.phases["leg"]
    leg.initial(x=x0, z=-0.5 * x0**2)
    t = np.unique(np.concatenate([np.linspace(0.0, x0, 13), np.linspace(x0, duration, 7)]))
    left = np.maximum(x0 - t, 0.0)
    return problem, t, np.stack([left, -0.5 * left**2]), np.where(t < x0, -1.0, 0.0)


@pytest.mark.parametrize(
    ("length", "result"), [(0.98, go.ConditionResult.PASS), (1.02, go.ConditionResult.FAIL)]
)
def test_a_bang_arc_before_takes_nothing_from_the_focal_time(
    length: float, result: go.ConditionResult
) -> None:
    """Only along the singular arc, whose focal time is pi / 2, may u be varied, and when it begins."""
    problem, t, x, u = arrival(0.8, 0.8 + length * 0.5 * np.pi)
    verdict = go.verify_trajectory(problem, t, x, {"u": u})
    assert verdict[NAME_GOH].result is result, verdict.explain()
    assert verdict.minimum is (result is go.ConditionResult.PASS)


@pytest.mark.parametrize(
    ("swing", "result"), [(0.9, go.ConditionResult.PASS), (1.1, go.ConditionResult.FAIL)]
)
def test_controls_that_alternate_from_node_to_node_gain_nothing(
    swing: float, result: go.ConditionResult
) -> None:
    """x^2 / 2 + swing t x u is (1 - swing) x^2 / 2 but for what an end that is given adds.

    The quadrature of t x u would take alternating controls for a gain if all of them were varied.
    """
    model, x, _z, u = dynamics("swing", "x z", "u", lambda x, z, u: {x: u, z: 0.1 * x})
    problem, leg = one_phase("swing", model, 0.0, 1.0)
    leg.initial(x=0.0, z=0.0)
    leg.final(x=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(0.5 * x**2 + swing * model.time * x * u))
    verdict = verdict_at_rest(problem, 1.0)
    assert verdict[NAME_GOH].result is verdict["second order"].result is result
    assert verdict.minimum is (result is go.ConditionResult.PASS)


END_COSTS: list[tuple[str, Callable[[Any, Any, Any], Any], go.ConditionResult]] = [
    ("nothing", lambda leg, x, u: 0.0, go.ConditionResult.PASS),
    (
        "what the control does not move at once",
        lambda leg, x, u: leg.final_state("z") ** 2,
        go.ConditionResult.PASS,
    ),
    ("a square", lambda leg, x, u: leg.final_state("x") ** 2, go.ConditionResult.PASS),
    ("the same as an integral", lambda leg, x, u: leg.integral(2 * x * u), go.ConditionResult.PASS),
    ("a negative square", lambda leg, x, u: -(leg.final_state("x") ** 2), go.ConditionResult.FAIL),
    ("a cube", lambda leg, x, u: -(leg.final_state("x") ** 3), go.ConditionResult.INCONCLUSIVE),
    ("a cube as an integral", lambda leg, x, u: -leg.integral(3 * x**2 * u), go.ConditionResult.INCONCLUSIVE),
]


@pytest.mark.parametrize(("cost", "result"), [pytest.param(c, r, id=name) for name, c, r in END_COSTS])
def test_what_the_end_feels_of_a_last_moment(cost: Any, result: go.ConditionResult) -> None:
    """u = 1 for the last w: x^2 / 2 costs w^3 / 6 and x(1)^3 is w^3: the second variation does not tell of it."""
    model, x, _z, u = dynamics("last moment", "x z", "u", lambda x, z, u: {x: u, z: 0.1 * x})
    problem, leg = one_phase("last moment", model, 0.0, 1.0)
    leg.initial(x=0.0, z=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(0.5 * x**2, "effort") + cost(leg, x, u))
    verdict = verdict_at_rest(problem, 1.0)
    assert verdict[NAME_GOH].result is result, verdict[NAME_GOH]
    assert verdict.ok is (verdict[NAME_GOH].value < 1e-4) is (result is not go.ConditionResult.FAIL)
    if result is go.ConditionResult.INCONCLUSIVE:
        assert "along a final impulse of the control is" in verdict[NAME_GOH].where


@pytest.mark.parametrize(
    ("final", "minimum"),
    [
        ((-1.0, 1.0), True),
        ((-1.0, np.inf), True),
        ((0.0, np.inf), False),
        ((-np.inf, 0.0), False),
        (0.0, True),
    ],
)
def test_a_final_bound_leaves_an_impulse_without_curvature_if_it_is_active(final: Any, minimum: bool) -> None:
    """x' = u at rest at x = 0 with x(1) at one bound, inside its bounds, or fixed."""
    model, x, _z, _u = dynamics("last moment", "x z", "u", lambda x, z, u: {x: u, z: 0.1 * x})
    problem, leg = one_phase("last moment", model, 0.0, 1.0)
    leg.initial(x=0.0, z=0.0)
    leg.final(x=final)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(0.5 * x**2 + 0.1 * x**3))
    verdict = verdict_at_rest(problem, 1.0)
    assert verdict.ok and verdict.minimum is minimum
    assert ("along a final impulse of the control is zero" in verdict[NAME_GOH].where) is not minimum


def test_the_curvature_along_a_final_impulse_does_not_depend_on_the_unit_of_time() -> None:
    """x' = u / T and the cost of x^2 / 2 on average, less x(T)^2: an impulse of u T gives -2 u^2."""
    values = []
    for duration in (1.0, 4.0):
        rates = lambda x, z, u, T=duration: {x: u / T, z: 0.1 * x / T}  # noqa: E731
        model, x, _z, _u = dynamics("last moment", "x z", "u", rates)
        problem, leg = one_phase("last moment", model, 0.0, duration)
        leg.initial(x=0.0, z=0.0)
        leg.bounds(u=(-1.0, 1.0))
        problem.minimize(leg.integral(0.5 * x**2 / duration) - leg.final_state("x") ** 2)
        values.append(verdict_at_rest(problem, duration)[NAME_GOH].value)
    assert values[0] > 1e-4 and values[0] == pytest.approx(values[1], rel=1e-9)


@pytest.mark.parametrize(("square", "slope"), [(0.1, 1.0), (-0.1, -1.0)])
def test_a_final_impulse_costs_the_same_in_every_frame(square: float, slope: float) -> None:
    """x' = u with x = ln(1 + y): b x(T) less the integral of b u is constant, and no quadratic form in y > -1."""
    model, y, _z, u = dynamics("frame", "y z", "u", lambda y, z, u: {y: (1 + y) * u, z: 0.1 * y})
    problem, leg = one_phase("frame", model, 0.0, 1.0)
    leg.initial(y=0.0, z=0.0)
    leg.bounds(u=(-1.0, 1.0))
    x, last = ca.log(1 + y), ca.log(1 + leg.final_state("y"))
    problem.minimize(leg.integral(0.5 * x**2 - slope * u) + square * last**2 + slope * last)
    result = verdict_at_rest(problem, 1.0)[NAME_GOH].result
    assert result is (go.ConditionResult.PASS if square > 0 else go.ConditionResult.FAIL)


def test_the_time_at_which_a_singular_arc_begins_is_no_variation_of_its_own() -> None:
    """u = -1 until x = 0, then 0, for least x^2 + c x^3: along x = 0 the second variation does not depend on c."""
    values = []
    for cubic in (0.5, -0.2):
        model, x, _u = dynamics("bang, singular", "x", "u", lambda x, u: {x: u})
        problem, leg = one_phase("bang, singular", model, 0.0, 2.0)
        leg.initial(x=1.0)
        leg.bounds(u=(-1.0, 1.0))
        problem.minimize(leg.integral(x**2 + cubic * x**3))
        t = np.concatenate([np.linspace(0.0, 1.0, 5), np.linspace(1.0, 2.0, 5)])
        verdict = go.verify_trajectory(problem, t, np.maximum(1 - t, 0.0), np.repeat([-1.0, 0.0], 5))
        assert verdict.minimum, verdict.explain()
        values.append(verdict["second order"].value)
    assert values[0] < -0.1 and values[0] == pytest.approx(values[1], rel=1e-9)


def test_a_segment_is_singular_as_a_whole_or_partly() -> None:
    """x' = u with a cost of x alone: u rises from 0 to its bound in the first segment, and is 0.5 in the second."""
    model, x, _u = dynamics("one", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("one", model, 0.0, 2.0)
    problem.minimize(leg.integral(x))
    one = lambda t, k: np.array([1.0 + 0 * t])  # noqa: E731
    for first, partly in ((lambda t: np.minimum(2 * t, 1.0), True), (lambda t: 0.2 + 0.5 * t, False)):
        s = by_hand.samples(
            problem,
            one,
            lambda t, k, f=first: np.array([f(t) if k == 0 else 0.5 + 0 * t]),
            one,
            weights=(1.0,),
            breaks=(0.0, 1.0, 2.0),
            control_bounds=by_hand.interval(-1.0, 1.0),
        )
        np.testing.assert_array_equal(mask_singular_segments(s), [[not partly, True]])
        assert _has_partly_singular_segment(s) is partly


@pytest.mark.parametrize(("limit", "push", "held"), [(1.0, 0.3, True), (1.0, 0.0, False), (2.0, 0.0, False)])
def test_a_control_that_a_state_limit_determines_is_not_singular(
    limit: float, push: float, held: bool
) -> None:
    """x' = u along x = 1: with a multiplier the limit x <= 1 keeps u at 0, without one H has to."""
    model, x, _u = dynamics("one", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("one", model, 0.0, 2.0)
    problem.minimize(leg.integral(-push * x))
    s = by_hand.samples(
        problem,
        lambda t, k: np.array([1.0 + 0 * t]),
        lambda t, k: np.array([0 * t]),
        lambda t, k: np.array([0 * t]),
        weights=(1.0,),
        breaks=(0.0, 1.0, 2.0),
        control_bounds=by_hand.interval(-1.0, 1.0),
        state_bounds=by_hand.interval(-1.0, limit),
        states=lambda t, k: np.array([push + 0 * t]),
    )
    np.testing.assert_array_equal(mask_singular_segments(s), [[not held, not held]])
    assert not _has_partly_singular_segment(s)


@pytest.mark.parametrize(
    ("limit", "free"),
    [("state", [1, 1, 0, 0, 1, 1]), ("path", [1, 1, 0, 0, 1, 1]), ("control", [0, 0, 1, 1, 1, 1])],
)
def test_segments_with_an_active_limit_are_not_varied_by_integrals(limit: str, free: list[int]) -> None:
    """x' = u for least u^2 - x, over 3 s: x <= 0.5 is active around 1.5 s, and u <= 0.4 in the first second."""
    model, x, u = dynamics("hop", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("hop", model, 0.0, 3.0)
    leg.initial(x=0.0)
    leg.final(x=0.0)
    if limit == "path":
        leg.path("ceiling", x, upper=0.5)
    else:
        leg.bounds(**({"x": (-5.0, 0.5)} if limit == "state" else {"u": (-5.0, 0.4)}))
    problem.minimize(leg.integral(u**2 - x))
    solution = recompute_stored_data(go.solve(problem, mesh="6x5", tol=None))
    cone = build_critical_cone(solution, list(solution.samples().values()), 0.0)
    unlimited = _mask_segments_without_active_limits(cone, cone.point.transcription.parts["leg"])
    np.testing.assert_array_equal(unlimited, [np.array(free, dtype=bool)])


def test_singular_segments_are_cut_and_movable_boundaries_stay() -> None:
    mesh = go.Mesh((0.0, 0.2, 0.5, 1.0), (3, 8, 4), (1, 2))
    finer = refine_mesh_at_singular_arc_ends(mesh, np.array([False, True, False]))
    first, last = ARC_END_CUTS
    n = len(first + last) + 1
    assert finer.degrees == (3, *[8] * n, 4) and finer.movable == (1, 1 + n)
    np.testing.assert_allclose(finer.breaks[1 : 2 + n], [0.2, *(0.2 + 0.3 * np.array(first + last)), 0.5])
    refined = refine_mesh_at_singular_arc_ends(mesh, np.array([True, False, False]))
    assert refined.degrees[:n] == (SINGULAR_SEGMENT_MIN_POINTS,) * n
    # an arc of several segments is narrow at its ends, not wherever the mesh has a boundary
    arc = refine_mesh_at_singular_arc_ends(mesh, np.array([False, True, True]))
    np.testing.assert_allclose(
        arc.breaks, [0.0, 0.2, *(0.2 + 0.3 * np.array(first)), 0.5, *(0.5 + 0.5 * np.array(last)), 1.0]
    )
    assert arc.degrees == (3, 8, 8, 8, *[SINGULAR_SEGMENT_MIN_POINTS] * 3) and arc.movable == (1, 4)
    assert refine_mesh_at_singular_arc_ends(mesh, np.zeros(3, dtype=bool)) == mesh


def test_an_end_that_curves_downwards_fails_where_nothing_else_curves() -> None:
    """From rest any way gains x(1)^2, and u^4 takes less of it; H does not curve at zero, and nothing was told."""
    model, _x, u = dynamics("last moment", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("last moment", model, 0.0, 1.0)
    leg.initial(x=0.0)
    problem.minimize(leg.integral(u**4) - leg.final_state("x") ** 2)
    t = np.linspace(0.0, 1.0, 9)
    verdict = go.verify_trajectory(problem, t, 0 * t, 0 * t)
    assert verdict[NAME_GOH].result is go.ConditionResult.FAIL, verdict[NAME_GOH]
