r"""Double oscillator: a controlled damper reduces the motion of two coupled masses, one of them shaken.

This example shows dynamics that depend on time, and initial velocities that are free.

States: ``x1``, ``x2`` (m), ``v1``, ``v2`` (m/s). Control: ``u``, change of the damping over its nominal value.

.. math::
   \ddot x_1 = -\frac{k_1 + k_2}{m_1} x_1 + \frac{k_2}{m_1} x_2 + \frac{\sin t}{m_1}, \quad
   \ddot x_2 = \frac{k_2}{m_2} (x_1 - x_2) - \frac{c}{m_2} (1 - u) \dot x_2, \qquad
   J = \tfrac12 \int_0^{2 \pi} x_1^2 + x_2^2 + u^2 \, dt

Source: the problem ``double_oscillator`` of OptimalControlProblems.jl, after C. Coudurier, O. Lepreux and N. Petit,
Optimal bang-bang control of a mechanical double oscillator using averaging methods, IFAC 2018.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

FIRST_MASS, SECOND_MASS, FIRST_SPRING, SECOND_SPRING, DAMPER = 100.0, 2.0, 100.0, 3.0, 0.5
"""kg, kg, N/m, N/m, N s/m."""


def build() -> go.Problem:
    """Return the problem."""
    masses = go.Model("double oscillator")
    x1, x2 = masses.state("x1", unit="m"), masses.state("x2", unit="m")
    v1, v2 = masses.state("v1", unit="m/s"), masses.state("v2", unit="m/s")
    u = masses.control("u")
    shaken = ca.sin(masses.time) - (FIRST_SPRING + SECOND_SPRING) * x1 + SECOND_SPRING * x2
    damped = SECOND_SPRING * (x1 - x2) - DAMPER * (1 - u) * v2
    masses.ode({x1: v1, x2: v2, v1: shaken / FIRST_MASS, v2: damped / SECOND_MASS})

    problem = go.Problem("double oscillator")
    period = problem.phase("period", masses)
    period.time(initial=0.0, final=2 * np.pi)
    period.initial(x1=0.0, x2=0.0)
    period.bounds(u=(-1.0, 1.0))
    problem.minimize(0.5 * period.integral(x1**2 + x2**2 + u**2))
    return problem


REFERENCE = Reference(0.000911035, "independent Radau collocation, two meshes agree", 2e-9)


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
