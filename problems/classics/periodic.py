r"""Periodic control: hold a disturbed plant near zero, day after day.

This example shows boundary conditions that join both ends: :math:`x(2\pi) = x(0)` with neither value given, by a link
of the phase to itself. The costate is then periodic as well, and the optimum is the forced response alone, without a
transient.

State: ``x``. Control: ``u``. No units; time in s.

.. math::
   \dot x = -x + u + \sin t, \qquad J = \tfrac12 \int_0^{2\pi} (x^2 + u^2)\,dt, \qquad x(2\pi) = x(0)

Closed form:

.. math:: x = \frac{\sin t - \cos t}{3}, \qquad u = -\frac{\sin t}{3}, \qquad \lambda = -u, \qquad J = \frac{\pi}{6}
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Array, Extremal, Reference, example_main


def build() -> go.Problem:
    """Return the problem."""
    plant = go.Model("disturbed plant")
    x = plant.state("x")
    u = plant.control("u")
    plant.ode({x: -x + u + ca.sin(plant.time)})

    problem = go.Problem("periodic regulator")
    day = problem.phase("day", plant)
    day.time(initial=0.0, final=2 * np.pi)
    problem.link(day, day, time=False)
    problem.minimize(day.integral((x**2 + u**2) / 2, "cost"))
    return problem


def closed_form(t: Array) -> Extremal:
    """Return the optimum and its costate at times t (s)."""
    return Extremal(
        states={"x": (np.sin(t) - np.cos(t)) / 3},
        controls={"u": -np.sin(t) / 3},
        costates={"x": np.sin(t) / 3},
    )


REFERENCE = Reference(np.pi / 6, "closed form: pi / 6", 1e-8)


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
