"""Mistakes that show only when a problem is complete: `check` finds them before the solver starts."""

from __future__ import annotations

import warnings
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.models import dynamics, one_phase
from testing.wrong_arguments import assert_clear, cart, refused, rest_to_rest, scalar, ship

import gnc_opt as go

# --- completeness -----------------------------------------------------------------------------------------


def test_completeness_refused() -> None:
    with refused(go.ProblemError, "problem 'p' has no phase", "phase(name, model)"):
        go.Problem("p").check()

    _, problem, _ = scalar()
    with refused(go.ProblemError, "problem 'decay' has no cost", "minimize()"):
        problem.check()

    problem, model = go.Problem("p"), cart()
    leg = problem.phase("leg", model)
    problem.minimize(leg.integral(model.symbol("a") ** 2))
    with refused(go.ProblemError, "phase 'leg' of problem 'p' has no times", "time(initial=..., final=...)"):
        problem.check()

    _, problem, _ = scalar()
    with refused(go.ProblemError, "no cost"):
        go.solve(problem, tol=None)


def test_numbers_that_contradict_each_other_refused() -> None:
    problem, leg = rest_to_rest()
    leg.time(initial=5.0, final=(1.0, 2.0))
    with refused(
        go.ProblemError, "phase 'leg'", "ends before it starts", "initial time 5 s, final time [1, 2] s"
    ):
        problem.check()

    problem, leg = rest_to_rest()
    leg.time(initial=1.0, final=1.0)
    with refused(go.ProblemError, "phase 'leg'", "no duration", "initial time 1 s, final time 1 s"):
        problem.check()

    problem, leg = rest_to_rest()
    leg.time(initial=0.0, final=(1.0, 2.0), duration=(8.0, 9.0))
    with refused(go.ProblemError, "phase 'leg'", "cannot last [8, 9] s", "final time of [1, 2] s"):
        problem.check()

    problem, leg = rest_to_rest()
    leg.time(initial=0.0, final=5.0, duration=(None, 2.0))
    with refused(go.ProblemError, "phase 'leg'", "cannot last [0, 2] s", "final time of 5 s"):
        problem.check()

    problem, leg = rest_to_rest()
    leg.bounds(q=(-0.5, 0.5))
    with refused(
        go.ProblemError, "initial value of 'q' in phase 'leg'", "is 1", "bounds [-0.5, 0.5]", "correct"
    ):
        problem.check()

    problem, model = go.Problem("p"), ship()
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.bounds(r=(-1.0, 1.0))
    leg.final(r=([0.0, 5.0, 0.0], [0.0, 6.0, 0.0]))
    problem.minimize(leg.final_time)
    with refused(go.ProblemError, "final value of 'r[1]' in phase 'leg'", "is [5, 6]", "bounds [-1, 1]"):
        problem.check()

    problem, model = go.Problem("p"), cart()
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.final(q=1.0)
    leg.bounds(a=(-1.0, 1.0))
    leg.path("wall", 1.5 * model.symbol("q") + model.symbol("a"), upper=0.3)
    problem.minimize(leg.integral(model.symbol("a") ** 2))
    with refused(
        go.ProblemError,
        "path constraint 'wall'",
        "final values of phase 'leg'",
        "it is [0.5, 2.5] there",
        "0.3]",
    ):
        problem.check()

    problem, _ = two_legs()  # time() fixes the initial time at 0: nothing is left for the first phase
    with refused(go.ProblemError, "phase 'b'", "follows phase 'a'", "starts at 0 s", "b.time(initial=None"):
        problem.check()


@pytest.mark.parametrize("times", [{"initial": 0.0, "final": None}, {"initial": None, "final": 0.0}])
def test_duration_holds_when_only_one_time_is_free(times: dict[str, float | None]) -> None:
    model, problem, leg = scalar()
    leg.time(**times, duration=(2.0, 3.0))
    problem.minimize(leg.duration + leg.integral(model.symbol("u") ** 2))
    solution = go.solve(problem, mesh="3x3", tol=None)
    assert solution.phase().duration == pytest.approx(
        2.0, abs=1e-7
    )  # interior point: within tolerance / multiplier


def test_value_that_rounding_puts_outside_its_bound() -> None:
    problem, leg = rest_to_rest()
    leg.bounds(q=(0.0, 0.3))
    leg.initial(q=0.1 + 0.2)  # 0.30000000000000004
    assert go.solve(problem, mesh="3x3", tol=None).status.solved


@pytest.mark.parametrize("limit", [0.5, 0.5 - 1e-7])
def test_end_at_which_a_path_constraint_is_just_met(limit: float) -> None:
    problem, leg = rest_to_rest()
    leg.path("wall", leg.model.symbol("q") / 2, upper=limit)
    problem.check()


def two_legs(first_final: Any = None, **second_time: Any) -> tuple[go.Problem, go.Phase]:
    """A cart moved in two phases that are linked, in least time."""
    model, problem = cart(), go.Problem("two")
    a, b = problem.phase("a", model), problem.phase("b", model)
    for leg in (a, b):
        leg.bounds(a=(-1.0, 1.0))
    a.time(final=first_final)
    b.time(**second_time)
    a.initial(q=0.0, v=0.0)
    b.final(q=1.0, v=0.0)
    problem.link(a, b)
    problem.minimize(b.final_time)
    return problem, a


