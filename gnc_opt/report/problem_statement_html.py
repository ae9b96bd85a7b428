"""Problem statement of a report: cost, dynamics, boundary conditions, limits and parameters as formulas and tables."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Sequence
from html import escape, unescape
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.model.model_variables import Layout
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.report.html_report_document import read_figure_captions
from gnc_opt.report.mathml_formulas import (
    Formulas,
    convert_latex_to_mathml,
    format_inline_formula,
    typeset_component_names,
    typeset_function_call,
    typeset_number,
    typeset_variable_name,
)
from gnc_opt.text_html_and_json_formatting import Html, format_html_table, pluralise_noun

_TIME = "<mi>t</mi>"


def format_problem_statement(problem: Problem) -> str:
    """Return the cost, the boundary constraints, the free parameters and all phases as HTML."""
    writer = Formulas(_map_boundary_symbols_to_names(problem))
    shown: dict[str, str] = {}
    phases = "".join(_build_phase_section(problem, phase, shown) for phase in problem.phases.values())
    return (
        f"<p>Objective: {format_objective_section(problem, writer)}.</p>"
        + _format_auxiliary_symbol_formulas(writer)
        + phases
        + _build_boundary_constraints_section(problem, writer)
        + _build_free_parameters_section(problem)
    )


def _map_boundary_symbols_to_names(problem: Problem) -> dict[int, str]:
    """Return the names of boundary states, times, integrals and free parameters."""
    names = typeset_component_names({s.variable.name: s for s in problem.free_parameter_symbols()})
    several = len(problem.phases) > 1
    for phase in problem.phases.values():
        of_phase = f"<mo>,</mo><mtext>{escape(phase.name)}</mtext>" if several else ""
        marks = (("initial", "0"), ("final", "f"))
        times = {end: f"<msub>{_TIME}<mrow><mi>{mark}</mi>{of_phase}</mrow></msub>" for end, mark in marks}
        for end, time in times.items():
            labels = [typeset_variable_name(label) for label in phase.model.states.labels]
            for label, element in zip(labels, ca.vertsplit(phase.end_states(end)), strict=True):
                names[element.element_hash()] = (
                    f"<mrow>{label}<mo stretchy='false'>(</mo>{time}<mo stretchy='false'>)</mo></mrow>"
                )
        for time, symbol in zip(times.values(), (phase.initial_time, phase.final_time), strict=True):
            names[symbol.element_hash()] = time
        for name, (symbol, _) in phase.integrands.items():
            names[symbol.element_hash()] = _format_integral_symbol(name)
    return names


def _format_integral_symbol(name: str) -> str:
    _, numbered, index = name.partition("integral_")
    return f"<msub><mi>I</mi><mn>{index}</mn></msub>" if numbered else typeset_variable_name(name)


def format_objective_section(problem: Problem, writer: Formulas | None = None) -> str:
    """Return "minimise t_f, in s"; without a writer of auxiliary quantities "the cost" if the formula needs some."""
    used = writer or Formulas(_map_boundary_symbols_to_names(problem))
    terms = used.split_formula_terms(problem.cost) if used.are_formulas_short(problem.cost) else []
    formula = (
        _format_terms_with_line_breaks(terms) if terms and (writer or not used.auxiliary) else "the cost"
    )
    unit = f", in {escape(problem.cost_unit)}" if problem.cost_unit else ""
    return f"{'maximise' if problem.sense < 0 else 'minimise'} {formula}{unit}"


def format_docstring_as_html(text: str) -> str:
    """Return the paragraphs and formulas of a docstring, such as that of a problem file."""
    shown = []
    for part in re.split(r"\n\s*\n", inspect.cleandoc(text)):
        if part.startswith(".. math::"):
            shown.append(_convert_latex_to_mathml(part.removeprefix(".. math::"), "block"))
        elif part and not part.startswith((".. ", " ")):
            part = re.sub(r"\*\*(.+?)\*\*", r"<strong>\1</strong>", escape(re.sub(":$", ".", part)))
            part = re.sub(r":math:`(.+?)`", lambda found: _convert_latex_to_mathml(found[1], "inline"), part)
            shown.append("<p>" + re.sub(r"(`+)(.+?)\1", r"<code>\2</code>", part) + "</p>")
    return "".join(shown)


def _convert_latex_to_mathml(formula: str, display: str) -> str:
    """Return MathML; without the package latex2mathml "" for a block and the source for a formula in a line."""
    if display == "block" and "&" in formula:
        formula = rf"\begin{{split}}{formula}\end{{split}}"
    try:
        mathml = convert_latex_to_mathml(unescape(formula), display)
    except ImportError:
        return f"<code>{formula}</code>" * (display == "inline")
    return mathml if display == "inline" else f'<div class="wide">{mathml}</div>'


def _build_boundary_constraints_section(problem: Problem, writer: Formulas) -> str:
    linkages, named = build_phase_linkage_rows(problem)
    others = [c for name, c in problem.constraints.items() if name not in named]
    links = format_html_table(("from", "to", "equal", "changed by"), linkages)
    return _add_html_section_title("h3", "Linked phases", links) + _add_html_section_title(
        "h3", "Boundary constraints", _format_path_constraints(writer, others)
    )


def _add_html_section_title(tag: str, title: str, body: str) -> str:
    return f"<{tag}>{title}</{tag}>{body}" * bool(body)


def build_phase_linkage_rows(problem: Problem) -> tuple[list[tuple[str, ...]], set[str]]:
    """Return a row for each pair of linked phases, and the names of the constraints that it states."""
    links: dict[tuple[str, str], tuple[list[str], list[str]]] = {}
    named = set()
    for phase in problem.phases.values():
        handed = [(name, first, change) for name, (first, change) in phase.linked_states.items()]
        handed += [("time", phase.preceding_phase, np.zeros(1))] if phase.preceding_phase is not None else []
        for name, first, change in handed:
            equal, changed = links.setdefault((first, phase.name), ([], []))
            if np.any(change):
                changed.append(
                    f"{name}: {_format_number_list(change)} {phase.model.states[name].unit}".rstrip()
                )
            else:
                equal.append(name)
            named.add(f"link_{first}_{phase.name}_{name}")
    return [(*pair, ", ".join(equal), ", ".join(changed)) for pair, (equal, changed) in links.items()], named


def _build_free_parameters_section(problem: Problem) -> str:
    box = problem.get_parameter_bounds()
    rows = [
        (name, format_interval_limits(box, at), unit)
        for name, at, unit in iterate_variables_with_rows(problem.parameters)
    ]
    return _add_html_section_title(
        "h3", "Free parameters", format_html_table(("parameter", "range", "unit"), rows)
    )


# --- phases -----------------------------------------------------------------------------------------------


def _build_phase_section(problem: Problem, phase: Phase, shown: dict[str, str]) -> str:
    """Return a phase; parts equal to those of an earlier phase are replaced by a reference."""

    def refer_to_identical_section_of_earlier_phase(part: str) -> str:
        earlier = shown.setdefault(part, phase.name) if part else phase.name
        return part if earlier == phase.name else f"<p>As in phase {escape(earlier)}.</p>"

    initial, final = phase.time_ranges()
    span, boxes = phase.numbers.duration, (phase.numbers.initial, phase.numbers.final, phase.numbers.states)
    times = {"initial time": initial, "final time": final}
    if span.lower[0] > 0 or np.isfinite(span.upper[0]):
        times["duration"] = span
    body = [
        f"<h3>Phase {escape(phase.name)}</h3>" if len(problem.phases) > 1 else "",
        *(f"<p>{escape(text)}.</p>" for text in (phase.control_map.texts if phase.control_map else ())),
        "<h4>Dynamics</h4>",
        refer_to_identical_section_of_earlier_phase(_build_dynamics_section(problem, phase)),
        "<h4>States, controls and times</h4>",
        format_html_table(
            ("", "initial value", "final value", "limits", "unit"),
            [
                *(
                    (name, *(format_interval_limits(box, rows) for box in boxes), unit)
                    for name, rows, unit in iterate_variables_with_rows(phase.model.states)
                ),
                *(
                    (name, "", "", format_interval_limits(phase.numbers.controls, rows), unit)
                    for name, rows, unit in iterate_variables_with_rows(phase.model.controls)
                ),
                *(
                    (name, "", "", format_interval_limits(box, [0]), problem.time_unit)
                    for name, box in times.items()
                ),
            ],
        ),
        _add_html_section_title(
            "h4",
            "Parameters of the model",
            refer_to_identical_section_of_earlier_phase(_build_parameter_table(problem, phase)),
        ),
    ]
    return "".join(body)


def iterate_variables_with_rows(layout: Layout) -> Iterable[tuple[str, list[int], str]]:
    for v in layout.variables:
        place = layout.slice(v.name)
        yield (
            (v.name if v.size == 1 else f"{v.name} [{v.size}]"),
            list(range(place.start, place.stop)),
            v.unit,
        )


def _build_parameter_table(problem: Problem, phase: Phase) -> str:
    values, symbols = phase.model.parameter_values, _find_parameter_symbols(problem, phase)
    rows = []
    for text, places, unit in iterate_variables_with_rows(phase.model.parameters):
        name = text.split(" [")[0]
        value = "free" if name in problem.parameters else _format_number_list(values[places])
        symbol = Html(format_inline_formula(typeset_variable_name(symbols[name]))) if name in symbols else ""
        rows.append((text, symbol, value, unit))
    return format_html_table(("parameter", "symbol" * bool(symbols), "value", "unit"), rows)


def _find_parameter_symbols(problem: Problem, phase: Phase) -> dict[str, str]:
    """Return the usual symbols of parameters with such a name, unless another variable has the symbol as its name."""
    model, usual = phase.model, read_figure_captions("symbols")
    used = {*problem.parameters.names, *model.states.names, *model.controls.names, *model.parameters.names}
    bases = {name.partition("_")[0] for name in used} | ({"I"} if phase.integrands else set())
    return {
        name: usual[name] for name in model.parameters.names if usual.get(name, "")[:1] not in {"", *bases}
    }


def _build_dynamics_section(problem: Problem, phase: Phase) -> str:
    """Return the dynamics, integrals and path constraints of a phase as formulas."""
    writer = Formulas(_list_phase_symbol_names(problem, phase))
    states = phase.model.states
    symbols = {
        _compute_expression_hashes(phase.model.symbol(v.name)): v.name
        for v in (*states.variables, *phase.model.controls.variables)
    }
    rows: list[tuple[str, Any]] = []
    for v in states.variables:
        rates = phase.model.state_derivative()[states.slice(v.name)]
        if (
            whole := symbols.get(_compute_expression_hashes(rates))
        ) is not None:  # of a vector, such as the velocity
            rows.append((typeset_variable_name(v.name, dotted=True), typeset_variable_name(whole)))
        else:
            rows += zip(
                (typeset_variable_name(label, dotted=True) for label in v.labels),
                ca.vertsplit(rates),
                strict=True,
            )
    text = _format_equations_as_mathml(writer, rows)
    if count := len(writer.auxiliary):
        words = f"By component, as in the program ({pluralise_noun(count, 'repeated term')})"
        text = f"<details open><summary>{words}</summary>{text}</details>"
    if phase.integrands:
        integrals = [
            (f"{_format_integral_symbol(name)}", value) for name, (_, value) in phase.integrands.items()
        ]
        text += "<h4>Integrals over the phase, of</h4>" + _format_equations_as_mathml(writer, integrals)
    return text + _add_html_section_title(
        "h4", "Path constraints", _format_path_constraints(writer, phase.paths.values())
    )


def _compute_expression_hashes(column: Any) -> tuple[int, ...]:
    return tuple(element.element_hash() for element in ca.vertsplit(column))


def _list_phase_symbol_names(problem: Problem, phase: Phase) -> dict[int, str]:
    """Return the names of time, states, controls, parameters and table values."""
    model = phase.model
    layouts, symbols = (
        (model.parameters, model.states, model.controls),
        _find_parameter_symbols(problem, phase),
    )
    variables = [v.name for layout in layouts for v in layout.variables]
    names = typeset_component_names({symbols.get(name, name): model.symbol(name) for name in variables})
    names[model.time.element_hash()] = _TIME
    names |= typeset_component_names({s.variable.name: s for s in problem.free_parameter_symbols()})
    writer = Formulas(names)
    for use in model.find_lookup_table_calls():
        if use.value.numel() == 1 and writer.are_formulas_short(use.arguments):
            arguments = [
                "".join(writer.split_formula_terms(argument)) for argument in ca.vertsplit(use.arguments)
            ]
            names[use.value.element_hash()] = typeset_function_call(use.table.name or "table", arguments)
    return names


# --- formulas ---------------------------------------------------------------------------------------------


def _format_path_constraints(writer: Formulas, constraints: Iterable[Any]) -> str:
    lines = []
    for c in constraints:
        expressions = ca.vertsplit(c.expression)
        rows = zip(c.labels, expressions, c.interval.lower, c.interval.upper, strict=True)
        for label, element, lower, upper in rows:
            before = typeset_number(lower) + "<mo>≤</mo>" if np.isfinite(lower) and lower != upper else ""
            sign = "=" if lower == upper else "≤"
            after = f"<mo>{sign}</mo>" + typeset_number(upper) if np.isfinite(upper) else ""
            after += f"<mtext> {escape(c.unit)}</mtext>" * bool(c.unit)
            lines.append((escape(label), before, element, after))
    return _format_formula_table(writer, lines)


def _format_equations_as_mathml(writer: Formulas, rows: Sequence[tuple[str, Any]]) -> str:
    return _format_formula_table(
        writer, [(format_inline_formula(label), "<mo>=</mo>", value, "") for label, value in rows]
    )


def _format_formula_table(writer: Formulas, lines: Sequence[tuple[str, str, Any, str]]) -> str:
    """Return a table of label, MathML before an expression, expression or its MathML, and MathML after it."""
    expressions = ca.vertcat(*[value for _, _, value, _ in lines if not isinstance(value, str)])
    if expressions.numel() and not writer.are_formulas_short(expressions):
        names = ", ".join(dict.fromkeys(label for label, *_ in lines if not label.startswith("<")))
        return f"<p>{len(lines)} expressions as in the program{f': {names}' * bool(names)}; too long to show.</p>"
    rows = []
    for label, before, value, after in lines:
        terms = [value] if isinstance(value, str) else writer.split_formula_terms(value)
        rows.append(
            (label, _format_terms_with_line_breaks([part for part in (before, *terms, after) if part]))
        )
    return _build_formula_table_html(rows) + _format_auxiliary_symbol_formulas(writer)


def _format_auxiliary_symbol_formulas(writer: Formulas) -> str:
    found = [
        (format_inline_formula(name), format_inline_formula("<mo>=</mo>" + formula))
        for name, formula in writer.auxiliary[writer.shown :]
    ]
    writer.shown = len(writer.auxiliary)
    return ("<p>where</p>" if found else "") + _build_formula_table_html(found)


def _format_terms_with_line_breaks(terms: Iterable[str]) -> str:
    return " ".join(format_inline_formula(term) for term in terms)


def _build_formula_table_html(rows: Iterable[tuple[str, str]]) -> str:
    body = "".join(f"<tr><td>{left}</td><td>{right}</td></tr>" for left, right in rows)
    return f'<div class="wide"><table class="formulas"><tbody>{body}</tbody></table></div>' if body else ""


def format_interval_limits(box: Interval, rows: Sequence[int]) -> str:
    """Return "20, 0, 0", "-1 to 1", "at most 3" or "free" of some rows of an interval."""
    lower, upper = box.lower[rows], box.upper[rows]
    if np.all(lower == upper):
        return _format_number_list(lower)
    texts = [_format_scalar_interval(low, high) for low, high in zip(lower, upper, strict=True)]
    return texts[0] if len(set(texts)) == 1 else "; ".join(texts)


def _format_scalar_interval(lower: float, upper: float) -> str:
    if lower == upper:
        return f"{lower:.6g}"
    if np.isfinite(lower) and np.isfinite(upper):
        return f"{lower:.6g} to {upper:.6g}"
    if np.isfinite(lower):
        return f"at least {lower:.6g}"
    return f"at most {upper:.6g}" if np.isfinite(upper) else "free"


def _format_number_list(values: Any) -> str:
    texts = [f"{value + 0.0:.6g}" for value in np.ravel(values)]
    return texts[0] if len(set(texts)) == 1 else ", ".join(texts)
