"""Minimum-effort trajectory of a vehicle in the plane through a waypoint.

Each phase has its own model, times and limits. A link equates the final time and states
of one phase with the initial ones of the next. The time of the waypoint is free.

Solve and verify with:   gnc-opt solve FILE --report report
Check the problem with:  gnc-opt check FILE
Options of build():      gnc-opt solve FILE --set duration=5
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

import gnc_opt as go
from gnc_opt.plot import View

# Initial mesh, for each phase: 6 segments of 4 points.
MESH = "6x4"
# Animated 3-D view in the report (requires plotly: pip install "gnc_opt[report]").
VIEW = View(position="r", force="a")


def build(
    waypoint: Sequence[float] = (1.0, 1.0),
    goal: Sequence[float] = (3.0, 0.0),
    duration: float = 4.0,
) -> go.Problem:
    """Return the problem; positions in m, total duration in s."""
    # Dynamics dx/dt = f(t, x, u, p) of both phases. Phases may have different models; a link
    # then applies to the states with equal names.
    vehicle = go.Model("point mass in the plane")
    r = vehicle.state("r", 2, unit="m")
    v = vehicle.state("v", 2, unit="m/s")
    a = vehicle.control("a", 2, unit="m/s^2")
    vehicle.ode({r: v, v: a})

    # A number or a list is a fixed value, a tuple (lower, upper) is a range.
    problem = go.Problem("waypoint")
    out = problem.phase("out", vehicle)
    out.time(initial=0.0, final=(0.1 * duration, 0.9 * duration))
    out.initial(r=0.0, v=0.0)
    out.final(r=list(waypoint))

    on = problem.phase("on", vehicle)
    on.time(initial=(0.1 * duration, 0.9 * duration), final=duration)
    on.final(r=list(goal), v=0.0)

    # Time and all states are continuous between the phases. A jump of a state, such as the mass
    # of a jettisoned stage, is given by jump={"m": -200.0}.
    problem.link(out, on)

    for phase in (out, on):
        phase.bounds(a=([-10.0, -10.0], [10.0, 10.0]))
    effort = [phase.integral(ca.sumsqr(a), "effort") for phase in (out, on)]
    problem.minimize(effort[0] + effort[1])
    return problem


if __name__ == "__main__":
    solution = go.solve(build(), mesh=MESH, tol=1e-8)
    print(solution)
    print(go.verify(solution).explain())
