"""Arcs of state limits that begin or end with a phase, and phases without controls: closed forms by hand."""

from __future__ import annotations

import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.planning import ArcKind

DRAG, TOP = 0.1, 0.6
COAST = 0.3
"""Shortest coast, and shortest push and brake, s; any longer coast is worse."""


def carriage(name: str, drag: float | None = None) -> go.Model:
    """A double integrator with |u| <= 1, or without its control, slowed by its drag."""
    model = go.Model(name)
    x, v = model.state("x"), model.state("v")
    model.ode({x: v, v: model.control("u") if drag is None else -drag * v})
    return model


def push_coast_brake() -> go.Problem:
    """Least time over 1 m with v <= TOP while pushing and braking, but not along the coast between."""
    problem = go.Problem("carriage")
    push, coast, brake = (
        problem.phase(name, carriage(name, DRAG if name == "coast" else None))
        for name in ("push", "coast", "brake")
    )
    problem.sequence(push, coast, brake, durations=dict.fromkeys(("push", "coast", "brake"), (COAST, 3.0)))
    push.initial(x=0.0, v=0.0)
    brake.final(x=1.0, v=0.0)
    push.bounds(u=(-1.0, 1.0))
    brake.bounds(u=(-1.0, 0.0))  # to speed up once more is as good for an instant, and a local minimum
    for leg in (push, brake):
        leg.bounds(v=(-TOP, TOP))
    problem.minimize(brake.final_time)
    return problem


def least_time() -> float:
    """Up to TOP, along it, slowed by drag, and down: what is left of 1 m is flown at TOP."""
    slowed = TOP * np.exp(-DRAG * COAST)
    others = TOP**2 / 2 + (TOP - slowed) / DRAG + slowed**2 / 2
    return float(TOP + (1.0 - others) / TOP + COAST + slowed)


def test_an_arc_may_end_with_its_phase() -> None:
    solution = go.solve(push_coast_brake())
    assert solution.converged and solution.objective == pytest.approx(least_time(), abs=1e-8)
    push = solution.phase("push")
    assert push.x(push.final_time)[1] == pytest.approx(TOP, abs=1e-8)
    (arc,) = [a for a in solution.structure if a.channel == "v"]
    assert arc.kind is ArcKind.UPPER and arc.phase == "push"
    assert (arc.start, arc.end) == pytest.approx((TOP, push.final_time), abs=1e-7)
