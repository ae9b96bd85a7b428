"""Results of solutions and verdicts that were checked once, in ``known_results.json``.

Results that change for a good reason are written anew: ``KNOWN_RESULTS=write python -m pytest TEST``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import gnc_opt as go

FILE = Path(__file__).with_suffix(".json")

Figures = Iterator[tuple[str, list[float], float]]
"""Names, numbers, and the size of differences that do not matter."""


def figures_of_verdict(verdict: go.Verdict) -> Figures:
    for c in verdict.conditions:
        yield f"{c.name}: {c.result.value}", [c.value, c.tolerance], 0.05 * abs(c.tolerance)
        yield f"loss by {c.name}", [] if c.loss is None else [c.loss], 1e-9


def figures_of_solution(solution: go.Solution) -> Figures:
    """Objective, arcs and costates, and the meshes and errors of the refinement."""
    yield "objective", [solution.objective, solution.objective_error.absolute_error], 1e-9
    for name, phase in solution.phases.items():
        span = phase.final_time - phase.initial_time
        lam = phase.lam(phase.initial_time + np.array([0.1, 0.35, 0.6, 0.85]) * span)
        yield f"costates, {name}", [*lam.ravel()], 1e-4 * float(np.max(np.abs(lam)))
    for arc in solution.structure:
        yield f"{arc.phase}, {arc.channel}: {arc.kind.value}", [arc.start, arc.end], 1e-5
    for k, step in enumerate(solution.history.passes if solution.history else ()):
        degrees = [float(n) for mesh in step.meshes.values() for n in mesh.degrees]
        yield f"iteration {k}, {step.stage}, {step.actions}", degrees, 0.0
        yield f"times of iteration {k}", [t for times in step.times.values() for t in times], 1e-4
        yield f"error of iteration {k}", [step.error], 0.05 * solution.history.tolerance


def assert_known(*results: go.Solution | go.Verdict) -> None:
    """Compare results with those of the test that calls it, to 0.2 %."""
    name = os.environ["PYTEST_CURRENT_TEST"].partition("::")[2].rpartition(" ")[0]
    known = json.loads(FILE.read_text(encoding="utf-8"))
    kinds = [figures_of_verdict if isinstance(r, go.Verdict) else figures_of_solution for r in results]
    found = [figure for figures, r in zip(kinds, results, strict=True) for figure in figures(r)]
    if os.environ.get("KNOWN_RESULTS") == "write":
        known[name] = [[what, *(float(f"{number:.6g}") for number in numbers)] for what, numbers, _ in found]
        lines = ",\n".join(f"{json.dumps(key)}: {json.dumps(known[key])}" for key in sorted(known))
        FILE.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")
    assert [what for what, *_ in found] == [what for what, *_ in known[name]]
    for (what, numbers, slack), (_, *expected) in zip(found, known[name], strict=True):
        assert numbers == pytest.approx(expected, rel=2e-3, abs=slack, nan_ok=True), what
