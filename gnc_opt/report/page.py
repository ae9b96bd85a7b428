"""The page about one solution.

The one page of a report: its frame, its style and its pieces; it needs no network and no other file.

A verdict as a table.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from gnc_opt.errors import GncOptError
from gnc_opt.planning.solution.history import History
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.summary import known_quality, mesh_text
from gnc_opt.planning.solution.verdict import Condition, ConditionResult, Verdict
from gnc_opt.text import table

_KINDS = {".svg": "image/svg+xml", ".png": "image/png"}
"""Content that browsers draw inside a page."""


def report_folder(directory: str | Path) -> Path:
    """Make a folder for a report and return its path; refuse a file."""
    folder = Path(directory)
    if folder.exists() and not folder.is_dir():
        raise GncOptError(f"cannot write the report to '{folder}', which is a file: name a folder.")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def save_figures(folder: Path, figures: Iterable[tuple[str, Any]]) -> list[Path]:
    """Write figures by file stem as SVG and return their paths."""
    from gnc_opt.plot.style import save_figure

    return [save_figure(figure, folder / f"{stem}.svg") for stem, figure in figures]


def document(title: str, headline: str, sections: Mapping[str, str]) -> str:
    """Return a page: sections of HTML below their titles, empty ones left out."""
    shown = {name: body for name, body in sections.items() if body}
    links = "".join(f'<a href="#{_anchor(name)}">{name}</a>' for name in shown)
    bodies = "".join(
        f'<section id="{_anchor(name)}"><h2>{name}</h2>{body}</section>' for name, body in shown.items()
    )
    name = escape(title)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{name}</title><style>{_STYLE}</style></head>\n<body><header><h1>{name}</h1>"
        f"<p>{headline}</p><nav>{links}</nav></header>\n<main>{bodies}</main></body></html>\n"
    )


def pictures(paths: Sequence[Path]) -> str:
    """Return SVG and PNG files as part of a page; others are left out."""
    return "".join(_picture(path) for path in paths if path.suffix in _KINDS)


def chip(word: str, tone: str) -> str:
    """Return a word that stands out; tones: good, bad, open or none."""
    return f'<span class="chip {tone}">{escape(word)}</span>'


def again(command: str | None) -> str:
    """Return how to get the same page again."""
    return f"<p>Again: <code>{escape(command)}</code></p>" if command else ""


def _anchor(title: str) -> str:
    return title.lower().replace(" ", "-")


def _picture(path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    name = escape(path.stem.replace("_", " "))
    source = f"data:{_KINDS[path.suffix]};base64,{data}"
    return f'<figure><img alt="{name}" src="{source}"><figcaption>{name}</figcaption></figure>'


_STYLE = """
:root { color-scheme: light dark; --ink: #1a1f24; --quiet: #5b6770; --paper: #fff; --line: #d8dde1;
  --good: #1a7f4b; --bad: #c0341d; --open: #8a6100; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ec; --quiet: #9aa7b1; --paper: #14181c; --line: #343c44;
  --good: #4cc38a; --bad: #ff8a70; --open: #e3b341; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 62rem; padding: 1rem; font: 16px/1.5 system-ui, sans-serif; color: var(--ink);
  background: var(--paper); }
h1 { margin: 0; font-size: 1.6rem; } h2 { margin: 2rem 0 .5rem; font-size: 1.15rem; }
nav { display: flex; flex-wrap: wrap; gap: .2rem 1.2rem; padding: .4rem 0; border-block: 1px solid var(--line); }
a { color: inherit; } a:focus-visible, summary:focus-visible { outline: 2px solid var(--good); }
.chip { display: inline-block; padding: 0 .55rem; margin-right: .5rem; border: 1px solid; border-radius: 1rem;
  font-size: .85rem; font-weight: 600; }
.good { color: var(--good); } .bad { color: var(--bad); } .open { color: var(--open); }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem 1rem .2rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line); }
th, summary span:last-child, figcaption { color: var(--quiet); font-weight: normal; }
details { padding: .3rem 0; border-bottom: 1px solid var(--line); } details p { margin: .3rem 0 .3rem 1rem; }
summary { cursor: pointer; } summary b { margin-right: .8rem; }
figure { margin: 0 0 1.5rem; } figcaption { font-size: .9rem; }
img { max-width: 100%; padding: .5rem; background: #fff; border-radius: .3rem; }
code { overflow-wrap: anywhere; } pre { overflow-x: auto; font-size: .85rem; }
#stage { height: min(36rem, 75vh); } #film { display: flex; flex-wrap: wrap; gap: .5rem; align-items: center; }
#film input { flex: 1 1 12rem; } #film select { max-width: 100%; } #film output { min-width: 7rem; }
#film button, #film select { font: inherit; min-height: 2.2rem; min-width: 4.5rem; }
@media print { nav, #motion { display: none; } figure, details, tr { break-inside: avoid; }
  h2 { break-after: avoid; } figure img { width: auto; max-width: 100%; max-height: 22cm; } }
"""


def verdict_counts(verdict: Verdict) -> str:
    """Return "11 pass, 0 fail, 2 inconclusive"."""
    words = {
        ConditionResult.PASS: "pass",
        ConditionResult.FAIL: "fail",
        ConditionResult.INCONCLUSIVE: "inconclusive",
    }
    results = [condition.result for condition in verdict.conditions]
    return ", ".join(f"{results.count(result)} {word}" for result, word in words.items())


def number_text(value: float) -> str:
    """Return two digits of a number, "-" for none."""
    return f"{value + 0.0:.1e}" if math.isfinite(value) else "-" if math.isnan(value) else "inf"


_TONES = {ConditionResult.PASS: "good", ConditionResult.FAIL: "bad", ConditionResult.INCONCLUSIVE: "open"}


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
            ("defect between nodes", f"{quality.max_defect:.2g} relative: {quality.defect_location}"),
            (
                "outside its bounds",
                f"{quality.max_bound_violation:.2g} of their range: {quality.bound_location}",
            ),
            ("miss when flown", f"{quality.propagation_error:.2g} relative: {quality.propagation_location}"),
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
    opened = " open" if condition.result is ConditionResult.FAIL else ""
    return (
        f"<details{opened}><summary>{chip(condition.result.value, _TONES[condition.result])}"
        f"<b>{escape(condition.name)}</b><span>{number_text(condition.value)}, tolerance "
        f"{condition.tolerance:.0e}</span></summary>"
        f"<p>{escape(condition.location_text)}</p><p>{escape(condition.meaning)}</p></details>"
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
