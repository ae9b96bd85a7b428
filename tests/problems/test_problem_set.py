"""Problems in JSON: reading expressions, building through the public API, solving, comparing."""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np
import pytest

import gnc_opt as go
from benchmarks.validation.problem_set import solve as problem_set
from benchmarks.validation.problem_set.reader import evaluate, read_constants

Document = dict[str, Any]


def state(name: str, x0: Any, xf: Any = None, lb: Any = None, ub: Any = None, **more: Any) -> Document:
    return {"name": name, "x0": x0, "xf": xf, "lb": lb, "ub": ub, **more}


def control(name: str, lb: Any = None, ub: Any = None, **more: Any) -> Document:
    return {"name": name, "lb": lb, "ub": ub, **more}


def phase(
    t0: Any, tf: Any, states: list[Document], controls: list[Document], ode: Document, **more: Any
) -> Document:
    return {"t0": t0, "tf": tf, "tguess": None, "states": states, "controls": controls, "ode": ode, **more}


def document(name: str, objective: str, *phases: Document, **more: Any) -> Document:
    return {"name": name, "sense": "min", "phases": list(phases), "objective": objective, **more}


FORMULAS = [
    "x**2-3*x/(1+x)",
    "-x+ +2",
    "2**-x",
    "1.5e-3*x",
    "sin(x)+cos(x)*tan(x)",
    "exp(-x)*log(x)+sqrt(x)",
    "asin(x/3)+acos(x/3)+atan(x)",
    "atan2(x,-2)",
    "sinh(x)-cosh(x)/tanh(x)",
    "abs(x-5)+pi",
    "min(x,2,1)+max(x,0.5)",
    "1 if x<=1 else 2",
    "x if x>2 else (3*x if x>=1 else 0)",
]


@pytest.mark.parametrize("formula", FORMULAS)
@pytest.mark.parametrize("x", [0.7, 1.0, 1.9])
def test_expressions_mean_what_python_means(formula: str, x: float) -> None:
    names = {name: getattr(math, name) for name in dir(math)}
    wanted = eval(formula, {"abs": abs, "min": min, "max": max, **names, "x": x})
    assert evaluate(formula, {"x": x}, "it") == pytest.approx(wanted, rel=1e-15)
    if " if " in formula:  # of numbers only
        return
    symbol = ca.SX.sym("x")
    function = ca.Function("f", [symbol], [evaluate(formula, {"x": symbol}, "it")])
    assert float(function(x)) == pytest.approx(wanted, rel=1e-14)


DI = {"x": "v", "v": "u"}

