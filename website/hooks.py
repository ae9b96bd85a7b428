"""What mkdocs calls while it builds the site: pages that are generated, links, formulas.

Links in the pages are those of the repository, so that they also work where the repository is read as files. Formulas
become MathML, which browsers draw themselves: no script, and nothing from the network.
"""

from __future__ import annotations

import html
import io
import json
import posixpath
import re
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from PIL import Image

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))  # for problems/ and website/, which are not installed

from gnc_opt.problem_files_and_examples import list_examples  # noqa: E402
from gnc_opt.report.mathml_formulas import convert_latex_to_mathml  # noqa: E402
from website import api, gallery, redirects, samples  # noqa: E402

FROM_ROOT = {
    "index.md": "README.md",
    "development/contributing.md": "CONTRIBUTING.md",
    "development/changelog.md": "CHANGELOG.md",
    "development/citation.md": "CITATION.cff",
    "development/licence.md": "LICENSE",
}
"""Pages that are files of the root, by their place in the site; data files are shown as code."""

SEARCH_FROM_FILES = "iframe-worker.js"
"""Script of the search for pages that are opened as files; `extra.polyfills` of ``mkdocs.yml`` names it."""

SEARCH_WEIGHTS = {
    "howto": 8.0,
    "control": 8.0,
    "analysis": 8.0,
    "start": 8.0,
    "stating_problems.md": 10.0,
    "howto/when_it_does_not_solve.md": 30.0,
    "howto/results.md": 10.0,
    "reference/solver_options.md": 12.0,
    "refinement.md": 7.0,
    "verdict.md": 4.0,
    "problems.md": 4.0,
    "attitude_control.md": 4.0,
    "rendezvous.md": 4.0,
    "learn": 6.0,
    "reference": 4.0,
    "theory": 5.0,
    "conventions.md": 8.0,
    "api": 0.2,
    "gallery": 0.3,
    "gallery/low_thrust_transfer.md": 8.0,
    "coming_from": 0.3,
    "development": 0.1,
}
"""By page or folder; 1 for all others."""

AMERICAN = {
    "discretis": "discretiz",
    "initialis": "initializ",
    "linearis": "lineariz",
    "maximis": "maximiz",
    "minimis": "minimiz",
    "normalis": "normaliz",
    "optimis": "optimiz",
    "quantis": "quantiz",
    "stabilis": "stabiliz",
    "behaviour": "behavior",
    "manoeuvre": "maneuver",
    "neighbour": "neighbor",
}
"""American spellings of British beginnings of words, with which the search finds pages as well."""

CLASS_WEIGHT = 3.0
"""Weight of the reference of a public class, for whose name the search lists it below the guides."""

LONG_SIGNATURE = 18
"""Lines of the signature of a class above which the list of its attributes suffices."""

_ON_THE_SITE = {
    "index.md": {
        "**API reference** in the site that `mkdocs build` writes (extra `docs`)": "**[API reference](api/index.md)**",
        "`report/report.html`": f"[`report/report.html`]({samples.SOLUTION})",
    },
    "howto/results.md": {
        "page, `report.html`": f"page, [`report.html`](../{samples.SOLUTION})",
        "a page on a": f"[a page](../{samples.CAMPAIGN}) on a",
    },
    "rendezvous_tracking.md": {"Write a report": f"Write [a report]({samples.CAMPAIGN})"},
}
"""What pages say in the repository, where nothing is generated, and on the site."""

_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s:#]+)(#[^)\s]*)?\)")
_FENCE = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
LONG_LINE = 98
"""Columns that fit beside the navigation at 1280 pixels."""

_CODE = re.compile(r'(<div class="[^"]*highlight)([^"]*">.*?</div>)', re.DOTALL)
_LINE_OF_CODE = re.compile(r'<span id="line-[\d-]+">')
"""Start of a line of code; the numbers recur in the signatures of a page."""

_UNDESCRIBED = re.compile(
    r'(<li class="doc-section-item field-body">(?:(?!</li>).)*?)(?:–\s*)?<div class="doc-md-description">\s*</div>\s*'
    r"</li>\s*",
    re.DOTALL,
)
_SECTION = 'doc-section-title">'
_NO_ITEMS = re.compile(r'<p><span class="doc-section-title">[^<]*</span></p>\s*<ul>\s*</ul>')
"""Attributes without a description stand in the signature alone; parameters are listed with their type."""

