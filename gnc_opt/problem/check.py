"""Finding mistakes before the solver stumbles over them."""

from __future__ import annotations

import warnings
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.errors import ProblemError, ProblemWarning, did_you_mean
from gnc_opt.model.layout import Array
from gnc_opt.model.symbol import foreign_symbols
from gnc_opt.problem.interval import Interval, intersect
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.problem import Problem

_SAMPLES = 11


def check_problem(problem: Problem) -> None:
    """Raise `ProblemError` at the first mistake; see ``Problem.check`` for what is looked at."""
    if not problem.phases:
        raise ProblemError(f"problem '{problem.name}' has no phase: add one with phase(name, model).")
    if problem.cost is None:
        raise ProblemError(f"problem '{problem.name}' has no cost: call minimize() or maximize().")
    for leg in problem.phases.values():
        _check_times(leg)
        _check_boundary_values(leg)
        _check_functions_symbols(problem, leg)
        _check_unused(problem, leg)
    _check_unused_parameters(problem)
    for leg in problem.phases.values():
        _check_evaluation(problem, leg)


def _check_times(leg: Phase) -> None:
    initial, final = leg.numbers.initial_time, leg.numbers.final_time
    if initial is None or final is None:
        raise ProblemError(f"{leg.where} has no times: call time(initial=..., final=...).")
    if initial.lower[0] > final.upper[0]:
        raise ProblemError(
            f"{leg.where} ends before it starts: initial time >= {initial.lower[0]:g} s, "
            f"final time <= {final.upper[0]:g} s."
        )
    if initial.fixed[0] and final.fixed[0] and initial.lower[0] == final.lower[0]:
        raise ProblemError(f"{leg.where} has no duration: initial and final time are both {initial.lower[0]:g} s.")


def _check_boundary_values(leg: Phase) -> None:
    for end, values in (("initial", leg.numbers.initial), ("final", leg.numbers.final)):
        both = intersect(values, leg.numbers.states)
        slack = 1e-12 * (1.0 + np.abs(both.lower))
        wrong = np.flatnonzero(both.lower > both.upper + slack)
        if wrong.size:
            i = int(wrong[0])
            raise ProblemError(
                f"the {end} value of '{leg.model.states.labels[i]}' in {leg.where} is {_show(values, i)}, "
                f"outside its bounds {_show(leg.numbers.states, i)}: correct one of the two."
            )


def _show(interval: Interval, i: int) -> str:
    lower, upper = interval.lower[i], interval.upper[i]
    return f"{lower:g}" if lower == upper else f"[{lower:g}, {upper:g}]"


def _phase_expressions(problem: Problem, leg: Phase) -> dict[str, Any]:
    """All expressions along a phase, by what they are called in messages."""
    expressions = {"the dynamics": leg.model.derivative()}
    expressions |= {f"path constraint '{c.name}'": c.expression for c in leg.paths.values()}
    expressions |= {f"integral '{name}'": e for name, (_, e) in leg.integrands.items()}
    return {what: problem.bind(leg, e) for what, e in expressions.items()}


def _check_functions_symbols(problem: Problem, leg: Phase) -> None:
    known = [*leg.model.arguments(), problem.parameter_symbols()]
    ends = [s.name() for other in problem.phases.values() for s in _end_scalars(other)]
    for what, expression in _phase_expressions(problem, leg).items():
        foreign = foreign_symbols(expression, known)
        if not foreign:
            continue
        if foreign[0] in ends:
            raise ProblemError(
                f"{what} of {leg.where} uses the end-point symbol '{foreign[0]}': "
                "end points belong in constrain() or the cost; along a phase use states, controls, time and parameters."
            )
        names = [n for kind in (leg.model.states, leg.model.controls, leg.model.parameters) for n in kind.names]
        raise ProblemError(
            f"{what} of {leg.where} uses '{foreign[0]}', which is no symbol of model '{leg.model.name}': "
            f"{did_you_mean(foreign[0].split('_')[0], names)}"
        )


def _end_scalars(leg: Phase) -> list[Any]:
    ends = [leg.ends("initial"), leg.ends("final"), leg.initial_time, leg.final_time, leg.integral_symbols()]
    return list(ca.symvar(ca.vertcat(*ends)))


def _check_unused(problem: Problem, leg: Phase) -> None:
    used = set()
    for expression in _phase_expressions(problem, leg).values():
        used |= {s.element_hash() for s in ca.symvar(expression)}
    for variable in leg.model.controls.variables:
        symbol = leg.model.symbol(variable.name)
        idle = [lab for lab, s in zip(variable.labels, ca.vertsplit(symbol), strict=True) if s.element_hash() not in used]
        if idle:
            raise ProblemError(
                f"control '{idle[0]}' of {leg.where} appears in no dynamics, path constraint or integral: "
                "use it or remove it (its value would be arbitrary)."
            )


