"""HTML document of a report: frame, style and elements of a self-contained page for screen and print."""

from __future__ import annotations

import json
import re
import shlex
import sys
from collections.abc import Iterable, Mapping
from datetime import date
from html import escape
from importlib import resources
from itertools import pairwise
from pathlib import Path
from string import Template
from typing import Any

from gnc_opt.errors import GncOptError
from gnc_opt.threads_and_package_versions import get_package_version

PANEL_POINTS = 324.0
"""Width of half a figure, points: `gnc_opt.plot.figure_style.PANEL_WIDTH`, whose module needs matplotlib."""

_AXES = r'(?s)\n  <g id="axes_\d+">.*?\n  </g>'
"""Axes in the SVG that matplotlib writes."""


def create_report_folder(directory: str | Path) -> Path:
    """Create a folder for a report and return its path; raise an error if it is a file."""
    folder = Path(directory)
    if folder.exists() and not folder.is_dir():
        raise GncOptError(f"cannot write the report to '{folder}', which is a file: name a folder.")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def read_figure_captions(report: str) -> dict[str, str]:
    """Return the captions of a report on a "solution" or a "campaign", or the usual "symbols" of parameters."""
    return dict(json.loads(_read_report_resource_file("captions.json"))[report])


def save_figures_as_svg(folder: Path, figures: Iterable[tuple[str, Any]]) -> dict[str, Path]:
    """Write figures, given by file stem, as SVG; return the paths by stem."""
    from gnc_opt.plot.figure_style import save_figure

    files = {}
    for stem, figure in figures:
        for patch in (figure.patch, *(ax.patch for ax in figure.axes)):
            patch.set_alpha(0.0)  # the page shows through, dark or light
        files[stem] = save_figure(figure, folder / f"{stem}.svg")
    return files


def build_html_document(
    title: str, headline: str, sections: Mapping[str, str], author: str = "", fingerprint: str = ""
) -> str:
    """Return a page with titled sections of HTML; empty sections are omitted. A fingerprint is shortened."""
    shown = {name: body for name, body in sections.items() if body}
    anchors = {name: name.lower().replace(" ", "-") for name in shown}
    links = "".join(f'<a href="#{anchor}">{name}</a>' for name, anchor in anchors.items())
    bodies = "".join(
        f'<section id="{anchors[name]}"><h2>{name}</h2>{body}</section>' for name, body in shown.items()
    )
    version = f"gnc_opt {get_package_version('gnc_opt')}"
    identity = f"fingerprint {fingerprint[:16]}" if fingerprint else ""
    written = ", ".join(filter(None, (author, date.today().isoformat(), version, identity)))
    texts = {"title": escape(title), "written": escape(written), "headline": headline}
    heading = title.translate({ord(mark): f"\\{ord(mark):x} " for mark in '\\"<>&\n'})
    texts |= {
        "heading": heading,
        "style": _read_report_resource_file("report.css"),
        "links": links,
        "sections": bodies,
    }
    return Template(_read_report_resource_file("page.html")).substitute(texts)


def _read_report_resource_file(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def embed_svg_figure(files: Mapping[str, Path], stem: str, caption: str) -> str:
    """Return a figure with its caption: one drawing, or one per axes if it has two columns. "" if it does not exist."""
    if stem not in files:
        return ""
    drawing = files[stem].read_text(encoding="utf-8")
    found = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', drawing)
    assert found is not None
    width, height = (float(number) for number in found.groups())
    content = drawing[drawing.index("</metadata>") + len("</metadata>") : drawing.rindex("</svg>")]
    kind = "halves" if width > 1.5 * PANEL_POINTS else "panel" if width < 1.1 * PANEL_POINTS else "picture"
    views: dict[tuple[float, ...], str] = {(0.0, 0.0, width, height): content}
    if kind == "halves" and (axes := re.findall(_AXES, content)):
        views = _split_svg_figure_by_axes(axes, width, height)
        content = re.sub(_AXES, "", content)  # definitions that all axes use
        views[next(iter(views))] += content
    label = f'role="img" aria-label="{escape(caption)}"'
    panels = []
    for box, body in views.items():
        window = " ".join(f"{number:g}" for number in box)
        body = re.sub(r'(?s)<style.*?</style>|(?<=<g) id="[^"]*"', "", body)
        side = "right" if box[0] > 0.0 else "full" * (kind == "halves" and box[2] > width / 2)
        panels.append(f'<div class="{side}"><svg viewBox="{window}" {label}>{body}</svg></div>')
        label = 'aria-hidden="true"'
    caption = f"<figcaption>{escape(caption)}</figcaption></figure>"
    return f'<figure class="{kind} {stem}">{"".join(panels)}{caption}'


def _split_svg_figure_by_axes(axes: list[str], width: float, height: float) -> dict[tuple[float, ...], str]:
    """Return the drawings of axes in two columns or both, by their view boxes; axes with the same frame share one."""
    frames: dict[tuple[float, float, float, float], str] = {}
    for body in axes:
        corners = re.findall(r"[ML] ([\d.]+) ([\d.]+)", body)[:3]
        (left, bottom), _, (right, top) = ((float(a), float(b)) for a, b in corners)
        half = width / 2 * (left > width / 2)
        frame = half, top, bottom, width if right - left > width / 2 else half + width / 2
        frames[frame] = frames.get(frame, "") + body
    views: dict[tuple[float, ...], str] = {}
    for frame, body in frames.items():
        left, top, bottom, right = frame
        column = sorted((f for f in frames if f[0] < right and f[3] > left), key=lambda f: f[1])
        k = column.index(frame)
        ends = [a[2] + (36.0 if b[1] - a[2] > 36.0 else 6.0) for a, b in pairwise(column)]  # below the labels
        start, end = [0.0, *ends, min(column[-1][2] + 36.0, height)][k : k + 2]
        start = min(start, max(top - 18.0, 0.0))  # above the power of ten of the axis
        views[left, start, right - left, end - start] = body
    return views


def format_status_as_html(word: str, tone: str) -> str:
    """Return an emphasised word; tones: good, bad, open or none."""
    return f'<span class="chip {tone}">{escape(word)}</span>'


def get_running_command_line() -> str | None:
    """Return the command of the running program, or None in an interactive session."""
    main = sys.modules["__main__"]
    if getattr(main, "__file__", None) is None:
        return None
    module = ["-m", main.__spec__.name.removesuffix(".__main__")] if main.__spec__ else [sys.argv[0]]
    return shlex.join(["python", *module, *sys.argv[1:]])


def format_shell_command_as_html(command: str | None) -> str:
    return f"<p>Command: <code>{escape(command)}</code></p>" if command else ""
