"""Switch-time optimisation: the structure loop.

Controls are held on their bounds piece by piece, the times of the switches are variables, and each piece is
collocated with a high degree; controls between bounds (interior and singular arcs) stay free inside their pieces. The
costates of the optimum then judge the structure: a piece whose length goes to zero is dropped (or the two switches
at its ends change places), a switching function of the wrong sign asks for an arc that is missing. The loop ends
when signs and structure agree everywhere and the error between the nodes is small.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from gnc_opt.nlp import SolverOptions
from gnc_opt.problem.arc import Arc
from gnc_opt.problem.problem import Problem
from gnc_opt.refine.error import estimate_errors
from gnc_opt.refine.passes import pass_meter, pass_record
from gnc_opt.refine.structure.detect import structures_of
from gnc_opt.refine.structure.mending import KINKS_MOVED, RAISED, SMOOTHED, improve, smoother
from gnc_opt.refine.structure.newton import settle
from gnc_opt.refine.structure.phase_structure import PhaseStructure
from gnc_opt.refine.structure.plan import Plan, points_of
from gnc_opt.refine.structure.simultaneous import settle_costates
from gnc_opt.solution.history import History, Pass, RefinementStatus
from gnc_opt.solution.solution import Solution
from gnc_opt.solution.solve_mesh import solve_mesh

PATIENCE = 4
"""Passes that only move kinks or raise the resolution without halving the error, after which the loop gives up."""

FINEST = 1e-9
"""Switch times are asked for at least this accurately: that costs a solve of a few iterations, if any."""

TIGHT, MOST_ITERATIONS = 1e-11, 200
"""Of each solve: switch times are as good as the solver's optimality, and a warm start needs few iterations."""


def optimise_switches(
    solution: Solution,
    *,
    tol: float = FINEST,
    max_passes: int = 40,
    max_points: int = 1000,
    max_work: float = math.inf,
    structures: Mapping[str, PhaseStructure] | None = None,
    options: SolverOptions | None = None,
    deadline: float = math.inf,
    progress: bool = False,
) -> tuple[Solution, History]:
    """Return the solution with exact switch times and its `structure`, and the history of the loop.

    Parameters
    ----------
    solution : Solution
        A solved collocation solution, with its problem.
    tol : float
        On the error between the nodes; see `gnc_opt.refine.error`.
    max_passes : int
        At most so many solves.
    max_points : int
        At most so many collocation points in any phase.
    max_work : float
        No pass begins after this much work, in iterations at one collocation point; see `Pass.work`.
    structures : mapping of PhaseStructure, optional
        What to start from, by phase, if it has been detected already.
    options : SolverOptions, optional
    deadline : float
        When to stop, as `time.perf_counter` counts. Ctrl-C stops it, too.
    progress : bool
        Show one line per pass.

    Returns
    -------
    Solution
        Where the loop comes to rest; else that of the pass with the least error, or the given one if no pass had a
        solution.
    History
    """
    begin = time.perf_counter()
    problem = solution.need_problem("refine")
    chosen = options or SolverOptions(tolerance=TIGHT, max_iterations=MOST_ITERATIONS)
    found = structures or structures_of(solution)
    plans = {name: Plan.of(s, points_of(solution.phases[name].mesh)) for name, s in found.items()}
    tries: list[_Try] = []
    with pass_meter(solution.problem_name, tol, progress) as show:
        try:
            limits = _Limits(tol, max_passes, max_points, max_work, deadline)
            guess, settled = _settled(solution, plans)
            status = _loop(problem, guess, settled, min(tol, FINEST), limits, chosen, show, tries)
            if status is RefinementStatus.FAILED and guess is not solution:
                status = _loop(problem, solution, plans, min(tol, FINEST), limits, chosen, show, tries)
        except KeyboardInterrupt:
            status = RefinementStatus.INTERRUPTED
    best = _best(tries, status)
    records = [t.record for t in tries] or [_record(solution, begin, "not begun")]
    message, seconds = f"{status.value}: {records[-1].actions}", time.perf_counter() - begin
    history = History(status, tol, tuple(records), best or 0, message, seconds)
    if best is None:
        return solution, history
    solution, plans = tries[best].solution, tries[best].plans
    if status is RefinementStatus.CONVERGED:
        solution = settle_costates(solution)
    return replace(solution, structure=_arcs(solution, plans)), history


@dataclass(frozen=True)
class _Limits:
    """Where the loop gives up, and what error was asked for."""

    tol: float
    passes: int
    points: int
    work: float
    deadline: float


@dataclass(frozen=True, eq=False)
class _Try:
    """One pass: what was found for which structure."""

    solution: Solution
    plans: dict[str, Plan]
    record: Pass


def _best(tries: list[_Try], status: RefinementStatus) -> int | None:
    """Return the pass to keep: where the loop came to rest, or the one with the least error; None without any."""
    solved = [k for k, t in enumerate(tries) if t.record.solved]
    if status is RefinementStatus.CONVERGED:
        return solved[-1]
    return min(solved, key=lambda k: tries[k].record.error, default=None)


