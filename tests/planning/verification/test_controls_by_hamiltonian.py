"""Controls that minimise the Hamiltonian: minimum principle, vectors, reduced Hessian."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.great_circle import great_circle, regulator
from testing.models import dynamics, one_phase
from testing.second_order import second_order_of

import gnc_opt as go
from gnc_opt.planning import ConditionResult
from gnc_opt.planning.optimality.kkt_system import ProgramPoint
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.verification.critical_cone import (
    CriticalCone,
    differentiate_augmented_hamiltonian,
    find_vector_control,
    fix_vector_control_directions,
)
from gnc_opt.planning.verification.hamiltonian_minimum import _MinimumSearch, get_control_search_bounds
from gnc_opt.planning.verification.reduced_hessian import run_lanczos

# The least Hamiltonian: in closed form for controls that enter it affinely, by a search for the others.


def idle(n: int, integrand: Callable[[Any], Any], *paths: tuple[Callable[[Any], Any], float]) -> go.Solution:
    """All of n controls are zero where |u| <= 1 and the integrand alone decides: H is the integrand."""
    model = go.Model("still")
    x, u = model.state("x"), model.control("u", n)
    model.ode({x: 0 * u[0]})
    problem, leg = one_phase("idle", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=([-1.0] * n, [1.0] * n))
    for k, (path, lower) in enumerate(paths):
        leg.path(f"gate {k}", path(u), lower=lower)
    problem.minimize(leg.integral(integrand(u)))
    pinned = go.solve(problem.with_bounds(u=(0.0, 0.0)), mesh="2x3", tol=None)
    box = Interval(-np.ones(n), np.ones(n))
    phases = {"leg": replace(pinned.phase(), control_bounds=box)}
    return replace(pinned, phases=phases, problem=problem)


WEIGHTS = 0.1 * np.array([1.0, -2.0, 3.0, -4.0, 5.0, -6.0, 7.0, -8.0])

GAINS: list[tuple[str, int, Any, Any, float]] = [
    ("eight affine controls", 8, lambda u: 1 + ca.dot(ca.DM(WEIGHTS), u), (), 3.6),
    ("affine and a double well", 2, lambda u: 1 + 0.3 * u[0] + (u[1] ** 2 - 1) ** 2, (), 1.3),
    ("affine, in a path", 1, lambda u: 1 + 0.3 * u[0], ((lambda u: u[0], -0.5),), 0.15),
    ("affine, one in a path", 2, lambda u: 1 + u[0] + 0.3 * u[1], ((lambda u: u[1], -0.5),), 1.15),
    ("a product", 2, lambda u: 1 + u[0] * u[1], (), 1.0),
    ("a kink", 1, lambda u: 1 + ca.fmax(ca.fmin(u[0], 1), -0.5 * u[0]), (), 0.0),
    ("a kink that is no minimum", 1, lambda u: 1 - ca.fabs(u[0]), (), 1.0),
]


@pytest.mark.parametrize(
    ("n", "integrand", "paths", "gain"), [case[1:5] for case in GAINS], ids=[case[0] for case in GAINS]
)
def test_what_other_controls_gain(n: int, integrand: Any, paths: Any, gain: float) -> None:
    """Over 1 s: wherever controls gain alone or together."""
    condition = go.verify(idle(n, integrand, *paths))["minimum principle"]
    assert condition.loss == pytest.approx(gain, rel=1e-5, abs=1e-12)
    assert condition.result is (go.ConditionResult.FAIL if gain else go.ConditionResult.PASS)


def test_a_step_of_h_is_found_though_no_slope_shows_it() -> None:
    """In 15 % of the range H is less by 0.5."""
    step = idle(1, lambda u: 1 - 0.5 * ca.logic_and(u[0] > 0.6, u[0] < 0.9))
    condition = go.verify(step)["minimum principle"]
    assert condition.result is go.ConditionResult.FAIL and condition.loss is not None
    assert 0.0 < condition.loss <= 0.5


def test_controls_that_a_limit_forbids_are_no_choice_where_its_gradient_vanishes() -> None:
    """|a| >= 1 written as a^2 >= 1: a = 0 would cost less, and is as forbidden as any a in between."""
    model, _q, a = dynamics("integrator", "q", "a", lambda q, a: {q: a})
    problem, leg = one_phase("annulus", model, 0.0, 1.0)
    leg.initial(q=0.0)
    leg.bounds(a=(-3.0, 3.0))
    leg.path("annulus", a**2, lower=1.0)
    problem.minimize(0.5 * leg.integral(a**2) + 0.3 * leg.final_state("q"))
    right = go.solve(problem.with_guess(a=-1.2), mesh="2x4", tol=None)
    assert right.objective == pytest.approx(0.2, abs=1e-7)
    assert go.verify(right)["minimum principle"].result is go.ConditionResult.PASS
    other = go.solve(problem.with_guess(a=1.2), mesh="2x4", tol=None)  # 0.8: the far side of the ring
    assert go.verify(other)["minimum principle"].result is go.ConditionResult.FAIL


def test_which_controls_are_separable() -> None:
    """Affine, apart from the others and in no path constraint."""
    solution = idle(
        7,
        lambda u: 2 * u[0] + u[1] * u[2] + ca.fabs(u[3]) + u[4] ** 2 + 3 * u[5] + u[6],
        (lambda u: u[5], -0.5),
    )
    apart = solution.phase_functions("leg").separable_controls
    np.testing.assert_array_equal(apart, [True, False, False, False, False, False, True])
    groups = [group.tolist() for group in solution.phase_functions("leg").coupled_controls]
    assert groups == [[1, 2], [3], [4], [5]]


def test_controls_in_one_path_constraint_are_one_group() -> None:
    solution = idle(4, lambda u: ca.dot(u, u), (lambda u: u[0] + u[3], -0.5), (lambda u: u[3] - u[2], -0.5))
    assert [group.tolist() for group in solution.phase_functions("leg").coupled_controls] == [[0, 2, 3], [1]]


def _well(center: float, width: float, depth: float) -> Callable[[Any], Any]:
    return lambda u: 1 + u[0] ** 2 - depth * ca.exp(-(((u[0] - center) / width) ** 2))


@pytest.mark.parametrize(("center", "width"), [(0.3713, 1e-1), (-0.617, 1e-3), (0.3713, 1e-4)])
def test_wells_wider_than_the_resolution_are_found(center: float, width: float) -> None:
    """A well of which 2e-4 of the range is below the flown H, beside one that is as narrow but too shallow."""
    condition = go.verify(idle(1, _well(center, width, 1.0)))["minimum principle"]
    assert condition.result is go.ConditionResult.FAIL
    assert condition.loss == pytest.approx(1 - center**2, rel=1e-2)
    if width < 0.1:  # a wide one pulls at the applied control
        shallow = go.verify(idle(1, _well(center, width, 0.9 * center**2)))["minimum principle"]
        assert shallow.result is go.ConditionResult.PASS


def test_a_well_below_the_resolution_is_missed_and_the_meaning_says_so() -> None:
    condition = go.verify(idle(1, _well(0.3713, 1e-8, 1.0)))["minimum principle"]
    assert condition.result is go.ConditionResult.PASS
    assert "the search may miss a narrow minimum" in condition.meaning
    convex = go.verify(idle(1, lambda u: 1 + u[0] ** 2))["minimum principle"]
    assert "may miss a narrow minimum" not in convex.meaning


@pytest.mark.parametrize("stiffness", [1e2, 1e6])
def test_stiffly_coupled_actuators_do_not_hide_another_valley(stiffness: float) -> None:
    """One actuator alone only adds stiffness u^2: it takes both to reach d = u - w = 1.2."""

    def coupled(tilt: float) -> Callable[[Any], Any]:
        def integrand(u: Any) -> Any:
            d = u[0] - u[1]
            return 1 + stiffness * (u[0] + u[1]) ** 2 + d**2 * (d - 1.2) ** 2 + tilt * d**3

        return integrand

    assert go.verify(idle(2, coupled(-0.3)))["minimum principle"].result is go.ConditionResult.FAIL
    assert go.verify(idle(2, coupled(0.3)))["minimum principle"].result is go.ConditionResult.PASS


@pytest.mark.parametrize("stiffness", [1.0, 1e3, 1e6])
def test_stiffly_coupled_actuators_do_not_hide_a_slope(stiffness: float) -> None:
    """(u - w - 0.3)^2 gains 0.09 over 1 s."""
    solution = idle(2, lambda u: 1 + stiffness * (u[0] + u[1]) ** 2 + (u[0] - u[1] - 0.3) ** 2)
    condition = go.verify(solution)["minimum principle"]
    assert condition.loss == pytest.approx(0.09, rel=1e-4)
    assert condition.result is go.ConditionResult.FAIL


@pytest.mark.parametrize(("bend", "gain"), [(2.0, 1.0), (0.5, 0.0)])
def test_controls_on_a_curve_are_searched_along_it(bend: float, gain: float) -> None:
    """On w = u^2 no lattice meets the curve; along it H is u^2 - bend u^4."""
    on_curve = ((lambda u: u[1] - u[0] ** 2, 0.0), (lambda u: u[0] ** 2 - u[1], 0.0))
    condition = go.verify(idle(2, lambda u: 1 + u[1] - bend * u[1] ** 2, *on_curve))["minimum principle"]
    assert condition.result is (go.ConditionResult.FAIL if gain else go.ConditionResult.PASS)
    assert (condition.value > 0.1) is bool(gain)


def test_wells_beside_an_affine_control_that_moves_nothing_are_saddles_of_plain_size() -> None:
    """-2 u^2 in half of the range: what is varied by its integral is no steeper than that, and gains what H does."""
    condition = second_order_of(idle(2, GAINS[1][2]))["second order"]
    assert condition.result is go.ConditionResult.FAIL and condition.value < 100.0


# The verdict on vector controls: the least Hamiltonian over a ball or an annulus is known in closed form.


MAGNITUDE, DIRECTION = 0, slice(1, 3)


@cache
def flight(least: float) -> go.Solution:
    """One unit across in a field of forces, with the least integral of the norm, on a coarse mesh."""
    model = go.Model("cart")
    r, v = model.state("r", 2), model.state("v", 2)
    a, norm = model.vector_control("a", 2)
    model.ode({r: v, v: a - 0.3 * r})
    problem, leg = one_phase("move", model, initial=0.0, final=3.0)
    leg.initial(r=[0.0, 0.0], v=[0.0, 0.2])
    leg.final(r=[1.0, 0.5], v=[0.0, 0.0])
    leg.norm_bounds(a=(least, 2.0))
    problem.minimize(leg.integral(norm))
    return go.solve(problem, mesh="12x3", tol=None)


def samples(solution: go.Solution, angle: float = 0.0) -> PhaseSamples:
    """The phase sampled, with its direction turned by an angle (rad)."""
    leg = solution.phase()
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    values = tuple(np.vstack([u[:1], turn @ u[DIRECTION]]) for u in leg.u.values)
    turned = replace(leg, u=replace(leg.u, values=values))
    return PhaseSamples.from_phase(turned, solution.phase_functions("leg"))


@pytest.mark.parametrize("least", [0.0, 0.2])
@pytest.mark.parametrize("angle", [0.0, 2.0])
def test_nothing_in_the_annulus_has_a_lower_hamiltonian(least: float, angle: float) -> None:
    s = samples(flight(least), angle)
    every = np.arange(s.times.size)
    (group,) = s.functions.coupled_controls
    vector = find_vector_control(s, group)
    assert vector is not None
    search = _MinimumSearch(s, group, every)
    lower, upper = get_control_search_bounds(s)
    best = lower[:, None] + (upper - lower)[:, None] * search.minimise_over_vector_control(vector)
    assert np.all(np.isclose(best[MAGNITUDE], least) | np.isclose(best[MAGNITUDE], 2.0))
    np.testing.assert_allclose(np.linalg.norm(best[DIRECTION], axis=0), 1.0, rtol=1e-12)
    lowest = s.functions.hamiltonian(s.times, s.x, best, s.lam)
    rng = np.random.default_rng(1)
    for _ in range(50):
        other = rng.uniform(-1.0, 1.0, best.shape)
        other[DIRECTION] /= np.linalg.norm(other[DIRECTION], axis=0)
        other[MAGNITUDE] = rng.uniform(least, 2.0, best.shape[1])
        assert np.all(s.functions.hamiltonian(s.times, s.x, other, s.lam) >= lowest - 1e-12)


@pytest.mark.parametrize("curve", ["cost", "path"])
def test_closed_form_is_for_affine_hamiltonians_without_other_limits(curve: str) -> None:
    model = go.Model("cart")
    v = model.state("v", 2)
    a, norm = model.vector_control("a", 2)
    model.ode({v: a})
    problem, leg = one_phase("move", model, initial=0.0, final=3.0)
    leg.initial(v=[0.0, 0.0])
    leg.final(v=[1.0, 0.5])
    leg.norm_bounds(a=(0.0, 2.0))
    if curve == "path":
        leg.path("forwards", a[0] - 0.1 * norm, lower=0.0)
    problem.minimize(leg.integral(norm**2 if curve == "cost" else norm))
    s = samples(go.solve(problem, mesh="2x3", tol=None))
    assert find_vector_control(s, s.functions.coupled_controls[0]) is None


@pytest.mark.slow
def test_optimum_passes_and_a_turned_thrust_fails_the_minimum_principle() -> None:
    solution = go.refine(flight(0.0), tol=1e-7)
    verdict = go.verify(solution)
    assert verdict["minimum principle"].result is go.ConditionResult.PASS
    assert "searched" not in verdict["minimum principle"].meaning
    parts = second_order_of(solution)
    for name in ("Legendre-Clebsch", "singular arcs", "generalised Legendre-Clebsch"):
        assert parts[name].result is go.ConditionResult.PASS, name
    s = samples(solution)
    coasts = s.u[MAGNITUDE] == 0
    assert 0 < np.mean(coasts) < 1
    np.testing.assert_array_equal(s.inactive_controls, [np.zeros_like(coasts), coasts, coasts])
    leg = solution.phase()
    turn = np.array([[np.cos(0.02), -np.sin(0.02)], [np.sin(0.02), np.cos(0.02)]])
    values = tuple(np.vstack([u[:1], turn @ u[DIRECTION]]) for u in leg.u.values)
    wrong = replace(solution, phases={"leg": replace(leg, u=replace(leg.u, values=values))})
    assert go.verify(wrong)["minimum principle"].result is go.ConditionResult.FAIL


def test_a_direction_alone_is_checked_to_second_order() -> None:
    """Against a current, at speed 1 through the water: a magnitude that is fixed has no switch that could vary.

    Across a river of unit speed v < 1 the least time is 1 / sqrt(1 - v^2), steering against the current: sin = v.
    """
    model = go.Model("boat")
    r = model.state("r", 2)
    u, _ = model.vector_control("u", 2)
    model.ode({r: u + np.array([0.6, 0.0])})
    problem, leg = one_phase("across", model, initial=0.0, final=(0.1, 10.0))
    leg.initial(r=[0.0, 0.0])
    leg.final(r=[0.0, 1.0])
    leg.norm_bounds(u=(1.0, 1.0))
    problem.minimize(leg.final_time)
    solution = go.solve(problem, mesh="3x4")
    assert solution.objective == pytest.approx(1 / 0.8, abs=1e-9)
    assert solution.control("u")(0.5) == pytest.approx([-0.6, 0.8], abs=1e-7)
    assert go.verify(solution)["second order"].result is go.ConditionResult.PASS


@pytest.mark.parametrize("angle", [0.0, 2.0])
def test_a_push_would_begin_along_the_primer_vector(angle: float) -> None:
    """Where nothing pushes the norm costs 1 and gains |lambda_v|, whatever the direction that was stored."""
    s = samples(flight(0.0), angle)
    coasts = s.u[MAGNITUDE] < 1e-9
    assert np.sum(coasts) > 20
    found = differentiate_augmented_hamiltonian(s, s.times, s.x, s.u, s.lam, s.mu)
    primer = np.linalg.norm(s.lam[2:], axis=0)
    np.testing.assert_allclose(found[MAGNITUDE, coasts], 1 - primer[coasts], atol=1e-12)
    np.testing.assert_array_equal(found[:, ~coasts], s.control_gradient[:, ~coasts])


@pytest.mark.slow
def test_a_coast_leaves_no_doubt_of_a_minimum() -> None:
    """Two burns in the plane with the least fuel: directions along the coast do nothing, and need not curve H."""
    model = go.Model("cart")
    r, v = model.state("r", 2), model.state("v", 2)
    a, norm = model.vector_control("a", 2)
    model.ode({r: v, v: a})
    problem, leg = one_phase("two burns", model, initial=0.0, final=2.5)
    leg.initial(r=0.0, v=0.0)
    leg.final(r=[0.6, 0.8], v=0.0)
    leg.norm_bounds(a=(0.0, 1.0))
    problem.minimize(leg.integral(norm))
    solution = go.solve(problem)
    assert solution.objective == pytest.approx(1.0, abs=1e-7)  # s (5/2 - s) = 1
    verdict = go.verify(solution)
    assert verdict.minimum, verdict.explain()


def test_directions_are_held_where_their_magnitude_is_and_there_alone() -> None:
    solution = flight(0.0)
    s, cone = (samples(solution), CriticalCone.from_program_point(ProgramPoint.from_solution(solution)))
    collocation = cone.point.transcription.parts["leg"].collocation
    magnitude, direction = collocation.point_controls[MAGNITUDE], collocation.point_controls[DIRECTION]
    length = cone.point.x.size + collocation.path_rows[0]
    strong = cone.strong.copy()
    strong[length] = True  # as if it were 1 along the coast, too
    held = fix_vector_control_directions(replace(cone, strong=strong), [s])
    coasts = cone.point.x[magnitude] < 1e-9
    assert 0 < np.sum(coasts) < coasts.size
    assert np.all(cone.strong[magnitude[coasts]]) and not np.any(cone.strong[direction[:, coasts]])
    np.testing.assert_array_equal(held.strong[direction], [coasts, coasts])
    np.testing.assert_array_equal(held.strong[length], ~coasts)  # of what is held already no row is left
    freed = cone.strong.copy()
    freed[magnitude] = False  # a magnitude that nothing pushes to zero may grow, in any direction
    assert not np.any(fix_vector_control_directions(replace(cone, strong=freed), [s]).strong[direction])


# Second order of smooth problems: minima pass, saddles and maxima that satisfy every first-order condition
# fail.


PASS, FAIL, UNTOLD = ConditionResult.PASS, ConditionResult.FAIL, ConditionResult.INCONCLUSIVE


def second_order(solution: go.Solution) -> go.Condition:
    return go.verify(solution)["second order"]


@pytest.mark.slow
@pytest.mark.parametrize(("arc", "result", "phases"), [(0.98, PASS, 1), (1.02, FAIL, 1), (1.02, FAIL, 2)])
def test_great_circle_is_shortest_up_to_half_the_sphere(
    arc: float, result: ConditionResult, phases: int
) -> None:
    solution = go.solve(great_circle(arc * np.pi, phases), mesh="4x6", tol=None)
    assert {c.name for c in go.verify(solution).failed} <= {"second order"}
    assert solution.objective == pytest.approx(0.5 * (arc * np.pi) ** 2)
    condition = second_order(solution)
    assert condition.result is result, condition
    # Bulging by theta = e sin(pi t) costs e^2 / 4 (pi^2 - arc^2): the curvature changes its sign at half the sphere.
    assert np.sign(condition.value) == np.sign(arc - 1)


@pytest.fixture(scope="module")
def at_rest() -> go.Solution:
    return go.solve(regulator(1.0), mesh="4x5", tol=None)


@pytest.mark.parametrize(("share", "result"), [(0.97, PASS), (1.0, UNTOLD), (1.03, FAIL)])
def test_regulator_before_and_past_its_conjugate_point(
    at_rest: go.Solution, share: float, result: ConditionResult
) -> None:
    """At the conjugate point itself sin(pi t) costs nothing, and no test of the second order can tell."""
    condition = second_order(replace(at_rest, problem=regulator(share * np.pi**2)))
    assert condition.result is result, condition


def test_gain_is_what_the_step_gains(at_rest: go.Solution) -> None:
    """The worst variation is close to sin(pi t): a step of 0.1 of u gains 0.05^2 / 2 (weight / pi^2 - 1) cos^2."""
    condition = second_order(replace(at_rest, problem=regulator(2 * np.pi**2)))
    gain = float(condition.where.split("lowers the cost by ")[1].split(" ")[0])
    assert gain == pytest.approx(0.1**2 * 0.5, rel=0.05)


def slow_disc(shallow: float) -> go.Problem:
    """Minimum time across a disc where everything is slow; straight through is stationary by symmetry."""
    model = go.Model("slow disc")
    x, y, heading = model.state("x"), model.state("y"), model.control("heading")
    speed = 1 - shallow * ca.exp(-4 * (x**2 + y**2))
    model.ode({x: speed * ca.cos(heading), y: speed * ca.sin(heading)})
    problem, leg = one_phase("slow disc", model, 0.0, (0.1, 20.0))
    leg.initial(x=-1.0, y=0.0)
    leg.final(x=1.0, y=0.0)
    leg.bounds(heading=(-1.5, 1.5))
    problem.minimize(leg.final_time)
    return problem


@pytest.mark.parametrize(("shallow", "result"), [(0.1, PASS), (0.8, FAIL)])
def test_straight_through_a_slow_disc(shallow: float, result: ConditionResult) -> None:
    """Round a deep one is faster: 2.72 s instead of 4.17 s."""
    straight = go.solve(slow_disc(shallow).with_bounds(y=(-1e-9, 1e-9)), mesh="10x5", tol=None)
    condition = second_order(replace(straight, problem=slow_disc(shallow)))
    assert condition.result is result, condition


def designed(cost: object, *, lower: float | None = None) -> go.Solution:
    """A cost in two free parameters, from (0, 0), beside an integrator that does nothing."""
    model, _x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem = go.Problem("two parameters")
    k, m = (problem.parameter(name, lower=lower, upper=1.0, guess=0.0) for name in ("k", "m"))
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    problem.minimize(leg.integral(u**2) + k**2 + m**2)
    solution = go.solve(problem, mesh="2x3", tol=None)
    other = go.Problem("two parameters")
    k, m = (other.parameter(name, lower=lower, upper=1.0, guess=0.0) for name in ("k", "m"))
    leg = other.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    other.minimize(leg.integral(u**2) + cost(k, m))  # type: ignore[operator]
    return replace(solution, problem=other, parameter_values=np.zeros(2), objective=0.0)


@pytest.mark.parametrize(
    ("cost", "lower", "result"),
    [
        (lambda k, m: k**2 + m**2 + k * m, None, PASS),
        (lambda k, m: k**2 + m**2 + 3 * k * m, None, FAIL),
        (lambda k, m: k**2, None, UNTOLD),
        # On a bound that does not push, only one side of it counts: the cost is copositive, or it is not.
        (lambda k, m: k**2 - m**2, 0.0, FAIL),
        (lambda k, m: k**2 + m**2 - 3 * k * m, 0.0, FAIL),
        (lambda k, m: k**2 + m**2 + 3 * k * m, 0.0, UNTOLD),
        (lambda k, m: k + m - k**2 - m**2, 0.0, PASS),
    ],
)
def test_free_parameters_take_part(cost: object, lower: float | None, result: ConditionResult) -> None:
    condition = second_order(designed(cost, lower=lower))
    assert condition.result is result, condition


def test_an_inactive_constraint_takes_no_direction(at_rest: go.Solution) -> None:
    """x(1) <= 5 and an integral of x below 5 hold nothing; equalities would."""
    for active, result in ((False, FAIL), (True, PASS)):
        problem = regulator(1.5 * np.pi**2)
        leg = problem.phases["leg"]
        x = leg.model.symbol("x")
        # The worst variation, sin(pi t), has an integral; those without need four times the weight.
        problem.constrain("integral", leg.integral(x), **({"equals": 0.0} if active else {"upper": 5.0}))
        held = go.solve(problem.with_parameters(k=1.0), mesh="4x5", tol=None)
        condition = second_order(replace(held, problem=problem))
        assert condition.result is result, condition


@pytest.mark.slow
def test_curvature_does_not_depend_on_units_of_the_cost() -> None:
    """Nor does the sign depend on what is added to it."""
    values = []
    for factor, constant in ((1.0, 0.0), (1e-4, 0.0), (1e4, 1e6)):
        problem = great_circle(0.9 * np.pi)
        problem.cost = factor * problem.cost + constant
        values.append(second_order(go.solve(problem, mesh="4x6", tol=None)).value)
    np.testing.assert_allclose(values, values[0], rtol=1e-4)


@pytest.mark.parametrize("end, result", [(2.0, PASS), (-2.0, FAIL)])
def test_curvature_in_a_control_that_rests_does_not_depend_on_its_unit(
    end: float, result: ConditionResult
) -> None:
    """Out of a circle of radius 2 from 1/2 beside its middle: straight ahead is best, by the far side worst.

    The other control is zero all along, and H curves in it by 2e-8 of what one unit of it could tell.
    """
    found, t = [], np.linspace(0.0, 1.0, 21)
    for unit in (1.0, 1e4):
        model, _x, _y, u, w = dynamics("plane", "x y", "u w", lambda x, y, u, w: {x: u, y: w})
        problem, leg = one_phase("out of a circle", model, 0.0, 1.0)
        leg.initial(x=0.5 * unit, y=0.0)
        radius2 = leg.final_state("x") ** 2 + leg.final_state("y") ** 2
        problem.constrain("out", radius2 / unit**2, lower=4.0)
        problem.minimize(leg.integral(u**2 + w**2) / unit**2)
        states = {"x": unit * (0.5 + (end - 0.5) * t), "y": 0 * t}
        verdict = go.verify_trajectory(problem, t, states, {"u": unit * (end - 0.5) + 0 * t, "w": 0 * t})
        found.append(verdict["second order"])
    assert [c.result for c in found] == [result, result]
    assert found[1].value == pytest.approx(found[0].value, rel=1e-6)


def test_simple_solutions_are_varied_on_richer_meshes() -> None:
    """Refined, x = 0 needs a mesh with as many conditions as unknowns only, which leaves nothing to vary."""
    solution = replace(go.solve(regulator(1.0), mesh="1x2", tol=None), problem=regulator(1.5 * np.pi**2))
    assert second_order(solution).result is FAIL


def test_lanczos_finds_both_ends_of_a_spectrum() -> None:
    values = np.concatenate([[-3.0], np.linspace(0.0, 1.0, 300), [2.0]])
    turned = np.linalg.qr(np.random.default_rng(1).standard_normal((values.size, values.size)))[0]
    matrix = turned @ np.diag(values) @ turned.T
    found, vectors = run_lanczos(lambda v: matrix @ v, np.ones(values.size), 80)
    assert found[0] == pytest.approx(-3.0, abs=1e-7) and found[-1] == pytest.approx(2.0, abs=1e-7)
    np.testing.assert_allclose(matrix @ vectors[:, 0], found[0] * vectors[:, 0], atol=1e-3)


def mirror(bend: float, unit: float = 1.0, cost: float = 1.0) -> go.Verdict:
    """From (-1, 0) to (1, 0) over the mirror y = 1 - bend x^2, at its middle: Fermat's stationary time.

    The ellipse with these foci through (0, 1) bends by 1/4: a mirror that bends more is nearer beside its middle.
    """
    problem = go.Problem("mirror")
    legs = []
    for name in ("towards_", "away"):
        model = go.Model(name)
        x, y, heading = model.state("x"), model.state("y"), model.control("heading")
        model.ode({x: unit * ca.cos(heading), y: unit * ca.sin(heading)})
        legs.append(problem.phase(name, model))
    legs[0].time(0.0, (0.5, 5.0))
    legs[1].time((0.5, 5.0), (1.0, 10.0))
    legs[0].initial(x=-unit, y=0.0)
    legs[1].final(x=unit, y=0.0)
    problem.link(*legs)
    x, y = (legs[0].final_state(name) / unit for name in ("x", "y"))
    problem.constrain("mirror", y + bend * x**2, lower=1.0, upper=1.0)
    problem.minimize(cost * legs[1].final_time)
    way, none = unit * np.linspace(0.0, 1.0, 11), np.zeros(11)
    t = way / unit * np.sqrt(2)
    return go.verify_trajectory(
        problem,
        {"towards_": t, "away": np.sqrt(2) + t},
        {"towards_": [way - unit, way], "away": [way, unit - way]},
        {"towards_": none + np.pi / 4, "away": none - np.pi / 4},
    )


@pytest.mark.parametrize("stated", ["path", "parameter"])
def test_an_arc_on_a_path_constraint_is_held_where_it_begins(stated: str) -> None:
    """As high as possible on average below 0.8, at 1 at most: up to the ceiling in 0.8 s, and 0.48 in all.

    Between the points of the arc a variation would gain that vanishes at all of them.
    """
    model, x, _u = dynamics("rise", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("rise", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-1.0, 1.0))
    ceiling = problem.parameter("p", lower=0.0, upper=0.8, guess=0.5) if stated == "parameter" else 0.8
    leg.path("ceiling", x - ceiling, upper=0.0)
    problem.maximize(leg.integral(x))
    t = np.array([*np.linspace(0.0, 0.8, 9), *np.linspace(0.8, 1.0, 5)])
    push = np.repeat([1.0, 0.0], [9, 5])
    verdict = go.verify_trajectory(
        problem, t, np.minimum(t, 0.8), push, [0.8] if stated == "parameter" else None
    )
    assert verdict.minimum, verdict.explain()


@pytest.mark.parametrize(("product", "minimum"), [(1.0, True), (3.5, False)])
def test_a_saddle_far_steeper_than_the_middle_row_is_seen(product: float, minimum: bool) -> None:
    """p^2 / 2 + r^2 + product p r, and a speed in 1e-4 of its unit beside it: as steep as 1e8 middle rows."""
    cart, _x, u = dynamics("cart", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("saddle", cart, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=0.0)
    p, r = (problem.parameter(name, lower=-9.0, upper=9.0, guess=0.3) for name in ("p", "r"))
    problem.minimize(leg.integral((1e-4 * u - p) ** 2) + 0.5 * p**2 + r**2 + product * p * r)
    t = np.linspace(0.0, 1.0, 11)
    verdict = go.verify_trajectory(problem, t, [0 * t], [0 * t], [0.0, 0.0])
    assert verdict.minimum == minimum
    assert (verdict["second order"].result is FAIL) != minimum
