"""Reports: HTML pages and JSON summaries of solutions, runs and campaigns."""

from functools import partial

from gnc_opt.planning.solution.solution_summary import summary
from gnc_opt.renamed_public_names import raise_missing_name_error
from gnc_opt.report.campaign_report import write_campaign_report
from gnc_opt.report.json_summaries import search_dict, summary_dict, write_json
from gnc_opt.report.solution_report_folder import write_report

__all__ = ["search_dict", "summary", "summary_dict", "write_campaign_report", "write_json", "write_report"]

__getattr__ = partial(raise_missing_name_error, __name__)