def _check_unused_parameters(problem: Problem) -> None:
    everything = [problem.cost, problem.constraint_expression()]
    for leg in problem.phases.values():
        everything += list(_phase_expressions(problem, leg).values())
    bound = [problem.bind(leg, e) for leg in problem.phases.values() for e in everything[:2]]
    used = {s.element_hash() for e in [*everything, *bound] for s in ca.symvar(e)}
    models = {id(leg.model): leg.model for leg in problem.phases.values()}.values()
    for variable in problem.parameters.variables:
        symbol = problem.parameter_symbols()[problem.parameters.slice(variable.name)]
        if not any(s.element_hash() in used for s in ca.vertsplit(symbol)):
            known = [n for model in models for n in model.parameters.names]
            raise ProblemError(
                f"parameter '{variable.name}' of problem '{problem.name}' appears in no function and no model has a "
                f"parameter of that name: {did_you_mean(variable.name, known)}"
            )
    for model in models:
        for variable in model.parameters.variables:
            own = ca.vertsplit(model.symbol(variable.name))
            if variable.name not in problem.parameters and not any(s.element_hash() in used for s in own):
                warnings.warn(
                    f"parameter '{variable.name}' of model '{model.name}' is used nowhere.", ProblemWarning, stacklevel=4
                )


def _check_evaluation(problem: Problem, leg: Phase) -> None:
    """Evaluate functions and Jacobians along the guess."""
    from gnc_opt.transcription.guess import start_phase

    fractions = np.linspace(0.0, 1.0, _SAMPLES)
    start = start_phase(leg, fractions)
    times = start.times[0] + fractions * (start.times[1] - start.times[0])
    for what, values in (("state", start.states), ("control", start.controls)):
        labels = (leg.model.states if what == "state" else leg.model.controls).labels
        _refuse_not_finite(values, labels, times, f"the guess of {what}", leg, "", {})
    point = dict(zip(leg.model.states.labels, start.states, strict=True))
    point |= dict(zip(leg.model.controls.labels, start.controls, strict=True))
    q = np.concatenate([*problem.parameter_guess.values(), np.zeros(0)])
    for name, rows, function in _checked_functions(problem, leg):
        value, jacobian = function(times.reshape(1, -1), start.states, start.controls, _parameters(leg), q)
        _refuse_not_finite(np.asarray(value.full()), rows, times, name, leg, "", point)
        by_row = np.asarray(jacobian.full()).reshape(len(rows), -1, times.size, order="F") if jacobian.numel() else None
        if by_row is not None:
            summed = np.where(np.isfinite(by_row), 0.0, np.nan).sum(axis=1)
            _refuse_not_finite(summed, rows, times, name, leg, "the Jacobian of ", point)


def _parameters(leg: Phase) -> Array:
    return leg.model.parameter_values


def _checked_functions(problem: Problem, leg: Phase) -> list[tuple[str, tuple[str, ...], Any]]:
    """For dynamics, paths and integrands: message name, row names, function (t, x, u, p, q) -> value, Jacobian."""
    key = ("check", leg.name)
    if key in problem.builds:
        found: list[tuple[str, tuple[str, ...], Any]] = problem.builds[key]
        return found
    t, x, u, p = leg.model.arguments()
    q = problem.parameter_symbols()
    named = [
        ("the time derivative of state", leg.model.states.labels, leg.model.derivative()),
        ("path constraint", leg.path_labels, leg.path_expression()),
        ("integral", tuple(leg.integrands), leg.integrand_expression()),
    ]
    found = []
    for what, rows, expression in named:
        if rows:
            bound = problem.bind(leg, expression)
            jacobian = ca.densify(ca.jacobian(bound, ca.vertcat(x, u)))
            found.append((what, rows, ca.Function("check", [t, x, u, p, q], [bound, ca.vec(jacobian)])))
    problem.builds[key] = found
    return found


def _refuse_not_finite(
    values: Array, rows: tuple[str, ...], times: Array, what: str, leg: Phase, prefix: str, point: dict[str, Array]
) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if not bad.size:
        return
    row, column = bad[np.argmin(bad[:, 1])]
    at = ", ".join(f"{name} = {value[column]:.4g}" for name, value in point.items()) if len(point) <= 12 else ""
    raise ProblemError(
        f"{prefix}{what} '{rows[row]}' is {'not finite' if prefix else values[row, column]} "
        f"at the guess in {leg.where} at t = {times[column]:.4g} s{f' ({at})' if at else ''}: "
        "give another guess(), or bounds that keep away from the singularity."
    )
