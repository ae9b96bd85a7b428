r"""Short arcs that a mesh shows beside limits since polynomials ring there, and that no trajectory has.

Where a control jumps inside a segment its polynomial swings, and so does the switching function, as multipliers of the
limit make up for it. What is read from their signs are bangs within a segment, gaps in an arc, and limits that change
places again and again. Let S have order one, and a bang be beside an arc on S = 0: before the arc it leads to the
limit, :math:`\dot S \ge 0`, and after it away, :math:`\dot S \le 0`. (It is zero where a limit of the control takes
over without a jump.) A bang that does neither is of the arc.
"""

from __future__ import annotations

import numpy as np

from gnc_opt.problem.arc import ArcKind
from gnc_opt.refine.structure.phase_structure import PhaseStructure
from gnc_opt.refine.structure.state_constraints import StateConstraints

CLEARLY = 0.05
"""So much of what the range of a control does to a constraint is more than the noise of a mesh."""


def without_ringing(
    structure: PhaseStructure, constraints: StateConstraints, segments: float
) -> PhaseStructure:
    """Return the structure without arcs shorter than some segments of the mesh that no trajectory has."""
    short = _short(structure, constraints, segments)
    for piece in short:
        if _gap(structure, piece) or _back_and_forth(structure, piece):
            return without_ringing(structure.without(piece), constraints, segments)
    for piece in short:
        for arc in (piece - 1, piece + 1):
            for row in _left(structure, piece, arc):
                if _leads_beyond(structure, constraints, row, piece, arc):
                    start, end = structure.times[piece], structure.times[piece + 1]
                    wider = structure.with_arc(structure.holders[row][0], start, end, ArcKind.SINGULAR)
                    wider = wider.with_arc(row, start, end, structure.kinds[arc][row])
                    return without_ringing(wider, constraints, segments)
    return structure


def _short(structure: PhaseStructure, constraints: StateConstraints, segments: float) -> list[int]:
    """Pieces shorter than some of the segments that they are in."""
    breaks = constraints.samples.leg.breaks
    middles = 0.5 * (np.asarray(structure.times[1:]) + np.asarray(structure.times[:-1]))
    place = np.clip(np.searchsorted(breaks, middles) - 1, 0, breaks.size - 2)
    return [int(k) for k in np.flatnonzero(structure.lengths < segments * np.diff(breaks)[place])]


def _within(structure: PhaseStructure, piece: int) -> bool:
    """Whether a structure is the same before and after a piece."""
    return 0 < piece < structure.pieces - 1 and structure.kinds[piece - 1] == structure.kinds[piece + 1]


def _gap(structure: PhaseStructure, piece: int) -> bool:
    """Whether limits of first order are left and met again by controls that are on no bound meanwhile."""
    return _within(structure, piece) and all(
        structure.orders[row] == 1
        and structure.kinds[piece - 1][row].at_limit
        and [structure.kinds[piece][i] for i in structure.holders[row]] == [ArcKind.SINGULAR]
        for row in structure.changes(piece)
    )


def _back_and_forth(structure: PhaseStructure, piece: int) -> bool:
    """Whether one limit of a control takes over from another, and that again."""
    return _within(structure, piece) and bool(structure.handed_over(piece))


def _left(structure: PhaseStructure, piece: int, arc: int) -> list[int]:
    """Rows of first order that one control holds along an arc, and leaves, or comes from, by a bang beside it."""
    if not 0 <= arc < structure.pieces:
        return []
    return [
        row
        for row in structure.changes(max(piece, arc))
        if structure.orders[row] == 1
        and [structure.kinds[arc][i] for i in structure.holders[row]] == [ArcKind.SINGULAR]
        and structure.kinds[piece][structure.holders[row][0]].at_limit
    ]


def _leads_beyond(
    structure: PhaseStructure, constraints: StateConstraints, row: int, piece: int, arc: int
) -> bool:
    """Whether a bang would lead a row beyond the limit along the arc beside it."""
    s, (control,) = constraints.samples, structure.holders[row]
    time = structure.times[max(piece, arc)]
    upper = structure.kinds[piece][control] is ArcKind.UPPER
    bounds, u = s.leg.control_bounds, np.tile(s.leg.u(time)[:, None], 2)
    u[control] = (bounds.upper if upper else bounds.lower)[control] + np.array(
        [0.0, s.control_scale[control]]
    )
    rates = constraints.derivative(
        row - len(structure.controls), 1, np.repeat(time, 2), np.tile(s.leg.x(time)[:, None], 2), u
    )
    outward = structure.kinds[arc][row].sign * (1 if piece > arc else -1) * rates[0]
    return bool(outward > CLEARLY * abs(rates[1] - rates[0]))
