"""Reports: HTML pages and JSON summaries of solutions, runs and campaigns."""

from typing import Any

from gnc_opt.planning.solution.text_summary import summary
from gnc_opt.renamed import check_renamed
from gnc_opt.report.json_output import search_dict, summary_dict, write_json
from gnc_opt.report.simulation_report import write_campaign_report
from gnc_opt.report.solution_report import write_report

__all__ = [
    "search_dict",
    "summary",
    "summary_dict",
    "write_campaign_report",
    "write_json",
    "write_report",
]


def __getattr__(name: str) -> Any:
    """Raise an error that names the replacement of a removed name."""
    check_renamed(__name__, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
