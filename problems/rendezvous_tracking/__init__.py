"""Rendezvous tracking: open loop, TVLQR, integral sliding mode, MPC and guidance in one campaign.

    python -m problems.rendezvous_tracking [--case 1..5] [--runs N] [--seed S] [--json OUT] [--report DIR]

Read the files in this order: `problems.rendezvous.model`, then here

* `control`: the plan, the plant with its dispersions, the controllers, and the evaluation of their runs;
* `guidance`: a plan without margin whose switching times are corrected on board, with an extended Kalman filter;
* `replanning`: the same, with new plans during flight.
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
