"""Whether rates of a restated phase are those that were stated: parts of controls are used one after the other."""

from __future__ import annotations

import numpy as np

from gnc_opt.problem.problem import Problem
from gnc_opt.solution.quality import NOTHING, Worst
from gnc_opt.solution.samples import PhaseSamples


def worst_of_parts(problem: Problem, s: PhaseSamples) -> Worst:
    """Return by what share of its size a state is moved by parts that push at once, over a phase."""
    restatement = problem.phases[s.leg.name].restatement
    relied = () if restatement is None else restatement.filled_in_order
    worst, layout = NOTHING, s.leg.controls
    for control in s.leg.composed_controls:
        if control.name not in relied:
            continue
        parts = [s.u[layout.slice(part)] for part in control.parts]
        filled = s.u.copy()
        for part, own in zip(control.parts, control.decompose(control.compose(*parts)), strict=True):
            filled[layout.slice(part)] = np.where(np.isnan(own), filled[layout.slice(part)], own)
        rates = s.functions.rates(s.times, s.x, s.u) - s.functions.rates(s.times, s.x, filled)
        moved = np.sum(np.abs(rates) * s.weights, axis=1) / s.state_scale
        i, j = int(np.argmax(moved)), int(np.argmax(np.max(np.abs(rates), axis=0)))
        where = f"{s.place(j)}: parts of {control.name} push at once, which moves {s.leg.states.labels[i]}"
        worst = worst.or_worse(Worst(float(moved[i]), where))
    return worst
