"""Reports of simulations: a folder with an HTML page on a run or a campaign."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gnc_opt.argument_checks import read_integer
from gnc_opt.errors import GncOptError
from gnc_opt.report.html_document import (
    command_html,
    figure_html,
    html_document,
    make_report_folder,
    save_figures,
    status_label_html,
    write_page,
)
from gnc_opt.text_formatting import html_preformatted, html_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gnc_opt.plot.motion_samples import View
    from gnc_opt.simulation.campaign import Campaign
    from gnc_opt.simulation.simulation_run import Run


CAMPAIGN_CAPTIONS = {
    "distributions": (
        "Share of the runs below each value. Dots: percentiles, with their 95 % confidence intervals. A limit (dashed) "
        "that is far from all runs is not drawn; the table has its value."
    ),
    "dispersion": "final errors of all runs, by pairs of components. Within the circle, they meet the limit.",
    "envelope": "1st, 50th and 99th percentile of all runs over time; shaded: their 95 % confidence intervals.",
}
"""Captions of the figures of a campaign, by kind."""


def write_run_report(
    run: Run,
    directory: str | Path,
    *,
    title: str = "run",
    view: View | None = None,
    command: str | None = None,
) -> list[Path]:
    """Write an HTML page on a closed-loop run, the run and its figures to a folder.

    Parameters
    ----------
    run : Run
    directory : str or Path
        Output folder; created if missing. Files of an earlier report are replaced.
    title : str
    view : gnc_opt.plot.View, optional
        View for the 3-D motion, as in `write_report`.
    command : str, optional
        Command that reproduces the report, printed on the page.

    Returns
    -------
    list of Path
        ``report.html``, ``run.npz`` and the figures (SVG).

    Examples
    --------
    >>> from gnc_opt.report import write_run_report
    >>> print([file.name for file in write_run_report(run, "report")][:2])
    ['report.html', 'run.npz']
    """
    from gnc_opt.plot.motion_scene import scene_html
    from gnc_opt.report.solution_page import CAPTIONS

    folder = make_report_folder(directory)
    motion = "" if view is None else scene_html({title: run}, view)
    files = save_figures(folder, lambda: _draw_run_figures(run, view))
    sections = {
        "Overview": figure_html(files, "trajectory", CAPTIONS["trajectory"]) + html_preformatted(str(run)),
        "Motion": motion,
        "States": figure_html(files, "states", "States of the plant over time."),
        "Controls": figure_html(files, "controls", "Commands and applied controls over time."),
        "Errors": figure_html(files, "errors", "Errors of the states relative to the reference over time."),
        "Parameters": html_table(
            ("parameter", "value", "unit"),
            zip(
                run.layouts["parameter"].labels,
                (f"{v:.9g}" for v in run.parameters),
                run.layouts["parameter"].units,
                strict=True,
            ),
        ),
        "Software": command_html(command) + html_table(("", ""), [("seed", run.seed)]),
    }
    headline = status_label_html(str(run.outcome), "good" if run.outcome.ok else "bad")
    page = write_page(folder, html_document(title, headline, sections))
    return [page, run.save(folder / "run.npz"), *files.values()]


def write_campaign_report(
    campaign: Campaign,
    directory: str | Path,
    *,
    title: str = "campaign",
    view: View | None = None,
    runs: int = 200,
    command: str | None = None,
) -> list[Path]:
    """Write an HTML page on a campaign, the campaign, its statistics as JSON and its figures to a folder.

    Parameters
    ----------
    campaign : Campaign
    directory, title, view, command
        As in `write_run_report`; the motion is shown for several runs, which are simulated again.
    runs : int
        Largest number of runs shown in motion; runs that did not pass come first.

    Returns
    -------
    list of Path
        ``report.html``, ``campaign.npz``, ``campaign.json`` and the figures (SVG).

    Raises
    ------
    GncOptError
        ``directory`` is a file, no run is complete, or a view is given for a campaign without compiled loop.
    ArgumentError
        ``runs`` is not a positive integer.

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
    motion = "" if view is None else _sample_runs_section(campaign, view, runs)
    files = save_figures(folder, lambda: _draw_campaign_figures(campaign))
    failures = [(index, str(outcome)) for index, outcome in campaign.failures.items()]
    sections = {
        "Overview": _results_table(campaign)
        + figure_html(files, "distributions", CAMPAIGN_CAPTIONS["distributions"]),
        "Motion": motion,
        "Dispersions": _figures_html_by_prefix(files, "dispersion_", CAMPAIGN_CAPTIONS["dispersion"]),
        "Envelopes": _figures_html_by_prefix(files, "envelope_", CAMPAIGN_CAPTIONS["envelope"]),
        "Failures": html_table(("run", "cause"), failures),
        "Parameters": _drawn_parameters_table(campaign),
        "Software": command_html(command)
        + html_table(("", ""), [("seed", campaign.seed), ("fingerprint", campaign.fingerprint)]),
    }
    passed = campaign.pass_rate()
    tone = "good" if passed.passed == len(campaign) else "open"
    headline = (
        status_label_html(f"{passed.passed} of {len(campaign)} passed", tone)
        + f"pass rate {passed}, 95 % confidence"
    )
    statistics = folder / "campaign.json"
    campaign.to_json(statistics)
    saved = campaign.save(folder / "campaign.npz")
    page = write_page(folder, html_document(title, headline, sections))
    return [page, saved, statistics, *files.values()]


