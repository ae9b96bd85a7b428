r"""Controls as sums of parts, one from corner to corner of the convex, piecewise linear kinks of an integral.

The cheaper parts are used first, so that each part is a control with bounds, in which the cost is linear. The largest
of :math:`e_0, \ldots, e_k` is :math:`e_0 + c \max_i(\alpha_i u + \beta_i)` if all differences from :math:`e_0` are
affine in one control u, with a common factor c >= 0 of anything else. The largest of those lines is one line, and more
of it beyond each corner, where the next line takes over.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.model.composed_controls import SplitControl
from gnc_opt.model.expressions import replaced
from gnc_opt.model.model import Model
from gnc_opt.model.variables import Layout, Symbol, Variable
from gnc_opt.planning.problem.constraints import Constraint
from gnc_opt.planning.problem.interval import Interval, free, intersect
from gnc_opt.planning.problem.interval_arithmetic import Domain, drawn, is_affine
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.phase_data import Restatement
from gnc_opt.planning.problem.reformulation.epigraph import (
    Extremum,
    Pieces,
    is_smooth,
    kinks_that_cost,
    limited_sense,
    pieces,
    rows_of,
)
from gnc_opt.planning.problem.reformulation.phase_form import PhaseForm, free_name
from gnc_opt.planning.problem.reformulation.vector_norms import stated_controls
from gnc_opt.planning.problem.statement import Statement
from gnc_opt.tolerances import EQUAL


@dataclass(frozen=True, eq=False)
class Bend:
    """A convex (sense 1) or concave (-1) kink that is piecewise linear in the control ``place``.

    Its value is ``base + factor (slope u + offset + sum of rise_k max(u - corner_k, 0))``, rises > 0.
    """

    node: Any
    sense: int
    base: Any
    factor: Any
    place: int
    slope: float
    offset: float
    corners: tuple[float, ...]
    rises: tuple[float, ...]

    @classmethod
    def of(
        cls, node: Any, sense: int, found: Pieces, controls: Mapping[int, Any], domain: Domain
    ) -> Bend | None:
        """Return the bend that a kink is; None if it is of several controls, or where it bends is no number."""
        gaps = ca.vertcat(*(sense * (e - found[0]) for e in found))
        for place, u in controls.items():
            slopes = ca.jacobian(gaps, u)
            if not slopes.nnz() or any(ca.which_depends(gaps, u, 2, True)):
                continue
            lines = _piece_lines(gaps, slopes, u)
            if lines is None:
                continue
            first, alpha, beta = lines
            factor = slopes[first]
            sign = domain.sign(factor)
            if sign != 0:
                own = _line_at_infinity(sign * alpha, sign * beta)
                return cls(node, sense, found[0], sense * sign * factor, place, *own)
        return None

    def expressed(self, u: Any, beyond: Mapping[float, Any]) -> Any:
        """Return its value with expressions for what the control is beyond each corner."""
        more = [rise * beyond[corner] for corner, rise in zip(self.corners, self.rises, strict=True)]
        return self.base + self.factor * (self.slope * u + self.offset + sum(more))


def _piece_lines(gaps: Any, slopes: Any, u: Any) -> tuple[int, Array, Array] | None:
    """Return the row of the first slope, and slopes and offsets of all in its units; None if those are no numbers."""
    first = next(i for i in range(slopes.numel()) if not slopes[i].is_zero())
    alpha, beta = ca.densify(slopes) / slopes[first], ca.substitute(gaps, u, 0.0) / slopes[first]
    values = drawn(ca.vertcat(alpha, beta))
    if not np.all(np.isfinite(values)):
        return None
    spread = np.ptp(values, axis=1)
    if np.any(spread > EQUAL * np.maximum(1.0, np.max(np.abs(values), axis=1))):
        return None
    n = slopes.numel()
    return first, np.median(values[:n], axis=1), np.median(values[n:], axis=1)


def _line_at_infinity(alpha: Array, beta: Array) -> tuple[float, float, tuple[float, ...], tuple[float, ...]]:
    """Return slope and offset of the line that is the largest far to the left, corners and rises of the slope there."""
    order = np.lexsort((-beta, alpha))
    at = order[0]
    slope, offset = float(alpha[at]), float(beta[at])
    corners: list[float] = []
    rises: list[float] = []
    while True:
        steeper = [i for i in order if alpha[i] > alpha[at]]
        if not steeper:
            return slope, offset, tuple(corners), tuple(rises)
        meets = {i: float((beta[at] - beta[i]) / (alpha[i] - alpha[at])) for i in steeper}
        corner = min(meets.values())
        following = max((i for i in steeper if meets[i] == corner), key=lambda i: alpha[i])
        corners.append(corner + 0.0)
        rises.append(float(alpha[following] - alpha[at]))
        at = following


def corners_of(bends: Iterable[Bend]) -> tuple[float, ...]:
    """Return the corners of all of them, in order."""
    return tuple(sorted({corner for bend in bends for corner in bend.corners}))


BoundsByHand: TypeAlias = dict[str, Interval]
"""Of all controls, by the path constraint that says them."""


def bounds_by_hand(leg: Phase, domain: Domain) -> BoundsByHand:
    """Return the bounds of controls that path constraints with kinks amount to, and nothing else."""
    symbols = ca.vertsplit(leg.model.symbols("control"))
    controls = {place: symbols[place] for place in stated_controls(leg).values()}
    found = {name: _part_bounds(c, controls, free(len(symbols)), domain) for name, c in leg.paths.items()}
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


def _part_bounds(
    constraint: Constraint, controls: dict[int, Any], box: Interval, domain: Domain
) -> Interval | None:
    for i, row in enumerate(rows_of(constraint.expression)):
        sense = limited_sense(constraint, i)
        own = pieces(row, sense, domain) if sense and not is_smooth(row) else None
        if own is None:
            return None
        limit = constraint.interval.upper[i] if sense > 0 else constraint.interval.lower[i]
        for piece in own:
            place, slope, offset = _affine_piece(piece, controls)
            if place is None:
                return None
            end = (limit - offset) / slope
            if sense * slope > 0:
                box.upper[place] = min(box.upper[place], end)
            else:
                box.lower[place] = max(box.lower[place], end)
    return box if np.all(box.lower <= box.upper) else None


def _affine_piece(piece: Any, controls: dict[int, Any]) -> tuple[int | None, float, float]:
    """Return the control that a piece is an affine function of alone, its slope and the rest; None if it is not."""
    own = ca.symvar(piece)
    place = next((i for i, u in controls.items() if len(own) == 1 and ca.is_equal(own[0], u)), None)
    if place is None or not is_affine(piece, own[0]):
        return None, 0.0, 0.0
    rest = ca.substitute(piece, own[0], 0.0)
    slope, offset = drawn(ca.vertcat(ca.jacobian(piece, own[0]), rest))[:, 0]
    return place, float(slope), float(offset)


@dataclass(frozen=True, eq=False)
class Bends:
    """The bends of integrals that splitting controls removes, by integral, and corners by the place of the control."""

    at: dict[str, list[Bend]]
    corners: dict[int, tuple[float, ...]]

    @classmethod
    def of(cls, problem: Statement, leg: Phase, domain: Domain) -> Bends:
        """Find those of controls all of whose components bend a cost, at as many corners each."""
        symbols = ca.vertsplit(leg.model.symbols("control"))
        controls = {i: symbols[i] for i in stated_controls(leg).values()}

        def bends(kinks: list[Extremum]) -> list[Bend]:
            tried = (Bend.of(k.node, k.sense, k.pieces, controls, domain) for k in kinks)
            return [bend for bend in tried if bend is not None]

        pushed = {name: bends(kinks) for name, kinks in kinks_that_cost(problem, leg, domain).items()}
        corners = _control_corners(leg.model.controls, [bend for own in pushed.values() for bend in own])
        kept = {
            name: [b for b in own if set(b.corners) <= set(corners.get(b.place, ()))]
            for name, own in pushed.items()
        }
        return cls({name: own for name, own in kept.items() if own}, corners)

    @property
    def key(self) -> tuple[Any, ...]:
        """The same for the same form."""
        return tuple((name, *(b.node.element_hash() for b in own)) for name, own in self.at.items())


def _control_corners(layout: Layout, bends: list[Bend]) -> dict[int, tuple[float, ...]]:
    """Return the corners of controls all of whose components have as many, by the places of those."""
    corners: dict[int, tuple[float, ...]] = {}
    for v in layout.variables:
        places = range(*layout.slice(v.name).indices(layout.size))
        own = {i: corners_of(bend for bend in bends if bend.place == i) for i in places}
        if all(own.values()) and len({len(found) for found in own.values()}) == 1:
            corners |= own
    return corners


@dataclass(frozen=True, eq=False)
class SplitForm(PhaseForm):
    """A phase with split controls in place of some controls."""

    controls: tuple[SplitControl, ...]

    @classmethod
    def of(cls, leg: Phase, bends: Bends) -> SplitForm:
        """Restate a phase in the parts of the controls that bend."""
        old, layout = leg.model, leg.model.controls
        parts: dict[str, list[Symbol]] = {}
        splits, instead, beyond = [], {}, {}
        for v in layout.variables:
            places = range(*layout.slice(v.name).indices(layout.size))
            if places[0] not in bends.corners:
                continue
            corners = tuple(zip(*(bends.corners[i] for i in places), strict=True))
            *plus, minus = parts[v.name] = _part_symbols(old, v, len(corners))
            own = SplitControl(v, tuple(p.variable.name for p in parts[v.name]), corners)
            splits.append(own)
            for i, symbol in enumerate(ca.vertsplit(old.symbol(v.name))):
                beyond[places[i]] = {
                    corner[i]: sum(p[i] for p in plus[k:]) for k, corner in enumerate(corners)
                }
                instead[symbol.element_hash()] = _part_value(corners[0][i], [p[i] for p in plus], minus[i])

        def split(expression: Any) -> Any:
            return replaced(expression, instead)

        symbols = ca.vertsplit(old.symbols("control"))

        def straight(name: str, expression: Any) -> Any:
            known = {
                b.node.element_hash(): b.expressed(symbols[b.place], beyond[b.place])
                for b in bends.at.get(name, ())
            }
            return split(replaced(expression, known))

        lengths = {v.length for v in leg.vectors}
        stated = ca.vertcat(*(old.symbol(c.name) for c in splits))
        return cls(
            old.in_controls(
                list(_new_controls(old, parts)),
                [(c, split(ca.SX(old.symbol(c.name)))) for c in splits],
                split,
            ),
            {
                name: c if name in lengths or not c.size else replace(c, expression=split(c.expression))
                for name, c in leg.paths.items()
            },
            {name: (symbol, straight(name, e)) for name, (symbol, e) in leg.integrands.items()},
            Restatement(
                old,
                stated,
                split(stated),
                _part_expressions(old, splits),
                tuple(map(_given_value, splits)),
            ),
            tuple(splits),
        )

    def apply(self, leg: Phase) -> None:
        """Give a phase this form with its own numbers."""
        old, new, numbers = leg.model, self.model.controls, leg.numbers
        box, scales = free(new.size), dict(numbers.scales)
        for name in new.names:
            if name in old.controls:
                place, there = new.slice(name), old.controls.slice(name)
                box.lower[place], box.upper[place] = (
                    numbers.controls.lower[there],
                    numbers.controls.upper[there],
                )
        for control in self.controls:
            there = old.controls.slice(control.name)
            lower, upper = (
                control.decompose(end[there][:, None])
                for end in (numbers.controls.lower, numbers.controls.upper)
            )
            *least, most_minus = lower
            *most, least_minus = upper
            for part, low, high in zip(
                control.parts, (*least, least_minus), (*most, most_minus), strict=True
            ):
                box.lower[new.slice(part)], box.upper[new.slice(part)] = low[:, 0], high[:, 0]
                if control.name in scales:
                    scales[part] = scales[control.name]
            scales.pop(control.name, None)
        self.give(leg, replace(numbers, controls=box, scales=scales))


def _part_value(corner: float, plus: list[Any], minus: Any) -> Any:
    total = sum(plus[1:], plus[0]) - minus
    return corner + total if corner else total


def _given_value(control: SplitControl) -> str:
    *plus, minus = control.parts
    first = control.corners[0]
    corner = f"{', '.join(f'{c:g}' for c in first)} + " if any(first) else ""
    return f"{control.name} is solved for as {corner}{' + '.join(plus)} - {minus}, parted where its cost has kinks"


def _part_symbols(model: Model, variable: Variable, corners: int) -> list[Symbol]:
    """Return the symbols of the parts beyond each corner, and below the first one."""

    def part(what: str) -> Symbol:
        return Symbol(replace(variable, name=free_name(model, f"{variable.name}_{what}")))

    return [*(part("plus" if k == 0 else f"plus_{k + 1}") for k in range(corners)), part("minus")]


def _part_expressions(model: Model, splits: list[SplitControl]) -> Any:
    """Return the new controls in terms of the old ones."""
    own = {c.name: c for c in splits}
    values: list[Any] = []
    for v in model.controls.variables:
        symbol = ca.SX(model.symbol(v.name))
        values += [*own[v.name].decompose_symbol(symbol)] if v.name in own else [symbol]
    return ca.vertcat(*values)


def _new_controls(model: Model, parts: dict[str, list[Symbol]]) -> Iterator[Symbol]:
    for v in model.controls.variables:
        yield from parts.get(v.name, [model.symbol(v.name)])
