"""JSON summaries of solutions and searches: the page "The JSON summary" of the documentation describes the fields."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gnc_opt.model.model_variables import Layout
from gnc_opt.planning.solution.optimality_verdict import Verdict
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.refinement_history import History
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_summary import (
    get_available_solution_accuracy,
    list_points_outside_tables,
)
from gnc_opt.planning.study.multistart_search import Multistart
from gnc_opt.text_html_and_json_formatting import build_attribute_dict, convert_to_json_values, format_json


def search_dict(found: Multistart) -> dict[str, Any]:
    """Return the result of a search as JSON values; each minimum has the summary of its solution.

    Parameters
    ----------
    found : Multistart

    Examples
    --------
    >>> from gnc_opt.report import search_dict
    >>> found = search_dict(go.multistart(problem, n=2, seed=1, executor="serial", refine=False))
    >>> print(found["finished"], len(found["minima"]))
    2 1
    """
    return {
        "problem": found.problem_name,
        **build_attribute_dict(found, "starts", "finished", "seed", "interrupted"),
        "failures": dict(found.failures),
        "minima": [
            {
                **build_attribute_dict(minimum, "objective", "hits", "trajectories", "refined", "verdict_ok"),
                "standing": minimum.check_result,
                "starts": list(minimum.starts),
                "coarse_objectives": list(minimum.coarse_objectives),
                "solution": summary_dict(minimum.solution),
            }
            for minimum in found.minima
        ],
    }


SCHEMA = 3
"""Version, raised when a key is removed or changes its meaning; new keys do not raise it."""


def summary_dict(solution: Solution, verdict: Verdict | None = None) -> dict[str, Any]:
    """Return the summary as JSON values; values that are not finite or not available are None.

    Parameters
    ----------
    solution : Solution
    verdict : Verdict, optional
        None: ``verdict`` is null.

    Examples
    --------
    >>> from gnc_opt.report import summary_dict
    >>> print(summary_dict(solution)["status"])
    optimal
    """
    accuracy = get_available_solution_accuracy(solution)
    spent = solution.statistics
    return dict(
        convert_to_json_values(
            {
                "schema": SCHEMA,
                "problem": solution.problem_name,
                "status": solution.status.value,
                "solved": solution.status.solved,
                "objective": solution.objective,
                "objective_unit": "" if solution.problem is None else solution.problem.cost_unit,
                "maximised": solution.maximised,
                "iterations": spent.iterations,
                "build_s": spent.build_s,
                "solve_s": spent.solve_s,
                "scheme": next(iter(solution.phases.values())).scheme,
                "mesh": _format_mesh_sizes(solution),
                "objective_error": accuracy and accuracy.objective_error,
                "max_defect": accuracy and accuracy.defect,
                "max_defect_where": accuracy and accuracy.defect_where,
                "max_bound_violation": accuracy and accuracy.violation,
                "max_bound_violation_where": accuracy and accuracy.violation_where,
                "propagation_error": accuracy and accuracy.miss,
                "terminal_error_where": accuracy and accuracy.miss_where,
                "bound": _build_lower_bound_dict(solution),
                "outside_tables": [str(found) for found in list_points_outside_tables(solution)],
                "verdict": None if verdict is None else _build_verdict_dict(verdict),
                "violations": [{"name": v.name, "amount": v.amount} for v in solution.violations],
                "structure": [
                    {**build_attribute_dict(arc, "phase", "channel", "start", "end"), "kind": arc.kind.value}
                    for arc in solution.structure
                ],
                "refinement": None
                if solution.history is None
                else _build_mesh_refinement_dict(solution.history),
                "parameters": {name: solution.parameter(name) for name in solution.free_parameters.names},
                "phases": [_build_phase_summary_dict(phase) for phase in solution.phases.values()],
                "provenance": dict(solution.provenance),
            }
        )
    )


def write_json(path: str | Path, found: Solution | Multistart, verdict: Verdict | None = None) -> Path:
    """Return the path of a UTF-8 JSON file with the summary of a solution or search.

    Parameters
    ----------
    path : str or Path
    found : Solution or Multistart
        Written by `summary_dict` or `search_dict`.
    verdict : Verdict, optional
        Verdict of a solution; None: ``verdict`` is null.

    Examples
    --------
    >>> from gnc_opt.report import write_json
    >>> path = write_json("cart.json", solution)
    """
    content = summary_dict(found, verdict) if isinstance(found, Solution) else search_dict(found)
    target = Path(path)
    target.write_text(format_json(content), encoding="utf-8")
    return target


def _format_mesh_sizes(solution: Solution) -> str:
    """Return ``"20x3"``, or ``"ascent 20x3, coast 5x2"`` for several phases."""
    if len(solution.phases) == 1:
        return str(solution.phase().mesh)
    return ", ".join(f"{name} {phase.mesh}" for name, phase in solution.phases.items())


def _build_lower_bound_dict(solution: Solution) -> dict[str, Any] | None:
    bound = solution.bound
    if bound is None:
        return None
    return {
        **build_attribute_dict(bound, "value", "certified", "theorem"),
        "gap": solution.gap,
        "states": list(bound.states),
    }


def _build_verdict_dict(verdict: Verdict) -> dict[str, Any]:
    members = ("name", "value", "tolerance", "where", "meaning", "sufficient", "loss", "unit")
    conditions = [{**build_attribute_dict(c, *members), "result": c.result.value} for c in verdict.conditions]
    return {**build_attribute_dict(verdict, "ok", "minimum", "estimated"), "conditions": conditions}


def _build_mesh_refinement_dict(history: History) -> dict[str, Any]:
    return {
        "status": history.status.value,
        "passes": len(history.passes),
        "error": history.final_iteration.error,
        **build_attribute_dict(history, "tolerance", "seconds"),
    }


def _build_phase_summary_dict(phase: PhaseSolution) -> dict[str, Any]:
    return {
        **build_attribute_dict(phase, "name", "initial_time", "final_time"),
        "segments": phase.mesh.segments,
        "points": phase.mesh.size,
        "states": _list_variable_sizes_and_units(phase.states),
        "controls": _list_variable_sizes_and_units(phase.controls),
    }


def _list_variable_sizes_and_units(layout: Layout) -> list[dict[str, Any]]:
    return [{"name": v.name, "size": v.size, "unit": v.unit} for v in layout.variables]
