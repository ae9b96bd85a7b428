r"""Planar quadrotor: minimum-time flight past two discs or through a gate.

A planar quadrotor flies 6 m to the side, from rest to rest. This example shows bang-singular arcs and keep-out discs.
Thrust and rate of turn are the controls. Thrust is at one of its limits, the rate too except for an arc on which H
does not depend on it. The path touches a disc at an instant or along an arc; the gate is a point between two phases.

States: ``p`` (m), ``v`` (m/s), sideways and up, ``theta`` (rad). Controls: ``F`` (m/s^2), 1 to 20, ``w`` (rad/s),
within 10.

.. math::
   \dot p = v, \qquad \dot v = F\,(\sin\theta, \cos\theta)^T - (0, g)^T, \qquad \dot\theta = \omega

Source of the model: Hehn, Ritz and D'Andrea, Performance benchmarking of quadrotor systems using time-optimal
control, Autonomous Robots 33, 2012.
"""

from __future__ import annotations

import casadi as ca

import gnc_opt as go
from gnc_opt.plot import View
from problems._example import Reference, example_main

GRAVITY = 9.81
"""m/s^2."""
DISCS = ((2.0, 0.6, 0.9), (4.2, -0.5, 0.9))
"""Centre and radius of each, m."""
GATE = (3.0, 1.2)
"""m."""


def build(discs: bool = False, gate: bool = False) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    discs : bool
        Whether `DISCS` have to be kept out of.
    gate : bool
        Whether it has to pass through `GATE`.
    """
    quadrotor = go.Model("planar quadrotor")
    p = quadrotor.state("p", 2, unit="m")
    v = quadrotor.state("v", 2, unit="m/s")
    theta = quadrotor.state("theta", unit="rad")
    F = quadrotor.control("F", unit="m/s^2")
    w = quadrotor.control("w", unit="rad/s")
    quadrotor.ode({p: v, v: ca.vertcat(F * ca.sin(theta), F * ca.cos(theta) - GRAVITY), theta: w})

    problem = go.Problem("quadrotor to the side")
    legs = [problem.phase(name, quadrotor) for name in (("to_gate", "on") if gate else ("flight",))]
    for leg in legs:
        leg.time(initial=0.0 if leg is legs[0] else (0.1, 10.0), final=(0.2, 10.0))
        leg.bounds(F=(1.0, 20.0), w=(-10.0, 10.0), theta=(-3.2, 3.2))
        for k, (x, y, radius) in enumerate(DISCS if discs else ()):
            leg.path(f"disc {k + 1}", (p[0] - x) ** 2 + (p[1] - y) ** 2, lower=radius**2)
    if gate:
        problem.link(*legs)
        legs[0].final(p=list(GATE))
    legs[0].initial(p=[0.0, 0.0], v=[0.0, 0.0], theta=0.0)
    legs[-1].final(p=[6.0, 0.0], v=[0.0, 0.0], theta=0.0)
    problem.minimize(legs[-1].final_time)
    return problem


REFERENCE = Reference(1.2313192852, "bang-singular structure optimised from two meshes", 1e-8, "s")

VARIANTS = {
    "past two discs": (
        {"discs": True},
        Reference(1.4809272369, "structure optimised from two meshes", 1e-8, "s"),
    ),
    "past two discs, through a gate": (
        {"discs": True, "gate": True},
        Reference(1.556635263, "structure optimised from two meshes", 1e-8, "s"),
    ),
}
"""Other data, with their references."""

VIEW = View("p")
"""What a report shows moving."""


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
