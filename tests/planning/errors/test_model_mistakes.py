"""Mistakes in a model: each is refused at the wrong line, by name, with a remedy."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.wrong_arguments import cart, mistake, ship

import gnc_opt as go


@mistake(go.ArgumentError, "name of a model", "Model")
def test_model_without_a_name() -> None:
    go.Model(cart())  # type: ignore[arg-type]  # wrong


@mistake(go.ModelError, "model 'cart'", "state 'v'", "add it to ode()")
def test_missing_dynamics() -> None:
    model = go.Model("cart")
    q, v = model.state("q"), model.state("v")
    model.ode({q: v})
    go.Problem("p").phase("leg", model)  # wrong


@mistake(go.ModelError, "states 'q', 'v'", "add them to ode()")
def test_missing_dynamics_of_several_states() -> None:
    model = go.Model("cart")
    model.state("q"), model.state("v")
    go.Problem("p").phase("leg", model)  # wrong


@mistake(go.ModelError, "model 'empty' has no states", "state()")
def test_model_without_states() -> None:
    go.Problem("p").phase("leg", go.Model("empty"))  # wrong


@mistake(go.ModelError, "dynamics of state 'q' twice", "keep one")
def test_duplicate_dynamics() -> None:
    model = go.Model("cart")
    q, v = model.state("q"), model.state("v")
    model.ode({q: v})
    model.ode({"q": 2 * v, v: 0.0})  # wrong


@mistake(go.ModelError, "'a' is a control", "states only")
def test_dynamics_for_a_control() -> None:
    model = go.Model("cart")
    q, a = model.state("q"), model.control("a")
    model.ode({q: a, a: 0.0})  # wrong


@mistake(go.ModelError, "'mass' is a parameter", "states only")
def test_dynamics_for_a_parameter_by_name() -> None:
    model = go.Model("cart")
    model.parameter("mass", 1.0)
    model.ode({"mass": 0.0})  # wrong


@mistake(go.ModelError, "model 'boat'", "'q' is a symbol of another model")
def test_dynamics_for_a_state_of_another_model() -> None:
    other, model = cart(), go.Model("boat")
    model.state("q")  # the same name does not make it the same symbol
    model.ode({other.symbol("q"): 1.0})  # wrong


@mistake(go.ModelError, "got the key r_0", "state()")
def test_dynamics_for_one_component() -> None:
    model = go.Model("ship")
    r = model.state("r", 3)
    model.ode({r[0]: 1.0})  # wrong


@mistake(go.UnknownNameError, "model 'cart' has no state 'vel'", "known: q, v")
def test_dynamics_for_an_unknown_name() -> None:
    model = go.Model("cart")
    model.state("q"), model.state("v")
    model.ode({"vel": 1.0})  # wrong


@mistake(go.ArgumentError, "ode() of model 'cart'", "ode({q: v, v: a})")
def test_dynamics_as_a_list() -> None:
    model = go.Model("cart")
    v = model.state("v")
    model.ode([v])  # type: ignore[arg-type]  # wrong


@mistake(go.ModelError, "state 'r'", "model 'ship'", "2 components: give 3")
def test_dynamics_of_the_wrong_size() -> None:
    model = go.Model("ship")
    r = model.state("r", 3)
    model.ode({r: [0.0, 1.0]})  # wrong


@mistake(go.ModelError, "state 'q'", "model 'boat'", "uses 'v'", "not a symbol of this model")
def test_dynamics_with_a_symbol_of_another_model() -> None:
    other, model = cart(), go.Model("boat")
    q = model.state("q")
    model.ode({q: other.symbol("v")})  # wrong


@mistake(go.ModelError, "uses 'v'", "another model's", "write model.symbol('v')")
def test_dynamics_with_the_namesake_in_another_model() -> None:
    other, model = cart(), go.Model("boat")
    v = model.state("v")
    model.ode({v: other.symbol("v")})  # wrong


@mistake(go.ModelError, "state 'q'", "'vv'", "did you mean 'v'?")
def test_dynamics_with_a_symbol_of_ones_own_making() -> None:
    model = go.Model("cart")
    q, v = model.state("q"), model.state("v")
    model.ode({q: ca.SX.sym("vv"), v: 0.0})  # wrong


@mistake(go.ModelError, "state 'q'", "'fast'", "neither a number nor a CasADi SX expression")
def test_dynamics_as_text() -> None:
    model = go.Model("cart")
    q = model.state("q")
    model.ode({q: "fast"})  # wrong


@mistake(go.ModelError, "MX", "neither a number nor a CasADi SX expression")
def test_dynamics_with_the_other_kind_of_casadi_symbol() -> None:
    model = go.Model("cart")
    q = model.state("q")
    model.ode({q: ca.MX.sym("v")})  # wrong


@mistake(go.ModelError, "model 'cart' declares 'q' twice", "rename")
def test_duplicate_state() -> None:
    model = go.Model("cart")
    model.state("q")
    model.control("q")  # wrong


@mistake(go.ModelError, "model 'cart' declares 'v' twice", "rename")
def test_output_named_like_a_state() -> None:
    model = go.Model("cart")
    v = model.state("v")
    model.output("v", 2 * v)  # wrong


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


@mistake(go.ModelError, "size of state 'r'", "model 'ship'", "is 0", "integer >= 1")
def test_state_without_components() -> None:
    go.Model("ship").state("r", 0)  # wrong


@mistake(go.ModelError, "size of control 'F'", "2.5", "integer >= 1")
def test_broken_number_of_components() -> None:
    go.Model("ship").control("F", 2.5)  # type: ignore[arg-type]  # wrong


@mistake(go.ModelError, "nominal value of state 'r'", "positive finite numbers")
def test_nominal_value_zero() -> None:
    go.Model("ship").state("r", 3, nominal=[1.0, 0.0, 1.0])  # wrong


@mistake(go.ModelError, "nominal value of state 'r'", "2 values", "give 3 values")
def test_nominal_value_of_the_wrong_size() -> None:
    go.Model("ship").state("r", 3, nominal=[1.0, 2.0])  # wrong


@mistake(go.ArgumentError, "unit of state 'q'", 'unit="m/s"')
def test_number_as_unit() -> None:
    go.Model("cart").state("q", unit=1)  # type: ignore[arg-type]  # wrong


@mistake(go.ModelError, "parameter 'mass' of model 'ship'", "'heavy'", "not a number")
def test_parameter_as_text() -> None:
    go.Model("ship").parameter("mass", "heavy")  # wrong


@pytest.mark.parametrize("value", [np.nan, np.inf, [1.0, np.nan], []])
def test_parameter_that_is_not_finite(value: object) -> None:
    with pytest.raises(go.ModelError, match=r"parameter 'mass' of model 'ship' is .*: give finite numbers"):
        go.Model("ship").parameter("mass", value)


@mistake(go.UnknownNameError, "model 'ship' has no parameter 'mas'", "did you mean 'mass'?")
def test_misspelt_parameter_of_a_model() -> None:
    ship().with_parameters(mas=3.0)  # wrong


@mistake(go.ModelError, "parameter 'mass'", "3 values", "one value")
def test_parameter_of_the_wrong_size() -> None:
    ship().with_parameters(mass=[1.0, 2.0, 3.0])  # wrong


@mistake(go.ModelError, "model 'cart' is already used by problem 'p'", "control()")
def test_model_changed_after_use() -> None:
    model = cart()
    go.Problem("p").phase("leg", model)
    model.control("b")  # wrong


@mistake(go.ModelError, "already used", "ode()")
def test_dynamics_changed_after_use() -> None:
    model = cart()
    go.Problem("p").phase("leg", model)
    model.ode({"q": 0.0})  # wrong


@mistake(go.UnknownNameError, "model 'cart' has no variable 'x'", "known: q, v, a")
def test_unknown_symbol() -> None:
    cart().symbol("x")  # wrong


@mistake(go.UnknownNameError, "model 'cart' has no output 'speed'", "none is declared")
def test_unknown_output() -> None:
    cart().output_expression("speed")  # wrong


@mistake(go.ArgumentError, "x of f()", "(3,)", "give (2,)")
def test_numeric_call_with_a_state_of_the_wrong_size() -> None:
    cart().f(0.0, [1.0, 2.0, 3.0], [0.0])  # wrong


@mistake(go.ArgumentError, "u of f()", "numbers are needed")
def test_numeric_call_with_a_symbol() -> None:
    model = cart()
    model.f(0.0, [1.0, 2.0], model.symbol("a"))  # wrong


@mistake(go.ArgumentError, "x of f()", "(2, 3)", "5 times")
def test_numeric_call_with_another_number_of_times() -> None:
    cart().f(np.arange(5.0), np.zeros((2, 3)), [0.0])  # wrong


@mistake(go.ArgumentError, "u of AB()", "give (1,)")
def test_linearisation_with_a_control_of_the_wrong_size() -> None:
    cart().linearize(0.0, [1.0, 2.0], [0.0, 0.0])  # wrong
