"""Every error for bad input is a `GncOptError`: in the source, and for whatever junk the public calls get."""

from __future__ import annotations

import ast
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.models import one_phase
from testing.source_files import source_files, walk_statements
from testing.wrong_arguments import cart, refused, rest_to_rest, voyage

import gnc_opt as go

# --- the source -------------------------------------------------------------------------------------------

HANDED_IN = {"error", "failure", "run.error"}
"""Names under which a function is told what to raise (`read_integer(..., error=ModelError)`)."""

ALLOWED = {
    "NotImplementedError": "abstract methods",
    "SystemExit": "the command line's exit code",
    "FileNotFoundError": "a missing file is what Python says it is",
    "__init__.py: AttributeError": "what Python expects of a module's __getattr__",
    "renamed_public_names.py: AttributeError": "the same",
    "argument_checks.py: TypeError": "what Python raises for an unknown keyword, with a suggestion",
    "argument_checks.py: AttributeError": "what Python expects where a class has not one of its protocols",
    "ode_integration.py: OdeError": "caught at once: why a propagation ended",
    "ode_integration.py: LimitError": "one of those",
    "multistart_search.py: KeyboardInterrupt": "Ctrl-C, passed on to the search, which keeps what it has found",
    "staged_refinement.py: KeyboardInterrupt": "Ctrl-C in a solve, passed on: the best candidate is kept",
    "warm_start_from_known_arcs.py: KeyboardInterrupt": "Ctrl-C before there is a solution that could be kept",
    "optimal_control_solver.py: KeyboardInterrupt": "the same",
    "parameter_sweep.py: KeyboardInterrupt": "Ctrl-C, passed on to the sweep, which keeps what it has found",
    "npz_result_files.py: _NotAnArchive": "caught at once and turned into 'is no archive'",
    "npz_result_files.py: zipfile.BadZipFile": "caught at once and turned into 'is damaged'",
}


@cache
def nodes() -> dict[Path, list[ast.AST]]:
    """Classes, functions and raised errors of each file."""
    kinds = (ast.ClassDef, ast.FunctionDef, ast.Raise)
    return {
        path: [n for n in walk_statements(path) if isinstance(n, kinds)] for path in source_files("gnc_opt")
    }


@cache
def own() -> set[str]:
    """Names of the error classes of gnc_opt, and of the functions that return one to raise."""
    everywhere = [node for found in nodes().values() for node in found]
    names = {"GncOptError"}
    for _ in range(4):  # the depth of the hierarchy
        classes = [n for n in everywhere if isinstance(n, ast.ClassDef)]
        names |= {c.name for c in classes if any(isinstance(b, ast.Name) and b.id in names for b in c.bases)}
    functions = [n for n in everywhere if isinstance(n, ast.FunctionDef)]
    return names | {f.name for f in functions if isinstance(f.returns, ast.Name) and f.returns.id in names}


@pytest.mark.slow
def test_the_source_raises_only_errors_of_gnc_opt() -> None:
    strangers, known = [], own() | HANDED_IN | set(ALLOWED)
    for path, found in nodes().items():
        for node in found:
            if isinstance(node, ast.Raise) and node.exc is not None:
                raised = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
                what = ast.unparse(raised)
                method = what.removeprefix("self.")
                if not {method, f"{path.name}: {what}"} & known:
                    strangers.append(f"{path.name}, line {node.lineno}: raise {what}")
    assert strangers == []


def test_every_error_is_a_gnc_opt_error_and_what_python_users_expect() -> None:
    for error in (
        go.ModelError,
        go.ProblemError,
        go.ArgumentError,
        go.UnknownNameError,
        go.UnknownAttributeError,
    ):
        assert issubclass(error, go.GncOptError)
    for error in (go.ModelError, go.ProblemError, go.ArgumentError, go.UnknownNameError):
        assert issubclass(error, ValueError)
    assert issubclass(go.UnknownNameError, KeyError) and issubclass(go.UnknownAttributeError, AttributeError)
    assert issubclass(go.SolveError, RuntimeError)


JUNK: tuple[Any, ...] = (
    None,
    "text",
    "",
    object(),
    lambda t: t,
    True,
    float("nan"),
    float("inf"),
    -1,
    0,
    [],
    {},
    set(),
    [1, 2, 3],
    (1,),
    ("a", "b"),
    [[1, 2], [3, 4]],
    [None],
    ([1, 2], [3]),
    {"q": 1},
    np.zeros((2, 2)),
    np.array(["a"]),
    ca.SX.sym("z"),
    ca.SX.sym("z", 3),
    ca.MX.sym("z"),
    ca.DM([1, 2]),
)
"""Things that users have passed to other people's functions."""

QUICK = "2x2"


@cache
def solution() -> go.Solution:
    return go.solve(rest_to_rest()[0], mesh=QUICK, tol=None)


