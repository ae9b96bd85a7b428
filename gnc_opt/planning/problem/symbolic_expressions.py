"""Expressions of a problem: checks of their symbols, and their table calls."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.errors import ProblemError, suggest_model_symbol
from gnc_opt.model.casadi_expression_graph import iterate_subexpressions
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_function
from gnc_opt.model.lookup_table import Table, TableCall
from gnc_opt.model.model_variables import Layout, find_declared_symbols, find_unknown_symbols
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.numerical_tolerances import AT_LIMIT
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem_definition import ProblemData


@dataclass(frozen=True)
class OutsideTable:
    """Interval (s) in which a trajectory exceeds axis ``axis`` (from 0) of a table, with extreme argument and time.

    Without a phase, the table is evaluated in the cost or a boundary constraint.
    """

    table: Table
    phase: str
    axis: int
    value: float
    time: float
    span: tuple[float, float]

    def __str__(self) -> str:
        grid = self.table.grids[self.axis]
        argument = f"argument {self.axis + 1} " if len(self.table.grids) > 1 else ""
        first, last = self.span
        when = f"{first:.4g} s" if first == last else f"{first:.4g} to {last:.4g} s"
        place, at = "in the cost or a boundary constraint", ""
        if self.phase:
            place, at = f"at t = {when} in phase {self.phase}", f" at t = {self.time:.4g} s"
        value = f"{argument}{self.value:.6g}{at}, beyond {grid[0]:g} to {grid[-1]:g}"
        return f"'{self.table.name}' evaluated outside {place}: {value}"


def stack_phase_expressions(phase: Phase) -> Any:
    """Return all expressions along a phase, stacked, in the symbols of its model."""
    return ca.vertcat(phase.model.state_derivative(), phase.path_expression(), phase.integrand_expression())


def build_function_along_phase(problem: ProblemData, phase: Phase, name: str, column: Any) -> Any:
    """Return a column along a phase as CasADi Function of (t, x, u, p, q), with the free parameters q."""
    arguments = [*phase.model.symbolic_arguments(), problem.parameter_symbols()]
    values = [ca.densify(problem.substitute_parameters(phase, column))]
    return ca.Function(name, arguments, values, ["t", "x", "u", "p", "q"], [name])


def list_table_calls(problem: ProblemData, phase: Phase) -> tuple[TableCall, ...]:
    """Return the table calls in the expressions along a phase."""
    return problem.memoize(("tables", phase.name), lambda: _find_table_calls(stack_phase_expressions(phase)))


def list_boundary_table_calls(problem: ProblemData) -> tuple[TableCall, ...]:
    """Return the table calls in the cost and the boundary constraints."""
    return _find_table_calls(ca.vertcat(problem.cost, problem.constraint_expression()))


def _find_table_calls(expression: Any) -> tuple[TableCall, ...]:
    calls = [use for s in find_declared_symbols(ca.symvar(expression)) for use in s.table_calls]
    present = {node.element_hash() for node in iterate_subexpressions(expression)} if calls else set()
    return tuple({id(use): use for use in calls if use.subexpression_hashes & present}.values())


def find_points_outside_tables(
    problem: ProblemData, phase: Phase, times: Array, states: Array, controls: Array, p: Array, q: Array
) -> list[OutsideTable]:
    """Return where a trajectory is outside of tables: times (N,), states and controls by columns, parameters."""
    uses = list_table_calls(problem, phase)
    if not uses:
        return []
    column = ca.vertcat(*(use.arguments for use in uses))
    function = problem.memoize(
        ("table arguments", phase.name), lambda: build_function_along_phase(problem, phase, "tables", column)
    )
    arguments = evaluate_casadi_function(function, times, states, controls, p, q)
    return _find_values_outside_tables(uses, arguments, phase.name, times)


def find_boundary_values_outside_tables(problem: ProblemData, ends: list[Any]) -> list[OutsideTable]:
    """Return where cost and boundary constraints are outside of tables at end values; see `list_endpoint_arguments`."""
    uses = list_boundary_table_calls(problem)
    if not uses:
        return []
    function = build_endpoint_expression_function(
        problem, "tables", ca.vertcat(*(use.arguments for use in uses))
    )
    return _find_values_outside_tables(uses, function(*ends).full(), "", np.full(1, np.nan))


def _find_values_outside_tables(
    uses: tuple[TableCall, ...], arguments: Array, phase: str, times: Array
) -> list[OutsideTable]:
    points, row = [], 0
    for use in uses:
        for axis, grid in enumerate(use.table.grids):
            excess = np.maximum(grid[0] - arguments[row], arguments[row] - grid[-1])
            outside = np.flatnonzero(excess > AT_LIMIT * (grid[-1] - grid[0]))
            if outside.size:
                worst = int(np.argmax(excess))
                span = (float(times[outside[0]]), float(times[outside[-1]]))
                value, time = float(arguments[row, worst]), float(times[worst])
                points.append(OutsideTable(use.table, phase, axis, value, time, span))
            row += 1
    return points


def list_endpoint_arguments(problem: ProblemData) -> list[Any]:
    """Return the arguments of a function of end values: those and the model parameters per phase, free parameters."""
    phases = problem.phases.values()
    own = zip(map(list_endpoint_symbols, phases), list_model_parameter_arguments(phases), strict=True)
    return [*(s for ends, parameters in own for s in (*ends, parameters)), problem.parameter_symbols()]


def build_endpoint_expression_function(problem: ProblemData, name: str, column: Any) -> Any:
    """Return a column of end values as CasADi Function of `list_endpoint_arguments`."""
    return ca.Function(
        name, list_endpoint_arguments(problem), [ca.densify(substitute_parameters(problem, column))]
    )


def substitute_parameters(problem: ProblemData, expression: Any) -> Any:
    """Replace model parameters that the problem optimises by the symbols of the problem."""
    for phase in problem.phases.values():
        expression = problem.substitute_parameters(phase, expression)
    return expression


def list_model_parameter_arguments(phases: Iterable[Phase]) -> list[Any]:
    """Return the model parameters of each phase as function arguments; repeated models get placeholders."""
    listed: set[int] = set()
    arguments = []
    for phase in phases:
        symbols = phase.model.symbols("parameter")
        elements = {element.element_hash() for element in ca.vertsplit(symbols)}
        arguments.append(ca.SX.sym("unused", symbols.shape[0]) if elements & listed else symbols)
        listed |= elements
    return arguments


def check_boundary_symbols(phases: Iterable[Phase], free_parameters: Any, expression: Any, what: str) -> None:
    """Raise `ProblemError` if a cost or boundary constraint uses a symbol that is not an end value or parameter."""
    phases = list(phases)
    known = [s for phase in phases for s in (*list_endpoint_symbols(phase), phase.model.symbols("parameter"))]
    unknown = find_unknown_symbols(expression, [*known, free_parameters])
    if not unknown:
        return
    name = unknown[0]
    for phase in phases:
        if name not in find_unknown_symbols(expression, list(phase.model.symbolic_arguments())):
            raise ProblemError(
                f"{what} uses '{name}', which varies along phase '{phase.name}': use "
                f"{phase.name}.final_state(...), {phase.name}.initial_state(...) or {phase.name}.integral(...)."
            )
    raise ProblemError(
        f"{what} uses '{name}', which is not a symbol of this problem: use end points, times, integrals "
        "and parameters of its own phases."
    )


def check_phase_symbols(
    phase: Phase,
    phases: Iterable[Phase],
    parameters: Layout,
    free_parameters: Any,
    expression: Any,
    what: str,
) -> None:
    """Raise `ProblemError` if an expression along a phase uses other symbols than its model and free parameters."""
    unknown = find_unknown_symbols(expression, [*phase.model.symbolic_arguments(), free_parameters])
    if not unknown:
        return
    name = unknown[0]
    if name not in find_unknown_symbols(
        expression, [s for other in phases for s in list_endpoint_symbols(other)]
    ):
        raise ProblemError(
            f"{what} uses the end-point symbol '{name}': end points belong in constrain() or the cost, "
            "while along a phase there are states, controls, time and parameters."
        )
    candidates = [
        n
        for k in (phase.model.states, phase.model.controls, phase.model.parameters, parameters)
        for n in k.names
    ]
    raise ProblemError(
        f"{what} uses '{name}', which is not a symbol of model '{phase.model.name}': "
        f"{suggest_model_symbol(name, candidates)}"
    )


def check_parameter_size(name: str, size: int, model: Model, problem: str) -> None:
    """Raise `ProblemError` if a free parameter and the model parameter of the same name differ in size."""
    if name in model.parameters and model.parameters[name].size != size:
        raise ProblemError(
            f"parameter '{name}' of problem '{problem}' has {size} components, but in model '{model.name}' "
            f"it has {model.parameters[name].size}: declare it with that size."
        )


def list_endpoint_symbols(phase: Phase) -> list[Any]:
    """Return the symbols of the end values of a phase: states at both ends, both times, integrals."""
    return [
        phase.end_states("initial"),
        phase.end_states("final"),
        phase.initial_time,
        phase.final_time,
        phase.integral_symbols(),
    ]
