r"""Two-link arm: a minimum-time motion of a robot with two rods.

This example shows bang-bang control of coupled joints: each motor has its own switching times, which are optimised.

States: ``rate_1``, ``rate_2`` (rad/s), of the rods, ``elbow``, ``shoulder`` (rad). Controls: ``u_1``, ``u_2``,
torques, -1 to 1. Lengths and masses are 1.

Source: Luus, Iterative Dynamic Programming, 2000, section 12.4.2; the PSOPT manual prints 2.98323 s, of a mesh that
meets no switch.
"""

from __future__ import annotations

import casadi as ca

import gnc_opt as go
from problems._example import Reference, example_main


def build() -> go.Problem:
    """Return the problem."""
    arm = go.Model("two-link arm")
    rate_1, rate_2 = (arm.state(name, unit="rad/s") for name in ("rate_1", "rate_2"))
    elbow, shoulder = (arm.state(name, unit="rad") for name in ("elbow", "shoulder"))
    u_1, u_2 = arm.control("u_1"), arm.control("u_2")
    s, c = ca.sin(elbow), ca.cos(elbow)
    inertia = 31 / 36 + 9 / 4 * s**2
    first = s * (9 / 4 * c * rate_1**2 + 2 * rate_2**2) + 4 / 3 * (u_1 - u_2) - 3 / 2 * c * u_2
    second = s * (7 / 2 * rate_1**2 + 9 / 4 * c * rate_2**2) - 7 / 3 * u_2 + 3 / 2 * c * (u_1 - u_2)
    arm.ode({rate_1: first / inertia, rate_2: -second / inertia, elbow: rate_2 - rate_1, shoulder: rate_1})

    problem = go.Problem("two-link arm")
    move = problem.phase("move", arm)
    move.time(initial=0.0, final=(1.0, 10.0))
    move.initial(rate_1=0.0, rate_2=0.0, elbow=0.5, shoulder=0.0)
    move.final(rate_1=0.0, rate_2=0.0, elbow=0.5, shoulder=0.522)
    move.bounds(u_1=(-1.0, 1.0), u_2=(-1.0, 1.0))
    problem.minimize(move.final_time)
    return problem


REFERENCE = Reference(2.9822799425, "independent: three switch times and the end by shooting", 1e-9, "s")


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
