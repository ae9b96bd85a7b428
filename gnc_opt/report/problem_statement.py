"""Problem statement of a report: cost, dynamics, boundary conditions, limits and parameters as formulas and tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.model.variables import Layout
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.report.formulas import (
    Formulas,
    component_names_mathml,
    function_call_mathml,
    inline_formula,
    name_mathml,
    number_mathml,
)
from gnc_opt.text_formatting import html_table

_TIME = "<mi>t</mi>"


def problem_statement_html(problem: Problem) -> str:
    """Return the cost, the boundary constraints, the free parameters and all phases as HTML."""
    writer = Formulas(_name_boundary_symbols(problem))
    shown: dict[str, str] = {}
    phases = "".join(_phase_section(problem, leg, shown) for leg in problem.phases.values())
    return (
        _objective_section(problem, writer)
        + phases
        + _boundary_constraints_section(problem, writer)
        + _free_parameters_section(problem)
    )


# --- cost and ends ----------------------------------------------------------------------------------------


def _name_boundary_symbols(problem: Problem) -> dict[int, str]:
    """Return the names of boundary states, times, integrals and free parameters."""
    names = component_names_mathml({s.variable.name: s for s in problem.free_parameter_symbols()})
    several = len(problem.phases) > 1
    for leg in problem.phases.values():
        of_phase = f"<mtext>{escape(leg.name)}</mtext>" if several else ""
        times = {
            "initial": _boundary_time_mathml("0", of_phase),
            "final": _boundary_time_mathml("f", of_phase),
        }
        for end, time in times.items():
            labels = [name_mathml(label) for label in leg.model.states.labels]
            for label, element in zip(labels, ca.vertsplit(leg.end_states(end)), strict=True):
                names[element.element_hash()] = f"<mrow>{label}<mo>(</mo>{time}<mo>)</mo></mrow>"
        for time, symbol in zip(times.values(), (leg.initial_time, leg.final_time), strict=True):
            names[symbol.element_hash()] = time
        for name, (symbol, _) in leg.integrands.items():
            names[symbol.element_hash()] = _integral_mathml(name)
    return names


def _boundary_time_mathml(mark: str, of_phase: str) -> str:
    return f"<msub>{_TIME}<mrow><mi>{mark}</mi>{'<mo>,</mo>' if of_phase else ''}{of_phase}</mrow></msub>"


def _integral_mathml(name: str) -> str:
    _, numbered, index = name.partition("integral_")
    return f"<msub><mi>I</mi><mn>{index}</mn></msub>" if numbered else name_mathml(name)


def _objective_section(problem: Problem, writer: Formulas) -> str:
    sense = "maximise" if problem.sense < 0 else "minimise"
    unit = f", in {problem.cost_unit}" if problem.cost_unit else ""
    return f"<p>{sense.capitalize()} the objective{escape(unit)}:</p>" + _equation_formulas(
        writer, [("<mi>J</mi>", problem.cost)]
    )


def _boundary_constraints_section(problem: Problem, writer: Formulas) -> str:
    if not problem.constraints:
        return ""
    linkages, named = linkage_rows(problem)
    rows = [
        row
        for name, c in problem.constraints.items()
        if name not in named
        for row in _pair_rows_with_limits(c.labels, c.expression, c.interval)
    ]
    links = (
        "<h3>Linked phases</h3>" + html_table(("from", "to", "equal", "changed by"), linkages)
        if linkages
        else ""
    )
    return links + ("<h3>Boundary constraints</h3>" + _constraint_formulas(writer, rows) if rows else "")


def linkage_rows(problem: Problem) -> tuple[list[tuple[str, ...]], set[str]]:
    """Return a row for each pair of linked phases, and the names of the constraints that it states."""
    links: dict[tuple[str, str], tuple[list[str], list[str]]] = {}
    named = set()
    for leg in problem.phases.values():
        handed = [(name, first, change) for name, (first, change) in leg.handed.items()]
        handed += [("time", leg.follows, np.zeros(1))] if leg.follows is not None else []
        for name, first, change in handed:
            equal, changed = links.setdefault((first, leg.name), ([], []))
            if np.any(change):
                changed.append(f"{name}: {_format_numbers(change)} {leg.model.states[name].unit}".rstrip())
            else:
                equal.append(name)
            named.add(f"link_{first}_{leg.name}_{name}")
    return [(*pair, ", ".join(equal), ", ".join(changed)) for pair, (equal, changed) in links.items()], named


def _free_parameters_section(problem: Problem) -> str:
    box = problem.parameter_interval()
    rows = [
        (label, interval_text(box, [i]), unit)
        for i, (label, unit) in enumerate(
            zip(problem.parameters.labels, problem.parameters.units, strict=True)
        )
    ]
    return "<h3>Free parameters</h3>" + html_table(("parameter", "range", "unit"), rows) if rows else ""


# --- phases -----------------------------------------------------------------------------------------------


def _phase_section(problem: Problem, leg: Phase, shown: dict[str, str]) -> str:
    """Return a phase; parts equal to those of an earlier phase are replaced by a reference."""

    def refer_if_repeated(part: str) -> str:
        earlier = shown.setdefault(part, leg.name)
        return part if earlier == leg.name else f"<p>As in phase {escape(earlier)}.</p>"

    initial, final = leg.time_ranges()
    span = leg.numbers.duration
    times = [
        ("initial time", interval_text(initial, [0]), problem.time_unit),
        ("final time", interval_text(final, [0]), problem.time_unit),
    ]
    if span.lower[0] > 0 or np.isfinite(span.upper[0]):
        times.append(("duration", interval_text(span, [0]), problem.time_unit))
    body = [
        f"<h3>Phase {escape(leg.name)}</h3>" if len(problem.phases) > 1 else "",
        *(f"<p>{escape(text)}.</p>" for text in (leg.restatement.texts if leg.restatement else ())),
        "<h4>Dynamics</h4>",
        refer_if_repeated(_dynamics_section(problem, leg)),
        "<h4>States, controls and times</h4>",
        html_table(
            ("", "initial value", "final value", "limits", "unit"),
            [
                *_state_table_rows(leg),
                *(
                    (name, "", "", interval_text(leg.numbers.controls, rows), unit)
                    for name, rows, unit in _iterate_layout_components(leg.model.controls)
                ),
                *((name, "", "", value, unit) for name, value, unit in times),
            ],
        ),
        *(
            ["<h4>Parameters of the model</h4>", refer_if_repeated(values)]
            if (values := _model_parameters_table(problem, leg))
            else []
        ),
    ]
    return "".join(body)


def _iterate_layout_components(layout: Layout) -> Iterable[tuple[str, list[int], str]]:
    for v in layout.variables:
        place = layout.slice(v.name)
        yield (
            (v.name if v.size == 1 else f"{v.name} [{v.size}]"),
            list(range(place.start, place.stop)),
            v.unit,
        )


def _state_table_rows(leg: Phase) -> list[tuple[str, ...]]:
    numbers = leg.numbers
    return [
        (name, *(interval_text(box, rows) for box in (numbers.initial, numbers.final, numbers.states)), unit)
        for name, rows, unit in _iterate_layout_components(leg.model.states)
    ]


def _model_parameters_table(problem: Problem, leg: Phase) -> str:
    values = leg.model.parameter_values
    rows = [
        (name, "free" if name.split(" [")[0] in problem.parameters else _format_numbers(values[rows]), unit)
        for name, rows, unit in _iterate_layout_components(leg.model.parameters)
    ]
    return html_table(("parameter", "value", "unit"), rows)


def _dynamics_section(problem: Problem, leg: Phase) -> str:
    """Return the dynamics, integrals and path constraints of a phase as formulas."""
    writer = Formulas(_phase_symbol_names(problem, leg))
    states = leg.model.states
    rows: list[tuple[str, Any]] = []
    for v, derivative in ((v, leg.model.derivative()[states.slice(v.name)]) for v in states.variables):
        whole = _find_variable_name(leg, derivative)
        if whole:
            rows.append((name_mathml(v.name, dotted=True), whole))
        else:
            labelled = zip(v.labels, ca.vertsplit(derivative), strict=True)
            rows += [(name_mathml(label, dotted=True), element) for label, element in labelled]
    text = _equation_formulas(writer, rows)
    if leg.integrands:
        integrals = [(f"{_integral_mathml(name)}", value) for name, (_, value) in leg.integrands.items()]
        text += "<h4>Integrals over the phase, of</h4>" + _equation_formulas(writer, integrals)
    limited = [
        row for c in leg.paths.values() for row in _pair_rows_with_limits(c.labels, c.expression, c.interval)
    ]
    return text + ("<h4>Path constraints</h4>" + _constraint_formulas(writer, limited) if limited else "")


def _phase_symbol_names(problem: Problem, leg: Phase) -> dict[int, str]:
    """Return the names of time, states, controls, parameters and table values."""
    model = leg.model
    layouts = (model.states, model.controls, model.parameters)
    names = component_names_mathml(
        {v.name: model.symbol(v.name) for layout in layouts for v in layout.variables}
    )
    names[model.time.element_hash()] = _TIME
    names |= component_names_mathml({s.variable.name: s for s in problem.free_parameter_symbols()})
    writer = Formulas(names)
    for use in model.find_table_calls():
        if use.value.numel() == 1 and writer.is_short_enough(use.arguments):
            arguments = ["".join(writer.split_terms(argument)) for argument in ca.vertsplit(use.arguments)]
            names[use.value.element_hash()] = function_call_mathml(use.table.name or "table", arguments)
    return names


def _find_variable_name(leg: Phase, expression: Any) -> str:
    """Return the name of the variable that a vector consists of, component by component; "" if there is none."""
    places = [element.element_hash() for element in ca.vertsplit(expression)]
    for layout in (leg.model.states, leg.model.controls):
        for v in layout.variables:
            if [e.element_hash() for e in ca.vertsplit(leg.model.symbol(v.name))] == places:
                return name_mathml(v.name)
    return ""


# --- formulas ---------------------------------------------------------------------------------------------


def _pair_rows_with_limits(
    labels: Sequence[str], expression: Any, box: Interval
) -> list[tuple[str, Any, Interval]]:
    boxes = (Interval(box.lower[i : i + 1], box.upper[i : i + 1]) for i in range(box.lower.size))
    return list(zip(labels, ca.vertsplit(expression), boxes, strict=True))


def _constraint_formulas(writer: Formulas, rows: Sequence[tuple[str, Any, Interval]]) -> str:
    if not writer.is_short_enough(ca.vertcat(*[element for _, element, _ in rows])):
        return _note_omitted_expressions(rows)
    lines = []
    for label, element, box in rows:
        lower, upper = float(box.lower[0]), float(box.upper[0])
        middle = _allow_breaks_between_terms(writer.split_terms(element))
        before = (
            inline_formula(number_mathml(lower) + "<mo>≤</mo>")
            if np.isfinite(lower) and lower != upper
            else ""
        )
        sign = "=" if lower == upper else "≤"
        after = inline_formula(f"<mo>{sign}</mo>" + number_mathml(upper)) if np.isfinite(upper) else ""
        lines.append((escape(label), f"{before} {middle} {after}"))
    return _formula_table(lines) + _auxiliary_formulas(writer)


def _equation_formulas(writer: Formulas, rows: Sequence[tuple[str, Any]]) -> str:
    expressions = ca.vertcat(*[value for _, value in rows if not isinstance(value, str)])
    if expressions.numel() and not writer.is_short_enough(expressions):
        return _note_omitted_expressions(rows)
    lines = []
    for label, value in rows:
        right = (
            inline_formula(value)
            if isinstance(value, str)
            else _allow_breaks_between_terms(writer.split_terms(value))
        )
        lines.append((inline_formula(label), inline_formula("<mo>=</mo>") + " " + right))
    return _formula_table(lines) + _auxiliary_formulas(writer)


def _auxiliary_formulas(writer: Formulas) -> str:
    found = [
        (inline_formula(name), inline_formula("<mo>=</mo>" + formula))
        for name, formula in writer.auxiliary[writer.shown :]
    ]
    writer.shown = len(writer.auxiliary)
    return ("<p>where</p>" if found else "") + _formula_table(found)


def _note_omitted_expressions(rows: Sequence[Sequence[Any]]) -> str:
    names = ", ".join(dict.fromkeys(str(row[0]) for row in rows if not str(row[0]).startswith("<")))
    return f"<p>{len(rows)} expressions as in the program{escape(f': {names}' if names else '')}; too long to show.</p>"


def _allow_breaks_between_terms(terms: Iterable[str]) -> str:
    return " ".join(inline_formula(term) for term in terms)


def _formula_table(rows: Iterable[tuple[str, str]]) -> str:
    body = "".join(f"<tr><td>{left}</td><td>{right}</td></tr>" for left, right in rows)
    return f'<div class="wide"><table class="formulas"><tbody>{body}</tbody></table></div>' if body else ""


# --- numbers ----------------------------------------------------------------------------------------------


def interval_text(box: Interval, rows: Sequence[int]) -> str:
    """Return "20, 0, 0", "-1 to 1", "at most 3" or "free" of some rows of an interval."""
    lower, upper = box.lower[rows], box.upper[rows]
    if np.all(lower == upper):
        return _format_numbers(lower)
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


def _format_numbers(values: Any) -> str:
    texts = [f"{value + 0.0:.6g}" for value in np.ravel(values)]
    return texts[0] if len(set(texts)) == 1 else ", ".join(texts)
