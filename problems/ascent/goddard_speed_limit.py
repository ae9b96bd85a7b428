r"""Goddard rocket with a speed limit: the highest ascent with limited speed.

The speed is at most a tenth of the circular orbital speed. This example shows a sequence of four different arcs: full
thrust, singular, on the state limit, and off. On the limit the thrust balances drag and weight.

States: ``h`` from the centre, ``v``, ``m``; units of the Earth's radius, gravity and the mass at lift-off; the unit of
time is √(R/g) = 806 s. Control: thrust ``u`` in shares of the largest.

.. math::
   \dot h = v, \qquad \dot v = \frac{T u - D}{m} - \frac{1}{h^2}, \qquad \dot m = -b T u, \qquad
   D = 310 \, v^2 e^{-500 (h - 1)}, \qquad v \le 0.1

Source: H. Seywald and E. M. Cliff, Goddard problem in presence of a dynamic pressure limit, J. Guidance 16 (1993)
776-781; in this form an example of BOCOP and of OptimalControl.jl, which gives 1.012576.
"""

from __future__ import annotations

import casadi as ca

import gnc_opt as go
from problems._example import Reference, example_main

MAX_THRUST, FLOW = 3.5, 2.0
"""Largest thrust T and mass flow b per thrust."""
DRAG, DECAY = 310.0, 500.0
MAX_SPEED, EMPTY = 0.1, 0.6


def build(max_speed: float = MAX_SPEED) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    max_speed : float
    """
    rocket = go.Model("sounding rocket")
    h, v, m = rocket.state("h"), rocket.state("v"), rocket.state("m")
    u = rocket.control("u")
    drag = DRAG * v**2 * ca.exp(-DECAY * (h - 1))
    rocket.ode({h: v, v: (MAX_THRUST * u - drag) / m - 1 / h**2, m: -FLOW * MAX_THRUST * u})

    problem = go.Problem("Goddard rocket with a speed limit", time_unit="√(R/g)")
    ascent = problem.phase("ascent", rocket)
    ascent.time(initial=0.0, final=(0.05, 1.0))
    ascent.initial(h=1.0, v=0.0, m=1.0)
    ascent.final(m=EMPTY)
    ascent.bounds(h=(1.0, None), v=(0.0, max_speed), m=(EMPTY, 1.0), u=(0.0, 1.0))
    problem.maximize(ascent.final_state("h"))
    return problem


REFERENCE = Reference(1.0125763, "independent Radau collocation converges to it; 1.012576 published", 1e-6)


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
