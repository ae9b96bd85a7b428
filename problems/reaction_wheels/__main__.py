"""``python -m problems.reaction_wheels``: the slew of least energy, verified, and tracked on a heavier body."""

from __future__ import annotations

import numpy as np

import gnc_opt as go
from gnc_opt.simulation import ConstantDisturbance, Saturation
from problems._example import example_main
from problems.reaction_wheels.control import CONTROL_STEP, design_tracker, peak_speed
from problems.reaction_wheels.model import DURATION, INERTIA, REST, wheel_model
from problems.reaction_wheels.optimal import REFERENCE, build, published_peak_torque

HEAVIER = 1.05
"""True moments of the body over those that plan and controller assume."""
PUSH = (2e-4, -1e-4, 1e-4)
"""Constant torque on the body, N m."""


def tracked(solution: go.Solution) -> str:
    """Track the slew for a minute with a heavier body and a constant disturbance; return a line about it."""
    limit, inertia = published_peak_torque(3), HEAVIER * np.asarray(INERTIA)
    loop = go.ClosedLoop(
        wheel_model(inertia),
        design_tracker(solution, limit),
        actuators=[Saturation("motors", -limit, limit)],
        disturbances=[ConstantDisturbance("push", np.asarray(PUSH) / inertia, on="omega")],
        dt=CONTROL_STEP,
    )
    flown = loop.simulate(REST, tf=DURATION)
    angle = np.degrees(flown.attitude_error("q"))
    return (
        f"tracked by a TVLQR on a body {HEAVIER - 1:.0%} heavier, {flown.outcome}: {angle:.1e} deg off after "
        f"{DURATION:.0f} s, wheels at most {peak_speed(flown):.0f} rpm"
    )


main = example_main(build, REFERENCE, closed_loop=tracked)

if __name__ == "__main__":
    raise SystemExit(main())
