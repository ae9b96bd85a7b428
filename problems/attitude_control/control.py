r"""On-board software: estimator, controllers and wheel limits as one controller of measurements; closed loops.

**Estimator.** An extended Kalman filter, multiplicative for the attitude (Lefferts, Markley and Shuster, Kalman
filtering for spacecraft attitude estimation, J. Guidance, Control, and Dynamics 5 (5), 1982), of attitude, rates,
momenta of the wheels and bias of the gyro, from star tracker, gyro and tachometers. It assumes that commands are
applied as given. Its process noise represents the lag of the motors and the dispersed inertia, wheels and torque.

**Laws.** The regulator along the slew of least energy (`problems.reaction_wheels.control.design_tracker`), and the two
published ones, feedback linearisation and quaternion feedback, which turn straight to the target
(`problems.reaction_wheels.control`).

**Limits.** Wheel i with the momentum h_i gets its torque T_i cut to

.. math:: |T_i| \le \eta T_{max}, \qquad
   \frac{h_i - \eta h_{max}}{\tau_c} \le T_i \le \frac{h_i + \eta h_{max}}{\tau_c}

(:math:`\dot h_i = -T_i`): no wheel comes closer to its largest speed than by the time constant :math:`\tau_c`, which
leaves its motor time to follow. The factor :math:`\eta` allows for motors that exceed their command, and for noise.

**Dispersions.** Every run differs from what is known on board by `DISPERSIONS` (the start, moments of inertia, motors
and their lag, a constant torque from outside, bias of the gyro), and by the noise of all sensors.

The star tracker measures the attitude twice a second, 0.1 s late, and not while the body turns faster than 1.5 deg/s,
which is most of the slew; later it is blinded once, from 55 to 65 s until 75 to 85 s.

After `SETTLED` the pointing error must be below `POINTING`. No wheel may exceed its limits of torque and speed.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt import simulation
from gnc_opt.control import Controller, law_function, with_dropout_handling
from gnc_opt.estimation import Estimator, Measurement, output_feedback
from gnc_opt.simulation.dispersions import Dispersion
from gnc_opt.simulation.sensor_and_actuator_block import clip_and_propagate_nan
from gnc_opt.spacecraft import quaternion_retraction
from problems.attitude_control import model
from problems.reaction_wheels.control import design_flc, design_quaternion_lqr, design_tracker
from problems.reaction_wheels.model import INVERSE, REST, wheel_model

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


@cache
def estimator(*, bias: bool = True) -> Estimator:
    """Return the filter, for comparison also one that does not know of the gyro's bias."""
    wrong = {"bias": 2 * model.GYRO_BIAS, "bias_walk": model.GYRO_WALK} if bias else {}
    return go.design_ekf(
        wheel_model(),
        REST,
        [
            Measurement(
                "q", model.TRACKER_NOISE, period=model.TRACKER_PERIOD, delay=model.TRACKER_DELAY, gate=0.99999
            ),
            Measurement("omega", model.GYRO_NOISE, **wrong),
            Measurement("h", model.TACHOMETER_NOISE),
        ],
        sigma0=FIRST,
        process_noise=UNKNOWN,
        dt=DT,
    )


def within_limits(controller: Controller) -> Controller:
    """Return a law of wheel or body torques as one of wheel torques that keeps the wheels' limits."""
    inner, craft = controller.without_dropout_handling or controller, wheel_model()
    t, x, r, z = (
        ca.SX.sym(name, n)
        for name, n in (("t", 1), ("x", 11), ("r", inner.signals.size), ("z", inner.memory.size))
    )
    wanted, after = inner.step(t, x, r, z)
    torques = wanted if "T" in inner.commands else ca.DM(INVERSE) @ wanted
    h, most = x[craft.states.slice("h")], SHARE * model.MAX_MOMENTUM
    torques = clip_and_propagate_nan(torques, (h - most) / CLOSING, (h + most) / CLOSING)
    torques = clip_and_propagate_nan(torques, -SHARE * model.MAX_TORQUE, SHARE * model.MAX_TORQUE)
    return with_dropout_handling(
        replace(
            inner,
            step=law_function(t, x, r, z, torques, after),
            commands=craft.controls,
            without_dropout_handling=None,
            codegen_law=None,
            dt=DT,
        )
    )


