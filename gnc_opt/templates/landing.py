"""A rocket lands on the Moon with the least fuel: when to light the engine?

Cost and dynamics are linear in the thrust, hence the best thrust is none or all there is
(bang-bang). A mesh alone finds the switch only to the width of a segment; refined, the
structure of the control is recognised and the time of the switch is found.

Solve and verify with:   gnc-opt solve FILE --report report
Look for mistakes with:  gnc-opt check FILE
Options of build():      gnc-opt solve FILE --set height=2000
"""

from __future__ import annotations

import gnc_opt as go
from gnc_opt.plot import View

# The mesh to begin with: 20 segments of 3 points each.
MESH = "20x3"
# What the report shows moving in three dimensions (with plotly: pip install "gnc_opt[report]").
VIEW = View(position="h", force="thrust")


def build(
    height: float = 1000.0,
    speed: float = -20.0,
    mass: float = 1000.0,
    max_thrust: float = 4000.0,
) -> go.Problem:
    """Return the problem; at the start: height in m, speed in m/s (upwards), mass in kg."""
    # The dynamics dx/dt = f(t, x, u, p), once.
    lander = go.Model("lander")
    h = lander.state("h", unit="m")
    v = lander.state("v", unit="m/s")
    m = lander.state("m", unit="kg")
    thrust = lander.control("thrust", unit="N")
    gravity = lander.parameter("gravity", 1.62, unit="m/s^2")
    exhaust = lander.parameter("exhaust", 3000.0, unit="m/s")
    lander.ode({h: v, v: thrust / m - gravity, m: -thrust / exhaust})

    # What to achieve. A number is a fixed value, a tuple (lower, upper) is a range, None
    # leaves an end of it open.
    problem = go.Problem("landing with the least fuel")
    descent = problem.phase("descent", lander)
    descent.time(initial=0.0, final=(10.0, 200.0))
    descent.initial(h=height, v=speed, m=mass)
    descent.final(h=0.0, v=0.0)
    descent.bounds(thrust=(0.0, max_thrust), m=(0.5 * mass, None))

    problem.maximize(descent.final_state("m"))
    return problem


if __name__ == "__main__":
    solution = go.solve(build(), mesh=MESH, tol=1e-8)
    print(solution)
    print(go.verify(solution).explain())
