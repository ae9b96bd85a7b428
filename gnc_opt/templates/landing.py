"""Minimum-fuel landing of a rocket on the Moon with free ignition and final times.

Cost and dynamics are linear in the thrust, so that the optimal thrust is zero or maximum
(bang-bang). A fixed mesh resolves the switching time to the length of a segment only;
refinement detects the control structure and optimises the switching time.

Solve and verify with:   gnc-opt solve FILE --report report
Check the problem with:  gnc-opt check FILE
Options of build():      gnc-opt solve FILE --set height=2000
"""

from __future__ import annotations

import gnc_opt as go
from gnc_opt.plot import View

# Initial mesh: 20 segments of 3 points each.
MESH = "20x3"
# Animated 3-D view in the report (requires plotly: pip install "gnc_opt[report]").
VIEW = View(position="h", force="thrust")


def build(
    height: float = 1000.0,
    speed: float = -20.0,
    mass: float = 1000.0,
    max_thrust: float = 4000.0,
) -> go.Problem:
    """Return the problem; initial height in m, vertical velocity in m/s (positive upwards), mass in kg."""
    # Dynamics dx/dt = f(t, x, u, p).
    lander = go.Model("lander")
    h = lander.state("h", unit="m")
    v = lander.state("v", unit="m/s")
    m = lander.state("m", unit="kg")
    thrust = lander.control("thrust", unit="N")
    gravity = lander.parameter("gravity", 1.62, unit="m/s^2")
    exhaust = lander.parameter("exhaust", 3000.0, unit="m/s")
    lander.ode({h: v, v: thrust / m - gravity, m: -thrust / exhaust})

    # Boundary conditions and bounds. A number is a fixed value, a tuple (lower, upper) is a
    # range, None means no limit.
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
