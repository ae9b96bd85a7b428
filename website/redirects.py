"""Pages of version 0.3.0 that have moved: small files at the old addresses that lead to the new ones."""

from __future__ import annotations

from pathlib import Path

from gnc_opt.renamed_public_names import RENAMED_STATUS_WORDS

_SECTIONS = {
    "howto/status": (
        "reference/statuses",
        "",
        "optimal acceptable infeasible unbounded not_a_number iteration_limit interrupted restoration_failed "
        "search_direction_failed step_too_small too_few_degrees_of_freedom invalid_option failed",
    ),
    "howto/refinement": (
        "reference/statuses",
        "refinement-",
        "converged verdict_fails point_limit pass_limit work_limit stalled failed interrupted",
    ),
    "howto/continuation": ("reference/statuses", "continuation-", "complete vanished interrupted"),
    "howto/runs": (
        "reference/outcomes",
        "",
        "ok inaccurate alarm diverged not_finite stopped refused lost",
    ),
}
"""Folder of the old pages: new page, prefix of its anchors, names of the old pages."""

_CONDITIONS = {
    "dynamics": "dynamics propagation",
    "limits": "bounds path_constraints tables",
    "boundary-conditions": "boundary_conditions",
    "cost": "cost stored_numbers",
    "stationarity": "stationarity adjoint_equation transversality hamiltonian parameters",
    "active-set": "control_signs complementarity",
    "minimum-principle": "minimum_principle",
    "kinks": "smoothness",
    "second-order": "second_order legendre_clebsch singular_arcs generalised_legendre_clebsch conjugate_points "
    "normality",
    "switching-times": "strict_switches induced_gradient",
}
"""Section of the page of conditions: names of the old pages in ``howto/conditions``."""

_PAGES = {
    "howto/command_line": "reference/command_line",
    "json_summary": "reference/json_summary",
    "howto/flight_computer": "control/c_code",
    "control": "control/overview",
    "sliding_mode": "control/sliding_mode",
    "estimation": "control/estimation",
    "analysis": "analysis/covariance",
    "gallery/index": "problems",
}
"""Old page: new page."""


def targets() -> dict[str, str]:
    """Return the new address, with its anchor, of each old one; both relative to the root of the site."""
    found = {f"{old}.html": f"{new}.html" for old, new in _PAGES.items()}
    for folder, (page, prefix, names) in _SECTIONS.items():
        for name in names.split():
            found[f"{folder}/{name}.html"] = f"{page}.html#{prefix}{RENAMED_STATUS_WORDS.get(name, name)}"
    for section, names in _CONDITIONS.items():
        for name in names.split():
            found[f"howto/conditions/{name}.html"] = f"reference/conditions.html#{section}"
    return found


def write(site: Path) -> None:
    """Write a page at each old address below the folder of the site."""
    for old, new in targets().items():
        address = "../" * old.count("/") + new
        path = site / old
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(
            f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>Moved</title>\n'
            f'<meta http-equiv="refresh" content="0; url={address}">\n'
            f'</head><body><a href="{address}">This page has moved.</a></body></html>\n',
            encoding="utf-8",
        )
