"""Linkages: a phase continues where another one ends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from numpy.typing import ArrayLike

from gnc_opt.arguments import expect
from gnc_opt.arrays import Array
from gnc_opt.errors import ProblemError, shown, warn_user
from gnc_opt.model.layout import as_vector
from gnc_opt.problem.phase import Phase


def linkages(
    problem: str,
    first: Phase,
    second: Phase,
    states: Iterable[str] | None,
    time: bool,
    jump: Mapping[str, ArrayLike] | None,
) -> Iterator[tuple[str, Any, Array]]:
    """Yield name, expression and value of each constraint that links two phases; see ``Problem.link``.

    The second phase notes for its guess what is handed over to it, and when. The names are
    ``link_<first>_<second>_<state>`` and ``..._time``.
    """
    label = f"link_{first.name}_{second.name}"
    if time and first is second:
        raise ProblemError(
            f"{label} of problem '{problem}' takes no time: link a phase to itself with time=False."
        )
    shared = [name for name in first.model.states.names if name in second.model.states]
    names = shared if states is None else _state_names(states, f"the states of {label}")
    jumps = {} if jump is None else expect(jump, Mapping, f"the jump of {label}", 'write jump={"m": -100.0}')
    for name in dict.fromkeys([*names, *jumps]):
        start, end = second.initial_state(name), first.final_state(name)
        if start.shape != end.shape:
            raise ProblemError(
                f"{label} of problem '{problem}' joins state '{name}' of {end.shape[0]} components to "
                f"one of {start.shape[0]}: leave it out of states=[...] and constrain() its components."
            )
        units = [leg.model.states[name].unit for leg in (first, second)]
        if all(units) and units[0] != units[1]:
            warn_user(
                f"{label} of problem '{problem}' hands '{name}' over from {units[0]} to {units[1]}, and nothing is "
                "converted: use one unit, or leave it out of states=[...] and constrain() it with a factor."
            )
        value = as_vector(jumps.get(name, 0.0), start.shape[0], f"the jump of '{name}' in {label}")
        second.handed[name] = (first.name, value)
        yield f"{label}_{name}", start - end, value
    if time:
        second.follows = first.name
        yield f"{label}_time", second.initial_time - first.final_time, as_vector(0.0, 1, label)


def _state_names(states: Iterable[str], what: str) -> list[str]:
    if isinstance(states, (list, tuple, set, frozenset)) and all(isinstance(name, str) for name in states):
        return list(states)
    raise ProblemError(f"{what} are {shown(states)}: give a list of names.")
