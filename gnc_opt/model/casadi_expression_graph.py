"""CasADi expressions: traversal and substitution of the graph, smooth functions, functions of a vector's norm."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.argument_checks import read_positive_number
from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import EQUAL


def iterate_subexpressions(expression: Any) -> Iterator[Any]:
    """Yield every scalar node of an expression once, results before their operands."""
    seen: set[int] = set()
    waiting = list(reversed(ca.vertsplit(ca.densify(ca.vec(expression)))))
    while waiting:
        node = waiting.pop()
        place = node.element_hash()
        if place not in seen:
            seen.add(place)
            yield node
            waiting += [node.dep(i) for i in range(node.n_dep())]


def replace_subexpressions(expression: Any, replacement: Callable[[Any], Any | None]) -> Any:
    """Return a column with nodes replaced by ``replacement(node)``; for None the operands of the node are visited."""
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
                new = _rebuild_operation_with_operands(
                    node, operands, [done[o.element_hash()] for o in operands]
                )
            done[place] = new
        waiting.pop()
    return ca.vertcat(*(done[e.element_hash()] for e in elements)) if elements else expression


def replace_subexpressions_by_hash(expression: Any, instead: Mapping[int, Any]) -> Any:
    """Return a column with nodes replaced according to their hashes, see `replace_subexpressions`."""
    return replace_subexpressions(expression, lambda node: instead.get(node.element_hash()))


def _rebuild_operation_with_operands(node: Any, old: list[Any], new: list[Any]) -> Any:
    if all(a.element_hash() == b.element_hash() for a, b in zip(old, new, strict=True)):
        return node
    return ca.SX.unary(node.op(), *new) if len(new) == 1 else ca.SX.binary(node.op(), *new)


def collect_casadi_operation_codes(expression: Any) -> set[int]:
    """Return the operation codes (``casadi.OP_...``) in an expression; much faster than `iterate_subexpressions`."""
    function = ca.Function("operations", [ca.vertcat(*ca.symvar(expression))], [expression])
    return {function.instruction_id(i) for i in range(function.n_instructions())}


def contains_nan_constant(expression: Any) -> bool:
    function = ca.Function("constants", [ca.vertcat(*ca.symvar(expression))], [expression])
    places = (i for i in range(function.n_instructions()) if function.instruction_id(i) == ca.OP_CONST)
    return any(math.isnan(function.instruction_constant(i)) for i in places)


def smooth_abs(x: Any, width: float) -> Any:
    """Return a smooth approximation of the absolute value of each component, ``sqrt(x^2 + width^2) - width``.

    This is the pseudo-Huber function (R. Hartley and A. Zisserman, Multiple View Geometry, Cambridge 2003, A6.8). It is
    0 at 0 with curvature 1 / width, and at most ``width`` less than the absolute value.

    Parameters
    ----------
    x : casadi.SX or float
    width : float
        In the unit of x, > 0.

    Raises
    ------
    ArgumentError
        The width is not a positive number.

    Examples
    --------
    >>> print(f"{float(go.smooth_abs(-3.0, 1e-3)):.6f} {float(go.smooth_abs(0.0, 1e-3)):.6f}")
    2.999000 0.000000
    """
    small = read_positive_number(width, "the width of smooth_abs()")
    return ca.sqrt(x**2 + small**2) - small


ROOTS = (ca.OP_SQRT, ca.OP_HYPOT)
"""Operations that are not differentiable at a zero vector."""

JUMPS = (
    *(ca.OP_SIGN, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD, ca.OP_REMAINDER),
    *(ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE),
)
"""Operations with jumps, which neither derivatives nor numerical tests reveal."""

_LENGTHS = np.array([0.7, 1.3, 2.1])
_DIRECTIONS, _PROBE_DRAWS, _SEED = 3, 3, 20


@dataclass(frozen=True, eq=False)
class NormNodes:
    """Nodes that are homogeneous functions of the norm of a vector."""

    vector: Any
    degrees: dict[int, int]

    @classmethod
    def find_vector_norms(cls, expression: Any, vector: Any) -> NormNodes:
        """Return these nodes of an SX column."""
        nodes = _find_subexpressions_smooth_in_vector(expression, vector)
        if not nodes:
            return cls(vector, {})
        values = _sample_subexpressions_along_directions(ca.vertcat(*nodes), vector)
        degrees = {
            n.element_hash(): d for n, d in zip(nodes, _find_homogeneity_degrees(values), strict=True) if d
        }
        return cls(vector, degrees)

    def replace_vector_norms(self, expression: Any, norm: Any, instead: Mapping[int, Any]) -> Any:
        """Return a column with the norm of the vector replaced by a symbol >= 0, and other nodes by hash."""
        unit = ca.SX([1.0] + [0.0] * (self.vector.numel() - 1))

        def find_subexpression_replacement(node: Any) -> Any | None:
            place = node.element_hash()
            degree = self.degrees.get(place)
            if degree is None:
                return instead.get(place)
            factor = ca.substitute(node, self.vector, unit)
            return factor * (norm if degree == 1 else norm**2)

        return replace_subexpressions(expression, find_subexpression_replacement)


def _find_subexpressions_smooth_in_vector(expression: Any, vector: Any) -> list[Any]:
    leaves = {s.element_hash() for s in ca.vertsplit(vector)}
    depends: dict[int, bool] = {}
    smooth: dict[int, bool] = {}
    found = []
    for node in _sort_subexpressions_topologically(expression):
        place, operands = node.element_hash(), [node.dep(i).element_hash() for i in range(node.n_dep())]
        depends[place] = place in leaves or any(depends[o] for o in operands)
        jumps = depends[place] and node.op() in (*JUMPS, ca.OP_IF_ELSE_ZERO)
        smooth[place] = not jumps and all(smooth[o] for o in operands)
        if depends[place] and smooth[place] and place not in leaves:
            found.append(node)
    return found


def _sort_subexpressions_topologically(expression: Any) -> list[Any]:
    nodes = {node.element_hash(): node for node in iterate_subexpressions(expression)}
    done: dict[int, Any] = {}
    for root in nodes.values():
        waiting = [root]
        while waiting:
            node = waiting[-1]
            missing = [
                nodes[h] for h in (node.dep(i).element_hash() for i in range(node.n_dep())) if h not in done
            ]
            if node.element_hash() in done or not missing:
                done[node.element_hash()] = node
                waiting.pop()
            else:
                waiting += missing
    return list(done.values())


def _sample_subexpressions_along_directions(nodes: Any, vector: Any) -> Array:
    """Return the values (n_nodes, n_directions, n_lengths, n_draws) for several directions and lengths of a vector."""
    own = {s.element_hash() for s in ca.vertsplit(vector)}
    others = [s for s in ca.symvar(nodes) if s.element_hash() not in own]
    function = ca.Function("nodes", [vector, ca.vertcat(*others) if others else ca.SX(0, 1)], [nodes])
    rng = np.random.default_rng(_SEED)
    turned = rng.normal(size=(_DIRECTIONS, vector.numel()))
    turned[:2] = [np.abs(turned[0]), -np.abs(turned[0])]  # both signs, also for a single component
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    rest = rng.uniform(0.5, 1.5, (_PROBE_DRAWS, len(others))) * rng.choice(
        [-1.0, 1.0, 1.0], (_PROBE_DRAWS, len(others))
    )
    vectors = np.einsum("di,l->dli", turned, _LENGTHS).reshape(-1, vector.numel())
    columns = [function(vectors.T, np.tile(other[:, None], vectors.shape[0])).full() for other in rest]
    return np.stack(columns, axis=-1).reshape(nodes.numel(), _DIRECTIONS, _LENGTHS.size, _PROBE_DRAWS)


def _find_homogeneity_degrees(values: Array) -> list[int]:
    """Return the degree of homogeneity, 1 or 2, of each rotation-invariant row; 0 for other rows."""
    with np.errstate(all="ignore"):
        known = np.all(np.isfinite(values) & (values != 0), axis=(1, 2))
        turned = np.abs(values / values[:, :1] - 1)
        alike = np.all((turned < EQUAL) | ~known[:, None, None], axis=(1, 2, 3))
        degrees = np.zeros(values.shape[0], dtype=int)
        for degree in (1, 2):
            expected = (_LENGTHS / _LENGTHS[0]) ** degree
            grown = np.abs(values / values[:, :, :1] / expected[:, None] - 1)
            scaled = np.all((grown < EQUAL) | ~known[:, None, None], axis=(1, 2, 3))
            degrees[scaled & alike & np.any(known, axis=1)] = degree
    return [int(d) for d in degrees]
