"""A vehicle in the plane flies to its goal by way of a waypoint, with the least effort.

Phases follow each other: each has its model, its times and its limits, and a link joins
the end of one with the beginning of the next. When the waypoint is passed is free.

Solve and verify with:   gnc-opt solve FILE --report report
Look for mistakes with:  gnc-opt check FILE
Options of build():      gnc-opt solve FILE --set duration=5
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

import gnc_opt as go
from gnc_opt.plot import View

# The mesh to begin with, for each phase: 6 segments of 4 points.
MESH = "6x4"
# What the report shows moving in three dimensions (with plotly: pip install "gnc_opt[report]").
VIEW = View(position="r", force="a")


def build(
    waypoint: Sequence[float] = (1.0, 1.0),
    goal: Sequence[float] = (3.0, 0.0),
    duration: float = 4.0,
) -> go.Problem:
    """Return the problem; places in m, duration of the whole flight in s."""
    # The dynamics dx/dt = f(t, x, u, p), once for both phases. Another phase may have
    # another model; states of the same name are then linked.
    vehicle = go.Model("point mass in the plane")
    r = vehicle.state("r", 2, unit="m")
    v = vehicle.state("v", 2, unit="m/s")
    a = vehicle.control("a", 2, unit="m/s^2")
    vehicle.ode({r: v, v: a})

    # A number or a list is a fixed value, a tuple (lower, upper) is a range.
    problem = go.Problem("by way of a waypoint")
    out = problem.phase("out", vehicle)
    out.time(initial=0.0, final=(0.1 * duration, 0.9 * duration))
    out.initial(r=0.0, v=0.0)
    out.final(r=list(waypoint))

    on = problem.phase("on", vehicle)
    on.time(initial=(0.1 * duration, 0.9 * duration), final=duration)
    on.final(r=list(goal), v=0.0)

    # Time and all states go on from one phase to the next. A jump of a state, such as the mass of a dropped
    # stage, is given by jump={"m": -200.0}.
    problem.link(out, on)

    for leg in (out, on):
        leg.bounds(a=([-10.0, -10.0], [10.0, 10.0]))
    effort = [leg.integral(ca.sumsqr(a), "effort") for leg in (out, on)]
    problem.minimize(effort[0] + effort[1])
    return problem


if __name__ == "__main__":
    solution = go.solve(build(), mesh=MESH, tol=1e-8)
    print(solution)
    print(go.verify(solution).explain())