@pytest.mark.parametrize("initial", [None, (1.0, 2.0)])
def test_phase_that_follows_another_later(initial: Any) -> None:
    two_legs(initial=initial)[0].check()


@pytest.mark.parametrize("limits", [{"equals": 4.5}, {"lower": 4.5}, {"upper": 1.5}])
def test_boundary_constraint_that_no_end_meets(limits: dict[str, float]) -> None:
    problem, a = two_legs(first_final=(1.0, 2.0), initial=None)
    problem.constrain("meet", 2 * a.final_time, **limits)
    with pytest.raises(go.ProblemError, match=r"constraint 'meet' .* cannot hold .* \[2, 4\]"):
        problem.check()


def test_boundary_constraint_that_the_last_end_meets() -> None:
    problem, a = two_legs(first_final=(1.0, 2.0), initial=None)
    problem.constrain("meet", 2 * a.final_time, equals=4.0)
    problem.check()


@pytest.mark.parametrize(
    ("times", "cost", "value"),
    [
        ({"final": 3.0}, lambda leg: leg.final_time, 3),
        ({"initial": None, "final": None, "duration": 3.0}, lambda leg: 2 * leg.duration, 6),
        ({"final": (1.0, 3.0)}, lambda leg: leg.final_state("q") ** 2, 0.25),
        ({"final": 3.0}, lambda leg: leg.integral(0.5), 1.5),
        ({"final": 3.0}, lambda leg: 4.0, 4),
    ],
)
def test_cost_that_no_control_changes_warns(times: dict[str, Any], cost: Any, value: float) -> None:
    problem, model = go.Problem("p"), cart()
    leg = problem.phase("leg", model)
    leg.time(**times)
    leg.final(q=0.5)
    problem.minimize(cost(leg))
    with pytest.warns(go.ProblemWarning, match=f"cost of problem 'p' is {value:g} for all controls.*squared"):
        problem.check()
    if ca.symvar(problem.cost):
        leg.final(q=None)
        leg.time(0.0, None, duration=(0.1, None))
        problem.check()


def test_declared_and_not_used_refused() -> None:
    model = go.Model("cart")
    q, a = model.state("q"), model.control("a")
    model.control("spare")
    model.ode({q: a})
    problem, leg = one_phase("p", model, 0.0, 1.0)
    problem.minimize(leg.integral(a**2))
    with refused(
        go.ProblemError, "control 'spare' of phase 'leg' of problem 'p'", "no dynamics", "remove it"
    ):
        problem.check()

    model, _r, force = dynamics("plane", "r:2", "force:3", lambda r, force: {r: force[:2]})
    problem, leg = one_phase("p", model, 0.0, 1.0)
    problem.minimize(leg.integral(force[0] ** 2 + force[1] ** 2))
    with refused(go.ProblemError, "control 'force[2]'"):
        problem.check()

    problem, model = go.Problem("p"), ship()
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    problem.parameter("mas", lower=1.0, upper=2.0)
    problem.minimize(leg.integral(ca.sumsqr(model.symbol("force")) + ca.sumsqr(model.symbol("tilt"))))
    with refused(go.ProblemError, "parameter 'mas' of problem 'p'", "no function", "did you mean 'mass'?"):
        problem.check()


def test_unused_model_parameter_is_a_warning_at_the_users_line() -> None:
    other = go.Model("other")
    x, u = other.state("x"), other.control("u")
    other.parameter("mass", 1.0)
    other.ode({x: u})
    problem, leg = one_phase("p", other, 0.0, 1.0)
    problem.minimize(leg.integral(u**2))
    with pytest.warns(go.ProblemWarning, match="parameter 'mass' of model 'other' is used nowhere") as caught:
        go.solve(problem, mesh="2x2", tol=None)
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        problem.check()  # once is enough


