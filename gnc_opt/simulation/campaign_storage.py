"""Campaigns on disk: one compressed NumPy archive with a JSON header; floats keep every bit, nothing is pickled."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from gnc_opt.errors import GncOptError
from gnc_opt.model.layout import Layout, Variable
from gnc_opt.simulation.campaign import Campaign
from gnc_opt.simulation.flight import Flight
from gnc_opt.simulation.outcome import Outcome, RunStatus
from gnc_opt.solution.storage import _write as write_archive

FORMAT = "gnc_opt campaign"
VERSION = 1
"""Raise it whenever `Campaign` changes its fields."""


def save(campaign: Campaign, path: str | Path) -> Path:
    """Write a campaign; return the file written."""
    target = Path(path)
    target = target if target.suffix else target.with_suffix(".npz")
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
        "layouts": {
            kind: [layout.kind, layout.owner, [[v.name, v.size, v.unit] for v in layout.variables]]
            for kind, layout in campaign.layouts.items()
        },
    }
    write_archive(target, {"header": np.array(json.dumps(header, allow_nan=False)), **arrays})
    return target


def load(path: str | Path, flight: Flight | None) -> Campaign:
    """Read a campaign; see `Campaign.load`."""
    with Path(path).open("rb") as stream:
        try:
            with np.load(stream, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
            header = json.loads(str(arrays.pop("header")))
            if header["format"] != FORMAT:
                raise ValueError("another format")
        except Exception as error:  # zipfile, zlib, NumPy and JSON each have their own
            raise GncOptError(
                f"'{path}' is not a campaign of gnc_opt, or a damaged one: save it again."
            ) from error
    if header.get("version") != VERSION:
        raise GncOptError(
            f"'{path}' has format version {header.get('version')}, but this gnc_opt reads version {VERSION}: "
            "load it with the version that wrote it."
        )
    try:
        campaign = _campaign(header, arrays)
    except Exception as error:  # whatever it is, this header does not describe a campaign
        raise GncOptError(
            f"'{path}' is damaged: its content does not make up a campaign; save it again."
        ) from error
    if flight is not None and flight.layout.labels != campaign.layouts["parameter"].labels:
        raise GncOptError(
            f"the campaign of '{path}' flew another loop than the given flight: its parameters have other names."
        )
    return replace(campaign, flight=flight)


def _campaign(header: dict[str, Any], arrays: dict[str, Any]) -> Campaign:
    measured = {name: arrays.pop(f"measured {i}") for i, name in enumerate(header["measured"])}
    layouts = {
        kind: Layout(entry[0], tuple(Variable(n, size, unit) for n, size, unit in entry[2]), entry[1])
        for kind, entry in header["layouts"].items()
    }
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
        layouts=layouts,
    )
