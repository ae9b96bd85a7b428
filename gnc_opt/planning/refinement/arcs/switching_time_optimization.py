"""Switch-time optimisation: the structure loop.

Controls are held on their bounds piece by piece, the times of the switches are variables, and each piece is
collocated with a high degree; controls between bounds (interior and singular arcs) stay free inside their pieces. The
costates of the optimum then check the structure: a piece whose length goes to zero is dropped (or the two switches
at its ends change places), a switching function of the wrong sign asks for an arc that is missing. The loop ends
when signs and structure agree everywhere and the error between the nodes is small.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

from gnc_opt.planning.direct.solve_mesh import SolveLimits, solve_mesh
from gnc_opt.planning.nlp import SolverOptions
from gnc_opt.planning.problem.arcs import Arc
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.arcs.arc_mesh import Plan, count_uniform_points
from gnc_opt.planning.refinement.arcs.piece_resolution import set_resolutions
from gnc_opt.planning.refinement.arcs.split_switches import simultaneous_switches, solve_with_split_switches
from gnc_opt.planning.refinement.arcs.structure import PhaseStructure
from gnc_opt.planning.refinement.arcs.structure_detection import detect_structures
from gnc_opt.planning.refinement.arcs.structure_update import (
    KINKS_MOVED,
    RAISED,
    SMOOTHED,
    correct_plans,
    remove_vanished_piece,
)
from gnc_opt.planning.refinement.error_estimation import estimate_errors
from gnc_opt.planning.refinement.iterations import IterationLimits, record_iteration, show_progress
from gnc_opt.planning.refinement.switching.collocated_trajectory import collocate_trajectory
from gnc_opt.planning.refinement.switching.newton import optimise_times
from gnc_opt.planning.solution.history import History, RefinementIteration, RefinementStatus
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.verification.optimality_check import verify
from gnc_opt.tolerances import EQUAL

STALLED_MAX_ITERATIONS = 4
"""Passes that only move kinks or raise the resolution without halving the error, after which the loop gives up."""

UNSOLVED_MAX_ITERATIONS = 2
"""Structures without a solution, one made of the other, after which the loop gives up."""

ARC_SOLVE_TOLERANCE, ARC_SOLVE_MAX_ITERATIONS = 1e-11, 200
"""Of each solve: switch times are as good as the solver's optimality, and a warm start needs few iterations."""


Segments: TypeAlias = Literal["few", "kept"]


def optimise_switching_times(
    solution: Solution,
    *,
    tol: float = EQUAL,
    limits: IterationLimits | None = None,
    structures: Mapping[str, PhaseStructure] | None = None,
    options: SolverOptions | None = None,
    progress: bool = False,
    segments: Segments = "few",
) -> tuple[Solution, History]:
    """Return the solution with exact switch times and its `structure`, and the history of the loop.

    Parameters
    ----------
    solution : Solution
        A solved collocation solution, with its problem.
    tol : float
        On the error between the nodes; see `gnc_opt.planning.refinement.error_estimation`.
    limits : IterationLimits, optional
    structures : mapping of PhaseStructure, optional
        What to start from, by phase, if it has been detected already.
    options : SolverOptions, optional
    progress : bool
        Show one line per pass.
    segments : {"few", "kept"}
        Begin with few, or with those that these very structures were refined to.

    Returns
    -------
    Solution
        Where the loop comes to rest; else that of the pass with the least error, or the given one if no pass had a
        solution.
    History
    """
    begin = time.perf_counter()
    problem = solution.need_problem("refine")
    chosen = options or SolverOptions(tolerance=ARC_SOLVE_TOLERANCE, max_iterations=ARC_SOLVE_MAX_ITERATIONS)
    found = structures or detect_structures(solution)
    plans = {name: _build_initial_plan(s, solution.phases[name].mesh, segments) for name, s in found.items()}
    tries: list[_Try] = []
    with show_progress(solution.problem_name, tol, progress) as show:
        try:
            loop = _StructureLoop(problem, tol, limits or IterationLimits(), chosen, show, tries)
            guess, settled, flown = (
                _start_from_newton(solution, plans, loop.target_error)
                if segments == "few"
                else (solution, plans, None)
            )
            status = loop.iterate_structures(guess, settled, flown)
            if status is RefinementStatus.FAILED and guess is not solution:
                status = loop.iterate_structures(solution, plans)
        except KeyboardInterrupt:
            status = RefinementStatus.INTERRUPTED
    best = _select_best_iterate(tries, status, tol)
    records = [t.record for t in tries] or [_record_try(solution, begin, "not begun")]
    message, seconds = f"{status.value}: {records[-1].actions}", time.perf_counter() - begin
    history = History(status, tol, tuple(records), best or 0, message, seconds)
    if best is None:
        return solution, history
    solution, plans = tries[best].solution, tries[best].plans
    if status is RefinementStatus.CONVERGED:
        solution = _determine_unique_costates(solution, plans, chosen, loop.limits.deadline)
    return replace(solution, structure=_list_arcs(solution, plans)), history


