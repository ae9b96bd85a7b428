"""Attitude slews with a pyramid of four reaction wheels: feedback linearisation, quaternion LQR, optimal slews.

A body at rest is turned by the motor torques of four wheels, with the least energy or in the least time, within the
wheels' torque and speed limits, and the slew is tracked. Two published attitude controllers are compared; their
printed numbers are reproduced by ``python -m benchmarks.validation.published reaction_wheels``. The page is
docs/reaction_wheels.md.

Read the files in this order:

* `model`: data, manoeuvres, dynamics;
* `control`: the two published controllers, their gains, closed forms, and the regulator along an optimal slew;
* `optimal`: the optimal control problems and their solutions.
"""

from problems.reaction_wheels.model import (
    AXES,
    DESIGN_SPEED,
    INERTIA,
    INVERSE,
    MANOEUVRES,
    NOMINAL_SPEED,
    NULL,
    REST,
    WHEEL_INERTIA,
    paper_quaternion,
    target_quaternion,
    wheel_model,
)
from problems.reaction_wheels.optimal import REFERENCE, build, published_peak_torque
