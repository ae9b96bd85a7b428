"""Which symbols may stand in which expression of a problem."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi as ca

from gnc_opt.errors import ProblemError, did_you_mean
from gnc_opt.model.symbol import foreign_symbols

if TYPE_CHECKING:
    from gnc_opt.model.model import Model
    from gnc_opt.problem.phase import Phase
    from gnc_opt.problem.problem import Problem


def end_symbols(problem: Problem) -> list[Any]:
    """Return all symbols that a cost or boundary constraint may use: phase by phase, then the parameters."""
    symbols: list[Any] = []
    for leg in problem.phases.values():
        symbols += [*_end_points(leg), leg.model.symbols("parameter")]
    return [*symbols, problem.parameter_symbols()]


def parameter_arguments(problem: Problem) -> list[Any]:
    """Return the model parameters of each phase, as arguments of a function of all phases.

    A function cannot take a symbol twice: of phases that share a model, only the first brings its symbols,
    and the others bring placeholders of the same size.
    """
    taken: set[int] = set()
    arguments = []
    for leg in problem.phases.values():
        own = leg.model.symbols("parameter")
        elements = {element.element_hash() for element in ca.vertsplit(own)}
        arguments.append(ca.SX.sym("unused", own.shape[0]) if elements & taken else own)
        taken |= elements
    return arguments


def refuse_foreign_ends(problem: Problem, expression: Any, what: str) -> None:
    """Raise `ProblemError` if a cost or boundary constraint uses what is not a value at an end of a phase."""
    foreign = foreign_symbols(expression, end_symbols(problem))
    if not foreign:
        return
    name = foreign[0]
    for leg in problem.phases.values():
        if name not in foreign_symbols(expression, list(leg.model.arguments())):
            raise ProblemError(
                f"{what} uses '{name}', which varies along phase '{leg.name}': use "
                f"{leg.name}.final_state(...), "
                f"{leg.name}.initial_state(...) or {leg.name}.integral(...)."
            )
    raise ProblemError(
        f"{what} uses '{name}', which belongs to no phase of this problem: use end points, times, integrals "
        "and "
        "parameters of its own phases."
    )


def refuse_foreign_along(problem: Problem, leg: Phase, expression: Any, what: str) -> None:
    """Raise `ProblemError` if an expression along a phase uses other than its model and free parameters."""
    foreign = foreign_symbols(expression, [*leg.model.arguments(), problem.parameter_symbols()])
    if not foreign:
        return
    name = foreign[0]
    if name not in foreign_symbols(
        expression, [s for other in problem.phases.values() for s in _end_points(other)]
    ):
        raise ProblemError(
            f"{what} uses the end-point symbol '{name}': end points belong in constrain() or the cost, "
            "while along a phase there are states, controls, time and parameters."
        )
    kinds = (leg.model.states, leg.model.controls, leg.model.parameters, problem.parameters)
    raise ProblemError(
        f"{what} uses '{name}', which is no symbol of model '{leg.model.name}': "
        f"{did_you_mean(name, [n for kind in kinds for n in kind.names])}"
    )


def refuse_other_size(name: str, size: int, model: Model, problem: str) -> None:
    """Raise `ProblemError` if a free parameter and the model's parameter of that name differ in size."""
    if name in model.parameters and model.parameters[name].size != size:
        raise ProblemError(
            f"parameter '{name}' of problem '{problem}' has {size} components, but in model '{model.name}' "
            "it has "
            f"{model.parameters[name].size}: declare it with that size."
        )


def _end_points(leg: Phase) -> list[Any]:
    return [leg.ends("initial"), leg.ends("final"), leg.initial_time, leg.final_time, leg.integral_symbols()]
