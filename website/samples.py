"""Sample reports: those that the command of the first page and the example of the tracked rendezvous write."""

from __future__ import annotations

import tempfile
from pathlib import Path

import gnc_opt as go
from gnc_opt.problem_files_and_examples import load_problem_file
from gnc_opt.report import write_campaign_report, write_report
from problems.rendezvous_tracking.control import Tracking, plan

_NO_ICON = '<link rel="icon" href="data:,"><title>'
"""Beginning of a title; otherwise browsers ask the server for an icon."""

SOLUTION, CAMPAIGN = "samples/solution.html", "samples/campaign.html"


def reports() -> dict[str, str]:
    """Return the pages of the reports by their place in the site."""
    file = load_problem_file(Path(__file__).parents[1] / "problems" / "rendezvous")
    solution = go.solve(file.module.build(case=1))
    campaign = Tracking(plan(1)).simulate_campaign("TVLQR", 100, seed=1)
    with tempfile.TemporaryDirectory() as folder:
        of_solution = write_report(
            solution,
            go.verify(solution),
            Path(folder) / "solution",
            view=file.view,
            description=file.describe_problem_builder({"case": 1}),
            command="gnc-opt solve problems/rendezvous --set case=1 --report report",
        )
        of_campaign = write_campaign_report(
            campaign, Path(folder) / "campaign", view=file.view, command="mkdocs build", required=0.95
        )
        found = {SOLUTION: of_solution[0], CAMPAIGN: of_campaign[0]}
        return {
            place: page.read_text("utf-8").replace("<title>", _NO_ICON, 1) for place, page in found.items()
        }
