r"""Goddard's rocket: the greatest altitude of a sounding rocket against drag and gravity.

This example shows the singular arc. Full thrust to the end would waste fuel on drag, slow ascent on gravity; between
them is an arc on which the switching function vanishes. On a fixed mesh the control oscillates there, and the altitude
is up to 16 m too high. Variable switching times of the arcs full, singular and off remove this error.

States: ``h`` (m), ``v`` (m/s), ``m`` (kg). Control: ``thrust`` (N).

.. math::
   \dot h = v, \qquad \dot v = \frac{T - D}{m} - g, \qquad \dot m = -\frac{T}{c}, \qquad
   D = \sigma v^2 e^{-h / h_0}

On the singular arc the state keeps to the surface :math:`m g = (1 + v / c) D` (`singular_surface`).

Source: Goddard, 1919; data of Betts, Practical Methods for Optimal Control, 2010 (18550.872 ft), converted from
feet and slugs."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Array, Reference, example_main

FOOT = 0.3048
"""m."""
SLUG = 14.593903
"""kg."""

MAX_THRUST = 193.044 * SLUG * FOOT
"""N."""
GRAVITY = 32.174 * FOOT
"""m/s^2."""
DRAG = 5.49153484923381e-5 * SLUG / FOOT
"""sigma, kg/m: drag per speed squared at sea level."""
EXHAUST_SPEED = 1580.942527987656 * FOOT
"""c, m/s."""
SCALE_HEIGHT = 23800 * FOOT
"""h_0, m."""
FULL, EMPTY = 3 * SLUG, 1 * SLUG
"""Mass at lift-off and at burn-out, kg."""


def build(max_thrust: float = MAX_THRUST) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    max_thrust : float
        Largest thrust, N; the rocket weighs 429 N at lift-off.
    """
    rocket = go.Model("sounding rocket")
    h = rocket.state("h", unit="m")
    v = rocket.state("v", unit="m/s")
    m = rocket.state("m", unit="kg")
    thrust = rocket.control("thrust", unit="N")
    rocket.ode({h: v, v: (thrust - drag(h, v)) / m - GRAVITY, m: -thrust / EXHAUST_SPEED})

    problem = go.Problem("Goddard rocket")
    ascent = problem.phase("ascent", rocket)
    ascent.time(initial=0.0, final=(15.0, 100.0))
    ascent.initial(h=0.0, v=0.0, m=FULL)
    ascent.final(m=EMPTY)
    ascent.bounds(thrust=(0.0, max_thrust), m=(0.9 * EMPTY, None))
    ascent.guess([0.0, 60.0], h=(0.0, 3000.0), v=0.0)
    problem.maximize(ascent.final_state("h"))
    return problem


def drag(h: Any, v: Any) -> Any:
    """Return the drag, N, at an altitude (m) and speed (m/s)."""
    return DRAG * v**2 * ca.exp(-h / SCALE_HEIGHT)


def singular_surface(h: Array, v: Array, m: Array) -> Array:
    """Return (1 + v/c) D / (m g) - 1, which is zero on the singular arc; arrays (n_times,)."""
    ratio = (1 + v / EXHAUST_SPEED) * np.asarray(drag(h, v), dtype=float).reshape(-1) / (m * GRAVITY)
    return np.asarray(ratio - 1)


REFERENCE = Reference(
    18550.8718638 * FOOT, "independent simulation with the singular feedback law", 1e-5, "m"
)


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
