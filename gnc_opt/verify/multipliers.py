r"""Costates and multipliers of a trajectory that comes without: least squares of the first-order conditions.

Transcribed on the trajectory's own mesh (Legendre-Gauss), stationarity with respect to states, controls, free times,
parameters and jump times of the controls reads :math:`\nabla f + g'^T\lambda_g + \lambda_x = 0`: the adjoint equation,
:math:`\partial H/\partial u = 0`, transversality, and a Hamiltonian that is continuous where a control jumps. It is
linear in the multipliers. Those of limits that are not active vanish; a variable on its limit frees its row, unless
the multiplier that is left there would have the wrong sign. Path constraints without controls push at segment
boundaries too (module `atoms`). The least-squares solution is mapped to costates as a
solver's multipliers are (module `covector`), and judged like those.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy

from gnc_opt.arrays import Array, Mask
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.covector import Iterate
from gnc_opt.solution.start import with_integrals
from gnc_opt.tolerances import ACTIVE, ROUNDING, TINY
from gnc_opt.transcription.transcription import Transcription
from gnc_opt.verify.atoms import Atoms, Trajectory
from gnc_opt.verify.trajectory_fit import FittedPhase

_WRONG = 1e-7
"""A multiplier of the wrong sign, relative to the largest, that is none."""

_ROUNDS = 8
"""Of sorting out which limits push."""

_DAMPING, _REPEATS = 1e-12, 4
"""Relative weight that keeps multipliers which nothing determines small, and repetitions that take its bias away."""


def estimate(
    transcription: Transcription,
    problem: Problem,
    fitted: Mapping[str, FittedPhase],
    q: Array,
    near: float = ACTIVE,
) -> Iterate:
    """Return the program's variables at a trajectory, and the multipliers that explain it best.

    Parameters
    ----------
    fitted : mapping of FittedPhase
    q : array (n_parameters,)
        Free parameters.
    near : float
        Distance from a limit, in shares of the scale, within which it may push.
    """
    x = _variables(transcription, problem, fitted, q)
    scales = _ranges(transcription, problem, fitted, x)
    values, gradient, nonzeros = transcription.evaluate(problem, x)
    rows, columns = transcription.constraints.jacobian_pattern
    steepest = np.zeros(transcription.n_constraints)
    np.maximum.at(steepest, rows, np.abs(nonzeros * scales[columns]))
    row_scales = 1 / np.where(steepest > 0, steepest, 1.0)
    worth = 1 / max(float(np.max(np.abs(gradient * scales))), TINY)
    shape = (transcription.n_variables, transcription.n_constraints)
    weights = scales / np.sqrt(_quadrature(transcription))
    matrix = scipy.sparse.csc_array(
        (nonzeros * weights[columns] * row_scales[rows], (columns, rows)), shape=shape
    )
    limits = _Limits.of(transcription.variable_interval(problem), x, near * scales)
    row_limits = _Limits.of(transcription.row_interval(problem), values, near / row_scales)
    atoms = Atoms.of(transcription, Trajectory(problem, fitted, q, scales, near))
    pushes = (
        scipy.sparse.diags_array(weights)
        @ atoms.gradients
        @ scipy.sparse.diags_array(1 / _or_one(atoms.sizes))
    )
    with_atoms = scipy.sparse.hstack([matrix, pushes], format="csc")
    pushing = row_limits.with_more(_Limits(atoms.at_lower, atoms.at_upper))
    scaled = _sort_out(with_atoms, gradient * weights * worth, _state_rows(transcription), limits, pushing)
    lam_g = scaled[: values.size] * row_scales / worth
    residual = gradient + scipy.sparse.csc_array((nonzeros, (columns, rows)), shape=shape) @ lam_g
    return Iterate(x, np.where(limits.anywhere, -residual, 0.0), lam_g)


class _Limits:
    """Which limits are near: lower ones push with multipliers <= 0, upper ones with >= 0, equal ones with any."""

    def __init__(self, lower: Mask, upper: Mask) -> None:
        self.lower, self.upper = lower, upper

    @classmethod
    def of(cls, box: Interval, values: Array, slack: Array) -> _Limits:
        return cls((values <= box.lower + slack) | box.fixed, (values >= box.upper - slack) | box.fixed)

    def with_more(self, other: _Limits) -> _Limits:
        """These, then others."""
        return _Limits(np.append(self.lower, other.lower), np.append(self.upper, other.upper))

    @property
    def anywhere(self) -> Mask:
        return self.lower | self.upper

    def wrong(self, multipliers: Array, size: float) -> Mask:
        """Multipliers with a sign that the limit cannot exert."""
        sign = np.where(np.abs(multipliers) > _WRONG * size, np.sign(multipliers), 0.0)
        return self.anywhere & (((sign > 0) & ~self.upper) | ((sign < 0) & ~self.lower))


def _sort_out(matrix: Array, gradient: Array, exact: Mask, limits: _Limits, row_limits: _Limits) -> Array:
    """Scaled multipliers of the rows: least squares, without those that would push the wrong way."""
    imposed, pushing = ~limits.anywhere, row_limits.anywhere.copy()
    multipliers = np.zeros(matrix.shape[1])
    for _ in range(_ROUNDS):
        multipliers[:] = 0.0
        multipliers[pushing] = _least_squares(matrix[imposed][:, pushing], -gradient[imposed], exact[imposed])
        residual = -(gradient + matrix @ multipliers)
        size = float(np.max(np.abs(gradient), initial=TINY))
        pulling = limits.wrong(residual, size) & ~imposed
        wrong = row_limits.wrong(multipliers, float(np.max(np.abs(multipliers), initial=TINY))) & pushing
        if not (np.any(pulling) or np.any(wrong)):
            break
        if not np.any(imposed & limits.anywhere) and np.all(pushing == row_limits.anywhere):
            right = _right_signs(matrix, gradient, multipliers, exact, limits, row_limits)
            if right is not None:
                return right
        imposed, pushing = imposed | pulling, pushing & ~wrong
    return multipliers


def _right_signs(
    matrix: Array, gradient: Array, first: Array, exact: Mask, limits: _Limits, row_limits: _Limits
) -> Array | None:
    """Multipliers with the right signs, by a linear programme, where they are not unique and others explain all too.

    Along bounds that fix the whole trajectory those of its ends are free, and the shortest ones may pull.
    """
    imposed, pushing = ~limits.anywhere, row_limits.anywhere
    size = float(np.max(np.abs(gradient), initial=TINY))
    left = (gradient + matrix @ first)[imposed]
    if not np.max(np.abs(left), initial=0.0) <= _WRONG * size:  # they explain nothing whatever their signs
        return None
    columns, bound = matrix[:, pushing], limits.anywhere
    # Of an active limit the residual -(g + A y) is the multiplier: not negative at upper ones, not positive at lower.
    only_upper, only_lower = bound & ~limits.lower, bound & ~limits.upper
    one_sided = scipy.sparse.vstack([columns[only_upper], -columns[only_lower]])
    # They push by as much as they can everywhere, lest one vanishes at a point and pulls beside it.
    margin = np.ones((one_sided.shape[0], 1))
    found = scipy.optimize.linprog(
        np.append(np.zeros(columns.shape[1]), -1.0),
        A_ub=scipy.sparse.hstack([one_sided, margin]),
        b_ub=np.concatenate([-gradient[only_upper], gradient[only_lower]]),
        A_eq=scipy.sparse.hstack([columns[imposed], np.zeros((int(np.sum(imposed)), 1))]),
        b_eq=-gradient[imposed],
        bounds=[
            *(
                (None if lower else 0.0, None if upper else 0.0)
                for lower, upper in zip(row_limits.lower[pushing], row_limits.upper[pushing], strict=True)
            ),
            (0.0, size),
        ],
        method="highs",
    )
    if found.status != 0:
        return None
    multipliers = np.zeros(matrix.shape[1])
    multipliers[pushing] = found.x[:-1]
    rest = -(gradient + matrix @ multipliers)[imposed]
    multipliers[pushing] += _least_squares(columns[imposed], rest, exact[imposed])
    return multipliers


def _least_squares(matrix: Array, right: Array, exact: Mask) -> Array:
    """The solution of min |A y - b|, some rows exact, by the augmented system damped towards the previous one."""
    n_rows, n = matrix.shape
    if not n:
        return np.zeros(0)
    sizes = np.sqrt(np.asarray((matrix**2).sum(axis=0)).ravel())
    columns = scipy.sparse.diags_array(1 / np.where(sizes > 0, sizes, 1.0))
    matrix = scipy.sparse.csc_array(matrix @ columns)
    loose = scipy.sparse.diags_array(np.where(exact, _DAMPING, 1.0))
    damped = scipy.sparse.eye_array(n) * -_DAMPING
    system = scipy.sparse.block_array([[loose, matrix], [matrix.T, damped]], format="csc")
    try:
        factors = scipy.sparse.linalg.splu(system)
    except RuntimeError:  # singular to rounding: nothing explains the trajectory
        return np.zeros(n)
    y = np.zeros(n)
    for _ in range(_REPEATS):
        y = y + factors.solve(np.concatenate([right - matrix @ y, np.zeros(n)]))[n_rows:]
    return np.asarray(columns @ y)


def _variables(
    transcription: Transcription, problem: Problem, fitted: Mapping[str, FittedPhase], q: Array
) -> Array:
    x = np.zeros(transcription.n_variables)
    for name, part in transcription.parts.items():
        collocation, phase = part.collocation, fitted[name]
        breaks = phase.x.breaks
        points = breaks[0] + collocation.fractions * (breaks[-1] - breaks[0])
        x[collocation.boundary_states] = phase.x(breaks)
        x[collocation.boundary_states[:, -1]] = phase.x(breaks[-1], "left")
        x[collocation.point_states], x[collocation.point_controls] = phase.x(points), phase.u(points)
        free_times = part.times < transcription.n_variables
        x[part.times[free_times]] = breaks[list(collocation.mesh.anchors)][free_times]
    x[transcription.parameter_places] = q
    return with_integrals(transcription, problem, x)


def _state_rows(transcription: Transcription) -> Mask:
    """Rows of the adjoint equation: they can be met whatever the costates at the end, so they are met exactly."""
    rows = np.zeros(transcription.n_variables, dtype=bool)
    for part in transcription.parts.values():
        rows[part.collocation.point_states] = True
        rows[part.collocation.boundary_states[:, 1:-1]] = True
    return rows


def _ranges(
    transcription: Transcription, problem: Problem, fitted: Mapping[str, FittedPhase], x: Array
) -> Array:
    """What variables vary by along the trajectory: no unit, origin or guess has a say in that."""
    scales = _or_one(np.abs(x))
    for name, part in transcription.parts.items():
        collocation, numbers = part.collocation, problem.phases[name].numbers
        for places, box in (
            (collocation.point_states, numbers.states),
            (collocation.point_controls, numbers.controls),
        ):
            limits, size = box.upper - box.lower, np.max(np.abs(x[places]), axis=1, initial=0.0)
            limits = np.where(np.isfinite(limits), limits, 0.0)
            varies = np.maximum(np.ptp(x[places], axis=1) if places.size else limits, limits)
            scales[places] = np.where(varies > ROUNDING * size, varies, _or_one(size))[:, None]
        scales[collocation.boundary_states] = scales[collocation.point_states[:, [0]]]
        scales[part.times[part.times < x.size]] = np.ptp(fitted[name].x.breaks)
    return scales


def _or_one(values: Array) -> Array:
    return np.where(values > 0, values, 1.0)


def _quadrature(transcription: Transcription) -> Array:
    """Weights by which the rows of states and controls at points become densities; 1 elsewhere."""
    weights = np.ones(transcription.n_variables)
    for part in transcription.parts.values():
        collocation = part.collocation
        weights[collocation.point_states] = collocation.quadrature
        weights[collocation.point_controls] = collocation.quadrature
    return weights
