"""Reaction wheels: slews with a pyramid of four wheels by feedback linearisation, quaternion LQR and optimal control.

Four wheels turn a body at rest, with minimum energy or in minimum time, within their torque and speed limits. A
regulator tracks the slews, and two published attitude controllers are compared with it.
``python -m benchmarks.validation.published reaction_wheels`` compares the results with the publication.

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
