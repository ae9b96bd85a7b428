"""Continuation: closed forms along the way, steps that adapt, where solutions vanish and branches end."""

from typing import Any

import numpy as np
import pytest
from testing.internals import predict_solution
from testing.models import dynamics
from testing.problem_families import rest_to_rest, stiff

import gnc_opt as go


def closed_form(k: float) -> float:
    return float(np.sqrt(k) * np.tanh(np.sqrt(k)))


@pytest.mark.slow
def test_every_solution_on_the_way_is_the_closed_form() -> None:
    found = go.continuation(stiff, [1.0, 10.0, 40.0], step=2.0, mesh="7x4")
    assert found.is_complete and found.status is go.ContinuationStatus.COMPLETE and not found.events
    assert {1.0, 10.0, 40.0} <= set(found.values) and found.values[-1] == 40.0
    np.testing.assert_allclose(found.objectives, [closed_form(k) for k in found.values], rtol=1e-7)
    assert found.solution_at(10.0).objective == pytest.approx(closed_form(10.0))
    assert found.final_solution is found.solutions[-1]
    assert np.max(np.diff(found.values)) > 2.0  # steps grow where predictions are good
    assert str(found).startswith("stiff: continuation complete, ")
    with pytest.raises(go.ArgumentError, match=r"no solution at 3\.5"):
        found.solution_at(3.5)


def test_it_goes_down_too() -> None:
    found = go.continuation(stiff, [4.0, 1.0], mesh="5x4")
    assert found.is_complete and found.objectives[-1] == pytest.approx(closed_form(1.0), rel=1e-7)


def test_predictions_by_sensitivity_are_of_second_order() -> None:
    """Halving the step quarters the error of the tangent; along no tangent it would halve."""
    problem = stiff()
    last = go.solve(problem, mesh="5x4", options=go.SolverOptions(tolerance=1e-12), tol=None)
    errors = []
    for step in (0.2, 0.1):
        twin = problem.with_parameters(k=1.0 + step)
        exact = go.solve(twin, mesh="5x4", options=go.SolverOptions(tolerance=1e-12), tol=None)
        errors.append(predict_solution(twin, last, None, 0.0).compute_prediction_error(exact))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)


def test_initial_values_are_predicted_too() -> None:
    """The problem is linear-quadratic: the tangent in the initial value is the answer."""
    problem = stiff()
    last = go.solve(problem, mesh="5x4", options=go.SolverOptions(tolerance=1e-12), tol=None)
    twin = problem.with_initial(x=2.0)
    exact = go.solve(twin, mesh="5x4", options=go.SolverOptions(tolerance=1e-12), tol=None)
    assert predict_solution(twin, last, None, 0.0).compute_prediction_error(exact) < 1e-8


@pytest.mark.slow
def test_where_a_solution_vanishes() -> None:
    """Less than 2 s cannot be done."""
    problem = rest_to_rest()
    found = go.continuation(lambda t: problem.with_time(final=t), [3.0, 1.5], smallest=0.05, mesh="6x4")
    assert found.status is go.ContinuationStatus.BRANCH_ENDED and not found.is_complete
    assert 2.0 - 1e-3 < found.values[-1] < 2.1
    assert found.events[-1].startswith("no solution beyond 2.0") and "infeasible" in found.events[-1]
    early = found.values > np.sqrt(6.0)
    np.testing.assert_allclose(found.objectives[early], 12 / found.values[early] ** 3, rtol=1e-6)


def cubic(k: float) -> go.Problem:
    """Pays p^4 / 4 - p^2 / 2 + k p for a choice p: the local minimum near +1 ends in a fold at k = 2 / sqrt(27)."""
    model = go.Model("cubic")
    x, u, level = model.state("x"), model.control("u"), model.parameter("k", k)
    model.ode({x: u})
    problem = go.Problem("cubic")
    p = problem.parameter("p", lower=-3.0, upper=3.0, guess=1.2)
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    problem.minimize(leg.integral(u**2 + p**4 / 4 - p**2 / 2 + level * p))
    return problem


