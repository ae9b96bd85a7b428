"""Animated 3-D scene in an HTML page: vehicle, path and plume, with a time slider.

Plotly (extra ``report``) draws it; the page works offline.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.errors import GncOptError
from gnc_opt.plot.vehicle_motion_sampling import (
    AXIS,
    PLUME,
    VEHICLE_HALF_EDGES,
    MotionSamples,
    Moved,
    View,
    get_motion_time_span,
    sample_ellipsoid_surface,
    sample_vehicle_motion,
)
from gnc_opt.threads_and_package_versions import import_optional_package

_INSTANTS = (41, 241)
"""Smallest and largest number of instants of a motion."""
_SCENE_MAX_SAMPLES = 60_000
"""Number of instants of all motions together; a page with 1000 runs stays below 5 MB."""
_DIGITS = 4
"""Resolution of positions relative to the extent of the scene, and of axes and forces relative to a unit vector."""


def render_3d_scene_html(
    shown: Mapping[str, Moved], view: View, *, regular: Mapping[str, bool] | None = None
) -> str:
    """Return the scene as an HTML element, at most once per page; without Plotly, a line with the install command.

    Motions that are not ``regular`` do not affect the limits of the axes.
    """
    data = _serialise_3d_scene(shown, view, regular or {})
    try:
        plotly = (
            Path(import_optional_package("plotly", "report").__file__).parent
            / "package_data"
            / "plotly.min.js"
        )
    except GncOptError as error:
        return f"<p>Not shown in 3-D: {escape(str(error))}</p>"
    script = resources.files(__package__).joinpath("scene.js").read_text(encoding="utf-8")
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    packed = {"plotly": plotly.read_bytes(), "motions": text.encode()}
    return (
        '<div id="scene"><div id="stage"><p>The 3-D view needs JavaScript and WebGL.</p></div><p id="film" hidden>'
        '<button type="button">Play</button> <input type="range" min="0" value="0" aria-label="time"> '
        '<output></output> <select aria-label="what moves"></select></p></div>'
        + _describe_body_axes_and_plume(view)
        + "".join(
            f'<script type="text/plain" id="{name}">{_compress_json_to_base64(part)}</script>'
            for name, part in packed.items()
        )
        + f"<script>{script}</script>"
    )


def _describe_body_axes_and_plume(view: View) -> str:
    """Return a sentence on the body axes and the plume, "" if neither is drawn."""
    parts = ["body axes: bx, by, bz"] if view.attitude is not None else []
    parts += (
        ["plume: opposite to the resultant force, length in proportion"] if view.force is not None else []
    )
    return f'<p class="quiet">{"; ".join(parts).capitalize()}.</p>' if parts else ""


def _compress_json_to_base64(data: bytes) -> str:
    return base64.b64encode(gzip.compress(data, compresslevel=9, mtime=0)).decode("ascii")


def _serialise_3d_scene(
    shown: Mapping[str, Moved], view: View, regular: Mapping[str, bool]
) -> dict[str, Any]:
    spans = np.array([get_motion_time_span(moved, view) for moved in shown.values()])
    n = int(np.clip(_SCENE_MAX_SAMPLES // len(shown), *_INSTANTS))
    times = np.linspace(spans[:, 0].min(), spans[:, 1].max(), n)
    motions = {name: sample_vehicle_motion(moved, view, times) for name, moved in shown.items()}
    motions = {name: each for name, each in motions.items() if np.all(np.isfinite(each.position))}
    if not motions:
        raise GncOptError("no motion has finite positions: there is nothing to show.")
    usual = [each.position for name, each in motions.items() if regular.get(name, True)]
    usual = usual or [each.position for each in motions.values()]
    volumes = {name: sample_ellipsoid_surface(*view.keep_out_volume(name)) for name in view.keep_out}
    bodies = {name: [float(v) for v in np.ravel(place)] for name, place in view.bodies.items()}
    still = [*(v.reshape(3, -1) for v in volumes.values()), *(np.array(b)[:, None] for b in bodies.values())]
    low, high, size = _compute_scene_bounding_box([*usual, *still], view)
    digits = _DIGITS - int(np.floor(np.log10(size)))
    first = next(iter(motions.values()))
    problem = getattr(next(iter(shown.values())), "problem", None)
    return {
        "times": np.round(times, 6).tolist(),
        "time_unit": "s" if problem is None else problem.time_unit,
        "unit": first.unit,
        "labels": first.labels,
        "down": view.down,
        "moves": view.position is not None,
        "turns": view.attitude is not None,
        "low": low.tolist(),
        "high": high.tolist(),
        "axis": AXIS * size,
        "plume": None if first.force is None else PLUME * size,
        "bodies": bodies,
        "half_edges": VEHICLE_HALF_EDGES,
        "volumes": {name: np.round(volume, digits).tolist() for name, volume in volumes.items()},
        "motions": {name: _serialise_vehicle_motion(each, digits) for name, each in motions.items()},
    }


def _serialise_vehicle_motion(each: MotionSamples, digits: int) -> dict[str, Any]:
    """Return the data of one motion; of the body axes the first two, since the third is their cross product."""
    axes = [] if each.dcm_BL is None else np.round(each.dcm_BL[:2], _DIGITS).tolist()
    return {
        "position": np.round(each.position, digits).tolist(),
        "axes": axes,
        "force": None if each.force is None else np.round(each.force, _DIGITS).tolist(),
    }


def _compute_scene_bounding_box(points: list[Array], view: View) -> tuple[Array, Array, float]:
    """Return lower and upper corner of the scene with a margin, and its largest extent."""
    everything = np.hstack(points)
    low, high = everything.min(axis=1), everything.max(axis=1)
    size = float(np.max(high - low)) if view.position is not None else 1.0
    size = size or 1.0
    margin = 0.15 * size
    return low - margin, high + margin, size
