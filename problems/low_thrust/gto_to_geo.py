r"""GTO to GEO in minimum time: a low-thrust spiral of a satellite of 1.5 t.

The thrust is 24 N. This example shows equinoctial elements, which have no singularity at small inclination and
eccentricity, and other minima: each number of revolutions has its own. `gnc_opt.solve` ends at a local minimum of
58.35 h; `gnc_opt.multistart` finds 34.7168 h.

States: ``P`` (Mm), ``ex``, ``ey``, ``hx``, ``hy``, longitude ``L`` (rad), ``m`` (kg). Control: vector ``u`` of length
at most 1, the thrust in radial, tangential and normal direction over its largest value. With
:math:`W = 1 + e_x \cos L + e_y \sin L`, :math:`Z = h_x \sin L - h_y \cos L`, :math:`C = 1 + h_x^2 + h_y^2` and
accelerations q, s, w,

.. math::
   \dot P = \frac{2 P}{W} \sqrt{\tfrac{P}{\mu}} s, \quad
   \dot e_x = \sqrt{\tfrac{P}{\mu}} \Big( \sin L \, q + \big(\cos L + \tfrac{e_x + \cos L}{W}\big) s
   - \tfrac{Z e_y}{W} w \Big)

.. math::
   \dot h_x = \sqrt{\tfrac{P}{\mu}} \frac{C \cos L}{2 W} w, \quad
   \dot L = \sqrt{\tfrac{\mu}{P^3}} W^2 + \sqrt{\tfrac{P}{\mu}} \frac{Z}{W} w, \quad \dot m = -\beta \|T\|

and ey, hy likewise.

Source: J. B. Caillau, J. Gergaud and J. Noailles, 3D geosynchronous transfer of a satellite: continuation on the
thrust, J. Optimization Theory and Applications 118 (2003) 541-565, which gives 34.716 h for 24 N.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

HOUR = 3600.0
"""s."""
MU = 398600.47 * HOUR**2 / 1e9
"""Mm^3/h^2."""
THRUST = 24.0
"""N."""
ACCELERATION = THRUST * HOUR**2 / 1e6
"""Largest acceleration times the mass, kg Mm/h^2."""
FLOW = 0.05112e-3 * THRUST * HOUR
"""kg/h at the largest thrust."""
START = {"P": 11.625, "ex": 0.75, "ey": 0.0, "hx": 0.0612, "hy": 0.0, "L": np.pi, "m": 1500.0}
TARGET = {"P": 42.165, "ex": 0.0, "ey": 0.0, "hx": 0.0, "hy": 0.0}


def build(revolutions: float = 2.5) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    revolutions : float
        Number of revolutions of the initial guess.
    """
    satellite = go.Model("satellite")
    P = satellite.state("P", unit="Mm")
    ex, ey, hx, hy = (satellite.state(name) for name in ("ex", "ey", "hx", "hy"))
    L = satellite.state("L", unit="rad")
    m = satellite.state("m", unit="kg")
    u, size = satellite.vector_control("u", 3)

    W = 1 + ex * ca.cos(L) + ey * ca.sin(L)
    Z = hx * ca.sin(L) - hy * ca.cos(L)
    C = 1 + hx**2 + hy**2
    radial, along, normal = (ca.sqrt(P / MU) * ACCELERATION / m * u[i] for i in range(3))
    satellite.ode(
        {
            P: 2 * P / W * along,
            ex: ca.sin(L) * radial + (ca.cos(L) + (ex + ca.cos(L)) / W) * along - Z * ey / W * normal,
            ey: -ca.cos(L) * radial + (ca.sin(L) + (ey + ca.sin(L)) / W) * along + Z * ex / W * normal,
            hx: C * ca.cos(L) / (2 * W) * normal,
            hy: C * ca.sin(L) / (2 * W) * normal,
            L: ca.sqrt(MU / P**3) * W**2 + Z / W * normal,
            m: -FLOW * size,
        }
    )

    problem = go.Problem("GTO to GEO")
    leg = problem.phase("transfer", satellite)
    leg.time(initial=0.0, final=(10.0, 100.0))
    leg.initial(**START)
    leg.final(**TARGET)
    elements = (-1.0, 1.0)
    leg.bounds(P=(5.0, 60.0), ex=elements, ey=elements, hx=elements, hy=elements, L=(3.0, 80.0))
    leg.bounds(m=(1000.0, START["m"]))
    leg.norm_bounds(u=(0.0, 1.0))
    leg.guess(
        P=(START["P"], TARGET["P"]),
        ex=(START["ex"], 0.0),
        hx=(START["hx"], 0.0),
        L=(np.pi, np.pi + 2 * np.pi * revolutions),
        m=(START["m"], 1350.0),
        u=[0.0, 1.0, 0.0],
    )
    problem.minimize(leg.final_time, unit="h")
    return problem


REFERENCE = Reference(
    34.71682, "independent Radau collocation, two meshes agree; 34.716 h published", 7e-5, "h"
)


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
