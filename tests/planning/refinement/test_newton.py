"""Newton's method on switch times: steps, costates, collocated flights, and warm starts."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, get_args

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq
from testing.constructed_solutions import cart as constructed_cart
from testing.constructed_solutions import costates, interval, phase, solution
from testing.internals import ArcMesh, Interval, PhaseStructure, Scheme, Switches, detect_control_structure
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.planning import ArcKind
from gnc_opt.planning.refinement import warm_start_from_known_arcs as v
from gnc_opt.planning.refinement.switching import bang_bang_extremal as c
from gnc_opt.planning.refinement.switching import bang_bang_extremal as switch_step
from gnc_opt.planning.refinement.switching import newton_iteration as n
from gnc_opt.planning.refinement.switching.bang_bang_extremal import (
    BangBangExtremal,
    are_gradients_independent,
    collocate_trajectory,
    compute_newton_step,
    compute_simplified_newton_step,
    minimise_quadratic_model,
)
from gnc_opt.planning.refinement.switching.newton_iteration import find_optimal_switching_times
from problems.rendezvous import SWITCHES, build

# Newton's method on switch times against closed forms.


LOWER, UPPER, INTERIOR = ArcKind.LOWER, ArcKind.UPPER, ArcKind.INTERIOR


def carts(*distances: float, initial: float = 0.0) -> go.Problem:
    """Carts that come to rest at 0 together, in least time, |a| <= 1: for one from d, t = 2 sqrt(d)."""
    model = go.Model("carts")
    q = model.state("q", len(distances))
    v = model.state("v", len(distances))
    a = model.control("a", len(distances))
    model.ode({q: v, v: a})
    problem, leg = one_phase("carts", model, initial=initial, final=(initial + 0.1, initial + 100.0))
    leg.initial(q=np.array(distances), v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=([-1.0] * len(distances), [1.0] * len(distances)))
    problem.minimize(leg.final_time)
    return problem


def oscillator() -> go.Problem:
    """x'' + x = u, |u| <= 1, from 5 at rest to the origin in least time."""
    model, _q, _v, _u = dynamics("oscillator", "q v", "u", lambda q, v, u: {q: v, v: u - q})
    problem, leg = one_phase("oscillator", model, initial=0.0, final=(0.1, 20.0))
    leg.initial(q=5.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    return problem


@pytest.fixture(scope="module")
def cart() -> go.Solution:
    return go.solve(carts(4.0), mesh="8x3", tol=None)


def structure(times: list[float], *kinds: ArcKind, others: int = 2) -> PhaseStructure:
    """Of one control and so many states."""
    rows = tuple((kind, *(INTERIOR,) * others) for kind in kinds)
    return PhaseStructure(tuple(times), rows, (False,) * (1 + others), 1, 0)


def collocated(known: go.Solution, found: PhaseStructure, flight: BangBangExtremal) -> go.Solution:
    return collocate_trajectory(known, flight, ArcMesh.from_integration_steps(found, flight.step_times))


@pytest.mark.parametrize("times", [[0.0, 1.5, 4.5], [0.0, 2.6, 3.4]])
def test_switch_and_end_time_of_one_cart(cart: go.Solution, times: list[float]) -> None:
    found, flight = find_optimal_switching_times(cart, structure(times, LOWER, UPPER)) or pytest.fail(
        "does not settle"
    )
    guess = collocated(cart, found, flight)
    assert found.times == pytest.approx([0.0, 2.0, 4.0], abs=1e-6)
    assert [row[0] for row in found.kinds] == [LOWER, UPPER]
    leg = guess.phase("leg")
    t = np.linspace(0.0, 4.0, 9)
    # Before and after the switch at 2 s.
    expected = np.where(t < 2, 4 - t**2 / 2, (4 - t) ** 2 / 2)
    assert leg.x(t)[0] == pytest.approx(expected, abs=1e-6)
    # H = 1 + lambda_q v + lambda_v a = 0 and lambda_v(2) = 0: lambda_q = 1/2, lambda_v = 1 - t/2.
    assert leg.lam(t) == pytest.approx(np.stack([np.full(9, 0.5), 1 - t / 2]), abs=1e-6)


def test_superfluous_arcs_vanish(cart: go.Solution) -> None:
    found, _ = (
        find_optimal_switching_times(cart, structure([0.0, 0.3, 2.2, 2.5, 4.1], UPPER, LOWER, UPPER, LOWER))
        or pytest.fail()
    )
    assert found.times == pytest.approx([0.0, 2.0, 4.0], abs=1e-6)
    assert [row[0] for row in found.kinds] == [LOWER, UPPER]


def test_oscillator_switches_every_half_period() -> None:
    solution = go.solve(oscillator(), mesh="20x3", tol=None)
    found, _ = find_optimal_switching_times(
        solution, detect_control_structure(solution.samples()["leg"])
    ) or pytest.fail("does not settle")
    inner = found.times[1:-1]
    assert len(inner) > 1 and np.diff(inner) == pytest.approx(np.full(len(inner) - 1, np.pi), abs=1e-6)


def test_switches_of_several_controls_pass_each_other() -> None:
    """Found on 10 segments, the order of the 19 switches is wrong, and an arc is missing."""
    solution = go.solve(build(case=1), mesh="10x3", tol=None)
    found, _ = find_optimal_switching_times(
        solution, detect_control_structure(solution.samples()["approach"])
    ) or pytest.fail("does not settle")
    assert found.times[-1] == pytest.approx(25.8699620765, abs=2e-7)
    for i, channel in enumerate(SWITCHES[1].values()):
        own = [found.times[k] for k in range(1, found.n_subarcs) if i in found.find_changed_arcs(k)]
        assert own == pytest.approx(channel.switching_times, abs=1e-4)


def fuller() -> go.Problem:
    """x'' = u, |u| <= 1, from 1 at rest to the origin at rest in 3 s, at the least integral of x^2."""
    model, x, _v, _u = dynamics("cart", "x v", "u", lambda x, v, u: {x: v, v: u})
    problem, leg = one_phase("Fuller", model, initial=0.0, final=3.0)
    leg.initial(x=1.0, v=0.0)
    leg.final(x=0.0, v=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(x**2))
    return problem


@pytest.mark.slow
def test_a_singular_arc_that_is_met_by_chattering() -> None:
    """The optimum switches on x = -z v|v| ever faster, z^2 = (sqrt(33) - 1) / 24, until it rests after 2.715 s.

    Its cost, 0.764017547725633, is the geometric series of the arcs between (Fuller 1963; Zelikin & Borisov 1994).
    """
    found = go.solve(fuller())
    z = np.sqrt((np.sqrt(33) - 1) / 24)
    first = np.sqrt(1 / (z + 0.5))  # where 1 - t^2 / 2 = z t^2
    times = [arc.start for arc in found.structure][1:]
    assert [arc.kind for arc in found.structure] == [LOWER, UPPER, LOWER, UPPER, ArcKind.SINGULAR]
    assert times[:2] == pytest.approx([first, 2.3069051155183793], abs=1e-4)  # by chattering that is cut off
    assert 0 < found.objective - 0.764017547725633 < 2e-8
    assert go.verify(found).ok


def test_a_shift_of_the_clock_changes_nothing(cart: go.Solution) -> None:
    later = go.solve(carts(4.0, initial=1000.0), mesh="8x3", tol=None)
    found, _ = (
        find_optimal_switching_times(later, structure([1000.0, 1001.5, 1004.5], LOWER, UPPER))
        or pytest.fail()
    )
    assert found.times == pytest.approx([1000.0, 1002.0, 1004.0], abs=1e-6)


def test_active_limits_of_the_end_are_left_to_others() -> None:
    """The final speed may be up to 0.5, and is: the limit decides where it is, and is no equality."""
    problem = carts(4.0)
    leg = problem.phases["leg"]
    leg.final(q=0.0, v=(-0.5, 0.0))
    solution = go.solve(problem, mesh="8x3", tol=None)
    assert find_optimal_switching_times(solution, structure([0.0, 2.0, 4.0], LOWER, UPPER)) is None


def test_conditions_that_depend_on_each_other_are_left_to_others() -> None:
    """The angle's cosine and sine are both held at the end: one of them follows, and has no multiplier of its own."""
    model, _c, _s, _w, _a = dynamics("pointing", "c s w", "a", lambda c, s, w, a: {c: -s * w, s: c * w, w: a})
    problem, leg = one_phase("pointing", model, initial=0.0, final=(0.1, 10.0))
    leg.initial(c=1.0, s=0.0, w=0.0)
    leg.final(c=0.0, s=1.0, w=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    solution = go.solve(problem, mesh="8x3", tol=None)
    half = np.sqrt(np.pi / 2)
    assert (
        find_optimal_switching_times(solution, structure([0.0, half, 2 * half], UPPER, LOWER, others=3))
        is None
    )


@pytest.mark.parametrize("kind", [INTERIOR, ArcKind.SINGULAR])
def test_controls_between_their_bounds_are_left_to_others(cart: go.Solution, kind: ArcKind) -> None:
    assert find_optimal_switching_times(cart, structure([0.0, 1.0, 4.0], kind, UPPER)) is None


def test_states_on_their_bounds_are_left_to_others(cart: go.Solution) -> None:
    held = structure([0.0, 2.0, 4.0], LOWER, UPPER)
    kinds = ((LOWER, INTERIOR, LOWER), held.kinds[1])
    assert find_optimal_switching_times(cart, replace(held, kinds=kinds)) is None


@pytest.mark.parametrize("unit", [1.0, 1e12, 1e-12])
def test_dependence_of_conditions_is_none_of_units(unit: float) -> None:
    rows = np.array([[1.0, 2.0, 3.0], [2.0, 4.0, 6.1]]) * np.array([[1.0], [unit]])
    assert are_gradients_independent(rows)
    assert not are_gradients_independent(rows @ np.diag([1.0, 1.0, 0.0]))
    assert not are_gradients_independent(np.vstack([rows, np.zeros(3)]))


def test_refinement_then_needs_one_pass() -> None:
    refined = go.refine(go.solve(oscillator(), mesh="20x3", tol=None))
    assert refined.history is not None and refined.history.converged
    assert len(refined.history.passes) <= 2


def measured() -> go.Problem:
    """A cart from 4 m in least time that adds up where it is: 8 m s."""
    problem = carts(4.0)
    leg = problem.phases["leg"]
    leg.integral(leg.model.symbol("q")[0], name="area")
    return problem


def test_a_guess_has_the_integrals_costates_and_multipliers_of_the_flow() -> None:
    solution = go.solve(measured(), mesh="8x3", tol=None)
    found, flight = find_optimal_switching_times(
        solution, structure([0.0, 1.5, 4.5], LOWER, UPPER)
    ) or pytest.fail("does not settle")
    guess = collocated(solution, found, flight)
    leg = guess.phase("leg")
    assert leg.integral("area") == pytest.approx(8.0, abs=1e-5)
    assert (leg.initial_time, leg.final_time) == pytest.approx((0.0, 4.0), abs=1e-6)
    assert leg.breaks[[0, -1]] == pytest.approx([0.0, 4.0], abs=1e-6)
    assert np.asarray(leg.mesh.breaks) * 4 == pytest.approx(leg.breaks, abs=1e-6)
    middles = 0.5 * (leg.breaks[1:] + leg.breaks[:-1])
    assert leg.u(middles)[0] == pytest.approx(np.where(middles < 2, -1.0, 1.0))
    assert leg.lam_start == pytest.approx(leg.lam(leg.breaks[:-1]), abs=1e-9)
    assert leg.lam_end == pytest.approx(leg.lam(leg.breaks[1:], "left"), abs=1e-9)
    assert leg.point_costates == pytest.approx(leg.lam(leg.point_times), abs=1e-6)
    assert leg.control_multipliers.shape == (1, leg.mesh.size) and not leg.state_impulses[:, 1:-1].any()
    # Flown with its own control it ends where it says.
    assert go.verify(guess)["dynamics"].result is go.ConditionResult.PASS


def test_conditions_and_costs_at_the_ends_count() -> None:
    """As far as possible from rest to rest in 6 s, where the rest is a constraint: lam_q = -1, lam_v = t - 3, nu = 3.

    The integral of the time, a constant, is there to be carried along.
    """
    model, *_ = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("far", model, 0.0, 6.0)
    leg.initial(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.constrain("stop", leg.final_state("v"), equals=0.0)
    problem.minimize(leg.integral(model.time) / 8 - leg.final_state("q"))
    solution = go.solve(problem, mesh="9x3", tol=None)
    start = structure([0.0, 2.0, 6.0], UPPER, LOWER)
    found, flight = find_optimal_switching_times(solution, start) or pytest.fail("does not settle")
    guess = collocated(solution, found, flight)
    assert found.times == pytest.approx([0.0, 3.0, 6.0], abs=1e-6)
    assert guess.constraint_multipliers == pytest.approx([3.0], abs=1e-5)
    t = np.linspace(0.0, 6.0, 7)
    assert guess.phase("leg").lam(t) == pytest.approx(np.stack([-1 + 0 * t, t - 3]), abs=1e-5)


@pytest.mark.parametrize("accuracy", [1e-4, 1e-9])
def test_the_flow_itself_is_as_accurate_as_requested(accuracy: float) -> None:
    """v' = a - v^2 / 10, rest to rest over 1 m: SciPy's own answer, to the accuracy and its root."""
    model, _q, _v, _a = dynamics("dragged", "q v", "a", lambda q, v, a: {q: v, v: a - 0.1 * v**2})
    problem, leg = one_phase("dragged", model, 0.0, (0.1, 10.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    # v = r tanh(t / r) with r = sqrt(10), then v = r tan((t_f - t) / r), the top speed w being the same.
    r = np.sqrt(10.0)

    def length(w: float) -> float:
        return float(-5 * np.log(1 - w**2 / 10) + 5 * np.log(1 + w**2 / 10))

    w = float(brentq(lambda w: length(w) - 1.0, 0.1, 2.0, xtol=1e-15))
    switch, end = r * np.arctanh(w / r), r * np.arctanh(w / r) + r * np.arctan(w / r)
    solution = go.solve(problem, mesh="5x3", tol=None)
    found, flight = (
        find_optimal_switching_times(solution, structure([0.0, 0.9, 2.1], UPPER, LOWER), accuracy)
        or pytest.fail()
    )
    guess = collocated(solution, found, flight)
    assert found.times[2] == pytest.approx(end, rel=2 * accuracy)
    assert found.times[1] == pytest.approx(switch, abs=2 * np.sqrt(accuracy) * end)
    assert guess.phase().x(guess.phase().breaks[-1], "left") == pytest.approx(
        [1.0, 0.0], abs=10 * np.sqrt(accuracy)
    )
    assert (
        find_optimal_switching_times(solution, structure([0.0, 0.9, 2.1], INTERIOR, LOWER), accuracy) is None
    )


def test_a_step_with_its_own_matrices_is_newtons() -> None:
    """Of the flight with one Newton step's multipliers, in a problem with an end constraint and a cost at both ends."""
    known, problem = carts(4.0), go.Problem("otherwise")
    leg = problem.phase("leg", known.phases["leg"].model)
    leg.time(initial=0.0, final=(0.1, 100.0))
    leg.initial(q=4.0, v=0.0)
    leg.final(v=0.0)
    leg.bounds(a=([-1.0], [1.0]))
    q = leg.final_state("q")[0]
    problem.constrain("there", q + 0.1 * leg.final_time**2, equals=1.0)
    problem.minimize(leg.final_time + 0.3 * q**2)
    solution = go.solve(known, mesh="8x3", tol=None)
    (s,) = solution.samples().values()
    at = Switches(np.array([1.9]), np.array([0]), np.array([-1.0]), np.array([0.0, 4.2]), np.zeros(1), ())
    stated = replace(s, phase=replace(s.phase, final_bounds=leg.numbers.final))
    own = compute_newton_step(problem, stated, at) or pytest.fail("no step")
    again = compute_simplified_newton_step(problem, stated, at, own) or pytest.fail("no step")
    assert again.change == pytest.approx(own.change, abs=1e-10) and np.max(np.abs(own.change)) > 0.01
    assert again.gain == pytest.approx(own.gain)
    np.testing.assert_array_equal(again.flow.final_state, own.flow.final_state)
    # Twice: the second one begins with the multipliers of the first one.
    moved = replace(at, times=at.times + own.change[1:-1], ends=at.ends + own.change[[0, -1]])
    twice = compute_simplified_newton_step(problem, stated, moved, again) or pytest.fail("no step")
    newer = compute_newton_step(problem, stated, moved) or pytest.fail("no step")
    assert np.max(np.abs(twice.change - newer.change)) < 0.3 * np.max(np.abs(newer.change))


# Newton's method on switch times, part by part: steps, arcs that stand in the way, arcs that are missing.


RNG = np.random.default_rng(4)


def switches(
    times: list[float], channels: list[int], first: Any = (-1.0, 4.0), ends: Any = (1.0, 11.0)
) -> Switches:
    """Of two controls, one from -1 to 1, one from 2 to 4."""
    return Switches(
        np.array(times, float),
        np.array(channels, int),
        np.array(first, float),
        np.array(ends, float),
        np.array([0.0, 6.0]),
        (),
    )


def step(*change: float) -> Any:
    return SimpleNamespace(change=np.array(change))


def test_a_step_is_that_of_the_optimality_system() -> None:
    rough = RNG.standard_normal((5, 5))
    hessian, gradient = rough @ rough.T + np.eye(5), RNG.standard_normal(5)
    rows, residuals = RNG.standard_normal((2, 5)), RNG.standard_normal(2)
    system = np.block([[hessian, rows.T], [rows, np.zeros((2, 2))]])
    wanted = np.linalg.solve(system, -np.concatenate([gradient, residuals]))[:5]
    assert minimise_quadratic_model(hessian, gradient, rows, residuals) == pytest.approx(wanted)


def test_where_conditions_leave_nothing_open_the_step_meets_them() -> None:
    rows = RNG.standard_normal((3, 3))
    wanted = np.array([1.0, -2.0, 3.0])
    assert minimise_quadratic_model(np.eye(3), np.ones(3), rows, -rows @ wanted) == pytest.approx(wanted)


def test_negative_curvatures_are_reversed() -> None:
    """x is held; along y and z, curvatures of -2 and 5 and slopes of 4 and -10: down both, by 2 and by 2."""
    hessian, gradient = np.diag([7.0, -2.0, 5.0]), np.array([1.0, 4.0, -10.0])
    found = minimise_quadratic_model(hessian, gradient, np.array([[2.0, 0.0, 0.0]]), np.array([3.0]))
    assert found == pytest.approx([-1.5, -2.0, 2.0])


@pytest.mark.parametrize(
    ("rows", "independent"),
    [
        ([[1.0, 0.0], [1.0, 1.0]], True),
        ([[1.0, 0.0], [1e-8, 1e-8]], True),
        ([[1.0, 2.0], [-2.0, -4.0]], False),
        ([[1.0, 0.0], [0.0, 0.0]], False),
        ([[1.0, 2.0]], True),
        ([[1.0, 1.0], [1.0, 1.0 + 1e-10]], False),
        ([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], False),
    ],
)
def test_conditions_are_independent_in_any_units(rows: Any, independent: bool) -> None:
    assert switch_step.are_gradients_independent(np.array(rows)) is independent


def test_arcs_of_every_control_from_end_to_end() -> None:
    """The second control switches first, then the first one, twice: unknowns 1 to 3 between 0 and 4."""
    assert n._list_arc_switches(switches([4.0, 3.0, 6.0], [0, 1, 0])) == [
        (0, 1),
        (1, 3),
        (3, 4),
        (0, 2),
        (2, 4),
    ]
    assert n._list_arc_switches(switches([6.0, 4.0], [0, 0])) == [(0, 2), (2, 1), (1, 3), (0, 3)]


def test_an_arc_is_added_between_two_switches_of_its_control() -> None:
    before = switches([3.0], [1])
    inner = n._insert_bang_arc(before, 0, 4.0, 6.0)
    assert (inner.times.tolist(), inner.channels.tolist()) == ([3.0, 4.0, 6.0], [1, 0, 0])
    assert inner.first.tolist() == [-1.0, 4.0]
    early = n._insert_bang_arc(before, 1, 1.0, 2.0)
    assert (early.times.tolist(), early.channels.tolist()) == ([3.0, 2.0], [1, 1])
    assert early.first.tolist() == [-1.0, 2.0] and before.first.tolist() == [-1.0, 4.0]
    late = n._insert_bang_arc(before, 0, 9.0, 11.0)
    assert (late.times.tolist(), late.channels.tolist(), late.first.tolist()) == (
        [3.0, 9.0],
        [1, 0],
        [-1.0, 4.0],
    )
    whole = n._insert_bang_arc(before, 0, 1.0, 11.0)
    assert whole.times.tolist() == [3.0] and whole.first.tolist() == [1.0, 4.0]


def test_polynomials_through_values_and_rates() -> None:
    """t^7 - 2 t and 4 - t^2 over uneven segments come back, rates and all."""

    def values(t: Any) -> Any:
        return np.array([t**7 - 2 * t, 4 - t**2])

    def rates(t: Any) -> Any:
        return np.array([7 * t**6 - 2, -2 * t])

    breaks = np.array([1.0, 1.5, 4.0])
    given = (breaks[:-1, None] + np.diff(breaks)[:, None] * np.array([0, 1, 2, 3]) / 3).ravel()
    found = c._interpolate_hermite(breaks, values(given), rates(given))
    t = np.linspace(1.0, 4.0, 13)
    assert found(t) == pytest.approx(values(t)) and found.derivative()(t) == pytest.approx(rates(t))


# Flights as solutions on a mesh, against closed forms: what refining a bang-bang solution returns without
# a solve.


def pulled() -> go.Problem:
    """From 5 at rest to the origin in least time, x'' + x = u, |u| <= 1, and what half of u^2 adds up to."""
    model, _q, _v, u = dynamics("oscillator", "q v", "u", lambda q, v, u: {q: v, v: u - q})
    problem, leg = one_phase("oscillator", model, initial=0.0, final=(0.1, 20.0))
    leg.initial(q=5.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(u=(-1.0, 1.0))
    leg.integral(0.5 * u**2, name="effort")
    problem.minimize(leg.final_time)
    return problem


def circles(t: np.ndarray, switches: np.ndarray, first: float) -> np.ndarray:
    """States under u = first, -first, ... : turns about (u, 0) in the phase plane."""
    found, begun, start, u = np.empty((2, t.size)), 0.0, np.array([5.0, 0.0]), first
    for end in [*switches, np.inf]:
        here = (t >= begun) & (t <= end)
        for k in [*np.flatnonzero(here), None]:
            turn = (end if k is None else t[k]) - begun
            if not np.isfinite(turn):
                break
            q, v = start[0] - u, start[1]
            there = np.array([u + q * np.cos(turn) + v * np.sin(turn), v * np.cos(turn) - q * np.sin(turn)])
            if k is not None:
                found[:, k] = there
        begun, start, u = end, there, -u
    return found


@pytest.fixture(scope="module", params=get_args(Scheme))
def refined(request: pytest.FixtureRequest) -> go.Solution:
    return go.solve(pulled(), mesh="10x3", scheme=request.param)


def test_states_costates_and_cost_are_those_of_the_closed_form(refined: go.Solution) -> None:
    """Arcs of pi between the switches; lam_v is a sine that vanishes there, H = 0 its size."""
    leg = refined.phase()
    switches = np.array([arc.end for arc in refined.structure[:-1]])
    assert np.diff(switches) == pytest.approx(np.pi, abs=1e-8)
    t = np.linspace(0.0, leg.final_time, 300)
    assert leg.x(t) == pytest.approx(circles(t, switches, -1.0), abs=1e-8)
    assert leg.x(leg.final_time, "left") == pytest.approx([0.0, 0.0], abs=1e-10)
    # 1 + lam_q v + lam_v (u - q) = 0 at the start, where v = 0 and u - q = -6: lam_v = 1/6 there.
    size = 1 / 6 / np.sin(switches[0])
    lam = np.stack([size * np.cos(switches[0] - t), size * np.sin(switches[0] - t)])
    assert leg.lam(t) == pytest.approx(lam, abs=1e-7)
    assert leg.point_costates == pytest.approx(leg.lam(leg.point_times), abs=1e-7)
    assert refined.objective == leg.final_time and leg.integral("effort") == pytest.approx(leg.final_time / 2)
    # A held start and end are worth the costates there; a bound on a control what moving it would gain.
    assert leg.state_impulses[:, 0] == pytest.approx(-lam[:, 0], abs=1e-7)
    assert leg.state_impulses[:, -1] + np.array([0.0, 1.0]) == pytest.approx(
        lam[:, -1] + [0.0, 1.0], abs=1e-7
    )
    assert leg.control_multipliers == pytest.approx(-leg.lam(leg.point_times)[1:], abs=1e-7)


def test_a_limit_that_the_flight_exceeds_leaves_no_solution() -> None:
    """The speed reaches -4.04 m/s."""
    solution = go.solve(pulled(), mesh="10x3", tol=None)
    (s,) = solution.samples().values()
    structure, flight = find_optimal_switching_times(solution, detect_control_structure(s)) or pytest.fail(
        "does not settle"
    )
    assert float(np.min(flight.states[1])) == pytest.approx(-4.04, abs=1e-3)
    for slowest, kept in ((-4.05, True), (-4.03, False)):
        box = Interval(np.array([-np.inf, slowest]), np.full(2, np.inf))
        limited = replace(flight, s=replace(s, phase=replace(s.phase, state_bounds=box)))
        found = collocated(solution, structure, limited)
        assert c.satisfies_inequality_limits(found, s.state_scale) is kept


# Variations of a known flight, part by part: where they begin, what limits they keep, what they are told
# to be.


KNOWN = solution(constructed_cart(), phase(constructed_cart(), integrals=np.array([12.0])))


def begun_at(first: Any, last: float = 1.0) -> go.Problem:
    problem = constructed_cart()
    problem.get_phase().time(first, last)
    return problem


def test_what_begins_on_the_way_is_the_rest_of_it() -> None:
    left = v.truncate_solution_to_start_time(KNOWN, begun_at(0.3))
    t = np.linspace(0.3, 1.0, 5)
    assert (left.phase().initial_time, left.phase().final_time) == (0.3, 1.0)
    assert left.phase().x(t) == pytest.approx(KNOWN.phase().x(t))
    two = replace(KNOWN, phases={"leg": KNOWN.phase(), "other": replace(KNOWN.phase(), name="other")})
    assert v.truncate_solution_to_start_time(two, begun_at(0.3)) is two


def test_it_starts_where_its_problem_says() -> None:
    """The whole trajectory moves there, but in what is not given."""
    t = np.linspace(0.0, 1.0, 5)
    box = interval([0.25, -np.inf], [0.25, np.inf])
    moved = v._shift_trajectory_to_initial_states(
        replace(KNOWN, phases={"leg": replace(KNOWN.phase(), initial_bounds=box)})
    )
    assert moved is not None
    assert moved.phase().x(t) == pytest.approx(KNOWN.phase().x(t) + np.array([[0.25], [0.0]]))
    for end in ("initial_time", "final_time"):
        other = interval(getattr(KNOWN.phase(), end) + 0.1, getattr(KNOWN.phase(), end) + 0.1)
        leg = replace(KNOWN.phase(), **{f"{end}_bounds": other})
        assert v._shift_trajectory_to_initial_states(replace(KNOWN, phases={"leg": leg})) is None
        free = replace(KNOWN.phase(), **{f"{end}_bounds": interval(-9.0, 9.0)})
        assert v._shift_trajectory_to_initial_states(replace(KNOWN, phases={"leg": free})) is not None


@pytest.mark.parametrize(
    ("what", "lower", "upper", "kept"),
    [
        ("state_bounds", [-1, -1], [1, 2], True),
        ("state_bounds", [-1, -1], [1, 1.4], False),
        ("path_bounds", [-99, -1], [99, 2], True),
        ("path_bounds", [-99, 0.1], [99, 2], False),
        ("path_bounds", [-99, -1], [5.9, 2], False),
    ],
)
def test_a_limit_along_the_way_may_not_be_exceeded(what: str, lower: Any, upper: Any, kept: bool) -> None:
    """v is 3/2 at most, a falls from 6 to -6, v + a from 6."""
    leg = replace(KNOWN.phase(), **{what: interval(lower, upper)})
    assert c.satisfies_inequality_limits(replace(KNOWN, phases={"leg": leg}), np.ones(2)) is kept


@pytest.mark.parametrize("pull", [0.0, 2.0])
@pytest.mark.parametrize("free", [False, True])
def test_multipliers_are_what_the_ends_and_controls_are_worth(pull: float, free: bool) -> None:
    """J = 7 t_0 + 2 t_f + 5 v_0 + 3 q_f + half the integral of a^2.

    With H = lam_q v + lam_v a + a^2 / 2 the multipliers of given ends are H - 7 and -(H + 2), -lam - (0, 5) and
    lam - (3, 0), and that of the control is -(a + lam_v).
    """
    model, _q, _speed, a = dynamics("cart", "q v", "a", lambda q, speed, a: {q: speed, speed: a})
    problem, leg = one_phase("cart", model, 0.0, (0.5, 9.0) if free else 1.0)
    ends = 7 * leg.initial_time + 2 * leg.final_time + 5 * leg.initial_state("v") + 3 * leg.final_state("q")
    problem.minimize(ends + 0.5 * leg.integral(a**2))
    lam = lambda t, k: costates(t, k) + np.array([[0.0], [pull]])  # noqa: E731
    times = {"final_time_bounds": interval(0.5, 9.0)} if free else {}
    flown = phase(problem, lam=lam, integrals=np.array([12.0]), integral_weights=np.array([0.5]), **times)
    found = c.compute_cost_and_multipliers(solution(problem, flown, objective=99.0))
    told = found.phase()
    first, last = (-6 + pull) * 6 + 18, (6 + pull) * -6 + 18
    assert told.time_multipliers == pytest.approx([first - 7, 0.0 if free else -(last + 2)])
    assert told.state_impulses[:, 0] == pytest.approx([12, 6 - pull - 5])
    assert told.state_impulses[:, -1] == pytest.approx([-12 - 3, 6 + pull])
    assert not np.any(told.state_impulses[:, 1:-1])
    assert told.control_multipliers == pytest.approx(np.full((1, 8), -pull), abs=1e-9)
    assert found.objective == pytest.approx(2 + 3 + 6) and found.history is None


# Costates where several controls switch at once: those of the continuous problem, whatever a program
# returns.


WORTH = np.array([1.0, 2.0, 3.0])


def carts_of_simultaneous(braking: float) -> go.Problem:
    """Three carts from rest to rest, as far as they get in at most 2 s, |a| <= 1; metres are worth 1, 2 and 3.

    The first one is told to stop by the integral of its acceleration, the second one by its final speed, the third one
    by a boundary constraint, which lets it go on by so many m/s for every second less, in a wind as strong that turns
    after 1 s.
    """
    model = go.Model("carts_of_simultaneous")
    q, v, a = model.state("q", 3), model.state("v", 3), model.control("a", 3)
    model.ode({q: v, v: a + ca.vertcat(0.0, 0.0, braking * (model.time - 1.0))})
    problem, leg = one_phase("together", model, 0.0, (0.5, 2.0))
    leg.initial(q=0.0, v=0.0)
    leg.bounds(a=([-1.0] * 3, [1.0] * 3))
    leg.final(v=([-9.0, 0.0, -9.0], [9.0, 0.0, 9.0]))
    problem.constrain("area", leg.integral(a[0]), equals=0.0)
    problem.constrain("rest", leg.final_state("v")[2] + braking * (leg.final_time - 2.0), equals=0.0)
    end = leg.final_state("q")
    problem.minimize(-sum(WORTH[i] * end[i] for i in range(3)))
    return problem


CARTS, BRAKED = carts_of_simultaneous(0.0), carts_of_simultaneous(0.5)


def together(push: float = 1.0, braking: float = 0.0) -> go.Solution:
    """The optimum: each switches at T/2, lam_q = -w and lam_v = w (t - T/2), but -w where the integral has the rest.

    One second more is worth w T/2 of each, less what the third one has to brake more, by itself and against the wind. A
    push of less than 1 is between the limits.
    """
    problem = BRAKED if braking else CARTS

    def x(t: Array, k: int) -> Any:
        q, v = (t - 1 + 0.5 - (t - 1) ** 2 / 2, 2 - t) if k else (t**2 / 2, t)
        return [q, q, q + braking * (t**3 / 6 - t**2 / 2), v, v, v + braking * (t**2 / 2 - t)]

    def lam(t: Array, k: int) -> Any:
        return [*(-w + 0 * t for w in WORTH), t - 2, 2 * (t - 1), 3 * (t - 1)]

    box = problem.get_phase().numbers
    given: dict[str, Any] = {"initial_bounds": box.initial, "final_bounds": box.final}
    bare = phase(
        problem, x, lambda t, k: [push * (1 - 2 * k) + 0 * t] * 3, lam, breaks=(0.0, 1.0, 2.0), degree=3
    )
    impulses = np.zeros((6, 3))
    impulses[:, 0], impulses[4, 2] = -bare.lam_start[:, 0], 2.0
    leg = replace(
        bare,
        **given,
        mesh=go.Mesh((0.0, 0.5, 1.0), (3, 3), (1,)),
        control_bounds=box.controls,
        final_time_bounds=interval(0.5, 2.0),
        control_multipliers=-WORTH[:, None] * (bare.point_times - 1),
        state_impulses=impulses,
        time_multipliers=np.array([0.0, 6.0 - 6.0 * braking]),
        integral_weights=np.ones(1),
    )
    return solution(
        problem,
        leg,
        objective=-6.0,
        constraint_labels=("area", "rest"),
        constraint_values=np.zeros(2),
        constraint_multipliers=np.array([1.0, 3.0]),
    )


def check(found: go.Solution, braking: float = 0.0) -> None:
    leg = found.phase()
    t = np.linspace(0.0, 2.0, 9)
    slopes = WORTH[:, None] * (t - 1.0)
    slopes[0] -= 1.0  # what the integral's weight does for the first one: lam_v = 0 at the end
    expected = np.vstack([np.repeat(-WORTH[:, None], 9, axis=1), slopes])
    np.testing.assert_allclose(leg.lam(t), expected, atol=2e-6)
    np.testing.assert_allclose(leg.lam_start, leg.lam(leg.breaks[:-1]), atol=2e-6)
    np.testing.assert_allclose(leg.lam_end, leg.lam(leg.breaks[1:], "left"), atol=2e-6)
    np.testing.assert_allclose(leg.point_costates, leg.lam(leg.point_times), atol=2e-6)
    assert found.constraint_multipliers == pytest.approx([1.0, 3.0], abs=2e-6)
    assert leg.integral_weights == pytest.approx([1.0], abs=2e-6)
    switching = WORTH[:, None] * (leg.point_times - 1.0)
    np.testing.assert_allclose(leg.control_multipliers, -switching, atol=1e-5)
    assert leg.time_multipliers[1] == pytest.approx(6.0 - 6.0 * braking, abs=1e-5)
    # Multipliers of given end values are what the costates are there.
    np.testing.assert_allclose(leg.state_impulses[:, 0], -leg.lam_start[:, 0], atol=1e-5)
    assert leg.state_impulses[4, -1] == pytest.approx(2.0, abs=1e-5)
    np.testing.assert_allclose(leg.state_impulses[[0, 1, 2, 3, 5], -1], 0.0, atol=1e-5)
