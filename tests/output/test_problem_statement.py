"""The problem statement of a report: formulas that have the values of their expressions, and every number stated."""

import math
import re
from dataclasses import replace
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pytest
from testing.internals import (
    Formulas,
    format_docstring_as_html,
    format_problem_statement,
    typeset_component_names,
    typeset_names_in_html,
    typeset_variable_name,
)
from testing.models import one_phase

import gnc_opt as go

X, Y = ca.SX.sym("x"), ca.SX.sym("y")
NAMES = {"x": X, "y": Y}


def value(element, values):
    """The value of presentation MathML, read by the rules of arithmetic."""
    return eval(
        _python(element), {"__builtins__": {}}, {**vars(math), "arctan": math.atan, "ln": math.log, **values}
    )


def _python(element):
    children = list(element)
    if element.tag in ("mi", "mn"):
        return element.text
    if element.tag == "mtext":  # value if condition, else 0
        return element.text
    if element.tag == "mo":
        return {"\u2212": "-", "\u2062": "*", "|": "|", "·": "*", "¬": " not "}.get(
            element.text, element.text
        )
    if element.tag == "mfrac":
        return f"(({_python(children[0])})/({_python(children[1])}))"
    if element.tag == "msup":
        return f"(({_python(children[0])})**({_python(children[1])}))"
    if element.tag == "msqrt":
        return f"sqrt({''.join(map(_python, children))})"
    if element.tag == "msub":
        return "".join(_python(child) for child in children)
    parts = [_python(child) for child in children]
    if any(child.tag == "mtext" for child in children):
        parts.insert(len(parts) - (parts[0] == "("), " else 0")
    return "".join(parts)


EXPRESSIONS = [
    X - (Y - X), X - (X + Y) * 2 / (1 - Y), -X + (-Y), (X + Y) ** 2 - X**2, (-X) ** 2 * -3,
    Y + (-2.5) * X * (Y - 1), ca.sqrt(1 + X**2) / (X * Y), X / Y / (X - Y), X * (Y * (X - Y)),
    ca.sin(X + Y) * ca.exp(-X / Y) - ca.atan(X),
    (1 + X**2 + Y**2) ** 3 + (1 + X**2 + Y**2) * X - ca.cos(1 + X**2 + Y**2), 1e-7 * X + 3.25e12 * Y,
    X**1.5 - 1 / Y, (X / Y) ** 2 + (X**1.5) ** 2, X + (-2 * Y) * X - (X * Y) * (X * -Y),
    (X * ca.sin(Y) * X) * ca.exp(X * ca.sin(Y) * X * Y) - X * ca.sin(Y) * X,
    X - (Y < X) + 3 * (X < Y + 2) - (X + Y < 1), X + ca.if_else(Y < X, X * Y, 0) - ca.if_else(X < Y, X, 2 + Y),
    ca.if_else(Y < 1, X, 0), 2 * ca.if_else(Y < 1, X, 3),
]  # fmt: skip


@pytest.mark.parametrize("expression", EXPRESSIONS, ids=str)
def test_formulas_have_the_values_of_their_expressions(expression):
    writer = Formulas(typeset_component_names(NAMES))
    assert writer.are_formulas_short(expression)
    text = "".join(writer.split_formula_terms(expression))
    values = {"x": 1.7, "y": 0.6}
    for name, formula in writer.auxiliary:
        key = _python(ElementTree.fromstring(name))
        values[key] = value(ElementTree.fromstring(f"<math>{formula}</math>"), values)
    found = value(ElementTree.fromstring(f"<math>{text}</math>"), values)
    exact = float(ca.Function("f", [X, Y], [expression])(1.7, 0.6))
    assert found == pytest.approx(exact, rel=1e-9)


def test_the_base_of_a_power_is_in_parentheses_if_it_is_a_fraction_or_a_power():
    writer = Formulas(typeset_component_names(NAMES))
    for expression, base in (((X / Y) ** 2, "mfrac"), ((X**1.5) ** 2, "msup")):
        power = ElementTree.fromstring("".join(writer.split_formula_terms(expression)))
        assert power.tag == "msup"
        opened, inner, closed = power[0][0]
        assert (opened.text, inner.tag, closed.text) == ("(", base, ")")


def test_what_occurs_twice_is_written_once():
    root = ca.sqrt(1 + X**2 + Y**2)
    writer = Formulas(typeset_component_names(NAMES))
    pair = ca.vertcat(X / root, ca.sin(root) + root)
    assert writer.are_formulas_short(pair)
    texts = ["".join(writer.split_formula_terms(row)) for row in ca.vertsplit(pair)]
    assert len(writer.auxiliary) == 1 and not any("msqrt" in text for text in texts)


def test_products_are_written_as_in_a_textbook():
    """Signs between terms, squares of equal factors, no parentheses in products, parameters before states."""
    writer = Formulas(typeset_component_names(NAMES))
    text = "".join(writer.split_formula_terms(X + (-2 * Y) * (X * (Y * 3))))
    shown = re.sub(r"<[^>]*>|&#8290;", "", text)
    assert shown == "x−6xy2"


