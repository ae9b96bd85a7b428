"""Fingerprint of a problem: hash of the functions, names and numbers that determine its solutions."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.model.model_variables import Layout
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.symbolic_expressions import list_endpoint_arguments


def compute_problem_fingerprint(problem: ProblemData) -> str:
    """Return a hash of the functions, names and numbers of a problem, without guesses, scales and prescribed arcs."""
    digest = hashlib.sha256()
    names = problem.sense, _list_variable_sizes(problem.parameters), problem.constraint_labels()
    digest.update(repr(names).encode())
    for phase in problem.phases.values():
        model = phase.model
        layouts = [_list_variable_sizes(v) for v in (model.states, model.controls, model.parameters)]
        digest.update(repr((phase.name, layouts, phase.path_labels, tuple(phase.integrands))).encode())
        digest.update(_serialise_phase_expressions(problem, phase))
        for vector in (
            _list_fixed_parameter_values(problem, phase),
            *_list_numeric_arrays_of_bounds(phase.numbers),
            *_list_numeric_arrays_of_bounds(phase.get_path_bounds()),
        ):
            digest.update(vector.tobytes())
    expressions = [problem.cost, problem.constraint_expression()]
    digest.update(_serialise_expressions(list_endpoint_arguments(problem), expressions))
    for vector in (
        *_list_numeric_arrays_of_bounds(problem.get_boundary_constraint_bounds()),
        *_list_numeric_arrays_of_bounds(problem.get_parameter_bounds()),
    ):
        digest.update(vector.tobytes())
    return digest.hexdigest()[:16]


def _list_variable_sizes(layout: Layout) -> tuple[tuple[str, int], ...]:
    return tuple((v.name, v.size) for v in layout.variables)


def _list_fixed_parameter_values(problem: ProblemData, phase: Phase) -> Array:
    """Return the values of the model parameters; the values of optimised parameters are ignored."""
    values = phase.model.parameter_values
    for name in problem.parameters.names:
        if name in phase.model.parameters:
            values[phase.model.parameters.slice(name)] = 0.0
    return values


def _list_numeric_arrays_of_bounds(box: Any) -> Iterable[Array]:
    for value in vars(box).values():
        if isinstance(value, Interval):
            yield from (value.lower, value.upper)
        elif isinstance(value, np.ndarray):
            yield value


def _serialise_phase_expressions(problem: ProblemData, phase: Phase) -> bytes:
    arguments = [*phase.model.symbolic_arguments(), problem.parameter_symbols()]
    expressions = [phase.model.state_derivative(), phase.path_expression(), phase.integrand_expression()]
    return _serialise_expressions(arguments, expressions)


def _serialise_expressions(arguments: list[Any], expressions: list[Any]) -> bytes:
    """Return expressions as bytes, with the indices of their symbols and all digits of their constants."""
    return bytes(ca.Function("exact", arguments, expressions).serialize(), "ascii")
