r"""The flexible spacecraft of Taei and Moradi: data, model and its quasi-sliding-mode law.

States: ``q_BO``, attitude of body axes B relative to orbital axes O, scalar part first; ``omega`` = omega_BI_B, the
inertial rate (rad/s); ``eta`` and ``eta_rate``, four modal coordinates (kg^0.5 m) and their rates. Control: ``torque``
in B (N m). The orbital axes turn at (0, -omega_0, 0).

.. math::
   J \dot\omega + C \ddot\eta + \omega \times (J \omega + C \dot\eta) &= T + T_d \\
   \ddot\eta + 2 \xi \Lambda \dot\eta + \Lambda^2 \eta + C^T \dot\omega &= 0 \\
   \dot q = \tfrac12\, q \otimes (0, \omega_r), \qquad \omega_r &= \omega - C_{BO} (0, -\omega_0, 0)^T

The law follows a reference (index r) with the error quaternion :math:`\delta q = q_r^{-1} \otimes q`,
:math:`\sigma = \mathrm{sign}\,\delta q_0`, :math:`v = \sigma\, \delta q_v`, and the rate relative to it,
:math:`\omega_e = \omega_{BO} - C_{BR}\, \omega_{RO}`:

.. math::
   e = -2 v, \qquad \dot e = -(|\delta q_0|\, \omega_e + v \times \omega_e), \qquad S = \dot e + c\, e, \\
   u = u_r + \omega \times J \omega - \omega_r \times J \omega_r
       + G\, [\epsilon \tanh(S / \delta) + k S + c\, \dot e] .

With e = x_d - x and g > 0 the reaching condition dS/dt = -eps tanh(S) - k S asks for these signs; the publication
prints minus signs (its equations 34, 35, 41, 42), which make S grow. k = 0 is its QSMC, k > 0 its RQSMC.

Source: Taei and Moradi, "Applying robust quasi-sliding mode approach for attitude control of a flexible spacecraft",
J. Aerospace Mechanics 19 (3), 97-108, 2023.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

import gnc_opt as go
from gnc_opt.control import Controller, Explanation, Fact, Reference, first_memory, law
from gnc_opt.control.schedule import ReferenceSchedule, reference_signals
from gnc_opt.errors import GncOptError
from gnc_opt.model.layout import Array, Layout
from gnc_opt.simulation import ClosedLoop, Disturbance, Run, Saturation
from gnc_opt.simulation.block import Defaults, Parameters, Tick, scalar
from gnc_opt.spacecraft import (
    FlexibleBody,
    cross,
    quaternion_conjugate,
    quaternion_difference,
    quaternion_product,
    quaternion_rate,
    quaternion_to_dcm,
)

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

FULL_FREQUENCIES = (0.7681, 1.1038, 1.8733, 2.5496)
"""The published ones before rounding, rad/s."""
FULL_DAMPING = (0.0056, 0.0086, 0.013, 0.025)
FULL = flexible_body(COUPLING, FULL_FREQUENCIES, FULL_DAMPING)


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
    spacecraft.ode(
        {q: quaternion_rate(q, relative), omega: turning, eta: eta_rate, eta_rate: bending},
    )
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


# --- the law --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class QuasiSlidingMode:
    """Gains of the law.

    Attributes
    ----------
    gain : tuple of 3
        Diagonal of G = 1/g.
    c : float
        Slope of the surface, 1/s.
    eps, k : float
        Of the reaching law.
    delta : float
        Width of the boundary layer.
    switching : bool
        sign(S) instead of tanh(S / delta).
    printed_sign : bool
        Minus eps tanh and minus k S, as printed: unstable.
    """

    gain: tuple[float, float, float]
    c: float
    eps: float
    delta: float
    k: float = 0.0
    switching: bool = False
    printed_sign: bool = False

    def torque(self, q: Any, omega: Any, frame: Any, body: FlexibleBody, r: tuple[Any, Any, Any]) -> Any:
        """Return the command, SX (3, 1), without limits.

        ``frame`` is the rate of the orbital axes in O; ``r`` attitude, rate and torque of the reference.
        """
        q_r, omega_r, u_r = r
        error = quaternion_product(quaternion_conjugate(q_r), q)
        sign = ca.if_else(error[0] < 0, -1.0, 1.0)
        v = sign * error[1:4]
        turning_r = omega_r - quaternion_to_dcm(q_r) @ frame
        relative = omega - quaternion_to_dcm(q) @ frame - quaternion_to_dcm(error) @ turning_r
        e, e_rate = -2 * v, -(ca.fabs(error[0]) * relative + cross(v, relative))
        s = e_rate + self.c * e
        reaching = self.eps * (ca.sign(s) if self.switching else ca.tanh(s / self.delta)) + self.k * s
        if self.printed_sign:
            reaching = -reaching
        inertia = ca.DM(body.inertia)
        gyroscopic = cross(omega, inertia @ omega) - cross(omega_r, inertia @ omega_r)
        return u_r + gyroscopic + ca.DM(self.gain) * (reaching + self.c * e_rate)


UNIT = QuasiSlidingMode((1.0, 1.0, 1.0), c=4.5, eps=0.3, delta=1.0)
"""Configuration U: the printed gains with G = 1, eps in N m."""
UNIT_ROBUST = QuasiSlidingMode((1.0, 1.0, 1.0), c=4.5, eps=0.3, delta=1.0, k=0.07)
INERTIAL = QuasiSlidingMode(INERTIA, c=0.08, eps=0.003, delta=0.02)
"""Configuration J: G = J, gains retuned."""
INERTIAL_ROBUST = QuasiSlidingMode(INERTIA, c=0.08, eps=0.003, delta=0.02, k=0.05)


def quasi_sliding_mode(
    model: go.Model, reference: Reference, gains: QuasiSlidingMode, *, body: FlexibleBody = BODY
) -> Controller:
    """Return the controller: it measures attitude and rate only, and knows the hub's inertia but no mode.

    Parameters
    ----------
    model : Model
        Of `build_model`.
    reference : Reference
        `target`, or an optimal slew; its torque is fed forward.
    gains : QuasiSlidingMode
    """
    states, controls = model.states, model.controls
    signals = reference_signals(reference)
    t, x = ca.SX.sym("t"), ca.SX.sym("x", states.size)
    r, z = ca.SX.sym("r", signals.size), ca.SX.sym("z", 0)
    attitude, rate = states.slice("q_BO"), states.slice("omega")
    frame = ca.vertcat(0, -float(model.parameter_values[0]), 0)
    followed = (r[attitude], r[rate], r[states.size : states.size + controls.size])
    u = gains.torque(x[attitude], x[rate], frame, body, followed)
    name = "RQSMC" if gains.k else "QSMC"
    facts = (
        Fact("slope c", gains.c, "1/s"),
        Fact("reaching law", np.array([gains.eps, gains.k, gains.delta]), "", "eps, k, delta"),
        Fact("torque per unit of the reaching law", np.array(gains.gain), "", "diagonal of G"),
    )
    return Controller(
        name=name,
        step=law(t, x, r, z, u, z),
        start=first_memory(t, x, r, z),
        states=states,
        commands=controls,
        signals=signals,
        memory=Layout("memory", (), name),
        schedule=ReferenceSchedule(reference),
        span=(reference.initial_time, reference.final_time),
        explanation=Explanation(f"{name} of '{model.name}' along {reference!r}", facts),
    )


# --- the loop -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PublishedDisturbance(Disturbance):
    """``amplitude * (sin t + r)`` on every axis, r uniform in (0, 1), a new one for every axis and control step."""

    amplitude: float = DISTURBANCE

    def parameters(self, size: int, unit: str) -> Defaults:
        return {"amplitude": (scalar(self.amplitude, f"the amplitude of '{self.name}'"), unit)}

    def noise(self, size: int) -> int:
        return size

    def start(self, signal: Any, p: Parameters, tick: Tick) -> Any:
        return ca.SX.zeros(signal.shape[0])

    def update(self, tick: Tick, state: Any, p: Parameters, noise: Any) -> Any:
        return 0.5 * (
            1 + ca.erf(noise / np.sqrt(2.0))
        )  # the distribution function of a normal number is uniform

    def value(self, t: Any, x: Any, state: Any, p: Parameters) -> Any:
        return p["amplitude"] * (ca.sin(t) + state)


def loop(
    model: go.Model,
    controller: Controller,
    *,
    dt: float,
    disturbances: tuple[Disturbance, ...] = (),
    substeps: int | None = None,
) -> ClosedLoop:
    """Return the closed loop with the torque limit.

    Integration steps of up to 0.025 s are enough for modes of 2.7 rad/s; each run checks that.
    """
    limit = Saturation("limit", -MAX_TORQUE, MAX_TORQUE)
    return ClosedLoop(
        model,
        controller,
        actuators=[limit],
        disturbances=disturbances,
        dt=dt,
        accuracy=1e-7,
        substeps=substeps or int(np.ceil(dt / 0.025 - 1e-9)),
    )


def fly_loop(closed: ClosedLoop, x0: ArrayLike, tf: float) -> Run:
    """Return the run of a loop; refuse one that is not accurate or not finite.

    Raises
    ------
    GncOptError
        The run's own outcome, if it is not ok.
    """
    run = closed.simulate(x0, tf=tf)
    if not run.outcome.ok:
        raise GncOptError(f"the run of '{closed.controller.name}' is {run.outcome}: give more substeps.")
    return run
