"""What a phase makes of one control alone: its dead zones, and where it is saturated.

A control u acts on the rates by functions of u alone, :math:`z(u)`, in which the rates are affine. Between their
corners these are smooth; where none of them changes, u does nothing but cost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.model.expressions import nodes_of, rebuilt, replaced
from gnc_opt.planning.problem.interval_arithmetic import Domain, drawn
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.reformulation.epigraph import integral_senses
from gnc_opt.planning.problem.statement import Statement
from gnc_opt.tolerances import EQUAL

Span = tuple[float, float]

_BETWEEN = (ca.OP_FMAX, ca.OP_FMIN)
_COMPARED = (ca.OP_LT, ca.OP_LE)
_ALONE = (ca.OP_FABS, ca.OP_SIGN)

_PROBES = (-1e3, -10.0, -1.0, -0.1, 0.1, 1.0, 10.0, 1e3)


@dataclass(frozen=True, eq=False)
class Acting:
    """How a control acts on a phase.

    Attributes
    ----------
    u : casadi.SX
        Its symbol, a scalar.
    rates, costs : list of casadi.SX
        The largest expressions of u alone in the rates, and in the integrands.
    corners : tuple of float
        Of those in the rates, in order.
    cost_corners : tuple of float or None
        Of those in the integrands; None if these are not known.
    slope : casadi.SX
        Of all that costs, by u.
    """

    u: Any
    rates: list[Any]
    costs: list[Any]
    corners: tuple[float, ...]
    cost_corners: tuple[float, ...] | None
    slope: Any

    @classmethod
    def of(cls, problem: Statement, leg: Phase, u: Any) -> Acting | None:
        """Return how a control acts; None if not by corners at numbers, or not in this way, or limited otherwise."""
        rates, integrands = leg.model.derivative(), leg.integrand_expression()
        if ca.depends_on(leg.path_expression(), u):
            return None
        own = outermost_of(rates, u)
        corners = None if all(_is_kinkless(z) for z in own) else _corners(own, u)
        costs = outermost_of(integrands, u)
        if not corners or not (_is_affine_in(rates, own, u) and _is_affine_in(integrands, costs, u)):
            return None
        senses, slope = integral_senses(problem, leg), ca.SX(0)
        for name, (_, integrand) in leg.integrands.items():
            if ca.depends_on(integrand, u):
                if senses[name] == 0:
                    return None
                slope += senses[name] * ca.jacobian(integrand, u)
        cost_corners = _corners(costs, u) if costs else set()
        return cls(
            u,
            own,
            costs,
            tuple(sorted(corners)),
            None if cost_corners is None else tuple(cost_corners),
            slope,
        )

    @property
    def nodes(self) -> list[Any]:
        """All expressions of it alone."""
        return [*self.rates, *self.costs]

    def spans(self, lower: float, upper: float) -> list[Span]:
        """Return from where to where the rates are smooth, between bounds."""
        inside = [c for c in self.corners if lower < c < upper]
        return [*pairwise((lower, *inside, upper))]

    def does_nothing(self, span: Span) -> bool:
        """Whether the rates do not change in a span."""
        return not any(ca.depends_on(branch(z, self.u, inner(span)), self.u) for z in self.rates)

    def rises(self, at: float, domain: Domain) -> int:
        """Return 1 where the cost rises with u beyond a number, -1 where it falls before it, 2 where it is least there.

        0 if nothing of this is known.
        """
        curvature = ca.jacobian(self.slope, self.u)
        if curvature.nnz() and domain.sign(curvature) <= 0:
            return 0
        here, *along = (replaced(self.slope, {self.u.element_hash(): ca.SX(at + k)}) for k in (0.0, *_PROBES))
        if np.any(np.diff(drawn(ca.vertcat(*along)), axis=0) < -EQUAL):  # kinks that are not convex
            return 0
        if np.all(np.abs(drawn(here)) < EQUAL):
            return 2
        return domain.sign(here)

    def on(self, z: Any, span: Span) -> Any:
        """Return an expression of the control in a span, without kinks if it has none there."""
        known = self.cost_corners
        kinked = known is None or any(span[0] < corner < span[1] for corner in known)
        return z if kinked and not any(z is own for own in self.rates) else branch(z, self.u, inner(span))

    def values(self, at: float) -> Array:
        """Return what acts on the rates at a number."""
        function = ca.Function("values", [self.u], [ca.vertcat(*self.rates)])
        return np.asarray(function(at).full()[:, 0])


def outermost_of(column: Any, u: Any) -> list[Any]:
    """Return the largest expressions in a column that depend on a scalar symbol, and on no other one."""
    found: dict[int, Any] = {}
    seen: set[int] = set()
    waiting = ca.vertsplit(ca.densify(column)) if column.numel() else []
    while waiting:
        node = waiting.pop()
        if node.element_hash() in seen or not ca.depends_on(node, u):
            continue
        seen.add(node.element_hash())
        if len(ca.symvar(node)) == 1:
            found[node.element_hash()] = node
        else:
            waiting += [node.dep(i) for i in range(node.n_dep())]
    return list(found.values())


def branch(expression: Any, u: Any, at: float) -> Any:
    """Return what an expression of u alone is in the neighbourhood of a number, without its kinks there."""

    def chosen(node: Any) -> Any | None:
        operation = node.op()
        if operation in _ALONE:
            sign = float(np.sign(_at(node.dep(0), u, at)))
            return ca.SX(sign) if operation == ca.OP_SIGN else sign * branch(node.dep(0), u, at)
        if operation in _BETWEEN:
            larger = _at(node.dep(0), u, at) > _at(node.dep(1), u, at)
            return branch(node.dep(0 if larger == (operation == ca.OP_FMAX) else 1), u, at)
        if operation == ca.OP_IF_ELSE_ZERO:
            return branch(node.dep(1), u, at) if _at(node.dep(0), u, at) else ca.SX(0)
        return None

    return rebuilt(expression, chosen)


def inner(span: Span) -> float:
    """Return a number within a span."""
    lower, upper = span
    if np.isfinite(lower) and np.isfinite(upper):
        return 0.5 * (lower + upper)
    return lower + 1.0 if np.isfinite(lower) else upper - 1.0 if np.isfinite(upper) else 0.0


def _at(expression: Any, u: Any, value: float) -> float:
    return float(ca.Function("at", [u], [expression])(value))


def _gap(node: Any) -> Any | None:
    """What vanishes where a node has its corner; None if it has none."""
    if node.op() in _ALONE:
        return node.dep(0)
    return node.dep(0) - node.dep(1) if node.op() in (*_BETWEEN, *_COMPARED) else None


def _is_kinkless(expression: Any) -> bool:
    return all(_gap(node) is None for node in nodes_of(expression))


def _corners(expressions: list[Any], u: Any) -> set[float] | None:
    """Return where expressions of u alone have corners; None if these are no roots of affine pieces."""
    corners: set[float] = set()
    for node in reversed([*nodes_of(ca.vertcat(*expressions))]):  # operands before what is made of them
        gap = _gap(node)
        if gap is None or not ca.depends_on(gap, u):
            continue
        roots = _roots(ca.Function("gap", [u], [gap]), sorted(corners))
        if roots is None:
            return None
        corners |= roots
    return corners


def _roots(function: Callable[[float], Any], corners: list[float]) -> set[float] | None:
    """Return where a function that is affine between corners vanishes; None if it is not affine."""
    found: set[float] = set()
    for span in pairwise((-np.inf, *corners, np.inf)):
        middle = inner(span)
        half = min(0.5, 0.25 * (span[1] - span[0]))
        left, value, right = (float(function(middle + k * half)) for k in (-1, 0, 1))
        slope = (right - left) / (2 * half)
        if abs(left + right - 2 * value) > EQUAL * max(1.0, abs(left), abs(right)):
            return None
        root = middle - value / slope if slope else np.nan
        if span[0] <= root <= span[1]:
            found.add(next((c for c in corners if abs(c - root) < EQUAL * max(1.0, abs(c))), root + 0.0))
    return found


def _is_affine_in(column: Any, nodes: list[Any], u: Any) -> bool:
    """Whether a column is affine in nodes of it, and depends on u by them alone."""
    if not nodes:
        return True
    z = ca.SX.sym("z", len(nodes))
    of_z = replaced(column, {node.element_hash(): z[i] for i, node in enumerate(nodes)})
    return not ca.depends_on(of_z, u) and not any(ca.which_depends(of_z, z, 2, True))
