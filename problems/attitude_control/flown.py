"""The loops, what their runs differ by, and how they are judged.

Every run differs from what is known on board in

* attitude at the start: up to 1 degree about any axis; rates and wheels there: 1 sigma 0.02 deg/s and 50 rpm;
* moments of inertia: uniform within 5 %; torques of the motors: within 2 % per wheel; their lag: within 30 %;
* a constant torque from outside: 1 sigma 2e-5 N m per axis;
* bias of the gyro: 1 sigma 0.05 deg/s per axis, and its drift;
* noise of star tracker, gyro and tachometers.

The star tracker tells the attitude twice a second, 0.1 s late, and nothing while the body turns faster than 1.5 deg/s,
which is most of the slew; later it is blinded once, from 55 to 65 s until 75 to 85 s.

From `SETTLED` on the spacecraft has to point to within `POINTING`; no wheel may ever have more torque or speed than it
can.
"""

from __future__ import annotations

from concurrent.futures import Executor
from pathlib import Path
from typing import Literal

import casadi as ca
import numpy as np

from gnc_opt.simulation import (
    Bias,
    Campaign,
    ClosedLoop,
    Noise,
    Normal,
    Outage,
    Quantity,
    RandomWalk,
    Sampling,
    ScaleFactor,
    SensorDelay,
    Turn,
    Uniform,
    monte_carlo,
)
from gnc_opt.simulation.dispersions import Dispersion
from gnc_opt.spacecraft import quaternion_retraction
from problems.attitude_control.board import DT, controller
from problems.attitude_control.model import (
    GYRO_BIAS,
    GYRO_NOISE,
    GYRO_WALK,
    MAX_MOMENTUM,
    MAX_TORQUE,
    RPM,
    TACHOMETER_NOISE,
    TARGET,
    TRACKER_DELAY,
    TRACKER_NOISE,
    TRACKER_PERIOD,
    TRACKER_RATE,
    WHEEL_INERTIA,
    off_target,
    plant,
)

END = 100.0
"""Of the runs, s."""
SETTLED = 60.0
"""s."""
POINTING = float(np.radians(0.1))
"""rad."""
START = {"q": [1.0, 0.0, 0.0, 0.0], "omega": np.zeros(3), "h": np.zeros(4), "motor": np.zeros(4)}

LIMITS = {
    "max(pointing)": POINTING,
    "max(torque)": MAX_TORQUE,
    "max(speed)": MAX_MOMENTUM / WHEEL_INERTIA / RPM,
}
"""rad, N m, rpm."""

DISPERSIONS: dict[str, Dispersion] = {
    "initial.q": Turn(Uniform(0.0, float(np.radians(1.0)))),
    "initial.omega": Normal(float(np.radians(0.02))),
    "initial.h": Normal(50.0 * WHEEL_INERTIA * RPM),
    "plant.inertia": Uniform(-0.05, 0.05, relative=True),
    "plant.lag": Uniform(-0.3, 0.3, relative=True),
    "plant.external": Normal(2e-5),
    "motors.factor": Uniform(-0.02, 0.02),
    "gyro bias.bias": Normal(GYRO_BIAS),
    "glare.begin": Uniform(-5.0, 5.0),
    "glare.end": Uniform(-5.0, 5.0),
}


def loop(name: str, *, bias: bool = True) -> ClosedLoop:
    """Return the loop of one of `LAWS`, before it is dispersed; with a filter that estimates the bias or does not."""
    craft = plant()
    t, q = craft.time, craft.symbol("q")
    return ClosedLoop(
        craft,
        controller(name, bias=bias),
        [ScaleFactor("motors", np.ones(4), on="T")],
        [
            Noise("star tracker", TRACKER_NOISE, quaternion_retraction, on="q"),
            Outage("too fast", where=lambda t, x: ca.norm_2(x["omega"]) - TRACKER_RATE, on="q"),
            Outage("glare", 60.0, 80.0, on="q"),
            Sampling("exposures", TRACKER_PERIOD, on="q"),
            SensorDelay("image processing", TRACKER_DELAY, on="q"),
            Noise("gyro", GYRO_NOISE, on="omega"),
            Bias("gyro bias", np.zeros(3), on="omega"),
            RandomWalk("gyro drift", GYRO_WALK, on="omega"),
            Noise("tachometers", TACHOMETER_NOISE, on="h"),
        ],
        quantities=[
            Quantity("pointing", ca.if_else(t > SETTLED, off_target(q), 0), "rad"),
            Quantity("torque", ca.norm_inf(craft.symbol("motor")), "N m"),
            Quantity("speed", ca.norm_inf(craft.symbol("h")) / WHEEL_INERTIA / RPM, "rpm"),
            Quantity("rate", ca.norm_2(craft.symbol("omega")), "rad/s"),
        ],
        dt=DT,
        accuracy=1e-6,
        substeps=20,
    )


def campaign(
    name: str,
    runs: int,
    seed: int,
    executor: Executor | Literal["serial"] | None = None,
    *,
    bias: bool = True,
    progress: bool = False,
    checkpoint: Path | None = None,
) -> Campaign:
    """Fly one of `LAWS`; the same seed gives all of them the same spacecraft, sensors and gaps."""
    return monte_carlo(
        loop(name, bias=bias),
        runs,
        x0=START,
        tf=END,
        seed=seed,
        dispersions=DISPERSIONS,
        target={"q": TARGET, "omega": np.zeros(3)},
        limits=LIMITS,
        executor=executor,
        progress=progress,
        checkpoint=checkpoint,
    )
