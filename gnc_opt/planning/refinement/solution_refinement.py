"""Refinement of a solution to a given accuracy, with an optimality check."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, TypeAlias, get_args

from gnc_opt.argument_checks import read_positive_number, require_type, suggest_keywords
from gnc_opt.errors import ProblemError, suggest_similar_name
from gnc_opt.planning.direct.computation_budget import RefinementLimits, WorkBudget
from gnc_opt.planning.direct.fixed_mesh_solve import solve_problem_on_mesh
from gnc_opt.planning.nlp import SolverOptions, Status
from gnc_opt.planning.refinement.staged_refinement import StagedRefinement
from gnc_opt.planning.solution.initial_nlp_point import fix_mesh_breaks
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.runtime_environment import limit_to_one_thread

StructureChoice: TypeAlias = Literal["auto", "bang-bang", "none"]


@limit_to_one_thread()
@suggest_keywords
def refine(
    solution: Solution,
    *,
    tol: float = 1e-8,
    structure: StructureChoice = "auto",
    check: bool = True,
    limits: RefinementLimits | None = None,
    options: SolverOptions | None = None,
    progress: bool = False,
) -> Solution:
    """Return a more accurate solution of the same problem, with its ``history``.

    Parameters
    ----------
    solution : Solution
        A converged solution with its problem. Arcs fixed by `Problem.with_fixed_arcs` belong to its mesh: the refined
        solution is one of the problem without them.
    tol : float
        On the local errors (`gnc_opt.planning.refinement.collocation_error_estimate`) and on the estimated
        relative error of the objective (`gnc_opt.planning.solution.solution_accuracy`).
    structure : {"auto", "bang-bang", "none"}
        ``"none"``: hp refinement of the mesh. ``"bang-bang"``: detect the bound arcs of each control, optimise their
        switching times, and update the structure until it agrees with the switching functions. Kinks at which controls
        enter or leave bounds or mixed path constraints, singular arcs and arcs on state bounds are detected likewise.
        ``"auto"``: the sequence of meshes, see `gnc_opt.planning.refinement.staged_refinement`.
    check : bool
        Whether the solution must pass the optimality check. Without the check, the first solution is returned whose
        estimated error of the objective is within the tolerance; its history ends as UNCHECKED.
    limits : RefinementLimits, optional
        On passes, points, work and wall time. At a limit, and after Ctrl-C, the best solution so far is returned.
    options : SolverOptions, optional
        Options of the solves; a wall time limit in them applies to one solve.
    progress : bool
        Print one line per pass.

    Returns
    -------
    Solution
        With ``history`` and, if switching times were optimised, ``structure``. The history ends as CONVERGED only if
        the tolerance was reached and no condition of the optimality check fails; otherwise its message lists them. The
        verdict is stored in the solution: ``verify(solution)`` returns it without another check.

    Raises
    ------
    GncOptError
        The solution has no problem or is not solved.
    ProblemError
        ``structure`` is unknown, or is ``"bang-bang"`` and no control is linear in H with finite bounds.

    Examples
    --------
    >>> coarse = go.solve(problem, mesh="5x3", tol=None)
    >>> print(abs(coarse.objective - 2) < 1e-6, abs(go.refine(coarse).objective - 2) < 1e-8)
    False True
    """
    require_type(solution, Solution, "the argument of refine()", "write refine(solve(problem))")
    read_positive_number(tol, "the tolerance of refine()")
    limits = limits or RefinementLimits()
    require_type(limits, RefinementLimits, "the limits of refine()", "write RefinementLimits(max_points=500)")
    solution.need_solved_problem("refine")
    budget = WorkBudget.start_work_budget(limits)
    stages = StagedRefinement(solution.need_problem("refine"), tol, budget, check, options, progress)
    return run_refinement_stages(solution, stages, structure)


def run_refinement_stages(
    solution: Solution, stages: StagedRefinement, structure: StructureChoice
) -> Solution:
    """Return the solution that the stages find from a solution on a first mesh; see `refine`."""
    if structure not in get_args(StructureChoice):
        raise ProblemError(
            f"refine() has no structure {structure!r}: "
            f"{suggest_similar_name(str(structure), get_args(StructureChoice))}"
        )
    try:
        solution = _remove_arc_constraints(solution, stages)
    except KeyboardInterrupt:
        return stages.build_interrupted_result(solution)
    stages.problem = solution.need_problem("refine")
    if structure == "auto":
        return stages.refine_in_stages(solution)
    return stages.refine_mesh(solution) if structure == "none" else stages.refine_with_fixed_arcs(solution)


def _remove_arc_constraints(solution: Solution, stages: StagedRefinement) -> Solution:
    """Return the solution, on the same mesh, of the problem without fixed arcs, which belong to one mesh."""
    problem = solution.need_problem("refine")
    held = [name for name, phase in problem.phases.items() if phase.numbers.arcs is not None]
    if not held:
        return solution
    for name in held:
        problem = problem.with_fixed_arcs(name, arcs=None)
    given = replace(solution, problem=problem.frozen())
    found = solve_problem_on_mesh(
        given.need_problem("refine"),
        {name: fix_mesh_breaks(phase) for name, phase in solution.phases.items()},
        scheme=next(iter(solution.phases.values())).scheme,
        guess=given,
        options=stages.options,
        budget=stages.budget,
    )
    if found.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return found if found.status.solved else given
