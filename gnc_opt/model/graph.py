"""The graph of a CasADi SX expression: its operations one by one."""

from __future__ import annotations

import math
from collections.abc import Iterator
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


def operations_in(expression: Any) -> set[int]:
    """Return the codes of the operations (``casadi.OP_...``) in an expression; much faster than `nodes_of`."""
    function = ca.Function("operations", [ca.vertcat(*ca.symvar(expression))], [expression])
    return {function.instruction_id(i) for i in range(function.n_instructions())}


def holds_nan(expression: Any) -> bool:
    """Whether a constant in an expression is not a number."""
    function = ca.Function("constants", [ca.vertcat(*ca.symvar(expression))], [expression])
    places = (i for i in range(function.n_instructions()) if function.instruction_id(i) == ca.OP_CONST)
    return any(math.isnan(function.instruction_constant(i)) for i in places)
