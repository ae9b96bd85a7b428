"""Newton's method on switch times against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from testing.internals import PhaseStructure, Plan, Switches, detect

import gnc_opt as go
from gnc_opt.planning import ArcKind
from gnc_opt.planning.refinement.arcs import loop as switching
from gnc_opt.planning.refinement.switching.newton import settle, settle_flow
from gnc_opt.planning.refinement.switching.step import chord_step, independent, newton_step
from problems.rendezvous import SWITCHES, build

LOWER, UPPER, INTERIOR = ArcKind.LOWER, ArcKind.UPPER, ArcKind.INTERIOR


def carts(*distances: float, initial: float = 0.0) -> go.Problem:
    """Carts that come to rest at 0 together, in least time, |a| <= 1: for one from d, t = 2 sqrt(d)."""
    model = go.Model("carts")
    q = model.state("q", len(distances))
    v = model.state("v", len(distances))
    a = model.control("a", len(distances))
    model.ode({q: v, v: a})
    problem = go.Problem("carts")
    leg = problem.phase("leg", model)
    leg.time(initial=initial, final=(initial + 0.1, initial + 100.0))
    leg.initial(q=np.array(distances), v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=([-1.0] * len(distances), [1.0] * len(distances)))
    problem.minimize(leg.final_time)
    return problem


def oscillator() -> go.Problem:
    """x'' + x = u, |u| <= 1, from 5 at rest to the origin in least time."""
    model = go.Model("oscillator")
    q, v, u = model.state("q"), model.state("v"), model.control("u")
    model.ode({q: v, v: u - q})
    problem = go.Problem("oscillator")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=(0.1, 20.0))
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


@pytest.mark.parametrize("times", [[0.0, 1.5, 4.5], [0.0, 2.6, 3.4]])
def test_switch_and_end_time_of_one_cart(cart: go.Solution, times: list[float]) -> None:
    found, flight = settle(cart, structure(times, LOWER, UPPER)) or pytest.fail("does not settle")
    guess = flight.solution(cart)
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
    found, _ = settle(cart, structure([0.0, 0.3, 2.2, 2.5, 4.1], UPPER, LOWER, UPPER, LOWER)) or pytest.fail()
    assert found.times == pytest.approx([0.0, 2.0, 4.0], abs=1e-6)
    assert [row[0] for row in found.kinds] == [LOWER, UPPER]


def test_oscillator_switches_every_half_period() -> None:
    solution = go.solve(oscillator(), mesh="20x3", tol=None)
    found, _ = settle(solution, detect(solution.samples()["leg"])) or pytest.fail("does not settle")
    inner = found.times[1:-1]
    assert len(inner) > 1 and np.diff(inner) == pytest.approx(np.full(len(inner) - 1, np.pi), abs=1e-6)


def test_switches_of_several_controls_pass_each_other() -> None:
    """Found on 10 segments, the order of the 19 switches is wrong, and an arc is missing."""
    solution = go.solve(build(case=1), mesh="10x3", tol=None)
    found, _ = settle(solution, detect(solution.samples()["approach"])) or pytest.fail("does not settle")
    assert found.times[-1] == pytest.approx(25.8699620765, abs=2e-7)
    for i, channel in enumerate(SWITCHES[1].values()):
        own = [found.times[k] for k in range(1, found.pieces) if i in found.changes(k)]
        assert own == pytest.approx(channel.switching_times, abs=1e-4)


def fuller() -> go.Problem:
    """x'' = u, |u| <= 1, from 1 at rest to the origin at rest in 3 s, at the least integral of x^2."""
    model = go.Model("cart")
    x, v, u = model.state("x"), model.state("v"), model.control("u")
    model.ode({x: v, v: u})
    problem = go.Problem("Fuller")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=3.0)
    leg.initial(x=1.0, v=0.0)
    leg.final(x=0.0, v=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(x**2))
    return problem


def test_a_few_bangs_stand_for_a_singular_arc_that_is_met_by_chattering() -> None:
    """The optimum switches on x = -z v|v| ever faster, z^2 = (sqrt(33) - 1) / 24, until it rests after 2.715 s.

    Its cost, 0.764017547725633, is the geometric series of the arcs between (Fuller 1963; Zelikin & Borisov 1994).
    """
    found = go.solve(fuller(), mesh="10x3")
    z = np.sqrt((np.sqrt(33) - 1) / 24)
    first = np.sqrt(1 / (z + 0.5))  # where 1 - t^2 / 2 = z t^2
    times = [arc.start for arc in found.structure][1:]
    assert {arc.kind for arc in found.structure} == {LOWER, UPPER}
    assert times[:2] == pytest.approx([first, 2.3069051155183793], abs=1e-4)  # by chattering that is cut off
    assert 0 < found.objective - 0.764017547725633 < 2e-8
    assert go.verify(found).ok


def test_a_shift_of_the_clock_changes_nothing(cart: go.Solution) -> None:
    later = go.solve(carts(4.0, initial=1000.0), mesh="8x3", tol=None)
    found, _ = settle(later, structure([1000.0, 1001.5, 1004.5], LOWER, UPPER)) or pytest.fail()
    assert found.times == pytest.approx([1000.0, 1002.0, 1004.0], abs=1e-6)


def test_active_limits_of_the_end_are_left_to_others() -> None:
    """The final speed may be up to 0.5, and is: the limit decides where it is, and is no equality."""
    problem = carts(4.0)
    leg = problem.phases["leg"]
    leg.final(q=0.0, v=(-0.5, 0.0))
    solution = go.solve(problem, mesh="8x3", tol=None)
    assert settle(solution, structure([0.0, 2.0, 4.0], LOWER, UPPER)) is None


def test_conditions_that_depend_on_each_other_are_left_to_others() -> None:
    """The angle's cosine and sine are both held at the end: one of them follows, and has no multiplier of its own."""
    model = go.Model("pointing")
    c, s, w, a = model.state("c"), model.state("s"), model.state("w"), model.control("a")
    model.ode({c: -s * w, s: c * w, w: a})
    problem = go.Problem("pointing")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=(0.1, 10.0))
    leg.initial(c=1.0, s=0.0, w=0.0)
    leg.final(c=0.0, s=1.0, w=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    solution = go.solve(problem, mesh="8x3", tol=None)
    half = np.sqrt(np.pi / 2)
    assert settle(solution, structure([0.0, half, 2 * half], UPPER, LOWER, others=3)) is None


@pytest.mark.parametrize("kind", [INTERIOR, ArcKind.SINGULAR])
def test_controls_between_their_bounds_are_left_to_others(cart: go.Solution, kind: ArcKind) -> None:
    assert settle(cart, structure([0.0, 1.0, 4.0], kind, UPPER)) is None


def test_states_on_their_bounds_are_left_to_others(cart: go.Solution) -> None:
    held = structure([0.0, 2.0, 4.0], LOWER, UPPER)
    kinds = ((LOWER, INTERIOR, LOWER), held.kinds[1])
    assert settle(cart, replace(held, kinds=kinds)) is None


def test_a_structure_that_cannot_be_collocated_is_given_up(
    cart: go.Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Thrust away from the goal and back leads nowhere: what was detected is tried then."""
    nowhere = structure([0.0, 2.0, 4.0], UPPER, UPPER)
    guess = replace(cart, statistics=cart.statistics)
    monkeypatch.setattr(switching, "_settled", lambda *_: (guess, {"leg": Plan.of(nowhere)}, None))
    found, history = switching.optimise_switches(cart)
    assert history.converged and not history.passes[0].solved
    assert found.objective == pytest.approx(4.0, abs=1e-9)


@pytest.mark.parametrize("unit", [1.0, 1e12, 1e-12])
def test_dependence_of_conditions_is_none_of_units(unit: float) -> None:
    rows = np.array([[1.0, 2.0, 3.0], [2.0, 4.0, 6.1]]) * np.array([[1.0], [unit]])
    assert independent(rows)
    assert not independent(rows @ np.diag([1.0, 1.0, 0.0]))
    assert not independent(np.vstack([rows, np.zeros(3)]))


def test_refinement_then_needs_one_pass() -> None:
    refined = go.refine(go.solve(oscillator(), mesh="20x3", tol=None))
    assert refined.history is not None and refined.history.converged
    assert len(refined.history.passes) <= 2


# --- as a guess, and by itself ----------------------------------------------------------------------------


def measured() -> go.Problem:
    """A cart from 4 m in least time that adds up where it is: 8 m s."""
    problem = carts(4.0)
    leg = problem.phases["leg"]
    leg.integral(leg.model.symbol("q")[0], name="area")
    return problem


def test_a_guess_has_the_integrals_costates_and_multipliers_of_the_flow() -> None:
    solution = go.solve(measured(), mesh="8x3", tol=None)
    _, flight = settle(solution, structure([0.0, 1.5, 4.5], LOWER, UPPER)) or pytest.fail("does not settle")
    guess = flight.solution(solution)
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
    assert leg.control_multipliers.shape == (1, leg.mesh.size) and not leg.state_impulses.any()
    # Flown with its own control it ends where it says.
    assert go.verify(guess)["dynamics"].result is go.ConditionResult.PASS


def test_conditions_and_costs_at_the_ends_count() -> None:
    """As far as possible from rest to rest in 6 s, where the rest is a constraint: lam_q = -1, lam_v = t - 3, nu = 3.

    The integral of a^2, constant for |a| = 1, is there to be carried along.
    """
    model = go.Model("cart")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    problem = go.Problem("far")
    leg = problem.phase("leg", model)
    leg.time(0.0, 6.0)
    leg.initial(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.constrain("stop", leg.final_state("v"), equals=0.0)
    problem.minimize(leg.integral(a**2) / 8 - leg.final_state("q"))
    solution = go.solve(problem, mesh="9x3", tol=None)
    start = structure([0.0, 2.0, 6.0], UPPER, LOWER)
    found, flight = settle(solution, start) or pytest.fail("does not settle")
    guess = flight.solution(solution)
    assert found.times == pytest.approx([0.0, 3.0, 6.0], abs=1e-6)
    assert guess.constraint_multipliers == pytest.approx([3.0], abs=1e-5)
    t = np.linspace(0.0, 6.0, 7)
    assert guess.phase("leg").lam(t) == pytest.approx(np.stack([-1 + 0 * t, t - 3]), abs=1e-5)


@pytest.mark.parametrize("accuracy", [1e-4, 1e-9])
def test_the_flow_itself_is_as_accurate_as_it_is_told_to_be(accuracy: float) -> None:
    """v' = a - v^2 / 10, rest to rest over 1 m: SciPy's own answer, to the accuracy and its root."""
    model = go.Model("dragged")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a - 0.1 * v**2})
    problem = go.Problem("dragged")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.1, 10.0))
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
    found, flight = settle_flow(solution, structure([0.0, 0.9, 2.1], UPPER, LOWER), accuracy) or pytest.fail()
    guess = flight.solution(solution)
    assert found.times[2] == pytest.approx(end, rel=2 * accuracy)
    assert found.times[1] == pytest.approx(switch, abs=2 * np.sqrt(accuracy) * end)
    assert guess.phase().x(guess.phase().breaks[-1], "left") == pytest.approx(
        [1.0, 0.0], abs=10 * np.sqrt(accuracy)
    )
    assert settle_flow(solution, structure([0.0, 0.9, 2.1], INTERIOR, LOWER), accuracy) is None


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
    stated = replace(s, leg=replace(s.leg, final_bounds=leg.numbers.final))
    own = newton_step(problem, stated, at) or pytest.fail("no step")
    again = chord_step(problem, stated, at, own) or pytest.fail("no step")
    assert again.change == pytest.approx(own.change, abs=1e-10) and np.max(np.abs(own.change)) > 0.01
    assert again.gain == pytest.approx(own.gain) and own.cost == again.cost
    # Twice: the second one begins with the multipliers of the first one.
    moved = replace(at, times=at.times + own.change[1:-1], ends=at.ends + own.change[[0, -1]])
    twice = chord_step(problem, stated, moved, again) or pytest.fail("no step")
    newer = newton_step(problem, stated, moved) or pytest.fail("no step")
    assert np.max(np.abs(twice.change - newer.change)) < 0.3 * np.max(np.abs(newer.change))
