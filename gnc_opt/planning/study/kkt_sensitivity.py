r"""KKT sensitivity: derivatives of a solution from the linearised first-order conditions of its program.

With the variables at their limits fixed and the rows at theirs active (set C), a minimum solves

.. math:: \nabla_F \mathcal L(z, \lambda; p) = 0, \qquad g_C(z; p) = b, \qquad z_P = \beta,

with :math:`\mathcal L = f + \lambda^T g`, F the free and P the fixed variables. For a change of the data p, b and
:math:`\beta`, the implicit function theorem gives the derivatives of the minimum (Fiacco 1976),

.. math::
    \begin{pmatrix} \mathcal L_{FF} & g_F^T \\ g_F & 0 \end{pmatrix}
    \begin{pmatrix} \dot z_F \\ \dot \lambda \end{pmatrix} =
    -\begin{pmatrix} \mathcal L_{FP}\dot\beta + \mathcal L_{Fp}\dot p \\
                     g_P\dot\beta + g_p\dot p - \dot b \end{pmatrix},

and those of the minimum value, :math:`\dot f = \mathcal L_p \dot p + \mathcal L_P \dot\beta - \lambda^T \dot b`.

The module also predicts solutions of problems with slightly changed numbers.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.array_types import Array
from gnc_opt.errors import GncOptError, ProblemWarning, warn_user
from gnc_opt.numerical_tolerances import (
    ACTIVE,
    NEGLIGIBLE,
    RANK,
    ROUNDING,
    SMALL,
    TINY,
    max_norm,
    replace_zeros_by_one,
    set_nonfinite_to_zero,
)
from gnc_opt.planning.direct.fixed_mesh_solve import solve_problem_on_mesh
from gnc_opt.planning.nlp import SolverOptions
from gnc_opt.planning.optimality.active_state_constraints import impose_touch_points
from gnc_opt.planning.optimality.kkt_system import ProgramLimits, ProgramPoint, build_kkt_matrix
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.reformulation import reformulate_problem
from gnc_opt.planning.solution.costates import NlpIterate
from gnc_opt.planning.solution.initial_nlp_point import build_nlp_point_from_solution
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_from_nlp_result import build_phase_solutions
from gnc_opt.planning.transcription.scaling import choose_variable_scales
from gnc_opt.planning.transcription.transcription import Transcription, transcribe_problem

SENSITIVITY_SOLVE_TOLERANCE = 1e-12
"""Solver tolerance that separates active limits from others."""


@dataclass(frozen=True, eq=False)
class PredictedSolution:
    """Predicted solution as a guess, with its physical variables and their scales (n_variables,)."""

    guess: Solution
    variables: Array
    scales: Array

    def compute_prediction_error(self, found: Solution) -> float:
        """Return the largest error of the prediction, relative to the scales of the variables."""
        here = _transcribe_solution(found.need_problem("compare"), found)[1].x
        if here.shape != self.variables.shape:
            return 0.0  # not comparable on a refined mesh
        return float(np.max(np.abs(here - self.variables) / self.scales))


def predict_solution(
    problem: Problem, last: Solution, before: Solution | None, ratio: float
) -> PredictedSolution:
    """Return the predicted solution of ``problem`` from the ``last`` one and the one ``before`` it.

    The prediction uses the sensitivities of the last solution if both problems are variations of one another; otherwise
    it extrapolates both solutions linearly, ``ratio`` being the length of this step relative to the last one.
    """
    problem = reformulate_problem(problem)
    transcription, start = _transcribe_solution(problem, last)
    change = _predict_nlp_variable_change(problem, last)
    if change is None and before is not None:
        earlier = build_nlp_point_from_solution(transcription, problem, before).x
        change = ratio * (start.x - earlier)
    x = start.x if change is None or change.shape != start.x.shape else start.x + change
    box = transcription.get_variable_bounds(problem)
    x = np.clip(x, box.lower, np.maximum(box.lower, box.upper))
    phases, _ = build_phase_solutions(transcription, problem, NlpIterate(x, start.lam_x, start.lam_g))
    values = x[transcription.parameter_indices]
    guess = replace(last, phases=phases, parameter_values=values, problem=problem.frozen())
    return PredictedSolution(guess, x, choose_variable_scales(transcription, problem, start.x))


def _transcribe_solution(problem: Problem, solution: Solution) -> tuple[Transcription, NlpIterate]:
    meshes = {name: phase.mesh for name, phase in solution.phases.items()}
    transcription = transcribe_problem(problem, meshes, solution.scheme)
    return transcription, build_nlp_point_from_solution(transcription, problem, solution)


def _predict_nlp_variable_change(problem: Problem, last: Solution) -> Array | None:
    """Return the first-order change of the variables (n_variables,), or None if it is unknown."""
    old = last.need_problem("differentiate")
    if problem.builds is not old.builds:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", ProblemWarning
            )  # one-sided derivatives are sufficient for a prediction
            point = KktPoint(last)
            return point.differentiate_solution(
                _compute_problem_data_difference(point.program.transcription, old, problem)
            ).variables
    except GncOptError:
        return None


def _compute_problem_data_difference(
    transcription: Transcription, old: Problem, new: Problem
) -> DataPerturbation:
    """Return the difference between the data of two problems; infinite limits do not change."""

    def subtract_finite_entries(before: Array, after: Array) -> Array:
        with np.errstate(invalid="ignore"):  # inf - inf
            return set_nonfinite_to_zero(after - before)

    here, there = transcription.get_variable_bounds(old), transcription.get_variable_bounds(new)
    rows, new_rows = transcription.get_constraint_bounds(old), transcription.get_constraint_bounds(new)
    lower = subtract_finite_entries(here.lower, there.lower)
    upper = subtract_finite_entries(here.upper, there.upper)
    row_lower = subtract_finite_entries(rows.lower, new_rows.lower)
    row_upper = subtract_finite_entries(rows.upper, new_rows.upper)
    return DataPerturbation(
        transcription.stack_model_parameters_and_fixed_times(new)
        - transcription.stack_model_parameters_and_fixed_times(old),
        np.where(lower != 0, lower, upper),
        np.where(row_lower != 0, row_lower, row_upper),
    )


_NEWTON_MAX_RESIDUAL = 1e-10
"""Largest residual of the scaled conditions after Newton's method."""

