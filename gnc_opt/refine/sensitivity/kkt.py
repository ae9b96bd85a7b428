r"""The first-order conditions of the transcribed program as a linear system, for derivatives of its solution.

With the variables on their limits pinned and the rows on theirs (set C), a minimum solves

.. math:: \nabla_F \mathcal L(z, \lambda; p) = 0, \qquad g_C(z; p) = b, \qquad z_P = \beta,

:math:`\mathcal L = f + \lambda^T g`, F the free and P the pinned variables. A change of the data p, b and
:math:`\beta` moves the minimum by the implicit function theorem (Fiacco 1976),

.. math::
    \begin{pmatrix} \mathcal L_{FF} & g_F^T \\ g_F & 0 \end{pmatrix}
    \begin{pmatrix} \dot z_F \\ \dot \lambda \end{pmatrix} =
    -\begin{pmatrix} \mathcal L_{FP}\dot\beta + \mathcal L_{Fp}\dot p \\
                     g_P\dot\beta + g_p\dot p - \dot b \end{pmatrix},

and the minimum itself by :math:`\dot f = \mathcal L_p \dot p + \mathcal L_P \dot\beta - \lambda^T \dot b`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.arrays import Array, Mask
from gnc_opt.errors import GncOptError, warn_user
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.problem import Problem
from gnc_opt.refine.sensitivity.saddle import SaddlePoint
from gnc_opt.solution.solution import Solution
from gnc_opt.solution.solve_mesh import sharper
from gnc_opt.solution.start import program_start
from gnc_opt.transcription.scaling import Scaling, scale_rows, scale_variables
from gnc_opt.transcription.transcription import Transcription, transcribe

WEAK = 1e-5
"""A limit is weakly active if both the distance to it and its multiplier are below this (scaled)."""

_RESIDUAL = 1e-10
"""Residual of the scaled conditions to which Newton's method must bring them."""

_ROUNDED = 1e-13
"""Residual at which only rounding is left."""

_NEWTON_STEPS = 8


@dataclass(frozen=True)
class Change:
    """A direction in the data of a program, physical.

    Attributes
    ----------
    numbers : array (n_numbers,)
        Of model parameters and fixed times, in the order of ``Transcription.numbers``.
    limits : array (n_variables,)
        Of the limits on which variables are pinned.
    row_limits : array (n_constraints,)
        Of the limits on which rows sit.
    """

    numbers: Array
    limits: Array
    row_limits: Array


@dataclass(frozen=True)
class Response:
    """What the minimum does in that direction: the minimised functional and the variables, physical."""

    objective: float
    variables: Array


