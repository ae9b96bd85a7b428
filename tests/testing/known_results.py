"""Results of solutions and verdicts that were checked once, in ``known_results.json``."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import gnc_opt as go
from testing.internals import (
    Scales,
    build_next_mesh,
    detect_arc_structures,
    estimate_segment_errors,
    find_active_constraint_multipliers,
    find_kinks_in_segment,
)

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
    yield from figures_of_analysis(solution)


def figures_of_analysis(solution: go.Solution) -> Figures:
    """Reference magnitudes, estimated errors, the next mesh of a refinement, and the structure that is detected."""
    samples = solution.samples()
    scales = Scales.from_solution(solution, [*samples.values()])
    errors = estimate_segment_errors(solution)
    figures = {"cost": [[scales.cost, scales.change_of_cost], scales.parameters]}
    figures |= {f"ends, {share}": list(terms) for share, terms in scales.boundary.items()}
    for name, s in samples.items():
        own, error, widths = scales.phases[name], errors[name], scales.phases[name].deviation
        figures[f"deviations, {name}"] = [widths.mean(axis=1), widths.max(axis=1), own.control_cost]
        reach = (own.start, own.along, own.end)
        figures[f"reach, {name}"] = [
            v for ellipsoid in reach for v in (ellipsoid.radius, ellipsoid.semi_axes)
        ]
        figures[f"variables, {name}"] = [s.state_scale, s.control_span, s.control_scale, s.path_scale]
        figures[f"cost and H, {name}"] = [[s.cost_scale, s.hamiltonian_scale, s.max_hamiltonian_change]]
        figures[f"errors, {name}"] = [np.fmax(error.stacked_segment_errors, 1e-9).max(axis=1)]
        active = find_active_constraint_multipliers(error)
        kinks = [find_kinks_in_segment(error, k, active) for k in range(s.phase.mesh.segments)]
        figures[f"kinks, {name}"] = [[kink.start, kink.end] for found in kinks for kink in found] or [[]]
        mesh, actions = build_next_mesh(error, 1e-6)
        figures[f"next mesh, {name}: {actions}"] = [mesh.degrees, mesh.breaks]
    for name, structure in detect_arc_structures(solution).items():
        kinds = "; ".join(" ".join(kind.value for kind in row) for row in structure.kinds)
        figures[f"structure, {name}: {kinds}"] = [structure.times]
    for what, parts in figures.items():
        numbers = np.concatenate([np.ravel(part).astype(float) for part in parts])
        finite = np.abs(numbers[np.isfinite(numbers)])
        yield what, numbers.tolist(), 1e-5 * float(np.max(finite, initial=1e-9))


def assert_known(*results: go.Solution | go.Verdict) -> None:
    """Compare results with those of the test that calls it, to 0.2 %."""
    test = os.environ["PYTEST_CURRENT_TEST"].rpartition(" ")[0]
    name = test.partition("::")[2]
    known = json.loads(FILE.read_text(encoding="utf-8"))
    found = []
    for r in results:
        found += figures_of_verdict(r) if isinstance(r, go.Verdict) else figures_of_solution(r)
    if os.environ.get("KNOWN_RESULTS") == "write":
        known[name] = [[what, *(float(f"{number:.5g}") for number in numbers)] for what, numbers, _ in found]
        lines = ",\n".join(f"{json.dumps(key)}: {json.dumps(known[key])}" for key in sorted(known))
        FILE.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")
    remedy = f"if that is meant, write the results anew: KNOWN_RESULTS=write python -m pytest '{test}'"
    assert [what for what, *_ in found] == [what for what, *_ in known.get(name, [])], remedy
    for (what, numbers, slack), (_, *expected) in zip(found, known[name], strict=True):
        assert numbers == pytest.approx(expected, rel=2e-3, abs=slack, nan_ok=True), f"{what}; {remedy}"
