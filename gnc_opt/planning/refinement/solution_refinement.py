"""refine: from a first solution to one that is right to many digits, and is known to be."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, TypeAlias, get_args

from gnc_opt.arguments import expect, read_positive, suggest_keywords
from gnc_opt.errors import GncOptError, ProblemError, did_you_mean
from gnc_opt.planning.direct.solve_mesh import SolveLimits, solve_mesh
from gnc_opt.planning.nlp import SolverOptions, Status
from gnc_opt.planning.refinement.staged_refinement import StagedRefinement
from gnc_opt.planning.refinement.work_budget import RefinementLimits, WorkBudget
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.warm_start import mesh_with_fixed_breaks
from gnc_opt.runtime_environment import one_thread

StructureChoice: TypeAlias = Literal["auto", "bang-bang", "none"]


@one_thread()
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
        A solved one, with its problem. Arcs that this holds explicitly (`Problem.with_fixed_arcs`) belong to its mesh:
        the refined solution is one of the problem without them.
    tol : float
        On the error between the nodes (`gnc_opt.planning.refinement.error_estimation`), and on the estimated error
        of the objective in shares of it (`gnc_opt.planning.solution.objective_error`).
    structure : {"auto", "bang-bang", "none"}
        ``"none"``: hp refinement of the mesh. ``"bang-bang"``: recognise which control is at which bound when,
        make the switch times variables, and mend the structure until the switching functions agree with it.
        The same for kinks, where controls enter and leave their bounds or mixed path constraints, and for singular
        arcs and arcs on state bounds.
        ``"auto"``: the sequence of meshes, see `gnc_opt.planning.refinement.staged_refinement`.
    check : bool
        Whether the answer has to pass the optimality check. Without it the first answer is returned whose estimated
        error of the objective is within the tolerance and whose history ends as UNCHECKED.
    limits : RefinementLimits, optional
        On passes, points, work and wall time. At a limit, and after Ctrl-C, the best solution so far is returned.
    options : SolverOptions, optional
        For the solves; a limit on wall time in it is that of one solve.
    progress : bool
        Show one line per pass.

    Returns
    -------
    Solution
        With ``history`` and, where switch times were optimised, ``structure``. The history ends as CONVERGED only
        if the tolerance was reached and no condition of the optimality check fails; otherwise its message
        names the open conditions.
        The solution keeps that verdict: ``verify(solution)`` returns it without another check.

    Raises
    ------
    GncOptError
        The solution has no problem or is not solved.
    ProblemError
        ``structure`` is none of the three, or it is ``"bang-bang"`` and no control can be.

    Examples
    --------
    >>> coarse = go.solve(problem, mesh="5x3", tol=None)
    >>> print(abs(coarse.objective - 2) < 1e-6, abs(go.refine(coarse).objective - 2) < 1e-8)
    False True
    """
    expect(solution, Solution, "what refine() got", "write refine(solve(problem))")
    read_positive(tol, "the tolerance of refine()")
    limits = limits or RefinementLimits()
    expect(limits, RefinementLimits, "the limits of refine()", "write RefinementLimits(max_points=500)")
    _check_solution(solution)
    budget = WorkBudget.from_limits(limits)
    stages = StagedRefinement(solution.need_problem("refine"), tol, limits, budget, check, options, progress)
    return refine_by_stages(solution, stages, structure)


def refine_by_stages(solution: Solution, stages: StagedRefinement, structure: StructureChoice) -> Solution:
    """Return the answer to which the stages lead from a solution on a first mesh; see `refine`."""
    if structure not in get_args(StructureChoice):
        raise ProblemError(
            f"refine() knows no structure {structure!r}: {did_you_mean(str(structure), get_args(StructureChoice))}"
        )
    try:
        solution = _release_fixed_arcs(solution, stages)
    except KeyboardInterrupt:
        return stages.answer_interruption(solution)
    stages.problem = solution.need_problem("refine")
    if structure == "auto":
        return stages.run_stages(solution)
    return stages.refine_mesh(solution) if structure == "none" else stages.refine_with_fixed_arcs(solution)


def _check_solution(solution: Solution) -> None:
    solution.need_problem("refine")
    if not solution.status.solved:
        raise GncOptError(
            f"the solution of '{solution.problem_name}' ended as {solution.status.value}: refine one that is solved."
        )


def _release_fixed_arcs(solution: Solution, stages: StagedRefinement) -> Solution:
    """Return the solution of the problem that holds no arcs: those are stated segment by segment of one mesh.

    What is best with them need not be without: it is solved anew, on the mesh as it was found.
    """
    problem = solution.need_problem("refine")
    held = [name for name, leg in problem.phases.items() if leg.numbers.arcs is not None]
    if not held:
        return solution
    for name in held:
        problem = problem.with_fixed_arcs(name, arcs=None)
    given = replace(solution, problem=problem.frozen())
    found = solve_mesh(
        given.need_problem("refine"),
        {name: mesh_with_fixed_breaks(leg) for name, leg in solution.phases.items()},
        scheme=next(iter(solution.phases.values())).scheme,
        guess=given,
        options=stages.options,
        limits=SolveLimits(deadline=stages.budget.deadline, cpu_deadline=stages.budget.cpu_deadline),
    )
    if found.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return found if found.status.solved else given
