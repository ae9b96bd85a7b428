"""Report of a campaign: a folder with an HTML page, data and figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gnc_opt.argument_checks import read_integer
from gnc_opt.errors import GncOptError
from gnc_opt.model.variables import list_with_units
from gnc_opt.report.formulas import typeset_names
from gnc_opt.report.html_document import (
    build_document,
    embed_figure,
    format_command,
    format_status,
    make_report_folder,
    read_captions,
    save_figures,
)
from gnc_opt.text_formatting import format_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gnc_opt.plot.vehicle_motion import View
    from gnc_opt.simulation.campaign import Campaign


def write_campaign_report(
    campaign: Campaign,
    directory: str | Path,
    *,
    title: str = "",
    author: str = "",
    view: View | None = None,
    runs: int = 200,
    command: str | None = None,
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

    Returns
    -------
    list of Path
        ``report.html``, ``campaign.npz``, ``campaign.json`` and the figures (SVG).

    Raises
    ------
    GncOptError
        ``directory`` is a file, no run is complete, or a view is given for a campaign without compiled loop.

    Examples
    --------
    >>> from gnc_opt.report import write_campaign_report
    >>> print([file.name for file in write_campaign_report(campaign, "report")][:3])
    ['report.html', 'campaign.npz', 'campaign.json']
    """
    runs = read_integer(runs, "the number of runs to show", 1)
    if not len(campaign):
        raise GncOptError("no run of the campaign is complete: run it longer.")
    folder = make_report_folder(directory)
    motion = "" if view is None else _build_sample_runs_section(campaign, view, runs)
    captions = read_captions("campaign")
    begin, end = campaign.span
    worst, reason = _find_worst_run(campaign)
    captions |= {kind: captions[kind].format(reason) for kind in ("states", "errors")}
    files = save_figures(folder, _draw_campaign_figures(campaign, worst, runs))
    scenario = [row for row in campaign.scenario if row[0] not in ("design", "software")]
    design, versions = ([row[1:] for row in campaign.scenario if row[0] == k] for k in ("design", "software"))
    sections = {
        "Overview": f"<p>These are {len(campaign)} runs from {begin:g} to {end:.6g} s with seed {campaign.seed}. "
        "A run passes if it ends without failure and every measure is within its limit.</p>"
        + _build_results_table(campaign)
        + embed_figure(files, "distributions", captions["distributions"]),
        "Scenario": format_table(("part", "name", "description"), scenario),
        "Controller": _describe_controller(campaign, design, captions)
        + format_table(("quantity", "value"), design),
        "Final errors": _build_figures_html_by_prefix(files, "dispersion", captions),
        "Envelopes": _build_figures_html_by_prefix(files, "envelope", captions)
        + "".join(
            embed_figure(files, f"envelope-{k}", captions[f"{k} over time"].format(min(runs, len(campaign))))
            for k in ("errors", "states")
        )
        + embed_figure(files, "envelope-controls", captions["control envelopes"]),
        f"Worst run: {worst}": "".join(
            embed_figure(files, k, captions[k]) for k in ("errors", "states", "controls")
        ),
        "Failures": format_table(("run", "cause"), campaign.failures.items()),
        "Parameters": _build_drawn_parameters_table(campaign),
    }
    names = {name for layout in campaign.layouts.values() for name in layout.names}
    sections = {name: typeset_names(body, names) for name, body in sections.items()}
    sections["Motion"] = motion
    data = [("runs", len(campaign)), ("seed", campaign.seed), ("fingerprint", campaign.fingerprint)]
    sections["Software"] = format_command(command) + format_table(("", ""), [*data, *versions])
    passed = campaign.pass_rate()
    tone = "good" if passed.passed == len(campaign) else "open"
    headline = (
        format_status(f"{passed.passed} of {len(campaign)} passed", tone)
        + f"The pass rate is {passed} with 95 % confidence."
    )
    statistics = folder / "campaign.json"
    campaign.to_json(statistics)
    page = folder / "report.html"
    plant = next((f": {name}" for kind, name, _ in campaign.scenario if kind == "plant"), "")
    page.write_text(build_document(title or f"campaign{plant}", headline, sections, author), encoding="utf-8")
    return [page, campaign.save(folder / "campaign.npz"), statistics, *files.values()]


def _find_worst_run(campaign: Campaign) -> tuple[int, str]:
    """Return the run with the largest value of a measure relative to its limit, and the reason for it.

    Without limits it is the run with the largest value of the first measure.
    """
    shares = {name: campaign.maximum(name) / limit for name, limit in campaign.limits.items() if limit > 0.0}
    failed, measures = campaign.failures, [*campaign.limits, *campaign.measures]
    name = max(shares, key=shares.__getitem__) if shares else measures[0] if measures else ""
    run = campaign.worst(name, 1)[0] if name else int(campaign.indices[0])
    reason = f"largest {campaign.describe_measure(name)}" if name else "first run"
    if name in shares:
        share = f"{campaign.describe_measure(name)}, {100 * shares[name]:.3g} % of the limit"
        reason = f"largest value relative to its limit: {share}"
    reason = "failed" if run in failed else reason
    beyond = len(campaign) - len(failed) - int(np.sum(campaign.passed()))
    counts = f"of {len(campaign)} runs {len(failed)} failed and {beyond} exceeded a limit"
    return run, f"run {run}: {reason}; {counts}"


