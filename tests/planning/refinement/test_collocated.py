"""Flights as solutions on a mesh, against closed forms: what refining a bang-bang solution returns without a solve."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from testing.internals import Interval, Plan, Scheme, detect

import gnc_opt as go
from gnc_opt.planning.refinement.switching.collocated_flight import collocated
from gnc_opt.planning.refinement.switching.newton import settle


def pulled() -> go.Problem:
    """From 5 at rest to the origin in least time, x'' + x = u, |u| <= 1, and what half of u^2 adds up to."""
    model = go.Model("oscillator")
    q, v, u = model.state("q"), model.state("v"), model.control("u")
    model.ode({q: v, v: u - q})
    problem = go.Problem("oscillator")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=(0.1, 20.0))
    leg.initial(q=5.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(u=(-1.0, 1.0))
    leg.integral(0.5 * u**2, name="effort")
    problem.minimize(leg.final_time)
    return problem


def circles(t: np.ndarray, switches: np.ndarray, first: float) -> np.ndarray:
    """States under u = first, -first, ... : turns about (u, 0) in the phase plane."""
    found, begun, start, u = np.empty((2, t.size)), 0.0, np.array([5.0, 0.0]), first
    for end in [*switches, np.inf]:
        here = (t >= begun) & (t <= end)
        for k in [*np.flatnonzero(here), None]:
            turn = (end if k is None else t[k]) - begun
            if not np.isfinite(turn):
                break
            q, v = start[0] - u, start[1]
            there = np.array([u + q * np.cos(turn) + v * np.sin(turn), v * np.cos(turn) - q * np.sin(turn)])
            if k is not None:
                found[:, k] = there
        begun, start, u = end, there, -u
    return found


@pytest.fixture(scope="module", params=get_args(Scheme))
def refined(request: pytest.FixtureRequest) -> go.Solution:
    return go.solve(pulled(), mesh="10x3", scheme=request.param)


def test_nothing_is_left_to_solve_and_the_mesh_is_as_fine_as_was_asked_for(refined: go.Solution) -> None:
    assert refined.history is not None and refined.history.converged
    assert [p.iterations for p in refined.history.passes] == [0] and refined.history.final.error < 1e-9
    assert refined.status is go.Status.OPTIMAL and str(refined.phase().mesh) in refined.provenance["mesh"]
    assert go.verify(refined).minimum


def test_states_costates_and_cost_are_those_of_the_closed_form(refined: go.Solution) -> None:
    """Arcs of pi between the switches; lam_v is a sine that vanishes there, H = 0 its size."""
    leg = refined.phase()
    switches = np.array([arc.end for arc in refined.structure[:-1]])
    assert np.diff(switches) == pytest.approx(np.pi, abs=1e-8)
    t = np.linspace(0.0, leg.final_time, 300)
    assert leg.x(t) == pytest.approx(circles(t, switches, -1.0), abs=1e-8)
    assert leg.x(leg.final_time, "left") == pytest.approx([0.0, 0.0], abs=1e-10)
    # 1 + lam_q v + lam_v (u - q) = 0 at the start, where v = 0 and u - q = -6: lam_v = 1/6 there.
    size = 1 / 6 / np.sin(switches[0])
    lam = np.stack([size * np.cos(switches[0] - t), size * np.sin(switches[0] - t)])
    assert leg.lam(t) == pytest.approx(lam, abs=1e-7)
    assert leg.point_costates == pytest.approx(leg.lam(leg.point_times), abs=1e-7)
    assert refined.objective == leg.final_time and leg.integral("effort") == pytest.approx(leg.final_time / 2)
    # A held start and end are worth the costates there; a bound on a control what moving it would gain.
    assert leg.state_impulses[:, 0] == pytest.approx(-lam[:, 0], abs=1e-7)
    assert leg.state_impulses[:, -1] + np.array([0.0, 1.0]) == pytest.approx(
        lam[:, -1] + [0.0, 1.0], abs=1e-7
    )
    assert leg.control_multipliers == pytest.approx(-leg.lam(leg.point_times)[1:], abs=1e-7)


@pytest.mark.parametrize(("slowest", "kept"), [(-5.0, True), (-4.05, True), (-4.03, False)])
def test_a_limit_that_the_flight_exceeds_leaves_no_solution(slowest: float, kept: bool) -> None:
    """The speed reaches -4.04 m/s."""
    solution = go.solve(pulled(), mesh="10x3", tol=None)
    (s,) = solution.samples().values()
    structure, flight = settle(solution, detect(s)) or pytest.fail("does not settle")
    least = float(np.min(flight.x[1]))
    assert least == pytest.approx(-4.04, abs=1e-3)
    box = Interval(np.array([-np.inf, slowest]), np.full(2, np.inf))
    limited = replace(flight, s=replace(s, leg=replace(s.leg, state_bounds=box)))
    assert (collocated(solution, limited, Plan.of(structure, 60.0)) is not None) is kept
