r"""Whether a convex problem has one solution only.

Let :math:`\delta = (\delta x, \delta u)` be the difference of two solutions of a convex problem (module `convex`). All
mixtures of the two are solutions as well, so that the cost is constant along them: where its integrands are quadratic
with Hessian H, :math:`H \delta = 0` at almost all times. With :math:`\dot{\delta x} = A \delta x + B \delta u` and
:math:`\delta x = 0` at the start, :math:`\delta` is an input and a state of a linear system with the output
:math:`H \delta`. If that system is left invertible, no input but zero has the output zero, and the two are the same.
For constant A, B, H it is if the pencil

.. math:: \begin{pmatrix} A - s I & B \\ H_x & H_u \end{pmatrix}

has full column rank for some s (H. L. Trentelman, A. A. Stoorvogel & M. Hautus, Control Theory for Linear Systems,
2001, section 8.2). A phase starts from :math:`\delta x = 0` if its initial states are given, or if end conditions lead
over to them from phases of which there is one solution only.

A control on its bound whose switching function vanishes at isolated times only is the same in all solutions: the first
order already costs what differs from it, :math:`\int |\partial H/\partial u_i|\,|\delta u_i|\,dt`. Its column of B
falls out, and with all of them the phase has one solution whatever A is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.arrays import Array, Indices, Mask
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.tolerances import AT_LIMIT
from gnc_opt.verify.brief import BRIEF, SMEARED, lasting_longer
from gnc_opt.verify.convex import is_convex
from gnc_opt.verify.switches import GRAZES

_FULL = 1e-9
"""Least singular value of matrices of full rank, rows and columns scaled to one."""

_ANYWHERE = 0.73 + 0.41j
"""A value of s, in units of the largest entry of A; the rank is less than usual for a few values only."""


def has_one_solution(problem: Problem, determined: Mapping[str, Mask] | None = None) -> bool:
    """Whether a problem is convex and cannot have two solutions, as far as constant matrices tell.

    Parameters
    ----------
    determined : mapping from phase names to bool array (m,)
        Controls that are the same in all solutions (`determined_by_slope`); by default none.
    """
    if not is_convex(problem) or problem.parameters.size:
        return False
    legs = list(problem.phases.values())
    points = [leg.ends(end) for leg in legs for end in ("initial", "final")]
    conditions = problem.constraint_expression()
    rows = _numbers(ca.jacobian(conditions, ca.vertcat(*points)))
    if rows is None:
        return False
    integrals = ca.vertcat(*(leg.integral_symbols() for leg in legs))
    of_ends = np.ones(
        conditions.numel(), dtype=bool
    )  # what depends on integrals says nothing of the ends alone
    of_ends[ca.jacobian_sparsity(conditions, integrals).row()] = False
    equal = rows[problem.constraint_interval().fixed & of_ends]
    same = np.concatenate([_given(leg) for leg in legs])
    waiting, places = legs, _places(legs)
    while waiting:
        settled = [leg for leg in waiting if _starts_alike(equal, same, places[leg.name][0])]
        if not settled or not all(
            _left_invertible(problem, leg, (determined or {}).get(leg.name)) for leg in settled
        ):
            return False
        for leg in settled:
            same[np.concatenate(places[leg.name])] = True
        waiting = [leg for leg in waiting if leg not in settled]
    return True


def _given(leg: Phase) -> Mask:
    """Which initial and final states of a phase are numbers."""
    return np.concatenate([leg.numbers.initial.fixed, leg.numbers.final.fixed])


def _places(legs: list[Phase]) -> dict[str, tuple[Indices, Indices]]:
    """Where initial and final states of each phase are among all of them."""
    found, at = {}, 0
    for leg in legs:
        n = leg.model.states.size
        found[leg.name] = np.arange(at, at + n), np.arange(at + n, at + 2 * n)
        at += 2 * n
    return found


def _starts_alike(equal: Array, same: Mask, initial: Indices) -> bool:
    """Whether equations between states at ends leave all solutions the same start of a phase."""
    left = initial[~same[initial]]
    others = np.setdiff1d(np.flatnonzero(~same), left)
    rows = equal[~np.any(equal[:, others] != 0, axis=1)]
    return left.size == 0 or _full_column_rank(rows[:, left])


def determined_by_slope(s: PhaseSamples) -> Mask:
    """Which controls are on their bounds all along, with switching functions that vanish for `BRIEF` at most (m,).

    A zero of any order at one time is no longer; one that lasts leaves a control open there.
    """
    at_lower, at_upper = s.leg.control_bounds.near(s.u, AT_LIMIT * s.control_scale)
    worth = np.abs(s.control_gradient) * s.control_scale[:, None] / s.hamiltonian_scale
    opens = lasting_longer(s.times, ~(worth > GRAZES), BRIEF)
    between = lasting_longer(s.times, ~(at_lower | at_upper), SMEARED)
    return np.asarray(~np.any(opens | between, axis=1))


def _left_invertible(problem: Problem, leg: Phase, determined: Mask | None) -> bool:
    _, x, u, p = leg.model.arguments()
    if determined is not None:
        u = u[np.flatnonzero(~determined).tolist()]
        if u.is_empty():
            return True
    rates = leg.model.derivative()
    z = ca.vertcat(x, u)
    curved = ca.SX(z.numel(), z.numel())
    for symbol, integrand in leg.integrands.values():
        hessian = ca.hessian(integrand, z)[0]
        if hessian.nnz():
            curved += problem.sense * ca.jacobian(problem.cost, symbol) * hessian
    values = leg.model.parameter_values
    parts = [ca.jacobian(rates, x), ca.jacobian(rates, u), curved]
    a, b, h = (_numbers(ca.substitute(part, p, ca.DM(values))) for part in parts)
    if a is None or b is None or h is None:
        return False
    s = _ANYWHERE * max(float(np.max(np.abs(a), initial=0.0)), 1.0)
    pencil = np.block([[a - s * np.eye(a.shape[0]), b], [h]])
    return _full_column_rank(pencil)


def _full_column_rank(matrix: Array) -> bool:
    for axis in (1, 0):
        sizes = np.max(np.abs(matrix), axis=axis, keepdims=True, initial=0.0)
        matrix = matrix / np.where(sizes > 0, sizes, 1.0)
    if matrix.shape[0] < matrix.shape[1]:
        return False
    return bool(scipy.linalg.svdvals(matrix)[-1] > _FULL)


def _numbers(expression: Any) -> Array | None:
    """The numbers of an expression, or None if it depends on something."""
    simple = ca.simplify(expression)
    return np.asarray(ca.DM(simple).full()) if simple.is_constant() else None
