r"""Powered descent to Mars: the least propellant with a lower limit of the thrust.

This example shows a vector control whose norm has a lower limit: the set of thrusts is not convex.
`Model.vector_control` states it by magnitude and direction. The thrust is at the upper limit, the lower and the upper
one again. A glide slope keeps the lander within a cone with its apex at the target.

States: ``r`` (m), ``v`` (m/s), up, east and north of the target, ``mass`` (kg). Control: ``T`` (N), of six engines
canted by 27 degrees, between 30 and 80 % of what they give. Gravity g = 3.7114 m/s^2 is that of Mars.

.. math::
   \dot r = v, \quad \dot v = \frac{T}{m} - g e_1, \quad \dot m = -\alpha \|T\|, \quad
   \alpha = \frac{1}{225\,\mathrm{s} \cdot g_0 \cos 27^\circ}

Source: Acikmese and Ploen, Convex programming approach to powered descent guidance for Mars landing, J. Guidance,
Control, and Dynamics 30 (5), 2007, whose flights of 81 and 72 s burn 399.5 kg with and 387.9 kg without the slope;
the best time on the slope saves 1.4 kg.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.plot import View
from problems._example import Reference, example_main

START = {"r": [1500.0, 0.0, 2000.0], "v": [-75.0, 0.0, 100.0], "mass": 1905.0}
GRAVITY = 3.7114
"""Of Mars, m/s^2."""
CANT = np.radians(27.0)
MASS_RATE = 1.0 / (225.0 * 9.80665 * np.cos(CANT))
"""Per thrust along the axis of the lander, s/m."""
FULL = 6 * 3100.0 * np.cos(CANT)
"""All engines, N."""
APEX = 1e-3
"""Radius of the rounded apex of the cone, m."""


def build(slope: float | None = 86.0) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    slope : float, optional
        Half angle of the cone over the target, degrees; None: no cone.
    """
    lander = go.Model("Mars lander")
    r = lander.state("r", 3, unit="m")
    v = lander.state("v", 3, unit="m/s")
    mass = lander.state("mass", unit="kg")
    T, thrust = lander.vector_control("T", 3, unit="N")
    lander.ode({r: v, v: T / mass - np.array([GRAVITY, 0.0, 0.0]), mass: -MASS_RATE * thrust})

    problem = go.Problem("powered descent to Mars")
    descent = problem.phase("descent", lander)
    descent.time(initial=0.0, final=(40.0, 120.0))
    descent.initial(**START)
    descent.final(r=[0.0, 0.0, 0.0], v=[0.0, 0.0, 0.0])
    descent.bounds(mass=(1505.0, 1905.0))
    descent.norm_bounds(T=(0.3 * FULL, 0.8 * FULL))
    if slope is not None:
        across = ca.sqrt(r[1] ** 2 + r[2] ** 2 + APEX**2) - APEX
        descent.path("glide slope", across - r[0] * np.tan(np.radians(slope)), upper=0.0)
    problem.maximize(descent.final_state("mass"))
    return problem


REFERENCE = Reference(
    1506.91403,
    "apex rounded to 10, 1 and 0.1 mm agree; without rounding, another program burns 398.0863 kg of 1905 kg",
    1e-7,
    "kg",
)
VARIANTS = {
    "without glide slope": (
        {"slope": None},
        Reference(1517.0916107, "two formulations agree; 1517.1 published", 1e-6, "kg"),
    )
}
"""Other data, with their references."""

VIEW = View(("r[1]", "r[2]", "r[0]"), force=("T[1]", "T[2]", "T[0]"))
"""What a report shows moving: east, north and up."""


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
