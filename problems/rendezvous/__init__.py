"""Time-optimal rendezvous: translation and rotation of a rigid spacecraft in six degrees of freedom.

A chaser comes to rest 10 m above its target on a circular orbit and turns by 90 degrees about y, as fast as its torques
and forces allow. `problems.rendezvous_tracking` tracks the plan in closed loop. The published times are reproduced by
``python -m benchmarks.validation.published rendezvous``; they are local minima, listed by
``python -m benchmarks.validation.rendezvous_minima``.

Read the files in this order:

* `model`: data, the five cases, dynamics, the optimal control problem;
* `optimal`: the known minimum times with their sources, and their switches.
"""

from problems.rendezvous.model import (
    ALTITUDE,
    CASES,
    EQUATIONS,
    FINAL_POSITION,
    FINAL_SIGMA,
    INERTIA,
    MASS,
    MAX_FORCE,
    MAX_TORQUE,
    MESH,
    PAPER_MESH,
    VIEW,
    Equation,
    build,
    chaser_model,
    printed_angular_acceleration,
)
from problems.rendezvous.optimal import REFERENCE, SWITCHES, Channel, switch_arcs, switch_mesh
