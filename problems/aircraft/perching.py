r"""Perching: a glider that pitches up beyond the stall to land at low speed.

The glider reaches a point at low speed, as a bird lands on a wire. This example shows aerodynamics at large angles of
attack: lift and drag of flat plates, wing and elevator, are smooth functions of the whole range. The elevator's rate
is the control.

States: ``x``, ``z`` (m), pitch ``theta``, elevator ``phi`` (rad), ``vx``, ``vz`` (m/s), ``q`` (rad/s). Control:
``rate`` of the elevator (rad/s).

.. math::
   m \dot v = f_w n_w + f_e n_e - m g e_z, \qquad I \dot q = -l_w f_w + l_e(\phi) f_e, \qquad
   f = \rho S \, (v^T n) \, \|v\|

with the normals n of wing and elevator: the force of a flat plate is normal to it and proportional to sin alpha.

Source: J. W. Roberts, R. Cory and R. Tedrake, On the controllability of fixed-wing perching, American Control
Conference 2009; the model is simplified: forces of the velocity of the centre of mass.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

import gnc_opt as go
from problems._example import Reference, example_main

MASS, INERTIA, GRAVITY, DENSITY = 0.08, 0.0015, 9.81, 1.225
"""kg, kg m^2, m/s^2, kg/m^3."""
WING_AREA, ELEVATOR_AREA = 0.0885, 0.0147
"""m^2."""
WING_OFFSET, TAIL, ELEVATOR = 0.005, 0.27, 0.022
"""Centre of pressure of the wing ahead of the centre of mass, hinge behind it, elevator behind the hinge; m."""
MAX_RATE, MAX_ELEVATOR = 13.0, 0.9
"""rad/s, rad."""
START = {"x": -3.5, "z": 0.1, "theta": 0.0, "phi": 0.0, "vx": 7.0, "vz": 0.0, "q": 0.0}


def plate(area: float, angle: Any, vx: Any, vz: Any) -> Any:
    """Return the force of a plate along its normal (-sin, cos of its angle), N."""
    across = vx * ca.sin(angle) - vz * ca.cos(angle)
    return DENSITY * area * across * ca.sqrt(vx**2 + vz**2 + 1e-4)


def build() -> go.Problem:
    """Return the problem."""
    glider = go.Model("glider")
    x, z = glider.state("x", unit="m"), glider.state("z", unit="m")
    theta, phi = glider.state("theta", unit="rad"), glider.state("phi", unit="rad")
    vx, vz = glider.state("vx", unit="m/s"), glider.state("vz", unit="m/s")
    q = glider.state("q", unit="rad/s")
    rate = glider.control("rate", unit="rad/s")
    wing, elevator = plate(WING_AREA, theta, vx, vz), plate(ELEVATOR_AREA, theta + phi, vx, vz)
    glider.ode(
        {
            x: vx,
            z: vz,
            theta: q,
            phi: rate,
            vx: -(wing * ca.sin(theta) + elevator * ca.sin(theta + phi)) / MASS,
            vz: (wing * ca.cos(theta) + elevator * ca.cos(theta + phi)) / MASS - GRAVITY,
            q: (wing * WING_OFFSET - elevator * (TAIL * ca.cos(phi) + ELEVATOR)) / INERTIA,
        }
    )

    problem = go.Problem("perching")
    flight = problem.phase("flight", glider)
    flight.time(initial=0.0, final=(0.2, 2.0))
    flight.initial(**START)
    flight.final(x=0.0, z=0.0)
    flight.bounds(z=(-1.0, 1.5), theta=(-0.5, 1.6), phi=(-MAX_ELEVATOR, MAX_ELEVATOR))
    flight.bounds(rate=(-MAX_RATE, MAX_RATE), vx=(0.0, 10.0), vz=(-5.0, 5.0), q=(-20.0, 20.0))
    flight.guess([0.0, 0.8], vx=(7.0, 2.0), theta=(0.0, 1.0), vz=0.0)
    vx_f, vz_f = flight.final_state("vx"), flight.final_state("vz")
    problem.minimize(vx_f**2 + vz_f**2 + 0.01 * flight.integral(rate**2 / MAX_RATE**2), unit="m^2/s^2")
    return problem


REFERENCE = Reference(3.1302187, "independent Radau collocation, converges to it", 4e-6, "m^2/s^2")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