CLOSED_FORM: list[Document] = [
    document(
        "lq_scalar",
        "J_1",
        phase(0, 1, [state("x", 1)], [control("u")], {"x": "u"}, integrals={"J": "0.5*(x**2+u**2)"}),
        ref_expr="0.5*tanh(1)",
        dJ_dx0={"x": "tanh(1)"},
        closed={"x": "cosh(1-t)/cosh(1)", "u": "-sinh(1-t)/cosh(1)", "lam_x": "sinh(1-t)/cosh(1)"},
    ),
    document(
        "di_min_energy",
        "J_1",
        phase(0, 1, [state("x", 0, 1), state("v", 0, 0)], [control("u")], DI, integrals={"J": "u**2/2"}),
        ref_expr="6",
        dJ_dx0={"x": "-12", "v": "-6"},
        closed={"x": "3*t**2-2*t**3", "u": "6-12*t", "lam_x": "-12", "lam_v": "12*t-6"},
    ),
    document(
        "periodic_lq",
        "J_1",
        phase(
            0,
            "2*pi",
            [state("x", None)],
            [control("u")],
            {"x": "-x+u+sin(t)"},
            integrals={"J": "0.5*(x**2+u**2)"},
        ),
        events=[{"expr": "x_f1-x_i1", "lb": 0, "ub": 0}],
        ref_expr="pi/6",
        closed={"x": "(sin(t)-cos(t))/3", "u": "-sin(t)/3", "lam_x": "sin(t)/3"},
    ),
    document(
        "isoperimetric",
        "J_1",
        phase(0, 1, [state("x", 0, 0)], [control("u")], {"x": "u"}, integrals={"J": "0.5*u**2", "A": "x"}),
        events=[{"expr": "A_1", "lb": 1, "ub": 1}],
        ref_expr="6",
        dJ_dx0={"x": "-6"},
        closed={"x": "6*t*(1-t)", "u": "6-12*t", "lam_x": "12*t-6"},
    ),
    document(
        "free_initial_time",
        "J_1",
        phase(
            [-3, 0.9],
            1,
            [state("x", 0, 1)],
            [control("u")],
            {"x": "u"},
            tguess=[-1, 1],
            integrals={"J": "0.5*u**2+2"},
        ),
        ref_expr="2",
        dJ_dx0={"x": "-2"},
        closed={"x": "2*(t-0.5)", "u": "2", "lam_x": "-2"},
    ),
    document(
        "interior_point",
        "J_1+J_2",
        phase(0, 0.75, [state("x", 1, 0.9)], [control("u", -1, 1)], {"x": "u"}, integrals={"J": "x**2+u**2"}),
        phase(
            0.75,
            1,
            [state("x", None, 0.75, guess=[0.9, 0.75])],
            [control("u", -1, 1)],
            {"x": "u"},
            integrals={"J": "x**2+u**2"},
        ),
        events=[{"expr": "x_f1-x_i2", "lb": 0, "ub": 0}],
        ref_expr="(1.81*cosh(0.75)-1.8)/sinh(0.75)+((0.9**2+0.75**2)*cosh(0.25)-2*0.9*0.75)/sinh(0.25)",
        dJ_dx0={"x": "2*(cosh(0.75)-0.9)/sinh(0.75)"},
        closed={"x": "(sinh(0.75-t)+0.9*sinh(t))/sinh(0.75)", "u": "(0.9*cosh(t)-cosh(0.75-t))/sinh(0.75)"},
    ),
    document(
        "cake_eating",
        "W_1",
        phase(
            0,
            10,
            [state("k", 1, 0, 0, 10)],
            [control("c", 0.001, 10, guess=0.15)],
            {"k": "0.1*k-c"},
            integrals={"W": "exp(-0.05*t)*log(c)"},
        ),
        sense="max",
        constants={"c0": "0.05/(1-exp(-0.5))"},
        ref_expr="log(c0)/c0+0.05*(1-1.5*exp(-0.5))/0.05**2",
        dJ_dx0={"k": "1/c0"},
        closed={"c": "c0*exp(0.05*t)", "lam_k": "exp(-0.1*t)/c0"},
    ),
    document(
        "free_parameter",  # x(1) = 2 by a bought drift k and a control u: k + u = 2, cost k^2 + u^2
        "k**2+J_1",
        phase(0, 1, [state("x", 0, 2)], [control("u")], {"x": "k+u"}, integrals={"J": "u**2"}),
        parameters=[{"name": "k", "lb": -5, "ub": 5, "guess": -2}],
        ref_expr="2",
        dJ_dx0={"x": "-2"},
        closed={"x": "2*t", "u": "1", "lam_x": "-2"},
    ),
    document(
        "di_time_asym",
        "t_f1",
        phase(0, [1, 100], [state("x", 0, 300), state("v", 0, 0)], [control("u", -2, 1)], DI, tguess=[0, 20]),
        ref_expr="30",
        dJ_dx0={"x": "-1/20", "v": "-1"},
        closed={"x": "0.5*t**2 if t<=20 else 300-(30-t)**2", "v": "t if t<=20 else 2*(30-t)"},
        accept_rel_tol=1e-3,
        tolerance=5e-3,  # a bang-bang problem on a mesh with no node on its switch: tests the piecewise forms
    ),
]


def with_numbers(problem: Document) -> Document:
    """Put numbers where the documents above have formulas."""
    names = read_constants(problem)
    numbers = {"reference": evaluate(problem["ref_expr"], names, "the reference")}
    if "dJ_dx0" in problem:
        numbers["dJ_dx0"] = {k: evaluate(v, names, "dJ_dx0") for k, v in problem["dJ_dx0"].items()}
    return {"accept_rel_tol": 1e-9, **problem, **numbers}