def test_parameters_have_their_usual_symbols():
    def rocket(gravity: str) -> str:
        model = go.Model("rocket")
        h, v, T = model.state("h"), model.state("v"), model.control("T")
        mass, g = model.parameter("mass", 2.0, unit="kg"), model.parameter(gravity, 9.8)
        model.ode({h: v, v: T / mass - g})
        problem, leg = one_phase("climb", model, 0.0, 1.0)
        problem.minimize(leg.final_state(h))
        return format_problem_statement(problem)

    shown = rocket("gravity")
    assert "<mi>m</mi>" in shown and "<td>mass</td><td><math><mi>m</mi></math></td>" in shown
    assert "<mi>g</mi>" in shown and "<mi>gravity</mi>" not in shown
    assert "<mi>mass</mi>" in rocket("m")  # whose symbol is taken


def test_long_dynamics_are_described_instead():
    long = X
    for i in range(500):
        long = ca.sin(long) + i * Y
    assert not Formulas(typeset_component_names(NAMES)).are_formulas_short(long)


def test_names_are_typeset_and_escaped():
    assert typeset_variable_name("omega[1]") == "<msub><mi>ω</mi><mtext>2</mtext></msub>"
    assert typeset_variable_name("inertia[0]") == "<msub><mi>inertia</mi><mtext>1</mtext></msub>"
    assert "<mtext>L,3</mtext>" in typeset_variable_name("r_L[2]")
    assert "<b>" not in typeset_variable_name("<b>")


def test_names_in_text_are_typeset_as_in_formulas():
    text = '<p id="r_L">phase a, r_L[2] and omega; a[0], a b, mass</p>'
    expected = '<p id="r_L">phase a, <i>r</i><sub>L,3</sub> and <i>ω</i>; <i>a</i><sub>1</sub>, a b, mass</p>'
    assert typeset_names_in_html(text, ["r_L", "omega", "a", "mass"]) == expected
    assert typeset_names_in_html("h-2 from -1.5 to 2", ["h"]) == "h-2 from −1.5 to 2"
    assert typeset_names_in_html("omega in kg m^2/s^-1", []) == "omega in kg m<sup>2</sup>/s<sup>-1</sup>"


def test_statement_shows_every_number_and_unit():
    model = go.Model("lander")
    r, v = model.state("r", 2, unit="m"), model.state("v", 2, unit="m/s")
    mass = model.state("mass", unit="kg")
    T = model.control("T", 2, unit="N")
    g = model.parameter("g", 3.71, unit="m/s^2")
    model.ode({r: v, v: T / mass - ca.vertcat(0, g), mass: -ca.sumsqr(T) / 1e6})
    problem, leg = one_phase("land <softly>", model, 0.0, (10.0, 90.0), name="descent")
    leg.initial(r=[150.0, 1200.0], v=[7.0, -30.0], mass=1900.0)
    leg.final(r=0.0, v=0.0)
    leg.bounds(T=([-9000.0] * 2, [9000.0] * 2), mass=(1505.0, None))
    leg.path("glide slope", r[1] - 0.25 * r[0], lower=-3.5)
    problem.constrain("range", leg.final_state("v")[0] ** 2, upper=17.0)
    problem.parameter("delay", lower=0.5, upper=2.25, unit="s")
    problem.maximize(leg.final_state("mass"))
    text = format_problem_statement(problem)
    plain = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", text))
    for shown in ("Objective: maximise", ", in kg.", "150, 1200", "7, -30", "1900", "-9000 to 9000", "at least 1505",
                  "10 to 90", "3.71", "m/s^2", "glide slope", "3.5", "range", "17", "0.5 to 2.25"):  # fmt: skip
        assert shown in plain, shown
    ElementTree.fromstring(f"<div>{text}</div>".replace("&#8290;", "\u2062"))
    assert format_problem_statement(go.solve(rest_to_rest(), mesh="4x3", tol=None).problem)


def rest_to_rest():
    """With a norm that is reformulated, a table and two phases linked."""
    model = go.Model("probe")
    r, v, a = model.state("r", 2), model.state("v", 2), model.control("a", 2)
    drag = go.table([0.0, 1.0, 2.0], [0.0, 0.1, 0.4], name="drag")
    model.ode({r: v, v: a * (1 - drag(0.5 + 0.1 * ca.tanh(v[0])))})
    problem = go.Problem("two phases")
    first, second = problem.phase("first", model), problem.phase("second", model)
    for leg in (first, second):
        leg.bounds(a=([-2.0, -2.0], [2.0, 2.0]))
    first.time(0.0, (0.5, 5.0))
    second.time((0.5, 5.0), (1.0, 9.0))
    first.initial(r=[1.0, 0.5], v=0.0)
    second.final(r=0.0, v=0.0)
    problem.link(first, second)
    problem.minimize(second.final_time + 0.1 * first.integral(ca.sumsqr(a)))
    return problem


