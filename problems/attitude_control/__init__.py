"""Attitude control from sensors to motors: star tracker with gaps, gyro with bias, four wheels within their limits.

    python -m problems.attitude_control [--runs N] [--seed S] [--json OUT] [--checkpoint DIR]

To be read in this order:

* `model`: the spacecraft, its sensors and wheels, the slew;
* `board`: what runs on board: the filter, the laws, the wheels' limits;
* `flown`: the loops, what runs differ by, how they are judged;
* `table`: what is printed.
"""

from problems.attitude_control.board import LAWS, controller, estimator
from problems.attitude_control.flown import DISPERSIONS, LIMITS, START, campaign, loop
from problems.attitude_control.model import MANOEUVRE, MAX_MOMENTUM, MAX_TORQUE, TARGET, build, plant, slew
from problems.attitude_control.table import main

__all__ = [
    "DISPERSIONS",
    "LAWS",
    "LIMITS",
    "MANOEUVRE",
    "MAX_MOMENTUM",
    "MAX_TORQUE",
    "START",
    "TARGET",
    "build",
    "campaign",
    "controller",
    "estimator",
    "loop",
    "main",
    "plant",
    "slew",
]
