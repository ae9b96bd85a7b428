r"""Rendezvous on an ellipse: a minimum-energy rendezvous on an eccentric orbit.

This example shows time-varying dynamics: the equations of relative motion along an ellipse with the true anomaly as
independent variable. The problem is linear and quadratic, so that the optimum is known from the Gramian of the
transition matrix.

States: ``x`` (radial), ``y`` (along track) and their derivatives ``vx``, ``vy``, all multiplied by
:math:`1 + e \cos f` (m). Control: ``a`` (two components). Independent variable: true anomaly f.

.. math::
   x'' = 2 y' + \frac{3}{1 + e \cos f} x + a_x, \qquad y'' = -2 x' + a_y, \qquad J = \tfrac12 \int a^T a \, df

Source: J. Tschauner and P. Hempel, Rendezvous zu einem in elliptischer Bahn umlaufenden Ziel, Astronautica Acta 11
(1965) 104-109; K. Yamanaka and F. Ankersen, J. Guidance 25 (2002) 60-66.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

import gnc_opt as go
from problems._example import Array, Reference, example_main

ECCENTRICITY = 0.7
FIRST, LAST = 0.0, 3 * np.pi / 2
"""True anomalies, rad."""
START = np.array([100.0, -500.0, 30.0, -150.0])
"""x, y, x', y'; m."""
STATES = ("x", "y", "vx", "vy")


def rates(anomaly: Any, eccentricity: float) -> Any:
    """Return the matrix of the free motion."""
    gravity = 3 / (1 + eccentricity * np.cos(anomaly))
    return np.array(
        [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [gravity, 0.0, 0.0, 2.0], [0.0, 0.0, -2.0, 0.0]]
    )


def least_energy(eccentricity: float = ECCENTRICITY) -> float:
    """Return half of z W^-1 z for the state z that free motion reaches and the Gramian W of the controls."""
    controlled = np.diag([0.0, 0.0, 1.0, 1.0])

    def slope(anomaly: float, values: Array) -> Array:
        matrix, gramian = rates(anomaly, eccentricity), values[4:].reshape(4, 4)
        return np.concatenate(
            [matrix @ values[:4], (matrix @ gramian + gramian @ matrix.T + controlled).ravel()]
        )

    start = np.concatenate([START, np.zeros(16)])
    end = solve_ivp(slope, (FIRST, LAST), start, "DOP853", rtol=1e-12, atol=1e-9).y[:, -1]
    return float(0.5 * end[:4] @ np.linalg.solve(end[4:].reshape(4, 4), end[:4]))


def build(eccentricity: float = ECCENTRICITY) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    eccentricity : float
    """
    chaser = go.Model("chaser")
    x, y, vx, vy = (chaser.state(name, unit="m") for name in STATES)
    a = chaser.control("a", 2, unit="m")
    gravity = 3 / (1 + eccentricity * ca.cos(chaser.time))
    chaser.ode({x: vx, y: vy, vx: 2 * vy + gravity * x + a[0], vy: -2 * vx + a[1]})

    problem = go.Problem("rendezvous on an ellipse", time_unit="rad")
    approach = problem.phase("approach", chaser)
    approach.time(initial=FIRST, final=LAST)
    approach.initial(**dict(zip(STATES, START, strict=True)))
    approach.final(**dict.fromkeys(STATES, 0.0))
    problem.minimize(0.5 * approach.integral(ca.dot(a, a)), unit="m^2")
    return problem


REFERENCE = Reference(least_energy(), "Gramian of the transition matrix, integrated", 1e-3, "m^2")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
