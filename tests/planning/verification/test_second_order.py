"""Second-order conditions of bang-bang solutions, and the structure loop that prepares them."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from testing.models import dynamics, one_phase
from testing.wrong_solutions import one_switch

import gnc_opt as go
from gnc_opt.planning import Arc, ArcKind, ConditionResult, refine
from gnc_opt.planning.optimality.switching_time_problem import Switches, SwitchingTimeProblem, SwitchUnknowns
from gnc_opt.planning.problem.hamiltonian_functions import PhaseFunctions
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.verification.bang_bang_second_order_conditions import (
    check_strict_bang_bang_property,
    explain_why_not_bang_bang,
)
from gnc_opt.planning.verification.solution_data_check import get_endpoint_gradients, recompute_stored_data


def oscillator(control_bound: float = 1.0) -> go.Problem:
    """Undamped oscillator to rest in minimum time: several switches, one costate dof each."""
    model, *_ = dynamics("oscillator", "x v", "u", lambda x, v, u: {x: v, v: -x + u})
    problem, leg = one_phase("oscillator to rest", model, 0.0, (0.1, 30.0))
    # A straight line leads to t = pi, where the miss is least locally; a decaying oscillation does not.
    leg.guess(
        time=[0.0, 8.0], x=lambda t: 5 * np.cos(t) * (1 - t / 8), v=lambda t: -5 * np.sin(t) * (1 - t / 8)
    )
    leg.initial(x=5.0, v=0.0)
    leg.final(x=0.0, v=0.0)
    leg.bounds(u=(-control_bound, control_bound))
    problem.minimize(leg.final_time)
    return problem


@pytest.fixture(scope="module")
def refined() -> go.Solution:
    return refine(go.solve(oscillator(), mesh="20x3", tol=None))


def test_switches_are_half_periods_apart(refined: go.Solution) -> None:
    """The switching function is a sinusoid of period 2 pi (Pontryagin et al. 1962), so inner arcs last pi."""
    inner = [arc.end - arc.start for arc in refined.structure[1:-1]]
    assert len(refined.structure) >= 3
    np.testing.assert_allclose(inner, np.pi, atol=1e-9)
    kinds = [arc.kind for arc in refined.structure]
    assert all(kind in (ArcKind.LOWER, ArcKind.UPPER) for kind in kinds)
    assert all(a is not b for a, b in itertools.pairwise(kinds))


def test_verdict_includes_second_order(refined: go.Solution) -> None:
    verdict = go.verify(refined, tol=1e-8)
    assert verdict.minimum, verdict.explain()
    assert verdict["switching times"].result is ConditionResult.PASS
    assert verdict["second order"].result is ConditionResult.PASS


def induced_problem(solution: go.Solution, refinement: int = 4) -> SwitchingTimeProblem:
    """The induced problem of a solution with one phase and no simultaneous switches."""
    solution = recompute_stored_data(solution)
    samples = list(solution.samples().values())
    name = samples[0].phase.name
    switches = {name: Switches.from_samples(samples[0])}
    pieces = {name: switches[name].build_piecewise_control(next(switches[name].list_switch_sequences()))}
    unknowns = SwitchUnknowns.from_switches(solution, samples, switches)
    return SwitchingTimeProblem.from_integrated_controls(
        solution, samples, get_endpoint_gradients(solution), unknowns, pieces, refinement
    )


def test_induced_jacobian_is_that_of_the_flow_in_closed_form(refined: go.Solution) -> None:
    leg = refined.phase()
    induced = induced_problem(refined)
    assert induced.unknowns.labels[-1] == "phase leg, final time"
    assert list(induced.unknowns.free) == [False] + [True] * (len(induced.unknowns.labels) - 1)
    # The costates are multipliers: they leave nothing of the cost's gradient.
    left = induced.gradient + induced.conditions.multipliers @ induced.conditions.jacobian
    np.testing.assert_allclose(left[1:], 0.0, atol=1e-6)
    # Final state of the oscillator in closed form: turning about (u, 0) at unit rate from switch to switch.
    knots = leg.breaks[list(leg.mesh.arc_breaks)]
    controls = leg.applied(0.5 * (knots[1:] + knots[:-1]))[0]

    def final_state(times: np.ndarray) -> np.ndarray:
        z = complex(5.0, 0.0)
        for left, right, u in zip(times[:-1], times[1:], controls, strict=True):
            z = u + (z - u) * np.exp(-1j * (right - left))
        return np.array([z.real, z.imag])

    step = 1e-6
    columns = []
    for k in range(1, knots.size):
        shift = np.zeros(knots.size)
        shift[k] = step
        columns.append((final_state(knots + shift) - final_state(knots - shift)) / (2 * step))
    found = induced.conditions.jacobian[:2, 1:] / induced.unknowns.scale[1:]
    np.testing.assert_allclose(found, np.stack(columns, axis=1), atol=1e-6)


def test_structure_survives_a_file(refined: go.Solution, tmp_path: object) -> None:
    path = refined.save(f"{tmp_path}/solution.npz")
    assert go.load(path).structure == refined.structure


def drifting(start: float) -> go.Problem:
    """x' = u, |u| <= 1, over 2 s from a free x0; the cost weighs x by the time since the start as well."""
    model, x, _u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("drifting", model, start, start + 2.0)
    leg.bounds(u=(-1.0, 1.0), x=(-5.0, 5.0))
    since = model.time - start
    running = leg.integral(-0.8 * x - 0.1 * x**2 + 0.3 * since * x)
    problem.minimize(running + 0.4 * leg.final_state("x") + 0.75 * leg.initial_state("x") ** 2)
    return problem


