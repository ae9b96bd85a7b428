r"""Low-thrust transfer in modified equinoctial elements: eight revolutions, least propellant.

This example shows a simulated guess and slowly varying elements. `guess_from_simulation` simulates a spiral with
thrust along the velocity, a law in the symbols of the model. With orbital elements eight revolutions need a few dozen
points per state, with Cartesian coordinates thousands.

States: ``p`` (ft), ``f``, ``g``, ``h``, ``k``, ``L`` (rad), ``w`` (weight, lb). Control: ``u``, the direction of
thrust in radial, transverse and normal components, a unit vector. Free parameter: the throttle factor ``tau`` in -50
to 0.

With :math:`q = 1 + f \cos L + g \sin L`, :math:`z = h \sin L - k \cos L` and the acceleration
:math:`(D_r, D_t, D_n)`:

.. math::
   \dot p = \frac{2p}{q}\sqrt{\frac p\mu} D_t, \quad
   \dot f = \sqrt{\frac p\mu}\Big(\sin L\, D_r + \frac{(q+1)\cos L + f}{q} D_t - \frac{g z}{q} D_n\Big), \quad \dots

.. math::
   \dot L = \sqrt{\mu p}\,(q/p)^2 + \frac zq \sqrt{\frac p\mu} D_n, \qquad \dot w = -T (1 + \tau/100) / I_{sp}

J2 to J4 of the Earth act besides the thrust. Maximise w at the end, on an orbit of given size, shape and inclination.

Source: J. T. Betts, Practical Methods for Optimal Control and Estimation Using Nonlinear Programming, SIAM 2010,
section 6.3.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MU = 1.407645794e16
"""Of the Earth, ft^3/s^2."""
G0 = 32.174
"""ft/s^2."""
ISP = 450.0
"""s."""
THRUST = 4.446618e-3
"""lb."""
RADIUS = 20925662.73
"""Of the Earth, ft."""
ZONAL = {2: 1082.639e-6, 3: -2.565e-6, 4: -1.608e-6}

START = {"p": 21837080.052835, "f": 0.0, "g": 0.0, "h": -0.25396764647494, "k": 0.0, "L": np.pi, "w": 1.0}
DURATION = 86810.0
"""Of the flight that makes the guess, s."""


def position_and_velocity(p: Any, f: Any, g: Any, h: Any, k: Any, L: Any) -> tuple[Any, Any]:
    """Return inertial position (ft) and velocity (ft/s) of the elements."""
    q, s2, a2 = 1 + f * ca.cos(L) + g * ca.sin(L), 1 + h**2 + k**2, h**2 - k**2
    cos, sin = ca.cos(L), ca.sin(L)
    r = (
        p
        / q
        / s2
        * ca.vertcat(
            cos * (1 + a2) + 2 * h * k * sin, sin * (1 - a2) + 2 * h * k * cos, 2 * (h * sin - k * cos)
        )
    )
    v = (
        ca.sqrt(MU / p)
        / s2
        * ca.vertcat(
            -(sin * (1 + a2) - 2 * h * k * cos + g - 2 * f * h * k + a2 * g),
            -(-cos + a2 * cos + 2 * h * k * sin - f + 2 * g * h * k + a2 * f),
            2 * (h * cos + k * sin + f * h + g * k),
        )
    )
    return r, v


def local_frame(r: Any, v: Any) -> Any:
    """Return the matrix with the radial, transverse and normal directions as its rows."""
    radial = r / ca.norm_2(r)
    normal = ca.cross(r, v)
    normal = normal / ca.norm_2(normal)
    return ca.horzcat(radial, ca.cross(normal, radial), normal).T


def oblateness(r: Any) -> Any:
    """Return the inertial acceleration by the zonal harmonics, ft/s^2."""
    distance = ca.norm_2(r)
    up = r / distance
    s = up[2]
    cosine = ca.sqrt(1 - s**2)
    north = (ca.vertcat(0, 0, 1) - s * up) / cosine
    legendre = {2: (3 * s**2 - 1) / 2, 3: (5 * s**3 - 3 * s) / 2, 4: (35 * s**4 - 30 * s**2 + 3) / 8}
    slopes = {2: 3 * s, 3: (15 * s**2 - 3) / 2, 4: (140 * s**3 - 60 * s) / 8}
    weights = {n: MU / distance**2 * (RADIUS / distance) ** n * j for n, j in ZONAL.items()}
    along_north = -cosine * sum(weights[n] * slopes[n] for n in ZONAL)
    along_radius = sum((n + 1) * weights[n] * legendre[n] for n in ZONAL)
    return along_north * north + along_radius * up


def build() -> go.Problem:
    """Return the problem, with a flight along the velocity as its guess."""
    model = go.Model("low thrust in equinoctial elements")
    p, f, g, h, k, L, w = (
        model.state(name, unit=unit)
        for name, unit in zip("pfghkLw", ("ft", "", "", "", "", "rad", "lb"), strict=True)
    )
    u, _ = model.vector_control("u", 3)
    tau = model.parameter("tau", -25.0)
    r, v = position_and_velocity(p, f, g, h, k, L)
    frame = local_frame(r, v)
    thrust = THRUST * (1 + 0.01 * tau)
    D = frame @ oblateness(r) + G0 * thrust / w * u
    q, s2, z = 1 + f * ca.cos(L) + g * ca.sin(L), 1 + h**2 + k**2, h * ca.sin(L) - k * ca.cos(L)
    root = ca.sqrt(p / MU)
    model.ode(
        {
            p: 2 * p / q * root * D[1],
            f: root * (ca.sin(L) * D[0] + ((q + 1) * ca.cos(L) + f) / q * D[1] - g / q * z * D[2]),
            g: root * (-ca.cos(L) * D[0] + ((q + 1) * ca.sin(L) + g) / q * D[1] + f / q * z * D[2]),
            h: root * s2 * ca.cos(L) / (2 * q) * D[2],
            k: root * s2 * ca.sin(L) / (2 * q) * D[2],
            L: root / q * z * D[2] + ca.sqrt(MU * p) * (q / p) ** 2,
            w: -thrust / ISP,
        }
    )

    problem = go.Problem("low-thrust transfer")
    problem.parameter("tau", lower=-50.0, upper=0.0, guess=-25.0)
    burn = problem.phase("burn", model)
    burn.time(initial=0.0, final=(50000.0, 100000.0))
    burn.initial(**START)
    burn.final(p=40007346.015232)
    burn.bounds(
        p=(1e7, 6e7),
        f=(-0.2, 0.2),
        g=(-0.1, 1.0),
        h=(-1.0, 1.0),
        k=(-0.2, 0.2),
        L=(np.pi, 20 * np.pi),
        w=(0.01, 2.0),
    )
    burn.norm_bounds(u=(1.0, 1.0))
    F, G, H, K = (burn.final_state(name) for name in "fghk")
    problem.constrain("eccentricity", F**2 + G**2, equals=0.73550320568829**2)
    problem.constrain("inclination", H**2 + K**2, equals=0.61761258786099**2)
    problem.constrain("node", F * H + G * K, equals=0.0)
    problem.constrain("perigee", G * H - K * F, upper=0.0)
    problem.maximize(burn.final_state("w"))
    along = frame @ (v / ca.norm_2(v))
    return go.guess_from_simulation(problem, {"u": along}, duration=DURATION)


REFERENCE = Reference(0.2201791266, "Betts 2010, section 6.3", 1e-8, "lb")


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
