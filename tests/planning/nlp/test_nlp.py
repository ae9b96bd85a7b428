"""The boundary to NLP solvers: endings, silence, warm starts, interruption, derivatives, options."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from gnc_opt.planning import SolverOptions, Status
from gnc_opt.planning.nlp import IterationInfo, NlpPoint, NlpProblem, NlpResult, NlpSolver, read_solver_status

INF = np.inf
NO_CONSTRAINT = ca.MX(0, 1)


def problem(n: int, write: Callable[[Any], tuple[Any, Any]], **derivatives: Any) -> NlpProblem:
    x = ca.MX.sym("x", n)
    f, g = write(x)
    return NlpProblem(x=x, p=ca.MX(0, 1), f=f, g=g, **derivatives)


def solve(
    nlp: NlpProblem,
    x0: Any,
    lbx: Any = -INF,
    ubx: Any = INF,
    lbg: Any = 0.0,
    ubg: Any = 0.0,
    options: SolverOptions | None = None,
    **more: Any,
) -> NlpResult:
    point = NlpPoint(x0, lbx, ubx, lbg, ubg, more.pop("p", ()))
    return NlpSolver(nlp, options).solve(point, **more)


def rosenbrock(n: int) -> NlpProblem:
    return problem(
        n, lambda x: (ca.sum1((1 - x[:-1]) ** 2 + 100 * (x[1:] - x[:-1] ** 2) ** 2), NO_CONSTRAINT)
    )


def quadratic_with_derivatives(**replaced: Any) -> NlpProblem:
    """min p x1^2 + x2^2 + x1 x2  s.t.  x1 + x2^2 = 2, all derivatives by hand."""
    x, p, lam_f, lam_g = (ca.MX.sym(s, n) for s, n in (("x", 2), ("p", 1), ("lam_f", 1), ("lam_g", 1)))
    f, g = p * x[0] ** 2 + x[1] ** 2 + x[0] * x[1], x[0] + x[1] ** 2
    gradient = ca.vertcat(2 * p * x[0] + x[1], 2 * x[1] + x[0])
    jacobian = ca.horzcat(1, 2 * x[1])
    hessian = ca.triu(lam_f * ca.blockcat([[2 * p, 1], [1, 2]]) + lam_g * ca.diag(ca.vertcat(0, 2)))
    given = {
        "grad_f": ca.Function("my_grad", [x, p], [f, gradient]),
        "jac_g": ca.Function("my_jac", [x, p], [g, jacobian]),
        "hess_lag": ca.Function("my_hess", [x, p, lam_f, lam_g], [hessian]),
    }
    return NlpProblem(x=x, p=p, f=f, g=g, **(given | replaced))


UNBOUNDED: dict[str, tuple[NlpProblem, Any, Any]] = {
    "linear": (problem(1, lambda x: (-x, NO_CONSTRAINT)), 0.0, -INF),
    "linear, one bound": (problem(1, lambda x: (-x, NO_CONSTRAINT)), 1.0, 0.0),
    "concave": (problem(1, lambda x: (-(x**2), NO_CONSTRAINT)), 1.0, -INF),
    "exponential": (problem(1, lambda x: (-ca.exp(x), NO_CONSTRAINT)), 0.0, -INF),
    "cubic": (problem(1, lambda x: (x**3, NO_CONSTRAINT)), -1.0, -INF),
    "saddle": (problem(2, lambda x: (x[0] * x[1], NO_CONSTRAINT)), 1.0, -INF),
    "along a line": (problem(2, lambda x: (x[0], x[0] - x[1])), 0.0, -INF),
    "along a cubic": (problem(2, lambda x: (x[0], x[0] - x[1] ** 3)), 1.0, -INF),
    "many": (problem(20, lambda x: (-ca.sum1(x), NO_CONSTRAINT)), 0.0, -INF),
}

NOT_A_NUMBER: dict[str, tuple[NlpProblem, float]] = {
    "objective": (problem(1, lambda x: (ca.sqrt(x), NO_CONSTRAINT)), -1.0),
    "infinite objective": (problem(1, lambda x: (1 / x, NO_CONSTRAINT)), 0.0),
    "gradient": (problem(1, lambda x: (ca.sqrt(x), NO_CONSTRAINT)), 0.0),
    "constraint": (problem(1, lambda x: (x**2, ca.log(x))), -1.0),
    "guess": (problem(1, lambda x: (x**2, NO_CONSTRAINT)), np.nan),
}


def is_silent(capfd: pytest.CaptureFixture[str]) -> bool:
    return tuple(capfd.readouterr()) == ("", "")


def test_optimal(capfd: pytest.CaptureFixture[str]) -> None:
    result = solve(rosenbrock(5), -0.5)
    assert result.status is Status.OPTIMAL and result.status.solved
    assert result.raw_status == "Solve_Succeeded"
    np.testing.assert_allclose(result.x, 1.0, atol=1e-9)
    assert result.g.shape == result.lam_g.shape == (0,)
    assert result.iterations > 0
    assert 0.0 < result.function_time < result.wall_time
    assert 0.0 < result.linear_solver_time < result.wall_time
    assert is_silent(capfd)


@pytest.mark.parametrize("name", UNBOUNDED)
def test_unbounded(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    nlp, x0, lbx = UNBOUNDED[name]
    result = solve(nlp, x0, lbx)
    assert result.status is Status.UNBOUNDED, result
    assert result.iterations < 200
    assert is_silent(capfd)


@pytest.mark.parametrize("name", NOT_A_NUMBER)
def test_not_a_number_at_the_guess(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    nlp, x0 = NOT_A_NUMBER[name]
    result = solve(nlp, x0)
    assert result.status is Status.NOT_A_NUMBER, result
    assert result.iterations == 0
    np.testing.assert_array_equal(result.x, x0)
    assert is_silent(capfd)


@pytest.mark.parametrize(
    ("nlp", "lbg", "ubg"),
    [
        (problem(1, lambda x: (x**2, ca.vertcat(x, x))), [1, -2], [2, 0]),
        (problem(2, lambda x: (x[0], ca.sumsqr(x))), -2, -1),
        (problem(2, lambda x: (x[0], ca.sumsqr(x))), -1, -1),
    ],
)
def test_infeasible(nlp: NlpProblem, lbg: Any, ubg: Any, capfd: pytest.CaptureFixture[str]) -> None:
    assert solve(nlp, 1.0, lbg=lbg, ubg=ubg).status is Status.INFEASIBLE
    assert is_silent(capfd)


def test_too_few_degrees_of_freedom(capfd: pytest.CaptureFixture[str]) -> None:
    nlp = problem(2, lambda x: (x[0], ca.vertcat(x[0] - x[1], x[0] + x[1], 2 * x[0])))
    result = solve(nlp, [0.3, 0.4], lbg=[1, 2, 9], ubg=[1, 2, 9])
    assert result.status is Status.TOO_FEW_DEGREES_OF_FREEDOM
    assert result.iterations == 0
    np.testing.assert_array_equal(result.x, [0.3, 0.4])
    np.testing.assert_allclose(result.g, [-0.1, 0.7, 0.6])
    assert is_silent(capfd)


def test_iteration_limit(capfd: pytest.CaptureFixture[str]) -> None:
    result = solve(rosenbrock(20), -0.5, options=SolverOptions(max_iterations=3))
    assert result.status is Status.ITERATION_LIMIT
    assert result.iterations == 3
    assert is_silent(capfd)


def test_verbose_prints(capfd: pytest.CaptureFixture[str]) -> None:
    solve(rosenbrock(3), 0.0, options=SolverOptions(verbose=True))
    assert "EXIT: Optimal Solution Found" in capfd.readouterr().out


@pytest.mark.parametrize("status", Status)
def test_every_status_has_a_remedy_and_serialises(status: Status) -> None:
    assert status.remedy.endswith(".") and len(status.remedy) > 40
    assert status.value == status.name.lower()
    assert Status(json.loads(json.dumps(status.value))) is status
    assert status.solved == (status.name in ("OPTIMAL", "ACCEPTABLE"))


@pytest.mark.parametrize(
    ("stats", "status"),
    [
        ({"return_status": "Restoration_Failed", "success": False}, Status.RESTORATION_FAILED),
        ({"return_status": "Maximum_WallTime_Exceeded", "success": False}, Status.INTERRUPTED),
        ({"return_status": "fine", "success": True}, Status.OPTIMAL),
        ({"success": False, "unified_return_status": "SOLVER_RET_LIMITED"}, Status.ITERATION_LIMIT),
        ({"success": False, "unified_return_status": "SOLVER_RET_NAN"}, Status.NOT_A_NUMBER),
        ({"success": False, "unified_return_status": "SOLVER_RET_INFEASIBLE"}, Status.INFEASIBLE),
        ({"success": False, "unified_return_status": "SOLVER_RET_UNKNOWN"}, Status.FAILED),
        ({"return_status": "unbounded", "success": True}, Status.UNBOUNDED),
        ({"return_status": "CONTINUOUS_UNBOUNDED", "success": False}, Status.UNBOUNDED),
        ({"return_status": "INFEASIBLE", "success": False}, Status.INFEASIBLE),
        ({"return_status": "LIMIT_EXCEEDED", "success": False}, Status.ITERATION_LIMIT),
        ({}, Status.FAILED),
    ],
)
def test_names_of_ipopt_and_other_plugins(stats: dict[str, object], status: Status) -> None:
    assert read_solver_status(stats) is status


def bounded_rosenbrock() -> tuple[NlpSolver, NlpPoint]:
    return NlpSolver(rosenbrock(30)), NlpPoint(-0.5, -2.0, 0.8, 0.0, 0.0, ())


def test_warm_start_is_shorter_and_ends_at_the_same_point() -> None:
    solver, point = bounded_rosenbrock()
    cold = solver.solve(point)
    warm = solver.solve(replace(point, x0=cold.x, lam_x0=cold.lam_x, lam_g0=cold.lam_g))
    assert cold.status is warm.status is Status.OPTIMAL
    assert warm.iterations <= 3 < cold.iterations
    np.testing.assert_allclose(warm.x, cold.x, rtol=0, atol=1e-9)
    np.testing.assert_allclose(warm.lam_x, cold.lam_x, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("lam_x", "lam_g"), [(None, None), (0.0, None), (None, 0.0), (0.0, 0.0)])
def test_any_multiplier_makes_a_start_warm(lam_x: Any, lam_g: Any) -> None:
    point = replace(bounded_rosenbrock()[1], lam_x0=lam_x, lam_g0=lam_g)
    assert (point.warm_or_cold_start == "cold") is (lam_x is lam_g is None)
    assert point.drop_multipliers().warm_or_cold_start == "cold"


def test_identical_solves_give_identical_bits() -> None:
    solver, point = bounded_rosenbrock()
    first, again = solver.solve(point), solver.solve(point)
    fresh_solver, _ = bounded_rosenbrock()
    fresh = fresh_solver.solve(point)
    warm = [solver.solve(replace(point, x0=first.x, lam_x0=first.lam_x)) for _ in range(2)]
    for one, other in ((first, again), (first, fresh), tuple(warm)):
        for name in ("x", "f", "g", "lam_x", "lam_g", "iterations"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_bounds_are_not_relaxed() -> None:
    nlp = problem(1, lambda x: (1e6 * x, NO_CONSTRAINT))
    assert solve(nlp, 2.0, lbx=1.0).x[0] >= 1.0
    assert solve(nlp, 2.0, lbx=1.0, options=SolverOptions(bound_relax=1e-8)).x[0] < 1.0


def test_signs_of_the_multipliers() -> None:
    """min x1 + x2  s.t. x1 >= 1, x1 + 2 x2 >= 4: L stationary with lam_g = -1/2, lam_x = (-1/2, 0)."""
    result = solve(problem(2, lambda x: (x[0] + x[1], x[0] + 2 * x[1])), 5.0, [1, -INF], INF, 4, INF)
    np.testing.assert_allclose(result.x, [1, 1.5], atol=1e-8)
    np.testing.assert_allclose(result.lam_g, [-0.5], atol=1e-8)
    np.testing.assert_allclose(result.lam_x, [-0.5, 0], atol=1e-8)


@pytest.mark.parametrize("solver", ["ipopt", "sqpmethod"])
@pytest.mark.parametrize("treatment", ["make_parameter", "make_parameter_nodual", "relax_bounds"])
def test_multipliers_of_fixed_variables(solver: str, treatment: str) -> None:
    """With x1 = 1 fixed: x2 = 1 (or -1), lam_g from the second row of stationarity, lam_x1 from the first."""
    extra = {"ipopt.fixed_variable_treatment": treatment} if solver == "ipopt" else {}
    options = SolverOptions(solver=solver, extra=extra)
    for nlp in (quadratic_with_derivatives(), quadratic_with_derivatives(grad_f=None, jac_g=None)):
        result = solve(nlp, [1, 0.7], [1, -5], [1, 5], 2, 2, options, p=3.0)
        assert result.status is Status.OPTIMAL
        np.testing.assert_allclose(result.x, [1, 1], atol=1e-8)
        np.testing.assert_allclose(result.lam_g, [-1.5], atol=1e-7)
        np.testing.assert_allclose(result.lam_x, [-(6 + 1 - 1.5), 0], atol=1e-7)


def test_sqpmethod_agrees_with_ipopt(capfd: pytest.CaptureFixture[str]) -> None:
    nlp = quadratic_with_derivatives()
    ipopt, sqp = (
        solve(nlp, 1.0, [0.5, -5], 5, 2, 2, SolverOptions(solver=name), p=3.0)
        for name in ("ipopt", "sqpmethod")
    )
    assert ipopt.status is sqp.status is Status.OPTIMAL
    for name in ("x", "f", "g", "lam_x", "lam_g"):
        np.testing.assert_allclose(getattr(sqp, name), getattr(ipopt, name), rtol=0, atol=1e-7)
    assert is_silent(capfd)


@pytest.mark.parametrize("solver", ["ipopt", "sqpmethod", "bonmin"])
def test_given_derivatives_give_the_same_answer(solver: str) -> None:
    options = SolverOptions(solver=solver)
    with_own = solve(quadratic_with_derivatives(), 1.0, -5, 5, 2, 2, options, p=3.0)
    without = quadratic_with_derivatives(grad_f=None, jac_g=None, hess_lag=None)
    np.testing.assert_allclose(with_own.x, solve(without, 1.0, -5, 5, 2, 2, options, p=3.0).x, atol=1e-7)


@pytest.mark.parametrize("solver", ["ipopt", "sqpmethod"])
@pytest.mark.parametrize("name", ["grad_f", "jac_g", "hess_lag"])
def test_given_derivatives_are_used(solver: str, name: str) -> None:
    """Make one derivative wrong: the solve must not take the path of the right one."""
    nlp = quadratic_with_derivatives()
    right = getattr(nlp, name)
    inputs = right.mx_in()
    *values, derivative = right.call(inputs)
    wrong = ca.Function("wrong", inputs, [*values, 3 * derivative])
    options = SolverOptions(solver=solver, max_iterations=2)
    good = solve(nlp, 1.0, -5, 5, 2, 2, options, p=3.0)
    bad = solve(quadratic_with_derivatives(**{name: wrong}), 1.0, -5, 5, 2, 2, options, p=3.0)
    assert np.max(np.abs(good.x - bad.x)) > 1e-4


@pytest.mark.parametrize(
    ("name", "outputs"),
    [("grad_f", lambda x: [x]), ("jac_g", lambda x: [x[0], x]), ("hess_lag", lambda x: [x @ x.T])],
)
def test_wrong_signatures_are_named(name: str, outputs: Callable[[Any], list[Any]]) -> None:
    x = ca.MX.sym("x", 2)
    with pytest.raises(ValueError, match=name):
        quadratic_with_derivatives(**{name: ca.Function("wrong", [x, ca.MX.sym("p")], outputs(x))})


def test_hessian_must_be_upper_triangular() -> None:
    inputs = [ca.MX.sym("x", 2), ca.MX.sym("p"), ca.MX.sym("lam_f"), ca.MX.sym("lam_g")]
    with pytest.raises(ValueError, match="upper triangle"):
        quadratic_with_derivatives(hess_lag=ca.Function("full", inputs, [ca.DM.ones(2, 2)]))


def test_callback_sees_iterates_and_may_stop() -> None:
    seen: list[IterationInfo] = []

    def watch(info: IterationInfo) -> bool:
        seen.append(info)
        return info.iteration == 4

    nlp = problem(2, lambda x: (ca.sumsqr(x), ca.exp(x[0]) * x[1]))
    result = solve(nlp, [3, 5], lbg=1, ubg=1, callback=watch)
    assert result.status is Status.INTERRUPTED and not result.status.solved
    assert [info.iteration for info in seen] == [0, 1, 2, 3, 4]
    assert seen[-1].objective == pytest.approx(result.f)
    assert seen[-1].infeasibility == pytest.approx(abs(result.g[0] - 1))
    assert seen[0].infeasibility == pytest.approx(5 * np.exp(3) - 1)


def test_exception_in_the_callback_is_raised_after_the_solve(capfd: pytest.CaptureFixture[str]) -> None:
    def broken(info: IterationInfo) -> None:
        raise KeyError("my own mistake")

    with pytest.raises(KeyError, match="my own mistake"):
        solve(rosenbrock(5), -0.5, callback=broken)
    assert is_silent(capfd)


@pytest.mark.parametrize("solver", ["ipopt", "sqpmethod"])
def test_ctrl_c_keeps_the_iterate(solver: str, capfd: pytest.CaptureFixture[str]) -> None:
    def press(info: IterationInfo) -> None:
        if info.iteration == 5:
            os.kill(os.getpid(), signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    result = solve(rosenbrock(20), -0.5, -5, 5, options=SolverOptions(solver=solver), callback=press)
    assert result.status is Status.INTERRUPTED
    assert 5 <= result.iterations <= 7
    assert result.f < float(rosenbrock(20).lagrangian_function(np.full(20, -0.5), [], [])[0])
    assert signal.getsignal(signal.SIGINT) is before
    assert is_silent(capfd)


@pytest.mark.parametrize("solver", ["ipopt", "sqpmethod"])
def test_wall_time_limit(solver: str, capfd: pytest.CaptureFixture[str]) -> None:
    seen = []

    def dawdle(info: IterationInfo) -> None:
        seen.append(info)
        time.sleep(0.02)

    options = SolverOptions(solver=solver, max_wall_time=0.1)
    result = solve(rosenbrock(20), -0.5, -5, 5, options=options, callback=dawdle)
    assert result.status is Status.INTERRUPTED
    assert result.wall_time > 0.1
    assert len(seen) <= 6  # the fifth is over after 0.1 s at the earliest, and a sixth may be under way
    assert is_silent(capfd)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"solver": "ipotp"}, r"no solver 'ipotp': did you mean 'ipopt'\?"),
        ({"linear_solver": "mump"}, r"no linear_solver 'mump': did you mean 'mumps'\?"),
        ({"tolerance": -1e-9}, "tolerance is -1e-09: give a finite number > 0"),
        ({"tolerance": float("nan")}, "tolerance"),
        ({"max_iterations": -1}, "max_iterations is -1: give an integer >= 0"),
        ({"max_iterations": 10.0}, "max_iterations is 10.0: give an integer >= 0"),
        ({"max_wall_time": 0.0}, "max_wall_time"),
        ({"bound_relax": -1e-8}, "bound_relax"),
        ({"mu_init": 0.0}, "mu_init"),
        ({"extra": [1]}, "extra"),
    ],
)
def test_options_are_checked(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SolverOptions(**options)


@pytest.mark.parametrize("extra", [{"ipopt.max_iter": 2}, {"ipopt": {"max_iter": 2}}])
def test_extra_options_win(extra: dict[str, Any]) -> None:
    options = SolverOptions(extra=extra)
    assert solve(rosenbrock(20), -0.5, options=options).iterations == 2


def test_unknown_extra_option_is_named() -> None:
    with pytest.raises(ValueError, match="nonsense"):
        solve(rosenbrock(3), 0.0, options=SolverOptions(extra={"ipopt.nonsense": 1}))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x0": [0.0, 0.0]}, r"x0 must have shape \(3,\), got \(2,\)"),
        ({"lbx": [0, 2, 0], "ubx": 1.0}, r"x\[1\] admit no number: 2.0 to 1.0"),
        ({"ubx": np.nan}, r"x\[0\]"),
        ({"lbx": INF}, r"x\[0\]"),
        ({"p": [1.0]}, "p must have shape"),
    ],
)
def test_arguments_are_checked(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        solve(rosenbrock(3), **({"x0": 0.0} | change))
