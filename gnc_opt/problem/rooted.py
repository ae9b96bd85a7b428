"""Controls of which a problem takes roots, powers or logarithms: what has no derivatives where they are zero.

A rotor's lift pays by its power 3/2, whose second derivative is infinite at lift 0. A solver that stays between the
bounds does not see it. Where a control is held on the bound it does, and cannot begin: there it is held a trace inside.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from gnc_opt.arrays import Mask
from gnc_opt.model.graph import nodes_of, operations_in
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.statement import Statement

ROOTED = {ca.OP_SQRT, ca.OP_POW, ca.OP_CONSTPOW, ca.OP_LOG, ca.OP_ASIN, ca.OP_ACOS}

TRACE = 1e-14
"""Share of the range of a control that it is held inside of its bounds: less than anything that is measured."""


def reachable_bounds(problem: Statement, leg: Phase) -> Interval:
    """Return the bounds of a phase's controls, a trace inside of them for controls of which roots are taken."""
    bounds = leg.numbers.controls
    rooted = problem.once(("rooted controls", leg.name), lambda: _rooted_controls(problem, leg))
    width = bounds.upper - bounds.lower
    step = np.where(rooted & np.isfinite(width), TRACE * width, 0.0)
    return Interval(bounds.lower + step, bounds.upper - step)


def _rooted_controls(problem: Statement, leg: Phase) -> Mask:
    """Return which controls are within a root, a power or a logarithm."""
    found = np.zeros(leg.model.controls.size, dtype=bool)
    parts = leg.model.derivative(), leg.path_expression(), leg.integrand_expression()
    rows = problem.bind(leg, ca.vertcat(*parts))
    if not operations_in(rows) & ROOTED:
        return found
    u = leg.model.arguments()[2]
    for node in nodes_of(rows):
        if node.op() in ROOTED:
            found[ca.jacobian_sparsity(node.dep(0), u).get_col()] = True
    return found
