"""HTML page on one solution, for a design review."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path

from gnc_opt.planning.problem.arcs import Arc
from gnc_opt.planning.solution.history import History
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.summary import exited_tables, mesh_text, objective_text, time_unit
from gnc_opt.planning.solution.verdict import (
    REMEDIES,
    ConditionResult,
    Verdict,
    violation_text,
    worst_condition,
)
from gnc_opt.report.html_document import command_html, figure_html, html_document, status_label_html
from gnc_opt.report.problem_statement import linkage_rows, problem_statement_html
from gnc_opt.text_formatting import derivative_unit, html_table

CAPTIONS = {
    "trajectory": "Trajectory: circle at the start, square at the end; vehicle at equal intervals of time.",
    "states": "States over time; dashed: limits.",
    "controls": (
        "Controls, each with ∂H/∂u on its right. A control that enters H linearly is at its lower limit where this "
        "switching function is positive, at its upper limit where it is negative; dotted: changes of sign."
    ),
    "costates": "Costates over time: derivatives of the optimal cost with respect to the states.",
    "hamiltonian": (
        "Hamiltonian over time. It is constant if time does not occur in the problem, and -1 in minimum time."
    ),
    "refinement": "Mesh and estimated error of each refinement iteration.",
}
"""Captions of the figures, by file stem."""


def solution_page_html(
    solution: Solution,
    verdict: Verdict | None,
    files: Mapping[str, Path],
    *,
    motion: str = "",
    command: str | None = None,
) -> str:

    def join_figures(*stems: str) -> str:
        return "".join(figure_html(files, stem, CAPTIONS[stem]) for stem in stems)

    sections = {
        "Overview": _overview_section(solution, verdict, files),
        "Motion": motion,
        "Problem": "" if solution.problem is None else problem_statement_html(solution.problem),
        "States": join_figures("states") if "trajectory" in files else "",
        "Costates and Hamiltonian": join_figures("costates", "hamiltonian"),
        "Arcs": _arcs_table(solution),
        "Refinement": _refinement_table(solution.history) + join_figures("refinement"),
        "Conditions": _conditions_table(verdict),
        "Multipliers": _multipliers_table(solution),
        "Software": _software_versions_table(solution, command),
    }
    return html_document(solution.problem_name, _format_headline(solution, verdict), sections)


# --- first section ----------------------------------------------------------------------------------------


def _format_headline(solution: Solution, verdict: Verdict | None) -> str:
    """Return a line with solver status, result of the optimality check and objective."""
    solved = solution.status.solved
    chips = status_label_html(f"solver: {solution.status.value.replace('_', ' ')}", "" if solved else "bad")
    if verdict is not None:
        tone = "good" if verdict.ok else "bad" if verdict.failed else "open"
        chips += status_label_html("strict local minimum" if verdict.minimum else verdict.word, tone)
    sense = "maximised" if solution.maximised else "minimised"
    return f"{chips} objective <strong>{escape(objective_text(solution))}</strong> ({sense})"


def _overview_section(solution: Solution, verdict: Verdict | None, files: Mapping[str, Path]) -> str:
    stems = "trajectory" if "trajectory" in files else "states", "controls"
    figures = "".join(figure_html(files, stem, CAPTIONS[stem]) for stem in stems)
    return _verdict_section(solution, verdict) + _solve_facts_table(solution) + figures


def _verdict_section(solution: Solution, verdict: Verdict | None) -> str:
    if not solution.status.solved:
        rows = [("what to do", solution.status.remedy)]
        rows += [(f"violated: {v.name}", f"by {v.amount:.2g} of its scale") for v in solution.violations]
        return html_table(("", ""), rows)
    if verdict is None:
        return "<p>Optimality was not checked.</p>"
    failing = "".join(f"<p>{escape(text)}</p>" for text in open_conditions_html(verdict))
    return failing + html_table(
        ("check", "result", "violation or margin", "largest at"), verdict_table_rows(verdict)
    )


def verdict_table_rows(verdict: Verdict) -> list[tuple[str, str, str, str]]:
    """Return group, result, largest violation and its location for three groups of conditions."""
    lines = []
    for group, found in verdict.groups.items():
        worst = worst_condition(found)
        place = f"{worst.name}: {worst.location_text}"
        lines.append((group, worst.result.value.lower(), violation_text(worst.value), place))
    return lines


def open_conditions_html(verdict: Verdict) -> list[str]:
    """Return location, size, meaning and remedy of each condition that fails, or is necessary and inconclusive."""
    return [
        f"{c.name} {c.result.value.lower()} at {c.location_text}. {c.meaning} {REMEDIES.get(c.name, '')}".rstrip()
        for c in verdict.open
    ]


def _solve_facts_table(solution: Solution) -> str:
    unit = time_unit(solution)
    rows = [
        (f"phase {name}", f"{leg.initial_time:.10g} to {leg.final_time:.10g} {unit}")
        for name, leg in solution.phases.items()
    ]
    rows += [(f"parameter {name}", f"{solution.parameter(name)}") for name in solution.free_parameters.names]
    if solution.problem is not None and solution.status.solved:
        rows.append(("accuracy", solution.accuracy.text))
    rows.append(("mesh", mesh_text(solution)))
    rows += [("table left", str(found)) for found in exited_tables(solution)]
    return html_table(("", ""), rows)


# --- further sections -------------------------------------------------------------------------------------


def _conditions_table(verdict: Verdict | None) -> str:
    if verdict is None:
        return ""
    rows = [
        (
            c.name,
            c.result.value.lower(),
            violation_text(c.value),
            violation_text(c.tolerance),
            c.location_text,
        )
        for c in verdict.conditions
    ]
    meanings = "".join(
        f"<p><strong>{escape(c.name)}</strong>: {escape(c.meaning)}</p>"
        for c in verdict.conditions
        if c.result is not ConditionResult.PASS
    )
    return (
        html_table(("condition", "result", "violation or margin", "tolerance", "largest at"), rows) + meanings
    )


def _arc_text(arc: Arc) -> str:
    touched = arc.start == arc.end
    return f"{arc.kind.value} {'at' if touched else f'{arc.start:.8g} to'} {arc.end:.8g}"


def _arcs_table(solution: Solution) -> str:
    channels: dict[tuple[str, str], list[str]] = {}
    for arc in solution.structure:
        channels.setdefault((arc.phase, arc.channel), []).append(_arc_text(arc))
    rows = [(phase, channel, ", ".join(arcs)) for (phase, channel), arcs in channels.items()]
    return html_table(("phase", "control or constraint", f"arcs ({time_unit(solution)})"), rows)


def _refinement_table(history: History | None) -> str:
    if history is None:
        return ""
    rows = [
        (
            i,
            p.segments,
            p.points,
            f"{p.error:.1e}",
            f"{p.objective:.12g}",
            p.iterations,
            f"{p.seconds:.2f}",
            p.actions,
        )
        for i, p in enumerate(history.passes)
    ]
    titles = ("iteration", "segments", "points", "error", "objective", "NLP steps", "time (s)", "changes")
    return f"<p>{escape(history.message)}</p>" + html_table(titles, rows)


def _multipliers_table(solution: Solution) -> str:
    cost_unit = "" if solution.problem is None else solution.problem.cost_unit
    links = (
        set() if solution.problem is None else linkage_rows(solution.problem)[1]
    )  # theirs are the costates
    rows = [
        (f"constraint {label}", f"{value:.6g}", "", "")
        for label, value in zip(solution.constraint_labels, solution.constraint_multipliers, strict=True)
        if label.partition("[")[0] not in links
    ]
    rows += [
        (f"limits of {label}", f"{value:.6g}", "", "")
        for label, value in zip(solution.free_parameters.labels, solution.parameter_multipliers, strict=True)
    ]
    for name, leg in solution.phases.items():
        ends = leg.lam(leg.initial_time), leg.lam(leg.final_time, "left")
        where = f", phase {name}" * (len(solution.phases) > 1)
        rows += [
            (f"costate of {label}{where}", f"{a:.6g}", f"{b:.6g}", derivative_unit(cost_unit, unit))
            for label, unit, a, b in zip(leg.states.labels, leg.states.units, *ends, strict=True)
        ]
    return html_table(("multiplier", "value, or at the start", "at the end", "unit"), rows)


def _software_versions_table(solution: Solution, command: str | None) -> str:
    rows = [
        (k.replace("_", " "), str(v)) for k, v in solution.provenance.items() if k not in ("scheme", "mesh")
    ]
    rows.append(("last solve", solution.statistics.text))
    return command_html(command) + html_table(("", ""), rows)