@pytest.mark.parametrize("start", [0.0, -1.0, 7.0])
def test_least_curvature_with_a_free_start_and_a_cost_that_depends_on_time(start: float) -> None:
    """x = x0 + t up to the switch s and x0 + 2 s - t after it: the cost of (x0, s) is a cubic, differentiated here."""
    mesh = go.Mesh.at_times([start, start + 0.8, start + 2.0], 5, movable=True)
    solution = go.solve(drifting(start).with_fixed_arcs(arcs=[[1, -1]]), mesh=mesh, tol=None)
    arcs = (
        Arc("leg", "u", ArcKind.UPPER, start, float(solution.phase().breaks[1])),
        Arc("leg", "u", ArcKind.LOWER, float(solution.phase().breaks[1]), start + 2.0),
    )
    nodes, weights = np.polynomial.legendre.leggauss(4)

    def cost(point: np.ndarray) -> float:
        x0, s = point
        total = 0.4 * (x0 + 2 * s - 2) + 0.75 * x0**2
        for left, right in ((0.0, s), (s, 2.0)):
            t = left + 0.5 * (right - left) * (1 + nodes)
            x = x0 + np.minimum(t, 2 * s - t)
            total += 0.5 * (right - left) * weights @ (-0.8 * x - 0.1 * x**2 + 0.3 * t * x)
        return float(total)

    point = np.array([solution.state("x")(start), solution.phase().breaks[1] - start])
    step, units = 1e-3, np.eye(2)
    hessian = np.array(
        [
            [
                sum(a * b * cost(point + step * (a * e + b * f)) for a in (1, -1) for b in (1, -1))
                / (4 * step**2)
                for f in units
            ]
            for e in units
        ]
    )
    assert solution.objective == pytest.approx(cost(point), rel=1e-9)
    verdict = go.verify(replace(solution, structure=arcs))
    assert verdict["second order"].result is verdict["second order"].result is ConditionResult.PASS
    induced = induced_problem(replace(solution, structure=arcs))
    order = [induced.unknowns.labels.index(what) for what in ("phase leg, initial x", switch_label(induced))]
    scale = induced.unknowns.scale[order]
    found = induced.compute_lagrangian_hessian(induced.conditions.multipliers)[0][
        np.ix_(order, order)
    ] / np.outer(scale, scale)
    np.testing.assert_allclose(found, hessian, rtol=1e-5)


def switch_label(induced: SwitchingTimeProblem) -> str:
    return next(label for label in induced.unknowns.labels if "switch of" in label)


