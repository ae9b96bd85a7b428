"""Minimum-effort motion of a cart with drag from rest to rest.

Solve and verify with:   gnc-opt solve FILE --report report
Check the problem with:  gnc-opt check FILE
Options of build():      gnc-opt solve FILE --set distance=2
"""

from __future__ import annotations

import gnc_opt as go

# Initial mesh: 8 segments of 4 points each.
MESH = "8x4"


def build(distance: float = 1.0, duration: float = 2.0) -> go.Problem:
    """Return the problem; distance in m, duration in s."""
    # Dynamics dx/dt = f(t, x, u, p), in CasADi expressions such as casadi.sin(q).
    # A vector has a size: cart.state("r", 3, unit="m").
    cart = go.Model("cart")
    q = cart.state("q", unit="m")
    v = cart.state("v", unit="m/s")
    a = cart.control("a", unit="m/s^2")
    drag = cart.parameter("drag", 0.3, unit="1/m")
    cart.ode({q: v, v: a - drag * v**2})

    # Boundary conditions and bounds. A number is a fixed value, a tuple (lower, upper) is a
    # range, None means no limit.
    problem = go.Problem("least effort")
    leg = problem.phase("leg", cart)
    leg.time(initial=0.0, final=duration)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=distance, v=0.0)
    leg.bounds(a=(-10.0, 10.0))
    # leg.path("power", a * v, upper=1.0)   # path constraint
    # leg.guess([0.0, duration], a=0.5)     # initial guess

    # Cost. For minimum time: problem.minimize(leg.final_time).
    problem.minimize(leg.integral(a**2, "effort"))
    return problem


if __name__ == "__main__":
    solution = go.solve(build(), mesh=MESH, tol=1e-8)
    print(solution)
    print(go.verify(solution).explain())
