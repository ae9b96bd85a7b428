r"""Order of a pure state constraint: number of time derivatives until a control appears.

Along :math:`\dot x = f(t, x, u)` a constraint S(t, x) has the derivatives (Bryson & Ho, Applied Optimal Control, 1975,
section 3.11; Hartl, Sethi & Vickson, SIAM Review 37(2), 1995, section 2)

.. math:: S^{(0)} = S, \qquad S^{(k+1)} = \frac{\partial S^{(k)}}{\partial t} + \frac{\partial S^{(k)}}{\partial x} f,

and its order q is the smallest k for which :math:`S^{(k)}` depends on a control. At the entry of an active arc
:math:`\dot S = \dots = S^{(q-1)} = 0`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem_definition import ProblemData

STATE_CONSTRAINT_MAX_ORDER = 4
"""Largest order that is determined."""


@dataclass(frozen=True, eq=False)
class ConstraintOrder:
    """Path constraint or state with its derivatives along the dynamics.

    Attributes
    ----------
    order : int or None
        Order q; 0 if the constraint contains a control, None if none appears up to `STATE_CONSTRAINT_MAX_ORDER`.
    derivatives : tuple of casadi.SX
        S and its derivatives up to order q (all computed ones if q is None).
    controls : tuple of int
        Controls in the q-th derivative.
    """

    label: str
    order: int | None
    derivatives: tuple[Any, ...]
    controls: tuple[int, ...]


def get_constraint_order(problem: ProblemData, phase: Phase, row: int) -> ConstraintOrder:
    """Return the order of one row of the path constraints of a phase, then of its states."""
    return problem.memoize(
        ("constraint order", phase.name, row), lambda: _derive_constraint_order(problem, phase, row)
    )


def _derive_constraint_order(problem: ProblemData, phase: Phase, row: int) -> ConstraintOrder:
    t, x, u, _ = phase.model.symbolic_arguments()
    rates = problem.substitute_parameters(phase, phase.model.state_derivative())
    value = problem.substitute_parameters(phase, ca.vertcat(phase.path_expression(), x)[row])
    return differentiate_until_controls_appear(
        (*phase.path_labels, *phase.model.states.labels)[row], value, t, x, u, rates
    )


def differentiate_until_controls_appear(
    label: str, value: Any, t: Any, x: Any, u: Any, rates: Any
) -> ConstraintOrder:
    """Return the derivatives of a scalar along dx/dt = ``rates``, up to the first one that contains controls u."""
    derivatives = [value]
    while True:
        controls = tuple(sorted(set(ca.jacobian(derivatives[-1], u).sparsity().get_col())))
        if controls:
            return ConstraintOrder(label, len(derivatives) - 1, tuple(derivatives), controls)
        if len(derivatives) > STATE_CONSTRAINT_MAX_ORDER:
            return ConstraintOrder(label, None, tuple(derivatives), ())
        last = derivatives[-1]
        derivatives.append(ca.simplify(ca.jacobian(last, t) + ca.jacobian(last, x) @ rates))
