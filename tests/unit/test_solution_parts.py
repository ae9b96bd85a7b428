"""Small parts of a solution: what tries cost together, named integrals."""

import pytest

import gnc_opt as go
from gnc_opt.solution.solution import Statistics


def test_costs_of_tries_add_up() -> None:
    first = Statistics(iterations=3, build_s=0.5, solve_s=2.0, function_s=0.25, linear_solver_s=1.0)
    second = Statistics(
        iterations=10, build_s=0.0, solve_s=4.0, function_s=0.5, linear_solver_s=3.0, build_reused=True
    )
    assert second.after(first) == Statistics(13, 0.5, 6.0, 0.75, 4.0, True)


def test_integrals_by_name() -> None:
    """x' = u = 1 / 2 from 0 to 1 in 2 s: the integral of u^2 is 1 / 2, that of x is 1."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("two integrals")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    leg.integral(x, name="area")
    problem.minimize(leg.integral(u**2, name="effort"))
    phase = go.solve(problem, mesh="2x4").phase()
    assert (phase.integral("area"), phase.integral("effort")) == pytest.approx((1.0, 0.5), rel=1e-8)
    with pytest.raises(go.UnknownNameError, match="did you mean 'effort'"):
        phase.integral("efort")
    with pytest.raises(go.UnknownNameError, match="no integral"):
        phase.integral(1)  # type: ignore[arg-type]