@cache
def stated() -> go.Problem:
    """Return a problem for calls that leave it as it is."""
    return rest_to_rest()[0]


@cache
def long_voyage() -> go.Problem:
    """Return the same with vectors."""
    return voyage()[0]


def own_model(problem: go.Problem) -> go.Model:
    return problem.phases["leg"].model


def model() -> go.Model:
    fresh = go.Model("fresh")
    fresh.state("x")
    return fresh


def unfinished() -> tuple[go.Problem, go.Phase]:
    problem, leg = one_phase("p", cart(), 0.0, 1.0)
    return problem, leg


CALLS: dict[str, Callable[[Any], object]] = {
    "Model": lambda j: go.Model(j),
    "state name": lambda j: model().state(j),
    "state size": lambda j: model().state("n", j),
    "state unit": lambda j: model().state("n", unit=j),
    "state nominal": lambda j: model().state("n", nominal=j),
    "control name": lambda j: model().control(j),
    "parameter name": lambda j: model().parameter(j, 1.0),
    "parameter value": lambda j: model().parameter("n", j),
    "ode": lambda j: model().ode(j),
    "ode value": lambda j: model().ode({"x": j}),
    "output name": lambda j: model().output(j, 1.0),
    "output value": lambda j: model().output("y", j),
    "model with_parameters": lambda j: own_model(long_voyage()).with_parameters(mass=j),
    "symbol": lambda j: model().symbol(j),
    "output_expression": lambda j: model().output_expression(j),
    "f t": lambda j: own_model(stated()).f(j, np.zeros(2), np.zeros(1)),
    "f x": lambda j: own_model(stated()).f(0.0, j, np.zeros(1)),
    "f u": lambda j: own_model(stated()).f(0.0, np.zeros(2), j),
    "f p": lambda j: own_model(long_voyage()).f(0.0, np.zeros(5), np.zeros(5), j),
    "linearize x": lambda j: own_model(stated()).linearize(0.0, j, np.zeros(1)),
    "Problem": lambda j: go.Problem(j),
    "phase name": lambda j: go.Problem("p").phase(j, cart()),
    "phase model": lambda j: go.Problem("p").phase("leg", j),
    "get_phase": lambda j: stated().get_phase(j),
    "free parameter name": lambda j: unfinished()[0].parameter(j),
    "free parameter size": lambda j: unfinished()[0].parameter("s", j),
    "free parameter lower": lambda j: unfinished()[0].parameter("s", lower=j),
    "free parameter upper": lambda j: unfinished()[0].parameter("s", upper=j),
    "free parameter guess": lambda j: unfinished()[0].parameter("s", guess=j),
    "constrain name": lambda j: unfinished()[0].constrain(j, 1.0, lower=0),
    "constrain expression": lambda j: unfinished()[0].constrain("c", j, lower=0),
    "constrain equals": lambda j: unfinished()[0].constrain("c", 1.0, equals=j),
    "link": lambda j: rest_to_rest()[0].link("leg", j),
    "link states": lambda j: rest_to_rest()[0].link("leg", "leg", states=j, time=False),
    "link jump": lambda j: rest_to_rest()[0].link("leg", "leg", jump=j, time=False),
    "link jump value": lambda j: rest_to_rest()[0].link("leg", "leg", jump={"q": j}, time=False),
    "minimize": lambda j: unfinished()[0].minimize(j),
    "maximize": lambda j: unfinished()[0].maximize(j),
    "with_initial": lambda j: stated().with_initial(q=j),
    "with_initial phase": lambda j: stated().with_initial(j, q=0.0),
    "with_final vector": lambda j: long_voyage().with_final(r=j),
    "with_bounds": lambda j: stated().with_bounds(a=j),
    "with_time initial": lambda j: stated().with_time(initial=j),
    "with_time final": lambda j: stated().with_time(final=j),
    "with_time duration": lambda j: stated().with_time(duration=j),
    "with_parameters": lambda j: long_voyage().with_parameters(mass=j),
    "with_scale": lambda j: long_voyage().with_scale(r=j),
    "with_guess time": lambda j: stated().with_guess(time=j),
    "with_guess": lambda j: stated().with_guess(q=j).check(),
    "with_guess over time": lambda j: stated().with_guess(time=[0, 1], q=j).check(),
    "with_guess function": lambda j: stated().with_guess(q=lambda t: j).check(),
    "path name": lambda j: unfinished()[1].path(j, 1.0, lower=0),
    "path expression": lambda j: unfinished()[1].path("n", j, lower=0),
    "path lower": lambda j: unfinished()[1].path("n", 1.0, lower=j),
    "path equals": lambda j: unfinished()[1].path("n", 1.0, equals=j),
    "integral": lambda j: unfinished()[1].integral(j),
    "integral name": lambda j: unfinished()[1].integral(1.0, name=j),
    "final_state": lambda j: unfinished()[1].final_state(j),
    "solve": lambda j: go.solve(j, tol=None),
    "solve mesh": lambda j: go.solve(stated(), mesh=j, tol=None),
    "solve mesh of a phase": lambda j: go.solve(stated(), mesh={"leg": j}, tol=None),
    "solve scheme": lambda j: go.solve(stated(), mesh=QUICK, scheme=j, tol=None),
    "solve guess": lambda j: go.solve(stated(), mesh=QUICK, guess=j),
    "solve options": lambda j: go.solve(stated(), mesh=QUICK, options=j, tol=None),
    "option solver": lambda j: go.SolverOptions(solver=j),
    "option linear_solver": lambda j: go.SolverOptions(linear_solver=j),
    "option tolerance": lambda j: go.SolverOptions(tolerance=j),
    "option max_iterations": lambda j: go.SolverOptions(max_iterations=j),
    "option max_wall_time": lambda j: go.SolverOptions(max_wall_time=j),
    "option bound_relax": lambda j: go.SolverOptions(bound_relax=j),
    "option mu_init": lambda j: go.SolverOptions(mu_init=j),
    "option extra": lambda j: go.SolverOptions(extra=j),
    "Mesh breaks": lambda j: go.Mesh(j, (3,)),
    "Mesh degrees": lambda j: go.Mesh((0.0, 1.0), j),
    "Mesh.uniform segments": lambda j: go.Mesh.uniform(j, 3),
    "Mesh.uniform degree": lambda j: go.Mesh.uniform(3, j),
    "Mesh.at_times": lambda j: go.Mesh.at_times(j, 3),
    "Mesh.at_times degree": lambda j: go.Mesh.at_times([0, 1, 2], j),
    "Mesh movable": lambda j: go.Mesh((0.0, 0.5, 1.0), (3, 3), j),
    "Mesh.at_times movable": lambda j: go.Mesh.at_times([0, 1, 2], 3, movable=j),
    "with_fixed_arcs": lambda j: stated().with_fixed_arcs(arcs=j),
    "Mesh.parse": lambda j: go.Mesh.parse(j),
    "solution phase": lambda j: solution().phase(j),
    "solution state": lambda j: solution().state(j),
    "solution costate": lambda j: solution().costate(j),
    "solution control": lambda j: solution().control(j),
    "solution saturated_control": lambda j: solution().saturated_control(j),
    "solution parameter": lambda j: solution().parameter(j),
    "solution multiplier": lambda j: solution().multiplier(j),
    "solution integral": lambda j: solution().phase().integral(j),
    "solution state of a phase": lambda j: solution().state("q", j),
    "time of a state": lambda j: solution().state("q")(j),
    "time of a flown control": lambda j: solution().saturated_control("a")(j),
    "side of a state": lambda j: solution().state("q")(0.5, j),
    "hamiltonian": lambda j: solution().hamiltonian(j),
    "switching_function": lambda j: solution().switching_function(j, 0.5),
    "time of switching_function": lambda j: solution().switching_function("a", j),
    "evaluate": lambda j: solution().evaluate(j, 0.5),
    "time of evaluate": lambda j: solution().evaluate("q", j),
    "with_problem": lambda j: solution().with_problem(j),
    "verify": lambda j: go.verify(j),
}


