"""What has no derivatives or no number is told when it is written; controls whose size costs are split."""

import math
import warnings
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.models import one_phase

import gnc_opt as go


def cart(rate: Callable[[Any, Any, Any], Any], path: Callable[[Any], Any] | None = None) -> go.Problem:
    model = go.Model("cart")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u + rate(model.time, x, u)})
    problem, leg = one_phase("cart", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    if path is not None:
        leg.path("limit", path(x), upper=5.0)
    problem.minimize(leg.integral(u**2))
    return problem


@pytest.mark.parametrize(
    "rate, message",
    [
        (lambda t, x, u: -ca.fabs(x), "rate of state 'x' .* contains fabs, which has a kink: use smooth_abs"),
        (lambda t, x, u: ca.sign(u), "contains sign, which jumps: use tanh"),
        (
            lambda t, x, u: ca.if_else(t > 0.5, 1.0, 0.0),
            "a comparison .*, which switches: let a phase end there",
        ),
        (lambda t, x, u: ca.floor(x), "floor .*, which jumps"),
        (lambda t, x, u: x % 1.0, "floor .*, which jumps"),
        (lambda t, x, u: ca.fmax(x, u), "fmax, which has a kink: use smooth_abs.* bounds.* split_control"),
    ],
)
def test_kinks_and_jumps_are_reported_once(rate: Any, message: str) -> None:
    problem = cart(rate)
    with pytest.warns(go.ProblemWarning, match=message) as found:
        problem.check()
        problem.check()
    assert len(found) == 1


def test_the_place_of_a_kink() -> None:
    with pytest.warns(go.ProblemWarning, match="path constraint 'limit' of phase 'leg'"):
        cart(lambda t, x, u: 0.0, lambda x: -ca.fabs(x)).check()


def test_kinks_of_what_does_not_change_are_not_reported() -> None:
    model = go.Model("cart")
    x, u, k = model.state("x"), model.control("u"), model.parameter("k", -2.0)
    model.ode({x: u - ca.fabs(k) * x})
    problem, leg = one_phase("cart", model, 0.0, 1.0)
    leg.initial(x=1.0)
    problem.minimize(leg.integral(u**2 + x**2))
    with warnings.catch_warnings():
        warnings.simplefilter("error", go.ProblemWarning)
        problem.check()
    problem.parameter("k", lower=-3.0, upper=-1.0)  # now it does
    with pytest.warns(go.ProblemWarning, match="fabs"):
        problem.check()


def test_functions_of_math_on_symbols() -> None:
    model = go.Model("pendulum")
    angle = model.state("angle")
    with pytest.raises(go.ModelError, match=r"'angle' is a symbol .* or ca.sin\(angle\)"):
        math.sin(angle)
    with pytest.raises(go.ModelError, match=r"write ca.sqrt\(angle\)"):
        math.sqrt(angle)
    with pytest.raises(go.ModelError, match=r"time derivative of state 'angle' .* contains nan"):
        model.ode({angle: math.cos(2 * angle)})  # the product is an expression without a name
    with pytest.raises(go.ProblemError, match=r"path constraint 'limit' .* contains nan"):
        cart(lambda t, x, u: 0.0, lambda x: x + math.exp(x - 1))


def test_functions_of_numpy_on_symbols() -> None:
    """CasADi answers for its own type only, and went round in circles with ours."""
    model = go.Model("point")
    v = model.state("v", 3)
    made = ca.vertcat(
        np.linalg.norm(v), np.max(v), np.clip(v, -1.0, 2.0), np.interp(v[0], [0.0, 4.0], [0.0, 1.0])
    )
    made = ca.vertcat(made, np.interp(v, [0.0, 4.0], [0.0, 1.0])[0])
    found = ca.Function("made", [v], [made])([1.0, -2.0, 3.0]).full().ravel()
    assert found == pytest.approx([math.sqrt(14.0), 3.0, 1.0, -1.0, 2.0, 0.25, 0.25], abs=1e-15)


def test_smooth_absolute_value() -> None:
    x = ca.SX.sym("x")
    value = go.smooth_abs(x, 0.1)
    function = ca.Function("f", [x], [value, ca.hessian(value, x)[0]])
    assert float(function(0.0)[0]) == 0.0 and float(function(0.0)[1]) == pytest.approx(10.0)
    assert go.smooth_abs(-3.0, 0.4) == pytest.approx(math.sqrt(9.16) - 0.4)
    for bad in (0.0, -1.0, math.nan, "wide"):
        with pytest.raises(go.ArgumentError, match="the width of smooth_abs"):
            go.smooth_abs(x, bad)  # type: ignore[arg-type]


def fuel(limit: Any) -> go.Problem:
    """Rest to rest, 1 m in 3 s, least impulse."""
    model = go.Model("cart")
    x, v = model.state("x"), model.state("v")
    a, size = model.split_control("a", unit="m/s^2")
    model.ode({x: v, v: a})
    problem, leg = one_phase("fuel", model, 0.0, 3.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    leg.bounds(a=limit)
    problem.minimize(leg.integral(size))
    return problem


def test_fuel_of_a_split_control_is_the_closed_form() -> None:
    """Bang-off-bang within -1 to 1: 3 - sqrt(5) m/s."""
    solution = go.solve(fuel((-1.0, 1.0)), tol=1e-8)
    assert solution.objective == pytest.approx(3 - math.sqrt(5), abs=1e-9)
    assert [float(solution.evaluate("a", t)) for t in (0.1, 1.5, 2.9)] == pytest.approx([1, 0, -1], abs=1e-6)
    assert go.verify(solution).ok


def test_bounds_of_a_split_control_are_those_of_its_parts() -> None:
    box = fuel((-0.5, 2.0)).phases["leg"].numbers.controls
    np.testing.assert_array_equal([box.lower, box.upper], [[0.0, 0.0], [2.0, 0.5]])
    box = fuel(None).phases["leg"].numbers.controls
    np.testing.assert_array_equal([box.lower, box.upper], [[0.0, 0.0], [np.inf, np.inf]])
    with pytest.raises(go.ProblemError, match=r"bounds of 'a' in phase 'leg' .* exclude zero"):
        fuel((0.5, 1.0))


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_row_is_read_as_a_column(n: int) -> None:
    model = go.Model("rows")
    x = model.state("x", n)
    model.ode({x: ca.horzcat(*(-(i + 1) * x[i] for i in range(n)))})
    rates = ca.Function("rates", [x], [model.state_derivative()])(np.ones(n))
    np.testing.assert_array_equal(rates.full(), -np.arange(1.0, n + 1)[:, None])
