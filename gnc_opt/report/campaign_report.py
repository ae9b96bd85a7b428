"""Report of a campaign: a folder with an HTML page, data and figures."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from gnc_opt.argument_checks import read_integer, read_probability
from gnc_opt.errors import GncOptError
from gnc_opt.report.html_report_document import (
    build_html_document,
    create_report_folder,
    embed_svg_figure,
    format_shell_command_as_html,
    format_status_as_html,
    get_running_command_line,
    read_figure_captions,
    save_figures_as_svg,
)
from gnc_opt.report.mathml_formulas import typeset_names_in_html
from gnc_opt.text_html_and_json_formatting import Html, format_html_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gnc_opt.analysis.loop_frequency_response import LoopResponse
    from gnc_opt.plot.vehicle_motion_sampling import View
    from gnc_opt.simulation.campaign_results import Campaign
    from gnc_opt.simulation.confidence_intervals import PassRate
    from gnc_opt.simulation.simulation_run_results import Run

_LEVELS = (0.5, 0.95, 0.99)
"""Levels of the percentiles in the table of results."""

_HEADLINE_LEVELS = (0.99, 0.95, 0.9, 0.5)
"""Levels of which the first with upper confidence limits is in the conclusion."""

_LISTED_RUNS, _CLOSEST_RUNS = 20, 5
"""Largest number of failed runs in the table, and of those closest to a limit if none failed."""


def write_campaign_report(
    campaign: Campaign,
    directory: str | Path,
    *,
    title: str = "",
    author: str = "",
    view: View | None = None,
    runs: int = 200,
    command: str | None = None,
    required: float | None = None,
    response: LoopResponse | None = None,
) -> list[Path]:
    """Write an HTML page on a campaign, the campaign, its statistics as JSON and its figures to a folder.

    Parameters
    ----------
    campaign : Campaign
    directory : str or Path
        Output folder; created if missing. Files of an earlier report are replaced.
    title, author : str
        Title line, default: with the name of the plant; author, printed below it.
    view : gnc_opt.plot.View, optional
        View for the 3-D motion of several runs, which are simulated again.
    command : str, optional
        Command that reproduces the report, printed on the page.
    runs : int
        Largest number of runs that are simulated again: for the envelopes of states and controls the first ones, for
        the motion those first that did not pass.
    required : float, optional
        Required probability in (0, 1) that a run passes; the conclusion states whether the campaign demonstrates it.
    response : gnc_opt.analysis.LoopResponse, optional
        Result of `loop_response`; adds the margins of the loop with all its components.

    Returns
    -------
    list of Path
        ``report.html``, ``campaign.npz``, ``campaign.json`` and the figures (SVG).

    Raises
    ------
    GncOptError
        ``directory`` is a file, ``required`` is not between 0 and 1, no run is complete, or a view is given for a
        campaign without compiled loop.

    Examples
    --------
    >>> from gnc_opt.report import write_campaign_report
    >>> print([file.name for file in write_campaign_report(campaign, "report")][:3])
    ['report.html', 'campaign.npz', 'campaign.json']
    """
    runs = read_integer(runs, "the number of runs to show", 1)
    if required is not None:
        required = read_probability(required, "the required pass probability")
    if not len(campaign):
        raise GncOptError("no run of the campaign is complete: run it longer.")
    folder = create_report_folder(directory)
    rerun = cache(campaign.rerun)
    motion = "" if view is None else _build_sample_runs_section(campaign, view, runs, rerun)
    captions = read_figure_captions("campaign")
    begin, end = campaign.span
    first = _rank_runs_by_limit_excess(campaign)[0][0]
    worst, cause = int(campaign.indices[first]), _describe_run_failure(campaign, first)
    files = save_figures_as_svg(folder, _draw_campaign_figures(campaign, worst, runs, rerun))
    scenario = [row for row in campaign.scenario if row[0] not in ("design", "dispersion", "software")]
    versions = [row[1:] for row in campaign.scenario if row[0] == "software"]
    design = [
        (name, *_format_controller_design_result(campaign, name, text))
        for kind, name, text in campaign.scenario
        if kind == "design"
    ]
    loop = "".join(f" The {kind} is {name} ({text})." for kind, name, text in scenario[:2])
    dispersed = ", ".join(name for kind, name, _ in campaign.scenario if kind == "dispersion")
    loop += f" The dispersed parameters are {dispersed}." * bool(dispersed)

    def embed_captioned_figures(*stems: str) -> str:
        of_all = "all" if runs >= len(campaign) else f"the first {runs} of"
        facts = {"worst": worst, "shown": f"{of_all} {len(campaign)} runs"}
        return "".join(embed_svg_figure(files, stem, captions[stem].format(**facts)) for stem in stems)

    sections = {
        "Overview": f"<ul>{build_campaign_conclusion(campaign, captions, required)}</ul>"
        + f"<p>The campaign has {len(campaign)} runs from {begin:g} to {end:.6g} s with seed {campaign.seed}."
        f"{escape(loop)} {captions['passed']}</p>"
        + _build_performance_measure_table(campaign, captions["percentiles"])
        + embed_captioned_figures("distributions"),
        **_build_critical_runs_section(campaign, captions),
        "Effects of dispersions": _build_uncorrelated_measures_note(campaign, captions)
        + embed_captioned_figures("effects"),
        "Final errors": embed_captioned_figures("envelope-final")
        + _build_campaign_figures_html(files, "dispersion", captions),
        "Envelopes": _build_campaign_figures_html(files, "envelope", captions)
        + embed_captioned_figures("envelope-errors", "envelope-states", "envelope-controls"),
        f"Worst run: {worst}": captions["worst" if cause[3] else "worst failure"].format(*map(escape, cause))
        + embed_captioned_figures("errors", "states", "controls"),
        "Saturation": _build_actuator_saturation_table(campaign, captions["saturation"]),
        "Scenario": format_html_table(("part", "name", "description"), scenario),
        "Controller": captions["controller"] * bool(design)
        + format_html_table(("quantity", "value"), [row[:2] for row in design if row[1]])
        + "".join(f"<h3>{escape(name)}</h3>{matrix}" for name, _, matrix in design if matrix)
        + (_build_stability_margins_table(response, captions["margins"]) if response is not None else ""),
        "Parameters": _build_parameter_dispersion_tables(campaign),
    }
    symbols = {name for layout in campaign.layouts.values() for name in layout.names}
    sections = {name: typeset_names_in_html(body, symbols) for name, body in sections.items()} | {
        "Motion": motion
    }
    data = [("runs", len(campaign)), ("seed", campaign.seed), ("fingerprint", campaign.fingerprint)]
    repeated = captions["repeat"].format(
        runs=len(campaign), seed=campaign.seed, end=f"{end:.10g}", worst=worst
    )
    sections["Software"] = (
        format_shell_command_as_html(command or get_running_command_line())
        + repeated
        + format_html_table(("", ""), [*data, *versions])
    )
    passed = campaign.pass_rate()
    all_passed = passed.passed == len(campaign) if required is None else required <= passed.low
    tone = "good" if all_passed else "open" if passed.passed else "bad"
    label = f"{passed.passed} of {len(campaign)} passed"
    if required is not None:
        label += f", {100 * required:.6g} % {'' if all_passed else 'not '}demonstrated"
    chip = format_status_as_html(label, tone)
    headline = f"{chip}The pass rate is {passed} with 95 % confidence."
    statistics = folder / "campaign.json"
    campaign.to_json(statistics)
    page = folder / "report.html"
    title = title or ": ".join(filter(None, ("campaign", " with ".join(row[1] for row in scenario[:2]))))
    text = build_html_document(title, headline, sections, author, campaign.fingerprint)
    page.write_text(text, encoding="utf-8")
    return [page, campaign.save(folder / "campaign.npz"), statistics, *files.values()]


def _rank_runs_by_limit_excess(campaign: Campaign) -> tuple[Any, dict[str, Any]]:
    """Return the places of runs, failed ones first, and the excess over limits (or 0) as a share of each."""
    limits, measure = campaign.limits or dict.fromkeys(campaign.measures[:1], 0.0), campaign.measure
    excess = {n: np.nan_to_num((measure(n) - x) / (abs(x) or 1.0), nan=np.inf) for n, x in limits.items()}
    largest = np.max([*excess.values(), np.full(len(campaign), -np.inf)], axis=0)
    return np.lexsort((-largest, campaign.passed())), excess


def _build_performance_measure_table(campaign: Campaign, note: str) -> str:
    """Return percentiles, limit and pass rate of each measure with their confidence intervals, and notes."""
    from gnc_opt.simulation.campaign_tables import (
        build_campaign_table_rows,
        format_confidence_and_event_notes,
        select_printed_performance_measures,
    )

    cells, shares = build_campaign_table_rows(campaign, _LEVELS, intervals=True), ["99 % / limit"]
    found = _compute_percentiles_relative_to_limit(campaign, _LEVELS[-1])
    for name in select_printed_performance_measures(campaign):
        share, low, high = map(_format_share_of_limit, found.get(name, 3 * (np.nan,)))
        shares.append(f"{share} ({f'{low} to {high}' if high else f'above {low}'})" * bool(share and low))
    titles, *rows = [
        [
            Html(re.sub(r"^(.*) \((.*)\)$", r"\1<br><small>\2</small>", escape(text)))
            for text in (*row[:2], *row[-2:], *row[2:-3], share, row[-3])
        ]
        for row, share in zip(cells, [*shares, ""], strict=False)
    ]
    notes = "".join(
        f"<p>{escape(each)}</p>" for each in (note, *format_confidence_and_event_notes(campaign)[1:])
    )
    return format_html_table(titles, rows) + notes


def _build_critical_runs_section(campaign: Campaign, captions: Mapping[str, str]) -> dict[str, str]:
    """Return the section of the failed runs, or of those closest to a limit."""
    (order, excess), limits, rows = _rank_runs_by_limit_excess(campaign), campaign.limits, []
    count, lost = int(np.sum(~campaign.passed())), int(np.sum(~campaign.ok))
    varied = np.any(campaign.parameters != campaign.parameters[:, :1], axis=1)
    spread = scipy.stats.zscore(campaign.parameters[varied], axis=1)
    labels = np.array(campaign.layouts["parameter"].labels)[varied]
    for k in order[: min(count, _LISTED_RUNS) or _CLOSEST_RUNS * bool(limits)]:
        largest = np.argsort(-np.abs(spread[:, k]), kind="stable")[:2]
        deviations = ", ".join(f"{labels[i]} {spread[i, k]:+.1f}" for i in largest)
        rows.append((int(campaign.indices[k]), *_describe_run_failure(campaign, k), deviations))
    titles = ("run", "cause or measure", "value", "limit", "value / limit", "at (s)", "largest deviations")
    text = captions["failed runs"].format(count, count - lost, lost) if count else ""
    beyond = {name: np.sum((excess[name] > 0.0) & (excess[name] < np.inf)) for name in limits}
    counts = ", ".join(f"{campaign.describe_measure(name)} in {n}" for name, n in beyond.items() if n)
    text += f"Runs beyond a limit: {escape(counts)}. " * bool(counts)
    text += captions["critical runs"].format(int(campaign.indices[order[0]]), campaign.seed)
    title = "Failed runs" if count else "Runs closest to limits"
    return {title: f"<p>{text}</p>{format_html_table(titles, rows)}" if rows else ""}


def _describe_run_failure(campaign: Campaign, k: int) -> tuple[str, str, str, str, str]:
    """Return why a run failed, or the measure closest to its limit, with value, limit, share of it and time."""
    outcome, excess = (
        campaign.outcomes[k],
        {name: each[k] for name, each in _rank_runs_by_limit_excess(campaign)[1].items()},
    )
    if not outcome.ok or not excess:
        return str(outcome).replace("_", " "), "", "", "", ""
    name = max(excess, key=lambda each: excess[each])
    more = sum(bool(0.0 < each < np.inf) for each in excess.values()) - 1
    cause = campaign.describe_measure(name) + f" and {more} more" * (more > 0)
    value, limit = campaign.measure(name)[k], campaign.limits.get(name)
    unit = f" {campaign.unit(name)}".rstrip()
    texts = f"{value:.4g}{unit}", "" if limit is None else f"{limit:.4g}{unit}"
    share = _format_share_of_limit(value / limit) if limit else ""
    return cause, *texts, share, f"{_find_time_of_extreme_value(campaign, name, k):.6g}"


def _compute_percentiles_relative_to_limit(
    campaign: Campaign, level: float
) -> dict[str, tuple[float, float, float]]:
    """Return a percentile of each measure and its confidence interval as shares of the limit, if that is positive."""
    found = {name: campaign.percentile(name, level) for name, limit in campaign.limits.items() if limit > 0.0}
    limits = campaign.limits
    return {n: (p.value / limits[n], p.low / limits[n], p.high / limits[n]) for n, p in found.items()}


def _format_share_of_limit(share: float) -> str:
    """Return a share of a limit as "27 %" or "40 ×"; "" for NaN or infinity."""
    text = f"{100.0 * share:.3g} %" if abs(share) < 10.0 else f"{share:.3g} ×"
    return text if np.isfinite(share) else ""


def build_campaign_conclusion(
    campaign: Campaign, captions: Mapping[str, str], required: float | None = None
) -> str:
    """Return pass rate, required probability, and the largest share of a limit by the highest bounded percentile."""
    rate, act = campaign.pass_rate(), "meet all limits" if campaign.limits else "end without failure"
    interval = f"{100 * rate.low:.4g} %", f"{100 * rate.high:.4g} %"
    requirement = _format_pass_rate_requirement(rate, captions, required)
    passed = captions["passed runs"].format(rate.passed, rate.runs, act, *interval, requirement)
    for level in _HEADLINE_LEVELS:
        shares = _compute_percentiles_relative_to_limit(campaign, level)
        if shares and np.all(np.isfinite(list(shares.values()))):
            name = max(shares, key=lambda each: shares[each][2])
            share, low, high = map(_format_share_of_limit, shares[name])
            share = share.replace("%", "% of").replace("×", "times")
            measure = escape(campaign.describe_measure(name))
            return captions["conclusion"].format(passed, measure, f"{100 * level:g}", share, low, high)
    return captions["no bound"].format(passed) if campaign.limits else passed


def _format_pass_rate_requirement(rate: PassRate, captions: Mapping[str, str], required: float | None) -> str:
    """Return whether a pass rate demonstrates a probability, and else the number of runs without failure that would."""
    if required is None:
        return captions["not required"]
    runs = int(np.ceil(np.log((1.0 - rate.confidence) / 2.0) / np.log(required)))  # required^runs <= tail
    found = "demonstrated" if required <= rate.low else "undecided" if required <= rate.high else "missed"
    found += " with failures" if found == "undecided" and rate.passed < rate.runs else ""
    return captions[found].format(f"{100 * required:.6g} %", runs)


def _build_stability_margins_table(response: LoopResponse, note: str) -> str:
    """Return gain, phase, delay and disk margins of each command at each time of a frequency response."""
    rows: list[tuple[str, ...]] = []
    for k, (time, disk) in enumerate(zip(response.times, response.disk_margins, strict=True)):
        if not disk > 0.0:  # NaN: open
            rows.append((f"{time:g}", "all", "unstable" if disk == 0.0 else "open: all commands at limits"))
            continue
        found = response.margins(k)
        columns = (found.gain_down, found.gain_up, np.degrees(found.phase), found.delay)
        for label, *values in zip(response.commands.labels, *columns, strict=True):
            down, *others = ("∞" if np.isinf(value) else f"{round(value, 9):.3g}" for value in values)
            gains = f"{down} to {others[0]}"
            rows.append((f"{time:g}", label, gains, *others[1:], f"{disk:.3g}"))
    titles = ("time (s)", "command", "gain factors", "phase (deg)", "delay (s)", "disk margin")
    return note + format_html_table(titles, rows)


def _build_uncorrelated_measures_note(campaign: Campaign, captions: Mapping[str, str]) -> str:
    """Return the measures without a significant correlation with a single dispersed component."""
    from gnc_opt.plot.campaign_figures import rank_dispersion_effects

    every = rank_dispersion_effects(campaign).items()
    weak = [name for name, (found, noise) in every if found and abs(found[0][1]) <= noise]
    names = escape(", ".join(map(campaign.describe_measure, weak)))
    return captions["weak effects"].format(names) if weak else ""


def _format_controller_design_result(campaign: Campaign, name: str, text: str) -> tuple[str, str]:
    """Return a value with the controls of margins, and "", or "" and the table of a gain with names and units."""
    commands, errors = (campaign.layouts[kind] for kind in ("command", "error"))
    followed = campaign.layouts.get("followed")
    text = re.sub(r"-?[\d.]+e\+0[345]\b", lambda found: f"{float(found[0]):.0f}", text)
    numbers, _, remark = text.partition(" (")
    rows, note = [line.split(", ") for line in numbers.split("\n")], f"({remark}" * bool(remark)
    names = [n for n in followed.names if n in errors] if followed else list(errors.names)
    columns = [(label, v.unit) for v in (errors[n] for n in names) for label in v.labels]
    if "gain" in name and len(rows) == commands.size and len(rows[0]) == len(columns) > 1:
        titles = (Html(f"{escape(label)}<br><small>{escape(unit)}</small>") for label, unit in columns)
        cells = [(label, *row) for label, row in zip(commands.labels, rows, strict=True)]
        return "", format_html_table(("", *titles), cells) + f"<p>{escape(note.strip('()'))}</p>"
    if "loops closed" in note and len(rows[0]) == commands.size > 1:
        numbers = ", ".join(map(" ".join, zip(commands.labels, rows[0], strict=True)))
    return f"{numbers} {note}".rstrip(), ""


def _build_actuator_saturation_table(campaign: Campaign, note: str) -> str:
    """Return the share of the runs' time during which each command is beyond a limit of its actuator."""
    ends = [outcome.time for outcome in campaign.outcomes]
    durations = np.where(np.isnan(ends), campaign.span[1], ends) - campaign.span[0]
    rows = []
    for label, times in zip(campaign.layouts["command"].labels, campaign.saturation_time, strict=True):
        shares = 100.0 * times / durations
        numbers = (f"{value:.3g} %" for value in (*np.quantile(shares, (0.5, 0.95)), shares.max()))
        rows.append((label, *numbers, int(campaign.indices[np.argmax(shares)]) if shares.any() else ""))
    titles = ("command", "median of runs", "95 % of runs", "largest", "in run")
    limited = any(kind == "actuator" for kind, _, _ in campaign.scenario) or np.any(campaign.saturation_time)
    return f"<p>{note}</p>{format_html_table(titles, rows)}" if limited else ""


