"""Campaigns on disk: one compressed NumPy archive with a JSON header; floats keep every bit, nothing is pickled."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from gnc_opt.archive import damaged, read_archive, write_archive
from gnc_opt.errors import GncOptError
from gnc_opt.simulation.campaign import Campaign
from gnc_opt.simulation.flight import Flight
from gnc_opt.simulation.outcome import Outcome, RunStatus
from gnc_opt.simulation.storage import pack_layouts, unpack_layouts

FORMAT = "gnc_opt campaign"
VERSION = 1
"""Raise it whenever `Campaign` changes its fields."""


def save(campaign: Campaign, path: str | Path) -> Path:
    """Write a campaign; return the file written."""
    values = {f.name: getattr(campaign, f.name) for f in fields(campaign)}
    arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    arrays |= {f"measured {i}": values for i, values in enumerate(campaign.measured.values())}
    header = {
        "format": FORMAT,
        "version": VERSION,
        "seed": campaign.seed,
        "asked": campaign.asked,
        "span": list(campaign.span),
        "limits": dict(campaign.limits),
        "measured": list(campaign.measured),
        "interrupted": campaign.interrupted,
        "outcomes": [
            [o.status.value, o.what, o.time if o.time == o.time else None] for o in campaign.outcomes
        ],
        "layouts": pack_layouts(campaign.layouts),
    }
    return write_archive(path, header, arrays)


def load(path: str | Path, flight: Flight | None) -> Campaign:
    """Read a campaign; see `Campaign.load`."""
    header, arrays = read_archive(path, FORMAT, VERSION)
    try:
        campaign = _campaign(header, arrays)
    except Exception as error:  # whatever it is, this header does not describe a campaign
        raise damaged(path, "campaign") from error
    if flight is not None and flight.layout.labels != campaign.layouts["parameter"].labels:
        raise GncOptError(
            f"the campaign of '{path}' flew another loop than the given flight: its parameters have other names."
        )
    return replace(campaign, flight=flight)


def _campaign(header: dict[str, Any], arrays: dict[str, Any]) -> Campaign:
    measured = {name: arrays.pop(f"measured {i}") for i, name in enumerate(header["measured"])}
    outcomes = [
        Outcome(RunStatus(status), what, float("nan") if time is None else float(time))
        for status, what, time in header["outcomes"]
    ]
    return Campaign(
        **arrays,
        seed=header["seed"],
        asked=header["asked"],
        span=(header["span"][0], header["span"][1]),
        limits=header["limits"],
        measured=measured,
        interrupted=header["interrupted"],
        outcomes=tuple(outcomes),
        layouts=unpack_layouts(header["layouts"]),
    )
