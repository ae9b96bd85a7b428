"""Contacts of controls in which the Hamiltonian is linear: arcs on limits, and bangs beside singular arcs."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.planning import ArcKind
from problems.robots import quadrotor

LENGTH, BELOW, RADIUS = 6.0, 0.4, 1.0
"""The way; how far below its middle the disc's centre lies, and its radius, m."""


def way_past_a_disc() -> go.Problem:
    """The shortest way of a car whose turns are bounded: its limit S = p.p - r^2 is of second order."""
    car = go.Model("car")
    p, heading = car.state("p", 2, unit="m"), car.state("heading", unit="rad")
    turn = car.control("turn", unit="rad/s")
    car.ode({p: ca.vertcat(ca.cos(heading), ca.sin(heading)), heading: turn})
    problem, way = one_phase("past a disc", car, initial=0.0, final=(LENGTH, 3 * LENGTH), name="way")
    way.initial(p=[0.0, 0.0])
    way.final(p=[LENGTH, 0.0])
    way.bounds(turn=(-2.0, 2.0), heading=(-1.5, 1.5))
    way.path("disc", (p[0] - LENGTH / 2) ** 2 + (p[1] + BELOW) ** 2, lower=RADIUS**2)
    problem.minimize(way.final_time)
    return problem


def test_an_arc_between_singular_arcs() -> None:
    """Tangent, arc, tangent: a string around the disc. The turn jumps to where it holds the limit, and back."""
    solution = go.refine(go.solve(way_past_a_disc(), tol=None))
    assert solution.converged and go.verify(solution).ok
    distance = np.hypot(LENGTH / 2, BELOW)
    straight = np.sqrt(distance**2 - RADIUS**2)
    bend = np.pi / 2 - np.arctan2(BELOW, LENGTH / 2) - np.arccos(RADIUS / distance)
    assert solution.objective == pytest.approx(2 * (straight + RADIUS * bend), abs=1e-12)
    (held,) = [arc for arc in solution.structure if arc.channel == "disc"]
    assert held.kind is ArcKind.LOWER
    assert (held.start, held.end) == pytest.approx((straight, straight + 2 * bend), abs=1e-8)
    found = solution.phase().control("turn")(np.array([0.1, straight + bend, 6.0]))
    np.testing.assert_allclose(found.ravel(), [0.0, -1.0 / RADIUS, 0.0], atol=1e-9)


@pytest.mark.slow
def test_a_bang_within_a_singular_arc() -> None:
    """A mesh too coarse for it shows one singular arc, whose polynomial reaches the bound where the bang belongs.

    The time is that of the structure that a mesh of twice the segments shows.
    """
    solution = go.refine(go.solve(quadrotor.build(), tol=None))
    assert solution.converged and go.verify(solution).ok
    assert solution.objective == pytest.approx(1.2313192852, abs=1e-9)
    turns = [arc.kind for arc in solution.structure if arc.channel == "w"]
    up, singular, low = ArcKind.UPPER, ArcKind.SINGULAR, ArcKind.LOWER
    assert turns == [up, singular, low, singular, up]
