r"""Van der Pol's oscillator, calmed by a bounded force: bang, bang, singular.

This example shows the derivation of a singular arc. The control enters linearly, so on a singular arc
:math:`\lambda_y = 0`. Its first derivative gives :math:`\lambda_x = -y`, the second :math:`\dot y = x`, and the
dynamics then require the feedback :math:`u = 2 x - y (1 - x^2)`. The end is free, so the optimum stays on that arc to
the end.

States: ``x``, ``y``. Control: ``u``, -1 to 1. No units; time in s.

.. math::
   \dot x = y, \qquad \dot y = -x + y (1 - x^2) + u, \qquad J = \tfrac12 \int_0^4 (x^2 + y^2)\,dt

Structure: u = -1 until 1.3667, +1 until 2.4609, then singular.

Source: Maurer, 2007; Vossen, Switching time optimization for bang-bang and singular controls, J. Optimization
Theory and Applications 144, 2010 (0.757618).
"""

from __future__ import annotations

import gnc_opt as go
from problems._example import Array, Reference, example_main

SWITCH_TIMES = (1.3667400311, 2.4608743843)
"""By shooting with the feedback law, s: y(4) = 0, and lam_y = 0 at the first switch."""


def build(duration: float = 4.0) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    duration : float
        s.
    """
    oscillator = go.Model("Van der Pol oscillator")
    x = oscillator.state("x")
    y = oscillator.state("y")
    u = oscillator.control("u")
    oscillator.ode({x: y, y: -x + y * (1 - x**2) + u})

    problem = go.Problem("Van der Pol, bang-bang-singular")
    calm = problem.phase("calm", oscillator)
    calm.time(initial=0.0, final=duration)
    calm.initial(x=0.0, y=1.0)
    calm.bounds(u=(-1.0, 1.0))
    problem.minimize(calm.integral((x**2 + y**2) / 2, "energy"))
    return problem


def singular_control(x: Array, y: Array) -> Array:
    """Return the control of the singular arc as a feedback of the states."""
    return 2 * x - y * (1 - x**2)


REFERENCE = Reference(0.7576179287, "independent, switch times optimised", 1e-9)


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
