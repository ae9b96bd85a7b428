"""``python -m problems.flexible_spacecraft``: the slew in minimum time, verified, and one with a reserve tracked."""

from __future__ import annotations

import numpy as np

import gnc_opt as go
from gnc_opt.spacecraft import quaternion_angle
from problems._example import example_main
from problems.flexible_spacecraft.control import loop, mean_disturbance, tvlqr
from problems.flexible_spacecraft.model import BODY, initial_state
from problems.flexible_spacecraft.optimal import REFERENCE, build, solved


def tracked(solution: go.Solution) -> str:
    """Track the slew of least time and effort under the published disturbance; return a line about its end."""
    reference = go.Reference(solved("prompt"))
    closed = loop(reference.model, tvlqr(reference), dt=0.05, disturbances=mean_disturbance())
    flown = closed.simulate(initial_state(reference.model), tf=reference.final_time)
    aligned = np.array([1.0, 0.0, 0.0, 0.0])
    off = float(np.degrees(quaternion_angle(flown.state("q_BO").values[:, -1], aligned)))
    energy = BODY.modal_energy(flown.state("eta").values[:, -1], flown.state("eta_rate").values[:, -1])
    return (
        f"least time and effort with 95 % of the torque takes {reference.final_time:.2f} s (least time "
        f"{solution.objective:.2f} s); tracked by a TVLQR, {flown.outcome}: {off:.4f} deg off and "
        f"{float(np.squeeze(energy)):.1e} J of vibration at its end"
    )


main = example_main(build, REFERENCE, closed_loop=tracked)

if __name__ == "__main__":
    raise SystemExit(main())
