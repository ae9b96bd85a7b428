r"""Low-thrust raising with oblateness: a climb and turn of the orbital plane in many orbits.

A satellite starts at 500 km. This example shows the longitude as independent variable in place of the time: the
dynamics are smooth over sixteen revolutions, and time is a state that is minimised.

States: ``p`` (Earth radii), ``f``, ``g``, ``h``, ``k``, time ``t``. Control: ``u`` of length at most 1: radial, along
track, normal. Independent variable: longitude L.

.. math::
   \frac{dp}{dL} = \frac{1}{\dot L} \frac{2 p}{w} \sqrt{p} \, \Delta_t, \qquad \frac{dt}{dL} = \frac{1}{\dot L}, \qquad
   \Delta_r = -\frac{3 J_2}{2 r^4} \Big( 1 - \frac{12 (h \sin L - k \cos L)^2}{s^4} \Big) + a u_r, \ldots

Source: own statement; the equations of M. J. H. Walker, B. Ireland and J. Owens, A set of modified equinoctial orbit
elements, Celestial Mechanics 36 (1985) 409-419.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

J2, ACCELERATION, REVOLUTIONS = 1.08263e-3, 8e-4, 12
"""-, in units of gravity at the surface, -."""
START, TARGET = 1.0784, 1.20
"""Radii of both orbits, in Earth radii."""
FIRST_TILT, LAST_TILT = float(np.tan(np.radians(25.0))), float(np.tan(np.radians(25.5)))
"""tan(i/2)."""


def build() -> go.Problem:
    """Return the problem."""
    satellite = go.Model("satellite")
    p, f, g, h, k, t = (satellite.state(name) for name in ("p", "f", "g", "h", "k", "t"))
    u, _ = satellite.vector_control("u", 3)
    L = satellite.time
    cosine, sine = ca.cos(L), ca.sin(L)
    w, s2 = 1 + f * cosine + g * sine, 1 + h**2 + k**2
    r, z = p / w, h * sine - k * cosine
    pull = J2 / r**4 / s2**2
    radial = -1.5 * J2 / r**4 * (1 - 12 * z**2 / s2**2) + ACCELERATION * u[0]
    along = -12 * pull * z * (h * cosine + k * sine) + ACCELERATION * u[1]
    normal = -6 * pull * (1 - h**2 - k**2) * z + ACCELERATION * u[2]
    root = ca.sqrt(p)
    rate = ca.sqrt(p) * (w / p) ** 2 + root * z / w * normal
    satellite.ode(
        {
            p: 2 * p / w * root * along / rate,
            f: root * (sine * radial + ((w + 1) * cosine + f) / w * along - g * z / w * normal) / rate,
            g: root * (-cosine * radial + ((w + 1) * sine + g) / w * along + f * z / w * normal) / rate,
            h: root * s2 * cosine / (2 * w) * normal / rate,
            k: root * s2 * sine / (2 * w) * normal / rate,
            t: 1 / rate,
        }
    )

    problem = go.Problem("low-thrust raising with oblateness", time_unit="rad")
    leg = problem.phase("transfer", satellite)
    leg.time(initial=0.0, final=(2 * np.pi * 2, 2 * np.pi * 40))
    leg.initial(p=START, f=0.0, g=0.0, h=FIRST_TILT, k=0.0, t=0.0)
    leg.final(p=TARGET, f=0.0, g=0.0)
    tilt = leg.final_state("h") ** 2 + leg.final_state("k") ** 2
    problem.constrain("inclination", tilt, equals=LAST_TILT**2)
    leg.bounds(p=(0.9, 1.5), f=(-0.3, 0.3), g=(-0.3, 0.3), h=(-1.0, 1.0), k=(-1.0, 1.0))
    leg.norm_bounds(u=(0.0, 1.0))
    leg.guess(
        [0.0, 2 * np.pi * REVOLUTIONS],
        p=(START, TARGET),
        h=FIRST_TILT,
        k=0.0,
        t=(0.0, 80.0),
        u=[0.0, 1.0, 0.0],
    )
    problem.minimize(leg.final_state("t"))
    return problem


REFERENCE = Reference(70.4386675, "independent Radau collocation, two meshes agree", 7e-5)


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