_KKT_ROUNDING_RESIDUAL = 1e-13
"""Residual at rounding level."""


@dataclass(frozen=True)
class DataPerturbation:
    """Direction in the data of a program, physical.

    Attributes
    ----------
    numbers : array (n_numbers,)
        Model parameters and fixed times, in the order of ``Transcription.problem_data``.
    limits, row_limits : array (n_variables,), (n_constraints,)
        Active limits of variables and rows.
    """

    numbers: Array
    limits: Array
    row_limits: Array


@dataclass(frozen=True)
class SolutionDerivative:
    """Derivatives of the minimised functional and of the variables in a direction of the data, physical."""

    objective: float
    variables: Array


class KktPoint:
    """Solution as a point of its program, with the factorised system of first-order conditions.

    Raises
    ------
    GncOptError
        The system is singular, or the active limits implied by the multipliers are not those of the minimum.
    """

    def __init__(self, solution: Solution) -> None:
        trouble = self._solve_optimality_conditions(solution)
        if trouble:
            trouble = self._solve_optimality_conditions(solve_with_tighter_tolerance(solution))
        if trouble:
            raise GncOptError(trouble)
        self._warn_of_weakly_active_limits()

    # --- the point --------------------------------------------------------------------------------

    def _solve_optimality_conditions(self, solution: Solution) -> str:
        """Determine the active limits of a solution and solve the conditions; return an error message or ""."""
        self.program = ProgramPoint.from_solution(
            solution, impose=partial(impose_touch_points, with_arcs=True)
        )
        return self._solve_kkt_by_newton() or self._describe_active_set_error()

    def _solve_kkt_by_newton(self) -> str:
        """Apply Newton's method to the conditions; return an error message or ""."""
        best = np.inf
        for _ in range(8):
            self._factorise_kkt_system()
            residual = self.program.kkt_residual
            size = max_norm(residual)
            if size <= _KKT_ROUNDING_RESIDUAL or (size <= _NEWTON_MAX_RESIDUAL and size > 0.1 * best):
                break
            best = min(best, size)
            self.program = take_newton_step(self.program, self._system.solve_saddle_point_system(-residual))
        if not best <= _NEWTON_MAX_RESIDUAL and not size <= _NEWTON_MAX_RESIDUAL:
            worst = self._system.labels[int(np.argmax(np.abs(residual)))]
            return (
                f"the first-order conditions of '{self.program.problem.name}' do not hold at '{worst}' (residual "
                f"{size:.1e}): solve with a tighter tolerance, or refine the solution first."
            )
        return ""

    def _factorise_kkt_system(self) -> None:
        point = self.program
        free, held = np.flatnonzero(~self.program.variables.active), np.flatnonzero(self.program.rows.active)
        matrix = build_kkt_matrix(
            point.lagrangian_hessian[free][:, free], point.constraint_jacobian[held][:, free]
        )
        labels = [point.variables.labels[i] for i in free] + [point.rows.labels[i] for i in held]
        self._system = SaddlePointSystem(matrix, free.size, labels, self.program.problem.name)

    def _describe_active_set_error(self) -> str:
        """Return an error message if a multiplier has the wrong sign or a limit is violated; else ""."""
        culprits = [
            limits.labels[i]
            for limits, values, multipliers in self._list_limits_and_multipliers()
            for i in np.flatnonzero(
                (limits.get_active_multipliers(multipliers) < -ACTIVE)
                | (limits.compute_slack(values) < -ACTIVE)
            )
        ]
        if not culprits:
            return ""
        return (
            f"the limit of '{culprits[0]}' of '{self.program.problem.name}' is neither active nor inactive when the "
            "first-order conditions are solved exactly: refine the solution (bang-bang arcs with structure='auto') "
            "first."
        )

    def _warn_of_weakly_active_limits(self) -> None:
        weak = [
            limits.labels[i]
            for limits, values, multipliers in self._list_limits_and_multipliers()
            for i in np.flatnonzero(limits.mask_weakly_active_limits(values, multipliers))
        ]
        if weak:
            others = f" and {len(weak) - 1} more" if len(weak) > 1 else ""
            warn_user(
                f"'{weak[0]}'{others} of '{self.program.problem.name}' is only just at its limit (weakly active), "
                "where the solution has two one-sided derivatives; the sensitivities are those of one of the sides."
            )

    def _list_limits_and_multipliers(self) -> list[tuple[ProgramLimits, Array, Array]]:
        point = self.program
        # The signs of multipliers that are not unique have no meaning.
        unique = np.nan if self._system.redundant else 1.0
        bounds, rows = point.multiplier_densities
        return [
            (point.variables, point.x, unique * bounds),
            (point.rows, point.constraint_values, unique * rows),
        ]

    # --- derivatives ------------------------------------------------------------------------------

    def differentiate_solution(self, change: DataPerturbation) -> SolutionDerivative:
        """Return the derivative of the minimum in a direction of the data."""
        point, scales, rows = self.program, self.program.scaling.variables, self.program.scaling.rows
        n_rest = point.parameter_values.size - change.numbers.size
        direction = np.concatenate([change.numbers, np.zeros(n_rest)])
        moved = np.where(self.program.variables.active, change.limits, 0.0) / scales
        shifted = np.where(self.program.rows.active, change.row_limits, 0.0) * rows
        of_lagrangian, of_gradient, of_rows = (
            v.full().ravel()
            for v in _build_kkt_directional_derivatives(self.program.transcription)(
                point.x, point.parameter_values, point.lam, direction
            )
        )
        free, held = ~self.program.variables.active, self.program.rows.active
        right = np.concatenate(
            [
                (of_gradient + point.lagrangian_hessian @ moved)[free],
                (of_rows + point.constraint_jacobian @ moved - shifted)[held],
            ]
        )
        solved = self._system.solve_saddle_point_system(-right)
        variables = moved.copy()
        variables[free] = solved[: int(np.sum(free))]
        objective = float(of_lagrangian[0] + point.lagrangian_gradient @ moved - point.lam @ shifted)
        return SolutionDerivative(objective / self.program.scaling.objective, variables * scales)


