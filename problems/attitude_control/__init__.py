"""Attitude control from sensors to motors: star tracker with gaps, gyro with bias, four wheels within their limits.

    python -m problems.attitude_control [--runs N] [--seed S] [--json OUT] [--checkpoint DIR]

Read the files in this order:

* `model`: the spacecraft, its sensors and wheels, the slew;
* `control`: the filter, the controllers, the limits of the wheels, the closed loops, and the dispersions.
"""

from problems.attitude_control.control import (
    DISPERSIONS,
    LAWS,
    LIMITS,
    START,
    controller,
    estimator,
    loop,
    simulate_campaign,
)
from problems.attitude_control.model import MANOEUVRE, MAX_MOMENTUM, MAX_TORQUE, TARGET, build, plant, slew
