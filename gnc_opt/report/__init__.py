"""Reports: the six-line summary, its JSON, the verdict as a table, progress, the report folder, CCSDS messages."""

from gnc_opt.report.ccsds import MessageMetadata, write_aem, write_oem
from gnc_opt.report.flights import write_campaign_report, write_run_report
from gnc_opt.report.report import write_report
from gnc_opt.report.search import search_dict, write_search
from gnc_opt.report.summary import summary
from gnc_opt.report.summary_json import summary_dict, write_json

__all__ = [
    "MessageMetadata",
    "search_dict",
    "summary",
    "summary_dict",
    "write_aem",
    "write_campaign_report",
    "write_json",
    "write_oem",
    "write_report",
    "write_run_report",
    "write_search",
]
