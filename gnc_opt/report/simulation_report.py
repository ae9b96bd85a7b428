"""Report of a campaign: a folder with an HTML page, data and figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gnc_opt.argument_checks import read_integer
from gnc_opt.errors import GncOptError
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
    (begin, end), measures = campaign.span, [*campaign.limits, *campaign.measures]
    worst = campaign.worst(measures[0], 1)[0] if measures else int(campaign.indices[0])
    captions["states"] = captions["states"].format(_describe_worst_run(campaign, worst, *measures[:1]))
    files = save_figures(folder, _draw_campaign_figures(campaign, worst, runs))
    scenario = [row for row in campaign.scenario if row[0] not in ("design", "software")]
    design, versions = ([row[1:] for row in campaign.scenario if row[0] == k] for k in ("design", "software"))
    sections = {
        "Overview": f"<p>These are {len(campaign)} runs from {begin:g} to {end:.6g} s with seed {campaign.seed}.</p>"
        + _build_results_table(campaign)
        + embed_figure(files, "distributions", captions["distributions"]),
        "Scenario": format_table(("part", "name", "description"), scenario),
        "Controller": format_table(("quantity", "value"), design),
        "Dispersions": _build_figures_html_by_prefix(files, "dispersion", captions),
        "Envelopes": _build_figures_html_by_prefix(files, "envelope", captions)
        + embed_figure(files, "envelope-states", captions["envelopes"].format(min(runs, len(campaign))))
        + embed_figure(files, "envelope-controls", captions["control envelopes"]),
        f"Worst run: {worst}": "".join(embed_figure(files, k, captions[k]) for k in ("states", "controls")),
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


def _describe_worst_run(campaign: Campaign, run: int, measure: str = "") -> str:
    """Return "run 62: largest final error of q; no run failed"."""
    failed, kind = campaign.failures, "final error" if measure in campaign.layouts["error"] else "value"
    reason = "failed" if run in failed else f"largest {kind} of {measure}" if measure else "first run"
    return f"run {run}: {reason}; {f'{len(failed)} of {len(campaign)} runs' if failed else 'no run'} failed"


def _build_results_table(campaign: Campaign) -> str:
    from gnc_opt.simulation.campaign_tables import build_campaign_rows, list_campaign_notes

    titles, *rows = build_campaign_rows(campaign)
    notes = "".join(f"<p>{escape(note)}</p>" for note in list_campaign_notes(campaign))
    return format_table((titles[0], "unit", *titles[2:]), rows) + notes


def _build_drawn_parameters_table(campaign: Campaign) -> str:
    """Return nominal value, distribution and drawn values of the parameters; constant parameters last."""
    layout, rows = campaign.layouts["parameter"], []
    drawn_from = {name: text for kind, name, text in campaign.scenario if kind == "dispersion"}
    nominal = np.full(layout.size, np.nan) if campaign.flight is None else campaign.flight.nominal
    for i, (label, unit, drawn) in enumerate(
        zip(layout.labels, layout.units, campaign.parameters, strict=True)
    ):
        varies = float(np.ptp(drawn)) > 0.0
        usual = nominal[i] if varies else drawn[0]
        spread = [f"{f(drawn):.4g}" for f in (np.mean, np.std, np.min, np.max)] if varies else 4 * [""]
        law = drawn_from.get(label.partition("[")[0], "") if varies else "fixed"
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
    from gnc_opt.plot.campaign import plot_dispersion, plot_distributions, plot_envelope, plot_run_envelopes
    from gnc_opt.plot.simulation_run import plot_run

    if campaign.measures:
        yield "distributions", plot_distributions(campaign)
    for name in campaign.measures:
        layout: Any = campaign.layouts["error"]
        if name in layout and layout[name].size > 1:
            yield f"dispersion_{name}", plot_dispersion(campaign, name)
    if campaign.sample_times.size:
        for name in campaign.layouts["quantity"].names:
            yield f"envelope_{name}", plot_envelope(campaign, name)
    if campaign.flight is not None:
        if campaign.flight.replanner is None:
            nominal = campaign.flight.run(campaign.flight.nominal, campaign.seed)
            some = [campaign.rerun(int(i)) for i in campaign.indices[:runs]]
            for kind, figure in plot_run_envelopes(campaign, some, nominal):
                yield f"envelope-{kind}", figure
        run = campaign.rerun(worst)
        yield "states", plot_run(run)
        yield "controls", plot_run(run, "controls")
