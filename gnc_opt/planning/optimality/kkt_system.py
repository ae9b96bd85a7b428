r"""Solution as a point of its program, and the linear algebra of second-order conditions and sensitivities there.

Variables at their limits are fixed (set P, the others F), and rows at their limits are active (set C). The first-order
conditions at the point are

.. math:: \nabla_F \mathcal L(z, \lambda) = 0, \qquad g_C(z) = b, \qquad \mathcal L = f + \lambda^T g.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from gnc_opt.array_types import Array, Indices, Mask, compute_interval_midpoints
from gnc_opt.numerical_tolerances import ACTIVE, MINOR, NEGLIGIBLE, RANK, ROUNDING, TINY, replace_zeros_by_one
from gnc_opt.planning.nlp.partially_separable_nlp import convert_casadi_to_scipy
from gnc_opt.planning.optimality.active_state_constraints import impose_touch_points
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.initial_nlp_point import build_nlp_point_from_solution
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.scaling import Scaling, choose_row_scales, choose_variable_scales
from gnc_opt.planning.transcription.transcription import Transcription, transcribe_problem


@dataclass(frozen=True, eq=False)
class ProgramLimits:
    """Scaled limits of variables or rows; ``active`` (n,): equal limits, or a multiplier larger than the distance."""

    box: Interval
    active: Mask
    at: Array
    labels: tuple[str, ...]

    @classmethod
    def determine_active_set(
        cls, bounds: Interval, values: Array, multipliers: Array, labels: tuple[str, ...]
    ) -> ProgramLimits:
        """Return the limits with the active set determined from values and multipliers (densities)."""
        at_lower = (multipliers < 0) & (values - bounds.lower < -multipliers)
        at_upper = (multipliers > 0) & (bounds.upper - values < multipliers)
        active = bounds.is_fixed | at_lower | at_upper
        limit = np.where(at_upper, bounds.upper, bounds.lower)
        return cls(bounds, active, np.where(active, limit, 0.0), labels)

    def get_active_multipliers(self, multipliers: Array) -> Array:
        """Return the inward multiplier of each active limit, > 0 for an admissible sign; NaN elsewhere."""
        upper = (self.at == self.box.upper) & (self.box.lower < self.box.upper)
        inward = np.where(upper, multipliers, -multipliers)
        return np.where(self.active & ~self.box.is_fixed, inward, np.nan)

    def compute_slack(self, values: Array) -> Array:
        """Return the distance of inactive entries to their nearer limit, negative beyond it; NaN elsewhere."""
        distance = np.minimum(values - self.box.lower, self.box.upper - values)
        return np.where(self.active, np.nan, distance)

    def mask_weakly_active_limits(self, values: Array, multipliers: Array) -> Mask:
        """Return which limits are weakly active: nearly reached with zero multiplier, or vice versa."""
        inward, slack = self.get_active_multipliers(multipliers), self.compute_slack(values)
        return np.asarray((inward < ACTIVE) | (slack < ACTIVE))


@dataclass(frozen=True, eq=False)
class ProgramPoint:
    """Scaled variables ``x`` (n_variables,) and multipliers ``lam`` (n_constraints,; 0 in inactive rows) of a program.

    ``variables.active`` is the set P, ``rows.active`` the set C; ``rounding`` is the rounding error of the scaled cost.
    """

    problem: Problem
    transcription: Transcription
    scaling: Scaling
    x: Array
    lam: Array
    variables: ProgramLimits
    rows: ProgramLimits
    rounding: float = 0.0

    @classmethod
    def from_solution(
        cls,
        solution: Solution,
        meshes: Mapping[str, Mesh] | None = None,
        choose_scales: Callable[[Transcription, Problem, Array], Array] = choose_variable_scales,
        rounding: float = 0.0,
        impose: Callable[[Solution], Problem] = impose_touch_points,
    ) -> ProgramPoint:
        """Return the point of a solution with its problem, on its own meshes or interpolated to others.

        ``choose_scales`` returns the scales (n_variables,); costs below ``rounding`` are rounding;
        ``impose`` returns the problem with active state constraints.
        """
        problem = impose(solution)
        meshes = meshes or {name: phase.mesh for name, phase in solution.phases.items()}
        transcription = transcribe_problem(problem, meshes, solution.scheme)
        point = build_nlp_point_from_solution(transcription, problem, solution)
        x, lam_x, lam_g = point.x, point.lam_x, point.lam_g
        scales = choose_scales(transcription, problem, x)
        row_scales, objective = choose_row_scales(transcription, problem, x, scales)
        objective = min(objective, 1 / rounding) if rounding > 0 else objective
        scaling = Scaling(scales, row_scales, objective)
        lam = lam_g / row_scales * objective
        bounds = _scale_bounds(transcription.get_variable_bounds(problem), scales)
        row_bounds = _scale_bounds(transcription.get_constraint_bounds(problem), 1 / row_scales)
        weights, row_weights = compute_quadrature_weights(transcription)
        p = transcription.build_parameter_vector(problem, scales, row_scales, objective)
        g = transcription.nlp.jac_g(x / scales, p)[0].full().ravel()
        variables = ProgramLimits.determine_active_set(
            bounds, x / scales, lam_x * scales * objective / weights, transcription.variable_labels
        )
        labels = transcription.constraint_row_labels
        rows = ProgramLimits.determine_active_set(row_bounds, g, lam / row_weights, labels)
        return cls(
            problem,
            transcription,
            scaling,
            np.where(variables.active, variables.at, x / scales),
            np.where(rows.active, lam, 0.0),
            variables,
            rows,
            rounding * objective,
        )._estimate_junction_multipliers()

    def _estimate_junction_multipliers(self) -> ProgramPoint:
        """Return the point with the junction multipliers for which the Lagrangian is stationary in the states there."""
        if not self.transcription.junctions:
            return self
        states_and_rows = [
            (self.transcription.parts[name].collocation.boundary_states[:, junction.boundary], rows)
            for name, junction, rows in self.transcription.junctions
        ]
        states, rows = (np.unique(np.concatenate(indices)) for indices in zip(*states_and_rows, strict=True))
        states = states[~self.variables.active[states]]
        by_state = self.constraint_jacobian[rows][:, states].toarray()
        slope = self.lagrangian_gradient[states]
        if not (np.isfinite(by_state).all() and np.isfinite(slope).all()):
            return self
        lam = self.lam.copy()
        lam[rows] += np.linalg.lstsq(by_state.T, -slope, rcond=RANK)[0]
        return replace(self, lam=lam)

    # --- values and derivatives -------------------------------------------------------------------

    @cached_property
    def parameter_values(self) -> Array:
        s = self.scaling
        return self.transcription.build_parameter_vector(self.problem, s.variables, s.rows, s.objective)

    @cached_property
    def _constraint_values_and_jacobian(self) -> tuple[Array, Any]:
        g, jacobian = self.transcription.nlp.jac_g(self.x, self.parameter_values)
        return g.full().ravel(), convert_casadi_to_scipy(jacobian)

    @property
    def constraint_values(self) -> Array:
        """Values of all rows (n_constraints,)."""
        return self._constraint_values_and_jacobian[0]

    @property
    def constraint_jacobian(self) -> Any:
        """Jacobian of all rows in all variables, sparse."""
        return self._constraint_values_and_jacobian[1]

    @cached_property
    def lagrangian_gradient(self) -> Array:
        """Gradient of the Lagrangian (n_variables,)."""
        slope = self.transcription.nlp.grad_f(self.x, self.parameter_values)[1].full().ravel()
        return np.asarray(slope + self.constraint_jacobian.T @ self.lam)

    @cached_property
    def lagrangian_hessian(self) -> Any:
        """Hessian of the Lagrangian, sparse (n_variables, n_variables)."""
        return self.evaluate_hessian(1.0, self.lam)

    def evaluate_hessian(self, objective: float, multipliers: Array) -> Any:
        """Return the Hessian of ``objective * f + multipliers @ g``, sparse (n_variables, n_variables)."""
        triangle = self.transcription.nlp.hess_lag(self.x, self.parameter_values, objective, multipliers)
        upper = convert_casadi_to_scipy(triangle)
        return scipy.sparse.csc_array(upper + scipy.sparse.triu(upper, 1).T)

    @property
    def is_finite(self) -> bool:
        matrices = self.constraint_jacobian, self.lagrangian_hessian
        return all(bool(np.isfinite(matrix.data).all()) for matrix in matrices)

    @property
    def kkt_residual(self) -> Array:
        """Residual of the first-order conditions: gradient in the free variables, followed by active rows."""
        active = self.rows.active
        excess = (self.constraint_values - self.rows.at)[active]
        return np.concatenate([self.lagrangian_gradient[~self.variables.active], excess])

    @cached_property
    def multiplier_densities(self) -> tuple[Array, Array]:
        """Multipliers of the limits of variables and rows, those along a phase as densities in its fraction."""
        weights, row_weights = compute_quadrature_weights(self.transcription)
        return -self.lagrangian_gradient / weights, self.lam / row_weights


def build_kkt_matrix(hessian: Any, jacobian: Any) -> Any:
    """Return the symmetric matrix of a quadratic program with equality constraints, sparse."""
    return scipy.sparse.block_array([[hessian, jacobian.T], [jacobian, None]], format="csc")


def compute_quadrature_weights(transcription: Transcription) -> tuple[Array, Array]:
    """Return quadrature weights (shares of the phase) of variables and rows along a phase; 1 elsewhere."""
    variables, rows = np.ones(transcription.n_variables), np.ones(transcription.n_constraints)
    for part in transcription.parts.values():
        collocation = part.collocation
        variables[collocation.point_controls] = collocation.quadrature_weights
        is_inner = ~np.isin(collocation.point_states, collocation.boundary_states)
        point_weights = np.broadcast_to(collocation.quadrature_weights, is_inner.shape)
        variables[collocation.point_states[is_inner]] = point_weights[is_inner]
        rows[collocation.path_rows] = collocation.quadrature_weights
    return variables, rows


def _scale_bounds(box: Interval, scales: Array) -> Interval:
    return Interval(box.lower / scales, box.upper / scales)


DENSE_ROW_MIN_ENTRIES = 200
"""Number of entries above which a row is dense; a collocation row has those of the points of its segment."""


def factorise_symmetric_matrix(matrix: Any) -> Callable[[Array], Array]:
    """Return the solver of a sparse symmetric system (n, n), a function of the right-hand side (n,).

    The rows of a collocated program are banded (Cuthill & McKee), except for those of quantities common to a whole
    phase, such as a free final time. These come last and are scaled down, so that they become pivots early only if the
    band alone is singular.
    """
    matrix = scipy.sparse.csr_array(matrix)
    dense = np.diff(matrix.indptr) > DENSE_ROW_MIN_ENTRIES
    if not np.any(dense):
        solve: Callable[[Array], Array] = scipy.sparse.linalg.splu(scipy.sparse.csc_array(matrix)).solve
        return solve
    sparse = np.flatnonzero(~dense)
    band = scipy.sparse.csr_matrix(matrix[sparse][:, sparse])
    order = scipy.sparse.csgraph.reverse_cuthill_mckee(band, symmetric_mode=True)
    order = np.concatenate([sparse[order], np.flatnonzero(dense)])
    scale = np.where(dense[order], ROUNDING, 1.0)
    ordered = scipy.sparse.diags_array(scale) @ matrix[order][:, order]
    factors = scipy.sparse.linalg.splu(scipy.sparse.csc_array(ordered), permc_spec="NATURAL")

    def solve_permuted_system(right: Array) -> Array:
        solution = np.empty(right.size)
        solution[order] = factors.solve(scale * right[order])
        return solution

    return solve_permuted_system


@dataclass(frozen=True, eq=False)
class NullSpace:
    """Variations of a program in which some variables and ``rows`` are fixed.

    Variations are relative to the scales, with weights for which the sum of squares is an integral over time; ``unit``
    (n_variables, n_variations; sparse) has the scaled variables of each. ``jacobian`` (sparse) contains the
    gradients of the fixed rows, divided by their ``norms``, then those of fixed variables that variations would change,
    then additional rows.
    """

    unit: Any
    rows: Indices
    norms: Array
    jacobian: Any

    @classmethod
    def with_fixed_variables(
        cls, point: ProgramPoint, fixed: Mask, unit: Any = None, extra_rows: Any = None
    ) -> NullSpace:
        """Return the space in which ``fixed`` (n_variables + n_constraints,) are fixed.

        ``unit`` (n_variables, n_variations) replaces one variation per variable; ``extra_rows`` are fixed, too.
        """
        fixed, rows = fixed[: point.x.size], np.flatnonzero(fixed[point.x.size :])
        if unit is None:
            weights = compute_variation_norm_weights(point.transcription)
            unit = scipy.sparse.diags_array(1 / np.sqrt(weights), format="csc")
        unit = unit[:, np.flatnonzero(abs(unit[~fixed]).sum(axis=0) > 0)]
        fixed_unit = unit[fixed]
        fixed_unit = fixed_unit[np.flatnonzero(abs(fixed_unit).sum(axis=1) > 0)]
        jacobian, norms = _normalise_matrix_rows(point.constraint_jacobian[rows] @ unit)
        blocks = [jacobian, _normalise_matrix_rows(fixed_unit)[0]]
        if extra_rows is not None:
            blocks.append(_normalise_matrix_rows(extra_rows @ unit)[0])
        return cls(unit, rows, norms, scipy.sparse.vstack(blocks, format="csc"))

    @property
    def dimension(self) -> int:
        return int(self.unit.shape[1])

    def project_to_null_space(self, hessian: Any) -> Any:
        """Return a Hessian in all scaled variables as a Hessian in the variations."""
        return scipy.sparse.csc_array(self.unit.T @ hessian @ self.unit)

    def factorise_hessian(self, hessian: Any) -> tuple[Any, Callable[[Array], Array]]:
        """Return the saddle-point matrix of a Hessian and the rows, and its solver."""
        n, m = self.dimension, self.jacobian.shape[0]
        matrix = build_kkt_matrix(hessian, self.jacobian)
        # With rows of unit norm, this slack makes dependent rows harmless; in moving frames they are nearly dependent.
        slack = scipy.sparse.diags_array(np.where(np.arange(n + m) < n, 0.0, NEGLIGIBLE * ROUNDING))
        return matrix, factorise_symmetric_matrix(matrix - slack)

    @cached_property
    def projection_factors(self) -> tuple[Any, Callable[[Array], Array]]:
        """Return the saddle-point matrix of the identity and its solver, a projection onto the null space."""
        return self.factorise_hessian(scipy.sparse.eye_array(self.dimension))

    def invert_projected_hessian(self, hessian: Any = None) -> Callable[[Array], Array]:
        """Return the inverse of a Hessian, by default the identity (a projection), restricted to the null space."""
        matrix, solve = self.projection_factors if hessian is None else self.factorise_hessian(hessian)
        rows = np.zeros(self.jacobian.shape[0])

        def apply_projected_inverse(vector: Array) -> Array:
            right = np.concatenate([vector, rows])
            solved = solve(right)
            solved = solved + solve(right - matrix @ solved)  # removes the slack of `factorise_hessian`
            return np.asarray(solved[: vector.size])

        return apply_projected_inverse


def compute_curvature(hessian: Any, direction: Array) -> tuple[float, float]:
    """Return the curvature along a direction, absolute and relative to the sum of its terms."""
    value = float(direction @ (hessian @ direction))
    magnitude = float(np.abs(direction) @ (abs(hessian) @ np.abs(direction)))
    return value, value / max(magnitude, TINY)


def run_lanczos(operate: Callable[[Array], Array], start: Array, steps: int) -> tuple[Array, Array]:
    """Return approximate eigenvalues (k,) and eigenvectors (n, k) of a symmetric operator, from ``start`` (n,)."""
    size = float(np.linalg.norm(start))
    if not size > 0:
        return np.zeros(0), np.zeros((start.size, 0))
    space = np.empty((min(steps, start.size) + 1, start.size))
    space[0] = start / size
    diagonal: list[float] = []
    subdiag: list[float] = []
    for k in range(space.shape[0] - 1):
        image = operate(space[k])
        diagonal.append(float(space[k] @ image))
        for _ in range(2):
            image = image - space[: k + 1].T @ (space[: k + 1] @ image)
        length = float(np.linalg.norm(image))
        if length <= NEGLIGIBLE * max(map(abs, diagonal)) or (
            k % 10 == 9 and are_extreme_eigenvalues_converged(diagonal, subdiag, length)
        ):
            break
        subdiag.append(length)
        space[k + 1] = image / length
    n = len(diagonal)
    values, vectors = scipy.linalg.eigh_tridiagonal(diagonal, subdiag[: n - 1])
    return values, space[:n].T @ vectors


def are_extreme_eigenvalues_converged(diagonal: list[float], subdiag: list[float], length: float) -> bool:
    """Return whether both ends of the spectrum have converged, from the last components of their eigenvectors."""
    values, vectors = scipy.linalg.eigh_tridiagonal(diagonal, subdiag)
    return bool(np.max(length * np.abs(vectors[-1, [0, -1]])) <= MINOR * np.max(np.abs(values)))


def _normalise_matrix_rows(rows: Any) -> tuple[Any, Array]:
    """Return the rows with norm 1 (zero rows stay), and the norms by which they were divided (m,)."""
    norms = np.sqrt(np.asarray((rows**2).sum(axis=1)))
    norms = replace_zeros_by_one(norms)
    return scipy.sparse.diags_array(1 / norms) @ rows, norms


def compute_variation_norm_weights(transcription: Transcription) -> Array:
    """Return the weights of the squares of scaled variables in the norm of a variation (n_variables,)."""
    weights, _ = compute_quadrature_weights(transcription)
    for part in transcription.parts.values():
        collocation = part.collocation
        # States at inner boundaries follow from the points; they are weighted by the adjacent segments.
        widths = collocation.mesh.segment_widths
        weights[collocation.boundary_states[:, 1:-1]] = compute_interval_midpoints(widths)
    return weights
