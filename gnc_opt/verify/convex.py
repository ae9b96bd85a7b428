"""Convex problems: their first-order conditions suffice for a global minimum.

With fixed times, dynamics, path constraints and end conditions that are affine in states, controls and
parameters, and a convex cost, every extremal is a global minimum (O. L. Mangasarian, Sufficient conditions for the
optimal control of nonlinear systems, SIAM J. Control 4, 1966, 139-152). Nothing curves downwards then, although
the program on a mesh whose boundaries move is not convex.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.problem.kinks import has_kinks
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.problem import Problem
from gnc_opt.tolerances import ROUNDING


def is_convex(problem: Problem) -> bool:
    """Whether a problem is convex in its trajectory, as far as constant Hessians tell."""
    return all(map(_fixed_times, problem.phases.values())) and _ends(problem) and _along(problem)


def _fixed_times(leg: Phase) -> bool:
    return all(bool(time.fixed[0]) for time in leg.times())


def _along(problem: Problem) -> bool:
    """Whether dynamics and path constraints are affine along every phase."""
    for leg in problem.phases.values():
        _, x, u, _ = leg.model.arguments()
        z = ca.vertcat(x, u, problem.parameter_symbols())
        rows = problem.bind(leg, ca.vertcat(leg.model.derivative(), leg.path_expression()))
        if not _affine(rows, z):
            return False
    return True


def _ends(problem: Problem) -> bool:
    """Whether end conditions are affine, and the cost is convex, in end points, parameters and integrals."""
    legs = problem.phases.values()
    integrals = ca.vertcat(*(leg.integral_symbols() for leg in legs))
    points = [value for leg in legs for value in (leg.ends("initial"), leg.ends("final"))]
    z = ca.vertcat(*points, problem.parameter_symbols(), integrals)
    conditions, cost = problem.constraint_expression(), problem.sense * problem.cost
    for leg in legs:
        conditions, cost = problem.bind(leg, conditions), problem.bind(leg, cost)
    if not _affine(conditions, z) or not _convex(cost, z):
        return False
    for leg in legs:
        _, x, u, _ = leg.model.arguments()
        along = ca.vertcat(x, u, problem.parameter_symbols())
        for symbol, integrand in leg.integrands.values():
            expression = problem.bind(leg, integrand)
            if _affine(expression, along):
                continue
            weight = ca.jacobian(cost, symbol)
            grows = (
                weight.is_constant() and float(ca.DM(weight)) >= 0 and not ca.depends_on(conditions, symbol)
            )
            if not grows or not _convex(expression, along):
                return False
    return True


def _affine(expression: Any, z: Any) -> bool:
    return not any(ca.which_depends(expression, z, 2, True)) if expression.numel() else True


def _convex(expression: Any, z: Any) -> bool:
    """Whether the Hessian of a scalar expression is constant and positive semidefinite, and it has no kinks."""
    hessian = ca.hessian(expression, z)[0]
    if not hessian.is_constant() or has_kinks(expression):
        return False
    values = np.linalg.eigvalsh(ca.DM(hessian).full())
    return bool(np.all(values >= -ROUNDING * np.max(np.abs(values), initial=0.0)))
