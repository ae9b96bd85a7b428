"""Runs and campaigns in files of version 1, whose headers listed their contents by hand."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from gnc_opt.archive import Arrays
from gnc_opt.model.variables import Layout, Variable
from gnc_opt.simulation.outcome import Outcome, RunStatus


def run_fields(header: dict[str, Any], arrays: Arrays) -> dict[str, Any]:
    """Return the fields of a `Run`."""
    return {
        "reference": None,
        "errors": None,
        **arrays,
        "seed": header["seed"],
        "integration_error": float(header["integration_error"]),
        "outcome": _outcome(header["outcome"]),
        "layouts": _layouts(header["layouts"]),
    }


def campaign_fields(header: dict[str, Any], arrays: Arrays) -> dict[str, Any]:
    """Return the fields of a `Campaign`."""
    measured = {name: arrays.pop(f"measured {i}") for i, name in enumerate(header["measured"])}
    first, last = header["span"]
    return {
        **arrays,
        **{name: header[name] for name in ("seed", "asked", "limits", "interrupted")},
        "span": (first, last),
        "measured": measured,
        "outcomes": tuple(_outcome(packed) for packed in header["outcomes"]),
        "layouts": _layouts(header["layouts"]),
    }


def _outcome(packed: Sequence[Any]) -> Outcome:
    status, what, time = packed
    return Outcome(RunStatus(status), what, math.nan if time is None else float(time))


def _layouts(packed: Mapping[str, Any]) -> dict[str, Layout]:
    return {
        kind: Layout(own, tuple(Variable(name, size, unit) for name, size, unit in variables), owner)
        for kind, (own, owner, variables) in packed.items()
    }