def _find_time_of_extreme_value(campaign: Campaign, name: str, k: int) -> float:
    """Return the time of the extreme sample of a quantity in a run, or of the run's end."""
    kind, _, quantity = name.rstrip(")").partition("(")
    if kind in ("max", "min") and campaign.sample_times.size:
        samples = campaign.samples[campaign.layouts["quantity"].slice(quantity).start, :, k]
        return float(campaign.sample_times[np.nanargmax(samples if kind == "max" else -samples)])
    end = campaign.outcomes[k].time
    return campaign.span[1] if np.isnan(end) else end


def _build_parameter_dispersion_tables(campaign: Campaign) -> str:
    """Return nominal and drawn values with the distribution of dispersed parameters, and the constant parameters."""
    layout, rows, fixed = campaign.layouts["parameter"], [], []
    laws = {name: text for kind, name, text in campaign.scenario if kind == "dispersion"}
    loop = campaign.compiled_loop
    nominal = np.full(layout.size, np.nan) if loop is None else loop.nominal
    for v in layout.variables:
        values = campaign.parameters[layout.slice(v.name)]
        if np.all(values == values[:, :1]):  # a constant may be infinite
            fixed.append((v.name, ", ".join(f"{value:.6g}" for value in values[:, 0]), v.unit))
            continue
        for label, usual, drawn in zip(v.labels, nominal[layout.slice(v.name)], values, strict=True):
            numbers = (f"{value:.4g}" for value in (drawn.mean(), drawn.std(), drawn.min(), drawn.max()))
            known = "" if np.isnan(usual) else f"{usual:.6g}"
            rows.append((label, known, v.unit, *numbers, laws.get(v.name, "")))
    titles = ("parameter", "nominal", "unit", "drawn mean", "std. dev.", "min", "max", "distribution")
    return format_html_table(titles, rows) + format_html_table(("constant", "value", "unit"), fixed)


