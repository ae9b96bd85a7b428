"""The rendezvous guided: planned with all the authority there is, its switches corrected on board until the last part.

The plan takes 25.87 s. `design_neighbouring_optimal` keeps it up from the measured state; for the last 10 s it lowers
the planned torques and forces by 8 %, and a regulator about the end follows what is left of it. Plant, dispersions and
limits are those of `tracking`; the runs are judged as long after the arrival, which is earlier.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.control import Controller, design_lqr
from gnc_opt.guidance import GuidanceOptions, design_neighbouring_optimal
from gnc_opt.simulation import Campaign, Run
from problems.rendezvous_tracking.tracking import AUTHORITY, DT, LIMITS, SETTLING, Tracking

LAST = 10.0
"""Of the flight, s, in which the regulator follows."""
REGULATED = 0.08
"""Share of the planned torques and forces that it has there."""


@dataclass(frozen=True)
class Guided(Tracking):
    """A plan with the whole authority, and the loop that guides it."""

    @cached_property
    def guidance(self) -> Controller:
        """The guidance, with the regulator about the end."""
        model, reference = self.reference.model, self.reference
        final = reference.x(reference.final_time)
        regulator = design_lqr(model, final, **self._weights, dt=DT, limits=AUTHORITY)
        weight = self._weights["Q"]
        options = GuidanceOptions(reserve=REGULATED, delay=self.conditions.lag)
        return design_neighbouring_optimal(self.solution, regulator, Q=weight, last=LAST, options=options)

    def controller(self, name: str = "neighbouring-optimal") -> Controller:
        """Return the guidance."""
        return self.guidance

    @property
    def end(self) -> float:
        """When the runs are judged, s."""
        first = self.guidance.initial_memory(0.0, self.initial)
        return float(first[self.guidance.memory.slice("final_time")][0]) + SETTLING

    def arrivals(self, campaign: Campaign) -> Array:
        """Return when each run arrived by its last plan (m,), s."""
        return np.asarray(campaign.memory[campaign.layouts["memory"].slice("final_time")][0])


def settled(run: Run, target: Array) -> float:
    """Return when a run came within all limits of its target (n_states,) for good, s; infinite if it did not."""
    states = run.layouts["state"]
    goal = {name: target[states.slice(name)] for name in states.names}
    # of small turns the parameters change by a quarter of the angle times 1 + sigma^2
    turn = 0.25 * (1 + float(goal["sigma"] @ goal["sigma"]))
    bands = {name: LIMITS[name] for name in ("r_L", "v_L", "omega")} | {
        "sigma": turn * LIMITS["angle(sigma)"]
    }
    return max(run.settling_time(name, band, target=goal[name]) for name, band in bands.items())
