"""``python -m problems.formation_flying``: the formation joined with minimum Delta-V, verified and tracked."""

from __future__ import annotations

import numpy as np

import gnc_opt as go
from gnc_opt.simulation import ClosedLoop, Saturation
from problems._example import example_main
from problems.formation_flying.control import delta_v, follow_plan
from problems.formation_flying.model import PERIOD, START, build_model
from problems.formation_flying.optimal import LIMIT, REFERENCE, RESERVE, build, plan

STEPS = 6000
"""Of the controller in a period."""


def tracked(solution: go.Solution) -> str:
    """Track the plan with a reserve of thrust and without oblateness on the oblate plant; return a line about it."""
    controller = follow_plan(plan("least Delta-V", RESERVE, False), PERIOD / STEPS, (-LIMIT, LIMIT))
    thrusters = Saturation("thrusters", -LIMIT, LIMIT)
    loop = ClosedLoop(build_model(), controller, actuators=[thrusters], dt=PERIOD / STEPS, substeps=1)
    flown = loop.simulate(START, tf=PERIOD)
    off = np.linalg.norm(flown.error("r").values[:, -1])
    return (
        f"tracked by the optimal sliding mode with {RESERVE:.0%} of the thrust in reserve, {flown.outcome}: "
        f"{1e3 * off:.1f} mm from the circle's point after a period, Delta-V {delta_v(flown):.4f} m/s "
        f"(optimum {solution.objective:.4f} m/s)"
    )


main = example_main(build, REFERENCE, closed_loop=tracked)

if __name__ == "__main__":
    raise SystemExit(main())
