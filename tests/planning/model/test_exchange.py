"""Models from CasADi's symbols and functions, and back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.models import one_phase

import gnc_opt as go

RNG = np.random.default_rng(7)
T, X, U, P = 0.3, RNG.normal(size=3), RNG.normal(size=1), np.array([0.7, 2.0])


def rate(t: float, x: Any, u: Any, p: Any) -> np.ndarray:
    """Of `expression`, in NumPy."""
    return np.array([x[1], x[2] * np.sin(t) + p[0] * u[0], -p[1] * x[0] * x[1]])


def expression(t: Any, x: Any, u: Any, p: Any) -> Any:
    return ca.vertcat(x[1], x[2] * ca.sin(t) + p[0] * u, -p[1] * x[0] * x[1])


def symbols(kind: Any) -> tuple[Any, ...]:
    return kind.sym("t"), kind.sym("x", 3), kind.sym("u"), kind.sym("p", 2)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_an_expression_becomes_a_model(kind: Any) -> None:
    t, x, u, p = symbols(kind)
    model = go.Model.from_casadi(
        "m", x, u, expression(t, x, u, p), t=t, p=p, values={"p": P}, units={"u": "N"}
    )
    assert model.states.names == ("x",) and model.states.size == 3
    assert model.controls["u"].unit == "N"
    np.testing.assert_allclose(model.f(T, X, U), rate(T, X, U, P), rtol=1e-14)
    np.testing.assert_allclose(model.with_parameters(p=2 * P).f(T, X, U), rate(T, X, U, 2 * P), rtol=1e-14)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_symbols_keep_their_names(kind: Any) -> None:
    r, v, m, a = kind.sym("r", 2), kind.sym("v", 2), kind.sym("m"), kind.sym("a", 2)
    f = ca.vertcat(v, a / m, -ca.sumsqr(a))
    for x in ([r, v, m], ca.vertcat(r, v, m), {"r": r, "v": v, "m": m}):
        model = go.Model.from_casadi("m", x, a, f)
        assert [(one.name, one.size) for one in model.states.variables] == [("r", 2), ("v", 2), ("m", 1)]
        np.testing.assert_allclose(model.f(0.0, [1, 2, 3, 4, 2.0], [6, 8]), [3, 4, 3, 4, -100], rtol=1e-14)


def test_a_mapping_gives_other_names() -> None:
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u")
    model = go.Model.from_casadi("cart", {"q": x[0], "v": x[1]}, {"a": u}, ca.vertcat(x[1], u))
    assert model.states.names == ("q", "v") and model.controls.names == ("a",)
    np.testing.assert_array_equal(model.f(0.0, [5.0, 2.0], 3.0), [2.0, 3.0])


def test_a_function_names_what_it_needs() -> None:
    x, u = ca.MX.sym("x", 2), ca.MX.sym("u")
    f = ca.Function("f", [u, x], [ca.vertcat(x[1], u)], ["u", "x"], ["rate"])  # in an order of its own
    model = go.Model.from_casadi("cart", {"q": 1, "v": 1}, {"a": 1}, f)
    np.testing.assert_array_equal(model.f(0.0, [5.0, 2.0], 3.0), [2.0, 3.0])


def test_rows_and_empty_inputs() -> None:
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u")
    without_p = ca.Function("f", [x, u, ca.SX()], [ca.vertcat(x[1], u)], ["x", "u", "p"], ["rate"])
    for f in ([x[1], u], without_p):
        model = go.Model.from_casadi("cart", x, u, f)
        np.testing.assert_array_equal(model.f(0.0, [5.0, 2.0], 3.0), [2.0, 3.0])


def test_there_and_back() -> None:
    model = go.Model("m")
    r, v = model.state("r", 2, unit="m"), model.state("v", 2)
    a, k = model.control("a", 2), model.parameter("k", [0.5, 2.0])
    model.ode({r: v, v: a - k * r * ca.cos(model.time)})
    model.output("energy", ca.sumsqr(v) / 2)
    model.output("r_squared", r * r)
    function = model.to_function()
    assert (function.name_in(), function.name_out()) == (["t", "x", "u", "p"], ["dx_dt", "y"])
    x, u = np.array([1.0, 2.0, 3.0, 4.0]), np.array([5.0, 6.0])
    np.testing.assert_allclose(function(0.0, x, u, model.parameter_values)[1].full()[:, 0], [12.5, 1.0, 4.0])

    def sizes(layout: Any) -> dict[str, int]:
        return {one.name: one.size for one in layout.variables}

    copy = go.Model.from_casadi(
        "copy",
        sizes(model.states),
        sizes(model.controls),
        function,
        p=sizes(model.parameters),
        values={"k": [0.5, 2.0]},
        units={"r": "m"},
    )
    assert copy.states.labels == model.states.labels and copy.states.units == model.states.units
    np.testing.assert_array_equal(copy.f(T, x, u), model.f(T, x, u))
    np.testing.assert_array_equal(copy.f(T, x, u, [3.0, 4.0]), model.f(T, x, u, [3.0, 4.0]))


def test_a_model_from_casadi_can_be_solved() -> None:
    q, v, a = ca.MX.sym("q"), ca.MX.sym("v"), ca.MX.sym("a")
    cart = go.Model.from_casadi("cart", [q, v], a, ca.vertcat(v, a))
    problem, leg = one_phase("least effort", cart, initial=0.0, final=1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    problem.minimize(leg.integral(cart.symbol("a") ** 2))
    assert go.solve(problem, mesh="1x6", tol=None).objective == pytest.approx(12.0, rel=1e-9)


def wrong(**changes: Any) -> Callable[[], go.Model]:
    x, u, k = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("k")
    given = {"name": "m", "x": x, "u": u, "f": ca.vertcat(x[1], u)} | changes
    if changes.get("f") == "free":
        given["f"] = ca.vertcat(x[1], k * u)
    if changes.get("f") == "short":
        given["f"] = x[1]
    return lambda: go.Model.from_casadi(**given)


SIZES: dict[str, Any] = {"x": {"q": 1, "v": 1}, "u": {"a": 1}}


def function(names: list[str], sizes: list[int], outputs: int = 1) -> Any:
    inputs = [ca.SX.sym(name, size) for name, size in zip(names, sizes, strict=True)]
    return ca.Function("f", inputs, [ca.SX.zeros(2)] * outputs, names, [f"o{i}" for i in range(outputs)])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (wrong(f="free"), "also uses k: name all"),
        (wrong(f="short"), r"has the shape \(1, 1\): the states require \(2, 1\)"),
        (wrong(f="nonsense"), "give an expression"),
        (wrong(x=ca.SX.sym("x", 2) * 2), "states of model 'm' are given as .* give columns"),
        (wrong(x=ca.MX.sym("x", 2, 2)), "give columns"),
        (wrong(u=3.0), "controls of model 'm' are given as 3.0"),
        (wrong(**SIZES), "give the symbols that it is written in"),
        (wrong(p=ca.SX.sym("k")), "parameter 'k' has no value"),
        (wrong(p=ca.SX.sym("k", 3), values={"k": [1.0, 2.0]}), "parameter 'k' is given 2 values"),
        (wrong(units={"y": "m"}), "'y'"),
        (wrong(values={"x": 1.0}), "'x'"),
        (
            wrong(**SIZES, f=function(["x", "w"], [2, 1])),
            "has the input 'w': name its inputs among t, x, u, p",
        ),
        (wrong(**SIZES, f=function(["x", "u"], [3, 1])), r"takes x of shape \(3, 1\)"),
        (wrong(**SIZES, f=function(["x", "u"], [2, 0])), r"takes u of shape \(0, 1\)"),
        (wrong(**SIZES, f=function(["x", "u"], [2, 1], 2)), "returns o0, o1"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(make: Callable[[], go.Model], message: str) -> None:
    with pytest.raises((go.ModelError, go.UnknownNameError), match=message) as refusal:
        make()
    assert "\n" not in str(refusal.value)


def test_a_root_inside_is_kept_with_its_derivative() -> None:
    """dz/dx of z^3 + z = x is 1 / (3 z^2 + 1)."""
    x, u, z = ca.MX.sym("x"), ca.MX.sym("u"), ca.MX.sym("z")
    root = ca.rootfinder("root", "newton", {"x": z, "p": x, "g": z**3 + z - x})
    model = go.Model.from_casadi("m", x, u, u - root(0.0, x))
    np.testing.assert_allclose(model.f(0.0, [10.0], [5.0]), [3.0], rtol=1e-12)
    np.testing.assert_allclose(model.linearize(0.0, [10.0], [5.0])[0], [[-1 / 13]], rtol=1e-9)