def _build_campaign_figures_html(files: Mapping[str, Path], kind: str, captions: Mapping[str, str]) -> str:
    stems = [stem for stem in files if stem.startswith(f"{kind}_")]
    names = {stem: stem.removeprefix(f"{kind}_") for stem in stems}
    figures = "".join(
        embed_svg_figure(files, stem, captions[kind].format(name=names[stem])) for stem in stems
    )
    return f'<div class="columns">{figures}</div>' if kind == "envelope" and figures else figures


def _build_sample_runs_section(campaign: Campaign, view: View, runs: int, rerun: Callable[[int], Run]) -> str:
    from gnc_opt.plot.animated_3d_scene import render_3d_scene_html

    passed = campaign.passed()
    chosen = np.argsort(passed, kind="stable")[:runs]
    simulated, regular = {}, {}
    for k in sorted(chosen, key=lambda k: int(campaign.indices[k])):
        index = int(campaign.indices[k])
        outcome = campaign.outcomes[k]
        word = "passed" if passed[k] else "beyond a limit" if outcome.ok else outcome.status.value
        name = f"run {index}: {word}"
        simulated[name], regular[name] = rerun(index), outcome.ok
    count = "" if len(simulated) == len(campaign) else f"<p>{len(simulated)} of {len(campaign)} runs.</p>"
    return count + render_3d_scene_html(simulated, view, regular=regular)