@pytest.mark.parametrize("problem", CLOSED_FORM, ids=lambda p: p["name"])
def test_closed_forms_from_the_straight_line_guess(problem: Document) -> None:
    """Objective, costates at the start, and all closed forms along the first phase, with default settings."""
    full = with_numbers(problem)
    outcome, solution = problem_set.run(full)
    assert outcome.passed, outcome
    assert solution is not None
    smooth = "tolerance" not in problem
    assert outcome.verdict_ok
    # 1e-6: costates converge half as fast as the objective, which is right to 1e-9 here.
    tolerance = 1e-6 if smooth else problem["tolerance"]
    leg, constants = solution.phase("phase_1"), read_constants(problem)
    sign = -1.0 if solution.maximised else 1.0
    for name, expression in problem["closed"].items():
        wanted, found = [], []
        for t in np.linspace(leg.initial_time, leg.final_time, 23):
            wanted.append(evaluate(expression, {**constants, "t": float(t)}, name))
            found.append((sign if name.startswith("lam_") else 1.0) * leg_value(leg, name, float(t)))
        scale = max(1.0, float(np.max(np.abs(wanted))))
        np.testing.assert_allclose(found, wanted, atol=5 * tolerance * scale, err_msg=name)


def leg_value(leg: go.PhaseSolution, name: str, t: float) -> float:
    """Value of a state, a control or, by the name of ``lam_<state>``, a costate."""
    if name.startswith("lam_"):
        return float(leg.costate(name[4:])(t))
    return float((leg.state if name in leg.states else leg.control)(name)(t))


BASE = phase(0, 1, [state("x", 0, 1)], [control("u", -2, 2)], {"x": "u"}, integrals={"J": "u**2"})


def ill_posed(name: str, category: str, objective: str = "J_1", **changes: Any) -> Document:
    return document(name, objective, {**BASE, **changes}, category=["ill-posed", category], expect="a report")


ILL_POSED: list[tuple[Document, str]] = [
    (ill_posed("too far", "infeasible", states=[state("x", 0, 9)]), "infeasible"),
    (ill_posed("bounds", "infeasible", states=[state("x", 1, None, 0, 0.5)]), "input_error"),
    (
        {
            **ill_posed("no bound", "unbounded", "x_f1", states=[state("x", 0)], controls=[control("u")]),
            "sense": "max",
        },
        "unbounded",
    ),
    (
        ill_posed("nan", "nan", states=[state("x", 1, 0.5, guess=[-1, -0.5])], ode={"x": "u*log(x)"}),
        "input_error",
    ),
    (
        {
            **ill_posed("unknown", "input-error", ode={"x": "u-k*x"}),
            "expect": "input error naming the symbol (k)",
        },
        "input_error",
    ),
    (
        ill_posed(
            "chatter",
            "not-attained",
            states=[state("x", 0, 0, -1, 1)],
            controls=[control("u", -2, 2, guess=0.5)],
            integrals={"J": "x**2+(u**2-1)**2"},
        ),
        "optimal",
    ),
]


@pytest.mark.parametrize(
    ("problem", "status"), ILL_POSED, ids=lambda p: p["name"] if isinstance(p, dict) else p
)
def test_ill_posed_problems_end_with_the_report_that_is_asked_for(problem: Document, status: str) -> None:
    outcome, _ = problem_set.run(problem, mesh="6x4")
    assert outcome.status == status
    assert outcome.passed
    assert outcome.objective is None or outcome.verdict_ok is False


def test_ill_posed_problems_that_are_reported_solved_do_not_pass() -> None:
    """A well-posed problem with the label of an ill-posed one stands for a tool that finds a false solution."""
    for category in ("infeasible", "unbounded", "not-attained", "input-error", "nan"):
        outcome, _ = problem_set.run(ill_posed("fine", category), mesh="4x4")
        assert outcome.verdict_ok
        assert not outcome.passed, category


def test_a_crash_never_passes_and_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def crash(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError("deep inside")

    monkeypatch.setattr(go, "solve", crash)
    outcome, solution = problem_set.run(ill_posed("crash", "infeasible"))
    assert (outcome.status, outcome.passed, solution) == ("crash", False, None)
    assert outcome.message == "ZeroDivisionError: deep inside"
