"""Mistakes in a model: each is refused at the wrong line, by name, with a remedy."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.wrong_arguments import cart, refused, ship

import gnc_opt as go


def test_model_mistakes() -> None:
    with refused(go.ArgumentError, "name of a model", "Model"):
        go.Model(cart())

    model = go.Model("cart")
    q, v = model.state("q"), model.state("v")
    model.ode({q: v})
    with refused(go.ModelError, "model 'cart'", "state 'v'", "add it to ode()"):
        go.Problem("p").phase("leg", model)

    model = go.Model("cart")
    model.state("q"), model.state("v")
    with refused(go.ModelError, "states 'q', 'v'", "add them to ode()"):
        go.Problem("p").phase("leg", model)
    with refused(go.ModelError, "model 'empty' has no states", "state()"):
        go.Problem("p").phase("leg", go.Model("empty"))

    model = go.Model("cart")
    q, v = model.state("q"), model.state("v")
    model.ode({q: v})
    with refused(go.ModelError, "dynamics of state 'q' twice", "keep one"):
        model.ode({"q": 2 * v, v: 0.0})

    model = go.Model("cart")
    q, a = model.state("q"), model.control("a")
    with refused(go.ModelError, "'a' is a control", "states only"):
        model.ode({q: a, a: 0.0})

    model = go.Model("cart")
    model.parameter("mass", 1.0)
    with refused(go.ModelError, "'mass' is a parameter", "states only"):
        model.ode({"mass": 0.0})

    other, model = cart(), go.Model("boat")
    model.state("q")  # the same name does not make it the same symbol
    with refused(go.ModelError, "model 'boat'", "'q' is a symbol of another model"):
        model.ode({other.symbol("q"): 1.0})

    model = go.Model("ship")
    r = model.state("r", 3)
    with refused(go.ModelError, "got the key r_0", "state()"):
        model.ode({r[0]: 1.0})

    model = go.Model("cart")
    model.state("q"), model.state("v")
    with refused(go.UnknownNameError, "model 'cart' has no state 'vel'", "known: q, v"):
        model.ode({"vel": 1.0})

    model = go.Model("cart")
    v = model.state("v")
    with refused(go.ArgumentError, "ode() of model 'cart'", "ode({q: v, v: a})"):
        model.ode([v])

    model = go.Model("ship")
    r = model.state("r", 3)
    with refused(go.ModelError, "state 'r'", "model 'ship'", "2 components: give 3"):
        model.ode({r: [0.0, 1.0]})

    other, model = cart(), go.Model("boat")
    q = model.state("q")
    with refused(go.ModelError, "state 'q'", "model 'boat'", "uses 'v'", "not a symbol of this model"):
        model.ode({q: other.symbol("v")})

    other, model = cart(), go.Model("boat")
    v = model.state("v")
    with refused(go.ModelError, "uses 'v'", "another model's", "write model.symbol('v')"):
        model.ode({v: other.symbol("v")})

    model = go.Model("cart")
    q, v = model.state("q"), model.state("v")
    with refused(go.ModelError, "state 'q'", "'vv'", "did you mean 'v'?"):
        model.ode({q: ca.SX.sym("vv"), v: 0.0})

    model = go.Model("cart")
    q = model.state("q")
    with refused(go.ModelError, "state 'q'", "'fast'", "neither a number nor a CasADi SX expression"):
        model.ode({q: "fast"})

    model = go.Model("cart")
    q = model.state("q")
    with refused(go.ModelError, "MX", "neither a number nor a CasADi SX expression"):
        model.ode({q: ca.MX.sym("v")})

    model = go.Model("cart")
    model.state("q")
    with refused(go.ModelError, "model 'cart' declares 'q' twice", "rename"):
        model.control("q")

    model = go.Model("cart")
    v = model.state("v")
    with refused(go.ModelError, "model 'cart' declares 'v' twice", "rename"):
        model.output("v", 2 * v)
    with refused(go.ModelError, "size of state 'r'", "model 'ship'", "is 0", "integer >= 1"):
        go.Model("ship").state("r", 0)
    with refused(go.ModelError, "size of control 'F'", "2.5", "integer >= 1"):
        go.Model("ship").control("F", 2.5)
    with refused(go.ModelError, "nominal value of state 'r'", "positive finite numbers"):
        go.Model("ship").state("r", 3, nominal=[1.0, 0.0, 1.0])
    with refused(go.ModelError, "nominal value of state 'r'", "2 values", "give 3 values"):
        go.Model("ship").state("r", 3, nominal=[1.0, 2.0])
    with refused(go.ArgumentError, "unit of state 'q'", 'unit="m/s"'):
        go.Model("cart").state("q", unit=1)
    with refused(go.ModelError, "parameter 'mass' of model 'ship'", "'heavy'", "not a number"):
        go.Model("ship").parameter("mass", "heavy")
    with refused(go.UnknownNameError, "model 'ship' has no parameter 'mas'", "did you mean 'mass'?"):
        ship().with_parameters(mas=3.0)
    with refused(go.ModelError, "parameter 'mass'", "3 values", "one value"):
        ship().with_parameters(mass=[1.0, 2.0, 3.0])

    model = cart()
    go.Problem("p").phase("leg", model)
    with refused(go.ModelError, "model 'cart' is already used by problem 'p'", "control()"):
        model.control("b")

    model = cart()
    go.Problem("p").phase("leg", model)
    with refused(go.ModelError, "already used", "ode()"):
        model.ode({"q": 0.0})
    with refused(go.UnknownNameError, "model 'cart' has no variable 'x'", "known: q, v, a"):
        cart().symbol("x")
    with refused(go.UnknownNameError, "model 'cart' has no output 'speed'", "none is declared"):
        cart().output_expression("speed")
    with refused(go.ArgumentError, "x of f()", "(3,)", "give (2,)"):
        cart().f(0.0, [1.0, 2.0, 3.0], [0.0])

    model = cart()
    with refused(go.ArgumentError, "u of f()", "numbers are needed"):
        model.f(0.0, [1.0, 2.0], model.symbol("a"))
    with refused(go.ArgumentError, "x of f()", "(2, 3)", "5 times"):
        cart().f(np.arange(5.0), np.zeros((2, 3)), [0.0])
    with refused(go.ArgumentError, "u of AB()", "give (1,)"):
        cart().linearize(0.0, [1.0, 2.0], [0.0, 0.0])


@pytest.mark.parametrize("name", ["2q", "q dot", "", "q[0]"])
def test_names_that_are_no_identifiers(name: str) -> None:
    model = go.Model("cart")
    for declare in (
        model.state,
        model.control,
        lambda n: model.parameter(n, 1.0),
        lambda n: model.output(n, 0.0),
    ):
        with pytest.raises(
            go.ModelError, match=r"cannot be the name of a variable of model 'cart': use letters"
        ):
            declare(name)


@pytest.mark.parametrize("name", ["lambda", "time", "class"])
def test_reserved_words_as_names(name: str) -> None:
    with pytest.raises(go.ModelError, match=f"'{name}' is a reserved word .* write '{name}_'"):
        go.Model("cart").state(name)  # initial(lambda=0) would be a syntax error, guess(time=...) ambiguous


@pytest.mark.parametrize("value", [np.nan, np.inf, [1.0, np.nan], []])
def test_parameter_that_is_not_finite(value: object) -> None:
    with pytest.raises(go.ModelError, match=r"parameter 'mass' of model 'ship' is .*: give finite numbers"):
        go.Model("ship").parameter("mass", value)
