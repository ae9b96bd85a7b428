"""``python -m problems.rendezvous``: the least time of the first case, verified, and flown open loop."""

from __future__ import annotations

import numpy as np

import gnc_opt as go
from problems._example import example_main
from problems.rendezvous.model import build, chaser_model
from problems.rendezvous.optimal import REFERENCE


def flown(solution: go.Solution) -> str:
    """Simulate the switches without feedback on the complete rotational dynamics; return a line about the end."""
    plan = go.Reference(solution)
    loop = go.ClosedLoop(chaser_model("exact"), go.feedforward(plan), dt=0.1)
    end = loop.simulate(plan.x(0.0), tf=plan.final_time)
    off = [np.linalg.norm(end.error(name).values[:, -1]) for name in ("r_L", "v_L")]
    return (
        f"open loop on the complete rotational dynamics, commands held for 0.1 s, {end.outcome}: {off[0]:.2f} m and "
        f"{off[1]:.3f} m/s off at the end; problems.rendezvous_tracking closes the loop"
    )


main = example_main(build, REFERENCE[1, "printed"]["exact"], closed_loop=flown)

if __name__ == "__main__":
    raise SystemExit(main())