def take_newton_step(point: ProgramPoint, step: Array) -> ProgramPoint:
    """Return the point after a step of the free variables and of the multipliers of active rows, stacked."""
    free, held = ~point.variables.active, point.rows.active
    x, lam, n = point.x.copy(), point.lam.copy(), int(np.sum(free))
    x[free] += step[:n]
    lam[held] += step[n:]
    return replace(point, x=x, lam=lam)


SINGULAR_MIN_CONDITION = 1e13
"""Condition number of the scaled system above which its solution has no reliable digits."""

SADDLE_REFINEMENTS = 6
"""Numbers of steps of inverse iteration and of iterative refinement."""


class SaddlePointSystem:
    """Symmetric indefinite sparse system; redundant consistent rows are allowed, undetermined variables are not."""

    def __init__(self, matrix: Any, n_primal: int, labels: list[str], name: str) -> None:
        self.labels, self._n, self._name = labels, n_primal, name
        self._scale = _equilibrate_rows(matrix)
        diagonal = scipy.sparse.diags_array(self._scale)
        self._matrix = scipy.sparse.csc_array(diagonal @ matrix @ diagonal)
        # SuperLU may print a message about a structurally singular matrix instead of raising.
        self.redundant = scipy.sparse.csgraph.structural_rank(self._matrix) < matrix.shape[0]
        if not self.redundant:
            try:
                self._factors = scipy.sparse.linalg.splu(self._matrix)
                self.redundant = not self._estimate_condition_number() < SINGULAR_MIN_CONDITION
            except RuntimeError:  # a pivot is zero
                self.redundant = True
        if self.redundant:
            self._reject_undetermined_variables()

    def _estimate_condition_number(self) -> float:
        n = self._matrix.shape[0]
        inverse = scipy.sparse.linalg.LinearOperator(
            (n, n),
            matvec=self._factors.solve,
            rmatvec=lambda b: self._factors.solve(b, trans="T"),
            dtype=float,
        )
        return (
            float(scipy.sparse.linalg.onenormest(inverse) * np.max(np.abs(self._matrix).sum(axis=0)))
            if n > 1
            else 1.0
        )

    def _reject_undetermined_variables(self) -> None:
        """Raise `GncOptError` if a singular system leaves a variable undetermined; multipliers may be undetermined."""
        n = self._matrix.shape[0]
        signs = np.where(np.arange(n) < self._n, 1.0, -1.0)
        self._factors = scipy.sparse.linalg.splu(
            scipy.sparse.csc_array(self._matrix + RANK * scipy.sparse.diags_array(signs))
        )
        null = np.random.default_rng(0).standard_normal(n)
        for _ in range(SADDLE_REFINEMENTS):
            null = self._factors.solve(null / np.max(np.abs(null)))
        null /= np.max(np.abs(null))
        if max_norm(null[: self._n]) > SMALL:
            contradicted = self.labels[int(np.argmax(np.abs(null[: self._n])))]
            raise GncOptError(
                f"the first-order conditions of '{self._name}' do not determine '{contradicted}' (the KKT system is "
                "singular): the cost must depend on it; a singular arc needs refine(solution, structure='auto') "
                "first, and a quantity that nothing depends on must be fixed."
            )

    def solve_saddle_point_system(self, right: Array) -> Array:
        """Return the solution, with iterative refinement that also removes the shift of a redundant system."""
        scaled = self._scale * right
        solved = self._factors.solve(scaled)
        smallest = 5 * np.finfo(float).eps * np.max(np.abs(scaled), initial=TINY)
        for _ in range(SADDLE_REFINEMENTS):
            rest = scaled - self._matrix @ solved
            if max_norm(rest) <= smallest:
                break
            solved = solved + self._factors.solve(rest)
        rest = scaled - self._matrix @ solved
        if not max_norm(rest) <= NEGLIGIBLE * np.max(np.abs(scaled), initial=TINY) + ROUNDING:
            contradicted = self.labels[int(np.argmax(np.abs(rest)))]
            raise GncOptError(
                f"the limits of '{self._name}' that are active contradict its constraints, at '{contradicted}': "
                "refine bang-bang arcs with refine(solution, structure='auto') first, or free a boundary value that is "
                "given twice."
            )
        return np.asarray(solved * self._scale)


