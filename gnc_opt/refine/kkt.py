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
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, onenormest, splu

from gnc_opt.errors import GncOptError, warn_user
from gnc_opt.model.layout import Array
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.solution import Solution
from gnc_opt.solution.warm_start import start_from_solution
from gnc_opt.transcription.guess import start_variables
from gnc_opt.transcription.scaling import Scaling, scale_rows, scale_variables
from gnc_opt.transcription.transcription import Transcription, transcribe

Mask = NDArray[np.bool_]

WEAK = 1e-5
"""A limit is weakly active if both the distance to it and its multiplier are below this (scaled)."""

SINGULAR = 1e13
"""Condition number of the scaled system from which its solution has no digits to rely on."""

_SHIFT = 1e-9
"""Relative shift under which a singular system is examined."""

_RESIDUAL = 1e-10
"""Residual of the scaled conditions to which Newton's method must bring them."""

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
        self._start(solution)
        self._limits()
        self._converge()
        self._check_limits()

    # --- the point --------------------------------------------------------------------------------

    def _start(self, solution: Solution) -> None:
        transcription, problem = self.transcription, self.problem
        x, lam_x, lam_g = start_from_solution(
            transcription, problem, solution, start_variables(transcription, problem)
        )
        places = transcription.integral_places
        if places.size:
            x[places] -= transcription.evaluate(problem, x)[0][-places.size :]
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

    def _converge(self) -> None:
        """Newton's method on the conditions, so that derivatives belong to the exact minimum of the program."""
        best = np.inf
        for _ in range(_NEWTON_STEPS):
            residual = self._linearise()
            size = float(np.max(np.abs(residual), initial=0.0))
            if size <= 1e-13 or (size <= _RESIDUAL and size > 0.1 * best):
                break
            best = min(best, size)
            step = self._system.solve(-residual)
            n = int(np.sum(~self.pinned))
            self._x[~self.pinned] += step[:n]
            self._lam[self.held] += step[n:]
        if not best <= _RESIDUAL and not size <= _RESIDUAL:
            worst = int(np.argmax(np.abs(residual)))
            raise GncOptError(
                f"the first-order conditions of '{self.problem.name}' do not hold at '{self._system.labels[worst]}' "
                f"(residual {size:.1e}): solve with a tighter tolerance, or refine the solution, before you ask for "
                "sensitivities."
            )

    def _linearise(self) -> Array:
        """Factorise the system at the present point; return the residual of the conditions on F and C."""
        nlp, transcription = self.transcription.nlp, self.transcription
        g, jacobian = nlp.jac_g(self._x, self._p)
        gradient = nlp.grad_f(self._x, self._p)[1].full().ravel()
        upper = _sparse(nlp.hess_lag(self._x, self._p, 1.0, self._lam))
        self._hessian = sp.csc_array(upper + sp.triu(upper, 1).T)
        self._jacobian = _sparse(jacobian)
        self._gradient = gradient + self._jacobian.T @ self._lam
        free, held = np.flatnonzero(~self.pinned), np.flatnonzero(self.held)
        block = self._jacobian[held][:, free]
        matrix = sp.block_array([[self._hessian[free][:, free], block.T], [block, None]], format="csc")
        labels = [transcription.variable_labels[i] for i in free]
        labels += [transcription.row_labels[i] for i in held]
        self._system = _System(matrix, free.size, labels, self.problem.name)
        return np.concatenate([self._gradient[free], (g.full().ravel() - self._row_at)[held]])

    def _check_limits(self) -> None:
        """Warn of limits that are weakly active; refuse the point if other limits are active than was thought."""
        transcription = self.transcription
        g = transcription.nlp.jac_g(self._x, self._p)[0].full().ravel()
        kinds = (
            (self._box, self._x, -self._gradient, self.pinned, self._variable_weights,
             transcription.variable_labels),
            (self._rows, g, self._lam, self.held, self._row_weights, transcription.row_labels),
        )  # fmt: skip
        weak: list[str] = []
        for box, values, multipliers, active, weights, labels in kinds:
            density = np.where(active & ~box.fixed, multipliers / weights, np.nan)
            upper = np.abs(values - box.upper) < np.abs(values - box.lower)
            pull = np.where(upper, density, -density)  # >= 0 where the limit is needed
            if self._system.redundant:  # multipliers that are not unique tell nothing by their signs
                pull = np.full(pull.size, np.nan)
            excess = np.where(active, -np.inf, np.maximum(box.lower - values, values - box.upper))
            for measure, verb in ((-pull, "wants to leave its limit"), (excess, "breaks its limit")):
                finite = np.where(np.isfinite(measure), measure, -np.inf)
                if finite.size and np.max(finite) > WEAK:
                    raise GncOptError(
                        f"'{labels[int(np.argmax(finite))]}' of '{self.problem.name}' {verb} once the first-order "
                        "conditions are solved exactly: solve with a tighter tolerance, or refine the solution, "
                        "before you ask for sensitivities."
                    )
            near = np.where(active, np.inf, np.minimum(values - box.lower, box.upper - values))
            weak += [labels[i] for i in np.flatnonzero((pull < WEAK) | (near < WEAK))]
        if weak:
            others = f" and {len(weak) - 1} more" if len(weak) > 1 else ""
            warn_user(
                f"'{weak[0]}'{others} of '{self.problem.name}' is only just at its limit (weakly active), where "
                "the solution has two one-sided derivatives; the sensitivities are those of one of the sides."
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
            v.full().ravel()
            for v in _derivatives(self.problem, self.transcription)(self._x, self._p, self._lam, direction)
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


class _System:
    """A symmetric indefinite sparse system; redundant but consistent rows are borne, a free direction is not.

    Attributes
    ----------
    redundant : bool
        Whether the rows leave multipliers undetermined.
    """

    def __init__(self, matrix: Any, n_primal: int, labels: list[str], name: str) -> None:
        self.labels, self._n, self._name = labels, n_primal, name
        self._scale = _equilibrate(matrix)
        diagonal = sp.diags_array(self._scale)
        self._matrix = sp.csc_array(diagonal @ matrix @ diagonal)
        try:
            self._factors = splu(self._matrix)
            self.redundant = not self._condition() < SINGULAR
        except RuntimeError:  # a pivot is exactly zero
            self.redundant = True
        if self.redundant:
            self._examine()

    def _condition(self) -> float:
        n = self._matrix.shape[0]
        inverse = LinearOperator(
            (n, n),
            matvec=self._factors.solve,
            rmatvec=lambda b: self._factors.solve(b, trans="T"),
            dtype=float,
        )
        return float(onenormest(inverse) * np.max(np.abs(self._matrix).sum(axis=0))) if n > 1 else 1.0

    def _examine(self) -> None:
        """Find what the singular system leaves undetermined: variables (refuse) or only multipliers (accept)."""
        n = self._matrix.shape[0]
        signs = np.where(np.arange(n) < self._n, 1.0, -1.0)
        self._factors = splu(sp.csc_array(self._matrix + _SHIFT * sp.diags_array(signs)))
        null = np.random.default_rng(0).standard_normal(n)
        for _ in range(6):
            null = self._factors.solve(null / np.max(np.abs(null)))
        null /= np.max(np.abs(null))
        if np.max(np.abs(null[: self._n]), initial=0.0) > 1e-3:
            culprit = self.labels[int(np.argmax(np.abs(null[: self._n])))]
            raise GncOptError(
                f"the first-order conditions of '{self._name}' do not determine '{culprit}' (the KKT system is "
                "singular): the cost must depend on it; a singular arc needs refine(solution, structure='auto') "
                "first, and a quantity that nothing depends on must be fixed."
            )

    def solve(self, right: Array) -> Array:
        """Solve with iterative refinement, which also undoes the shift of a redundant system."""
        scaled = self._scale * right
        solved = self._factors.solve(scaled)
        for _ in range(6):
            rest = scaled - self._matrix @ solved
            if np.max(np.abs(rest), initial=0.0) <= 1e-15 * np.max(np.abs(scaled), initial=1e-300):
                break
            solved = solved + self._factors.solve(rest)
        rest = scaled - self._matrix @ solved
        if not np.max(np.abs(rest), initial=0.0) <= 1e-7 * np.max(np.abs(scaled), initial=1e-300) + 1e-13:
            culprit = self.labels[int(np.argmax(np.abs(rest)))]
            raise GncOptError(
                f"the constraints of '{self._name}' contradict each other when its data change, at '{culprit}': "
                "boundary values or bounds are given twice; free one of them."
            )
        return np.asarray(solved * self._scale)


def _transcription(problem: Problem, solution: Solution) -> Transcription:
    meshes = {name: leg.mesh for name, leg in solution.phases.items()}
    scheme = next(iter(solution.phases.values())).scheme
    return transcribe(problem, meshes, scheme)


def _derivatives(problem: Problem, transcription: Transcription) -> Any:
    """Return (x, p, lam, dp) -> directional derivatives along dp of L, of its gradient and of g."""
    key = ("sensitivity", id(transcription))
    if key not in problem.builds:
        nlp = transcription.nlp
        lam, dp = ca.MX.sym("lam", nlp.n_constraints), ca.MX.sym("dp", nlp.n_parameters)
        lagrangian = nlp.f + ca.dot(lam, nlp.g)
        gradient = ca.gradient(lagrangian, nlp.x)
        outputs = [ca.densify(ca.jtimes(e, nlp.p, dp)) for e in (lagrangian, gradient, nlp.g)]
        problem.builds[key] = ca.Function("sensitivity", [nlp.x, nlp.p, lam, dp], outputs)
    return problem.builds[key]


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
    return sp.csc_array((matrix.nonzeros(), pattern.row(), pattern.colind()), shape=matrix.shape)


def _equilibrate(matrix: Any) -> Array:
    """Return symmetric scale factors that bring the largest entry of every row near 1."""
    scale = np.ones(matrix.shape[0])
    absolute = sp.coo_array(np.abs(matrix))
    for _ in range(4):
        norms = np.zeros(scale.size)
        np.maximum.at(norms, absolute.row, absolute.data * scale[absolute.row] * scale[absolute.col])
        scale = scale / np.sqrt(np.where(norms > 0, norms, 1.0))
    return scale
