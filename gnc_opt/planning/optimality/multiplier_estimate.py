r"""Estimated costates and multipliers of a given trajectory: least squares of the first-order conditions.

Transcribed on the trajectory's own mesh (Legendre-Gauss), stationarity with respect to states, controls, free
times, parameters and jump times of the controls reads :math:`\nabla f + g'^T\lambda_g + \lambda_x = 0`: the
adjoint equation, :math:`\partial H/\partial u = 0`, transversality, and a Hamiltonian that is continuous
where a control jumps. It is linear in the multipliers. Multipliers of inactive limits vanish. A variable on
its limit removes its row, unless its multiplier would have the wrong sign. Path constraints without controls
also have atoms at segment boundaries (module `atoms`). The least-squares solution is mapped to costates like
a solver's multipliers (module `covector`) and checked in the same way.

Atoms (impulsive multipliers) of a trajectory's path constraints, which a program's rows do not contain.

Where a constraint :math:`c(t, x) \le 0` without controls is touched, reached or left, its multiplier is a measure with
an atom :math:`\eta \ge 0`: the costate jumps by :math:`-\eta\,\partial c/\partial x` (Hartl, Sethi & Vickson, SIAM
Review 37(2), 1995, theorem 4.1). A program has rows for path constraints at its collocation points only, so that the
terms :math:`\eta\,c(t_k, x_k)` at the boundaries of its segments are added to its Lagrangian: at the ends of arcs of
order two or more (of order one an arc is entered and left without), at touches, and at the ends of the phase.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from gnc_opt.arrays import Array, Indices, Mask
from gnc_opt.planning.optimality.costate_jumps import path_gradients
from gnc_opt.planning.optimality.trajectory_fit import FittedPhase
from gnc_opt.planning.problem.functions import PhaseFunctions, phase_functions
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.state_constraints import constraint_order
from gnc_opt.planning.solution.costates import Iterate
from gnc_opt.planning.solution.extract import model_parameters
from gnc_opt.planning.solution.warm_start import with_integrals
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.program_layout import PhasePart
from gnc_opt.planning.transcription.transcription import Transcription
from gnc_opt.tolerances import ACTIVE, ROUNDING, TINY


@dataclass(frozen=True)
class SampledTrajectory:
    """A trajectory without multipliers.

    Attributes
    ----------
    problem : Problem
    phases : mapping of FittedPhase
    q : array (n_parameters,)
        Free parameters.
    scales : array (n_variables,)
        What the variables of its program vary by.
    near : float
        Distance from a limit, in shares of its scale, within which it may push.
    """

    problem: Problem
    phases: Mapping[str, FittedPhase]
    q: Array
    scales: Array
    near: float


@dataclass(frozen=True)
class PointMultipliers:
    """Where path constraints without controls may push at a boundary of segments.

    Attributes
    ----------
    gradients : sparse array (n_variables, n_atoms)
        Of the constraints, by the program's variables.
    sizes : array (n_atoms,)
        What a constraint varies by.
    at_lower, at_upper : bool array (n_atoms,)
    """

    gradients: Any
    sizes: Array
    at_lower: Mask
    at_upper: Mask

    @classmethod
    def of(cls, transcription: Transcription, trajectory: SampledTrajectory) -> PointMultipliers:
        """Find them along a trajectory."""
        found = [cls._none(transcription.n_variables)]
        problem = trajectory.problem
        for name, part in transcription.parts.items():
            leg = problem.phases[name]
            orders = [constraint_order(problem, leg, i).order for i in range(len(leg.path_labels))]
            pure = np.flatnonzero([order != 0 for order in orders])
            if pure.size:
                touched_only = np.array([orders[i] == 1 for i in pure])
                found.append(_of_phase(transcription, part, trajectory, pure, touched_only))
        return cls(
            scipy.sparse.hstack([atoms.gradients for atoms in found], format="csc"),
            *(
                np.concatenate([getattr(a, name) for a in found])
                for name in ("sizes", "at_lower", "at_upper")
            ),
        )

    @classmethod
    def _none(cls, n_variables: int) -> PointMultipliers:
        nowhere = np.zeros(0, dtype=bool)
        return cls(scipy.sparse.csc_array((n_variables, 0)), np.zeros(0), nowhere, nowhere)


def path_gradients_at_boundaries(
    transcription: Transcription, part: PhasePart, functions: PhaseFunctions, at: tuple[Array, Array, Array]
) -> tuple[Indices, Array]:
    """Gradients of path constraints at the boundaries of a phase's segments, by the program's variables.

    Parameters
    ----------
    at : (K + 1,), (n_states, K + 1), (n_controls, K + 1)
        Times, states and controls at the boundaries.

    Returns
    -------
    places : int array (k, K + 1)
        Variables of the program: states, free times, free parameters.
    gradients : array (k, n_paths, K + 1)
    """
    collocation, n = part.collocation, at[0].size
    by_state, by_time, by_parameter = path_gradients(functions, collocation.n_paths, *at)
    free = part.times < transcription.n_variables
    others = np.concatenate([part.times[free], transcription.parameter_places])
    moved = _boundary_times(collocation.mesh)[free]
    return (
        np.vstack([collocation.boundary_states, np.repeat(others[:, None], n, axis=1)]),
        np.concatenate([by_state, moved[:, None] * by_time, by_parameter]),
    )


def _of_phase(
    transcription: Transcription,
    part: PhasePart,
    trajectory: SampledTrajectory,
    pure: Indices,
    touched_only: Mask,
) -> PointMultipliers:
    problem, fitted, q, scales = trajectory.problem, trajectory.phases, trajectory.q, trajectory.scales
    leg, polynomials = problem.phases[part.name], fitted[part.name]
    times = polynomials.x.breaks
    # A shared value belongs to the segment that begins with it, but for the last one.
    x, u = (np.hstack([p(times[:-1]), p(times[-1:], "left")]) for p in (polynomials.x, polynomials.u))
    none = np.zeros(len(leg.integrands))
    functions = phase_functions(problem, part.name, model_parameters(problem, leg, q), q, none)
    places, gradients = path_gradients_at_boundaries(transcription, part, functions, (times, x, u))
    gradients = gradients[:, pure]
    sizes = np.sum(np.abs(gradients) * scales[places][:, None], axis=0)
    at_lower, at_upper = _at_limits(leg, functions.paths(times, x, u)[pure], pure, trajectory.near * sizes)
    chosen = _may_push(at_lower | at_upper, touched_only)
    which, k = np.nonzero(chosen)
    columns = np.tile(np.arange(which.size), places.shape[0])
    return PointMultipliers(
        scipy.sparse.csc_array(
            (gradients[:, which, k].ravel(), (places[:, k].ravel(), columns)), shape=(scales.size, which.size)
        ),
        sizes[chosen],
        at_lower[chosen],
        at_upper[chosen],
    )


def _at_limits(leg: Phase, values: Array, pure: Indices, slack: Array) -> tuple[Mask, Mask]:
    limits: Interval = leg.path_interval()
    return values <= limits.lower[pure, None] + slack, values >= limits.upper[pure, None] - slack


def _may_push(active: Mask, touched_only: Mask) -> Mask:
    """Where active constraints (n, K + 1) may have an atom: not within arcs, nor at the ends of some constraints'."""
    before, after = np.zeros_like(active), np.zeros_like(active)
    before[:, 1:], after[:, :-1] = active[:, :-1], active[:, 1:]
    beside = np.where(touched_only[:, None], before | after, before & after)
    beside[:, [0, -1]] = False
    return np.asarray(active & ~beside)


def _boundary_times(mesh: Mesh) -> Array:
    """By how much each boundary moves with each anchor in time (n_anchors, K + 1)."""
    fractions = np.asarray(mesh.breaks)
    anchors = fractions[list(mesh.anchors)]
    return np.array([np.interp(fractions, anchors, one) for one in np.eye(anchors.size)])


_WRONG = 1e-7
"""Multipliers of the wrong sign below this share of the largest count as zero."""

_ACTIVE_SET_ITERATIONS = 8
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
    atoms = PointMultipliers.of(transcription, SampledTrajectory(problem, fitted, q, scales, near))
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
    for _ in range(_ACTIVE_SET_ITERATIONS):
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
    # The smallest multiplier is maximised, so that none vanishes at a point and has the wrong sign next to
    # it.
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
    """Spans of the variables along the trajectory, which are independent of origin and guess."""
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
