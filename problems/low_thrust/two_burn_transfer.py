r"""Two-burn transfer: the largest payload from a low to a high orbit.

This example shows phases of very different length: two coasts of half an orbit, two burns of two minutes and less, in
equinoctial elements with the zonal harmonics J2 to J4 of the Earth.

States: ``p`` (ft), ``f``, ``g``, ``h``, ``k``, ``L`` (rad), weight ``w`` (lb). Controls: ``theta``, ``phi`` (rad), the
angles of the thrust out of the orbit's plane and away from the velocity in it.

With :math:`q = 1 + f \cos L + g \sin L`, :math:`s^2 = 1 + h^2 + k^2` and the perturbing acceleration
:math:`(\Delta_r, \Delta_t, \Delta_n)`,

.. math::
   \dot p = \frac{2 p}{q} \sqrt{\tfrac{p}{\mu}} \Delta_t, \quad
   \dot f = \sqrt{\tfrac{p}{\mu}} \Big( \sin L \, \Delta_r + \tfrac{(q + 1) \cos L + f}{q} \Delta_t
   - \tfrac{g (h \sin L - k \cos L)}{q} \Delta_n \Big)

.. math::
   \dot h = \sqrt{\tfrac{p}{\mu}} \frac{s^2 \cos L}{2 q} \Delta_n, \quad
   \dot w = -\frac{T}{I_{sp}}

and g, k likewise;

.. math::
   \dot L = \sqrt{\mu p} \, \Big( \frac{q}{p} \Big)^2
   + \sqrt{\tfrac{p}{\mu}} \frac{h \sin L - k \cos L}{q} \Delta_n

Source: J. T. Betts, Practical Methods for Optimal Control and Estimation Using Nonlinear Programming, SIAM 2010,
section 6.2; the example ``twoburn`` of PSOPT; 0.2367248 lb published.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MU, GRAVITY, EARTH_RADIUS = 1.407645794e16, 32.174, 20925662.73
"""ft^3/s^2, ft/s^2, ft."""
THRUST, ISP = 1.2, 300.0
"""lb, s."""
ZONAL = {2: 1082.639e-6, 3: -2.565e-6, 4: -1.608e-6}
"""J2 to J4."""
START = {"p": 21837080.052835, "f": 0.0, "g": 0.0, "h": -0.25396764647494, "k": 0.0, "L": np.pi, "w": 1.0}
TARGET_RADIUS = 19323.0 * 6076.1154855643 + EARTH_RADIUS
"""ft."""
LEGS = {
    # Duration (s); guesses of L and w.
    "first_coast": ((1000.0, 3000.0), (np.pi, 5.9), 1.0),
    "first_burn": ((50.0, 300.0), (5.9, 6.2), (1.0, 0.45)),
    "second_coast": ((15000.0, 22000.0), (6.2, 9.3), 0.45),
    "second_burn": ((10.0, 300.0), (9.3, 9.4), (0.45, 0.24)),
}


def position_and_velocity(p: Any, f: Any, g: Any, h: Any, k: Any, L: Any) -> tuple[Any, Any]:
    """Return position (ft) and velocity (ft/s) of equinoctial elements."""
    cosine, sine = ca.cos(L), ca.sin(L)
    radius = p / (1 + f * cosine + g * sine)
    s2, alpha2 = 1 + h**2 + k**2, h**2 - k**2
    position = (
        radius
        / s2
        * ca.vertcat(
            (1 + alpha2) * cosine + 2 * h * k * sine,
            (1 - alpha2) * sine + 2 * h * k * cosine,
            2 * (h * sine - k * cosine),
        )
    )
    velocity = (
        ca.sqrt(MU / p)
        / s2
        * ca.vertcat(
            2 * h * k * (cosine + f) - (1 + alpha2) * (sine + g),
            (1 - alpha2) * (cosine + f) - 2 * h * k * (sine + g),
            2 * (h * (cosine + f) + k * (sine + g)),
        )
    )
    return position, velocity


def zonal_acceleration(position: Any) -> tuple[Any, Any]:
    """Return the components of the zonal harmonics towards north and downwards, ft/s^2."""
    r = ca.norm_2(position)
    sine = position[2] / r
    legendre = {
        2: (3 * sine**2 - 1) / 2,
        3: (5 * sine**3 - 3 * sine) / 2,
        4: (35 * sine**4 - 30 * sine**2 + 3) / 8,
    }
    slope = {2: 3 * sine, 3: (15 * sine**2 - 3) / 2, 4: (35 * sine**3 - 15 * sine) / 2}
    size = {n: MU / r**2 * (EARTH_RADIUS / r) ** n * coefficient for n, coefficient in ZONAL.items()}
    north = -ca.sqrt(1 - sine**2) * sum(size[n] * slope[n] for n in ZONAL)
    down = -sum(size[n] * (n + 1) * legendre[n] for n in ZONAL)
    return north, down


def stage(name: str) -> go.Model:
    """Return the model of a phase."""
    model = go.Model(name)
    units = {"p": "ft", "L": "rad", "w": "lb"}
    p, f, g, h, k, L, w = (model.state(n, unit=units.get(n, "")) for n in START)
    position, velocity = position_and_velocity(p, f, g, h, k, L)
    radial = position / ca.norm_2(position)
    momentum = ca.cross(position, velocity)
    normal = momentum / ca.norm_2(momentum)
    along = ca.cross(normal, radial)
    north = ca.DM([0.0, 0.0, 1.0]) - radial[2] * radial
    north_acceleration, down_acceleration = zonal_acceleration(position)
    acceleration = north_acceleration * north / ca.norm_2(north) - down_acceleration * radial
    flow = 0.0
    if name.endswith("burn"):
        theta, phi = model.control("theta", unit="rad"), model.control("phi", unit="rad")
        forward = velocity / ca.norm_2(velocity)
        sideways = ca.cross(velocity, position)
        sideways = sideways / ca.norm_2(sideways)
        third = ca.cross(forward, sideways)
        in_plane = ca.cos(phi) * forward + ca.sin(phi) * sideways
        acceleration += THRUST * GRAVITY / w * (ca.cos(theta) * in_plane + ca.sin(theta) * third)
        flow = THRUST / ISP
    d_r, d_t, d_n = (ca.dot(axis, acceleration) for axis in (radial, along, normal))
    q, s2, root = 1 + f * ca.cos(L) + g * ca.sin(L), 1 + h**2 + k**2, ca.sqrt(p / MU)
    tilt = (h * ca.sin(L) - k * ca.cos(L)) / q
    model.ode(
        {
            p: 2 * p / q * root * d_t,
            f: root * (ca.sin(L) * d_r + ((q + 1) * ca.cos(L) + f) / q * d_t - g * tilt * d_n),
            g: root * (-ca.cos(L) * d_r + ((q + 1) * ca.sin(L) + g) / q * d_t + f * tilt * d_n),
            h: root * s2 * ca.cos(L) / (2 * q) * d_n,
            k: root * s2 * ca.sin(L) / (2 * q) * d_n,
            L: ca.sqrt(MU * p) * (q / p) ** 2 + root * tilt * d_n,
            w: -flow,
        }
    )
    return model


def build() -> go.Problem:
    """Return the problem."""
    problem = go.Problem("two-burn transfer")
    legs = []
    for name, (_, longitude, weight) in LEGS.items():
        leg = problem.phase(name, stage(name))
        element = (-1.0, 1.0)
        leg.bounds(p=(1e7, 2e8), f=element, g=element, h=element, k=element, L=(3.0, 30.0), w=(0.05, 1.0))
        leg.guess(L=longitude, w=weight)
        if name.endswith("burn"):
            leg.bounds(theta=(-np.pi, np.pi), phi=(-np.pi, np.pi))
            leg.guess(theta=0.0, phi=0.0)
        legs.append(leg)
    problem.sequence(*legs, durations={name: duration for name, (duration, *_) in LEGS.items()})
    legs[0].initial(**START)
    legs[-1].final(p=TARGET_RADIUS, f=0.0, g=0.0, h=0.0, k=0.0)
    problem.maximize(legs[-1].final_state("w"))
    return problem


REFERENCE = Reference(
    0.23672487, "independent Radau collocation, two meshes agree; 0.2367248 published", 5e-7, "lb"
)


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