def _settled(solution: Solution, plans: dict[str, Plan]) -> tuple[Solution, dict[str, Plan]]:
    """Go near the optimum, where Newton's method on switch times finds it."""
    if len(plans) > 1:
        return solution, plans  # The flow of one phase says nothing about the others.
    ((name, plan),) = plans.items()
    found = settle(solution, plan.structure)
    if found is None:
        return solution, plans
    structure, guess = found
    return guess, {name: Plan.settled(structure, plan.points)}


def _loop(
    problem: Problem,
    solution: Solution,
    plans: dict[str, Plan],
    tol: float,
    limits: _Limits,
    options: SolverOptions,
    show: Callable[[Pass], None],
    tries: list[_Try],
) -> RefinementStatus:
    """Solve and mend until nothing is left to mend; add every pass to ``tries``."""
    swapped: set[tuple[str, PhaseStructure]] = set()
    for _ in range(limits.passes):
        begin = time.perf_counter()
        if begin > limits.deadline:
            return RefinementStatus.INTERRUPTED
        records = [t.record for t in tries]
        if any(plan.mesh().size > limits.points for plan in plans.values()):
            return _limited(records, limits, RefinementStatus.POINT_LIMIT)
        if sum(record.work for record in records) > limits.work:
            return _limited(records, limits, RefinementStatus.WORK_LIMIT)
        found = _solve(problem, plans, solution, options, limits.deadline)
        if not found.status.solved:
            tries.append(_Try(found, plans, _record(found, begin, f"not solved ({found.status.value})")))
            show(tries[-1].record)
            interrupted = found.status.value == "interrupted"
            return RefinementStatus.INTERRUPTED if interrupted else RefinementStatus.FAILED
        solution = found
        current = {name: _at_solution(plan, solution, name) for name, plan in plans.items()}
        plans, action = improve(solution, current, swapped, tol)
        record = _record(solution, begin, action or "structure stands")
        resolved = _resolved([*(t.record for t in tries), record], tol)
        if resolved and (finer := smoother(solution, current)) != current:
            plans, resolved, record = finer, False, replace(record, actions=SMOOTHED)
        tries.append(_Try(solution, current, record))
        show(record)
        if not action or resolved:
            return RefinementStatus.CONVERGED
        if _restless([t.record for t in tries]):
            return RefinementStatus.STALLED
    return _limited([t.record for t in tries], limits, RefinementStatus.PASS_LIMIT)


def _limited(records: list[Pass], limits: _Limits, status: RefinementStatus) -> RefinementStatus:
    """How the loop ends at a limit: at rest if its last structure stands with the accuracy that was asked for."""
    rests = bool(records) and records[-1].solved and records[-1].actions == RAISED
    return RefinementStatus.CONVERGED if rests and records[-1].error <= limits.tol else status


def _resolved(records: list[Pass], tol: float) -> bool:
    """Whether a finer mesh was asked for twice where the error is small: for costates that are nothing but rounding."""
    return len(records) > 1 and all(r.actions == RAISED and r.error <= tol for r in records[-2:])


def _restless(records: list[Pass]) -> bool:
    """Whether the structure stays, but neither moving kinks nor finer meshes reduce the error."""
    last = records[-PATIENCE:]
    adjusting = all(set(str(r.actions).split(", ")) <= {KINKS_MOVED, RAISED, SMOOTHED} for r in last)
    if not adjusting or len(records) <= PATIENCE:
        return False
    return min(r.error for r in last) > 0.5 * min(r.error for r in records[:-PATIENCE])


def _solve(
    problem: Problem, plans: Mapping[str, Plan], guess: Solution, options: SolverOptions, deadline: float
) -> Solution:
    held = problem
    for name, plan in plans.items():
        held = plan.hold(held, name)
    meshes = {name: plan.mesh() for name, plan in plans.items()}
    found = solve_mesh(held, meshes, guess=guess, options=options, deadline=deadline)
    return replace(found, problem=problem)


def _at_solution(plan: Plan, solution: Solution, name: str) -> Plan:
    """Return the plan with the switch times of the solution."""
    leg = solution.phases[name]
    times = tuple(float(t) for t in leg.breaks[list(plan.piece_ends)])
    return replace(plan, structure=plan.structure.at(times))


def _record(solution: Solution, begin: float, action: str) -> Pass:
    return pass_record(solution, estimate_errors(solution), begin, action)


def _arcs(solution: Solution, plans: Mapping[str, Plan]) -> tuple[Arc, ...]:
    arcs: list[Arc] = []
    for name, s in solution.samples().items():
        labels = (*s.leg.controls.labels, *s.leg.path_labels, *s.leg.states.labels)
        arcs += plans[name].structure.arcs(name, labels)
    return tuple(arcs)