def _build_initial_plan(structure: PhaseStructure, mesh: Mesh, segments: Segments) -> Plan:
    if segments == "few":
        return Plan.from_structure(structure, count_uniform_points(mesh))
    return Plan.from_refined_mesh(structure, mesh)


def _determine_unique_costates(
    solution: Solution, plans: Mapping[str, Plan], options: SolverOptions, deadline: float
) -> Solution:
    """Return the solution with costates that make every switching function vanish where switches share a time."""
    if not any(simultaneous_switches(plan.structure) for plan in plans.values()) or verify(solution).ok:
        return solution
    apart = solve_with_split_switches(solution, plans, options, deadline)
    if apart is None or verify(apart).ok:
        return apart or solution
    return min(solution, apart, key=lambda each: each.objective_error.value)


Change: TypeAlias = tuple[str, PhaseStructure, PhaseStructure]
"""Phase and its order of arcs, without times, before and after it is mended."""


@dataclass(frozen=True, eq=False)
class _Try:
    """One pass: what was found for which structure."""

    solution: Solution
    plans: dict[str, Plan]
    record: RefinementIteration


def _select_best_iterate(tries: list[_Try], status: RefinementStatus, tol: float) -> int | None:
    """Return the pass to keep: where the loop came to rest, or the one whose objective has the least estimated error.

    None without any; of passes within the tolerance the one with the least local error.
    """
    solved = {k: t for k, t in enumerate(tries) if t.record.solved}
    if not solved or status is RefinementStatus.CONVERGED:
        return max(solved, default=None)
    return min(
        solved, key=lambda k: (max(solved[k].solution.objective_error.relative, tol), solved[k].record.error)
    )


def _start_from_newton(
    solution: Solution, plans: dict[str, Plan], aim: float
) -> tuple[Solution, dict[str, Plan], Solution | None]:
    """Go to the optimum, where Newton's method on switch times finds it, with a mesh fine enough for that.

    Returned are a guess, the plans and, where no limit is in its way, the flight as their solution.
    """
    if len(plans) > 1:
        return solution, plans, None  # The flow of one phase says nothing about the others.
    ((name, plan),) = plans.items()
    found = optimise_times(solution, plan.structure)
    if found is None:
        return solution, plans, None
    structure, flight = found
    guess = flight.build_solution(solution)
    plan = set_resolutions(Plan.from_structure(structure, plan.points), solution.samples()[name], guess, aim)
    return guess, {name: plan}, collocate_trajectory(solution, flight, plan)


@dataclass(frozen=True, eq=False)
class _StructureLoop:
    """What it is asked for, and what it has tried."""

    problem: Problem
    tol: float
    limits: IterationLimits
    options: SolverOptions
    show: Callable[[RefinementIteration], None]
    tries: list[_Try]

    def iterate_structures(
        self, solution: Solution, plans: dict[str, Plan], flown: Solution | None = None
    ) -> RefinementStatus:
        """Solve, except in the first pass if its solution is integrated, and update until nothing changes.

        Every pass is added to ``tries``.
        """
        left: set[tuple[str, PhaseStructure]] = set()
        asked: set[Change] = set()
        vain = 0
        for _ in range(self.limits.passes):
            begin = time.perf_counter()
            if begin > self.limits.deadline:
                return RefinementStatus.INTERRUPTED
            if any(plan.mesh().size > self.limits.points for plan in plans.values()):
                return RefinementStatus.POINT_LIMIT
            spent = sum(record.work for record in self.iteration_records)
            if self.limits.are_exhausted(spent):
                return RefinementStatus.BUDGET_LIMIT
            within = self.limits.limit_solve((plan.mesh() for plan in plans.values()), spent)
            found = flown or _solve_program(self.problem, plans, solution, self.options, within)
            flown = None
            if not found.status.solved:
                self._append_try(
                    _Try(found, plans, _record_try(found, begin, f"not solved ({found.status.value})"))
                )
                if found.status.value == "interrupted":
                    return RefinementStatus.INTERRUPTED
                vain += 1
                others = _propose_alternative_plans(found, plans, left)
                if others is None or vain == UNSOLVED_MAX_ITERATIONS:
                    return RefinementStatus.FAILED
                plans = others
                continue
            solution, vain = found, 0
            current = {name: _update_plan_times(plan, solution, name) for name, plan in plans.items()}
            plans, action = correct_plans(solution, current, left, self.target_error)
            record = _record_try(solution, begin, action or "structure unchanged")
            self._append_try(_Try(solution, current, record))
            if len(self.iteration_records) == 1 and record.error > self.limits.worst:
                return RefinementStatus.FAILED
            if not action:
                return RefinementStatus.CONVERGED
            changes = set() if _keeps_arc_order(record) else _list_arc_orders(current, plans)
            again, asked = changes & asked, changes | asked
            if again or _is_stalled(self.iteration_records):
                return RefinementStatus.STALLED
        return RefinementStatus.ITERATION_LIMIT

    @property
    def target_error(self) -> float:
        """Error that meshes are refined to: it costs little more, where a structure is known."""
        return min(self.tol, EQUAL)  # that costs a solve of a few iterations, if any

    @property
    def iteration_records(self) -> list[RefinementIteration]:
        return [t.record for t in self.tries]

    def _append_try(self, tried: _Try) -> None:
        self.tries.append(tried)
        self.show(tried.record)


