"""Minimum time: the brachistochrone, and bang-bang problems whose meshes have a node on the switch.

A mesh whose boundaries are fixed fractions of the phase and sit exactly on the switches leaves every control
on its bound, so fewer variables than equations remain: the program has many multipliers, and H need not be
continuous across the switch. With the boundary movable (its stationarity is the continuity of H) they are
unique.
"""

from __future__ import annotations

import numpy as np
import pytest
from testing.closed_forms import SCHEMES, Truth, assert_matches, constant, solve
from testing.models import dynamics, one_phase

import gnc_opt as go

pytestmark = pytest.mark.parametrize("scheme", SCHEMES)


def cart_problem(target: float, lower: float, upper: float) -> tuple[go.Problem, go.Phase]:
    """Rest to rest in minimum time with lower <= u <= upper."""
    cart, *_ = dynamics("cart", "x v", "u", lambda x, v, u: {x: v, v: u})
    problem, leg = one_phase("minimum time", cart, initial=0.0, final=(0.1, 100.0))
    leg.initial(x=0.0, v=0.0)
    leg.final(x=target, v=0.0)
    leg.bounds(u=(lower, upper))
    problem.minimize(leg.final_time)
    return problem, leg


def bang_bang_truth(switch: float, end: float, upper: float, lower: float, found: float) -> Truth:
    """Accelerate with ``upper`` until the switch, then brake with ``lower`` < 0 to rest at the end; H = -1.

    ``found`` is the solution's switch, equal up to rounding: which side of it a time lies on is its choice.
    """
    slope = 1 / (upper * switch)
    target = upper * switch**2 / 2 + upper * switch * (end - switch) / 2
    return Truth(
        end,
        states={
            "x": lambda t: np.where(t < found, upper * t**2 / 2, target + lower * (t - end) ** 2 / 2),
            "v": lambda t: np.where(t < found, upper * t, lower * (t - end)),
        },
        controls={"u": lambda t: np.where(t < found, upper, lower)},
        costates={"x": constant(-slope), "v": lambda t: slope * (t - switch)},
        hamiltonian=constant(-1.0),
    )


@pytest.mark.parametrize("degree", [3, 4, 7])
def test_fixed_node_on_the_switch(degree: int, scheme: str) -> None:
    """A fixed mesh with a boundary on the switch: t_f, trajectory and lam_x to 1e-8.

    lam_v is left out: its zero may lie anywhere between the points beside the switch. So is LGL's trajectory:
    it has two controls at the switch, and other pairs than (1, -1) reach the target in the same time.
    """
    problem, _ = cart_problem(1.0, -1.0, 1.0)
    solution = solve(problem, go.Mesh.uniform(2, degree), scheme, tolerance=1e-12)
    switch = solution.phase().breaks[1]
    assert switch == pytest.approx(1.0, abs=1e-8)
    exact = bang_bang_truth(1.0, 2.0, 1.0, -1.0, switch)
    states, controls = (exact.states, exact.controls) if scheme != "LGL" else ({}, {})
    assert_matches(solution, Truth(2.0, states, costates={"x": exact.costates["x"]}), 1e-8)
    assert_matches(
        solution, Truth(2.0, controls=controls), 1e-7
    )  # the barrier keeps them that far off their bounds


@pytest.mark.parametrize("degree", [3, 7])
@pytest.mark.parametrize(("lower", "target", "switch", "end"), [(-1, 1, 1, 2), (-2, 300, 20, 30)])
def test_movable_node_on_the_switch(
    lower: float, target: float, switch: float, end: float, degree: int, scheme: str
) -> None:
    """Controls held on their bounds, the switch a variable, started off it: all to 1e-8, H = -1 too."""
    problem, leg = cart_problem(target, lower, 1.0)
    leg.hold([[1, -1]])
    mesh = go.Mesh.at_times([0.0, 0.6 * end, end], degree, movable=True)
    solution = solve(problem, mesh, scheme)
    found = solution.phase().breaks[1]
    assert found == pytest.approx(switch, rel=1e-8)
    assert_matches(solution, bang_bang_truth(switch, end, 1.0, lower, found), 1e-8)
    # A held control is fixed; its multiplier is what the bound would push: minus the switching function.
    pushes = np.asarray(solution.switching_function("u", solution.phase().point_times))
    np.testing.assert_allclose(solution.phase().control_multipliers[0], -pushes, atol=1e-8)


