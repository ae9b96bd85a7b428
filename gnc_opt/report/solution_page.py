"""HTML page on one solution, for a design review."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from gnc_opt.planning.problem.fixed_arcs import Arc, ArcKind
from gnc_opt.planning.solution.history import History
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.text_summary import (
    list_points_outside_tables,
    mesh_text,
    objective_text,
    time_unit,
)
from gnc_opt.planning.solution.verdict import REMEDIES, Condition, Verdict, format_violation, worst_condition
from gnc_opt.plot.axes import cost_unit
from gnc_opt.plot.controls import find_declared_controls, has_control
from gnc_opt.plot.trajectory import find_negligible_costates
from gnc_opt.report.html_document import command_html, figure_html, html_document, status_label_html
from gnc_opt.report.problem_statement import linkage_rows, problem_statement_html
from gnc_opt.text_formatting import derivative_unit, html_table
from gnc_opt.tolerances import EQUAL

CAPTIONS = {
    "trajectory": (
        "Trajectory from the start (circle) to the end (square), with the vehicle at equal intervals of time."
    ),
    "states": "States over time. Dashed: limits, if they are in view; dotted: ends of phases.",
    "controls": (
        "Controls, each bounded one with its switching function ∂H/∂u. A control that enters H linearly is optimal at "
        "its lower limit where this is positive and at its upper limit where it is negative. Dotted: the ends of "
        "its arcs, where it switches."
    ),
    "constraints": (
        "Path constraints over time with their limits (dashed). Shaded: the constraint is active. Where it is not, its "
        "distance from the limit is the margin."
    ),
    "costates": (
        "Costates: change of the minimised cost for a small change of each state at that time. At a "
        "limit of a state they may jump."
    ),
    "refinement": (
        "Segments of each refinement iteration over time, coloured by degree. They are short where the solution "
        "changes fast."
    ),
}
"""Captions of the figures, by file stem."""

CHECK_NOTE = (
    "Feasible: dynamics, limits, boundary conditions and cost, also between the nodes. First order: the minimum "
    "principle. Second order: neighbouring trajectories cost more. Violations are relative to the scale of each "
    "condition; a margin is the distance of a sufficient condition from its limit."
)

_IMPULSIVE = re.compile(r"N|/s\^2")
"""Units of forces, torques and accelerations, whose integral over time is an impulse or a change of velocity."""

EFFORT_MIDPOINTS = 20_000
"""Points of a phase at which a control is evaluated for its effort: five digits also where it changes sign."""

_UNSET_OPTION = re.compile(r", \w+=(None|False|\{\})")


def solution_page_html(
    solution: Solution,
    verdict: Verdict | None,
    files: Mapping[str, Path],
    *,
    motion: str = "",
    command: str | None = None,
) -> str:
    captions = dict(CAPTIONS)
    boxes = [leg.control_bounds for leg in solution.phases.values()]
    if not any(np.any(np.isfinite([box.lower, box.upper])) for box in boxes):
        captions["controls"] = "Controls over time, which have no limits of their own."
    if solution.problem is not None:
        captions["hamiltonian"] = _hamiltonian_caption(solution)

    def join_figures(*stems: str) -> str:
        return "".join(figure_html(files, stem, captions[stem]) for stem in stems if stem in files)

    first = "trajectory" if "trajectory" in files else "states"
    sections = {
        "Overview": _verdict_section(solution, verdict)
        + _solve_facts_table(solution)
        + join_figures(first, "controls"),
        "Motion": motion,
        "Problem": "" if solution.problem is None else problem_statement_html(solution.problem),
        "States": join_figures(*{"states"} - {first}) + _boundary_values_table(solution, "state"),
        "Path constraints": join_figures("constraints"),
        "Costates and Hamiltonian": join_figures("costates", "hamiltonian")
        + _boundary_values_table(solution, "costate"),
        "Arcs": _arcs_table(solution),
        "Refinement": f"<p>Mesh: {escape(mesh_text(solution))}.</p>"
        + _refinement_table(solution.history)
        + join_figures("refinement"),
        "Conditions": _conditions_table(verdict),
        "Multipliers": _multipliers_table(solution),
        "Software": _software_versions_table(solution, command),
    }
    return html_document(solution.problem_name, _format_headline(solution, verdict), sections)


def _hamiltonian_caption(solution: Solution) -> str:
    values = [solution.hamiltonian(leg.point_times, leg.name) for leg in solution.phases.values()]
    return (
        f"Hamiltonian. It varies by at most {max(float(np.ptp(h)) for h in values):.1g} within a phase. If time does "
        "not occur in the problem, it must be constant: -1 for the least time, 0 for a free final time without cost."
    )


# --- first section ----------------------------------------------------------------------------------------


def _format_headline(solution: Solution, verdict: Verdict | None) -> str:
    """Return a line with the result of the solve and of the optimality check, and the objective."""
    status = solution.status
    chips = "" if status.solved else status_label_html(f"not solved: {status.value.replace('_', ' ')}", "bad")
    if verdict is not None:
        tone = "good" if verdict.minimum else "bad" if verdict.failed else "open"
        proven = (
            "strict local minimum" if verdict.minimum else "necessary conditions hold, minimum not proven"
        )
        word = proven if verdict.ok else verdict.outcome
        chips += status_label_html(f"optimality check: {word}", tone)
    sense = "maximised" if solution.maximised else "minimised"
    return f"{chips} objective <strong>{escape(objective_text(solution))}</strong> ({sense})"


def _verdict_section(solution: Solution, verdict: Verdict | None) -> str:
    if not solution.status.solved:
        rows = [("what to do", solution.status.remedy)]
        rows += [(f"violated: {v.name}", f"by {v.amount:.2g} of its scale") for v in solution.violations]
        return html_table(("", ""), rows)
    if verdict is None:
        return "<p>Optimality was not checked.</p>"
    groups = [(group, worst_condition(found)) for group, found in verdict.condition_groups.items()]
    checks = [(group, *_format_condition_cells(c, f"{c.name}: ")) for group, c in groups]
    return (
        _open_conditions_table(solution, verdict)
        + html_table(("check", *_CONDITION_TITLES), checks)
        + f'<p class="quiet">{CHECK_NOTE}</p>'
    )


def _open_conditions_table(solution: Solution, verdict: Verdict) -> str:
    """Return the first open condition with place, size in the unit of the objective and remedy; others by name."""
    if not verdict.open_conditions:
        return ""
    first, *others = verdict.open_conditions
    rows = [
        (
            first.result.value,
            f"{first.name}: {format_violation(first.value)} (tolerance {first.tolerance:.0e})",
        ),
        ("where", first.location_text),
        ("objective", objective_text(solution)),
        ("what to do", REMEDIES.get(first.name, first.meaning)),
    ]
    rows += [("also", ", ".join(c.name for c in others))] if others else []
    return f'<div class="failure">{html_table(("", ""), rows)}</div>'


_CONDITION_TITLES = ("result", "violation", "tolerance", "largest at")


def _format_condition_cells(condition: Condition, prefix: str = "") -> tuple[str, ...]:
    numbers = (format_violation(value) for value in (condition.value, condition.tolerance))
    return condition.result.value.lower(), *numbers, prefix + condition.location_text


def _solve_facts_table(solution: Solution) -> str:
    rows = [
        (f"phase {name}", f"{leg.initial_time:.10g} to {leg.final_time:.10g} {time_unit(solution)}")
        for name, leg in solution.phases.items()
    ]
    free = solution.free_parameters
    rows += [
        (f"parameter {label}", f"{value:.10g} {unit}".rstrip())
        for label, value, unit in zip(free.labels, solution.parameter_values, free.units, strict=True)
    ]
    if solution.problem is not None and solution.status.solved:
        rows.append(("accuracy", solution.accuracy.summary_text))
    rows += _consumption_rows(solution)
    rows += [("table left", str(found)) for found in list_points_outside_tables(solution)]
    return html_table(("", ""), rows)


def _consumption_rows(solution: Solution) -> Iterator[tuple[str, str]]:
    """Yield the decrease of masses, the effort of forces, torques and accelerations, and named integrals."""
    legs = list(solution.phases.values())
    states = {v.name: v for leg in legs for v in leg.states.variables}
    for name in [v.name for v in states.values() if v.unit == "kg" and v.size == 1]:
        signals = [leg.state(name)(leg.breaks[[0, -1]]) for leg in legs if name in leg.states]
        yield f"decrease of {name}", f"{-sum(float(np.diff(ends)[0]) for ends in signals):.6g} kg"
    for name in find_declared_controls(legs):
        owners = [leg for leg in legs if has_control(leg, name)]
        unit = owners[0].saturated_control(name).unit
        is_vector = any(c.name == name for leg in owners for c in leg.vector_controls)
        if _IMPULSIVE.search(unit) and not is_vector:
            effort = sum(control_effort(leg, name) for leg in owners)
            yield f"effort of {name}", f"{effort:.5g} {unit} s, the integral of the components' magnitudes"
    for leg in legs:
        where = f", phase {leg.name}" * (len(legs) > 1)
        named = (name for name in leg.integral_labels if not name.startswith("integral_"))
        yield from ((f"integral {name}{where}", f"{leg.integral(name):.8g}") for name in named)


def control_effort(leg: PhaseSolution, name: str) -> float:
    """Return the integral of the magnitudes of an applied control, summed over its components, by the midpoint rule."""
    edges = np.unique([*leg.breaks, *leg.applied.jump_times])
    n = -(-EFFORT_MIDPOINTS // edges.size)
    t = edges[:-1, None] + np.diff(edges)[:, None] * (np.arange(n) + 0.5) / n
    values = np.abs(np.atleast_2d(leg.saturated_control(name)(t.ravel())))
    return float(np.sum(values, axis=0) @ np.repeat(np.diff(edges) / n, n))


# --- further sections -------------------------------------------------------------------------------------


def _boundary_values_table(solution: Solution, kind: str) -> str:
    """Return start, end, smallest and largest value of each state or costate; rounding errors are 0."""
    legs = list(solution.phases.values())
    negligible = find_negligible_costates(legs)
    rows = []
    for leg in legs:
        values = (leg.x if kind == "state" else leg.lam)(leg.sample_times())
        for v in leg.states.variables:
            mine = values[leg.states.slice(v.name)]
            least = EQUAL * np.max(np.abs(mine)) if kind == "state" else negligible[v.name]
            unit = v.unit if kind == "state" else derivative_unit(cost_unit(solution), v.unit)
            for label, row in zip(v.labels, np.where(np.abs(mine) > least, mine, 0.0), strict=True):
                numbers = (f"{value:.6g}" for value in (row[0], row[-1], row.min(), row.max()))
                rows.append((leg.name, label, *numbers, unit))
    return _phase_table(solution, (kind, "at the start", "at the end", "smallest", "largest", "unit"), rows)


def _phase_table(solution: Solution, titles: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """Return a table of rows that begin with the phase, which is omitted if there is only one."""
    first = int(len(solution.phases) == 1)
    return html_table(("phase", *titles)[first:], [row[first:] for row in rows])


def _conditions_table(verdict: Verdict | None) -> str:
    if verdict is None:
        return ""
    rows = [(c.name, *_format_condition_cells(c)) for c in verdict.conditions]
    meanings = "".join(
        f"<p><strong>{escape(c.name)}</strong>: {escape(c.meaning)}</p>" for c in verdict.conditions
    )
    return html_table(("condition", *_CONDITION_TITLES), rows) + f'<div class="quiet">{meanings}</div>'


def _format_arc(arc: Arc) -> str:
    if arc.start == arc.end:
        return f"touches the {arc.kind.value} limit at {arc.end:.7g}"
    return f"{arc.kind.value} {arc.start:.7g} to {arc.end:.7g}"


def _arcs_table(solution: Solution) -> str:
    """Return the arcs of each control and constraint, unless it is never at a limit."""
    channels: dict[tuple[str, str], list[Arc]] = {}
    for arc in solution.structure:
        channels.setdefault((arc.phase, arc.channel), []).append(arc)
    rows = [
        (*place, "; ".join(map(_format_arc, arcs)))
        for place, arcs in channels.items()
        if any(arc.kind is not ArcKind.INTERIOR for arc in arcs)
    ]
    return _phase_table(solution, ("control or constraint", f"arcs ({time_unit(solution)})"), rows)


def _refinement_table(history: History | None) -> str:
    if history is None:
        return ""
    rows = [
        (i, p.n_segments, p.n_points, f"{p.error:.1e}", f"{p.objective:.12g}", p.iterations, p.actions)
        for i, p in enumerate(history.passes)
    ]
    titles = ("iteration", "segments", "points", "error", "objective", "NLP steps", "changes")
    return f"<p>{escape(history.message)}</p>" + html_table(titles, rows)


def _multipliers_table(solution: Solution) -> str:
    """Return the multipliers of boundary constraints and free parameters; those of linkages are costates."""
    links = set() if solution.problem is None else linkage_rows(solution.problem)[1]
    rows = [
        (f"constraint {label}", f"{value:.6g}")
        for label, value in zip(solution.constraint_labels, solution.constraint_multipliers, strict=True)
        if label.partition("[")[0] not in links
    ]
    rows += [
        (f"limits of {label}", f"{value:.6g}")
        for label, value in zip(solution.free_parameters.labels, solution.parameter_multipliers, strict=True)
    ]
    return html_table(("multiplier", "decrease of the minimised cost per unit of the limit"), rows)


def _software_versions_table(solution: Solution, command: str | None) -> str:
    rows = [
        (name, _UNSET_OPTION.sub("", str(value)))
        for name, value in solution.provenance.items()
        if name not in ("scheme", "mesh")
    ]
    rows.append(("last solve", solution.statistics.summary_text))
    return command_html(command) + html_table(("", ""), rows)