def _describe_controller(
    campaign: Campaign, design: Iterable[Sequence[str]], captions: Mapping[str, str]
) -> str:
    """Return control step, reference, rows and columns of the gain, and the meaning of symbols in the table."""
    words = {word for name, _ in design for word in name.split()}
    notes = [f"{name}, {step}." for kind, name, step in campaign.scenario if kind == "controller"]
    if words & {"K", "gain"}:
        commands, errors = (campaign.layouts[kind].variables for kind in ("command", "error"))
        followed = () if campaign.flight is None else campaign.flight.followed.names
        columns = list_with_units(v for v in errors if v.name in followed)
        notes.append(captions["gain"].format(list_with_units(commands), columns or "the states"))
    return f"<p>{escape(' '.join(notes))}</p>" if words else ""


def _build_results_table(campaign: Campaign) -> str:
    from gnc_opt.simulation.campaign_tables import build_campaign_rows, list_campaign_notes

    titles, *rows = build_campaign_rows(campaign)
    notes = "".join(f"<p>{escape(note)}</p>" for note in list_campaign_notes(campaign))
    return format_table(titles, rows) + notes


def _build_drawn_parameters_table(campaign: Campaign) -> str:
    """Return nominal value, distribution and drawn values of the parameters; constant parameters last."""
    layout, rows = campaign.layouts["parameter"], []
    drawn_from = {name: text for kind, name, text in campaign.scenario if kind == "dispersion"}
    nominal = np.full(layout.size, np.nan) if campaign.flight is None else campaign.flight.nominal
    for i, (label, unit, drawn) in enumerate(
        zip(layout.labels, layout.units, campaign.parameters, strict=True)
    ):
        varies = bool(np.any(drawn != drawn[0]))  # a constant may be infinite
        usual = nominal[i] if varies else drawn[0]
        spread = [f"{f(drawn):.4g}" for f in (np.mean, np.std, np.min, np.max)] if varies else 4 * [""]
        name = label.partition("[")[0]
        law = drawn_from.get(name, "") if varies else "fixed"
        rows.append((not varies, (label, "" if np.isnan(usual) else f"{usual:.6g}", unit, law, *spread)))
    titles = ("parameter", "nominal", "unit", "distribution", "drawn mean", "std", "min", "max")
    return format_table(titles, [row for _, row in sorted(rows, key=lambda row: row[0])])


def _build_figures_html_by_prefix(files: Mapping[str, Path], kind: str, captions: Mapping[str, str]) -> str:
    stems = [stem for stem in files if stem.startswith(f"{kind}_")]
    figures = "".join(embed_figure(files, stem, captions[kind]) for stem in stems)
    return f'<div class="columns">{figures}</div>' if kind == "envelope" and figures else figures


def _build_sample_runs_section(campaign: Campaign, view: View, runs: int) -> str:
    from gnc_opt.plot.animated_3d_scene import render_scene

    passed = campaign.passed()
    chosen = np.argsort(passed, kind="stable")[:runs]
    flown, regular = {}, {}
    for k in sorted(chosen, key=lambda k: int(campaign.indices[k])):
        index = int(campaign.indices[k])
        outcome = campaign.outcomes[k]
        word = "passed" if passed[k] else "beyond a limit" if outcome.ok else outcome.status.value
        name = f"run {index}: {word}"
        flown[name], regular[name] = campaign.rerun(index), outcome.ok
    count = "" if len(flown) == len(campaign) else f"<p>{len(flown)} of {len(campaign)} runs.</p>"
    return count + render_scene(flown, view, regular=regular)


def _draw_campaign_figures(campaign: Campaign, worst: int, runs: int) -> Iterator[tuple[str, Figure]]:
    """Yield file stem and figure; those of states and controls need the compiled loop, envelopes no re-planning."""
    from gnc_opt.plot import campaign as figures
    from gnc_opt.plot.simulation_run import plot_run

    if campaign.measures:
        yield "distributions", figures.plot_distributions(campaign)
    for name in campaign.measures:
        layout: Any = campaign.layouts["error"]
        if name in layout and layout[name].size > 1:
            yield f"dispersion_{name}", figures.plot_dispersion(campaign, name)
    if campaign.sample_times.size:
        for name in campaign.layouts["quantity"].names:
            yield f"envelope_{name}", figures.plot_envelope(campaign, name)
    if campaign.flight is not None:
        if campaign.flight.replanner is None:
            nominal = campaign.flight.run(campaign.flight.nominal, campaign.seed)
            some = [campaign.rerun(int(i)) for i in campaign.indices[:runs]]
            for kind, figure in figures.plot_run_envelopes(campaign, some, nominal):
                yield f"envelope-{kind}", figure
        run = campaign.rerun(worst)
        shown = figures.list_shown_variables(run)
        if shown["errors"]:
            yield "errors", figures.plot_run_errors(campaign, run, shown["errors"])
        if shown["states"]:
            yield "states", plot_run(run, "states", shown["states"])
        yield "controls", plot_run(run, "controls")