@pytest.mark.parametrize("call", CALLS)
def test_junk_is_accepted_or_refused_by_an_error_of_gnc_opt(call: str) -> None:
    refused = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # neither NumPy nor CasADi may grumble on the way
        for junk in JUNK:
            try:
                CALLS[call](junk)
            except go.GncOptError as error:
                refused += 1
                message = str(error)
                assert message.endswith((".", "?")) and "\n" not in message, f"{call}: {message}"
            except Exception as error:  # say which junk it was
                pytest.fail(f"{call} of {junk!r}: {type(error).__name__}: {error}")
    assert refused > len(JUNK) // 2, f"{call} takes too much"


def test_numbers_too_large_for_a_float_are_refused() -> None:
    for option in ("tolerance", "max_wall_time", "bound_relax", "mu_init"):
        with pytest.raises(go.ArgumentError, match=f"{option} is 1000.*000: give a finite number"):
            go.SolverOptions(**{option: 10**400})


def test_the_assertion_on_refusals_can_fail() -> None:
    for error, fragment, failure in (
        (go.UnknownNameError, "did you mean 'q'?", "did you mean 'v'"),
        (go.ArgumentError, "no state", "no state"),
    ):
        with pytest.raises((AssertionError, go.UnknownNameError), match=failure), refused(error, fragment):
            rest_to_rest()[1].initial(vv=0.0)
