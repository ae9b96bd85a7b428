r"""Aeroassisted plane change: a turn of the orbital plane by 15 degrees in the atmosphere.

The speed after one pass through the atmosphere is maximised. This example shows an end condition on an angle between
planes instead of on states, and a guess of three points that goes down into the atmosphere and out again. The heat
flux is limited.

States: ``h`` (m), latitude ``phi`` (rad), ``v`` (m/s), ``gamma``, heading ``psi`` from the first orbit's plane (rad).
Controls: lift coefficient ``C_L``, ``bank`` (rad). The drag polar is :math:`C_D = C_{D0} + K C_L^2`.

.. math::
   \dot\phi = \frac{v \cos\gamma \sin\psi}{r}, \quad
   \dot\gamma = \frac{L \cos\sigma}{v} - \Big( \frac{g}{v} - \frac{v}{r} \Big) \cos\gamma, \quad
   \dot\psi = \frac{L \sin\sigma}{v \cos\gamma} - \frac{v}{r} \cos\gamma \cos\psi \tan\phi

.. math:: \cos\phi(t_f) \cos\psi(t_f) = \cos 15°

Source: own statement with the vehicle of A. V. Rao, S. Tang and W. P. Hallman, Numerical optimization study of
multiple-pass aeroassisted orbital transfer, Optimal Control Applications and Methods 23 (2002) 215-238.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MU, RADIUS = 3.986e14, 6378.145e3
"""m^3/s^2, m."""
MASS, AREA = 4898.7, 11.69
"""kg, m^2."""
ZERO_LIFT_DRAG, INDUCED_DRAG = 0.032, 1.4
DENSITY, SCALE_HEIGHT = 1.225, 7254.24
"""kg/m^3, m."""
HEATING, CIRCULAR_SPEED, MAX_HEATING = 1.76 * 1.135 * 100.0, 7905.0, 180.0
"""Flux (W/cm^2) at sea level density and the speed given (m/s), and its limit."""
TURN = np.radians(15.0)
"""rad."""
EDGE = 111e3
"""Altitude of entry and exit, m."""


def build(turn: float = TURN) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    turn : float
        Angle between the planes, rad.
    """
    vehicle = go.Model("vehicle")
    h = vehicle.state("h", unit="m")
    phi = vehicle.state("phi", unit="rad")
    v = vehicle.state("v", unit="m/s")
    gamma = vehicle.state("gamma", unit="rad")
    psi = vehicle.state("psi", unit="rad")
    c_l, bank = vehicle.control("C_L"), vehicle.control("bank", unit="rad")
    r, g = RADIUS + h, MU / (RADIUS + h) ** 2
    density = DENSITY * ca.exp(-h / SCALE_HEIGHT)
    pressure = 0.5 * density * v**2 * AREA / MASS
    lift, drag = pressure * c_l, pressure * (ZERO_LIFT_DRAG + INDUCED_DRAG * c_l**2)
    vehicle.ode(
        {
            h: v * ca.sin(gamma),
            phi: v * ca.cos(gamma) * ca.sin(psi) / r,
            v: -drag - g * ca.sin(gamma),
            gamma: lift * ca.cos(bank) / v - (g / v - v / r) * ca.cos(gamma),
            psi: lift * ca.sin(bank) / (v * ca.cos(gamma))
            - v / r * ca.cos(gamma) * ca.cos(psi) * ca.tan(phi),
        }
    )

    problem = go.Problem("aeroassisted plane change")
    leg = problem.phase("atmosphere", vehicle)
    leg.time(initial=0.0, final=(100.0, 2500.0))
    leg.initial(h=EDGE, phi=0.0, v=7900.0, gamma=np.radians(-1.5), psi=0.0)
    leg.final(h=EDGE, gamma=(0.0, np.radians(10.0)))
    leg.bounds(h=(30e3, 130e3), phi=(-1.0, 1.0), v=(4000.0, 8500.0), gamma=(-0.3, 0.3), psi=(-1.5, 1.5))
    leg.bounds(C_L=(0.0, 0.4), bank=(-np.pi, np.pi))
    flux = HEATING * ca.sqrt(density / DENSITY) * (v / CIRCULAR_SPEED) ** 3.15
    leg.path("heat flux", flux, upper=MAX_HEATING)
    plane = ca.cos(leg.final_state("phi")) * ca.cos(leg.final_state("psi"))
    problem.constrain("turn", plane, equals=np.cos(turn))
    leg.guess(
        [0.0, 400.0, 900.0],
        h=[EDGE, 65e3, EDGE],
        v=[7900.0, 7300.0, 7000.0],
        gamma=np.radians([-1.5, 0.0, 1.0]),
        psi=[0.0, 0.12, 0.25],
        phi=[0.0, 0.0, 0.05],
        C_L=0.15,
        bank=1.5,
    )
    problem.maximize(leg.final_state("v"))
    return problem


REFERENCE = Reference(6953.2154, "independent Radau collocation, two meshes agree", 0.01, "m/s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