_PICTURE = re.compile(r'<p>((?:<a [^>]*>)?<img alt="([^"]*)" src="([^"]*)" ?/?>(?:</a>)?)</p>')

WIDE_PT = 420.0
"""Width of a picture above which phones scroll it instead of making its letters too small."""

_CELL = re.compile(r"<td([^>]*)>(.*?)</td>", re.DOTALL)
SHORT_NAME = 14
"""Letters of a name that fit the columns of phones, so that it does not break."""

LONG_CELL = 20
"""Letters of a cell of a table above which it is text, which phones give more width than numbers."""

_ARTICLE = re.compile(r"<article.*?</article>", re.DOTALL)
_MARKUP_OR_TEXT = re.compile(r"<(pre|script|style|math)\b.*?</\1>|<[^>]*>|([^<]+)", re.DOTALL)
_NUMBER_OR_OPTION = re.compile(r"(?<![\w.])\d[\d.]*e-\d+|(?<!\S)--?[A-Za-z][\w-]*")
_CODE_OF_CELL = re.compile(r"<code>.*?</code>", re.DOTALL)

_SIGNATURE = re.compile(
    r'<div class="doc-signature highlight"><pre><span></span><code><span class="line"><span class="nf">[A-Z].*?</div>',
    re.S,
)
_MADE_DEFAULT = re.compile(
    r'(<span class="o">=</span> )<span class="p">\(</span><span class="k">lambda</span>.*\n'
)
_FORMULA = re.compile(r'<(span|div) class="arithmatex">(.*?)</\1>([,.:;]?)', re.DOTALL)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Show the version in the header, and list what is generated in the navigation."""
    config.site_name = f"gnc_opt {documented_version((ROOT / 'CHANGELOG.md').read_text(encoding='utf-8'))}"
    sections = dict(_sections(config.nav))
    for trade, members in gallery.by_trade().items():
        pages = [{gallery.heading(e): f"gallery/{e.name}.md"} for e in members]
        if trade == gallery.SYSTEMS:  # their results are pages of docs/, listed before the code
            sections[trade].append({"Code": pages})
        else:
            sections["Examples"].append({trade: pages})
    sections["API"].append("api/index.md")
    sections["API"].extend({api.title(p): f"api/{p}.md"} for p in api.entries())
    sections["Project"].extend(place for place in FROM_ROOT if place.startswith("development/"))
    return config


def documented_version(changelog: str) -> str:
    """Return the newest version of the changelog: "0.4.0 (unreleased)" until its release."""
    found = re.search(r"(?m)^## (Unreleased \()?([\d.]+)", changelog)
    assert found is not None
    return found[2] + " (unreleased)" * bool(found[1])


def _sections(entries: Any) -> Iterator[tuple[str, list[Any]]]:
    """Yield title and pages of every section of the navigation, nested ones too."""
    for entry in entries or ():
        for title, pages in entry.items() if isinstance(entry, dict) else ():
            if isinstance(pages, list):
                yield title, pages
                yield from _sections(pages)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is generated."""
    wanted = bool(config.extra["figures"])
    texts = {place: (ROOT / name).read_text(encoding="utf-8") for place, name in FROM_ROOT.items()}
    texts["development/citation.md"] = f"# Citation\n\n```yaml\n{texts['development/citation.md']}```\n"
    texts["development/licence.md"] = f"# Licence\n\n{texts['development/licence.md']}"
    for place, text in (texts | api.pages() | gallery.pages(wanted) | samples.reports()).items():
        files.append(File.generated(config, place, content=text))
    shim = Path(__file__).parent / SEARCH_FROM_FILES
    files.append(File.generated(config, SEARCH_FROM_FILES, content=shim.read_text(encoding="utf-8")))
    if wanted:
        with ProcessPoolExecutor() as pool:
            for found in pool.map(gallery.pictures, list_examples()):
                for place, picture in found.items():
                    files.append(File.generated(config, place, content=picture))
    return files


