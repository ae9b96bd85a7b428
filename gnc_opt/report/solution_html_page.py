"""HTML page on one solution, for a design review."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from html import escape
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np

from gnc_opt.numerical_tolerances import EQUAL, SMALL
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.optimality_verdict import (
    REMEDIES,
    Condition,
    ConditionResult,
    Verdict,
    find_worst_optimality_condition,
    format_violation,
)
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.refinement_history import History
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_summary import (
    format_mesh,
    format_objective,
    list_points_outside_tables,
    time_unit,
)
from gnc_opt.plot.control_figures import find_declared_controls, has_phase_control
from gnc_opt.plot.time_plot_axes import get_cost_unit, get_hamiltonian_unit
from gnc_opt.plot.trajectory_figures import find_negligible_costates
from gnc_opt.report.constraint_margins import LimitMargin, list_limit_margins, sample_phase_signal
from gnc_opt.report.html_report_document import (
    embed_svg_figure,
    format_shell_command_as_html,
    format_status_as_html,
    read_figure_captions,
)
from gnc_opt.report.mathml_formulas import typeset_names_in_html
from gnc_opt.report.problem_statement_html import (
    build_phase_linkage_rows,
    format_docstring_as_html,
    format_objective_section,
    format_problem_statement,
)
from gnc_opt.report.switching_structure_margins import (
    StructureMargin,
    iterate_control_structure_margins,
    select_largest_risks,
)
from gnc_opt.text_html_and_json_formatting import (
    Html,
    format_html_table,
    format_unit_quotient,
    simplify_time_integral_unit,
)

_IMPULSIVE = re.compile(r"N|/s\^2")
"""Units of forces, torques and accelerations, whose integral over time is an impulse or a change of velocity."""

SINGULAR_SHARE = 1e-3
"""Share of the largest |S| below which an extremum of a switching function S is in the headline."""

_MAX_SPACE = 3
"""Largest number of components of a vector whose length is shown."""

_UNSET_OPTION = re.compile(r", \w+=(None|False|\{\})")


def build_solution_page(
    solution: Solution,
    verdict: Verdict | None,
    files: Mapping[str, Path],
    motion: str,
    description: str,
    command: str | None,
) -> tuple[str, dict[str, str]]:
    """Return the headline and the sections of the page."""
    captions = read_figure_captions("solution")
    boxes = [phase.control_bounds for phase in solution.phases.values()]
    if not any(np.any(np.isfinite([box.lower, box.upper])) for box in boxes):
        captions["controls"] = captions["free controls"]
    if (problem := solution.problem) is not None:
        values = [solution.hamiltonian(phase.point_times, phase.name) for phase in solution.phases.values()]
        variation = max(float(np.ptp(along)) for along in values)
        value = _describe_hamiltonian_constancy(problem, solution)
        captions["hamiltonian"] = captions["hamiltonian"].format(f"{variation:.1g}") + value

    if "states" in files and 'id="limit"' in files["states"].read_text(encoding="utf-8"):
        captions["states"] += " Grey dashed lines are limits."
    captions["states"] += " Vertical dotted lines are ends of phases." * (len(solution.phases) > 1)

    def embed_captioned_figures(*stems: str) -> str:
        return "".join(embed_svg_figure(files, stem, captions[stem]) for stem in stems if stem in files)

    text, statement = (
        format_docstring_as_html(description),
        "" if problem is None else format_problem_statement(problem),
    )
    if "<math" in text:  # which has the equations as vectors: those by component are folded
        statement = statement.replace("<details open>", "<details>")
    known = solution.problem is not None and solution.status.solved
    limits = list(list_limit_margins(solution)) if known else []
    every_margin = list(iterate_control_structure_margins(solution)) if known else []
    margins = select_largest_risks(every_margin)
    first = "trajectory" if "trajectory" in files else "states"
    sections = {
        "Overview": _build_verdict_section(solution, verdict, captions["check"])
        + _build_solution_summary_table(solution, limits)
        + embed_captioned_figures(first, "controls"),
        "Problem": "" if problem is None else text + statement,
        "Limits and margins": _build_constraint_margins_table(solution, limits, captions["limits"])
        + embed_captioned_figures("constraints"),
        "States": embed_captioned_figures(*{"states"} - {first})
        + _build_boundary_values_table(solution, "state"),
        "Costates and Hamiltonian": embed_captioned_figures("costates")
        + _build_boundary_values_table(solution, "costate")
        + embed_captioned_figures("hamiltonian"),
        "Arcs": _build_control_arcs_table(solution, limits, captions["arcs"])
        + _build_control_structure_margins_table(solution, margins, captions["structure"]),
        "Multipliers": _build_boundary_multipliers_table(solution),
        "Refinement": f"<p>Mesh of the solution: {escape(format_mesh(solution))}.</p>"
        + _build_mesh_refinement_table(solution.history),
        "Conditions": _format_optimality_conditions_table(verdict),
    }
    names = _list_variable_names(solution)
    sections = {name: typeset_names_in_html(body, names) for name, body in sections.items()}
    sections = {"Overview": sections.pop("Overview"), "Motion": motion, **sections}
    sections["Software"] = _build_software_versions_table(solution, command, captions["software"])
    headline = _format_solve_and_verdict_headline(solution, verdict) + _format_nearly_singular_control(
        solution, every_margin
    )
    return typeset_names_in_html(headline, ()), sections


def _describe_hamiltonian_constancy(problem: Problem, solution: Solution) -> str:
    """Return whether the Hamiltonian is constant and, for a single phase with free final time, its value."""
    for phase in problem.phases.values():
        functions = phase.model.state_derivative(), phase.integrand_expression(), phase.path_expression()
        tables = [ca.vec(use.arguments) for use in phase.model.find_lookup_table_calls()]
        if ca.depends_on(ca.vertcat(*functions, *tables), phase.model.time):
            return " Time occurs explicitly in the problem, so that it may vary."
    slope, (initial, final) = ca.jacobian(problem.sense * problem.cost, phase.final_time), phase.time_ranges()
    times, ends = np.array([solution.phases[phase.name].final_time]), [*problem.constraints.values()]
    free = initial.is_fixed[0] and not np.any(final.is_near_limits(times, SMALL * np.abs(times)))
    free = free and not any(ca.depends_on(c.expression, phase.final_time) for c in ends)
    if len(problem.phases) > 1 or not slope.is_constant() or not free:
        return " It must be constant, because time does not occur explicitly."
    value = f"{0.0 - float(slope):g}, the negative derivative of the cost with respect to the free final time"
    return f" It must be constant, because time does not occur explicitly: {value}."


def _list_variable_names(solution: Solution) -> set[str]:
    names = set(solution.free_parameters.names)
    for phase in solution.phases.values():
        layouts = phase.states, phase.controls, phase.model_parameters
        names.update(*(layout.names for layout in layouts), (c.name for c in phase.composed_controls))
    return names


def _format_solve_and_verdict_headline(solution: Solution, verdict: Verdict | None) -> str:
    """Return a line with the result of the solve and of the optimality check, and the objective."""
    status = solution.status
    chips = (
        "" if status.solved else format_status_as_html(f"not solved: {status.value.replace('_', ' ')}", "bad")
    )
    if verdict is not None:
        tone = "good" if verdict.minimum else "bad" if verdict.failed else "open"
        proven = (
            "strict local optimum" if verdict.minimum else "necessary conditions hold, optimum not proven"
        )
        word = proven if verdict.ok else verdict.outcome
        chips += format_status_as_html(f"optimality check: {word}", tone)
    sense = "maximised" if solution.maximised else "minimised"
    objective = escape(format_objective(solution))
    sense += "; ± is the numerical error only" * ("±" in objective)
    return f"{chips} objective <strong>{objective}</strong> ({sense})"


def _format_nearly_singular_control(solution: Solution, margins: Iterable[StructureMargin]) -> str:
    """Return where a switching function nearly vanishes inside a phase without a switch, "" if nowhere."""
    for m in sorted(margins, key=lambda each: -each.risk):
        phase = solution.phase(m.phase)
        if m.kind == "smallest extremum" and phase.initial_time < m.time < phase.final_time:
            if m.risk * SINGULAR_SHARE < 1.0:
                break
            label = typeset_names_in_html(escape(m.label), _list_variable_names(solution))
            chip, share = format_status_as_html("nearly singular", "open"), f"{100.0 / m.risk:.3g} %"
            return (
                f"<br>{chip} The switching function of {label} falls to {share} of its largest magnitude at "
                f"{m.time:.5g} {time_unit(solution)} without a switch."
            )
    return ""


def _build_verdict_section(solution: Solution, verdict: Verdict | None, note: str) -> str:
    if not solution.status.solved:
        rows = [("what to do", solution.status.remedy)]
        rows += [(f"violated: {v.name}", f"by {v.amount:.2g} of its scale") for v in solution.violations]
        return format_html_table(("", ""), rows)
    if verdict is None:
        return "<p>Optimality was not checked.</p>"
    groups = [
        (group, find_worst_optimality_condition(found)) for group, found in verdict.condition_groups.items()
    ]
    checks = [(group, c.result.value.lower(), _describe_condition_result(c)) for group, c in groups]
    failures = format_html_table(
        ("result", "reason", "what to do"),
        [
            (c.result.value, _describe_condition_result(c), REMEDIES.get(c.name, c.meaning))
            for c in verdict.open_conditions
        ],
    )
    failures = f'<div class="failure">{failures}</div>' if failures else ""
    return (
        failures + format_html_table(("check", "result", "reason"), checks) + f'<p class="quiet">{note}</p>'
    )


def _describe_condition_result(condition: Condition) -> str:
    """Return value, tolerance, condition and location of a violation or margin in a sentence."""
    size, least = (f"{abs(value):.1e}" for value in (condition.value, condition.tolerance))
    place = f"{condition.name} ({condition.location_text})"
    if condition.value == 0.0 and condition.result is ConditionResult.PASS:
        return f"No violation was found; the tolerance is {least}."
    if np.isnan(condition.value) or condition.value == 0.0 or condition.tolerance < condition.value < 0.0:
        return f"The condition {'fails' if condition.result is ConditionResult.FAIL else 'is inconclusive'}: {place}."
    if condition.value < 0.0:
        return f"The margin {size} exceeds the required {least}: {place}."
    relation = "is within" if condition.value <= condition.tolerance else "exceeds"
    return f"The largest violation {size} {relation} the tolerance {least}: {place}."


def _build_solution_summary_table(solution: Solution, limits: Iterable[LimitMargin]) -> str:
    rows: list[tuple[str, str]] = []
    if solution.problem is not None:
        rows.append(("problem", Html(format_objective_section(solution.problem))))
    for name, phase in solution.phases.items():
        times = f"{phase.initial_time:.10g} to {phase.final_time:.10g} {time_unit(solution)}"
        rows.append((f"phase {name}", times))
    free = solution.free_parameters
    rows += [
        (f"parameter {label}", f"{value:.10g} {unit}".rstrip())
        for label, value, unit in zip(free.labels, solution.parameter_values, free.units, strict=True)
    ]
    pairs = [(a, b) for a, b in pairwise(solution.structure) if (a.phase, a.channel) == (b.phase, b.channel)]
    if switches := sum(a.kind.sign * b.kind.sign < 0 for a, b in pairs):
        rows.append(("switches", f"{switches} between control limits"))
    if solution.problem is not None and solution.status.solved:
        text = solution.accuracy.summary_text + _describe_largest_final_error(solution)
        rows.append(("integration of the applied controls", text))
    rows += _format_smallest_path_margin_row(limits, time_unit(solution))
    rows += _format_propellant_and_effort_rows(solution)
    rows += [("table left", str(found)) for found in list_points_outside_tables(solution)]
    return format_html_table(("", ""), rows)


def _describe_largest_final_error(solution: Solution) -> str:
    """Return "; largest final error in phase leg, q (m)"; a state without unit is marked."""
    where = solution.accuracy.miss_where
    return f"; largest final error in {where}{'' if where.endswith(')') else ' (no unit)'}" if where else ""


def _format_propellant_and_effort_rows(solution: Solution) -> Iterator[tuple[str, str]]:
    """Yield the decrease of masses, the effort of forces, torques and accelerations, and named integrals."""
    phases = list(solution.phases.values())
    states = {v.name: v for phase in phases for v in phase.states.variables}
    for name in [v.name for v in states.values() if v.unit == "kg" and v.size == 1]:
        signals = [phase.state(name)(phase.breaks[[0, -1]]) for phase in phases if name in phase.states]
        yield f"decrease of {name}", f"{-sum(float(np.diff(ends)[0]) for ends in signals):.6g} kg"
    for name in find_declared_controls(phases):
        owners = [phase for phase in phases if has_phase_control(phase, name)]
        unit = owners[0].saturated_control(name).unit
        is_vector = any(c.name == name for phase in owners for c in phase.vector_controls)
        if _IMPULSIVE.search(unit) and not is_vector:
            integral = simplify_time_integral_unit(f"{unit} s")
            effort = sum(compute_control_effort(phase, name) for phase in owners)
            yield f"effort of {name}", f"{effort:.5g} {integral}, the integral of the components' magnitudes"
    for phase in phases:
        where = f", phase {phase.name}" * (len(phases) > 1)
        named = (name for name in phase.integral_labels if not name.startswith("integral_"))
        yield from ((f"integral {name}{where}", f"{phase.integral(name):.8g}") for name in named)


def compute_control_effort(phase: PhaseSolution, name: str) -> float:
    """Return the integral of the magnitudes of an applied control, summed over its components."""
    t, values = sample_phase_signal(phase, phase.saturated_control(name))
    return float(np.trapezoid(np.sum(np.abs(values), axis=0), t))


def _build_boundary_values_table(solution: Solution, kind: str) -> str:
    """Return start, end, smallest and largest value of each state (and length of a vector) or costate; noise is 0."""
    phases = list(solution.phases.values())
    negligible = find_negligible_costates(phases)
    rows = []
    for phase in phases:
        _, values = sample_phase_signal(phase, phase.x if kind == "state" else phase.lam)
        for v in phase.states.variables:
            mine = values[phase.states.slice(v.name)]
            least = EQUAL * np.max(np.abs(mine)) if kind == "state" else negligible[v.name]
            unit = v.unit if kind == "state" else format_unit_quotient(get_cost_unit(solution), v.unit)
            labels, mine = list(v.labels), np.where(np.abs(mine) > least, mine, 0.0)
            if kind == "state" and v.unit and 1 < v.size <= _MAX_SPACE:
                labels, mine = [*labels, f"|{v.name}|"], np.vstack([mine, np.linalg.norm(mine, axis=0)])
            for label, row in zip(labels, mine, strict=True):
                numbers = (f"{value:.6g}" for value in (row[0], row[-1], row.min(), row.max()))
                rows.append((phase.name, label, *numbers, unit))
    return _build_html_table_by_phase(
        solution, (kind, "at the start", "at the end", "smallest", "largest", "unit"), rows
    )


def _build_html_table_by_phase(
    solution: Solution, titles: tuple[str, ...], rows: Sequence[tuple[str, ...]]
) -> str:
    """Return a table of rows that begin with the phase, which is omitted if there is only one."""
    first = int(len(solution.phases) == 1)
    return format_html_table(("phase", *titles)[first:], [row[first:] for row in rows])


def _format_optimality_conditions_table(verdict: Verdict | None) -> str:
    if verdict is None:
        return ""
    rows = [
        (c.name, c.result.value.lower(), *map(format_violation, (c.value, c.tolerance)), c.location_text)
        for c in verdict.conditions
    ]
    titles = ("condition", "result", "violation", "tolerance", "location")
    meanings = "".join(
        f"<p><strong>{escape(c.name)}</strong>: {escape(c.meaning)}</p>" for c in verdict.conditions
    )
    return format_html_table(titles, rows) + f'<div class="quiet">{meanings}</div>'


def _build_control_arcs_table(solution: Solution, limits: Iterable[LimitMargin], note: str) -> str:
    """Return the arcs of each control and constraint, unless it is never at a limit, with the multipliers."""
    unit, active = time_unit(solution), {}
    for found in limits:
        of_cost = format_unit_quotient(get_cost_unit(solution), found.quantity.unit)
        for arc in found.active:
            key = found.phase, arc.label, f"{'upper' if found.upper else 'lower'} limit", arc.start, arc.end
            active[key] = f"{arc.multiplier:.5g} {of_cost}".rstrip()
    arcs = [
        (arc.phase, arc.channel, arc.kind.value + " limit" * arc.kind.is_at_limit, arc.start, arc.end)
        for arc in solution.structure
    ]
    limited = {
        key[:2] for key, arc in zip(arcs, solution.structure, strict=True) if arc.kind is not ArcKind.INTERIOR
    }
    rows = [
        (*key[:3], *(f"{time:.5g}" for time in key[3:]), active.get(key, ""))
        for key in (arcs or active)
        if not arcs or key[:2] in limited
    ]
    titles = ("control or constraint", "arc", f"from ({unit})", f"to ({unit})", "multiplier")
    return _build_html_table_by_phase(solution, titles, rows) + f'<p class="quiet">{note}</p>' * bool(rows)


def _build_control_structure_margins_table(
    solution: Solution, margins: Iterable[StructureMargin], note: str
) -> str:
    """Return the shortest arc, the slowest switch and the smallest extremum of a switching function."""
    rows = []
    for m in margins:
        phase, unit = solution.phase(m.phase), time_unit(solution)
        share = f"{100.0 / m.risk:.3g} % of the " + ("phase" if m.kind == "shortest arc" else "largest |S|")
        text = f"{m.value:.5g} {unit}"
        if m.kind != "shortest arc":
            of_control = phase.controls.units[phase.controls.labels.index(m.label)]
            text = (
                f"{m.value:.3g} {format_unit_quotient(get_hamiltonian_unit(solution), of_control)}".rstrip()
            )
        if m.kind == "slowest switch":
            text += f" per {unit}"
            share = f"shifted by 1 % of the phase if S changes by {phase.duration / m.risk:.3g} % of the largest |S|"
        rows.append((m.phase, m.kind, m.label, f"{m.time:.5g}", text, share))
    note = f'<p class="quiet">{note}</p>' * any(m.kind != "shortest arc" for m in margins)
    titles = ("margin", "of", f"at ({time_unit(solution)})", "value", "relative to its scale")
    table = _build_html_table_by_phase(solution, titles, rows)
    return f"<h3>Smallest margins of the arcs</h3>{table}{note}" if rows else ""


def _build_mesh_refinement_table(history: History | None) -> str:
    if history is None:
        return ""
    numbered = [
        (f"{i}, returned" if i == history.chosen else str(i), p) for i, p in enumerate(history.passes)
    ]
    if (first := history.first_solve) is not None:
        numbered.insert(0, ("first solve", replace(first, stage="first mesh", actions="arcs detected")))
    rows = [
        (
            number,
            *(p.n_segments, p.n_points, f"{p.error:.1e}", f"{p.objective:.12g}", p.iterations),
            *(f"{p.seconds:.2f}", p.stage, p.actions),
        )
        for number, p in numbered
    ]
    counts = "iteration", "segments", "nodes", "error", "objective", "NLP iterations"
    titles = *counts, "time (s)", "stage", "changes"
    message = f"{history.message[:1].upper()}{history.message[1:].rstrip('.')}."
    message = f"{message} Refinement and optimality checks took {history.seconds:.2g} s."
    if any("switching times" in p.stage for p in history.passes):
        message += " In stages with switching times, the free breakpoints of the mesh are the ends of arcs."
    return f"<p>{escape(message)}</p>" + format_html_table(titles, rows)


def _build_constraint_margins_table(solution: Solution, limits: Iterable[LimitMargin], note: str) -> str:
    rows = []
    for found in limits:
        v, searched = found.quantity, found.quantity.name in ("initial time", "final time")
        relative = f" ({100 * found.margin / abs(found.limit):.3g} %)" if found.limit and not searched else ""
        row = (
            _format_constraint_limit(found) + " (search bound)" * searched,
            f"{found.attained:.6g}" + f" ({found.label})" * (v.size > 1),
            "" if np.isnan(found.time) else f"{found.time:.6g}",
            f"{found.margin:.6g}{relative}",
        )
        rows.append((found.phase, *row))
    titles = ("requirement", "attained", f"at ({time_unit(solution)})", "margin")
    return _build_html_table_by_phase(solution, titles, rows) + f'<p class="quiet">{note}</p>' * bool(rows)


def _format_constraint_limit(found: LimitMargin) -> str:
    v = found.quantity
    return f"{v.name} {'≤' if found.upper else '≥'} {found.limit:.6g} {v.unit}".rstrip()


def _format_smallest_path_margin_row(limits: Iterable[LimitMargin], unit: str) -> Iterator[tuple[str, str]]:
    """Yield the limit over time that is not attained with the smallest margin relative to the limit."""
    inactive = [each for each in limits if each.margin > 0.0 and each.limit and not np.isnan(each.time)]
    if inactive:
        found = min(inactive, key=lambda each: each.margin / abs(each.limit))
        share = f"{100.0 * found.margin / abs(found.limit):.3g} %"
        limit = _format_constraint_limit(found)
        text = f"{limit}: {found.attained:.6g} attained at {found.time:.6g} {unit}, margin {share}"
        yield "smallest margin of an inactive limit", text


def _build_boundary_multipliers_table(solution: Solution) -> str:
    """Return the multipliers of boundary constraints and parameters; those of linkages are costates."""
    links = set() if solution.problem is None else build_phase_linkage_rows(solution.problem)[1]
    rows = [
        (f"constraint {label}", f"{value:.6g}")
        for label, value in zip(solution.constraint_labels, solution.constraint_multipliers, strict=True)
        if label.partition("[")[0] not in links
    ]
    rows += [
        (f"limits of {label}", f"{value:.6g}")
        for label, value in zip(solution.free_parameters.labels, solution.parameter_multipliers, strict=True)
    ]
    return format_html_table(("multiplier", "decrease of the minimised cost per unit of the limit"), rows)


def _build_software_versions_table(solution: Solution, command: str | None, note: str) -> str:
    rows = [
        (name, _UNSET_OPTION.sub("", str(value)))
        for name, value in solution.provenance.items()
        if name not in ("scheme", "mesh")
    ]
    rows.append(("last solve", solution.statistics.summary_text))
    return (
        format_shell_command_as_html(command)
        + format_html_table(("", ""), rows)
        + f'<p class="quiet">{note}</p>'
    )
