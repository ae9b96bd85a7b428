"""Margins of the sequence of arcs: shortest arc, slowest switch, smallest extremum of a switching function."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import EQUAL, TINY
from gnc_opt.planning.problem.active_constraint_arcs import Arc
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.report.constraint_margins import sample_phase_signal

SLOPE_STEP_SHARE_OF_PHASE = 1e-5
"""Step of the difference quotient of a switching function."""


class StructureMargin(NamedTuple):
    """Arc, switch or extremum of a channel with its value, and ``risk``, by which margins of a kind are compared.

    The values are a duration (s), a slope (per s) and a value of the switching function S. The risk is the phase over
    the arc, the largest |S| over the slope (the shift of the switch, s, by a change of S by this magnitude), and the
    largest |S| over the extremum.
    """

    kind: str
    phase: str
    label: str
    time: float
    value: float
    risk: float


def select_largest_risks(margins: Iterable[StructureMargin]) -> list[StructureMargin]:
    """Return the margin with the largest risk of each kind; values of S at the ends of a phase count as extrema."""
    found: dict[str, StructureMargin] = {}
    for margin in margins:
        found[margin.kind] = max(found.get(margin.kind, margin), margin, key=lambda each: each.risk)
    return list(found.values())


def iterate_control_structure_margins(solution: Solution) -> Iterator[StructureMargin]:
    """Yield the margins of all arcs of all controls and constraints."""
    for phase in solution.phases.values():
        arcs = [arc for arc in solution.structure if arc.phase == phase.name]
        for label in dict.fromkeys(arc.channel for arc in arcs):
            mine = [arc for arc in arcs if arc.channel == label]
            yield from list_margins_of_control_arcs(solution, phase, label, mine)


def list_margins_of_control_arcs(
    solution: Solution, phase: PhaseSolution, label: str, arcs: Sequence[Arc]
) -> Iterator[StructureMargin]:
    """Yield the margins of the arcs of a channel; those of a switching function of controls always at a limit."""
    for arc in (
        [arc for arc in arcs if arc.end > arc.start] if len(arcs) > 1 else ()
    ):  # touches have no length
        length = arc.end - arc.start
        yield StructureMargin("shortest arc", phase.name, label, arc.start, length, phase.duration / length)
    if label not in phase.controls.labels or not all(arc.kind.is_at_limit for arc in arcs):
        return
    row, functions = phase.controls.labels.index(label), solution.phase_functions(phase.name)
    if phase.control_bounds.is_fixed[row]:
        return

    def evaluate_switching_function(t: Any, side: Any) -> Array:
        return np.asarray(
            functions.switching_functions(t, phase.x(t, side), phase.u(t, side), phase.lam(t, side))[row]
        )

    times, (values,) = sample_phase_signal(phase, evaluate_switching_function)
    times, chosen = np.unique(times, return_index=True)
    values = values[chosen]
    largest, step = float(np.max(np.abs(values))), SLOPE_STEP_SHARE_OF_PHASE * phase.duration
    for arc, following in pairwise(arcs):
        if arc.kind is not following.kind:
            before, after = evaluate_switching_function(arc.end + np.array([-step, step]), "right")
            slope = float(abs(after - before)) / (2 * step)
            risk = largest / max(slope, TINY)
            yield StructureMargin("slowest switch", phase.name, label, arc.end, slope, risk)
    near = EQUAL * phase.duration
    for arc in arcs:
        inside = (times > arc.start + near) & (times < arc.end - near)  # without the switches
        inside[[0, -1]] |= np.abs(times[[0, -1]] - (arc.start, arc.end)) <= near
        places = np.flatnonzero(inside)
        size = np.abs(values[places])
        dips = 1 + np.flatnonzero((size[1:-1] < size[:-2]) & (size[1:-1] <= size[2:]))
        for i in {*places[dips], places[np.argmax(size)], *({0, times.size - 1} & {*places})}:
            value = float(abs(values[i]))
            risk = largest / max(value, TINY)
            yield StructureMargin("smallest extremum", phase.name, label, float(times[i]), value, risk)
