r"""What runs on board: an estimator, a law, and the wheels' limits, all of them one controller of measurements.

**Estimator.** An extended Kalman filter, multiplicative for the attitude (Lefferts, Markley and Shuster, Kalman
filtering for spacecraft attitude estimation, J. Guidance, Control, and Dynamics 5 (5), 1982), of attitude, rates,
momenta of the wheels and bias of the gyro, of star tracker, gyro and tachometers. It takes the commands as applied, and
knows neither the motors' lag nor the run's inertia, wheels and external torque, which its process noise stands for.

**Laws.** The regulator along the slew of least energy (`problems.reaction_wheels.optimal.design_tracker`), and the two
published ones, feedback linearisation and quaternion feedback, which turn straight to the target
(`problems.reaction_wheels.laws`).

**Limits.** Wheel i with the momentum h_i gets its torque T_i cut to

.. math:: |T_i| \le \eta T_{max}, \qquad
   \frac{h_i - \eta h_{max}}{\tau_c} \le T_i \le \frac{h_i + \eta h_{max}}{\tau_c}

(:math:`\dot h_i = -T_i`): no wheel comes closer to its largest speed than by the time constant :math:`\tau_c`, which
leaves its motor time to follow; :math:`\eta` is for motors that give more than they are told, and for noise.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

import gnc_opt as go
from gnc_opt.control import Controller, bridge_dropouts, law
from gnc_opt.estimation import Estimator, Measurement, output_feedback
from gnc_opt.simulation.block import clip
from problems.attitude_control.model import (
    GYRO_BIAS,
    GYRO_NOISE,
    GYRO_WALK,
    MAX_MOMENTUM,
    MAX_TORQUE,
    TACHOMETER_NOISE,
    TARGET,
    TRACKER_DELAY,
    TRACKER_NOISE,
    TRACKER_PERIOD,
    slew,
)
from problems.kept import kept
from problems.reaction_wheels.laws import design_flc, design_quaternion_lqr
from problems.reaction_wheels.model import INVERSE, REST, wheel_model
from problems.reaction_wheels.optimal import design_tracker

DT = 0.1
"""Control step, s."""
SHARE = 0.97
"""Of torque and momentum that are used."""
CLOSING = 0.5
"""Time constant with which a wheel comes to its largest speed at most, s."""
FIRST = {"q": 0.02, "omega": 1e-3, "h": 0.01}
"""Errors of the expected start (1 sigma), rad, rad/s, N m s."""
UNKNOWN = {"omega": 3e-4, "h": 1e-3}
"""Process noise: what wrong inertia, wheels, lag and torques do, rad/s^1.5 and N m s^0.5."""

LAWS = ("least energy", "FLC", "LQR")


@kept
def estimator(*, bias: bool = True) -> Estimator:
    """Return the filter, for comparison also one that does not know of the gyro's bias."""
    wrong = {"bias": 2 * GYRO_BIAS, "bias_walk": GYRO_WALK} if bias else {}
    return go.design_ekf(
        wheel_model(),
        REST,
        [
            Measurement("q", TRACKER_NOISE, period=TRACKER_PERIOD, delay=TRACKER_DELAY, gate=0.99999),
            Measurement("omega", GYRO_NOISE, **wrong),
            Measurement("h", TACHOMETER_NOISE),
        ],
        sigma0=FIRST,
        process_noise=UNKNOWN,
        dt=DT,
    )


def within_limits(controller: Controller) -> Controller:
    """Return a law of wheel or body torques as one of wheel torques that keeps the wheels' limits."""
    inner, craft = controller.unbridged or controller, wheel_model()
    t, x, r, z = (
        ca.SX.sym(name, n)
        for name, n in (("t", 1), ("x", 11), ("r", inner.signals.size), ("z", inner.memory.size))
    )
    wanted, after = inner.step(t, x, r, z)
    torques = wanted if "T" in inner.commands else ca.DM(INVERSE) @ wanted
    h, most = x[craft.states.slice("h")], SHARE * MAX_MOMENTUM
    torques = clip(torques, (h - most) / CLOSING, (h + most) / CLOSING)
    torques = clip(torques, -SHARE * MAX_TORQUE, SHARE * MAX_TORQUE)
    return bridge_dropouts(
        replace(
            inner,
            step=law(t, x, r, z, torques, after),
            commands=craft.controls,
            unbridged=None,
            flight=None,
            dt=DT,
        )
    )


def controller(name: str, *, bias: bool = True) -> Controller:
    """Return all that runs on board with one of `LAWS`."""
    if name == "least energy":
        inner = design_tracker(slew(), MAX_TORQUE)
    else:
        inner = design_flc(TARGET) if name == "FLC" else design_quaternion_lqr(TARGET)
    return output_feedback(within_limits(inner), estimator(bias=bias))
