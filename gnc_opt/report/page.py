"""The page about one solution."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from gnc_opt.markup import table
from gnc_opt.report.document import again, chip, document, pictures
from gnc_opt.report.summary import known_quality, mesh_text
from gnc_opt.report.verdict_table import number_text, verdict_counts
from gnc_opt.solution.history import History
from gnc_opt.solution.solution import Solution
from gnc_opt.verify.verdict import Condition, Result, Verdict

_TONES = {Result.PASS: "good", Result.FAIL: "bad", Result.CANNOT_TELL: "open"}


def page(
    solution: Solution,
    verdict: Verdict | None,
    files: Sequence[Path],
    *,
    motion: str = "",
    command: str | None = None,
) -> str:
    """Return the page as HTML.

    Parameters
    ----------
    solution : Solution
    verdict : Verdict or None
    files : sequence of Path
        Figures, which become part of the page.
    motion : str
        The scene in three dimensions as HTML.
    command : str, optional
        What was typed to get here.
    """
    sections = {
        "Answer": _answer(solution),
        "Motion": motion,
        "Verdict": _verdict(verdict),
        "Arcs": _arcs(solution),
        "Refinement": _refinement(solution.history),
        "Figures": pictures(files),
        "Multipliers": _multipliers(solution),
        "Provenance": _provenance(solution, command),
    }
    return document(solution.problem_name, _chips(solution, verdict), sections)


# --- sections -------------------------------------------------------------------------------------------


def _chips(solution: Solution, verdict: Verdict | None) -> str:
    """Status, verdict and objective in one line."""
    solved = solution.status.solved
    chips = chip(f"solver: {solution.status.value.replace('_', ' ')}", "" if solved else "bad")
    if verdict is not None:
        chips += chip(verdict.word, "good" if verdict.ok else "bad" if verdict.failed else "open")
        chips += chip("a strict local minimum", "good") if verdict.minimum else ""
    sense = "maximised" if solution.maximised else "minimised"
    return f"{chips} objective <strong>{solution.objective:.12g}</strong> ({sense})"


def _answer(solution: Solution) -> str:
    rows = [("mesh", mesh_text(solution))]
    for name, leg in solution.phases.items():
        rows.append((f"phase {name}", f"{leg.initial_time:.12g} s to {leg.final_time:.12g} s"))
    for name in solution.free_parameters.names:
        rows.append((f"parameter {name}", f"{solution.parameter(name)}"))
    quality = known_quality(solution)
    if quality is not None:
        rows += [
            ("defect between nodes", f"{quality.max_defect:.2g} relative: {quality.defect_where}"),
            (
                "outside its bounds",
                f"{quality.max_bound_violation:.2g} of their range: {quality.bound_where}",
            ),
            ("miss when flown", f"{quality.terminal_error:.2g} relative: {quality.terminal_where}"),
        ]
    rows += [(f"broken: {broken.name}", f"{broken.amount:.2g}") for broken in solution.violations]
    if not solution.status.solved:
        rows.append(("what to do", solution.status.remedy))
    return table(("", ""), rows)


def _verdict(verdict: Verdict | None) -> str:
    if verdict is None:
        return "<p>Not judged.</p>"
    return f"<p>{verdict_counts(verdict)}. Each line unfolds.</p>" + "".join(
        _condition(c) for c in verdict.conditions
    )


def _condition(condition: Condition) -> str:
    opened = " open" if condition.result is Result.FAIL else ""
    return (
        f"<details{opened}><summary>{chip(condition.result.value, _TONES[condition.result])}"
        f"<b>{escape(condition.name)}</b><span>{number_text(condition.value)}, tolerance "
        f"{condition.tolerance:.0e}</span></summary>"
        f"<p>{escape(condition.offence_text)}</p><p>{escape(condition.meaning)}</p></details>"
    )


def _arcs(solution: Solution) -> str:
    rows = [
        (arc.phase, arc.channel, arc.kind.value, f"{arc.start:.12g}", f"{arc.end:.12g}")
        for arc in solution.structure
    ]
    return table(("phase", "channel", "arc", "from (s)", "to (s)"), rows)


def _refinement(history: History | None) -> str:
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
    titles = ("pass", "segments", "points", "error", "objective", "iterations", "time (s)", "done")
    return f"<p>{escape(history.message)}</p>" + table(titles, rows)


def _multipliers(solution: Solution) -> str:
    rows = list(zip(solution.constraint_labels, map(_exact, solution.constraint_multipliers), strict=True))
    rows += zip(solution.free_parameters.labels, map(_exact, solution.parameter_multipliers), strict=True)
    for name, leg in solution.phases.items():
        ends = zip(leg.states.labels, leg.lam(leg.initial_time), leg.lam(leg.final_time, "left"), strict=True)
        for label, first, last in ends:
            rows.append(
                (
                    f"costate of {label}, phase {name}",
                    f"{_exact(first)} at the start, {_exact(last)} at the end",
                )
            )
    return table(("", "value"), rows)


def _provenance(solution: Solution, command: str | None) -> str:
    rows = [(key.replace("_", " "), str(value)) for key, value in solution.provenance.items()]
    rows.append(("solver", solution.statistics.text))
    return again(command) + table(("", ""), rows)


# --- pieces ---------------------------------------------------------------------------------------------


def _exact(value: float) -> str:
    return f"{value:.9g}"