def test_two_phases_with_different_authority(scheme: str) -> None:
    """|u| <= 2 until x = 1/2, then |u| <= 1, to rest at x = 1: t_f = 1/2 + sqrt(3/2), and lam_x jumps."""
    cart, *_ = dynamics("cart", "x v", "u", lambda x, v, u: {x: v, v: u})
    problem = go.Problem("two stages")
    first, second = problem.phase("first", cart), problem.phase("second", cart)
    first.time(initial=0.0, final=(0.1, 10.0))
    second.time(initial=(0.1, 10.0), final=(0.2, 20.0))
    first.initial(x=0.0, v=0.0)
    second.final(x=1.0, v=0.0)
    first.bounds(u=(-2.0, 2.0))
    second.bounds(u=(-1.0, 1.0))
    first.hold([[1, -1]])
    second.hold([[-1]])
    problem.link(first, second)
    problem.constrain("gate", first.final_state("x"), equals=0.5)
    problem.minimize(second.final_time)
    meshes = {"first": go.Mesh((0.0, 0.7, 1.0), (3, 4), (1,)), "second": go.Mesh.uniform(1, 3)}
    solution = solve(problem, meshes, scheme)
    slope, switch, middle = 1 / np.sqrt(1.5), np.sqrt(1.5) / 2, np.sqrt(1.5) - 0.5
    end = middle + 1
    found = solution.phase("first").breaks[1]
    assert found == pytest.approx(switch, abs=1e-8)
    slope_after = slope * (middle - switch) - 1  # lam_v is continuous, and H = -1 = lam_x v - lam_v
    before = Truth(
        end,
        states={"v": lambda t: np.where(t < found, 2 * t, 1 - 2 * (t - middle))},
        controls={"u": lambda t: np.where(t < found, 2.0, -2.0)},
        costates={"x": constant(-slope), "v": lambda t: slope * (t - switch)},
        hamiltonian=constant(-1.0),
    )
    after = Truth(
        end,
        states={"v": lambda t: end - t, "x": lambda t: 1 - (end - t) ** 2 / 2},
        controls={"u": constant(-1.0)},
        costates={"x": constant(slope_after), "v": lambda t: 1 + slope_after * (end - t)},
        hamiltonian=constant(-1.0),
    )
    assert_matches(solution, before, 1e-8, "first")
    assert_matches(solution, after, 1e-8, "second")
    assert solution.multiplier("gate") == pytest.approx(-slope - slope_after, abs=1e-8)


def test_an_arc_cannot_be_shorter_than_nothing(scheme: str) -> None:
    """x' = u from 0 to 1: after u = 1 an arc with u = -1 only costs time, unless it lasted less than nothing.

    Arcs of t_1 and t_2 need t_1 - t_2 = 1 and take 1 + 2 t_2: 1 s with t_2 = 0, and less and less below.
    """
    model, *_ = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("one way", model, initial=0.0, final=(0.1, 10.0))
    leg.initial(x=0.0)
    leg.final(x=1.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    mesh = go.Mesh.at_times([0.0, 1.2, 1.4], 3, movable=True)
    solution = solve(problem.with_fixed_arcs(arcs=[[1, -1]]), mesh, scheme)
    assert solution.objective == pytest.approx(1.0, abs=1e-7)
    assert np.min(np.diff(solution.phase().breaks)) >= 0.0
