r"""Hyper-sensitive problem: 10 000 s, of which only the first and the last ten matter.

This example shows the purpose of mesh refinement. The optimum decays to zero, stays there, and rises at the end (a
turnpike). A uniform mesh needs tens of thousands of points, and shooting fails, since errors grow like :math:`e^t`.
Each boundary layer is the stable or unstable manifold of the origin, where H = 0 gives the costate as a function of
the state, and the layer in closed form.

State: ``x``. Control: ``u``, -50 to 50 (never reached). No units; time in s.

.. math::
   \dot x = -x^3 + u, \qquad J = \tfrac12 \int_0^{t_f} (x^2 + u^2)\,dt

Closed form, up to :math:`e^{-t_f}`: with :math:`y = x^2`, from the start and likewise backwards from the end,

.. math::
   y = \frac{1}{\sinh(2 t + \operatorname{arsinh}(1 / y_0))}, \qquad \lambda = -u = -x^3 \pm x \sqrt{x^4 + 1}

with + at the start and - at the end.

Source: Rao and Mease, Eigenvector approximate dichotomic basis method for solving hyper-sensitive optimal control
problems, Optimal Control Applications and Methods 21, 2000.
"""

from __future__ import annotations

import numpy as np

import gnc_opt as go
from problems._example import Array, Extremal, Reference, example_main

DURATION = 10_000.0
"""s."""
FIRST, LAST = 1.5, 1.0
"""x at both ends."""


def build(duration: float = DURATION) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    duration : float
        s; from about 20 on, the cost no longer depends on it.
    """
    plant = go.Model("cubic decay")
    x = plant.state("x")
    u = plant.control("u")
    plant.ode({x: -(x**3) + u})

    problem = go.Problem("hyper-sensitive")
    stay = problem.phase("stay", plant)
    stay.time(initial=0.0, final=duration)
    stay.initial(x=FIRST)
    stay.final(x=LAST)
    stay.bounds(u=(-50.0, 50.0))
    problem.minimize(stay.integral((x**2 + u**2) / 2, "cost"))
    return problem


def _layer(distance: Array, at_end: float) -> Array:
    """Return x at a distance (s) from the end where it has the given value."""
    # Beyond an argument of 700 sinh overflows, and x is zero to 150 digits.
    argument = np.minimum(2 * distance + np.arcsinh(1 / at_end**2), 700.0)
    return np.asarray(1 / np.sqrt(np.sinh(argument)))


def closed_form(t: Array) -> Extremal:
    """Return the two layers and their costates at times t (s)."""
    early = t < DURATION / 2
    x = np.where(early, _layer(t, FIRST), _layer(DURATION - t, LAST))
    lam = -(x**3) + np.where(early, 1.0, -1.0) * x * np.sqrt(x**4 + 1)
    return Extremal(states={"x": x}, controls={"u": -lam}, costates={"x": lam})


def _cost() -> float:
    """Return the sum of the costs of both layers: the integrals of the costate over x."""

    def half(x: float) -> float:
        return float((x**2 * np.sqrt(x**4 + 1) + np.arcsinh(x**2)) / 4)

    return half(FIRST) - FIRST**4 / 4 + half(LAST) + LAST**4 / 4


REFERENCE = Reference(_cost(), "closed form up to exp(-10000)", 1e-8)


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
