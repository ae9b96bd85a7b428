r"""Controllers of the flexible spacecraft: the published quasi-sliding mode, a regulator along a plan, their loop.

The quasi-sliding mode follows a reference (index r) with the error quaternion :math:`\delta q = q_r^{-1} \otimes q`,
:math:`\sigma = \mathrm{sign}\,\delta q_0`, :math:`v = \sigma\, \delta q_v`, and the rate relative to it,
:math:`\omega_e = \omega_{BO} - C_{BR}\, \omega_{RO}`:

.. math::
   e = -2 v, \qquad \dot e = -(|\delta q_0|\, \omega_e + v \times \omega_e), \qquad S = \dot e + c\, e, \\
   u = u_r + \omega \times J \omega - \omega_r \times J \omega_r
       + G\, [\epsilon \tanh(S / \delta) + k S + c\, \dot e] .

With e = x_d - x and g > 0 the reaching condition dS/dt = -eps tanh(S) - k S asks for these signs; the publication
prints minus signs (its equations 34, 35, 41, 42), which make S grow. k = 0 is its QSMC, k > 0 its RQSMC.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.control import (
    Controller,
    DesignReport,
    Reference,
    ReportEntry,
    bryson,
    design_tvlqr,
    initial_state_function,
    law_function,
)
from gnc_opt.control.feedforward_and_reference_schedule import (
    ReferenceSchedule,
    build_reference_signal_layout,
)
from gnc_opt.model.model_variables import Layout
from gnc_opt.simulation import ClosedLoop, ConstantDisturbance, Disturbance, Saturation, SinusoidalDisturbance
from gnc_opt.spacecraft import (
    FlexibleBody,
    cross,
    quaternion_conjugate,
    quaternion_product,
    quaternion_to_dcm,
)
from problems.flexible_spacecraft.model import BODY, DISTURBANCE, INERTIA, MAX_TORQUE


@dataclass(frozen=True)
class QuasiSlidingMode:
    """Gains of the law: diagonal of G = 1/g, slope c of the surface (1/s), eps and k of the reaching law.

    ``delta`` is the width of the boundary layer; ``switching`` takes sign(S) instead of tanh(S / delta);
    ``printed_sign`` takes minus eps tanh and minus k S, as printed: unstable.
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
    signals = build_reference_signal_layout(reference)
    t, x = ca.SX.sym("t"), ca.SX.sym("x", states.size)
    r, z = ca.SX.sym("r", signals.size), ca.SX.sym("z", 0)
    attitude, rate = states.slice("q_BO"), states.slice("omega")
    frame = ca.vertcat(0, -float(model.parameter_values[0]), 0)
    followed = (r[attitude], r[rate], r[states.size : states.size + controls.size])
    u = gains.torque(x[attitude], x[rate], frame, body, followed)
    name = "RQSMC" if gains.k else "QSMC"
    facts = (
        ReportEntry("slope c", gains.c, "1/s"),
        ReportEntry("reaching law", np.array([gains.eps, gains.k, gains.delta]), "", "eps, k, delta"),
        ReportEntry("torque per unit of the reaching law", np.array(gains.gain), "", "diagonal of G"),
    )
    return Controller(
        name=name,
        step=law_function(t, x, r, z, u, z),
        start=initial_state_function(t, x, r, z),
        states=states,
        commands=controls,
        signals=signals,
        memory=Layout("memory", (), name),
        schedule=ReferenceSchedule(reference),
        span=(reference.initial_time, reference.final_time),
        explanation=DesignReport(f"{name} of '{model.name}' along {reference!r}", facts),
    )


def tvlqr(reference: Reference) -> Controller:
    """Return the time-varying regulator of attitude, rate and modes, which must be measured or estimated."""
    model = reference.model
    return design_tvlqr(
        model,
        reference,
        Q=bryson(model.errors, q_BO=2e-3, omega=1e-3, eta=2e-3, eta_rate=2e-3),
        R=bryson(model.controls, torque=1e-2),
    )


def mean_disturbance(amplitude: float = DISTURBANCE) -> tuple[Disturbance, ...]:
    """Return the published disturbance, sin t and a random part, with the latter at its mean: others can compute it."""
    return (
        SinusoidalDisturbance("wave", amplitude, 1.0, on="torque"),
        ConstantDisturbance("push", amplitude / 2, on="torque"),
    )


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
