"""Kinks as the largest or least of smooth pieces: ``fabs(e)`` of e and -e, ``fmax(a, b)``, sums of these and so on."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from gnc_opt.model.graph import nodes_of
from gnc_opt.problem.norms.domain import Domain, drawn, is_affine
from gnc_opt.problem.norms.table_lines import lines_of
from gnc_opt.tolerances import EQUAL

KINKED = (ca.OP_FABS, ca.OP_FMAX, ca.OP_FMIN, ca.OP_IF_ELSE_ZERO)
"""Operations by which kinks are written."""

MOST = 16
"""Pieces of a kink: a sum of four absolute values has as many."""

Pieces: TypeAlias = list[Any]


def is_smooth(expression: Any) -> bool:
    """Whether an expression holds no operation of `KINKED`."""
    return not any(node.op() in KINKED for node in nodes_of(expression))


def outermost(expression: Any, ignored: frozenset[int], domain: Domain) -> list[Any]:
    """Return the kinks of a scalar expression that are in no other one.

    Parameters
    ----------
    expression : casadi.SX
    ignored : frozenset of int
        Hashes of nodes that are left alone: those of tables.
    domain : Domain
    """
    found: dict[int, Any] = {}
    seen: set[int] = set()
    waiting = [expression]
    while waiting:
        node = waiting.pop()
        place = node.element_hash()
        if place in seen or place in ignored:
            continue
        seen.add(place)
        if _extremum(node, domain) is not None:
            found[place] = node
        else:
            waiting += [node.dep(i) for i in range(node.n_dep())]
    return list(found.values())


def pieces(node: Any, sense: int, domain: Domain) -> Pieces | None:
    """Return smooth expressions of which a node is the largest (sense 1) or the least (-1); None if it is of none."""
    found = _pieces(node, sense, domain)
    return None if found is None or len(found) > MOST else _without_dominated(found, sense)


def _pieces(node: Any, sense: int, domain: Domain) -> Pieces | None:
    if is_smooth(node):
        return [node]
    extremum = _extremum(node, domain)
    if extremum is not None:
        own, operands = extremum
        if own != sense:
            return None
        if node.op() == ca.OP_FABS and domain.surely().sign(operands[0]) > 0:
            operands = operands[:1]
        return _union([_pieces(operand, sense, domain) for operand in operands])
    operation = node.op()
    if operation == ca.OP_NEG:
        return _scaled(_pieces(node.dep(0), -sense, domain), -1)
    if operation == ca.OP_TWICE:
        return _scaled(_pieces(node.dep(0), sense, domain), 2)
    if operation in (ca.OP_ADD, ca.OP_SUB):
        sign = 1 if operation == ca.OP_ADD else -1
        left, right = _pieces(node.dep(0), sense, domain), _pieces(node.dep(1), sign * sense, domain)
        if left is None or right is None or len(left) * len(right) > MOST:
            return None
        return [a + sign * b for a, b in product(left, right)]
    if operation in (ca.OP_MUL, ca.OP_DIV):
        return _times(node, sense, domain)
    return None


def _times(node: Any, sense: int, domain: Domain) -> Pieces | None:
    """Of a product or quotient of a kink and a smooth factor of known sign."""
    kink, factor = node.dep(0), node.dep(1)
    if node.op() == ca.OP_MUL and not is_smooth(factor):
        kink, factor = factor, kink
    sign = domain.sign(factor) if is_smooth(factor) else 0
    if sign == 0:
        return None
    return _scaled(_pieces(kink, sign * sense, domain), 1 / factor if node.op() == ca.OP_DIV else factor)


def _union(lists: list[Pieces | None]) -> Pieces | None:
    found: dict[int, Any] = {}
    for one in lists:
        if one is None:
            return None
        found |= {e.element_hash(): e for e in one}
    return list(found.values())


def _scaled(found: Pieces | None, factor: Any) -> Pieces | None:
    return None if found is None else [factor * e for e in found]


def _extremum(node: Any, domain: Domain) -> tuple[int, Pieces] | None:
    """Return 1 for a largest value, -1 for a least one, and of what; None if a node is neither."""
    use = domain.tables.get(node.element_hash())
    if use is not None:
        return lines_of(use, domain)
    operation = node.op()
    if operation == ca.OP_FABS:
        return 1, [node.dep(0), -node.dep(0)]
    if operation == ca.OP_FMAX:
        return 1, [node.dep(0), node.dep(1)]
    if operation == ca.OP_FMIN:
        return -1, [node.dep(0), node.dep(1)]
    return _chosen(node, domain) if operation == ca.OP_ADD else None


def _chosen(node: Any, domain: Domain) -> tuple[int, Pieces] | None:
    """``if_else(a < b, ...)`` that is continuous, and bends where a = b, is the larger or the smaller of its values."""
    first, second = node.dep(0), node.dep(1)
    if first.op() != ca.OP_IF_ELSE_ZERO or second.op() != ca.OP_IF_ELSE_ZERO:
        return None
    condition, other = first.dep(0), second.dep(0)
    opposed = other.op() == ca.OP_NOT and other.dep(0).element_hash() == condition.element_hash()
    if not opposed or condition.op() not in (ca.OP_LT, ca.OP_LE):
        return None
    when, otherwise = first.dep(1), second.dep(1)
    gap, rise = condition.dep(1) - condition.dep(0), when - otherwise
    for symbol in ca.symvar(gap):
        if not is_affine(ca.vertcat(gap, rise), symbol):
            continue
        across, up = ca.jacobian(gap, symbol), ca.jacobian(rise, symbol)
        left = drawn(ca.substitute(rise, symbol, meeting(gap, symbol)))
        sense = domain.sign(across) * domain.sign(up)
        if sense != 0 and np.all(np.abs(left) < EQUAL):
            return sense, [when, otherwise]
    return None


def meeting(gap: Any, symbol: Any) -> Any:
    """Return where a scalar that is affine in a symbol vanishes."""
    return -ca.substitute(gap, symbol, 0.0) / ca.jacobian(gap, symbol)


def _without_dominated(found: Pieces, sense: int) -> Pieces:
    """Leave out constants that the larger of e and -e is never below."""
    values = drawn(ca.vertcat(*found))
    opposed = any(np.all(values[i] == -values[j]) for i in range(len(found)) for j in range(i))
    keep = [not (opposed and e.is_constant() and sense * float(e) <= 0) for e in found]
    return [e for e, kept in zip(found, keep, strict=True) if kept]


def rows_of(column: Any) -> Iterator[Any]:
    """Yield the rows of a column, of which there may be none."""
    yield from ca.vertsplit(column) if column.numel() else ()
