"""The optimum and the solution on the paper's mesh, followed by the same regulator over the same dispersed runs."""

from __future__ import annotations

from problems.dispersed import Rivals
from problems.rendezvous_tracking.tracking import SHOWN, Conditions, Tracking, plan

PLANS = {"refined plan, TVLQR": True, "plan on the paper's mesh, TVLQR": False}
"""Both with a share of the authority, by whether their switch times are exact."""


def rivals() -> Rivals:
    """Return both plans, judged `problems.rendezvous_tracking.SETTLING` after the later one's arrival."""
    conditions = Conditions()
    followed = {name: Tracking(plan(refined=refined), conditions) for name, refined in PLANS.items()}
    loops = {name: (each.loop(each.tvlqr), each.initial) for name, each in followed.items()}
    first = next(iter(followed.values()))
    states = first.reference.model.states
    target = first.reference.x(first.reference.final_time)
    measures = {what: (f"{label} ({unit})", factor) for what, (label, factor, unit) in SHOWN.items()}
    return Rivals(
        loops,
        max(each.end for each in followed.values()),
        conditions.dispersions,
        {name: target[states.slice(name)] for name in states.names},
        {**measures, "effort(F_B)": ("effort of the forces (N s)", 1.0)},
    )
