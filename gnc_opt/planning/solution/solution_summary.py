"""Summary of a solution, the output of `print(solution)`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeAlias

from gnc_opt.planning.problem.problem_check import describe_missing_bounds
from gnc_opt.planning.problem.symbolic_expressions import OutsideTable
from gnc_opt.planning.solution.optimality_verdict import REMEDIES, ConditionResult
from gnc_opt.planning.solution.refinement_history import RefinementStatus
from gnc_opt.planning.solution.solution_accuracy import Accuracy
from gnc_opt.text_html_and_json_formatting import pluralise_noun

LABEL_WIDTH = 13
SUMMARY_MAX_NAMES = 3
"""Largest number of violated constraints that are named."""

BETTER_COARSE_SOLVE = "also seen"
"""Key of the provenance: a better solution on a coarse mesh during the refinement, possibly another minimum."""

MOVED_START = "start"
"""Key of the provenance: initial states that were moved to a bound."""

_LOADED_CHECK: dict[RefinementStatus | None, str] = {
    RefinementStatus.CONVERGED: "passed at the end of the refinement",
    RefinementStatus.CONDITIONS_FAIL: "FAILED at the end of the refinement",
}
"""Result of the optimality check of a loaded solution, from the status of its refinement."""

_RESULT_LABELS = {ConditionResult.FAIL: "fails", ConditionResult.INCONCLUSIVE: "inconclusive"}

_FAMILY_NAMES = {"LG": "Legendre-Gauss", "LGR": "Legendre-Gauss-Radau", "LGL": "Legendre-Gauss-Lobatto"}


SolutionLike: TypeAlias = Any
"""A `gnc_opt.Solution`; its module imports this one."""


def summary(solution: SolutionLike) -> str:
    """Return a summary: seven lines for a converged solution that passes the optimality check, more for others.

    The lines are: objective with unit and estimated error; optimality check; accuracy of final states and limits;
    times; refinement; mesh; time spent. Further lines name open or failed conditions, with remedies.

    Parameters
    ----------
    solution : Solution

    Returns
    -------
    str
        Text without a trailing newline.

    Examples
    --------
    >>> from gnc_opt.report import summary
    >>> print(summary(solution).splitlines()[0].partition(",")[0])
    rest to rest in minimum time: refined (converged)
    """
    unit, statistics, history = time_unit(solution), solution.statistics, solution.history
    times = [f"{n} {x.initial_time:.10g} to {x.final_time:.10g} {unit}" for n, x in solution.phases.items()]
    seconds = statistics.build_s + statistics.solve_s if history is None else history.seconds
    rows = [
        *_summarise_failure(solution),
        *_summarise_optimality(solution),
        *_summarise_accuracy(solution),
        ("time", "; ".join(times)),
        *_summarise_refinement(solution),
        *_summarise_lower_bound_and_norms(solution),
        ("mesh", format_mesh(solution)),
        ("time spent", f"{seconds:.2f} s; last solve: {statistics.summary_text}"),
        *(("table", str(point)) for point in list_points_outside_tables(solution)),
    ]
    lines = [f"  {label:<{LABEL_WIDTH}}{text}" for label, text in rows]
    return "\n".join([_format_summary_headline(solution), *lines])


def get_available_solution_accuracy(solution: SolutionLike) -> Accuracy | None:
    """Return the accuracy, computed or stored in the file; None if neither is possible."""
    accuracy: Accuracy | None = vars(solution).get("accuracy")
    return accuracy if solution.problem is None else solution.accuracy


def format_mesh(solution: SolutionLike) -> str:
    """Return ``"20 segments, degree 3, Legendre-Gauss"``, with the phase name for several phases."""
    texts = []
    for name, mesh in ((name, phase.mesh) for name, phase in solution.phases.items()):
        low, high = min(mesh.degrees), max(mesh.degrees)
        text = f"{name} " * (len(solution.phases) > 1) + pluralise_noun(mesh.segments, "segment")
        text += f", degree {low}" + f" to {high}" * (high > low)
        breakpoints = f", {pluralise_noun(len(mesh.movable), 'free breakpoint')}" * bool(mesh.movable)
        texts.append(text + breakpoints)
    return f"{'; '.join(texts)}, {_FAMILY_NAMES[solution.scheme]}"


def format_objective(solution: SolutionLike) -> str:
    """Return ``"2.5 s ± 3e-09"``: objective, unit and, if solved, estimated error."""
    unit = "" if solution.problem is None else solution.problem.cost_unit
    value = f"{solution.objective:.10g} {unit}".rstrip()
    accuracy = get_available_solution_accuracy(solution) if solution.status.solved else None
    return value if accuracy is None else f"{value} ± {accuracy.objective_error:.1g}"


def _format_summary_headline(solution: SolutionLike) -> str:
    sense = "maximised" if solution.maximised else "minimised"
    history = solution.history
    if not solution.status.solved:
        status = f"NOT SOLVED ({_format_status(solution.status.value)})"
    elif history is None:
        status = f"solved ({_format_status(solution.status.value)})"
    else:
        is_final = history.converged or history.status is RefinementStatus.UNCHECKED
        status = f"{'refined' if is_final else 'NOT CONVERGED'} ({_format_status(history.status.value)})"
    return f"{solution.problem_name}: {status}, objective {format_objective(solution)} ({sense})"


def _summarise_failure(solution: SolutionLike) -> Iterator[tuple[str, str]]:
    if solution.status.solved:
        return
    yield "what to do", solution.status.remedy
    for violation in solution.violations[:SUMMARY_MAX_NAMES]:
        yield "violated", f"{violation.name}, by {violation.amount:.2g} of its scale"


def _summarise_optimality(solution: SolutionLike) -> Iterator[tuple[str, str]]:
    """Yield the result of the optimality check, the first condition that does not pass, and missing bounds."""
    if not solution.status.solved:
        return
    if solution.verdict is None:
        unknown = "not checked: call verify()"
        status = None if solution.history is None else solution.history.status
        yield "optimality", _LOADED_CHECK.get(status, unknown)
        return
    yield "optimality", solution.verdict.headline
    for c in solution.verdict.open_conditions[:1]:
        size = f"{c.name} {c.value:.1e} (tolerance {c.tolerance:.0e})"
        yield _RESULT_LABELS[c.result], f"{size} at {c.location_text}"
        yield "what to do", REMEDIES.get(c.name, c.meaning)
    if solution.problem is not None and (missing := describe_missing_bounds(solution.problem)):
        yield "what to do", missing


def _summarise_accuracy(solution: SolutionLike) -> Iterator[tuple[str, str]]:
    """Yield the accuracy, without the problem the stored one; the defect too if no check shows it."""
    accuracy = get_available_solution_accuracy(solution)
    if accuracy is None:
        yield "accuracy", "unknown: load the solution with its problem"
        return
    saved = " (when it was saved)" if solution.problem is None else ""
    yield "accuracy", accuracy.summary_text + saved
    if not solution.converged and solution.verdict is None:
        yield "defect", f"{accuracy.defect:.2g} (relative), largest at {accuracy.defect_where}"


def _summarise_refinement(solution: SolutionLike) -> Iterator[tuple[str, str]]:
    """Yield requested and reached error of a refinement, and notes of its provenance."""
    notes, history = solution.provenance, solution.history
    if MOVED_START in notes:
        yield MOVED_START, notes[MOVED_START]
    if history is None:
        return
    if BETTER_COARSE_SOLVE in notes:
        yield BETTER_COARSE_SOLVE, notes[BETTER_COARSE_SOLVE]
    final, count = history.final_iteration, pluralise_noun(len(history.passes), "iteration")
    text = f"error between nodes {final.error:.1e}, tolerance {history.tolerance:.0e}, {count}"
    yield "refinement", text + ("" if history.converged else f"; {final.where}")


def _summarise_lower_bound_and_norms(solution: SolutionLike) -> Iterator[tuple[str, str]]:
    """Yield the lower bound of the cost, and the reformulated norms."""
    if solution.bound is not None:
        side = "at most" if solution.maximised else "at least"
        yield "bound", f"{side} {solution.bound}; gap {solution.gap:.1e}"
    for phase in solution.problem.phases.values() if solution.problem is not None else ():
        for text in phase.control_map.texts if phase.control_map is not None else ():
            yield "reformulated", f"{text}{f', phase {phase.name}' * (len(solution.phases) > 1)}"


def time_unit(solution: SolutionLike) -> str:
    """Return the unit of time; s for a solution without its problem."""
    return "s" if solution.problem is None else solution.problem.time_unit


def list_points_outside_tables(solution: SolutionLike) -> list[OutsideTable]:
    """Return where the trajectory is outside tables; empty without the problem."""
    return [] if solution.problem is None else solution.outside_tables()


def _format_status(value: str) -> str:
    return value.replace("_", " ")
