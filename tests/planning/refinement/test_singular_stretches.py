"""Bangs that stand in for singular arcs, beside long bangs whose switching function is small, too.

A planar quadrotor goes round a pole in the least time. Each rotor has a short singular arc next to a bang along which
its switching function stays below a hundredth of H. With B = -lambda_vx sin(theta) + lambda_vz cos(theta) and
A = lambda_vx cos(theta) + lambda_vz sin(theta) the switching functions are B / m -+ l lambda_w / J, and their second
time derivatives vanish where the thrust is

    f = +- J / (2 A l) (c B' - w A' + w (lambda_x cos(theta) + lambda_z sin(theta))).
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.models import one_phase

import gnc_opt as go
from gnc_opt import ArcKind
from gnc_opt.array_types import Array

MASS, INERTIA, ARM, DRAG, GRAVITY = 0.5, 4e-3, 0.15, 0.05, 9.81


@pytest.fixture(scope="module")
def solution() -> go.Solution:
    quad = go.Model("planar quadrotor")
    x, z, theta, vx, vz, w = (quad.state(name) for name in ("x", "z", "theta", "vx", "vz", "w"))
    f = quad.control("f", 2, unit="N")
    thrust = ca.sum1(f) / MASS
    quad.ode(
        {
            x: vx,
            z: vz,
            theta: w,
            vx: -thrust * ca.sin(theta) - DRAG * vx,
            vz: thrust * ca.cos(theta) - GRAVITY - DRAG * vz,
            w: ARM / INERTIA * (f[1] - f[0]),
        }
    )
    ocp, leg = one_phase("round a pole", quad, initial=0.0, final=(0.5, 10.0))
    leg.initial(x=0.0, z=0.0, theta=0.0, vx=0.0, vz=0.0, w=0.0)
    leg.final(x=4.0, z=0.0, theta=0.0, vx=0.0, vz=0.0, w=0.0)
    leg.bounds(f=([0.3, 0.3], [5.0, 5.0]))
    leg.path("pole", (x - 2.0) ** 2 + (z + 0.2) ** 2, lower=0.6**2)
    ocp.minimize(leg.final_time)
    return go.solve(ocp, mesh="60x3")


def singular_thrust(solution: go.Solution, rotor: int, t: Array) -> Array:
    """Return the thrust at which the second derivative of the rotor's switching function vanishes."""
    theta, w = solution.state("theta")(t), solution.state("w")(t)
    px, pz, pu, pw = (solution.costate(name)(t) for name in ("x", "z", "vx", "vz"))
    along, across = px * np.cos(theta) + pz * np.sin(theta), px * np.sin(theta) - pz * np.cos(theta)
    a, b = pu * np.cos(theta) + pw * np.sin(theta), -pu * np.sin(theta) + pw * np.cos(theta)
    a_rate, b_rate = w * b + DRAG * a - along, -w * a + DRAG * b + across
    sign = 2 * rotor - 1
    return np.ravel(sign * INERTIA / (2 * a * ARM) * (DRAG * b_rate - w * a_rate + w * along))


@pytest.mark.slow
def test_only_the_bangs_that_stand_in_for_a_singular_arc_make_room_for_it(solution: go.Solution) -> None:
    assert solution.converged and go.verify(solution).ok
    singular = [arc for arc in solution.structure if arc.kind is ArcKind.SINGULAR]
    assert sorted(arc.channel for arc in singular) == ["f[0]", "f[1]"]
    for arc in singular:
        assert arc.end - arc.start < 0.05
        t = arc.start + (arc.end - arc.start) * np.linspace(0.15, 0.85, 10)
        rotor = int(arc.channel == "f[1]")
        thrust = solution.control("f")(t)[rotor]
        np.testing.assert_allclose(thrust, singular_thrust(solution, rotor, t), atol=2e-2)
    # A mesh of 150 segments comes to 1.182453, twenty bangs in place of the arcs to 1.18244040.
    assert solution.objective == pytest.approx(1.18244010, abs=2e-7)