def test_functions_that_are_not_finite_at_the_guess_refused() -> None:
    model, _, u = dynamics("log", "x", "u", lambda x, u: {x: u * ca.log(x)})
    problem, leg = one_phase("p", model, 0.0, 1.0)
    leg.initial(x=-1.0)
    problem.minimize(leg.integral(u**2))
    with refused(
        go.ProblemError,
        "rate of state 'x' is nan",
        "phase 'leg' of problem 'p'",
        "t = 0.",
        "(x = -",
        "guess()",
    ):
        problem.check()

    model, problem, leg = scalar()
    leg.path("angle", ca.acos(2.0 + model.symbol("x")), upper=1.0)
    problem.minimize(leg.integral(model.symbol("u") ** 2))
    with refused(go.ProblemError, "path constraint 'angle'", "is nan", "phase 'leg'", "t = "):
        problem.check()

    model, problem, leg = scalar()
    problem.minimize(leg.integral(ca.sqrt(model.symbol("x") - 2.0), name="loss"))
    with refused(go.ProblemError, "integral 'loss'", "is nan", "phase 'leg'", "t = "):
        problem.check()

    model, problem, leg = scalar()
    leg.initial(x=None)
    leg.guess(x=0.0)
    problem.minimize(leg.integral(ca.sqrt(model.symbol("x")), name="loss"))
    with refused(
        go.ProblemError, "derivative of integral 'loss' with respect to 'x' is inf", "phase 'leg'", "x = 0"
    ):
        problem.check()

    model, _x, u = dynamics("root", "x", "u", lambda x, u: {x: ca.sqrt(u)})
    problem, leg = one_phase("p", model, 0.0, 1.0)
    leg.guess(u=0.0)
    problem.minimize(leg.final_state("x"))
    with refused(
        go.ProblemError, "derivative of the rate of state 'x' with respect to 'u' is", "phase 'leg'"
    ):
        problem.check()

    _, problem, leg = scalar()
    problem.minimize(ca.log(leg.final_state("x") - 5.0))
    with refused(go.ProblemError, "cost of problem 'decay' is nan", "end points of the guess"):
        problem.check()

    _, problem, leg = scalar()
    leg.guess(x=(2.0, 1.0))
    problem.constrain("root", ca.sqrt(leg.final_state("x") - 1.0), upper=1.0)
    problem.minimize(leg.final_state("x"))
    with refused(go.ProblemError, "derivative of constraint 'root' with respect to 'final x of leg' is inf"):
        problem.check()

    model, problem, leg = scalar()
    leg.guess(x=lambda t: np.nan)
    problem.minimize(leg.integral(model.symbol("u") ** 2))
    with refused(go.ProblemError, "guess of 'x' in phase 'leg'", "at t = 0", "finite"):
        problem.check()

    model, problem, leg = scalar()
    leg.guess(x=lambda t: [t, t])
    problem.minimize(leg.integral(model.symbol("u") ** 2))
    with refused(go.ProblemError, "guess of 'x' in phase 'leg'", "at t = 0 s", "2 values", "give one value"):
        problem.check()


def test_singularity_at_a_bound_is_left_to_the_solver() -> None:
    """Fine: solvers stay off bounds, Gauss points off the ends of a phase."""
    model, x, u = dynamics("root", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("p", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    leg.bounds(x=(0.0, None))
    problem.minimize(leg.integral(u**2 + 0.1 * ca.sqrt(x)))
    with pytest.warns(go.ProblemWarning, match="integral 'integral_1' .* at its initial state"):
        problem.check()
    assert go.solve(problem, mesh="4x3", tol=None).status.solved


@pytest.mark.parametrize(
    ("drag", "end"),
    [
        (lambda v: ca.sqrt(ca.sumsqr(v)) * v, "initial"),  # 0/0
        (lambda v: v**1.5, "initial"),  # in the second derivative
        (lambda v: (1.0 - v) ** 1.5, "final"),
        (lambda v: ca.sqrt(ca.sumsqr(v) + 1e-6) * v, None),
        (lambda v: ca.sqrt(v + 1.0), None),
    ],
)
def test_derivatives_that_are_not_finite_at_a_given_end_are_a_warning(drag: Any, end: str | None) -> None:
    model, *_ = dynamics("boat", "r:2 v:2", "a:2", lambda r, v, a: {r: v, v: a - drag(v)})
    problem, leg = one_phase("p", model, 0.0, 1.0)
    leg.initial(v=[0.0, 0.0])
    leg.final(v=[1.0, 1.0])
    leg.bounds(v=([0.0, 0.0], [1.0, 1.0]))
    problem.minimize(leg.integral(ca.sumsqr(model.symbol("a"))))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        problem.check()
    found = "; ".join(str(each.message) for each in caught)
    if end is None:
        assert not found
    else:
        assert_clear(
            found,
            f"rate of state 'v[0]' of phase 'leg' of problem 'p' has no finite derivatives at its {end}",
        )
        assert len(caught) == 1


def test_a_free_end_state_that_the_guess_sets_to_zero_is_no_singularity() -> None:
    model, _r, _v, a = dynamics("boat", "r:2 v:2", "a:2", lambda r, v, a: {r: v, v: a - ca.norm_2(v) * v})
    problem, leg = one_phase("p", model, 0.0, 1.0)
    leg.initial(r=[0.0, 0.0])
    leg.final(r=[1.0, 1.0])
    problem.minimize(leg.integral(ca.sumsqr(a)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        problem.check()


def test_large_models_are_not_printed_state_by_state() -> None:
    model, _x, u = dynamics("large", "x:20", "u:20", lambda x, u: {x: ca.log(x) + u})
    problem, leg = one_phase("p", model, 0.0, 1.0)
    leg.initial(x=-1.0)
    problem.minimize(leg.integral(ca.sumsqr(u)))
    with pytest.raises(go.ProblemError) as caught:
        problem.check()
    assert_clear(str(caught.value), "rate of state 'x[0]'")
    assert "x[1]" not in str(caught.value)
