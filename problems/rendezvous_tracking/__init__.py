"""The time-optimal rendezvous followed by open loop, TVLQR, integral sliding mode and MPC in one campaign; and guided.

    python -m problems.rendezvous_tracking [--case 1..5] [--runs N] [--seed S] [--json OUT] [--report DIR]

To be read in this order: `problems.rendezvous.model`, then here

* `tracking`: the plan, the plant and what it differs by, the controllers, and how their runs are judged;
* `guided`: the plan without reserve, its switches corrected on board;
* `measured`: both by range, bearing, star tracker and gyro, through a filter;
* `replanned`: the same, with the problem solved again in flight;
* `flown`: the optimum and the solution on the paper's mesh over the same runs;
* `basilisk`: the plan and its regulator in another maker's plant;
* `plots`, `report`: what is drawn and printed.
"""

from problems.rendezvous import CASES
from problems.rendezvous_tracking.guided import Guided, settled
from problems.rendezvous_tracking.measured import Filtered, Measured
from problems.rendezvous_tracking.replanned import Replanned
from problems.rendezvous_tracking.report import main
from problems.rendezvous_tracking.tracking import (
    ACCEPTED,
    AUTHORITY,
    CONTROLLERS,
    CORRECTIONS,
    DIFFERENTIAL_FORCE,
    DISPERSIONS,
    DT,
    FORCE_STEP,
    HORIZON,
    LAG,
    LAYER,
    LIMITS,
    MPC_RUNS,
    NOISE,
    REACHING,
    RESERVE,
    SETTLING,
    TORQUE_STEP,
    Conditions,
    Tracking,
    example_run,
    plan,
    price_of_robustness,
    turned,
)

__all__ = [
    "ACCEPTED",
    "AUTHORITY",
    "CASES",
    "CONTROLLERS",
    "CORRECTIONS",
    "DIFFERENTIAL_FORCE",
    "DISPERSIONS",
    "DT",
    "FORCE_STEP",
    "HORIZON",
    "LAG",
    "LAYER",
    "LIMITS",
    "MPC_RUNS",
    "NOISE",
    "REACHING",
    "RESERVE",
    "SETTLING",
    "TORQUE_STEP",
    "Conditions",
    "Filtered",
    "Guided",
    "Measured",
    "Replanned",
    "Tracking",
    "example_run",
    "main",
    "plan",
    "price_of_robustness",
    "settled",
    "turned",
]
