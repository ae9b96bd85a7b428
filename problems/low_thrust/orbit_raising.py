r"""Orbit raising: the largest circular orbit in a given time.

This example shows steering by a unit vector instead of an angle: the direction is a control of two components with
its norm as a path equality, which has no singularity. The optimum first thrusts outwards, and turns inwards by a
steep reversal about halfway. The circular orbit at the end is a boundary constraint between two free states.

States: ``r``, ``v_r`` and ``v_t``, radial and transverse velocity. Control: ``direction``, the unit vector of
the thrust, radial and transverse. Units are canonical, mu = 1: for the Earth's orbit about the Sun, 1 AU, 29.78
km/s, 58.13 days; the transfer takes 3.32, or 193 days.

.. math::
   \dot r = v_r, \qquad \dot v_r = \frac{v_t^2}{r} - \frac{1}{r^2} + a u_r, \qquad
   \dot v_t = -\frac{v_r v_t}{r} + a u_t, \qquad a = \frac{0.1405}{1 - 0.0749\, t}

Source: Moyer and Pinkham, 1964; Bryson and Ho, Applied Optimal Control, 1975, section 2.5.
"""

from __future__ import annotations

import casadi as ca

import gnc_opt as go
from problems._example import Reference, example_main

ACCELERATION, MASS_RATE = 0.1405, 0.0749
"""Thrust and mass flow, per initial mass."""


def build(duration: float = 3.32) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    duration : float
        Duration of the transfer, canonical time units.
    """
    ship = go.Model("low-thrust ship")
    r = ship.state("r")
    v_r = ship.state("v_r")
    v_t = ship.state("v_t")
    direction = ship.control("direction", 2)
    a = ACCELERATION / (1 - MASS_RATE * ship.time)
    ship.ode({r: v_r, v_r: v_t**2 / r - 1 / r**2 + a * direction[0], v_t: -v_r * v_t / r + a * direction[1]})

    problem = go.Problem("orbit raising", time_unit="√(AU³/μ)")
    transfer = problem.phase("transfer", ship)
    transfer.time(initial=0.0, final=duration)
    transfer.initial(r=1.0, v_r=0.0, v_t=1.0)
    transfer.final(v_r=0.0)
    transfer.bounds(r=(0.9, 10.0))
    transfer.path("unit direction", ca.sumsqr(direction), equals=1.0)
    transfer.guess(r=(1.0, 1.5), v_t=(1.0, 0.8), direction=([0.0, 1.0], [1.0, 0.0]))
    r_f, v_f = transfer.final_state("r"), transfer.final_state("v_t")
    problem.constrain("circular at the end", v_f - 1 / ca.sqrt(r_f), equals=0.0)
    problem.maximize(r_f, unit="AU")
    return problem


REFERENCE = Reference(1.525277700649, "independent collocation, two meshes agree", 1e-9, "AU")


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
