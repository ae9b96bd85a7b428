"""Problem on one mesh, ready for the solver: program, scaling, initial point, and conversion of the result."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from gnc_opt.array_types import Array, Indices
from gnc_opt.planning.nlp import IterationInfo, NlpPoint, NlpResult, NlpSolver, SolverOptions
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.constraint_violation_diagnosis import list_iterate_violations
from gnc_opt.planning.solution.costates import NlpIterate
from gnc_opt.planning.solution.initial_nlp_point import (
    build_nlp_point_from_solution,
    choose_initial_variables,
)
from gnc_opt.planning.solution.refinement_history import Statistics
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_from_nlp_result import build_phase_solutions, unwrap_angle_controls
from gnc_opt.planning.transcription.collocation_families import Scheme
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.scaling import Scaling, choose_row_scales, choose_variable_scales
from gnc_opt.planning.transcription.transcription import Transcription, transcribe_problem
from gnc_opt.threads_and_package_versions import list_software_versions

ShowIteration: TypeAlias = Callable[[IterationInfo], None]


@dataclass(frozen=True, eq=False)
class ScaledNlp:
    """Nonlinear program of a problem on given meshes, with numbers, scaling and initial point.

    ``start`` (n_variables,) is that of a ``known`` solution, with its multipliers, or of the problem's guess.
    ``options`` are those of the user (those of the solver may be adapted to the mesh), ``build_s`` the wall time of the
    preparation, s; ``reused`` indicates a solver of an earlier solve, ``progress`` the display of iterations.
    """

    transcription: Transcription
    problem: Problem
    solver: NlpSolver
    options: SolverOptions
    scaling: Scaling
    start: Array
    known: NlpIterate | None
    build_s: float
    reused: bool
    progress: bool = False

    @classmethod
    def from_problem(
        cls,
        problem: Problem,
        meshes: Mapping[str, Mesh],
        scheme: Scheme,
        guess: Solution | None,
        options: SolverOptions,
        *,
        progress: bool = False,
    ) -> ScaledNlp:
        """Transcribe and scale a problem (or reuse an earlier program) and determine an initial point."""
        begin = time.perf_counter()
        transcription = transcribe_problem(problem, meshes, scheme)
        # Short arcs make the linear systems nearly singular.
        has_arcs = any(part.collocation.mesh.movable for part in transcription.parts.values())
        is_chosen = options.careful_pivoting is not None or not has_arcs
        adapted = options if is_chosen else replace(options, careful_pivoting=True)
        key = repr(adapted)
        if not (reused := key in transcription.built):
            transcription.built[key] = NlpSolver(transcription.nlp, adapted)
        solver: NlpSolver = transcription.built[key]
        known = None if guess is None else build_nlp_point_from_solution(transcription, problem, guess)
        start = choose_initial_variables(transcription, problem) if known is None else known.x
        scales = choose_variable_scales(transcription, problem, start)
        scaling = Scaling(scales, *choose_row_scales(transcription, problem, start, scales))
        build_s = time.perf_counter() - begin
        return cls(transcription, problem, solver, options, scaling, start, known, build_s, reused, progress)

    def build_scaled_nlp_point(
        self,
        x: Array,
        known: NlpIterate | None = None,
        *,
        held: Indices | None = None,
        with_cost: bool = True,
    ) -> NlpPoint:
        """Return the scaled solver input for x, with multipliers if ``known``, with ``held`` variables fixed."""
        transcription, problem, scaling = self.transcription, self.problem, self.scaling
        variables = transcription.get_variable_bounds(problem)
        rows = transcription.get_constraint_bounds(problem)
        if held is not None:
            variables.lower[held] = variables.upper[held] = x[held]
        scales, factor = scaling.variables, scaling.objective if with_cost else 0.0
        return NlpPoint(
            x / scales,
            variables.lower / scales,
            variables.upper / scales,
            rows.lower * scaling.rows,
            rows.upper * scaling.rows,
            transcription.build_parameter_vector(problem, scales, scaling.rows, factor),
            None if known is None else known.lam_x * scales * factor,
            None if known is None else known.lam_g / scaling.rows * factor,
        )

    @contextmanager
    def display_solver_progress(self, *, with_cost: bool) -> Iterator[ShowIteration]:
        """Provide the function that displays iterations, without effect unless progress is displayed."""
        if not self.progress:
            yield lambda info: None
            return
        from gnc_opt.progress_display import show_solve_progress

        # In the sense and unit of the user.
        factor = self.problem.sense * self.scaling.objective if with_cost else 1.0
        with show_solve_progress(self.problem.name) as show:
            yield lambda info: show(info.iteration, info.objective / factor, info.infeasibility)

    def build_solution_from_nlp_result(self, result: NlpResult) -> Solution:
        """Return the solution of a solver result; its problem is a frozen copy."""
        transcription, problem, scaling = self.transcription, self.problem, self.scaling
        iterate = NlpIterate(
            result.x * scaling.variables,
            result.lam_x / scaling.variables / scaling.objective,
            result.lam_g * scaling.rows / scaling.objective,
        )
        bounds = transcription.get_variable_bounds(problem)
        # Scaling and unscaling rounds; fixed variables must equal their bounds exactly.
        iterate = replace(iterate, x=np.where(bounds.is_fixed, bounds.lower, iterate.x))
        iterate = replace(iterate, x=unwrap_angle_controls(transcription, problem, iterate.x))
        phases, gradients = build_phase_solutions(transcription, problem, iterate)
        places, parts = transcription.parameter_indices, transcription.parts
        return Solution(
            problem_name=problem.name,
            status=result.status,
            objective=gradients.cost,
            maximised=problem.sense < 0,
            phases=phases,
            free_parameters=problem.parameters,
            parameter_values=iterate.x[places],
            parameter_multipliers=iterate.lam_x[places],
            constraint_labels=problem.constraint_labels(),
            constraint_values=gradients.constraints,
            constraint_multipliers=iterate.lam_g[transcription.constraint_rows],
            violations=list_iterate_violations(
                transcription, problem, result, scaling, phases, iterate.x[places]
            ),
            statistics=Statistics(
                result.iterations,
                self.build_s,
                result.wall_time,
                result.function_time,
                result.linear_solver_time,
                self.reused,
            ),
            provenance={
                **list_software_versions(),
                "scheme": transcription.scheme,
                "mesh": ", ".join(f"{name} {part.collocation.mesh}" for name, part in parts.items()),
                "options": repr(self.options),
                "fingerprint": problem.fingerprint(),
            },
            problem=problem.frozen(),
        )
