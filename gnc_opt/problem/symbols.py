"""Which symbols may stand in which expression of a problem."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import casadi as ca

from gnc_opt.errors import ProblemError, right_symbol
from gnc_opt.model.layout import Layout
from gnc_opt.model.model import Model
from gnc_opt.model.symbol import foreign_symbols
from gnc_opt.problem.phase import Phase


def end_symbols(phases: Iterable[Phase], free_parameters: Any) -> list[Any]:
    """Return all symbols that a cost or boundary constraint may use: phase by phase, then the free parameters."""
    symbols: list[Any] = []
    for leg in phases:
        symbols += [*end_points(leg), leg.model.symbols("parameter")]
    return [*symbols, free_parameters]


def parameter_arguments(phases: Iterable[Phase]) -> list[Any]:
    """Return the model parameters of each phase, as arguments of a function of all phases.

    A function cannot take a symbol twice: of phases that share a model, only the first brings its symbols,
    and the others bring placeholders of the same size.
    """
    taken: set[int] = set()
    arguments = []
    for leg in phases:
        own = leg.model.symbols("parameter")
        elements = {element.element_hash() for element in ca.vertsplit(own)}
        arguments.append(ca.SX.sym("unused", own.shape[0]) if elements & taken else own)
        taken |= elements
    return arguments


def refuse_foreign_ends(phases: Iterable[Phase], free_parameters: Any, expression: Any, what: str) -> None:
    """Raise `ProblemError` if a cost or boundary constraint uses what is not a value at an end of a phase."""
    phases = list(phases)
    foreign = foreign_symbols(expression, end_symbols(phases, free_parameters))
    if not foreign:
        return
    name = foreign[0]
    for leg in phases:
        if name not in foreign_symbols(expression, list(leg.model.arguments())):
            raise ProblemError(
                f"{what} uses '{name}', which varies along phase '{leg.name}': use "
                f"{leg.name}.final_state(...), {leg.name}.initial_state(...) or {leg.name}.integral(...)."
            )
    raise ProblemError(
        f"{what} uses '{name}', which belongs to no phase of this problem: use end points, times, integrals "
        "and parameters of its own phases."
    )


def refuse_foreign_along(
    leg: Phase, phases: Iterable[Phase], parameters: Layout, free_parameters: Any, expression: Any, what: str
) -> None:
    """Raise `ProblemError` if an expression along a phase uses other than its model and free parameters.

    Parameters
    ----------
    phases : iterable of Phase
        All of the problem.
    parameters : Layout
        Names of the problem's free parameters.
    free_parameters : casadi.SX
        Their symbols, stacked.
    """
    foreign = foreign_symbols(expression, [*leg.model.arguments(), free_parameters])
    if not foreign:
        return
    name = foreign[0]
    if name not in foreign_symbols(expression, [s for other in phases for s in end_points(other)]):
        raise ProblemError(
            f"{what} uses the end-point symbol '{name}': end points belong in constrain() or the cost, "
            "while along a phase there are states, controls, time and parameters."
        )
    known = [
        n for k in (leg.model.states, leg.model.controls, leg.model.parameters, parameters) for n in k.names
    ]
    raise ProblemError(
        f"{what} uses '{name}', which is no symbol of model '{leg.model.name}': {right_symbol(name, known)}"
    )


def refuse_other_size(name: str, size: int, model: Model, problem: str) -> None:
    """Raise `ProblemError` if a free parameter and the model's parameter of that name differ in size."""
    if name in model.parameters and model.parameters[name].size != size:
        raise ProblemError(
            f"parameter '{name}' of problem '{problem}' has {size} components, but in model '{model.name}' "
            f"it has {model.parameters[name].size}: declare it with that size."
        )


def end_points(leg: Phase) -> list[Any]:
    """Return the symbols of what is known at the ends of a phase: states at both, both times, integrals."""
    return [leg.ends("initial"), leg.ends("final"), leg.initial_time, leg.final_time, leg.integral_symbols()]
