"""Performance profiles: the curves by hand, and a problem with a closed form by two of the programs."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

import gnc_opt as go
from benchmarks.performance.profile import compare, documents
from benchmarks.validation.problem_set.reader import build_problem


def row(program: str, problem: str, objective: float | None, seconds: float = 1.0) -> dict[str, object]:
    told = {"failed": "diverged"} if objective is None else {"objective": objective, "seconds": seconds}
    return {"program": program, "way": "", "problem": problem, "reference": 2.0, "tolerance": 0.0, **told}


def test_curves_are_shares_of_problems_within_a_factor_of_the_least_time() -> None:
    rows = [
        row("a", "one", 2.0, 1.0),
        row("b", "one", 2.0001, 3.0),
        row("a", "two", 2.1, 1.0),
        row("b", "two", 2.0, 8.0),  # a is wrong
        row("a", "three", None),
        row("b", "three", None),
        row("a", "four", 2.0, 5.0),  # b has not tried it
    ]
    curves = compare.ratios(rows, 1e-3)
    assert curves == {("a", ""): [1.0, math.inf, math.inf], ("b", ""): [3.0, 1.0, math.inf]}
    assert compare.share_within(curves["b", ""], 1.0) == pytest.approx(1 / 3)
    assert compare.share_within(curves["b", ""], 3.0) == pytest.approx(2 / 3)
    assert compare.ratios(rows, 1e-6)["b", ""] == [math.inf, 1.0, math.inf]
    solved, fastest, near = ([cells[:2] for cells in each] for _, each in compare.tables(rows))
    assert solved == [("a, ", "1"), ("b, ", "2")]
    assert fastest == [("a, ", "33"), ("b, ", "33")] and near == [("a, ", "33"), ("b, ", "67")]


def test_programs_solve_a_problem_of_the_set(tmp_path: Path) -> None:
    """Least energy of the double integrator from rest to rest: J = 6. Maximising its negative is the same."""
    ends, free = (("x", "2*h"), ("v", 0)), {"lb": None, "ub": None}
    states = [{"name": name, "x0": 0, "xf": end, **free} for name, end in ends]
    phase = {"t0": 0, "tf": 1, "tguess": None, "path": [], "aux": {"a": "u"}, "ode": {"x": "v", "v": "a"}}
    phase["states"] = states
    phase |= {"controls": [{"name": "u", **free}], "integrals": {"J": "-h*u**2"}}
    document = {"name": "di_min_energy", "constants": {"h": "1/2"}, "parameters": [], "phases": [phase]}
    document |= {"events": [], "objective": "J_1", "sense": "max", "reference": -6.0}
    document["reference_uncertainty"] = 1e-12
    path, out = tmp_path / "set.json", tmp_path / "rows.json"
    path.write_text(json.dumps([document]), encoding="utf-8")
    given = ["--set", str(path), "--groups", "--programs", "gnc_opt", "casadi", "--json", str(out)]
    assert compare.main([*given, "--figure", str(tmp_path / "profile.svg")]) == 0
    rows = json.loads(out.read_text(encoding="utf-8"))
    assert len(rows) == 5 and all(each["objective"] == pytest.approx(-6.0, rel=1e-7) for each in rows)
    assert (tmp_path / "profile.svg").stat().st_size > 1000


@pytest.mark.parametrize("name", ["heading_reversal", "double_oscillator"])
def test_scaled_document_of_a_flagship_problem_has_its_optimum(name: str) -> None:
    (document,) = documents.documents(["flagship"], [name])
    solution = go.solve(build_problem(document), check=False)
    assert document["reference"] == 1.0
    assert solution.objective == pytest.approx(1.0, abs=document["reference_uncertainty"])
