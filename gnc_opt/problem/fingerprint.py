"""Fingerprint: a hash by which a stored solution recognises its problem."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.model.layout import Layout
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.statement import Statement
from gnc_opt.problem.symbols import parameter_arguments


def problem_fingerprint(problem: Statement) -> str:
    """Return a hash of the functions, names and numbers that define the problem (hex, 16 digits).

    How an answer is looked for is left out: guesses, scales and held arcs.
    """
    digest = hashlib.sha256()
    digest.update(repr((problem.sense, _names(problem.parameters), problem.constraint_labels())).encode())
    for leg in problem.phases.values():
        model = leg.model
        layouts = [_names(layout) for layout in (model.states, model.controls, model.parameters)]
        digest.update(repr((leg.name, layouts, leg.path_labels, tuple(leg.integrands))).encode())
        digest.update(_along(problem, leg))
        for vector in (_given(problem, leg), *_vectors(leg.numbers), *_vectors(leg.path_interval())):
            digest.update(vector.tobytes())
    digest.update(_at_ends(problem))
    for vector in (*_vectors(problem.constraint_interval()), *_vectors(problem.parameter_interval())):
        digest.update(vector.tobytes())
    return digest.hexdigest()[:16]


def _names(layout: Layout) -> tuple[tuple[str, int], ...]:
    return tuple((v.name, v.size) for v in layout.variables)


def _given(problem: Statement, leg: Phase) -> Array:
    """Values of the model's parameters; of those that are optimised, the values say nothing."""
    values = leg.model.parameter_values
    for name in problem.parameters.names:
        if name in leg.model.parameters:
            values[leg.model.parameters.slice(name)] = 0.0
    return values


def _vectors(box: Any) -> Iterable[Array]:
    """Yield every float vector of a dataclass of intervals, depth first."""
    for value in vars(box).values():
        if isinstance(value, Interval):
            yield from (value.lower, value.upper)
        elif isinstance(value, np.ndarray):
            yield value


def _along(problem: Statement, leg: Phase) -> bytes:
    expressions = [leg.model.derivative(), leg.path_expression(), leg.integrand_expression()]
    return _exact([*leg.model.arguments(), problem.parameter_symbols()], expressions)


def _at_ends(problem: Statement) -> bytes:
    arguments: list[Any] = []
    for leg, parameters in zip(
        problem.phases.values(), parameter_arguments(problem.phases.values()), strict=True
    ):
        arguments += [leg.ends("initial"), leg.ends("final"), leg.initial_time, leg.final_time]
        arguments += [leg.integral_symbols(), parameters]
    return _exact([*arguments, problem.parameter_symbols()], [problem.cost, problem.constraint_expression()])


def _exact(arguments: list[Any], expressions: list[Any]) -> bytes:
    """Return expressions with the places of their symbols and every digit of their constants.

    Printed, constants would be rounded to six digits, and symbols of one name would look alike.
    """
    return bytes(ca.Function("exact", arguments, expressions).serialize(), "ascii")
