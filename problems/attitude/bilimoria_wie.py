r"""Bilimoria and Wie: turn a spherically symmetric satellite by 180 degrees in minimum time.

This example shows a saddle point. The turn about the axis itself (eigenaxis) takes :math:`2 \sqrt\pi` = 3.5449 s and
satisfies every first-order condition; nutation through the other two axes is 8.5 % faster, since the torque vector of
three independent axes is longer than that of one. A guess on the axis stays there; the default guess is perturbed.
The norm of the quaternion is conserved, so the component of its costate along q is arbitrary.

States: ``q``, quaternion of body axes B relative to inertial axes A, scalar part first; ``omega``
(rad/s) of B relative to A. Control: ``torque`` in B (N m), -1 to 1 each; the inertia is 1 kg m^2 about every axis.

.. math::
   \dot q = \tfrac12\, q \otimes (0, \omega), \qquad \dot\omega = T / I

Structure: five switches, at `SWITCH_TIMES`; by symmetry there are several equally good mirror images.

Source: Bilimoria and Wie, Time-optimal three-axis reorientation of a rigid spacecraft, J. Guidance, Control, and
Dynamics 16 (3), 1993 (3.2430).
"""

from __future__ import annotations

import numpy as np

import gnc_opt as go
from gnc_opt.plot import View
from gnc_opt.spacecraft import quaternion_rate
from problems._example import Reference, example_main

EIGENAXIS_TIME = 2 * np.sqrt(np.pi)
"""Of the turn about one axis only, s."""
SWITCH_TIMES = (0.4454389949, 1.1761026438, 1.6215416387, 2.0669806337, 2.7976442825)
"""Of all axes, from an independent calculation, s."""


def build(angle: float = np.pi) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    angle : float
        Angle of the rotation about the third axis, rad.
    """
    satellite = go.Model("spherically symmetric satellite")
    q_BA = satellite.state("q", 4)
    omega_BA_B = satellite.state("omega", 3, unit="rad/s")
    torque_B = satellite.control("torque", 3, unit="N m")
    inertia = satellite.parameter("inertia", 1.0, unit="kg m^2")
    satellite.ode({q_BA: quaternion_rate(q_BA, omega_BA_B), omega_BA_B: torque_B / inertia})

    problem = go.Problem("Bilimoria-Wie reorientation")
    turn = problem.phase("turn", satellite)
    turn.time(initial=0.0, final=(0.5, 20.0))
    turn.initial(q=[1.0, 0.0, 0.0, 0.0], omega=0.0)
    turn.final(q=[np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)], omega=0.0)
    turn.bounds(q=(-1.1, 1.1), omega=(-5.0, 5.0), torque=(-1.0, 1.0))
    turn.guess([0.0, 3.5])
    problem.minimize(turn.final_time)
    return problem


REFERENCE = Reference(3.2430832775, "independent, switch times optimised, best of many starts", 1e-8, "s")

VIEW = View(attitude="q")
"""What a report shows moving: it turns in place."""


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
