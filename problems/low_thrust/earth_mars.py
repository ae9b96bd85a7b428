r"""Earth to Mars: electric propulsion with minimum propellant in 348.79 days.

This example shows the switching function of the magnitude, Lawden's :math:`c \|p\| / m` minus the costate of the
mass, with the primer vector :math:`p = -\lambda_v`. The optimum thrusts, coasts, thrusts, coasts and thrusts. During
a coast the direction of the thrust is arbitrary. A vector control permits this; the constraint ``T @ T <= d**2``
would have a singular Jacobian.

States: ``r`` (km), ``v`` (km/s) about the Sun, ``mass`` (kg). Control: ``T`` (N), at most 0.5 N, specific impulse
2000 s.

.. math::
   \dot r = v, \quad \dot v = -\mu \frac{r}{\|r\|^3} + \frac{T}{1000\,m}, \quad \dot m = -\frac{\|T\|}{I_{sp} g_0}

Source: Taheri, Kolmanovsky and Atkins, Enhanced smoothing technique for indirect optimization of minimum-fuel
low-thrust trajectories, J. Guidance, Control, and Dynamics 39 (11), 2016 (603.93 kg arrive).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.plot import View
from problems._example import Reference, example_main

MU = 132712440018.0
"""Of the Sun, km^3/s^2."""
DAY = 86400.0
"""s."""
MOST = 0.5
"""N."""
EXHAUST_SPEED = 2000.0 * 9.80665
"""m/s."""
EARTH = {"r": [-140699693.0, -51614428.0, 980.0], "v": [9.774596, -28.07828, 4.337725e-4]}
MARS = {"r": [-172682023.0, 176959469.0, 7948912.0], "v": [-16.427384, -14.860506, 9.21486e-2]}


def build(days: float = 348.79) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    days : float
        Duration of the flight, days.
    """
    probe = go.Model("probe about the Sun")
    r = probe.state("r", 3, unit="km")
    v = probe.state("v", 3, unit="km/s")
    mass = probe.state("mass", unit="kg")
    T, thrust = probe.vector_control("T", 3, unit="N")
    probe.ode({r: v, v: -MU * r / ca.norm_2(r) ** 3 + T / mass / 1000.0, mass: -thrust / EXHAUST_SPEED})

    problem = go.Problem("from the Earth to Mars with the least propellant")
    cruise = problem.phase("cruise", probe)
    cruise.time(initial=0.0, final=days * DAY)
    cruise.initial(**EARTH, mass=1000.0)
    cruise.final(**MARS)
    cruise.bounds(mass=(300.0, 1000.0))
    cruise.norm_bounds(T=(0.0, MOST))
    problem.maximize(cruise.final_state("mass"))

    # Less than one revolution outwards, on an arc of growing radius.
    share = np.linspace(0.0, 1.0, 60)
    start, end = (np.arctan2(body["r"][1], body["r"][0]) for body in (EARTH, MARS))
    angle = start + share * ((end - start) % (2 * np.pi))
    near, far = (np.linalg.norm(body["r"]) for body in (EARTH, MARS))
    radius = near + share * (far - near)
    speed = np.sqrt(MU / radius)
    cruise.guess(
        time=share * days * DAY,
        r=np.array([radius * np.cos(angle), radius * np.sin(angle), share * MARS["r"][2]]),
        v=np.array([-speed * np.sin(angle), speed * np.cos(angle), 0 * angle]),
        mass=(1000.0, 600.0),
    )
    return problem


REFERENCE = Reference(603.91838, "independent: magnitude times unit vector; 603.93 published", 1e-5, "kg")

VIEW = View("r", force="T")
"""What a report shows moving."""


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