class KktPoint:
    """A solution as a point of its program, with the system of first-order conditions factorised.

    Parameters
    ----------
    solution : Solution
        Solved, with its problem.

    Attributes
    ----------
    transcription : Transcription
    problem : Problem
    pinned, held : bool arrays (n_variables,), (n_constraints,)
        Variables and rows on their limits.

    Raises
    ------
    GncOptError
        The system is singular, or the limits that the multipliers name are not those of the minimum.
    """

    def __init__(self, solution: Solution) -> None:
        problem = solution.problem
        assert problem is not None, "the caller has seen to it"
        self.problem: Problem = problem
        self.transcription = _transcription(problem, solution)
        trouble = self._attempt(solution)
        if trouble:
            trouble = self._attempt(sharper(solution))
        if trouble:
            raise GncOptError(trouble)
        self._warn_of_weak_limits()

    # --- the point --------------------------------------------------------------------------------

    def _attempt(self, solution: Solution) -> str:
        """Take the active limits from a solution and solve the conditions; return what is wrong, or nothing."""
        self._start(solution)
        self._limits()
        return self._converge() or self._wrong_limit()

    def _start(self, solution: Solution) -> None:
        transcription, problem = self.transcription, self.problem
        start = program_start(transcription, problem, solution)
        x, lam_x, lam_g = start.x, start.lam_x, start.lam_g
        assert lam_x is not None and lam_g is not None, "a solution has multipliers"
        scales = scale_variables(transcription, problem, x)
        rows, objective = scale_rows(transcription, problem, x, scales)
        self.scaling = Scaling(scales, rows, objective)
        self._p = transcription.parameter_vector(problem, scales, rows, objective)
        self._x, self._lam = x / scales, lam_g / rows * objective
        self._lam_x = lam_x * scales * objective

    def _limits(self) -> None:
        """Decide which limits are active: those whose multiplier outweighs the distance to them."""
        transcription, scaling = self.transcription, self.scaling
        box = _scaled(transcription.variable_interval(self.problem), scaling.variables)
        rows = _scaled(transcription.row_interval(self.problem), 1 / scaling.rows)
        g = transcription.nlp.jac_g(self._x, self._p)[0].full().ravel()
        weights = _weights(transcription)
        self._box, self._rows = box, rows
        self._variable_weights, self._row_weights = weights
        self.pinned, self._at = _active(box, self._x, self._lam_x / weights[0])
        self.held, self._row_at = _active(rows, g, self._lam / weights[1])
        self._x = np.where(self.pinned, self._at, self._x)
        self._lam = np.where(self.held, self._lam, 0.0)

    def _converge(self) -> str:
        """Newton's method on the conditions, so that derivatives belong to the exact minimum of the program.

        Returns what is wrong if it fails, else nothing.
        """
        best = np.inf
        for _ in range(_NEWTON_STEPS):
            residual = self._linearise()
            size = float(np.max(np.abs(residual), initial=0.0))
            if size <= _ROUNDED or (size <= _RESIDUAL and size > 0.1 * best):
                break
            best = min(best, size)
            step = self._system.solve(-residual)
            n = int(np.sum(~self.pinned))
            self._x[~self.pinned] += step[:n]
            self._lam[self.held] += step[n:]
        if not best <= _RESIDUAL and not size <= _RESIDUAL:
            worst = int(np.argmax(np.abs(residual)))
            return (
                f"the first-order conditions of '{self.problem.name}' do not hold at '{self._system.labels[worst]}' "
                f"(residual {size:.1e}): solve with a tighter tolerance, or refine the solution, before you ask for "
                "sensitivities."
            )
        return ""

    def _linearise(self) -> Array:
        """Factorise the system at the present point; return the residual of the conditions on F and C."""
        nlp, transcription = self.transcription.nlp, self.transcription
        g, jacobian = nlp.jac_g(self._x, self._p)
        gradient = nlp.grad_f(self._x, self._p)[1].full().ravel()
        upper = _sparse(nlp.hess_lag(self._x, self._p, 1.0, self._lam))
        self._hessian = scipy.sparse.csc_array(upper + scipy.sparse.triu(upper, 1).T)
        self._jacobian = _sparse(jacobian)
        self._gradient = gradient + self._jacobian.T @ self._lam
        free, held = np.flatnonzero(~self.pinned), np.flatnonzero(self.held)
        block = self._jacobian[held][:, free]
        matrix = scipy.sparse.block_array(
            [[self._hessian[free][:, free], block.T], [block, None]], format="csc"
        )
        labels = [transcription.variable_labels[i] for i in free]
        labels += [transcription.row_labels[i] for i in held]
        self._system = SaddlePoint(matrix, free.size, labels, self.problem.name)
        return np.concatenate([self._gradient[free], (g.full().ravel() - self._row_at)[held]])

    def _wrong_limit(self) -> str:
        """What is wrong if a limit pushes the wrong way or is broken, now that the conditions hold; else nothing."""
        culprits = [label for side in self._sides() for label in side.wrong_labels]
        if not culprits:
            return ""
        return (
            f"the limit of '{culprits[0]}' of '{self.problem.name}' is neither kept nor left when the first-order "
            "conditions are solved exactly: refine the solution (bang-bang arcs with structure='auto') before "
            "you ask for sensitivities."
        )

    def _warn_of_weak_limits(self) -> None:
        weak = [label for side in self._sides() for label in side.weak_labels]
        if weak:
            others = f" and {len(weak) - 1} more" if len(weak) > 1 else ""
            warn_user(
                f"'{weak[0]}'{others} of '{self.problem.name}' is only just at its limit (weakly active), where "
                "the solution has two one-sided derivatives; the sensitivities are those of one of the sides."
            )

    def _sides(self) -> tuple[_Side, _Side]:
        """Variables and rows with their limits and multipliers at the present point."""
        transcription = self.transcription
        g = transcription.nlp.jac_g(self._x, self._p)[0].full().ravel()
        # Multipliers that are not unique tell nothing by their signs.
        unique = np.nan if self._system.redundant else 1.0
        bound = -unique * self._gradient / self._variable_weights
        row = unique * self._lam / self._row_weights
        return (
            _Side(self._box, self._x, bound, self.pinned, self._at, transcription.variable_labels),
            _Side(self._rows, g, row, self.held, self._row_at, transcription.row_labels),
        )

    # --- derivatives ------------------------------------------------------------------------------

    def respond(self, change: Change) -> Response:
        """Return the derivative of the minimum in a direction of the data."""
        scales, rows = self.scaling.variables, self.scaling.rows
        n_rest = self._p.size - change.numbers.size
        direction = np.concatenate([change.numbers, np.zeros(n_rest)])
        moved = np.where(self.pinned, change.limits, 0.0) / scales
        shifted = np.where(self.held, change.row_limits, 0.0) * rows
        of_lagrangian, of_gradient, of_rows = (
            v.full().ravel() for v in _derivatives(self.transcription)(self._x, self._p, self._lam, direction)
        )
        free, held = ~self.pinned, self.held
        right = np.concatenate(
            [
                (of_gradient + self._hessian @ moved)[free],
                (of_rows + self._jacobian @ moved - shifted)[held],
            ]
        )
        solved = self._system.solve(-right)
        variables = moved.copy()
        variables[free] = solved[: int(np.sum(free))]
        objective = float(of_lagrangian[0] + self._gradient @ moved - self._lam @ shifted)
        return Response(objective / self.scaling.objective, variables * scales)

    @property
    def variables(self) -> Array:
        """The variables (n_variables,) at the minimum, physical."""
        return self._x * self.scaling.variables


