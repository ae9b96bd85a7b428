"""The whole site in a real browser, without a window: every link leads somewhere, at no width is anything cut off."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Iterator
from functools import cache, partial
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from testing.browser import BROWSER, DESKTOP, PHONE, Tab, browser

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif("SITE" not in os.environ, reason="SITE names no folder of `mkdocs build --strict`"),
]
needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")

LOOSE = "[...document.images].filter(i => !i.naturalWidth || !i.alt).map(i => i.src)"
"""Pictures that are not there, or that nothing is said of."""

CUT = """[...document.querySelectorAll("article *")].filter(element => {
  const place = element.getBoundingClientRect();
  if (!place.width || place.right <= innerWidth + 1) return false;
  for (let around = element; around.tagName !== "ARTICLE"; around = around.parentElement)
    if (/auto|scroll/.test(getComputedStyle(around).overflowX)) return false;
  return true;
}).map(element => `${element.tagName} ${element.textContent.trim().slice(0, 40)} is cut off`).slice(0, 3)"""
"""What sticks out to the side where nothing scrolls."""

SCROLLED = """[...document.querySelectorAll("pre, pre > code")].filter(e => e.scrollWidth > e.clientWidth + 1)
.map(e => `code scrolls sideways: ${e.textContent.trim().slice(0, 40)}`).slice(0, 3)"""


class Links(HTMLParser):
    """What a page refers to, and what in it can be referred to."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.anchors: set[str] = set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for key, value in attrs:
            if key in ("href", "src") and value:
                self.targets.append(value)
            if key in ("id", "name") and value:
                self.anchors.add(value)


@pytest.fixture(scope="module")
def site() -> Path:
    """The built site: SITE names its folder, FIGURES=false leaves the gallery's pictures out."""
    return Path(os.environ["SITE"])


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(site))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture(scope="module")
def tab() -> Iterator[Tab]:
    with browser() as tab:
        yield tab


def test_links_resolve(site: Path) -> None:
    pages = {page: Links(page) for page in site.rglob("*.html")}
    assert len(pages) > 80
    lost = [
        f"{page.relative_to(site)}: {target}"
        for page, links in pages.items()
        for target in dict.fromkeys(links.targets)
        if not resolves(target, page, site, pages)
    ]
    assert not lost, "\n".join(lost)


def resolves(target: str, page: Path, site: Path, pages: dict[Path, Links]) -> bool:
    """Whether a link of a page leads elsewhere, or to a file of the site and to what it names there."""
    url = urlsplit(target)
    if url.scheme or url.netloc:
        return True
    root = site if url.path.startswith("/") else page.parent
    there = file_at(os.path.normpath(root / unquote(url.path).lstrip("/"))) if url.path else page
    if there is None:
        return False
    return not url.fragment or there not in pages or unquote(url.fragment) in pages[there].anchors


@cache
def file_at(path: str) -> Path | None:
    """The file that is served for a path; the menu of every page asks for the same ones."""
    there = Path(path)
    there = there / "index.html" if there.is_dir() else there
    return there if there.is_file() else None


def chosen(site: Path) -> list[Path]:
    """The two largest pages of each folder, where something cut off is likeliest; all of them by SITE_PAGES=all.

    Redirects are left out.
    """
    shown = [page for page in site.rglob("*.html") if 'http-equiv="refresh"' not in page.read_text("utf-8")]
    pages = sorted(shown, key=lambda page: (page.parent, -page.stat().st_size))
    if os.environ.get("SITE_PAGES") == "all":
        return pages
    return [page for page in pages if page in [p for p in pages if p.parent == page.parent][:2]]


@needs_browser
def test_pages_at_both_widths(site: Path, address: str, tab: Tab) -> None:
    wrong = []
    for page in chosen(site):
        name = page.relative_to(site).as_posix()
        tab.open(f"{address}/{name}", PHONE)
        for size in (PHONE, DESKTOP):
            tab.resize(size)
            try:
                # Parts of the theme glide.
                tab.wait("document.documentElement.scrollWidth <= innerWidth", 3.0)
            except AssertionError:
                wrong.append(f"{name}: {tab.ask('document.documentElement.scrollWidth')} wide of {size[0]}")
            wrong += [f"{name} at {size[0]}: {what}" for what in (*tab.ask(CUT), *tab.ask(SCROLLED))]
        elsewhere = [asked for asked in tab.asked if not asked.startswith(address)]
        wrong += [f"{name}: {what}" for what in (*tab.said, *elsewhere, *tab.ask(LOOSE))]
    assert not wrong, "\n".join(wrong)


