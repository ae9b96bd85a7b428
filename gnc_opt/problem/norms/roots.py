r"""Upper limits of roots that may vanish, without the root.

:math:`\sqrt{S} \le c` holds where :math:`S / (2 c) + c / 2 \le c` does. Both sides and their gradients are the same at
the limit, hence multipliers too; but the root has no derivative where S is zero, as the speed of what is at rest.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.model.graph import nodes_of, rebuilt
from gnc_opt.problem.constraint import Constraint
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.norms.limits import limits_of
from gnc_opt.problem.phase import Phase


def without_roots(leg: Phase) -> dict[str, Constraint]:
    """Return those constraints of a phase that have rows ``root <= c``, as they are without the root."""
    changed = {}
    for name, c in leg.paths.items():
        rows = [
            _without_root(row, Interval(c.interval.lower[i : i + 1], c.interval.upper[i : i + 1]))
            for i, row in enumerate(ca.vertsplit(c.expression))
        ]
        if any(row is not None for row in rows):
            kept = ca.vertsplit(c.expression)
            both = [old if new is None else new for new, old in zip(rows, kept, strict=True)]
            changed[name] = replace(c, expression=ca.vertcat(*both))
    return changed


def _without_root(row: Any, limits: Interval) -> Any | None:
    """Return a row that is a function of a root alone, with a limit from above, without it; else None."""
    root = next((node for node in nodes_of(row) if node.op() in (ca.OP_SQRT, ca.OP_HYPOT)), None)
    if root is None:
        return None
    place, size = root.element_hash(), ca.SX.sym("size")
    of_size = rebuilt(row, lambda node: size if node.element_hash() == place else None)
    found = limits_of(of_size, size, limits)
    if found is None or found[0] > 0 or not (0 < found[1] < np.inf) or not _vanishes(root):
        return None
    square = root.dep(0) if root.op() == ca.OP_SQRT else root.dep(0) ** 2 + root.dep(1) ** 2
    tangent = square / (2 * found[1]) + found[1] / 2
    return rebuilt(row, lambda node: tangent if node.element_hash() == place else None)


def _vanishes(root: Any) -> bool:
    """Whether a root is zero where everything is."""
    symbols = ca.vertcat(*ca.symvar(root))
    return float(ca.Function("root", [symbols], [root])(np.zeros(symbols.numel()))) == 0