def controller(name: str, *, bias: bool = True) -> Controller:
    """Return all that runs on board with one of `LAWS`."""
    if name == "least energy":
        inner = design_tracker(model.slew(), model.MAX_TORQUE)
    else:
        inner = design_flc(model.TARGET) if name == "FLC" else design_quaternion_lqr(model.TARGET)
    return output_feedback(within_limits(inner), estimator(bias=bias))


END = 100.0
"""Of the runs, s."""
SETTLED = 60.0
"""s."""
POINTING = float(np.radians(0.1))
"""rad."""
START: dict[str, Any] = {
    "q": [1.0, 0.0, 0.0, 0.0],
    "omega": np.zeros(3),
    "h": np.zeros(4),
    "motor": np.zeros(4),
}

LIMITS = {
    "max(pointing)": POINTING,
    "max(torque)": model.MAX_TORQUE,
    "max(speed)": model.MAX_MOMENTUM / model.WHEEL_INERTIA / model.RPM,
}
"""rad, N m, rpm."""

DISPERSIONS: dict[str, Dispersion] = {
    "initial.q": simulation.RandomRotation(simulation.Uniform(0.0, float(np.radians(1.0)))),
    "initial.omega": simulation.Normal(float(np.radians(0.02))),
    "initial.h": simulation.Normal(50.0 * model.WHEEL_INERTIA * model.RPM),
    "plant.inertia": simulation.Uniform(-0.05, 0.05, relative=True),
    "plant.lag": simulation.Uniform(-0.3, 0.3, relative=True),
    "plant.external": simulation.Normal(2e-5),
    "motors.factor": simulation.Uniform(-0.02, 0.02),
    "gyro bias.bias": simulation.Normal(model.GYRO_BIAS),
    "glare.begin": simulation.Uniform(-5.0, 5.0),
    "glare.end": simulation.Uniform(-5.0, 5.0),
}


def loop(name: str, *, bias: bool = True) -> simulation.ClosedLoop:
    """Return the loop of one of `LAWS`, before it is dispersed; with a filter that estimates the bias or does not."""
    craft = model.plant()
    t, q = craft.time, craft.symbol("q")
    return simulation.ClosedLoop(
        craft,
        controller(name, bias=bias),
        [simulation.ScaleFactor("motors", np.ones(4), on="T")],
        [
            simulation.Noise("star tracker", model.TRACKER_NOISE, quaternion_retraction, on="q"),
            simulation.SensorOutage(
                "too fast", where=lambda t, x: ca.norm_2(x["omega"]) - model.TRACKER_RATE, on="q"
            ),
            simulation.SensorOutage("glare", 60.0, 80.0, on="q"),
            simulation.ZeroOrderHold("exposures", model.TRACKER_PERIOD, on="q"),
            simulation.Delay("image processing", model.TRACKER_DELAY, on="q"),
            simulation.Noise("gyro", model.GYRO_NOISE, on="omega"),
            simulation.Bias("gyro bias", np.zeros(3), on="omega"),
            simulation.RandomWalk("gyro drift", model.GYRO_WALK, on="omega"),
            simulation.Noise("tachometers", model.TACHOMETER_NOISE, on="h"),
        ],
        quantities=[
            simulation.Quantity("pointing", ca.if_else(t > SETTLED, model.off_target(q), 0), "rad"),
            simulation.Quantity("torque", ca.norm_inf(craft.symbol("motor")), "N m"),
            simulation.Quantity(
                "speed", ca.norm_inf(craft.symbol("h")) / model.WHEEL_INERTIA / model.RPM, "rpm"
            ),
            simulation.Quantity("rate", ca.norm_2(craft.symbol("omega")), "rad/s"),
        ],
        dt=DT,
        accuracy=1e-6,
        substeps=20,
    )


def simulate_campaign(
    name: str, runs: int, seed: int, *, bias: bool = True, **options: Any
) -> simulation.Campaign:
    """Simulate one of `LAWS`; the same seed gives all the same spacecraft and gaps; options as of `monte_carlo`."""
    return simulation.monte_carlo(
        loop(name, bias=bias),
        runs,
        x0=START,
        tf=END,
        seed=seed,
        dispersions=DISPERSIONS,
        target={"q": model.TARGET, "omega": np.zeros(3)},
        limits=LIMITS,
        **options,
    )