@pytest.mark.slow
def test_the_end_of_a_branch_is_a_jump() -> None:
    found = go.continuation(cubic, [0.0, 0.6], smallest=1e-2, mesh="2x3")
    assert found.is_complete and len(found.events) == 1
    fold = 2 / np.sqrt(27)
    before, after = (float(text) for text in found.events[0].split(":")[0].split()[2::2])
    assert before <= fold + 1e-2 and after >= fold - 1e-2 and after - before < 2.5e-2
    assert found.solutions[0].parameter("p") == pytest.approx(1.0, abs=1e-6)
    assert float(found.final_solution.parameter("p")) < -1.0


@pytest.mark.slow
def test_a_structure_is_carried_along() -> None:
    """Saturated, free, saturated: below T^2 = 6 the control meets its bounds."""
    problem = rest_to_rest(2.2)
    found = go.continuation(lambda t: problem.with_time(final=t), [2.2, 2.3], tol=1e-8)
    assert found.is_complete and not found.events
    first, last = found.solutions[0], found.final_solution
    assert [arc.kind for arc in first.structure] == [arc.kind for arc in last.structure] and len(
        last.structure
    ) == 3
    direct = go.solve(rest_to_rest(2.3), tol=1e-8, check=False)
    assert last.objective == pytest.approx(direct.objective, rel=1e-9)
    assert [arc.end for arc in last.structure] == pytest.approx(
        [arc.end for arc in direct.structure], abs=1e-6
    )


@pytest.mark.parametrize(
    "arguments, message",
    [
        ((stiff, [1.0]), "give two or more, ascending or descending"),
        ((stiff, [1.0, 3.0, 2.0]), "give two or more, ascending or descending"),
        ((stiff, [1.0, np.nan]), "give two or more"),
        ((stiff, ["a", 1]), "not a number"),
        ((stiff(), [1.0, 2.0]), "needs a function"),
        ((lambda k: k, [1.0, 2.0]), "the result of the function of continuation"),
        ((rest_to_rest, [1.0, 2.0]), "the first problem of continuation.*, at 1, has no solution"),
    ],
)
def test_mistakes_get_a_sentence(arguments: Any, message: str) -> None:
    with pytest.raises(go.GncOptError, match=message):
        go.continuation(*arguments)
    with pytest.raises(go.GncOptError, match="step of continuation"):
        go.continuation(stiff, [1.0, 2.0], step=0.0)


def test_ctrl_c_keeps_what_was_found() -> None:
    calls = []

    def family(k: float) -> go.Problem:
        calls.append(k)
        if len(calls) > 3:
            raise KeyboardInterrupt
        return stiff(k)

    found = go.continuation(family, [1.0, 2.0, 3.0, 4.0, 5.0], mesh="5x4")
    assert found.status is go.ContinuationStatus.INTERRUPTED and not found.is_complete
    assert 1.0 < found.values[-1] < 5.0
    np.testing.assert_allclose(found.objectives, [closed_form(k) for k in found.values], rtol=1e-7)


def two_phases(duration: float = 4.0) -> go.Problem:
    """A rest-to-rest move of 1 m in two phases of equal bounds: 12 / T^3 as in one."""
    problem = go.Problem("two phases")
    legs = []
    for name in ("first", "second"):
        model, *_ = dynamics("cart", "x v", "u", lambda x, v, u: {x: v, v: u})
        legs.append(problem.phase(name, model))
    problem.sequence(*legs, durations={"first": 0.5 * duration, "second": 0.5 * duration})
    legs[0].initial(x=0.0, v=0.0)
    legs[1].final(x=1.0, v=0.0)
    problem.minimize(sum(leg.integral(leg.model.symbol("u") ** 2) for leg in legs))
    return problem


@pytest.mark.slow
def test_several_phases() -> None:
    found = go.continuation(two_phases, [4.0, 3.0, 2.0], step=0.5, mesh="3x4")
    assert found.is_complete and not found.events
    np.testing.assert_allclose(found.objectives, 12 / found.values**3, rtol=1e-7)
