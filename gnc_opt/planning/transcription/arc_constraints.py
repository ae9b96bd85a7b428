"""Prescribed arcs in the nonlinear program: bounds of variables and rows, and rows of smooth controls."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from gnc_opt.array_types import Array, Indices
from gnc_opt.errors import ProblemError
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind, FixedArcs, Junction, Kinds, SmoothControl
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.redundant_bounds import (
    find_implied_bounds,
    find_monotone_states,
    relax_state_bounds,
)
from gnc_opt.planning.transcription.collocation import PhaseCollocation
from gnc_opt.planning.transcription.quadrature import build_lagrange_interpolation_matrix


def check_number_of_arc_segments(phase: Phase, collocation: PhaseCollocation) -> None:
    """Raise an error if the arcs are given for another number of segments."""
    held, segments = phase.numbers.arcs, collocation.mesh.segments
    for kinds in (held.controls, held.paths, held.states) if held else ():
        if kinds and len(kinds[0]) != segments:
            raise ProblemError(
                f"arcs of {phase.label} are given for {len(kinds[0])} segments, but its mesh has {segments}: "
                "give one column per segment."
            )


def impose_control_limits_on_arcs(
    box: Interval, held: FixedArcs, bounds: Interval, collocation: PhaseCollocation
) -> None:
    """Apply the limits of controls at the points of their arcs to ``box``."""
    _fix_variables_at_arc_limits(box, collocation.point_controls, held.controls, bounds, collocation)


def impose_path_limits_on_arcs(
    box: Interval, held: FixedArcs, bounds: Interval, collocation: PhaseCollocation
) -> None:
    """Apply the limits of path constraint rows at the points of their arcs to ``box``."""
    if held.paths:
        _fix_variables_at_arc_limits(box, collocation.path_rows, held.paths, bounds, collocation)


def impose_state_limits_on_arcs(
    box: Interval, phase: Phase, held: FixedArcs, collocation: PhaseCollocation
) -> None:
    """Apply the limits of states at the start and the points of their arcs to ``box``.

    The collocation rows imply them at the segment ends. A start linked from an arc on the same bound gets none.
    """
    if not held.states:
        return
    bounds, going_on = phase.numbers.states, _find_states_linked_from_bound_arc(phase, held)
    _fix_variables_at_arc_limits(box, collocation.point_states, held.states, bounds, collocation)
    for i, row in enumerate(held.states):
        for k, kind in enumerate(row):
            if kind is ArcKind.RELEASED:
                inner = collocation.boundary_states[i, max(k, 1) : min(k + 2, len(row))]
                box.lower[inner], box.upper[inner] = -np.inf, np.inf
    for i, row in enumerate(held.states):
        for k, kind in enumerate(row):
            if not kind.is_at_limit:
                continue
            start, end = collocation.boundary_states[i, k : k + 2]
            if k == 0 and i in going_on:
                box.lower[start], box.upper[start] = -np.inf, np.inf
            elif k == 0 or row[k - 1] is not kind:
                box.lower[start] = box.upper[start] = bounds.get_limit_by_sign(kind.sign)[i]
            box.lower[end], box.upper[end] = -np.inf, np.inf


def _find_states_linked_from_bound_arc(phase: Phase, held: FixedArcs) -> set[int]:
    """Return the states that the previous phase links from an arc on the same bound."""
    found = set()
    for before, theirs, ours in _iterate_linked_states(phase):
        if before.numbers.arcs is not None and before.numbers.arcs.states:
            rows = zip(range(phase.model.states.size)[ours], before.numbers.arcs.states[theirs], strict=True)
            found |= {i for i, row in rows if row[-1] is held.states[i][0]}
    return found


def _iterate_linked_states(phase: Phase) -> Iterator[tuple[Phase, slice, slice]]:
    """Yield the earlier phase of each state linked without a jump, and the indices of the state in both phases."""
    for name in phase.model.states.names:
        before, jump = phase.find_linked_phase(name) or (None, None)
        if before is not None and not np.any(jump):
            yield before, before.model.states.slice(name), phase.model.states.slice(name)


def relax_bounds_of_linked_starts(box: Interval, phase: Phase, collocation: PhaseCollocation) -> None:
    """Relax bounds of linked states at the start that they have at the end of the earlier phase."""
    loose = relax_state_bounds(phase)
    for before, theirs, ours in _iterate_linked_states(phase):
        places, own, other = collocation.boundary_states[ours, 0], phase.numbers.states, before.numbers.states
        lower, upper = other.lower[theirs] >= own.lower[ours], other.upper[theirs] <= own.upper[ours]
        box.lower[places[lower]], box.upper[places[upper]] = (
            loose.lower[ours][lower],
            loose.upper[ours][upper],
        )


def relax_bounds_of_monotone_states(
    box: Interval, problem: Problem, phase: Phase, collocation: PhaseCollocation
) -> None:
    """Relax the bounds of monotone states except at the one end where they are not redundant."""
    rising, falling = find_monotone_states(problem, phase, undriven=phase.numbers.arcs is not None)
    loose = relax_state_bounds(phase)
    after, before = slice(1, None), slice(None, -1)
    for limits, wider, at_start, at_end in (
        (box.lower, loose.lower, rising, falling & ~rising),
        (box.upper, loose.upper, falling, rising & ~falling),
    ):
        for ways, idle in ((at_start, after), (at_end, before)):
            for i in np.flatnonzero(ways):
                limits[collocation.boundary_states[i, idle]] = limits[collocation.point_states[i]] = wider[i]


def remove_implied_state_bounds(
    box: Interval, problem: Problem, phase: Phase, collocation: PhaseCollocation
) -> None:
    """Remove bounds of states that are implied by the constant length of a vector."""
    sides = (box.lower, -np.inf), (box.upper, np.inf)
    for (limits, none), idle in zip(sides, find_implied_bounds(problem, phase), strict=True):
        limits[collocation.boundary_states[idle]] = limits[collocation.point_states[idle]] = none


def impose_state_bounds_at_junctions(
    box: Interval, held: FixedArcs, bounds: Interval, collocation: PhaseCollocation
) -> None:
    """Fix states at their bounds at junctions; other junction conditions are rows."""
    for junction in held.junctions:
        i = junction.constraint - collocation.n_paths
        if i >= 0 and junction.conditions:
            place = collocation.boundary_states[i, junction.boundary]
            box.lower[place] = box.upper[place] = bounds.get_limit_by_sign(junction.kind.sign)[i]


def _fix_variables_at_arc_limits(
    box: Interval, places: Indices, arc_kinds: Kinds, bounds: Interval, collocation: PhaseCollocation
) -> None:
    """Fix the variables of bound arcs at the limits, and free those of released arcs."""
    shape = len(arc_kinds), collocation.mesh.segments  # a coast arc has no segment
    kinds = np.repeat(np.asarray(arc_kinds, dtype=object).reshape(shape), collocation.mesh.degrees, axis=1)
    for kind in (ArcKind.LOWER, ArcKind.UPPER):
        here = kinds == kind
        limits = np.broadcast_to(bounds.get_limit_by_sign(kind.sign)[:, None], kinds.shape)
        box.lower[places[here]] = box.upper[places[here]] = limits[here]
    released = places[kinds == ArcKind.RELEASED]
    box.lower[released], box.upper[released] = -np.inf, np.inf


def list_arc_junctions(phase: Phase) -> tuple[Junction, ...]:
    """Return the junctions of the state constraints of a phase."""
    return () if phase.numbers.arcs is None else phase.numbers.arcs.junctions


def list_junction_derivative_orders(junction: Junction, n_paths: int) -> range:
    """Return the derivative orders with a row; a state at its bound is fixed by a bound instead."""
    return range(0 if junction.constraint < n_paths else 1, junction.conditions)


def count_junction_constraint_rows(junction: Junction, n_paths: int) -> int:
    return len(list_junction_derivative_orders(junction, n_paths)) + (junction.tangent != 0)


def compute_junction_constraint_limits(junction: Junction, paths: Interval, order: int | None) -> Array:
    """Return the values of the rows of a junction: the limit of a path constraint, followed by zeros."""
    values = np.zeros(count_junction_constraint_rows(junction, paths.lower.size))
    if junction.constraint < paths.lower.size and (junction.conditions or order == 0):
        values[0] = paths.get_limit_by_sign(junction.kind.sign)[junction.constraint]
    return values


@dataclass(frozen=True, eq=False)
class JunctionControls:
    """Controls of a segment, variables (m, n) or (m, 0), and weights (n,) that interpolate them at one of its ends."""

    points: Indices
    weights: Array


def find_controls_at_junction(collocation: PhaseCollocation, junction: Junction) -> JunctionControls:
    """Return the controls of the segment on the tangent side of a junction."""
    places = collocation.point_controls
    if not junction.tangent:
        return JunctionControls(places[:, :0], np.zeros(0))
    segment = junction.boundary - (junction.tangent < 0)
    points = slice(*collocation.mesh.point_offsets[segment : segment + 2])
    rule = collocation.collocation_rules[segment]
    return JunctionControls(
        places[:, points], build_lagrange_interpolation_matrix(rule.points, [-float(junction.tangent)])[0]
    )


def list_polynomial_controls(phase: Phase) -> tuple[SmoothControl, ...]:
    """Return the controls of a phase that are one polynomial over several segments."""
    return () if phase.numbers.arcs is None else phase.numbers.arcs.smooth


def build_polynomial_control_constraints(
    smooth: SmoothControl, collocation: PhaseCollocation
) -> tuple[Indices, Array]:
    """Return control variables of segments (N,), and orthonormal rows that vanish for polynomials of the degree."""
    mesh = collocation.mesh
    points = slice(mesh.point_offsets[smooth.first], mesh.point_offsets[smooth.last])
    left = mesh.arc_starts[smooth.first]
    right = mesh.arc_starts[smooth.last - 1] + mesh.arc_widths[smooth.last - 1]
    places = 2 * (collocation.normalised_times_in_arcs[points] - left) / (right - left) - 1
    basis = np.linalg.qr(legendre.legvander(places, smooth.degree), mode="complete")[0]
    return collocation.point_controls[smooth.control, points], basis[:, smooth.degree + 1 :].T


def list_polynomial_control_nonzeros(
    rows: list[tuple[Indices, Array]], first_row: int
) -> tuple[Indices, Indices, Array]:
    """Return rows, columns and values of all smoothness rows, starting at ``first_row``."""
    entries: list[Any] = []
    for columns, values in rows:
        numbers = first_row + np.arange(values.shape[0])
        entries.append((np.repeat(numbers, columns.size), np.tile(columns, values.shape[0]), values.ravel()))
        first_row += values.shape[0]
    if not entries:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0)
    stacked = [np.concatenate([e[i] for e in entries]) for i in range(3)]
    return stacked[0], stacked[1], stacked[2]