@dataclass(frozen=True, eq=False)
class _Side:
    """Limits of all variables, or of all rows, and which of them are taken for active (scaled)."""

    box: Interval
    values: Array
    multipliers: Array
    active: Mask
    at: Array
    labels: tuple[str, ...]

    @cached_property
    def push(self) -> Array:
        """How much each active limit is needed: its multiplier, > 0 if it pushes inwards; NaN elsewhere."""
        upper = (self.at == self.box.upper) & (self.box.lower < self.box.upper)
        push = np.where(upper, self.multipliers, -self.multipliers)
        return np.where(self.active & ~self.box.fixed, push, np.nan)

    @cached_property
    def room(self) -> Array:
        """Distance of what is not active to its nearer limit, negative beyond; NaN elsewhere."""
        room = np.minimum(self.values - self.box.lower, self.box.upper - self.values)
        return np.where(self.active, np.nan, room)

    @property
    def wrong_labels(self) -> list[str]:
        """What pulls outwards or lies beyond its limit."""
        return self._labels((self.push < -WEAK) | (self.room < -WEAK))

    @property
    def weak_labels(self) -> list[str]:
        """What is as good as at its limit without being held there."""
        return self._labels((self.push < WEAK) | (self.room < WEAK))

    def _labels(self, which: Mask) -> list[str]:
        return [self.labels[i] for i in np.flatnonzero(which)]


def _transcription(problem: Problem, solution: Solution) -> Transcription:
    meshes = {name: leg.mesh for name, leg in solution.phases.items()}
    return transcribe(problem, meshes, solution.scheme)


def _derivatives(transcription: Transcription) -> Any:
    """Return (x, p, lam, dp) -> directional derivatives along dp of L, of its gradient and of g."""
    if "sensitivity" not in transcription.built:
        nlp = transcription.nlp
        lam, dp = ca.MX.sym("lam", nlp.n_constraints), ca.MX.sym("dp", nlp.n_parameters)
        lagrangian = nlp.f + ca.dot(lam, nlp.g)
        gradient = ca.gradient(lagrangian, nlp.x)
        outputs = [ca.densify(ca.jtimes(e, nlp.p, dp)) for e in (lagrangian, gradient, nlp.g)]
        transcription.built["sensitivity"] = ca.Function("sensitivity", [nlp.x, nlp.p, lam, dp], outputs)
    return transcription.built["sensitivity"]


def _active(box: Interval, values: Array, multipliers: Array) -> tuple[Mask, Array]:
    """Which limits are active, and the limits (0 where none is)."""
    below = (multipliers < 0) & (values - box.lower < -multipliers)
    above = (multipliers > 0) & (box.upper - values < multipliers)
    active = box.fixed | below | above
    limit = np.where(above, box.upper, box.lower)
    return active, np.where(active, limit, 0.0)


def _weights(transcription: Transcription) -> tuple[Array, Array]:
    """Quadrature weights (shares of the phase) by which multipliers become densities; 1 elsewhere."""
    variables, rows = np.ones(transcription.n_variables), np.ones(transcription.n_constraints)
    for part in transcription.parts.values():
        collocation = part.collocation
        variables[collocation.point_controls] = collocation.quadrature
        inner = ~np.isin(collocation.point_states, collocation.boundary_states)
        wide = np.broadcast_to(collocation.quadrature, inner.shape)
        variables[collocation.point_states[inner]] = wide[inner]
        rows[collocation.path_rows] = collocation.quadrature
    return variables, rows


def _scaled(box: Interval, scales: Array) -> Interval:
    return Interval(box.lower / scales, box.upper / scales)


def _sparse(matrix: Any) -> Any:
    """Convert a sparse CasADi DM to scipy."""
    pattern = matrix.sparsity()
    return scipy.sparse.csc_array((matrix.nonzeros(), pattern.row(), pattern.colind()), shape=matrix.shape)