def test_figure_of_motion_holds_vehicle_and_other_bodies():
    from gnc_opt.plot import View, plot_motion

    solution = go.solve(rest_to_rest(), mesh="4x3", tol=None)
    view = View(("r[0]", "r[1]"), bodies={"target": (0.0, 0.0, 0.5)})
    axes = plot_motion(solution, view).axes[0]
    path = np.array(axes.lines[0].get_data_3d())
    assert path[:, 0] == pytest.approx([1.0, 0.0, 0.5]) and path[:, -1] == pytest.approx(
        [0.0, 0.0, 0.0], abs=1e-6
    )
    low, high = axes.get_zlim()
    assert low < 0.0 and high > 0.5 and axes.get_xlabel() == r"$r_{\mathrm{1}}$"
    mirrored = plot_motion(solution, replace(view, down=True)).axes[0]
    assert (mirrored.get_ylim(), mirrored.get_zlim()) == (axes.get_ylim()[::-1], axes.get_zlim()[::-1])
    with pytest.raises(go.ArgumentError, match="position of 'target'"):
        View("r", bodies={"target": (0.0, 1.0)})


def minimum_time(factor: float, unit: str) -> go.Problem:
    """A unit distance at unit rate at most: one unit of time."""
    model = go.Model("drift")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("drift")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.1, 5.0))
    leg.initial(x=0.0)
    leg.final(x=1.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(factor * leg.final_time, unit=unit)
    return problem


def test_a_final_time_that_is_minimised_states_the_unit_of_time() -> None:
    solution = go.solve(minimum_time(1.0, "h"))
    assert "leg 0 to 1 h" in str(solution)
    places = " ".join(condition.where for condition in go.verify(solution).conditions)
    assert re.search(r"t = [\d.]+ h", places) and not re.search(r"\d s\b", places)


def test_a_multiple_of_a_time_states_its_unit() -> None:
    assert "leg 0 to 1 × 2 h" in str(go.solve(minimum_time(2.0, "h")))


def test_a_cost_without_a_unit_leaves_seconds() -> None:
    assert "leg 0 to 1 s" in str(go.solve(minimum_time(1.0, "")))


def test_large_motion_counts_kilometres_and_a_plane_is_seen_from_its_front() -> None:
    from gnc_opt.plot import View, plot_motion

    model = go.Model("far")
    x, y, u = model.state("x", unit="m"), model.state("y", unit="m"), model.control("u")
    model.ode({x: 1e6 * u, y: 1e5 * u})
    problem = go.Problem("far")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0, y=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.maximize(leg.final_state("x"))
    axes = plot_motion(go.solve(problem, mesh="1x3", tol=None), View(("x", "y"))).axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()) == ("$x$ (km)", "", "$y$ (km)")
    assert (axes.elev, axes.azim) == (0, -90)
    assert axes.xaxis.get_major_formatter()(500_000.0, 0) == "500"


def test_linked_phases_are_one_row_each() -> None:
    """States that are equal, and those that change, instead of a constraint for each component."""
    problem = go.Problem("stages")
    legs = []
    for name in ("boost", "coast"):
        model = go.Model("rocket")
        r, m, u = model.state("r", 2, unit="m"), model.state("m", unit="kg"), model.control("u", 2)
        model.ode({r: u, m: -1.0})
        legs.append(problem.phase(name, model))
    legs[0].time(0.0, 1.0)
    legs[1].time(None, 2.0)
    problem.link(*legs, jump={"m": -5.0})
    problem.minimize(-legs[1].final_state("m"))
    text = format_problem_statement(problem)
    assert "<td>boost</td><td>coast</td><td>r, time</td><td>m: -5 kg</td>" in text
    assert "link_" not in text


def test_formulas_of_a_docstring_and_vector_equations_come_first():
    pytest.importorskip("latex2mathml")
    shown = format_docstring_as_html(
        "Cart.\n\n.. math::\n   \\dot r &= v \\\\\n   \\dot v &= u\n\nOf :math:`u < 1`."
    )
    page = ElementTree.fromstring(f"<page>{re.sub(' xmlns=[^ >]*', '', shown)}</page>")
    assert [part.tag for part in page] == ["p", "div", "p"] and len(page.findall(".//mtr")) == 2
    model = go.Model("point mass")
    r, v, u = model.state("r", 3), model.state("v", 3), model.control("u", 3)
    model.ode({r: v, v: u - r})
    problem, leg = one_phase("transfer", model, 0.0, 1.0)
    problem.minimize(leg.integral(ca.sumsqr(u)))
    text = re.sub(r"<[^>]*>|&#8290;|\s", "", format_problem_statement(problem))
    assert "r˙=v" in text and "v˙1=u1−r1" in text and "r˙1" not in text
