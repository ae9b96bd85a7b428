"""What a mesh shows and no control can do: two limits that one control holds at once."""

from __future__ import annotations

from gnc_opt.planning.problem.arcs import ArcKind
from gnc_opt.planning.refinement.arcs.structure import PhaseStructure


def without_overlaps(structure: PhaseStructure) -> PhaseStructure:
    """Return the structure without pieces along which two limits hold one control, which can hold one of them.

    On a mesh both push in the segment in which one takes over from the other. One that is held on both sides of the
    other is left on the side on which it is shorter.
    """
    for piece in range(structure.pieces):
        rows = _held_by_one(structure, piece)
        if len(rows) < 2:
            continue
        beside = [k for k in (piece - 1, piece + 1) if 0 <= k < structure.pieces]
        around = [[k for k in beside if structure.kinds[k][i].at_limit] for i in rows]
        if sorted(around) == [[piece - 1], [piece + 1]]:
            return without_overlaps(structure.without(piece))
        for row, sides in zip(rows, around, strict=True):
            if len(sides) == 2:
                first, last = sorted((piece, min(sides, key=lambda k: structure.lengths[k])))
                start, end = structure.times[first], structure.times[last + 1]
                return without_overlaps(structure.with_arc(row, start, end, ArcKind.INTERIOR))
    return structure


def _held_by_one(structure: PhaseStructure, piece: int) -> list[int]:
    """Rows that are on limits in a piece though one control holds them all: state constraints, or else mixed paths.

    Its own bound may be among them.
    """
    kinds, first = structure.kinds[piece], len(structure.controls)
    owners = [(i,) if i < first else own for i, own in enumerate(structure.holders)]
    found = [i for i, own in enumerate(owners) if kinds[i].at_limit and len(own) == 1]
    by_state = [i for i in found if structure.orders[i]]
    mixed = [i for i in found if i >= first and structure.regular[i]]
    return [i for i in found if (by_state or mixed) and owners[i] == owners[(by_state or mixed)[0]]]
