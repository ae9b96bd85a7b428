"""Singular arcs: Goh's condition and the generalised Legendre-Clebsch condition, against hand-made derivatives."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing import constructed_solutions as by_hand
from testing.second_order import of_samples, second_order_of
from testing.wrong_solutions import singular_problem

import gnc_opt as go
from gnc_opt.planning.optimality.cost_scale import least_for_long, without_switches
from gnc_opt.planning.verification.reduced_hessian import critical_cone, flown_spans, rounding_of_cost
from gnc_opt.planning.verification.singular_arcs import chatters

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
    problem = go.Problem("chain of integrators")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
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


def test_an_order_beyond_those_looked_for_is_not_told() -> None:
    condition = judged(chain(4, -1.0))
    assert (
        condition.result is go.ConditionResult.INCONCLUSIVE
        and "no derivative up to order 6" in condition.where
    )


@pytest.mark.parametrize(("order", "told"), [(1, False), (2, True), (3, False)])
def test_arcs_of_second_order_are_met_by_chattering(order: int, told: bool) -> None:
    problem = chain(order, 1.0)
    samples = go.solve(problem, mesh="3x3", tol=None).samples()["leg"]
    assert chatters(problem, samples, 0) is told


def plane(gyration: float, weights: tuple[float, float] = (1.0, 1.0)) -> go.Problem:
    """Two controls move x and y, whose squares cost; an area swept by both costs, too, and need not come back.

    The rate of z is x w - y u: the bracket of the two controls' fields is along z, whose costate is ``gyration``.
    """
    model = go.Model("plane")
    x, y, z = model.state("x"), model.state("y"), model.state("z")
    u, w = model.control("u"), model.control("w")
    model.ode({x: u, y: w, z: x * w - y * u})
    problem = go.Problem("plane")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
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
    model = go.Model("regular")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("regular")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
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
    problem = go.Problem("Aly and Chan")
    leg = problem.phase("leg", model)
    leg.time(0.0, 0.5 * np.pi)
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


@pytest.mark.parametrize("factor", [1e-8, 1.0, 1e8])
def test_a_path_constraint_that_determines_a_control_does_so_in_any_unit(factor: float) -> None:
    """x is to stay at 1 or above at the least of its integral: along the limit the slope of u is zero, and u no arc."""
    model = go.Model("wall")
    x, y, u = model.state("x"), model.state("y"), model.control("u")
    model.ode({x: u, y: 1.0})
    problem = go.Problem("wall")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=1.0, y=0.0)
    leg.bounds(u=(-1.0, 1.0))
    leg.path("wall", factor * x, lower=factor)
    problem.minimize(leg.integral(x) + leg.final_state("y"))
    solution = go.solve(problem, mesh="2x4")
    assert second_order_of(solution)[NAME].where == "no singular arc"


def coupled(coupling: float, start: float = 1.0) -> go.Problem:
    """x' = u at the least integral of (x^2 + v^2) / 2 + e u v: least in v at v = -e u, where -(e u)^2 / 2 is left."""
    model = go.Model("coupled")
    x, u, v = model.state("x"), model.control("u"), model.control("v")
    model.ode({x: u})
    problem = go.Problem("coupled")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0 + 7.0 * start)
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
    assert condition.result is result and "both curve H downwards" in condition.where
    assert condition.value == pytest.approx((2 * coupling) ** 2 / (0.5 + coupling), rel=1e-6)


def test_a_coupled_arc_is_ok_within_the_tolerance_and_no_minimum() -> None:
    verdict = go.verify(go.solve(coupled(5e-4)))
    assert verdict.ok and not verdict.minimum
    assert verdict["second order"].result is go.ConditionResult.INCONCLUSIVE


def test_a_control_that_loses_its_grip_before_a_free_end_is_no_singular_arc() -> None:
    """The furthest x by g' = exp(-20 t) cos b: b = 0. H curves in b by (1 - t) exp(-20 t), which decays."""
    model = go.Model("grip")
    x, g, b = model.state("x"), model.state("g"), model.control("b")
    clock = model.state("clock")
    model.ode({x: g, g: ca.exp(-20 * clock) * ca.cos(b), clock: 1.0})
    problem = go.Problem("grip")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0, g=0.0, clock=0.0)
    leg.bounds(b=(0.0, np.pi))
    problem.maximize(leg.final_state("x"))
    solution = go.solve(problem)
    assert solution.objective == pytest.approx((1.0 - (1.0 - np.exp(-20.0)) / 20) / 20, rel=1e-8)
    verdict, samples = go.verify(solution), list(solution.samples().values())
    assert verdict.ok, verdict.explain()
    # Its integral stands for no control: H is not affine in it.
    assert critical_cone(solution, samples, rounding_of_cost(samples), flown_spans).unit is None


def test_a_switch_smeared_by_a_polynomial_is_no_arc() -> None:
    times = np.linspace(0.0, 1.0, 100001)
    inside = np.array([(times > 0.3) & (times < 0.30005), (times > 0.3) & (times < 0.301)])
    assert not np.any(without_switches(times, inside)[0])
    np.testing.assert_array_equal(without_switches(times, inside)[1], inside[1])


def test_a_dip_counts_if_it_lasts() -> None:
    times = np.linspace(0.0, 1.0, 100_001)
    values = 3.0 + np.abs(times - 0.5)
    values[(times > 0.3) & (times < 0.30005)] = -2.0
    lasting = np.abs(times - 0.7) < 1e-3
    values[lasting] = -1.0 + 100.0 * np.abs(times[lasting] - 0.7)
    k = least_for_long(times, values)
    # Half of 1e-4 to either side of the trough it has risen by 0.005.
    assert values[k] == pytest.approx(-0.995, abs=1e-3) and times[k] == pytest.approx(0.7, abs=1e-4)
    coarse = np.linspace(0.0, 1.0, 11)
    assert least_for_long(coarse, np.cos(2 * np.pi * coarse)) == 5
    assert times[least_for_long(times, np.where(times > 0.99985, -1.0, 0.0))] > 0.99985
    assert times[least_for_long(times, np.where(times > 0.99995, -1.0, 0.0))] < 0.99995
