"""What notebooks show: well formed, complete, and nothing that a user wrote is taken for HTML."""

from __future__ import annotations

import warnings
from typing import Any
from xml.etree import ElementTree

import pytest
import rich.console
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.progress_display import show_campaign_progress
from gnc_opt.simulation import Noise, Saturation

HOSTILE = "<script>alert('a')</script> & <b>"
TAGS = {"div", "p", "strong", "table", "thead", "tbody", "tr", "th", "td", "pre"}


def parsed(thing: Any) -> ElementTree.Element:
    tree = ElementTree.fromstring(f"<div>{thing._repr_html_()}</div>")
    assert {element.tag for element in tree.iter()} <= TAGS
    return tree


def rows(tree: ElementTree.Element) -> list[list[str]]:
    return [["".join(cell.itertext()) for cell in row] for row in tree.iter("tr")]


@pytest.fixture(scope="module")
def problem() -> go.Problem:
    model = go.Model(HOSTILE)
    r, v = model.state("r", 2, unit="m"), model.state("v", 2, unit=HOSTILE)
    a = model.control("a", 2)
    model.ode({r: v, v: a})
    problem, leg = one_phase(HOSTILE, model, 0.0, 1.0)
    leg.initial(r=[0.0, 0.0], v=0.0)
    leg.final(r=[1.0, 2.0], v=0.0)
    leg.path(HOSTILE, a[0] + a[1], upper=100.0)
    problem.minimize(leg.integral(a[0] ** 2 + a[1] ** 2))
    return problem


@pytest.fixture(scope="module")
def solution(problem: go.Problem) -> go.Solution:
    return go.solve(problem, mesh="1x6", tol=None)


def test_problem(problem: go.Problem) -> None:
    tree = parsed(problem)
    assert f"{HOSTILE}, cost minimised" in "".join(tree.itertext())
    assert rows(tree)[1:] == [["leg", HOSTILE, f"r[2] (m), v[2] ({HOSTILE})", "a[2]", HOSTILE]]


def test_solution(solution: go.Solution) -> None:
    assert "".join(parsed(solution).itertext()) == str(solution)
    assert HOSTILE in str(solution)


def test_verdict(solution: go.Solution) -> None:
    verdict = go.verify(solution)
    assert "".join(parsed(verdict).itertext()) == str(verdict)
    assert repr(verdict) == f"<verdict on '{HOSTILE}': {verdict.outcome}>"


def test_a_verdict_that_is_not_ok_names_the_place(solution: go.Solution) -> None:
    condition = go.Condition("cost", go.ConditionResult.FAIL, 0.5, 1e-5, HOSTILE, "It is wrong.")
    assert HOSTILE in "".join(parsed(go.Verdict(HOSTILE, (condition,))).itertext())


def test_run_and_campaign() -> None:
    model = go.Model("glider")
    q, u = model.state("q", unit=HOSTILE), model.control("u")
    model.ode({q: u})
    parts = {"actuators": [Saturation("thruster", -1.0, 1.0)], "sensors": [Noise(HOSTILE, 0.1, on="q")]}
    loop = go.ClosedLoop(model, go.design_lqr(model, [0.0], Q=1, R=1, dt=0.1), dt=0.1, **parts)
    campaign = go.monte_carlo(loop, n=3, seed=1, x0={"q": 1.0}, tf=0.5, dispersions={}, executor="serial")
    for shown in (campaign, campaign.rerun(0), loop):
        assert "".join(parsed(shown).itertext()) == str(shown)
        assert HOSTILE in str(shown)
    assert repr(campaign).startswith("<campaign of 3 runs, seed 1") and "\n" not in repr(campaign)
    heading = "closed loop of plant 'glider' and controller 'LQR', control step 0.1 s"
    blocks = f"  actuators     thruster (Saturation)\n  sensors       {HOSTILE} (Noise)"
    assert str(loop) == f"{heading}\n{blocks}" and repr(loop) == f"<{heading}>"
    assert repr(campaign.rerun(0)) == "<run of 0.5 s in 5 control steps: ok>"


def test_progress_needs_no_widgets(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rich would ask for ipywidgets, and show nothing without them."""
    monkeypatch.setattr(rich.console, "_is_jupyter", lambda: True)
    with warnings.catch_warnings(), show_campaign_progress(3) as show:
        warnings.simplefilter("error")
        show(1, 0)
        show(2, 1)
    told = capsys.readouterr()
    assert told.err.count("\r") >= 3 and "3/3" in told.err and "1 failed" in told.err and not told.out
