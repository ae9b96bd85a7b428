"""Runs on disk: one compressed NumPy archive with a JSON header; floats keep every bit, nothing is pickled."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from gnc_opt.archive import damaged, read_archive, write_archive
from gnc_opt.model.layout import Layout, Variable
from gnc_opt.simulation.outcome import Outcome, RunStatus
from gnc_opt.simulation.run import Run

FORMAT = "gnc_opt run"
VERSION = 1
"""Raise it whenever `Run` changes its fields."""


def save(run: Run, path: str | Path) -> Path:
    """Write a run; return the file written."""
    arrays = {
        f.name: getattr(run, f.name) for f in fields(run) if isinstance(getattr(run, f.name), np.ndarray)
    }
    time = run.outcome.time
    header = {
        "format": FORMAT,
        "version": VERSION,
        "seed": run.seed,
        "integration_error": repr(run.integration_error),
        "outcome": [run.outcome.status.value, run.outcome.what, None if math.isnan(time) else time],
        "layouts": pack_layouts(run.layouts),
    }
    return write_archive(path, header, arrays)


def load(path: str | Path) -> Run:
    """Read a run; see `Run.load`."""
    header, arrays = read_archive(path, FORMAT, VERSION)
    try:
        return _run(header, arrays)
    except Exception as error:  # whatever it is, this header does not describe a run
        raise damaged(path, "run") from error


def _run(header: dict[str, Any], arrays: dict[str, Any]) -> Run:
    status, what, time = header["outcome"]
    optional = {name: arrays.pop(name, None) for name in ("reference", "errors")}
    return Run(
        **arrays,
        **optional,
        seed=header["seed"],
        integration_error=float(header["integration_error"]),
        outcome=Outcome(RunStatus(status), what, math.nan if time is None else float(time)),
        layouts=unpack_layouts(header["layouts"]),
    )


def pack_layouts(layouts: Mapping[str, Layout]) -> dict[str, Any]:
    """Return layouts as JSON can hold them."""
    return {
        kind: [layout.kind, layout.owner, [[v.name, v.size, v.unit] for v in layout.variables]]
        for kind, layout in layouts.items()
    }


def unpack_layouts(packed: Mapping[str, Any]) -> dict[str, Layout]:
    """Return the layouts that `pack_layouts` packed."""
    return {
        kind: Layout(own, tuple(Variable(name, size, unit) for name, size, unit in variables), owner)
        for kind, (own, owner, variables) in packed.items()
    }
