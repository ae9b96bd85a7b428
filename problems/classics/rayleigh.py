r"""Rayleigh's equation with a mixed constraint: a limit on state and control together.

This example shows a constraint on the control that depends on the state. Where it is active it determines the
control, and its multiplier, a density in time, follows from the stationarity of H. It becomes active and inactive
with kinks of the control, which refinement places on mesh boundaries.

States: ``x1``, ``x2``. Control: ``u``, with u + x1 / 6 <= 0. No units; time in s.

.. math::
   \dot x_1 = x_2, \qquad \dot x_2 = -x_1 + x_2 (1.4 - 0.14 x_2^2) + 4 u, \qquad J = \int_0^{4.5} (u^2 + x_1^2)\,dt

Source: Maurer and Augustin, Sensitivity analysis and real-time control of parametric optimal control problems using
boundary value methods, in Groetschel et al., Online Optimization of Large Scale Systems, 2001; Betts, 2010
(44.8044433).
"""

from __future__ import annotations

import gnc_opt as go
from problems._example import Reference, example_main


def build(limit: float = 0.0) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    limit : float
        Upper limit of u + x1 / 6.
    """
    plant = go.Model("Rayleigh")
    x1, x2 = plant.state("x1"), plant.state("x2")
    u = plant.control("u")
    plant.ode({x1: x2, x2: -x1 + x2 * (1.4 - 0.14 * x2**2) + 4 * u})

    problem = go.Problem("Rayleigh with a mixed constraint")
    leg = problem.phase("leg", plant)
    leg.time(initial=0.0, final=4.5)
    leg.initial(x1=-5.0, x2=-5.0)
    leg.path("mixed", u + x1 / 6, upper=limit)
    problem.minimize(leg.integral(u**2 + x1**2))
    return problem


REFERENCE = Reference(44.8044449, "independent Radau collocation, two meshes; Betts 2010: 44.8044433", 1e-6)


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
