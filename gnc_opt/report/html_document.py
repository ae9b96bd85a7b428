"""HTML document of a report: frame, style and elements of a self-contained page for screen and print."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Mapping
from datetime import date
from html import escape
from pathlib import Path
from typing import Any

from gnc_opt.errors import GncOptError
from gnc_opt.runtime_environment import package_version


def make_report_folder(directory: str | Path) -> Path:
    """Create a folder for a report and return its path; raise an error if it is a file."""
    folder = Path(directory)
    if folder.exists() and not folder.is_dir():
        raise GncOptError(f"cannot write the report to '{folder}', which is a file: name a folder.")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def write_page(folder: Path, text: str) -> Path:
    """Write ``report.html`` to a folder and return its path."""
    path = folder / "report.html"
    path.write_text(text, encoding="utf-8")
    return path


def save_figures(folder: Path, draw: Callable[[], Iterable[tuple[str, Any]]]) -> dict[str, Path]:
    """Write figures by file stem as SVG, also narrow ones in a folder of that name; return the paths by stem."""
    from gnc_opt.plot.style import draw_narrow_figures, save_figure

    def save_all(where: Path) -> dict[str, Path]:
        files = {}
        for stem, figure in draw():
            for patch in (figure.patch, *(ax.patch for ax in figure.axes)):
                patch.set_alpha(0.0)  # the page shows through, dark or light
            files[stem] = save_figure(figure, where / f"{stem}.svg")
        return files

    with draw_narrow_figures():
        save_all(folder / "narrow")
    return save_all(folder)


def html_document(title: str, headline: str, sections: Mapping[str, str]) -> str:
    """Return a page with titled sections of HTML; empty sections are omitted."""
    shown = {name: body for name, body in sections.items() if body}
    anchors = {name: name.lower().replace(" ", "-") for name in shown}
    links = "".join(f'<a href="#{anchor}">{name}</a>' for name, anchor in anchors.items())
    bodies = "".join(
        f'<section id="{anchors[name]}"><h2>{name}</h2>{body}</section>' for name, body in shown.items()
    )
    name = escape(title)
    written = f"{date.today().isoformat()}, gnc_opt {package_version('gnc_opt')}"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{name}</title><style>{_STYLE}</style></head>\n<body><header><h1>{name}</h1>"
        f'<p>{headline}</p><p class="quiet">{written}</p><nav>{links}</nav></header>\n'
        f"<main>{bodies}</main></body></html>\n"
    )


def figure_html(files: Mapping[str, Path], stem: str, caption: str) -> str:
    """Return a figure with its caption; narrow screens show the narrow file. "" if it does not exist."""
    if stem not in files:
        return ""
    path, text = files[stem], escape(caption)
    return (
        f'<figure class="{stem}"><picture><source media="(max-width: 40rem)" '
        f'srcset="{_data_url(path.parent / "narrow" / path.name)}"><img alt="{text}" src="{_data_url(path)}">'
        f"</picture><figcaption>{text}</figcaption></figure>"
    )


def _data_url(path: Path) -> str:
    return f"data:image/svg+xml;base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"


def status_label_html(word: str, tone: str) -> str:
    """Return an emphasised word; tones: good, bad, open or none."""
    return f'<span class="chip {tone}">{escape(word)}</span>'


def command_html(command: str | None) -> str:
    return f"<p>Command: <code>{escape(command)}</code></p>" if command else ""


_STYLE = """
:root { color-scheme: light dark; --ink: #1a1f24; --quiet: #5b6770; --paper: #fff; --line: #d8dde1;
  --good: #1a7f4b; --bad: #c0341d; --open: #8a6100; }
@media screen and (prefers-color-scheme: dark) { :root { --ink: #e6e9ec; --quiet: #9aa7b1; --paper: #14181c;
  --line: #343c44; --good: #4cc38a; --bad: #ff8a70; --open: #e3b341; }
  img[src^="data:image/svg"] { filter: invert(.914) hue-rotate(180deg); } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 68rem; padding: 1rem; font: 16px/1.5 system-ui, sans-serif; color: var(--ink);
  background: var(--paper); }
h1 { margin: 0; font-size: 1.6rem; } h2 { margin: 2.2rem 0 .6rem; font-size: 1.3rem; }
h3 { margin: 1.4rem 0 .3rem; font-size: 1.1rem; } h4 { margin: 1rem 0 .2rem; font-size: 1rem; }
header p { margin: .3rem 0; } .quiet { color: var(--quiet); font-size: .9rem; }
nav { display: flex; flex-wrap: wrap; gap: .2rem 1.2rem; padding: .4rem 0; border-block: 1px solid var(--line); }
a { color: inherit; } a:focus-visible { outline: 2px solid var(--good); }
.chip { display: inline-block; padding: 0 .55rem; margin-right: .5rem; border: 1px solid; border-radius: 1rem;
  font-size: .85rem; font-weight: 600; }
.good { color: var(--good); } .bad { color: var(--bad); } .open { color: var(--open); }
.wide { overflow-x: auto; } .wide + .wide { margin-top: .8rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem 1rem .2rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line); }
th, figcaption { color: var(--quiet); font-weight: normal; }
.failure { border-left: .3rem solid var(--bad); padding-left: .8rem; margin-bottom: 1rem; }
.formulas td { border: 0; padding: .25rem .8rem .25rem 0; vertical-align: baseline; line-height: 2; }
.formulas td:first-child { text-align: right; }
th, td:not(:last-child) { white-space: nowrap; }
.trajectory img { max-width: 52rem; margin: 0 auto; } .formulas td:first-child { white-space: normal; }
figure { margin: 1rem 0 1.5rem; overflow-x: auto; } figcaption { font-size: .9rem; }
img { display: block; width: 100%; height: auto; }
math { font-size: 1.12em; math-style: normal; font-family: "STIX Two Math", "Latin Modern Math", "Cambria Math", math; }
code { overflow-wrap: anywhere; } pre { overflow-x: auto; font-size: .85rem; }
#stage { height: min(36rem, 75vh); } #film { display: flex; flex-wrap: wrap; gap: .5rem; align-items: center; }
#film input { flex: 1 1 12rem; } #film select { max-width: 100%; } #film output { min-width: 7rem; }
#film button, #film select { font: inherit; min-height: 2.2rem; min-width: 4.5rem; }
@media (max-width: 40rem) { table { font-size: .85rem; } th, td { padding-right: .6rem; }
  th, td:not(:last-child) { white-space: normal; } .formulas { font-size: .8rem; }
  td:nth-child(n + 4):last-child { min-width: 8rem; } }
@page { size: A4; margin: 14mm 15mm; }
@media print { body { padding: 0; font-size: 10pt; line-height: 1.35; max-width: none; }
  p { margin: .3rem 0; } table, figcaption, .quiet { font-size: 8.5pt; }
  th, td { padding: .1rem .8rem .1rem 0; } h2 { margin: 1.2rem 0 .3rem; }
  nav, #motion, #overview h2 { display: none; }
  #problem { break-before: page; } figure, tr { break-inside: avoid; } figure { margin: .5rem 0; }
  .formulas { font-size: 8pt; } .wide, figure { overflow: visible; } h2, h3, h4 { break-after: avoid; }
  figure img { width: auto; max-width: 100%; max-height: 23cm; margin: 0 auto; }
  #overview img { max-height: 10.4cm; } #overview .trajectory img { max-height: 5.2cm; } }
"""
