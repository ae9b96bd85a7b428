"""The graph of a CasADi SX expression: its operations one by one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import casadi as ca


def nodes_of(expression: Any) -> Iterator[Any]:
    """Yield every scalar node of an expression once, parents before their children."""
    seen: set[int] = set()
    waiting = list(reversed(ca.vertsplit(ca.densify(ca.vec(expression)))))
    while waiting:
        node = waiting.pop()
        place = node.element_hash()
        if place not in seen:
            seen.add(place)
            yield node
            waiting += [node.dep(i) for i in range(node.n_dep())]


def rebuilt(expression: Any, replacement: Callable[[Any], Any | None]) -> Any:
    """Return a column in which nodes are replaced; what is built of none of those stays the node that it is.

    (So calls of tables, which are known by their nodes, are found again; ``casadi.substitute`` makes all nodes anew.)

    Parameters
    ----------
    expression : casadi.SX
        A column.
    replacement : function
        Returns what stands in place of a node, or None: then its operands are looked at.
    """
    done: dict[int, Any] = {}
    elements = ca.vertsplit(ca.densify(expression)) if expression.numel() else []
    waiting = list(elements)
    while waiting:
        node = waiting[-1]
        place = node.element_hash()
        if place not in done:
            operands = [node.dep(i) for i in range(node.n_dep())]
            new = replacement(node)
            if new is None:
                missing = [operand for operand in operands if operand.element_hash() not in done]
                if missing:
                    waiting += missing
                    continue
                new = _same_operation(node, operands, [done[o.element_hash()] for o in operands])
            done[place] = new
        waiting.pop()
    return ca.vertcat(*(done[e.element_hash()] for e in elements)) if elements else expression


def replaced(expression: Any, instead: Mapping[int, Any]) -> Any:
    """Return a column, as `rebuilt` does, with what stands in place of some nodes by their hashes."""
    return rebuilt(expression, lambda node: instead.get(node.element_hash()))


def _same_operation(node: Any, old: list[Any], new: list[Any]) -> Any:
    if all(a.element_hash() == b.element_hash() for a, b in zip(old, new, strict=True)):
        return node
    return ca.SX.unary(node.op(), *new) if len(new) == 1 else ca.SX.binary(node.op(), *new)


def operations_in(expression: Any) -> set[int]:
    """Return the codes of the operations (``casadi.OP_...``) in an expression; much faster than `nodes_of`."""
    function = ca.Function("operations", [ca.vertcat(*ca.symvar(expression))], [expression])
    return {function.instruction_id(i) for i in range(function.n_instructions())}


def holds_nan(expression: Any) -> bool:
    """Whether a constant in an expression is not a number."""
    function = ca.Function("constants", [ca.vertcat(*ca.symvar(expression))], [expression])
    places = (i for i in range(function.n_instructions()) if function.instruction_id(i) == ca.OP_CONST)
    return any(math.isnan(function.instruction_constant(i)) for i in places)
