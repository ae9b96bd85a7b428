"""The drift check: what moved is named, what did not is not, and the baseline knows the rendezvous."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmarks.validation import regression
from benchmarks.validation.regression import BASELINE, Record, compare, read_baseline
from problems import rendezvous

STILL = Record(
    "p", "optimal", 2.0, {"q": 1.0, "v": 0.0}, {"q": 1.0, "v": 0.5}, 20, 3, ("bounds",), ("second order",)
)


def moves(before: Record, now: Record) -> list[regression.Move]:
    return compare({before.name: before}, {now.name: now})


# --- comparing ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("now", "what"),
    [
        (replace(STILL, objective=2.0 * (1 + 2e-9)), "objective, by 2.0e-09"),
        (replace(STILL, objective=float("nan")), "objective"),
        (replace(STILL, status="infeasible", objective=None), "status"),
        (replace(STILL, failed=()), "verdict"),
        (replace(STILL, inconclusive=()), "verdict"),
        (replace(STILL, failed=("second order",), inconclusive=("bounds",)), "verdict"),
    ],
)
def test_what_matters_counts(now: Record, what: str) -> None:
    found = moves(STILL, now)
    assert [move.what[: len(what)] for move in found if move.counts] == [what]


# --- the program --------------------------------------------------------------------------------------


def quadratic(name: str) -> dict[str, Any]:
    """min 1/2 int x^2 + u^2 from x(0) = 1 over 1 s."""
    state = {"name": "x", "x0": 1.0, "xf": None, "lb": None, "ub": None}
    phase = {
        "t0": 0, "tf": 1, "states": [state], "controls": [{"name": "u", "lb": None, "ub": None}],
        "ode": {"x": "u"}, "integrals": {"J": "(x**2+u**2)/2"},
    }  # fmt: skip
    return {"name": name, "sense": "min", "phases": [phase], "objective": "J_1"}


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, Path]:
    """A set of one problem, without the rendezvous, and a baseline of it."""
    monkeypatch.setattr(regression, "rendezvous_documents", list)
    problems, baseline = tmp_path / "set.json", tmp_path / "baseline.json"
    problems.write_text(json.dumps([quadratic("one")]))
    assert regression.main([str(problems), "--baseline", str(baseline), "--write"]) == 0
    return str(problems), baseline


def test_a_second_run_moves_nothing(files: tuple[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    problems, baseline = files
    kept = read_baseline(baseline)["one"]
    assert kept.objective == pytest.approx(0.5 * 0.7615941559557649, abs=1e-9)  # tanh(1) / 2
    assert kept.costates == pytest.approx({"x": 0.7615941559557649}, abs=1e-6)
    assert kept.magnitudes == pytest.approx({"x": 1.0})
    assert (kept.status, kept.failed) == ("optimal", ())
    assert regression.main([problems, "--baseline", str(baseline)]) == 0
    assert "1 problems compared: nothing moved" in capsys.readouterr().out


def test_what_moved_is_named(files: tuple[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    problems, baseline = files
    text = baseline.read_text()
    results = json.loads(text)
    results["problems"][0]["objective"] *= 1 + 1e-8
    baseline.write_text(json.dumps(results))
    assert regression.main([problems, "--baseline", str(baseline)]) == 1
    out = capsys.readouterr().out
    assert "1 moved" in out and "objective, by 1.0e-08" in out and "MOVED" in out
    results = json.loads(text)
    results["problems"][0]["iterations"] += 10
    baseline.write_text(json.dumps(results))
    assert regression.main([problems, "--baseline", str(baseline)]) == 0
    assert "shown only" in capsys.readouterr().out


# --- the baseline -------------------------------------------------------------------------------------


def test_the_baseline_holds_the_ten_optima_of_the_rendezvous() -> None:
    kept = read_baseline(BASELINE)
    documents = regression.rendezvous_documents()
    assert len(documents) == 10
    for document in documents:
        found = kept[document["name"]]
        known = rendezvous.REFERENCE[document["case"], document["equation"]]["exact"]
        assert found.objective == pytest.approx(known.value, abs=1e-10)
        assert (found.status, found.failed, found.inconclusive) == ("optimal", (), ())
        assert found.costates is not None and len(found.costates) == 12
