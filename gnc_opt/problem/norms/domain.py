"""Between which values expressions of a problem lie, and which way they go, as far as its numbers tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array, Mask
from gnc_opt.model.graph import nodes_of, replaced
from gnc_opt.model.table import TableUse
from gnc_opt.problem.interval import Interval, free, intersect
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.ranges import ranges_of
from gnc_opt.problem.statement import Statement
from gnc_opt.problem.tables import along, table_uses

_DRAWS = 6

_QUOTIENTS = (ca.OP_DIV, ca.OP_INV, ca.OP_LOG)
_FACTORS = (ca.OP_MUL, ca.OP_SQ, ca.OP_TWICE, ca.OP_NEG)


@dataclass(frozen=True, eq=False)
class Domain:
    """Symbols and their ranges.

    Attributes
    ----------
    symbols : tuple of casadi.SX
        Columns.
    boxes : tuple of Interval
    stated : tuple of Interval
        Without what is only presumed of states.
    tables : mapping of TableUse
        Calls of linear tables of one axis, by the hashes of their values.
    """

    symbols: tuple[Any, ...]
    boxes: tuple[Interval, ...]
    stated: tuple[Interval, ...]
    tables: Mapping[int, TableUse] = field(default_factory=dict)

    @classmethod
    def along(cls, problem: Statement, leg: Phase) -> Domain:
        """Of what varies along a phase."""
        initial, final = leg.times()
        p = leg.model.parameter_values
        values = Interval(p.copy(), p.copy())
        for name, box in problem.parameter_bounds.items():
            if name in leg.model.parameters:
                place = leg.model.parameters.slice(name)
                values.lower[place], values.upper[place] = box.lower, box.upper
        time, rest = Interval(initial.lower, final.upper), (values, problem.parameter_interval())
        sign, never_zero = _presumed_states(leg), _divisors(problem, leg)
        told = leg.numbers.states
        stated = Interval(
            np.where(never_zero, sign.lower, told.lower), np.where(never_zero, sign.upper, told.upper)
        )
        boxes, surely = ((time, x, leg.numbers.controls, *rest) for x in (sign, stated))
        uses = table_uses(problem, problem.phases[leg.name])
        lines = {
            int(use.value.element_hash()): use
            for use in uses
            if use.table.method == "linear" and len(use.table.grids) == 1
        }
        return cls((*leg.model.arguments(), problem.parameter_symbols()), boxes, surely, lines)

    @classmethod
    def at_ends(cls, problem: Statement) -> Domain:
        """Of end points, times, integrals and free parameters."""
        symbols, boxes = [problem.parameter_symbols()], [problem.parameter_interval()]
        constants: dict[int, tuple[Any, float]] = {}  # phases may share a model
        for leg in problem.phases.values():
            numbers = leg.numbers
            symbols += [leg.initial_time, leg.final_time, leg.ends("initial"), leg.ends("final")]
            boxes += [*leg.times(), intersect(numbers.initial, numbers.states)]
            symbols.append(leg.integral_symbols())
            boxes += [intersect(numbers.final, numbers.states), free(len(leg.integrands))]
            own = zip(ca.vertsplit(leg.model.arguments()[3]), leg.model.parameter_values, strict=True)
            constants |= {s.element_hash(): (s, value) for s, value in own}
        values = np.array([value for _, value in constants.values()])
        symbols.append(ca.vertcat(*(s for s, _ in constants.values())) if constants else ca.SX(0, 1))
        every = (*boxes, Interval(values, values))
        return cls(tuple(symbols), every, every)

    @property
    def key(self) -> bytes:
        """The same for the same numbers."""
        return b"".join(box.lower.tobytes() + box.upper.tobytes() for box in self.boxes)

    def ranges(self, column: Any) -> Interval:
        """Return the ranges of a column."""
        return ranges_of(ca.Function("ranges", self.symbols, [ca.densify(column)]), self.boxes)

    def directions(self, expression: Any, nodes: list[Any]) -> list[int]:
        """Return 1 for nodes with which a scalar expression never falls, -1 if it never rises, else 0."""
        z = ca.SX.sym("z", len(nodes))
        place = {node.element_hash(): z[i] for i, node in enumerate(nodes)}
        of_z = replaced(expression, place)
        boxes = (*self.boxes, self.ranges(ca.vertcat(*nodes)))
        within = Domain((*self.symbols, z), boxes, boxes)
        slopes = within.ranges(ca.jacobian(of_z, z).T)
        return [
            1 if low >= 0 else -int(high <= 0) for low, high in zip(slopes.lower, slopes.upper, strict=True)
        ]

    def surely(self) -> Domain:
        """Return the domain without what is only presumed."""
        return Domain(self.symbols, self.stated, self.stated, self.tables)

    def sign(self, expression: Any) -> int:
        """Return 1 for a scalar that is never negative, -1 for one that is never positive, else 0."""
        found = self.ranges(expression)
        if found.lower[0] >= 0 or found.upper[0] <= 0:
            return 1 if found.lower[0] >= 0 else -1
        if expression.is_symbolic():
            return 0
        for symbol in ca.symvar(
            expression
        ):  # a factor that occurs twice hides from intervals: v / 0.8 - 0.8 v
            if is_affine(expression, symbol) and not np.any(drawn(ca.substitute(expression, symbol, 0.0))):
                return self.sign(symbol) * self.sign(ca.jacobian(expression, symbol))
        return 0


def is_affine(column: Any, symbol: Any) -> bool:
    """Whether all of a column is affine in a scalar symbol."""
    return not any(ca.which_depends(column, symbol, 2, True))


def drawn(column: Any) -> Array:
    """Return the values of a column, (n, n_draws), for some values of all of its symbols."""
    symbols = ca.vertcat(*ca.symvar(column))
    rng = np.random.default_rng(20)
    size = (symbols.numel(), _DRAWS)
    values = rng.uniform(0.5, 1.5, size) * np.where(rng.random(size) < 0.4, -1.0, 1.0)
    function = ca.Function("drawn", [symbols if symbols.numel() else ca.SX(0, 1)], [ca.densify(column)])
    return np.asarray(
        function(values).full() if symbols.numel() else np.tile(function(np.zeros(0)).full(), _DRAWS)
    )


def _divisors(problem: Statement, leg: Phase) -> Mask:
    """Which states something is divided by along a phase, so that they keep their signs."""

    def find() -> Mask:
        found: set[int] = set()
        waiting = [node.dep(node.n_dep() - 1) for node in nodes_of(along(leg)) if node.op() in _QUOTIENTS]
        while waiting:
            node = waiting.pop()
            if node.is_symbolic():
                found.add(node.element_hash())
            elif node.op() in _FACTORS:
                waiting += [node.dep(i) for i in range(node.n_dep())]
        return np.array([s.element_hash() in found for s in ca.vertsplit(leg.model.symbols("state"))])

    return problem.once(("divisors", leg.name), find)


def _presumed_states(leg: Phase) -> Interval:
    """The bounds of states; those without any keep the sign that both ends have, as masses do."""
    box, numbers = leg.numbers.states, leg.numbers
    known = np.stack([numbers.initial.lower, numbers.initial.upper, numbers.final.lower, numbers.final.upper])
    told = np.where(np.isfinite(known), known, 0.0)
    above = np.all(told >= 0, axis=0) & np.any(told > 0, axis=0)
    below = np.all(told <= 0, axis=0) & np.any(told < 0, axis=0)
    return Interval(
        np.where(above, np.maximum(box.lower, 0.0), box.lower),
        np.where(below, np.minimum(box.upper, 0.0), box.upper),
    )
