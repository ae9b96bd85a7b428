"""Reports of what flew: a folder with one page about a run, or about a campaign and any of its runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gnc_opt.arguments import read_integer
from gnc_opt.errors import GncOptError
from gnc_opt.report.page import again, chip, document, pictures, report_folder, save_figures
from gnc_opt.text import preformatted, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gnc_opt.plot.view import View
    from gnc_opt.simulation.campaign import Campaign
    from gnc_opt.simulation.run import Run


def write_run_report(
    run: Run,
    directory: str | Path,
    *,
    title: str = "run",
    view: View | None = None,
    command: str | None = None,
) -> list[Path]:
    """Write one page about a run of a closed loop, the run itself and its figures into a folder.

    Parameters
    ----------
    run : Run
    directory : str or Path
        Made if it does not exist. Files of an earlier report are replaced.
    title : str
        Of the page.
    view : gnc_opt.plot.View, optional
        What of the motion is shown in three dimensions, as in `write_report`.
    command : str, optional
        How to get this report again, for the page.

    Returns
    -------
    list of Path
        ``report.html``, ``run.npz`` and the figures (SVG).

    Raises
    ------
    GncOptError
        ``directory`` is a file.

    Examples
    --------
    >>> from gnc_opt.report import write_run_report
    >>> print([file.name for file in write_run_report(run, "report")][:2])
    ['report.html', 'run.npz']
    """
    folder = report_folder(directory)
    motion = "" if view is None else _scene({title: run}, view)
    files = save_figures(folder, _run_figures(run))
    sections = {
        "Answer": preformatted(str(run)),
        "Motion": motion,
        "Figures": pictures(files),
        "Parameters": table(
            ("", "value"),
            zip(run.layouts["parameter"].labels, (f"{v:.9g}" for v in run.parameters), strict=True),
        ),
        "Provenance": again(command) + table(("", ""), [("seed", run.seed)]),
    }
    headline = chip(str(run.outcome), "good" if run.outcome.ok else "bad")
    return [_written(folder, document(title, headline, sections)), run.save(folder / "run.npz"), *files]


def write_campaign_report(
    campaign: Campaign,
    directory: str | Path,
    *,
    title: str = "campaign",
    view: View | None = None,
    runs: int = 200,
    command: str | None = None,
) -> list[Path]:
    """Write one page about a campaign, the campaign itself, its statistics as JSON and its figures into a folder.

    Parameters
    ----------
    campaign : Campaign
    directory : str or Path
        Made if it does not exist. Files of an earlier report are replaced.
    title : str
        Of the page.
    view : gnc_opt.plot.View, optional
        What is shown in three dimensions, as in `write_report`: any of the runs, flown again for it, all their
        paths, and the tube that holds 95 % of them. It needs a campaign that can fly (see `Campaign.rerun`).
    runs : int
        At most so many are shown there: those that did not pass first, then the others in the order of their numbers.
    command : str, optional
        How to get this report again, for the page.

    Returns
    -------
    list of Path
        ``report.html``, ``campaign.npz``, ``campaign.json`` and the figures (SVG).

    Raises
    ------
    GncOptError
        ``directory`` is a file, no run has ended, or a view of a campaign that cannot fly.
    ArgumentError
        ``runs`` is no positive number.

    Examples
    --------
    >>> from gnc_opt.report import write_campaign_report
    >>> print([file.name for file in write_campaign_report(campaign, "report")][:3])
    ['report.html', 'campaign.npz', 'campaign.json']
    """
    runs = read_integer(runs, "the number of runs to show", 1)
    if not len(campaign):
        raise GncOptError("no run of the campaign has ended: there is nothing to report.")
    folder = report_folder(directory)
    motion = "" if view is None else _any_run(campaign, view, runs)
    files = save_figures(folder, _campaign_figures(campaign))
    failures = [(index, str(outcome)) for index, outcome in campaign.failures.items()]
    sections = {
        "Answer": preformatted(str(campaign)),
        "Motion": motion,
        "Figures": pictures(files),
        "Failures": table(("run", "what went wrong"), failures),
        "Provenance": again(command)
        + table(("", ""), [("seed", campaign.seed), ("fingerprint", campaign.fingerprint)]),
    }
    passed = campaign.pass_rate()
    headline = chip(
        f"{passed.passed} of {len(campaign)} passed", "good" if passed.passed == len(campaign) else "open"
    )
    statistics = folder / "campaign.json"
    campaign.to_json(statistics)
    saved = campaign.save(folder / "campaign.npz")
    return [_written(folder, document(title, headline, sections)), saved, statistics, *files]


# --- motion -----------------------------------------------------------------------------------------------


def _scene(shown: dict[str, Run], view: View, regular: dict[str, bool] | None = None) -> str:
    from gnc_opt.plot.scene import scene_html

    return scene_html(shown, view, regular=regular)


def _any_run(campaign: Campaign, view: View, runs: int) -> str:
    passed = campaign.passed()
    chosen = np.argsort(passed, kind="stable")[:runs]
    flown, regular = {}, {}
    for k in sorted(chosen, key=lambda k: int(campaign.indices[k])):
        index = int(campaign.indices[k])
        outcome = campaign.outcomes[k]
        word = "passed" if passed[k] else "beyond a limit" if outcome.ok else outcome.status.value
        name = f"run {index}: {word}"
        flown[name], regular[name] = campaign.rerun(index), outcome.ok
    told = "" if len(flown) == len(campaign) else f"<p>{len(flown)} of {len(campaign)} runs.</p>"
    return told + _scene(flown, view, regular)


# --- figures ----------------------------------------------------------------------------------------------


def _run_figures(run: Run) -> Iterator[tuple[str, Figure]]:
    from gnc_opt.plot.run import plot_run_controls, plot_run_errors, plot_run_states

    yield "states", plot_run_states(run)
    yield "controls", plot_run_controls(run)
    if run.errors is not None:
        yield "errors", plot_run_errors(run)


def _campaign_figures(campaign: Campaign) -> Iterator[tuple[str, Figure]]:
    from gnc_opt.plot.campaign import plot_dispersion, plot_distributions

    if campaign.measures:
        yield "distributions", plot_distributions(campaign)
    for name in campaign.measures:
        layout: Any = campaign.layouts["error"]
        if name in layout and layout[name].size > 1:
            yield f"dispersion_{name}", plot_dispersion(campaign, name)


def _written(folder: Path, text: str) -> Path:
    told = folder / "report.html"
    told.write_text(text, encoding="utf-8")
    return told
