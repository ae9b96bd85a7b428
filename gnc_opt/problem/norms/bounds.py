"""Limits of kinks that are bounds of controls: ``norm_inf(u) <= 1`` keeps each component within 1."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from gnc_opt.problem.constraint import Constraint
from gnc_opt.problem.interval import Interval, free, intersect
from gnc_opt.problem.norms.domain import Domain, drawn, is_affine
from gnc_opt.problem.norms.extrema import is_smooth, pieces, rows_of
from gnc_opt.problem.norms.find import stated_controls
from gnc_opt.problem.norms.kinks import limited_sense
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.restatement import Restatement

BoundsByHand: TypeAlias = dict[str, Interval]
"""Of all controls, by the path constraint that says them."""


def bounds_by_hand(leg: Phase, domain: Domain) -> BoundsByHand:
    """Return the bounds of controls that path constraints with kinks amount to, and nothing else."""
    symbols = ca.vertsplit(leg.model.symbols("control"))
    controls = {place: symbols[place] for place in stated_controls(leg).values()}
    found = {name: _bounds(c, controls, free(len(symbols)), domain) for name, c in leg.paths.items()}
    return {name: box for name, box in found.items() if box is not None}


def bound_controls(leg: Phase, found: BoundsByHand) -> None:
    """Give controls the bounds that path constraints amount to, in place of those."""
    box = leg.numbers.controls
    for own in found.values():
        box = intersect(box, own)
    leg.numbers = replace(leg.numbers, controls=box)
    leg.paths = {name: c for name, c in leg.paths.items() if name not in found}
    texts = tuple(f"'{name}' is solved for as bounds of controls" for name in found)
    leg.restatement = Restatement.of_limits(leg.model, texts).after(leg.restatement)


def _bounds(
    constraint: Constraint, controls: dict[int, Any], box: Interval, domain: Domain
) -> Interval | None:
    for i, row in enumerate(rows_of(constraint.expression)):
        sense = limited_sense(constraint, i)
        own = pieces(row, sense, domain) if sense and not is_smooth(row) else None
        if own is None:
            return None
        limit = constraint.interval.upper[i] if sense > 0 else constraint.interval.lower[i]
        for piece in own:
            place, slope, offset = _line(piece, controls)
            if place is None:
                return None
            end = (limit - offset) / slope
            if sense * slope > 0:
                box.upper[place] = min(box.upper[place], end)
            else:
                box.lower[place] = max(box.lower[place], end)
    return box if np.all(box.lower <= box.upper) else None


def _line(piece: Any, controls: dict[int, Any]) -> tuple[int | None, float, float]:
    """Return the control that a piece is an affine function of alone, its slope and the rest; None if it is not."""
    own = ca.symvar(piece)
    place = next((i for i, u in controls.items() if len(own) == 1 and ca.is_equal(own[0], u)), None)
    if place is None or not is_affine(piece, own[0]):
        return None, 0.0, 0.0
    rest = ca.substitute(piece, own[0], 0.0)
    slope, offset = drawn(ca.vertcat(ca.jacobian(piece, own[0]), rest))[:, 0]
    return place, float(slope), float(offset)
