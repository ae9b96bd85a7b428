r"""Lunar descent: Apollo's powered descent with minimum propellant.

The lander brakes from perilune at 15 km to a point 500 ft above the site. This example shows that the least
propellant is bang-bang in the thrust magnitude; full thrust brakes nearly all the way, as Apollo's engine did, which
could not be throttled between 60 % and full.

States: ``h`` (m), range angle ``theta`` (rad), ``v_r``, ``v_t`` (m/s), ``m`` (kg). Control: vector ``T`` (N), radial
and tangential.

.. math::
   \dot v_r = \frac{T_r}{m} - \frac{\mu}{r^2} + \frac{v_t^2}{r}, \qquad
   \dot v_t = \frac{T_t}{m} - \frac{v_r v_t}{r}, \qquad \dot m = -\frac{\|T\|}{g_0 I_{sp}}

Source: own statement with the data of F. V. Bennett, Apollo experience report: mission planning for lunar module
descent and ascent, NASA TN D-6846, 1972.
"""

from __future__ import annotations

import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MU, RADIUS, G0 = 4.9048695e12, 1737.4e3, 9.80665
"""m^3/s^2, m, m/s^2."""
THRUST, ISP, START_MASS = (4670.0, 45000.0), 311.0, 15100.0
"""N, s, kg."""
PERILUNE, APOLUNE = 15240.0, 111e3
"""Heights of the orbit before, m."""
GATE = 152.4
"""Height at the end, m."""


def build() -> go.Problem:
    """Return the problem."""
    lander = go.Model("lunar module")
    h, theta = lander.state("h", unit="m"), lander.state("theta", unit="rad")
    v_r, v_t = lander.state("v_r", unit="m/s"), lander.state("v_t", unit="m/s")
    m = lander.state("m", unit="kg")
    thrust, size = lander.vector_control("T", 2, unit="N")
    r = RADIUS + h
    lander.ode(
        {
            h: v_r,
            theta: v_t / r,
            v_r: thrust[0] / m - MU / r**2 + v_t**2 / r,
            v_t: thrust[1] / m - v_r * v_t / r,
            m: -size / (G0 * ISP),
        }
    )

    problem = go.Problem("lunar descent")
    descent = problem.phase("descent", lander)
    descent.time(initial=0.0, final=(200.0, 1000.0))
    near, far = RADIUS + PERILUNE, RADIUS + APOLUNE
    speed = float(np.sqrt(2 * MU * far / (near * (near + far))))
    descent.initial(h=PERILUNE, theta=0.0, v_r=0.0, v_t=speed, m=START_MASS)
    descent.final(h=GATE, v_r=-5.0, v_t=15.0)
    descent.bounds(h=(0.0, 30e3), v_r=(-200.0, 200.0), v_t=(-50.0, 2000.0), m=(5000.0, START_MASS))
    descent.norm_bounds(T=THRUST)
    problem.maximize(descent.final_state("m"))
    return problem


REFERENCE = Reference(8470.1912, "independent Radau collocation, converges to it", 0.008, "kg")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
