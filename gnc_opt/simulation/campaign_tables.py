"""Text and JSON output of a campaign's statistics."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from gnc_opt.simulation.confidence_intervals import CONFIDENCE, Percentile, share_below_maximum
from gnc_opt.text_html_and_json_formatting import build_attribute_dict, convert_to_json_values

LEVELS = (0.5, 0.9, 0.95, 0.99)
"""Levels of the percentiles in the output."""

PASSED = ("passed", "rate", "low", "high")
"""Members of a pass rate in the output."""

LISTED = 5
"""Largest numbers of failure causes, of failed runs per cause, and of events in the output."""

CampaignStatistics: TypeAlias = Any
"""A `gnc_opt.simulation.Campaign`; not imported here to avoid a circular import."""


def select_printed_performance_measures(campaign: CampaignStatistics) -> tuple[str, ...]:
    """Return the measures to print: those with limits first, then errors, user-defined measures and efforts.

    The error of an attitude with a limited angle is omitted, which is the same number.
    """
    errors = [n for n in campaign.measures if "(" not in n and f"angle({n})" not in campaign.limits]
    efforts = [n for n in campaign.measures if n.startswith("effort(")]
    return tuple(dict.fromkeys([*campaign.limits, *errors, *efforts]))


def format_campaign_table(campaign: CampaignStatistics) -> str:
    """Return the summary table of a campaign: outcomes, percentiles, and pass rates with confidence intervals."""
    runs, n_runs = len(campaign), campaign.asked
    counts = ", ".join(f"{count} {status.value}" for status, count in campaign.status_counts.items())
    interrupted = f" of {n_runs}, interrupted" if campaign.interrupted else ""
    lines = [f"campaign of {runs} runs{interrupted}, seed {campaign.seed}: {counts or 'none has ended'}"]
    if not runs:
        return lines[0]
    rows = build_campaign_table_rows(campaign)
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        cells = [
            c.ljust(w) if i < 2 else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append(("  " + "  ".join(cells)).rstrip())
    notes = [*format_confidence_and_event_notes(campaign), *_format_failure_causes(campaign)]
    return "\n".join([*lines, *(f"  {note}" for note in notes)])


def build_campaign_table_rows(
    campaign: CampaignStatistics, levels: Sequence[float] = LEVELS, *, intervals: bool = False
) -> list[list[str]]:
    """Return header and rows of the table: percentiles, maximum, limit and pass rate of each printed measure.

    With intervals, a percentile is "2 (1.8 to 2.1)", or "2 (above 1.8)" if the number of runs gives no upper limit.
    """
    titles = *(f"{100 * level:g} %" for level in levels), "largest", "limit", "pass rate"
    rows = [["measure", "unit", *titles]]
    for name in select_printed_performance_measures(campaign):
        percentiles = [campaign.percentile(name, level) for level in levels]
        numbers = [
            _format_performance_statistic(p.value) + (_format_confidence_interval(p) if intervals else "")
            for p in percentiles
        ]
        limit, passed = "", ""
        if name in campaign.limits:
            limit, passed = (
                _format_performance_statistic(campaign.limits[name]),
                str(campaign.pass_rate(name)),
            )
        numbers.append(_format_performance_statistic(campaign.maximum(name)))
        rows.append([campaign.describe_measure(name), campaign.unit(name), *numbers, limit, passed])
    if campaign.limits:
        rows.append(["all limits", *[""] * (len(levels) + 3), str(campaign.pass_rate())])
    return rows


def _format_confidence_interval(percentile: Percentile) -> str:
    if not math.isfinite(percentile.low):
        return " (no interval)"
    low, high = _format_performance_statistic(percentile.low), _format_performance_statistic(percentile.high)
    return f" ({low} to {high})" if math.isfinite(percentile.high) else f" (above {low})"


def format_confidence_and_event_notes(campaign: CampaignStatistics) -> list[str]:
    """Return the notes on confidence levels and events."""
    runs, tail = len(campaign), (1 - CONFIDENCE) / 2
    notes = [f"Pass rates have two-sided intervals with {100 * CONFIDENCE:g} % confidence."]
    needed = {level: math.ceil(math.log(tail) / math.log(level)) for level in LEVELS}  # level^n <= tail
    if few := ", ".join(f"{100 * level:g} % (needs {n} runs)" for level, n in needed.items() if n > runs):
        notes.append(f"With {runs} runs these percentiles have no upper confidence limit: {few}.")
    if all(np.isfinite(campaign.maximum(name)) for name in select_printed_performance_measures(campaign)):
        share = f"{100 * share_below_maximum(runs):.2f} % of all runs"
        notes.append(
            f"With the same confidence (one-sided), {share} stay below the largest value of each measure."
        )
    return [*notes, *_format_event_counts(campaign)]


def _format_event_counts(campaign: CampaignStatistics) -> list[str]:
    text = ", ".join(f"{name} in {count} runs" for name, count in campaign.event_totals.items())
    return [f"events: {text}"] if text else []


def _format_failure_causes(campaign: CampaignStatistics) -> list[str]:
    runs_by_cause: dict[str, list[int]] = defaultdict(list)
    for index, outcome in campaign.failures.items():
        status = outcome.status.value
        text = re.sub(r" (is )?[-+.\de]+(, |$)", r" \1", outcome.what).strip()  # without numbers
        runs_by_cause[f"{status}: {text}" if text else status].append(index)
    ordered = sorted(runs_by_cause.items(), key=lambda item: -len(item[1]))
    lines = []
    for cause, indices in ordered[:LISTED]:
        more = ", ..." if len(indices) > LISTED else ""
        lines.append(f"{len(indices)} {cause} (run {', '.join(map(str, indices[:LISTED]))}{more})")
    other_failures = sum(len(indices) for _, indices in ordered[LISTED:])
    return [*lines, f"{other_failures} for other causes"] if other_failures else lines


def _format_performance_statistic(value: float) -> str:
    if not math.isfinite(value):
        return "failed"
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"


def build_campaign_summary_dict(campaign: CampaignStatistics) -> dict[str, Any]:
    """Return statistics and failures of a campaign as JSON values; null stands for infinity."""
    runs = len(campaign)
    content = {
        "runs": runs,
        "asked": campaign.asked,
        "seed": campaign.seed,
        "span": list(campaign.span),
        "interrupted": campaign.interrupted,
        "confidence": CONFIDENCE,
        "outcomes": {status.value: count for status, count in campaign.status_counts.items()},
        "events": campaign.event_totals,
        "failures": [
            {"run": index, "status": outcome.status.value, "what": outcome.what, "time": outcome.time}
            for index, outcome in campaign.failures.items()
        ],
        "measures": {
            name: _build_performance_statistics_dict(campaign, name)
            for name in select_printed_performance_measures(campaign)
        }
        if runs
        else {},
        "passed": build_attribute_dict(campaign.pass_rate(), *PASSED) if runs else None,
        "share_below_maximum": share_below_maximum(runs) if runs else None,
    }
    return dict(convert_to_json_values(content))


def _build_performance_statistics_dict(campaign: CampaignStatistics, name: str) -> dict[str, Any]:
    limited, members = name in campaign.limits, ("level", "value", "low", "high")
    return {
        "unit": campaign.unit(name),
        "percentiles": [build_attribute_dict(campaign.percentile(name, level), *members) for level in LEVELS],
        "max": campaign.maximum(name),
        "limit": campaign.limits[name] if limited else None,
        "passed": build_attribute_dict(campaign.pass_rate(name), *PASSED) if limited else None,
    }
