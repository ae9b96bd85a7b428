"""The conditions of a verdict as a table for terminals."""

from __future__ import annotations

import io

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from gnc_opt.planning.solution.verdict import Condition, ConditionResult, Verdict
from gnc_opt.report.page import residual_text

_STYLES = {
    ConditionResult.PASS: "green",
    ConditionResult.FAIL: "bold red",
    ConditionResult.INCONCLUSIVE: "yellow",
}


def verdict_counts(verdict: Verdict) -> str:
    """Return "11 pass, 0 fail, 2 inconclusive"."""
    results = [condition.result for condition in verdict.conditions]
    return ", ".join(f"{results.count(result)} {result.value.lower()}" for result in ConditionResult)


def verdict_table(verdict: Verdict) -> Table:
    """Return the conditions of a verdict as a rich table: name, result, value, tolerance, place."""
    table = Table(box=box.SIMPLE_HEAD, title=verdict_headline(verdict), title_justify="left", pad_edge=False)
    table.add_column("condition", no_wrap=True)
    table.add_column("result", no_wrap=True)
    table.add_column("value", justify="right", no_wrap=True)
    table.add_column("tolerance", justify="right", no_wrap=True)
    table.add_column("worst at", overflow="fold")
    for condition in verdict.conditions:
        table.add_row(*_cells(condition))
    return table


def verdict_headline(verdict: Verdict) -> Text:
    """Return "verdict on '...': ok, 11 pass, 0 fail, 2 inconclusive", in colour."""
    style = "green" if verdict.ok else "bold red" if verdict.failed else "yellow"
    return Text.assemble(
        f"verdict on '{verdict.problem_name}': ", (verdict.word, style), f" ({verdict_counts(verdict)})"
    )


def verdict_text(verdict: Verdict, width: int = 120) -> str:
    """Return the table as plain text of at most ``width`` columns, without colours, ending in a newline."""
    stream = io.StringIO()
    Console(file=stream, width=width).print(verdict_table(verdict))
    return "\n".join(line.rstrip() for line in stream.getvalue().strip("\n").splitlines()) + "\n"


def _cells(condition: Condition) -> tuple[Text, ...]:
    return (
        Text(condition.name),
        Text(condition.result.value, _STYLES[condition.result]),
        Text(residual_text(condition.value)),
        Text(f"{condition.tolerance:.0e}"),
        Text(condition.location_text),
    )
