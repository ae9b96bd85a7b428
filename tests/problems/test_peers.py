"""What programs are compared on: the same dynamics for all, and the fastest right answer of each."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.performance.peers.compare import ahead, best
from problems.rendezvous import CASES, build, chaser_model

PLAIN = Path(__file__).parents[2] / "benchmarks" / "performance" / "peers" / "plain.py"


@pytest.fixture(scope="module")
def plain() -> Any:
    spec = importlib.util.spec_from_file_location("plain", PLAIN)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_plain_rates_are_those_of_the_model(plain: Any) -> None:
    model, random = chaser_model(), np.random.default_rng(5)
    x, u = random.normal(size=12), random.normal(size=6) * np.array(plain.LIMITS)
    found = np.array(plain.rates(list(x), list(u)))
    assert found == pytest.approx(model.f(0.0, x, u), rel=1e-13, abs=1e-15)


@pytest.mark.parametrize("case", CASES)
def test_plain_ends_and_limits_are_those_of_the_problem(plain: Any, case: int) -> None:
    leg = build(case).get_phase()
    first, last = plain.ends(case)
    assert first == pytest.approx(leg.numbers.initial.lower) and last == pytest.approx(
        leg.numbers.final.upper
    )
    assert pytest.approx(leg.numbers.controls.upper) == plain.LIMITS and leg.numbers.states.upper[3] == 1.0


def test_a_program_counts_with_its_fastest_right_answer() -> None:
    ways = {
        "coarse": {1: {"s": 0.1, "error": 1e-3}, 2: {"s": 0.3, "error": 1e-5}},
        "fine": {1: {"s": 1.0, "error": 1e-7}, 2: {"s": 2.0, "error": 1e-7}},
        "broken": {1: {"s": 0.01, "error": 1e-9}, 2: {"failed": "no"}},
    }
    assert best(ways, [1, 2], 1e-3) == (pytest.approx(0.2), "coarse")
    assert best(ways, [1, 2], 1e-4) == (pytest.approx(1.5), "fine")
    assert best(ways, [1], 1e-8) == (0.01, "broken") and best(ways, [1, 2], 1e-8) is None
    mine = {"all": {1: {"s": 0.05, "error": 1e-9}}}
    assert ahead({"gnc_opt": mine, "other": {"a": ways["coarse"]}}, [1])
    assert not ahead({"gnc_opt": mine, "other": {"b": ways["broken"]}}, [1])
    assert not ahead({"gnc_opt": {"b": ways["coarse"]}, "other": {}}, [1])  # nobody is right to 1e-8
