"""Small parts of a solution: what tries cost together, named integrals."""

from types import SimpleNamespace

import numpy as np
import pytest
from testing.internals import SCHEMES, RefinementIteration, Scheme, Statistics

import gnc_opt as go
from gnc_opt.planning import History, RefinementStatus
from gnc_opt.planning.solution.diagnosis import _running_off


def test_costs_of_tries_add_up() -> None:
    first = Statistics(iterations=3, build_s=0.5, solve_s=2.0, function_s=0.25, linear_solver_s=1.0)
    second = Statistics(
        iterations=10, build_s=0.0, solve_s=4.0, function_s=0.5, linear_solver_s=3.0, compiled_before=True
    )
    assert second.after(first) == Statistics(13, 0.5, 6.0, 0.75, 4.0, True)
    assert not first.compiled_before and not first.after(second).compiled_before


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
    phase = go.solve(problem, mesh="2x4", tol=None).phase()
    assert (phase.integral("area"), phase.integral("effort")) == pytest.approx((1.0, 0.5), rel=1e-8)
    with pytest.raises(go.UnknownNameError, match="did you mean 'effort'"):
        phase.integral("efort")
    with pytest.raises(go.UnknownNameError, match="no integral"):
        phase.integral(1)  # type: ignore[arg-type]


def test_numbers_are_numbers_and_vectors_are_vectors() -> None:
    """Two parameters of one component and of two, and constraints likewise: (p - 1)^2 + |q - (2, 3)|^2, q held at 1."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("parameters")
    p, q = problem.parameter("p"), problem.parameter("q", 2)
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    problem.constrain("both", q, equals=[1.0, 1.0])
    problem.constrain("one", p, upper=5.0)
    problem.minimize(leg.integral(u**2) + (p - 1) ** 2 + (q[0] - 2) ** 2 + (q[1] - 3) ** 2)
    solution = go.solve(problem, mesh="1x4", tol=None)
    assert isinstance(solution.parameter("p"), float) and isinstance(solution.multiplier("one"), float)
    assert solution.parameter("p") == pytest.approx(1.0, abs=1e-7)
    assert solution.parameter("q") == pytest.approx([1.0, 1.0], abs=1e-9)
    assert solution.multiplier("both") == pytest.approx([2.0, 4.0], rel=1e-6)
    assert solution.multiplier("one") == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(go.UnknownNameError, match="did you mean 'both'"):
        solution.multiplier("bth")


@pytest.mark.parametrize("scheme", SCHEMES)
def test_costs_at_both_ends(scheme: Scheme) -> None:
    """(x_0 - 1)^2 + 3 (x_f - 2)^2 + int u^2 over 1 s with x' = u is least, 3/7, from 10/7 to 13/7.

    A constraint that does not bind says what it is: x_0 x_f - 2 t_f.
    """
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("both ends")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    first, last = leg.initial_state("x"), leg.final_state("x")
    problem.constrain("product", first * last - 2 * leg.final_time, upper=5.0)
    problem.minimize((first - 1) ** 2 + 3 * (last - 2) ** 2 + leg.integral(u**2))
    solution = go.solve(problem, mesh="3x2", scheme=scheme, tol=None)
    assert solution.objective == pytest.approx(3 / 7, rel=1e-7)
    assert solution.phase().x([0.0, 1.0])[0] == pytest.approx([10 / 7, 13 / 7], rel=1e-6)
    assert solution.constraint_values == pytest.approx([130 / 49 - 2.0], rel=1e-5)
    assert solution.phase().lam(0.0) == pytest.approx(
        [-6 / 7], rel=1e-5
    )  # dJ*/dx_0 of what follows: -2 (x_0 - 1)


def test_a_record_after_an_earlier_one_has_the_passes_and_seconds_of_both() -> None:
    def record(status: RefinementStatus, n: int, chosen: int, seconds: float) -> History:
        passes = tuple(
            RefinementIteration({}, {}, 0.5**i, status.value, 0.0, True, i, 0.0, "") for i in range(n)
        )
        return History(status, 1e-6, passes, chosen, status.value, seconds)

    earlier, later = (
        record(RefinementStatus.STALLED, 3, 2, 1.5),
        record(RefinementStatus.CONVERGED, 2, 0, 4.0),
    )
    both = later.after(earlier)
    assert both.passes == (*earlier.passes, *later.passes) and both.seconds == 5.5
    assert both.final is later.passes[0] and both.chosen == 3
    assert both.converged and both.message == "converged" and not earlier.converged


def test_what_runs_off_is_named_once_where_it_is_largest_and_first() -> None:
    names = [f"{name}, t = {i}" for i in range(40) for name in ("x", "y", "z")]
    scaled = np.full(120, -2e6)
    scaled[3 * 7 + 1], scaled[2::3] = 3e6, 9e5
    found = _running_off(SimpleNamespace(variable_labels=names), scaled)  # type: ignore[arg-type]
    assert [(v.name, v.amount) for v in found] == [
        ("y, t = 7 runs off to infinity", 3e6),
        ("x, t = 0 runs off to infinity", 2e6),
    ]
