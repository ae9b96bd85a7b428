"""Runs on disk: one compressed NumPy archive with a JSON header; floats keep every bit, nothing is pickled."""

from __future__ import annotations

import json
import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from gnc_opt.errors import GncOptError
from gnc_opt.model.layout import Layout, Variable
from gnc_opt.simulation.outcome import Outcome, RunStatus
from gnc_opt.simulation.run import Run
from gnc_opt.solution.storage import _write as write_archive

FORMAT = "gnc_opt run"
VERSION = 1
"""Raise it whenever `Run` changes its fields."""


def save(run: Run, path: str | Path) -> Path:
    """Write a run; return the file written."""
    target = Path(path)
    target = target if target.suffix else target.with_suffix(".npz")
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
        "layouts": {
            kind: [layout.kind, layout.owner, [[v.name, v.size, v.unit] for v in layout.variables]]
            for kind, layout in run.layouts.items()
        },
    }
    write_archive(target, {"header": np.array(json.dumps(header, allow_nan=False)), **arrays})
    return target


def load(path: str | Path) -> Run:
    """Read a run; see `Run.load`."""
    with Path(path).open("rb") as stream:
        try:
            with np.load(stream, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
            header = json.loads(str(arrays.pop("header")))
            if header["format"] != FORMAT:
                raise ValueError("another format")
        except Exception as error:  # zipfile, zlib, NumPy and JSON each have their own
            raise GncOptError(
                f"'{path}' is not a run of gnc_opt, or a damaged one: save it again."
            ) from error
    if header.get("version") != VERSION:
        raise GncOptError(
            f"'{path}' has format version {header.get('version')}, but this gnc_opt reads version {VERSION}: "
            "load it with the version that wrote it."
        )
    try:
        return _run(header, arrays)
    except Exception as error:  # whatever it is, this header does not describe a run
        raise GncOptError(
            f"'{path}' is damaged: its content does not make up a run; save it again."
        ) from error


def _run(header: dict[str, Any], arrays: dict[str, Any]) -> Run:
    status, what, time = header["outcome"]
    layouts = {
        kind: Layout(entry[0], tuple(Variable(n, size, unit) for n, size, unit in entry[2]), entry[1])
        for kind, entry in header["layouts"].items()
    }
    optional = {name: arrays.pop(name, None) for name in ("reference", "errors")}
    return Run(
        **arrays,
        **optional,
        seed=header["seed"],
        integration_error=float(header["integration_error"]),
        outcome=Outcome(RunStatus(status), what, math.nan if time is None else float(time)),
        layouts=layouts,
    )