def _propose_alternative_plans(
    failed: Solution, plans: dict[str, Plan], left: set[tuple[str, PhaseStructure]]
) -> dict[str, Plan] | None:
    """Return what to try where a structure had no solution, or None.

    Without limits next to them arcs may have moved to where these have no value; else a piece that vanished on the
    way is in the way.
    """
    if any(plan.may_leave_constraints for plan in plans.values()):
        return {name: replace(plan, firm=True) for name, plan in plans.items()}
    for name, s in failed.samples().items():
        current = _update_plan_times(plans[name], failed, name)
        structure, _ = remove_vanished_piece(s, current, left)
        if structure is not None:
            return {**plans, name: current.replace_structure(structure)}
    return None


def _is_stalled(records: list[RefinementIteration]) -> bool:
    """Whether the structure stays, but neither moving kinks nor finer meshes reduce the error.

    Singular controls of a higher degree reduce what is left of dH/du, and are raised no further where they do not.
    """
    changes = [k for k, r in enumerate(records) if not _keeps_arc_order(r) or SMOOTHED in str(r.actions)]
    errors = [r.error for r in records[changes[-1] + 1 if changes else 0 :]]
    return len(errors) > STALLED_MAX_ITERATIONS and min(errors[-STALLED_MAX_ITERATIONS:]) > 0.5 * min(
        errors[:-STALLED_MAX_ITERATIONS]
    )


def _list_arc_orders(before: Mapping[str, Plan], after: Mapping[str, Plan]) -> set[Change]:
    """Return the orders of arcs, whatever their times, before and after a change of a structure."""
    return {
        (name, plan.structure.with_times(()), after[name].structure.with_times(()))
        for name, plan in before.items()
        if after[name].structure != plan.structure
    }


def _keeps_arc_order(record: RefinementIteration) -> bool:
    """Whether a solution asked for nothing but other kinks and resolutions."""
    return set(str(record.actions).split(", ")) <= {KINKS_MOVED, RAISED, SMOOTHED}


def _solve_program(
    problem: Problem, plans: Mapping[str, Plan], guess: Solution, options: SolverOptions, limits: SolveLimits
) -> Solution:
    held = problem
    for name, plan in plans.items():
        held = plan.hold_arcs(held, name)
    meshes = {name: plan.mesh() for name, plan in plans.items()}
    found = solve_mesh(held, meshes, guess=guess, options=options, limits=limits)
    return replace(found, problem=problem)


def _update_plan_times(plan: Plan, solution: Solution, name: str) -> Plan:
    leg = solution.phases[name]
    times = tuple(float(t) for t in leg.breaks[list(plan.piece_breaks)])
    return replace(plan, structure=plan.structure.with_times(times))


def _record_try(solution: Solution, begin: float, action: str) -> RefinementIteration:
    return record_iteration(solution, estimate_errors(solution), begin, action)


def _list_arcs(solution: Solution, plans: Mapping[str, Plan]) -> tuple[Arc, ...]:
    arcs: list[Arc] = []
    for name, s in solution.samples().items():
        labels = (*s.leg.controls.labels, *s.leg.path_labels, *s.leg.states.labels)
        arcs += plans[name].structure.list_arcs(name, labels)
    return tuple(arcs)