def _draw_campaign_figures(
    campaign: Campaign, worst: int, runs: int, rerun: Callable[[int], Run]
) -> Iterator[tuple[str, Figure]]:
    """Yield file stem and figure; those of states and controls need the compiled loop, envelopes no re-planning."""
    from gnc_opt.plot import campaign_figures as figures
    from gnc_opt.plot.simulation_run_figure import plot_run

    if campaign.measures:
        yield "distributions", figures.plot_distributions(campaign)
    if campaign.measures and np.any(campaign.parameters != campaign.parameters[:, :1]):
        yield "effects", figures.plot_dispersion_effects(campaign)
    layout: Any = campaign.layouts["error"]
    vectors = [name for name in campaign.measures if name in layout and layout[name].size > 1]
    for name in [name for name in vectors if name in campaign.limits] or vectors:
        yield f"dispersion_{name}", figures.plot_dispersion(campaign, name)
    if campaign.sample_times.size:
        for name in campaign.layouts["quantity"].names:
            yield f"envelope_{name}", figures.plot_envelope(campaign, name)
    if campaign.compiled_loop is not None:
        nominal = campaign.compiled_loop.run(campaign.compiled_loop.nominal, campaign.seed)
        if campaign.compiled_loop.replanner is None:
            some = [rerun(int(i)) for i in campaign.indices[:runs]]
            for kind, figure in figures.plot_run_envelopes(campaign, some, nominal):
                yield f"envelope-{kind}", figure
        run = rerun(worst)
        shown = figures.group_variables_by_figure(run)
        if shown["errors"]:
            yield "errors", plot_run(run, "errors", shown["errors"])
        if shown["states"]:
            yield "states", plot_run(run, "states", shown["states"])
        yield "controls", figures.plot_run_controls(campaign, run, nominal, f"run {worst}")