def on_page_markdown(markdown: str, page: Page, **more: Any) -> str:
    """Let links to files of the repository lead to the pages that show them; what is generated has the site's own."""
    place = page.file.src_uri
    page.meta["search"] = {"boost": search_weight(place)}
    page.meta["hide"] = ["navigation"] if place == "index.md" else []  # it would list this page alone
    if place not in FROM_ROOT and page.file.generated_by:
        return markdown
    pieces = re.split(f"({_FENCE.pattern})", markdown, flags=_FENCE.flags)
    source = FROM_ROOT.get(place, f"docs/{place}")
    shown = (piece if piece.startswith("```") else relinked(piece, source, place) for piece in pieces)
    text = "".join(shown)
    for here, there in _ON_THE_SITE.get(place, {}).items():
        text = text.replace(here, there)
    return text


def search_weight(place: str) -> float:
    """Return the weight of a page in the search: guides before references, these before generated pages."""
    folder = place.partition("/")[0] if "/" in place else ""
    return SEARCH_WEIGHTS.get(place, SEARCH_WEIGHTS.get(folder, 1.0))


def relinked(text: str, source: str, place: str) -> str:
    """Return a text of the repository's file ``source`` with links for the page at ``place`` of the site.

    What the site does not show is named without a link.
    """

    def link(found: re.Match[str]) -> str:
        sign, label, target, anchor = found[1], found[2], found[3], found[4] or ""
        there = shown_at(posixpath.normpath(posixpath.join(posixpath.dirname(source), target)))
        if there is None:
            return label
        return f"{sign}[{label}]({posixpath.relpath(there, posixpath.dirname(place) or '.')}{anchor})"

    return _LINK.sub(link, text)


def shown_at(path: str) -> str | None:
    """Return where the site shows a file or folder of the repository; None if nowhere."""
    for place, name in FROM_ROOT.items():
        if path == name:
            return place
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    found = re.fullmatch(r"problems/(?:\w+/(?=\w+\.py))?(\w+)(?:\.py|/)?", path)
    return f"gallery/{found[1]}.md" if found else None


def shorten_signature(found: re.Match[str]) -> str:
    """Return the signature of a class without defaults made by functions; "" if it is long."""
    return (
        "" if found[0].count("\n") > LONG_SIGNATURE else _MADE_DEFAULT.sub(r"\1<span>...</span>,\n", found[0])
    )


def on_page_content(
    content: str, *, page: Page | None = None, files: Files | None = None, **more: Any
) -> str:
    """Turn formulas into MathML and pictures into figures with captions; leave out names without a description."""
    folder = posixpath.dirname(page.file.src_uri) if page else ""

    def picture(found: re.Match[str]) -> str:
        place = posixpath.normpath(posixpath.join(folder, found[3]))
        file = files.get_file_from_path(place) if files else None
        size = " wide" if _width_pt(file.content_bytes if file else _read(place)) > WIDE_PT else ""
        return (
            f'<figure class="picture{size}"><div>{found[1]}</div><figcaption>{found[2]}</figcaption></figure>'
        )

    def formula(found: re.Match[str]) -> str:
        latex = html.unescape(found[2]).strip()[2:-2]  # without \( \) or \[ \]
        if found[1] == "div":
            parts = "".join(convert_latex_to_mathml(part, "block") for part in separate_formulas(latex))
            return f'<div class="formulas">{parts}</div>{found[3]}'
        drawn = convert_latex_to_mathml(latex, "inline")
        return f'<span class="unbroken">{drawn}{found[3]}</span>' if found[3] else drawn

    def undescribed(found: re.Match[str]) -> str:
        before = found.string[: found.start()].rpartition(_SECTION)[2]
        return f"{found[1]}</li>" if before.startswith("Parameters") else ""

    content = _SIGNATURE.sub(shorten_signature, _LINE_OF_CODE.sub('<span class="line">', content))
    content = _PICTURE.sub(picture, _NO_ITEMS.sub("", _UNDESCRIBED.sub(undescribed, content)))
    return _FORMULA.sub(formula, _CODE.sub(_marked_if_long, content))


