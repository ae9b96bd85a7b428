"""The report in a real browser, without a window: nothing missing, nothing out of the page, nothing on the console."""

import json
import re
import shutil
import subprocess
from html import unescape

import numpy as np
import pytest
from PIL import Image

import gnc_opt as go
from gnc_opt.report import write_report

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [
    pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine"),
    pytest.mark.slow,
]

PHONE, DESKTOP = (500, 844), (1280, 900)  # 500: no window of Chromium is narrower

PROBE = """
<script>
const errors = [];
addEventListener("error", event => errors.push(String(event.message || event.target.src)), true);
addEventListener("load", () => {
  for (const fold of document.querySelectorAll("details")) fold.open = true;
  const all = selector => [...document.querySelectorAll(selector)];
  const found = {
    errors,
    width: innerWidth,
    scroll: document.documentElement.scrollWidth,
    pictures: all("img").map(img => img.naturalWidth),
    described: all("img").every(img => img.alt),
    broken: all("a[href^='#']").map(a => a.getAttribute("href")).filter(href => !document.querySelector(href)),
    outside: all("[src], link[href], a[href]").map(e => e.getAttribute("src") || e.getAttribute("href"))
      .filter(place => !/^(#|data:)/.test(place)),
    folds: all("details > summary").length,
    sections: all("main > section").map(section => section.id),
    reachable: all("nav a, summary").every(e => e.tabIndex >= 0),
  };
  const result = document.createElement("pre");
  result.id = "probe";
  result.hidden = true;
  result.textContent = JSON.stringify(found);
  document.body.append(result);
});
</script>
"""


def browse(page, profile, *options, size=DESKTOP):
    """Open a page, return what Chromium prints."""
    quiet = [
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--no-first-run",
    ]
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", *quiet]
    command += [f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}", *options, page.as_uri()]
    return subprocess.run(command, check=True, capture_output=True, text=True, timeout=120)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    model = go.Model("cart <&> rail")
    q, v = model.state("q", unit="m"), model.state("v", unit="m/s")
    a = model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    problem = go.Problem("one metre <in> least time")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=(0.1, 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    solution = go.solve(problem)
    folder = tmp_path_factory.mktemp("report")
    write_report(solution, go.verify(solution), folder)
    probed = folder / "probed.html"
    text = (folder / "report.html").read_text(encoding="utf-8")
    probed.write_text(text.replace("</title>", "</title>" + PROBE, 1), encoding="utf-8")
    return probed


@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
def test_page_is_whole(page, tmp_path, size):
    shown = browse(page, tmp_path, "--dump-dom", size=size).stdout
    found = json.loads(unescape(re.search(r'<pre id="probe"[^>]*>(.*?)</pre>', shown, re.DOTALL)[1]))
    assert found["errors"] == []
    assert found["width"] == size[0]
    assert found["scroll"] <= found["width"]  # nothing sticks out to the side
    assert len(found["pictures"]) >= 4 and min(found["pictures"]) > 100
    assert found["described"] and found["reachable"]
    assert found["broken"] == []
    assert found["outside"] == []  # needs no network
    assert found["folds"] >= 5
    assert {"answer", "verdict", "arcs", "figures", "multipliers", "provenance"} <= set(found["sections"])


def test_console_is_silent(page, tmp_path):
    log = browse(page, tmp_path, "--enable-logging=stderr", "--dump-dom").stderr
    assert not [line for line in log.splitlines() if ":CONSOLE" in line]


def test_dark_mode_is_the_same_page_in_the_dark(page, tmp_path):
    bright, dark = (look(page, tmp_path, scheme) for scheme in (1, 0))
    assert bright.shape == dark.shape
    assert bright.mean() > 200 > 80 > dark.mean()
    # the same layout: where one has edges at a coarse look, so has the other
    assert np.corrcoef(*(coarse_edges(picture).ravel() for picture in (bright, dark)))[0, 1] > 0.5


def look(page, folder, scheme):
    """A screenshot as an array of grey; scheme 0 is dark, 1 is light."""
    picture = folder / f"{scheme}.png"
    browse(
        page, folder / "profile", f"--screenshot={picture}", f"--blink-settings=preferredColorScheme={scheme}"
    )
    with Image.open(picture) as image:
        return np.asarray(image.convert("L"), dtype=float)


def coarse_edges(picture):
    """Whether there is something, in fields of 20 by 20 points."""
    steps = np.abs(np.diff(picture, axis=1, prepend=picture[:, :1]))
    high, wide = (n // 20 * 20 for n in steps.shape)
    return (steps[:high, :wide].reshape(high // 20, 20, wide // 20, 20).max(axis=(1, 3)) > 20).astype(float)