def test_a_slope_that_is_no_number_is_not_strict(
    refined: go.Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    samples = PhaseSamples.from_phase(refined.phase(), refined.phase_functions("leg"))
    assert check_strict_bang_bang_property([samples]).result is ConditionResult.PASS
    unknown = lambda self, t, x, u, lam, mu: np.full(np.shape(u), np.nan)  # noqa: E731
    monkeypatch.setattr(PhaseFunctions, "control_gradient", unknown)
    assert check_strict_bang_bang_property([samples]).result is ConditionResult.FAIL


def why_inapplicable(solution: go.Solution) -> str:
    return explain_why_not_bang_bang(list(recompute_stored_data(solution).samples().values()))


@pytest.mark.parametrize("weight", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("kind", ["state_multipliers", "path_multipliers"])
def test_a_push_counts_by_its_share_of_the_cost(weight: float, kind: str) -> None:
    """Over 100 m: 20 s, 10 m/s, costates worth 10 per weight; what matters begins at 5e-6 and 1e-6 per weight."""
    solution = weighted(weight)
    leg = solution.phase()
    reason = "a state bound is active" if kind == "state_multipliers" else "a path constraint is active"
    for share, forbids in ((2e-7, False), (1e-4, True)):
        pushed = getattr(leg, kind).copy()
        pushed[-1, 3] = -share * weight
        found = why_inapplicable(replace(solution, phases={"leg": replace(leg, **{kind: pushed})}))
        assert found.endswith(reason) is forbids


def weighted(weight: float) -> go.Solution:
    """Rest to rest over 100 m in minimum time, which costs ``weight`` per second."""
    model, _q, v, _a = dynamics("double integrator", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("minimum time", model, 0.0, (0.1, 100.0))
    leg.initial(q=100.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    leg.path("speed", v, lower=-50.0)
    problem.minimize(weight * leg.final_time)
    mesh = go.Mesh.at_times([0.0, 9.0, 20.0], 5, movable=True)
    options = go.SolverOptions(tolerance=1e-11)
    solution = go.solve(problem.with_fixed_arcs(arcs=[[-1, 1]]), mesh=mesh, options=options, tol=None)
    arcs = (Arc("leg", "a", ArcKind.LOWER, 0.0, 10.0), Arc("leg", "a", ArcKind.UPPER, 10.0, 20.0))
    return replace(solution, structure=arcs)


def test_a_single_arc_has_no_switch_to_judge() -> None:
    """x' = u from 0 to 1 in minimum time: u = 1 throughout, and as many conditions as unknowns."""
    model, *_ = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("one way", model, 0.0, (0.1, 10.0))
    leg.initial(x=0.0)
    leg.final(x=1.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    solution = go.solve(problem.with_fixed_arcs(arcs=[[1]]), mesh="1x4", tol=None)
    verdict = go.verify(replace(solution, structure=(Arc("leg", "u", ArcKind.UPPER, 0.0, 1.0),)))
    strict, second = verdict["switching times"], verdict["second order"]
    assert (strict.result, strict.value) == (ConditionResult.PASS, 0.0)
    assert strict.where == "no switch between control limits"
    assert (second.result, second.value) == (ConditionResult.PASS, 0.0)
    assert "no degree of freedom" in second.where


def far_limit(problem: go.Problem, leg: go.Phase) -> float:
    problem.constrain("far", leg.final_state("x"), upper=100.0)
    return 0.0


def designed(curvature: float) -> Callable[[go.Problem, go.Phase], object]:
    def more(problem: go.Problem, leg: go.Phase) -> object:
        k = problem.parameter("k", lower=-1.0, upper=1.0, guess=0.0)
        return curvature * k**2

    return more


@pytest.mark.parametrize(
    ("bend", "more", "result"),
    [
        (1.5, far_limit, ConditionResult.FAIL),
        (0.5, far_limit, ConditionResult.PASS),
        (0.5, designed(-1.0), ConditionResult.FAIL),
        (0.5, designed(1.0), ConditionResult.PASS),
        (1.0, far_limit, ConditionResult.INCONCLUSIVE),
    ],
)
def test_only_what_is_active_takes_directions(
    bend: float, more: Callable[[go.Problem, go.Phase], object], result: ConditionResult
) -> None:
    """A limit that is far away takes none, a free parameter adds one, and no curvature at all is neither."""
    assert go.verify(one_switch(bend, more=more))["second order"].result is result


def cart(problem: go.Problem) -> go.Phase:
    model, *_ = dynamics("double integrator", "q v", "a", lambda q, v, a: {q: v, v: a})
    leg = problem.phase("leg", model)
    leg.bounds(a=(-1.0, 1.0))
    return leg


def test_ranges_of_the_final_time_and_of_an_initial_value_at_their_limits() -> None:
    """From rest to rest in at most 2 s: 1 m. To the origin from 0.5 m to 1 m away and at rest: from 0.5 m, in 1 s."""
    farthest, fastest = go.Problem("farthest"), go.Problem("start anywhere")
    leg = cart(farthest)
    leg.time(0.0, (0.1, 2.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(v=0.0)
    farthest.maximize(leg.final_state("q"))
    leg = cart(fastest)
    leg.time(0.0, (0.1, 10.0))
    leg.initial(q=(0.5, 1.0), v=0.0)
    leg.final(q=0.0, v=0.0)
    fastest.minimize(leg.final_time)
    for problem, objective in ((farthest, 1.0), (fastest, np.sqrt(2.0))):
        solution = go.solve(problem, tol=1e-8)
        assert solution.objective == pytest.approx(objective, abs=1e-8) and solution.structure
        assert go.verify(solution).minimum


@pytest.mark.parametrize("far", [1e3, 1e9])
@pytest.mark.parametrize(("share", "result"), [(0.9, ConditionResult.PASS), (1.1, ConditionResult.FAIL)])
def test_far_limits_do_not_change_the_second_order(share: float, result: ConditionResult, far: float) -> None:
    """The integral of u^2 - w^2 f(x) over 1 s is least for w < pi, with f = x^2 from x = 0 to 1, u 0.5 above its limit,
    and with f = sin^2 x at rest."""
    t, w = np.linspace(0.0, 1.0, 61)[None], share * np.pi
    motion = np.sin(w * t) / np.sin(w), w * np.cos(w * t) / np.sin(w)
    for (x, u), limits in ((motion, (np.min(motion[1]) - 0.5, far)), ((0 * t, 0 * t), (-far, far))):
        model, state, control = dynamics("integrator", "x", "u", lambda x, u: {x: u})
        problem, leg = one_phase("oscillator", model, 0.0, 1.0)
        leg.initial(x=0.0)
        leg.final(x=x[0, -1])
        leg.bounds(u=limits)
        problem.minimize(leg.integral(control**2 - w**2 * (state if np.any(x) else ca.sin(state)) ** 2))
        assert go.verify_trajectory(problem, t[0], x, u)["second order"].result is result


@pytest.mark.parametrize(("share", "minimum"), [(1.0, True), (1.1, False)])
def test_a_free_time_of_a_picosecond_is_not_zero(share: float, minimum: bool) -> None:
    """x' = u from 0 to 1 at the cost 1 / T + T: the best T is 1."""
    t = np.linspace(0.0, share * 1e-12, 21)
    model, _x, u = dynamics("integrator", "x", "u", lambda x, u: {x: 1e12 * u})
    problem, leg = one_phase("picosecond", model, 0.0, (0.0, 1e-11))
    leg.initial(x=0.0)
    leg.final(x=1.0)
    problem.minimize(leg.integral(u**2 + 1))
    assert go.verify_trajectory(problem, t, t[None] / t[-1], 1 / share + 0 * t[None]).ok is minimum


def switch_together(kappa: float, n: int = 2) -> go.Solution:
    """n controls that switch at 1 s; the cost decreases by kappa / 2 times the square of the first two's difference."""
    model, x, _u = dynamics("integrators", f"x:{n}", f"u:{n}", lambda x, u: {x: u})
    problem, leg = one_phase("together", model, 0.0, 2.0)
    leg.initial(x=0.0)
    leg.bounds(u=([-1.0] * n, [1.0] * n))
    ends = leg.final_state("x")
    problem.minimize(ca.sum1(ends) - leg.integral(ca.sum1(x)) - kappa / 8 * (ends[0] - ends[1]) ** 2)
    mesh = go.Mesh.at_times([0.0, 0.9, 2.0], 5, movable=True)
    solution = go.solve(problem.with_fixed_arcs(arcs=[[1, -1]] * n), mesh=mesh, tol=None)
    arcs = [
        Arc("leg", label, k, *e)
        for label in model.controls.labels
        for k, e in ((ArcKind.UPPER, (0.0, 1.0)), (ArcKind.LOWER, (1.0, 2.0)))
    ]
    return replace(solution, structure=tuple(arcs))


def test_simultaneous_switches_may_part() -> None:
    """J = -2 + (s - 1)^2 + (r - 1)^2 - kappa / 2 (s - r)^2 at switches s and r: a saddle beyond kappa = 1.

    The eigenvalue 2 - 2 kappa is relative to the norms of both terms of the Hessian and the cost scale.
    """
    kappas = {0.9: ConditionResult.PASS, 1.0: ConditionResult.INCONCLUSIVE, 1.1: ConditionResult.FAIL}
    found = {kappa: go.verify(switch_together(kappa))["second order"] for kappa in kappas}
    assert {kappa: condition.result for kappa, condition in found.items()} == kappas
    first, second = ((2 * k - 2) / found[k].value - 2 * k - np.sqrt(8) for k in (0.9, 1.1))
    assert first > 0 and first == pytest.approx(second, rel=1e-6)
    for condition in found.values():
        assert condition.tolerance == pytest.approx(-1e-9, rel=1e-3) and "2 orders" in condition.where
    assert found[1.0].where.endswith("the curvature is within its error")


def test_more_orders_than_are_tested_leave_the_second_order_inconclusive() -> None:
    """Six switches at one time have 720 orders."""
    verdict = go.verify(switch_together(0.9, 6))
    assert verdict.ok and not verdict.minimum
    assert verdict["second order"].where == "simultaneous switches have more than 120 possible orders"


def test_equal_carts_switch_together() -> None:
    """Every order of their switches is as good and leaves no direction; both switching functions vanish at 1 s."""
    model, _q, _v, _a = dynamics("carts", "q:2 v:2", "a:2", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("two carts", model, 0.0, (0.1, 10.0))
    leg.initial(q=[1.0, 1.0], v=[0.0, 0.0])
    leg.final(q=[0.0, 0.0], v=[0.0, 0.0])
    leg.bounds(a=([-1.0, -1.0], [1.0, 1.0]))
    problem.minimize(leg.final_time)
    solution = go.refine(go.solve(problem, mesh="7x3", tol=None), structure="bang-bang")
    verdict = go.verify(solution)
    assert solution.objective == pytest.approx(2.0, abs=1e-8)
    assert len(solution.structure) == 4 and verdict.minimum, verdict.explain()
    # One time for two switches leaves their multipliers open within the tolerance of the solver.
    np.testing.assert_allclose(solution.costate("v")(1.0), 0.0, atol=1e-6)


def through_phases(pull: float) -> go.Solution:
    """A cart whose thrust is twice as strong from 1 s on, from rest to rest over 1 m in minimum time, in two phases."""
    problem = go.Problem("stronger later")
    legs = []
    for name, strength in (("weak", 1.0), ("strong", pull)):
        model, *_ = dynamics(name, "q v", "a", lambda q, v, a, k=strength: {q: v, v: k * a})
        legs.append(problem.phase(name, model))
        legs[-1].bounds(a=(-1.0, 1.0))
    legs[0].time(0.0, 0.5)
    legs[1].time(0.5, (0.6, 10.0))
    legs[0].initial(q=1.0, v=0.0)
    legs[1].final(q=0.0, v=0.0)
    problem.link("weak", "strong")
    problem.minimize(legs[1].final_time)
    return go.solve(problem, tol=1e-8)


def test_several_phases_with_dynamics_switched_by_time() -> None:
    """v = -1/2 at 1/2 s, then thrust 2: -1/2 - 2 s + 2 r = 0 and the way covered is 1 m."""
    solution = through_phases(2.0)
    verdict = go.verify(solution)
    assert verdict["second order"].result is verdict["second order"].result is ConditionResult.PASS, (
        verdict.explain()
    )
    # q = 7/8 - s/2 - s^2 when the thrust turns, s after 1/2 s; the same speed is lost in r = s + 1/4 with r^2 = q.
    s = (-1 + np.sqrt(1 + 13 / 2)) / 4
    assert solution.objective == pytest.approx(0.5 + 2 * s + 0.25, abs=1e-7)


@pytest.mark.parametrize(("gain", "result"), [(0.2, ConditionResult.PASS), (0.3, ConditionResult.FAIL)])
def test_a_switch_may_come_in_from_the_end(gain: float, result: ConditionResult) -> None:
    """Braking for the last d seconds costs d^2 of the way and 2 d of the speed, whose loss gains ``gain`` (2 d)^2."""
    problem = go.Problem("farthest, with any speed")
    leg = cart(problem)
    leg.time(0.0, 2.0)
    leg.initial(q=0.0, v=0.0)
    problem.minimize(-leg.final_state("q") - gain * (leg.final_state("v") - 2.0) ** 2)
    verdict = go.verify(go.solve(problem.with_fixed_arcs(arcs=[[1]]), mesh="1x4", tol=None))
    assert verdict["second order"].result is result, verdict.explain()
    assert verdict["switching times"].result is ConditionResult.PASS


@pytest.mark.parametrize(("split", "result"), [(0.9, ConditionResult.PASS), (1.1, ConditionResult.FAIL)])
def test_each_phase_of_several_has_switches_of_its_own(split: float, result: ConditionResult) -> None:
    """Two phases that share nothing but the cost, which is that of two switches at s and r, see `pair`."""
    problem = go.Problem("pair of phases")
    total, ends = 0.0, []
    for name in ("first", "second"):
        model, x, _u = dynamics(name, "x", "u", lambda x, u: {x: u})
        leg = problem.phase(name, model)
        leg.time(0.0, 2.0)
        leg.initial(x=0.0)
        leg.bounds(u=(-1.0, 1.0))
        total = total + leg.final_state("x") - leg.integral(x)
        ends.append(leg.final_state("x"))
    problem.minimize(total - split / 8 * (ends[0] - ends[1]) ** 2)
    held = problem.with_fixed_arcs("first", arcs=[[1, -1]]).with_fixed_arcs("second", arcs=[[1, -1]])
    verdict = go.verify(go.solve(held, mesh=go.Mesh.at_times([0.0, 0.9, 2.0], 5, movable=True), tol=None))
    condition = verdict["second order"]
    assert condition.result is result and "2 degrees of freedom" in condition.where, verdict.explain()


@pytest.mark.parametrize(("angle", "shortest"), [(2.0, True), (2.6, False)])
def test_a_string_round_a_ball_slips_off_along_the_limit(angle: float, shortest: bool) -> None:
    """Tangents of length 1/2 at both ends of an arc round the unit ball.

    The arc slips off sideways beyond 2 atan(2) = 2.214 rad: there variations along the limit lower the length.
    """
    model = go.Model("string")
    x, y, z = model.state("x"), model.state("y"), model.state("z")
    u, v, w = model.control("u"), model.control("v"), model.control("w")
    model.ode({x: u, y: v, z: w})
    along, whole = [np.linspace(0, part, n) for part, n in ((0.5, 21), (angle, 121))], angle + 1.0
    arc = along[1] - angle / 2
    circle = np.array([np.sin(arc), np.cos(arc)])
    tangent = np.array([np.cos(arc), -np.sin(arc)])
    first = circle[:, :1] + (along[0] - 0.5) * tangent[:, :1]
    last = circle[:, -1:] + along[0] * tangent[:, -1:]
    path = np.hstack([first, circle, last])
    rates = whole * np.hstack([np.repeat(tangent[:, :1], 21, 1), tangent, np.repeat(tangent[:, -1:], 21, 1)])
    times = np.concatenate([along[0], 0.5 + along[1], 0.5 + angle + along[0]]) / whole
    problem, leg = one_phase("string", model, 0.0, 1.0)
    leg.initial(x=path[0, 0], y=path[1, 0], z=0.0)
    leg.final(x=path[0, -1], y=path[1, -1], z=0.0)
    leg.path("ball", x**2 + y**2 + z**2, lower=1.0)
    problem.minimize(leg.integral(u**2 + v**2 + w**2))
    states = {"x": path[0], "y": path[1], "z": 0 * times}
    controls = {"u": rates[0], "v": rates[1], "w": 0 * times}
    assert go.verify_trajectory(problem, times, states, controls).ok == shortest