def on_post_page(output: str, **more: Any) -> str:
    """Let names in tables break after underscores, points and parentheses; numbers and options do not break.

    The search has the text as it was.
    """

    def breakable(code: re.Match[str]) -> str:
        if len(html.unescape(re.sub(r"<[^>]*>", "", code[0]))) <= SHORT_NAME:
            return code[0]
        return re.sub(r"(?<=[\w\])\[][\w\])\[][\w\])])([_.(\[])(?=\w)", r"\1<wbr>", code[0])

    def cell(found: re.Match[str]) -> str:
        kind = ' class="text"' * (
            "class" not in found[1] and len(re.sub(r"<[^>]*>", "", found[2])) > LONG_CELL
        )
        return f"<td{found[1]}{kind}>{_CODE_OF_CELL.sub(breakable, found[2])}</td>"

    def unbroken(found: re.Match[str]) -> str:
        if found[2] is None:
            return found[0]
        text = re.sub(r"(?<=\d) (?=%)", "&nbsp;", found[2])
        return _NUMBER_OR_OPTION.sub(r'<span class="unbroken">\g<0></span>', text)

    return _ARTICLE.sub(lambda found: _MARKUP_OR_TEXT.sub(unbroken, found[0]), _CELL.sub(cell, output))


def separate_formulas(latex: str) -> list[str]:
    """Return the formulas that stand side by side in a display, which phones show below each other."""
    parts = [""]
    for piece in re.split(r"(\\q?quad(?![A-Za-z]))", latex):
        whole = parts[-1]
        outside = whole.count("{") == whole.count("}") and r"\begin" not in whole and r"\left" not in whole
        if outside and re.fullmatch(r"\\q?quad", piece):
            parts.append("")
        else:
            parts[-1] += piece
    return [part for part in parts if part.strip()]


def _read(place: str) -> bytes:
    return (ROOT / "docs" / place).read_bytes()


def _width_pt(picture: bytes) -> float:
    """Return the width of a picture in points: that of an SVG file, or 0.75 per pixel."""
    found = re.search(rb'<svg [^>]*width="([\d.]+)pt"', picture)
    return float(found[1]) if found else 0.75 * Image.open(io.BytesIO(picture)).width


def _marked_if_long(found: re.Match[str]) -> str:
    """Give a block with long lines, or with a drawing, a class of its own, which makes its letters smaller."""
    lines = html.unescape(re.sub(r"<[^>]*>", "", found[2])).splitlines()
    kind = " drawing" if "──" in found[2] else " long" if max(map(len, lines), default=0) > LONG_LINE else ""
    return f"{found[1]}{kind}{found[2]}"


@event_priority(-50)  # after the search has written its index, before it is copied for pages opened as files
def on_post_build(config: MkDocsConfig) -> None:
    """Let the addresses of pages that have moved lead to the new ones; title and weight names in the search."""
    redirects.write(Path(config.site_dir))
    index = Path(config.site_dir) / "search" / "search_index.json"
    found = json.loads(index.read_text(encoding="utf-8"))
    for entry in found["docs"]:
        entry["title"] = search_title(entry["title"], entry["location"])
        if re.search(r"^api/.*\.[A-Z]\w*$", entry["location"]):
            entry["boost"] = CLASS_WEIGHT
        entry["text"] += american_spellings(entry["text"])
    index.write_text(json.dumps(found, separators=(",", ":")), encoding="utf-8")


def american_spellings(text: str) -> str:
    """Return the American spellings of the British words in a text, each after a space, to be found by them."""
    words = sorted(set(re.findall(rf"\b(?:{'|'.join(AMERICAN)})\w*", text.lower())))
    return "".join(f" {re.sub('|'.join(AMERICAN), lambda found: AMERICAN[found[0]], word)}" for word in words)


def search_title(title: str, location: str) -> str:
    """Return the title of a hit: "Class.member" for members in the API, without labels such as "property"."""
    name = re.sub(r"\s*<code>\w+</code>", "", title) if location.startswith("api/") else title
    member = re.search(r"#gnc_opt\..*\.([A-Z]\w*\.\w+)$", location)
    return member[1] if member else name
