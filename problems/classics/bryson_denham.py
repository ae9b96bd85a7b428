r"""Bryson-Denham: minimum effort with a limit on position.

A mass is thrown back with minimum effort and must not pass a wall at :math:`l = 1/9` m. This example shows a state
constraint of second order: the control appears in the second derivative of :math:`x \le l`. At both ends of the
active arc :math:`\lambda_x` jumps down by 18, while the control is continuous. A constraint that is enforced at the
nodes only gives a wrong result: one segment of degree 8 gives J = 3.982, half a percent *below* the optimum, with an
ODE residual of zero. A check between the nodes finds this.

States: ``x`` (m), ``v`` (m/s). Control: ``a`` (m/s^2).

.. math::
   \dot x = v, \qquad \dot v = a, \qquad J = \tfrac12 \int_0^1 a^2\,dt, \qquad x \le l

Closed form for :math:`l \le 1/6`: the limit is active from :math:`3 l` to :math:`1 - 3 l`. Before, with
:math:`z = 1 - t / (3 l)`,

.. math::
   x = l (1 - z^3), \quad v = z^2, \quad a = -\frac{2 z}{3 l}, \quad \lambda_x = \frac{2}{9 l^2}, \quad
   \lambda_v = -a, \quad J = \frac{4}{9 l}

Afterwards the motion is mirrored.

Source: Bryson and Ho, Applied Optimal Control, 1975, page 120.
"""

from __future__ import annotations

import numpy as np

import gnc_opt as go
from problems._example import Array, Extremal, Reference, example_main

LIMIT = 1 / 9
"""l, m."""


def build(limit: float = LIMIT) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    limit : float
        Limit of x, m: active on an arc up to 1/6, at one time up to 1/4, inactive above.
    """
    mass = go.Model("double integrator")
    x = mass.state("x", unit="m")
    v = mass.state("v", unit="m/s")
    a = mass.control("a", unit="m/s^2")
    mass.ode({x: v, v: a})

    problem = go.Problem("Bryson-Denham")
    bounce = problem.phase("bounce", mass)
    bounce.time(initial=0.0, final=1.0)
    bounce.initial(x=0.0, v=1.0)
    bounce.final(x=0.0, v=-1.0)
    bounce.bounds(x=(None, limit))
    problem.minimize(bounce.integral(a**2 / 2, "effort"), unit="m^2/s^3")
    return problem


def closed_form(t: Array) -> Extremal:
    """Return the optimum and its costates (constraint adjoined directly) at times t (s)."""
    z = np.maximum(1 - np.minimum(t, 1 - t) / (3 * LIMIT), 0.0)  # 0 on the limit
    side = np.where(z > 0, np.sign(0.5 - t), 0.0)
    a = -2 * z / (3 * LIMIT)
    return Extremal(
        states={"x": LIMIT * (1 - z**3), "v": side * z**2},
        controls={"a": a},
        costates={"x": side * 2 / (9 * LIMIT**2), "v": -a},
    )


REFERENCE = Reference(4 / (9 * LIMIT), "closed form: 4 / (9 l)", 1e-10, "m^2/s^3")


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