@needs_browser
@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
def test_first_page_in_light_and_dark(address: str, tab: Tab, size: tuple[int, int]) -> None:
    pictures = []
    for dark in (False, True):
        tab.open(f"{address}/index.html", size, dark=dark)
        pictures.append(tab.look())
    light, black = pictures
    assert np.median(light) > 200 > 80 > np.median(black)
    headings = tab.ask(
        "[...document.querySelectorAll('article h2')].map(h => h.firstChild.textContent.trim())"
    )
    assert {"Start", "Read on"} <= set(headings)


@needs_browser
@pytest.mark.parametrize("word", ["costate", "design_tvlqr"])
def test_search_finds(address: str, tab: Tab, word: str) -> None:
    """A word of the text that also stands within code, and a name."""
    tab.open(f"{address}/index.html", DESKTOP)
    search(tab, word)
    tab.wait("document.querySelectorAll('.md-search-result__item').length > 3", 20.0)
    assert not tab.said


@needs_browser
def test_search_works_in_pages_opened_as_files(site: Path, tab: Tab) -> None:
    tab.open(site.resolve() / "index.html", DESKTOP)
    search(tab, "costate")
    tab.wait("document.querySelectorAll('.md-search-result__item').length > 3", 20.0)
    assert not tab.said
    assert all(asked.startswith("file:") for asked in tab.asked)


@needs_browser
@pytest.mark.parametrize("script", ["search/search_index.js", "assets/javascripts/workers/*.js"])
def test_a_search_without_its_scripts_says_so(site: Path, tab: Tab, tmp_path: Path, script: str) -> None:
    (page := tmp_path / "index.html").write_bytes((site / "index.html").read_bytes())
    for name in ("assets", "search", "style.css", "iframe-worker.js"):
        (shutil.copytree if (site / name).is_dir() else shutil.copy)(site / name, tmp_path / name)
    for path in tmp_path.glob(script):
        path.unlink()
    tab.open(page, DESKTOP)
    search(tab, "costate")
    message = "document.querySelector('.md-search-result__meta').textContent"
    tab.wait(f"{message}.includes('cannot be loaded')", 20.0)


PHRASES = {
    "path constraint": "stating_problems", "free final time": "stating_problems", "time of flight": "stating_problems",
    "minimum fuel": "learn/bang_bang", "low thrust": "gallery/low_thrust_transfer", "Pontryagin": "verdict",
    "thrust vector": "howto/kinks", "delta-v": "howto/kinks", "export csv": "howto/results",
    "mesh refinement": "refinement", "costate at any time": "howto/results",
    "sign of the Hamiltonian": "conventions", "bang-bang": "learn/bang_bang", "minimum time": "learn/first_problem",
    "keep-out zone": "stating_problems", "initial guess": "howto/guess", "scaling": "howto/scaling",
    "multiple phases": "howto/phases", "parameter sweep": "howto/sweeps", "warm start": "howto/warm_start",
    "save solution": "howto/results", "not optimal": "howto/when_it_does_not_solve",
    "infeasible": "reference/statuses", "linear solver": "reference/solver_options", "saturation": "control/simulation",
    "another linear solver": "reference/solver_options", "obstacle avoidance": "stating_problems",
    "attitude control": "attitude_control", "eclipse": "gallery/eclipse_orbit_raising",
    "reentry": "gallery/shuttle", "noise": "control/simulation", "bounds on states": "stating_problems",
    "lower bound": "theory/lower_bounds", "LQR": "control/linear", "MPC": "control/predictive",
    "sliding mode": "control/sliding_mode", "Kalman filter": "control/estimation", "event": "control/events",
    "Monte Carlo": "control/campaigns", "1000 runs": "control/campaigns", "re-planning": "control/guidance",
    "gain margin": "analysis/frequency", "UKF": "control/estimation", "C code": "control/c_code", "FMU": "control/fmu",
    "outcome": "reference/outcomes", "installation": "start/installation", "glossary": "reference/glossary",
}  # fmt: skip
"""What users type, and the page that comes first."""


def search(tab: Tab, phrase: str) -> None:
    """Type a phrase into the search of the open page."""
    tab.ask(
        f"(i => {{ i.focus(); i.value = '{phrase}'; i.dispatchEvent(new Event('keyup', {{bubbles: true}})); }})"
        "(document.querySelector('.md-search__input'))"
    )


@needs_browser
def test_search_returns_the_right_page_first(address: str, tab: Tab) -> None:
    first = "document.querySelector('.md-search-result__item a')?.getAttribute('href') ?? ''"
    wrong = []
    for phrase, page in PHRASES.items():
        tab.open(f"{address}/index.html", DESKTOP)  # without results of the phrase before
        search(tab, phrase)
        tab.wait(first, 20.0)
        found = urlsplit(tab.ask(first)).path.lstrip("/")
        if found != f"{page}.html":
            wrong.append(f"{phrase}: {found}")
    assert not wrong, "\n".join(wrong)
