"""Linkage of phases, and division of a phase at times or at fractions of its duration, for time windows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array, require_type
from gnc_opt.array_types import Array
from gnc_opt.errors import ProblemError, quote_value, warn_user
from gnc_opt.model.model_variables import read_vector
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.phase import Phase, PhaseOwner
from gnc_opt.planning.problem.phase_bounds_and_guess import read_duration


def build_linkage_constraints(
    problem: str,
    first: Phase,
    second: Phase,
    states: Iterable[str] | None,
    time: bool,
    jump: Mapping[str, ArrayLike] | None,
) -> Iterator[tuple[str, Any, Array]]:
    """Yield name, expression and value of each constraint that links two phases; see ``Problem.link``."""
    label = f"link_{first.name}_{second.name}"
    if time and first is second:
        raise ProblemError(f"{label} of problem '{problem}' joins a phase to itself: use time=False.")
    own_states = first.own_states | second.own_states
    common = [name for name in first.model.states.names if name in second.model.states]
    shared = [name for name in common if name not in own_states]
    names = shared if states is None else _read_state_names(states, f"the states of {label}")
    jumps = (
        {}
        if jump is None
        else require_type(jump, Mapping, f"the jump of {label}", 'write jump={"m": -100.0}')
    )
    for name in dict.fromkeys([*names, *jumps]):
        start, end = second.initial_state(name), first.final_state(name)
        if start.shape != end.shape:
            raise ProblemError(
                f"{label} of problem '{problem}' joins state '{name}' of {end.shape[0]} components to "
                f"one of {start.shape[0]}: leave it out of states=[...] and constrain() its components."
            )
        units = [phase.model.states[name].unit for phase in (first, second)]
        if all(units) and units[0] != units[1]:
            warn_user(
                f"{label} of problem '{problem}' links '{name}' in {units[0]} to {units[1]}, but units are not "
                "converted: use one unit, or omit it in states=[...] and constrain() it with a factor."
            )
        value = read_vector(jumps.get(name, 0.0), start.shape[0], f"the jump of '{name}' in {label}")
        second.linked_states[name] = (first.name, value)
        yield f"{label}_{name}", start - end, value
    if time:
        second.preceding_phase = first.name
        yield f"{label}_time", second.initial_time - first.final_time, read_vector(0.0, 1, label)


def _read_state_names(states: Iterable[str], what: str) -> list[str]:
    if isinstance(states, (list, tuple, set, frozenset)) and all(isinstance(name, str) for name in states):
        return list(states)
    raise ProblemError(f"{what} are {quote_value(states)}: give a list of names.")


class DivisibleProblem(PhaseOwner, Protocol):
    """Interface of a problem whose phases can be divided."""

    cost: Any

    def link(self, first: Phase, second: Phase, *, states: Iterable[str]) -> None: ...

    def constrain(
        self, name: str, expression: Any, *, lower: Any = None, upper: Any = None, equals: Any = None
    ) -> None: ...

    def constraint_expression(self) -> Any: ...


def divide_phase(
    problem: DivisibleProblem, phase: Phase, times: ArrayLike | None, fractions: ArrayLike | None
) -> tuple[Phase, ...]:
    """Return the parts of a phase, divided at times (s) or at fractions of its duration."""
    _check_phase_can_be_divided(problem, phase)
    begin, end, total = phase.numbers.initial_time, phase.numbers.final_time, phase.numbers.duration
    if begin is None or end is None:
        raise ProblemError(f"{phase.label} has no times: call time(initial=..., final=...) before divide().")
    n_points = np.size(_read_phase_division_points(phase, times, fractions))
    names = [f"{phase.name}_{k + 2}" for k in range(n_points)]
    parts = [phase, *phase.create_following_phases(names)]
    boundary_times = [begin, *_read_phase_division_times(phase, times, fractions, begin, end), end]
    for part, (first, last) in zip(parts, pairwise(boundary_times), strict=True):
        part.numbers = replace(
            part.numbers, initial_time=first, final_time=last, duration=read_duration(None, part.label)
        )
        problem.phases[part.name] = part
    problem.clear_cache()
    for before, after in pairwise(parts):
        problem.link(before, after, states=phase.model.states.names)
    duration = parts[-1].final_time - phase.initial_time
    if fractions is not None:
        for part, share, time in zip(parts[1:], np.ravel(fractions), boundary_times[1:], strict=False):
            if not time.is_fixed[0]:
                elapsed = part.initial_time - phase.initial_time
                problem.constrain(f"start of {part.name}", elapsed - float(share) * duration, equals=0.0)
    if total.lower[0] > 0.0 or np.isfinite(total.upper[0]):
        problem.constrain(f"duration of {phase.name}", duration, lower=total.lower, upper=total.upper)
    return tuple(parts)


def _read_phase_division_points(phase: Phase, times: ArrayLike | None, fractions: ArrayLike | None) -> Any:
    if (times is None) == (fractions is None):
        raise ProblemError(f"divide() of {phase.label} needs either times or fractions: give one of them.")
    return times if fractions is None else fractions


def _read_phase_division_times(
    phase: Phase, times: ArrayLike | None, fractions: ArrayLike | None, begin: Interval, end: Interval
) -> Iterator[Interval]:
    what = "times" if fractions is None else "fractions"
    points = _read_phase_division_points(phase, times, fractions)
    values = np.ravel(read_float_array(points, f"the {what} of divide()", ProblemError))
    lower, upper = (begin.lower[0], end.upper[0]) if fractions is None else (0.0, 1.0)
    if not (values.size and np.all(np.diff([lower, *values, upper]) > 0)):
        raise ProblemError(
            f"the {what} of divide() of {phase.label} are {values}: "
            f"give increasing ones between {lower:g} and {upper:g}."
        )
    for value in values:
        if fractions is None:
            yield Interval(np.array([value]), np.array([value]))
        else:
            limits = [
                (1.0 - value) * a + value * b for a, b in ((begin.lower, end.lower), (begin.upper, end.upper))
            ]
            yield Interval(*limits)


def _check_phase_can_be_divided(problem: DivisibleProblem, phase: Phase) -> None:
    problem.require_mutable()
    functions = ca.vertcat(problem.constraint_expression(), *([] if problem.cost is None else [problem.cost]))
    if (
        phase.integrands
        or phase.numbers.guess.values
        or ca.depends_on(functions, ca.vertcat(phase.end_states("final"), phase.final_time))
    ):
        raise ProblemError(
            f"{phase.label} has an integral, a guess, or a cost or constraint at its end: call divide() first "
            "and state them for its parts."
        )