def _equilibrate_rows(matrix: Any) -> Array:
    """Return symmetric scale factors for which the largest entry of every row is near 1."""
    scale = np.ones(matrix.shape[0])
    absolute = scipy.sparse.coo_array(np.abs(matrix))
    for _ in range(4):
        norms = np.zeros(scale.size)
        np.maximum.at(norms, absolute.row, absolute.data * scale[absolute.row] * scale[absolute.col])
        scale = scale / np.sqrt(replace_zeros_by_one(norms))
    return scale


def _build_kkt_directional_derivatives(transcription: Transcription) -> Any:
    """Return (x, p, lam, dp) -> directional derivatives along dp of L, of its gradient and of g."""
    if "sensitivity" not in transcription.built:
        nlp = transcription.nlp
        lam, dp = ca.MX.sym("lam", nlp.n_constraints), ca.MX.sym("dp", nlp.n_parameters)
        lagrangian = nlp.f + ca.dot(lam, nlp.g)
        gradient = ca.gradient(lagrangian, nlp.x)
        outputs = [ca.densify(ca.jtimes(e, nlp.p, dp)) for e in (lagrangian, gradient, nlp.g)]
        transcription.built["sensitivity"] = ca.Function("sensitivity", [nlp.x, nlp.p, lam, dp], outputs)
    return transcription.built["sensitivity"]


def solve_with_tighter_tolerance(solution: Solution) -> Solution:
    """Return the solution on its own mesh with a tolerance that separates active limits; unchanged on failure."""
    problem = solution.need_problem("solve")
    options = SolverOptions(tolerance=SENSITIVITY_SOLVE_TOLERANCE)
    again = solve_problem_on_mesh(problem, scheme=solution.scheme, guess=solution, options=options)
    return again if again.status.solved else solution
