r"""Corrections of contacts that a mesh shows and no trajectory has.

Where a control jumps inside a segment its polynomial swings, and so does the switching function, as multipliers of the
limit make up for it. What is read from their signs are bangs within a segment and gaps in an arc. Let S have order one,
and a bang be next to an arc on S = 0: before the arc it leads to the limit, :math:`\dot S \ge 0`, and after it away,
:math:`\dot S \le 0`. (It is zero where a limit of the control takes over without a jump.) A bang that does neither is
of the arc. In the segment in which one limit takes over from another both seem to be held by one control.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.planning.optimality.state_constraints import StateConstraints
from gnc_opt.planning.problem.arcs import ArcKind
from gnc_opt.planning.refinement.arcs.structure import PhaseStructure
from gnc_opt.tolerances import TINY

CONSTRAINT_RATE_MIN_SHARE = 0.05
"""So much of what the range of a control does to a constraint is more than the noise of a mesh."""


def remove_oscillation_arcs(
    structure: PhaseStructure, constraints: StateConstraints, segments: float
) -> PhaseStructure:
    """Return the structure without arcs shorter than some segments of the mesh that no trajectory has."""
    short = _short_pieces(structure, constraints, segments)
    for piece in short:
        for arc in (piece - 1, piece + 1) if 0 < piece < structure.n_pieces - 1 else ():
            if _leaves_first_order_limits(structure, piece, arc):
                return remove_oscillation_arcs(_merge_with_arc(structure, piece, arc), constraints, segments)
    for piece in short:
        for arc in (piece - 1, piece + 1):
            for row in _find_limits_left_by_bang(structure, piece, arc):
                if _does_bang_violate_limit(structure, constraints, row, piece, arc):
                    start, end = structure.times[piece], structure.times[piece + 1]
                    wider = structure.with_arc(structure.holders[row][0], start, end, ArcKind.SINGULAR)
                    wider = wider.with_arc(row, start, end, structure.kinds[arc][row])
                    return remove_oscillation_arcs(wider, constraints, segments)
    return structure


def _short_pieces(structure: PhaseStructure, constraints: StateConstraints, segments: float) -> list[int]:
    breaks = constraints.samples.leg.breaks
    middles = 0.5 * (np.asarray(structure.times[1:]) + np.asarray(structure.times[:-1]))
    place = np.clip(np.searchsorted(breaks, middles) - 1, 0, breaks.size - 2)
    return [int(k) for k in np.flatnonzero(structure.piece_lengths < segments * np.diff(breaks)[place])]


def _leaves_first_order_limits(structure: PhaseStructure, piece: int, arc: int) -> bool:
    """Whether nothing but limits of first order are left next to an arc, by controls that are on no bound there."""
    rows = structure.rows_changing_at(max(piece, arc))
    return bool(rows) and all(
        structure.is_first_order(row)
        and structure.kinds[arc][row].at_limit
        and [structure.kinds[piece][i] for i in structure.holders[row]] == [ArcKind.SINGULAR]
        for row in rows
    )


def _merge_with_arc(structure: PhaseStructure, piece: int, arc: int) -> PhaseStructure:
    kinds = list(structure.kinds)
    kinds[piece] = kinds[arc]
    return replace(structure, kinds=tuple(kinds)).merge_pieces()


def _find_limits_left_by_bang(structure: PhaseStructure, piece: int, arc: int) -> list[int]:
    """Rows of first order that one control holds along an arc, and leaves, or comes from, by a neighbouring bang."""
    if not 0 <= arc < structure.n_pieces:
        return []
    return [
        row
        for row in structure.rows_changing_at(max(piece, arc))
        if structure.is_first_order(row)
        and [structure.kinds[arc][i] for i in structure.holders[row]] == [ArcKind.SINGULAR]
        and structure.kinds[piece][structure.holders[row][0]].at_limit
    ]


def _does_bang_violate_limit(
    structure: PhaseStructure, constraints: StateConstraints, row: int, piece: int, arc: int
) -> bool:
    """Whether a bang would lead a row beyond the limit along the neighbouring arc."""
    way = 1 if piece > arc else -1
    time, kind = structure.times[max(piece, arc)], structure.kinds[arc][row]
    return way * _violation_rate(structure, constraints, row, piece, time, kind) > CONSTRAINT_RATE_MIN_SHARE


def _violation_rate(
    structure: PhaseStructure, constraints: StateConstraints, row: int, piece: int, time: float, kind: ArcKind
) -> float:
    """How fast a bang would lead a row beyond a limit, in shares of what the range of its control does to it."""
    s, (control,) = constraints.samples, structure.holders[row]
    upper = structure.kinds[piece][control] is ArcKind.UPPER
    bounds, u = s.leg.control_bounds, np.tile(s.leg.u(time)[:, None], 2)
    u[control] = (bounds.upper if upper else bounds.lower)[control] + np.array(
        [0.0, s.control_scale[control]]
    )
    rates = constraints.time_derivative(
        row - len(structure.control_kinds), 1, np.repeat(time, 2), np.tile(s.leg.x(time)[:, None], 2), u
    )
    return float(kind.sign * rates[0] / max(abs(rates[1] - rates[0]), TINY))


# --- two limits that one control holds at once


def remove_overlapping_limits(structure: PhaseStructure) -> PhaseStructure:
    """Return the structure without pieces along which two limits hold one control, which can hold one of them.

    On a mesh both push in the segment in which one takes over from the other. One that is held on both sides of the
    other is left on the side on which it is shorter.
    """
    for piece in range(structure.n_pieces):
        rows = _find_overdetermined_rows(structure, piece)
        if len(rows) < 2:
            continue
        beside = [k for k in (piece - 1, piece + 1) if 0 <= k < structure.n_pieces]
        around = [[k for k in beside if structure.kinds[k][i].at_limit] for i in rows]
        if sorted(around) == [[piece - 1], [piece + 1]]:
            return remove_overlapping_limits(structure.without_piece(piece))
        for row, sides in zip(rows, around, strict=True):
            if len(sides) == 2:
                first, last = sorted((piece, min(sides, key=lambda k: structure.piece_lengths[k])))
                start, end = structure.times[first], structure.times[last + 1]
                return remove_overlapping_limits(structure.with_arc(row, start, end, ArcKind.INTERIOR))
    return structure


def _find_overdetermined_rows(structure: PhaseStructure, piece: int) -> list[int]:
    """Rows that are on limits in a piece though one control holds them all: state constraints, or else mixed paths.

    Its own bound may be among them.
    """
    kinds, first = structure.kinds[piece], len(structure.control_kinds)
    owners = [(i,) if i < first else own for i, own in enumerate(structure.holders)]
    found = [i for i, own in enumerate(owners) if kinds[i].at_limit and len(own) == 1]
    by_state = [i for i in found if structure.orders[i]]
    mixed = [i for i in found if i >= first and structure.regular[i]]
    return [i for i in found if (by_state or mixed) and owners[i] == owners[(by_state or mixed)[0]]]
