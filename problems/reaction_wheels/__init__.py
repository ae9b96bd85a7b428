"""Attitude slews with a pyramid of four reaction wheels: feedback linearisation, quaternion LQR, optimal slews.

A body at rest is turned by the motor torques of four wheels. The publication's two laws are reproduced number by
number; the same slews are then made with the least energy and in the least time, and tracked. The page is
docs/reaction_wheels.md.

To be read in this order:

* `model`: data, manoeuvres, dynamics;
* `laws`: the two published laws, their gains, closed forms;
* `runs`: the published slews; `limits`: null space, speed limit, singularity;
* `published`: every number that is known of them, against ours;
* `optimal`: the optimal control problems, their solutions and tracking;
* `flown`: optimal slews and published law under the same errors and limits;
* `plots`, `report`: what is drawn and printed.
"""

from problems.reaction_wheels.model import (
    AXES,
    DESIGN_SPEED,
    DURATION,
    INERTIA,
    INVERSE,
    MANOEUVRES,
    MAX_MOMENTUM,
    NOMINAL_SPEED,
    NULL,
    REST,
    RPM,
    TORQUE_CONSTANT,
    VOLTAGE_CONSTANT,
    WHEEL_INERTIA,
    Drive,
    paper_quaternion,
    resting,
    target_quaternion,
    wheel_model,
)
from problems.reaction_wheels.optimal import REFERENCE, Goal, build, published_peak_torque
from problems.reaction_wheels.report import main

__all__ = [
    "AXES",
    "DESIGN_SPEED",
    "DURATION",
    "INERTIA",
    "INVERSE",
    "MANOEUVRES",
    "MAX_MOMENTUM",
    "NOMINAL_SPEED",
    "NULL",
    "REFERENCE",
    "REST",
    "RPM",
    "TORQUE_CONSTANT",
    "VOLTAGE_CONSTANT",
    "WHEEL_INERTIA",
    "Drive",
    "Goal",
    "build",
    "main",
    "paper_quaternion",
    "published_peak_torque",
    "resting",
    "target_quaternion",
    "wheel_model",
]
