"""The report in a real browser, without a window: nothing missing, nothing out of the page, nothing on the console."""

import numpy as np
import pytest
from testing.browser import BROWSER, DESKTOP, PHONE, browser
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.report import write_report
from gnc_opt.report.html_report_document import build_html_document

pytestmark = [pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine"), pytest.mark.slow]

PROBE = """(() => {
  const all = selector => [...document.querySelectorAll(selector)];
  return {
    width: innerWidth,
    scroll: document.documentElement.scrollWidth,
    pictures: all("svg[role=img]").map(svg => svg.getBoundingClientRect().width),
    described: all("svg[role=img]").every(svg => svg.getAttribute("aria-label")),
    broken: all("a[href^='#']").map(a => a.getAttribute("href")).filter(href => !document.querySelector(href)),
    outside: all("[src], link[href], a[href]").map(e => e.getAttribute("src") || e.getAttribute("href"))
      .filter(place => !/^(#|data:)/.test(place)),
    sections: all("main > section").map(section => section.id),
    reachable: all("nav a").every(e => e.tabIndex >= 0),
  };
})()"""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    model = go.Model("cart <&> rail")
    q, v = model.state("q", unit="m"), model.state("v", unit="m/s")
    a = model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    problem, leg = one_phase("one metre <in> least time", model, initial=0.0, final=(0.1, 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    solution = go.solve(problem)
    folder = tmp_path_factory.mktemp("report")
    return write_report(solution, go.verify(solution), folder)[0]


@pytest.fixture(scope="module")
def tab():
    with browser() as tab:
        yield tab


@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
def test_page_is_whole(tab, page, size):
    tab.open(page, size)
    found = tab.ask(PROBE)
    assert found["width"] == size[0]
    assert found["scroll"] <= found["width"]  # nothing sticks out to the side
    assert len(found["pictures"]) >= 4 and min(found["pictures"]) > 100
    assert found["described"] and found["reachable"]
    assert found["broken"] == []
    assert found["outside"] == [] and tab.asked == [page.as_uri()]  # needs no network
    assert found["sections"][:2] == ["overview", "problem"]
    assert {"costates-and-hamiltonian", "arcs", "conditions", "software"} <= set(found["sections"])
    assert tab.said == []


def test_dark_mode_is_the_same_page_in_the_dark(tab, page):
    pictures = []
    for dark in (False, True):
        tab.open(page, DESKTOP, dark=dark)
        pictures.append(tab.look())
    bright, black = pictures
    assert bright.shape == black.shape
    assert bright.mean() > 200 > 80 > black.mean()
    # the same layout: where one has edges at a coarse look, so has the other
    assert np.corrcoef(*(coarse_edges(picture).ravel() for picture in pictures))[0, 1] > 0.5


def test_a_narrow_figure_leaves_the_one_before_it_on_its_page(tab, tmp_path):
    """The page has 261 mm: 170 mm, two figures of about 30 mm, and 215 mm fit on two pages."""
    drawing = '<div><svg viewBox="0 0 300 100"></svg></div>'
    figures = "".join(
        f'<figure class="{kind}">{drawing * n}<figcaption>Text.</figcaption></figure>'
        for kind, n in (("halves", 2), ("panel", 1))
    )
    blocks = [f'<div style="height: {height}mm"></div>' for height in (170, 215)]
    page = tmp_path / "report.html"
    page.write_text(build_html_document("Report", "", {"First": blocks[0], "Second": figures + blocks[1]}))
    tab.open(page, DESKTOP)
    assert tab.print_to_pdf().count(b"/Type /Page\n") == 2


def coarse_edges(picture):
    """Whether there is something, in fields of 20 by 20 points."""
    steps = np.abs(np.diff(picture, axis=1, prepend=picture[:, :1]))
    high, wide = (n // 20 * 20 for n in steps.shape)
    return (steps[:high, :wide].reshape(high // 20, 20, wide // 20, 20).max(axis=(1, 3)) > 20).astype(float)
