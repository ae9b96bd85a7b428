"""What a mesh shows and no control can do: two limits held at once by one, bangs that lead beyond a limit just left."""

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


def with_possible_ends(structure: PhaseStructure, longest: float) -> PhaseStructure:
    """Return the structure without bangs beside arcs of second order that would lead beyond their limit.

    An arc is met, and left, with S'' away from its limit. A mesh holds it with a control that swings, and shows the
    ends of that as bangs of the other sign, no longer than this (s), between the arc and the bang that is right: they
    are of the arc. Or that bang is too short to be seen: a short one is put there.
    """
    for k in range(1, structure.pieces):
        for row in structure.changes(k):
            entered = structure.kinds[k][row].at_limit
            arc, bang, beyond = (k, k - 1, k - 2) if entered else (k - 1, k, k + 1)
            if structure.orders[row] < 2 or len(structure.holders[row]) != 1 or structure.leans[row] == (0,):
                continue
            (i,), limit = structure.holders[row], structure.kinds[arc][row]
            outward = limit.sign * structure.leans[row][0]
            if structure.kinds[arc][i] is not ArcKind.SINGULAR or structure.kinds[bang][i].sign != outward:
                continue
            right = 0 <= beyond < structure.pieces and structure.kinds[beyond][i].sign == -outward
            if right and structure.lengths[bang] < longest:
                start, end = structure.times[bang], structure.times[bang + 1]
                wider = structure.with_arc(i, start, end, ArcKind.SINGULAR).with_arc(row, start, end, limit)
                return with_possible_ends(wider, longest)
            room = min(0.25 * longest, *(0.5 * structure.lengths[[arc, bang]]))
            start, end = structure.times[k] - 0.5 * room, structure.times[k] + 0.5 * room
            inward = ArcKind.LOWER if outward > 0 else ArcKind.UPPER
            ended = structure.with_arc(row, start, end, ArcKind.INTERIOR).with_arc(i, start, end, inward)
            return with_possible_ends(ended, longest)
    return structure
