r"""The flexible spacecraft of Taei and Moradi: data and dynamics.

States: ``q_BO``, attitude of body axes B relative to orbital axes O, scalar part first; ``omega`` = omega_BI_B, the
inertial rate (rad/s); ``eta`` and ``eta_rate``, four modal coordinates (kg^0.5 m) and their rates. Control: ``torque``
in B (N m). The orbital axes turn at (0, -omega_0, 0).

.. math::
   J \dot\omega + C \ddot\eta + \omega \times (J \omega + C \dot\eta) &= T + T_d \\
   \ddot\eta + 2 \xi \Lambda \dot\eta + \Lambda^2 \eta + C^T \dot\omega &= 0 \\
   \dot q = \tfrac12\, q \otimes (0, \omega_r), \qquad \omega_r &= \omega - C_{BO} (0, -\omega_0, 0)^T

Source: Taei and Moradi, "Applying robust quasi-sliding mode approach for attitude control of a flexible spacecraft",
J. Aerospace Mechanics 19 (3), 97-108, 2023.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.control import Reference
from gnc_opt.spacecraft import FlexibleBody, quaternion_difference, quaternion_rate, quaternion_to_dcm

INERTIA = (100.0, 75.0, 50.0)
"""Principal moments, kg m^2."""
COUPLING = (
    (6.45637, -1.25619, 1.11687, 1.23637),
    (1.27814, 0.91756, 2.48901, -2.6581),
    (2.15629, -1.67264, -0.83674, -1.12503),
)
"""kg^0.5 m; the publication prints it cut to one digit."""
FREQUENCIES = (0.7, 1.0, 1.8, 2.5)
"""Of the clamped appendages, rad/s."""
DAMPING = (0.0056, 0.0086, 0.0128, 0.0252)
ORBITAL_RATE = 1.078e-3
"""rad/s; the printed 1.078e-2 would be an orbit of 583 s."""
MAX_TORQUE = 0.5
"""N m, each axis."""
INITIAL_ATTITUDE = (float(np.sqrt(0.1)), 0.7, -0.5, -0.4)
"""143.1 degrees from the target; printed as initial "rates"."""
DISTURBANCE = 5e-4 * float(np.sqrt(3.0)) / 3
"""Amplitude of sin t and of the random part, N m."""


def flexible_body(coupling: ArrayLike, frequencies: ArrayLike, damping: ArrayLike) -> FlexibleBody:
    """Return a body with the hub's inertia."""
    arrays = (np.asarray(values, dtype=float) for values in (INERTIA, coupling, frequencies, damping))
    return FlexibleBody(*arrays)


BODY = flexible_body(COUPLING, FREQUENCIES, DAMPING)


def build_model(body: FlexibleBody = BODY, orbital_rate: float = ORBITAL_RATE) -> go.Model:
    """Return the dynamics: 15 states, 3 controls."""
    spacecraft = go.Model("flexible spacecraft")
    q = spacecraft.state("q_BO", 4)
    omega = spacecraft.state("omega", 3, unit="rad/s")
    eta = spacecraft.state("eta", body.frequencies.size, unit="kg^0.5 m")
    eta_rate = spacecraft.state("eta_rate", body.frequencies.size, unit="kg^0.5 m/s")
    torque = spacecraft.control("torque", 3, unit="N m")
    omega_0 = spacecraft.parameter("omega_0", orbital_rate, unit="rad/s")
    turning, bending = body.accelerations(omega, eta, eta_rate, torque)
    relative = omega - quaternion_to_dcm(q) @ ca.vertcat(0, -omega_0, 0)
    spacecraft.ode({q: quaternion_rate(q, relative), omega: turning, eta: eta_rate, eta_rate: bending})
    spacecraft.difference(q, quaternion_difference)
    return spacecraft


def rest(model: go.Model, attitude: Any) -> Array:
    """Return the state (n_states,) at rest in the orbital frame, without deflection."""
    q = np.asarray(attitude, dtype=float)
    frame = np.array([0.0, -float(model.parameter_values[0]), 0.0])
    still = np.zeros(model.states.size)
    still[model.states.slice("q_BO")] = q
    still[model.states.slice("omega")] = quaternion_to_dcm(q) @ frame
    return still


def initial_state(model: go.Model) -> Array:
    """Return the state (n_states,) before the manoeuvre."""
    return rest(model, INITIAL_ATTITUDE)


def target(model: go.Model) -> Reference:
    """Return the end of the manoeuvre as a constant reference: aligned with the orbital frame, an equilibrium."""
    return Reference.constant(model, rest(model, (1.0, 0.0, 0.0, 0.0)))
