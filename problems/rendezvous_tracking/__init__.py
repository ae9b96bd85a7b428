"""Rendezvous tracking: open loop, TVLQR, integral sliding mode, MPC and guidance in one campaign.

    python -m problems.rendezvous_tracking [--case 1..5] [--runs N] [--seed S] [--json OUT] [--report DIR]

Read the files in this order: `problems.rendezvous.model`, then here

* `control`: the plan, the plant and what it differs by, the controllers, and how their runs are evaluated;
* `guidance`: the plan without reserve, its switches corrected on board; both by range, bearing, star tracker and gyro;
* `replanning`: the same, with the problem solved again in flight.
"""

from problems.rendezvous_tracking.control import (
    DISPERSIONS,
    DT,
    FORCE_STEP,
    LIMITS,
    NOISE,
    RESERVE,
    SETTLING,
    TORQUE_STEP,
    Tracking,
    example_run,
    plan,
)
from problems.rendezvous_tracking.guidance import Filtered, Guided, Measured, settled
from problems.rendezvous_tracking.replanning import Replanned