def _results_table(campaign: Campaign) -> str:
    from gnc_opt.simulation.campaign_tables import build_campaign_rows, list_campaign_notes

    titles, *rows = build_campaign_rows(campaign)
    notes = "".join(f"<p>{escape(note)}</p>" for note in list_campaign_notes(campaign))
    return html_table((titles[0], "unit", *titles[2:]), rows) + notes


def _drawn_parameters_table(campaign: Campaign) -> str:
    """Return mean, standard deviation and range of the parameters over the runs; constant parameters last."""
    layout, rows = campaign.layouts["parameter"], []
    for label, unit, drawn in zip(layout.labels, layout.units, campaign.parameters, strict=True):
        varies = float(np.ptp(drawn)) > 0.0
        spread = [f"{f(drawn):.4g}" for f in (np.std, np.min, np.max)] if varies else ["fixed", "", ""]
        rows.append((not varies, (label, f"{np.mean(drawn):.6g}", *spread, unit)))
    titles = ("parameter", "mean", "standard deviation", "smallest", "largest", "unit")
    return html_table(titles, [row for _, row in sorted(rows, key=lambda row: row[0])])


def _figures_html_by_prefix(files: Mapping[str, Path], prefix: str, caption: str) -> str:
    stems = [stem for stem in files if stem.startswith(prefix)]
    return "".join(figure_html(files, stem, f"{stem.removeprefix(prefix)}: {caption}") for stem in stems)


# --- motion -----------------------------------------------------------------------------------------------


def _sample_runs_section(campaign: Campaign, view: View, runs: int) -> str:
    from gnc_opt.plot.motion_scene import scene_html

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
    return count + scene_html(flown, view, regular=regular)


# --- figures ----------------------------------------------------------------------------------------------


def _draw_run_figures(run: Run, view: View | None) -> Iterator[tuple[str, Figure]]:
    from gnc_opt.plot.motion_path import plot_motion
    from gnc_opt.plot.simulation_run import plot_run

    if view is not None and view.position is not None:
        yield "trajectory", plot_motion(run, view)
    yield "states", plot_run(run)
    yield "controls", plot_run(run, "controls")
    if run.errors is not None:
        yield "errors", plot_run(run, "errors")


def _draw_campaign_figures(campaign: Campaign) -> Iterator[tuple[str, Figure]]:
    from gnc_opt.plot.campaign import plot_dispersion, plot_distributions, plot_envelope

    if campaign.measures:
        yield "distributions", plot_distributions(campaign)
    for name in campaign.measures:
        layout: Any = campaign.layouts["error"]
        if name in layout and layout[name].size > 1:
            yield f"dispersion_{name}", plot_dispersion(campaign, name)
    if campaign.sample_times.size:
        for name in campaign.layouts["quantity"].names:
            yield f"envelope_{name}", plot_envelope(campaign, name)
