"""Controls that active constraints determine are not singular; those that they merely touch are."""

from __future__ import annotations

import numpy as np
import pytest
from testing.second_order import second_order_of
from testing.wrong_solutions import scaled, with_leg

import gnc_opt as go
from gnc_opt.planning.optimality.active_set import left_free
from gnc_opt.planning.solution.samples import PhaseSamples

PASS, UNTOLD = go.ConditionResult.PASS, go.ConditionResult.INCONCLUSIVE


def curvature(solution: go.Solution) -> set[go.ConditionResult]:
    found = second_order_of(solution)
    return {found[name].result for name in ("Legendre-Clebsch", "singular arcs")}


def along_a_slope(unit: float, *, others: int = 0) -> go.Solution:
    """The farthest x of x' = u under u + x <= 1: u = exp(-t), which H, affine in u, does not determine."""
    model = go.Model("slope")
    x, u = model.state("x"), model.control("u")
    equations = {x: u}
    if others:
        equations[model.state("y")] = model.control("w")
    model.ode(equations)
    problem = go.Problem("slope")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(**dict.fromkeys(model.states.names, 0.0))
    if others:
        leg.final(y=0.0)
        leg.bounds(w=(-1.0, 1.0))
    leg.bounds(u=(-5.0 * unit, 5.0 * unit))
    leg.path("sum", u + x, upper=unit)
    problem.maximize(leg.final_state("x"))
    return go.solve(problem, mesh="2x10", tol=None)


@pytest.mark.parametrize("unit", [1.0, 1e4, 1e-4])
def test_a_control_fixed_by_a_mixed_constraint_is_not_singular(unit: float) -> None:
    solution = along_a_slope(unit)
    assert solution.objective == pytest.approx((1 - np.exp(-1)) * unit, rel=1e-6)
    assert curvature(solution) == {PASS}


def test_another_control_beside_it_stays_singular() -> None:
    condition = second_order_of(along_a_slope(1.0, others=1))["singular arcs"]
    assert condition.result is UNTOLD and ", w, " in condition.where


def cruise(order: int, *, by_path: bool = False) -> go.Solution:
    """A chain of integrators that starts on a ceiling of its first state and must stay there as long as it pays."""
    model = go.Model("chain")
    states = [model.state(f"x{k}") for k in range(order)]
    u = model.control("u")
    model.ode(dict(zip(states, [*states[1:], u], strict=True)))
    problem = go.Problem("cruise")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(**dict.fromkeys(model.states.names, 0.0))
    leg.bounds(u=(-1.0, 1.0))
    if by_path:
        leg.path("ceiling", states[0], upper=0.0)
    else:
        leg.bounds(x0=(None, 0.0))
    problem.maximize(leg.integral(states[0]))
    return go.solve(problem, mesh="3x5", tol=None)


@pytest.mark.parametrize("by_path", [False, True])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_order_of_a_state_constraint_is_found(order: int, by_path: bool) -> None:
    solution = cruise(order, by_path=by_path)
    leg = solution.phase()
    assert np.allclose(np.hstack(leg.x.values), 0.0, atol=1e-6)
    solution = scaled(scaled(solution, "x", 0.0), "u", 0.0)
    s = PhaseSamples.of(with_pushes(solution, by_path, 1.0).phase(), solution.functions("leg"))
    inside = np.ones((1, s.times.size), dtype=bool)
    assert all(basis.shape == (1, 0) for basis in left_free(s, inside, np.ones(1)))
    idle = PhaseSamples.of(with_pushes(solution, by_path, 0.0).phase(), solution.functions("leg"))
    assert all(basis.shape == (1, 1) for basis in left_free(idle, inside, np.ones(1)))


def with_pushes(solution: go.Solution, by_path: bool, size: float) -> go.Solution:
    """The same with another multiplier of the ceiling throughout."""
    name = "path_multipliers" if by_path else "state_multipliers"
    values = np.zeros_like(getattr(solution.phase(), name))
    values[0] = size
    return with_leg(solution, **{name: values})


def test_arc_along_a_ceiling_is_judged() -> None:
    assert curvature(cruise(1)) == {PASS}
