"""How far path constraints let controls go that have no bounds of their own."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array, Mask
from gnc_opt.model.evaluation import evaluate
from gnc_opt.problem.guess.trajectory import PhaseStart
from gnc_opt.problem.phase import Phase

SIZES = np.logspace(-8, 12, 161)
"""What is tried: eight to a decade."""


def path_reach(leg: Phase, times: Array, start: PhaseStart, wanted: Mask) -> Array:
    """Return the typical magnitude that path constraints leave to each control, (m,); 0 where they say nothing.

    It is the least size, of either sign, beyond which a constraint that holds without controls is broken, at the
    guessed state at which that is largest; a constraint that has no room there says nothing.

    Parameters
    ----------
    leg : Phase
    times : array (n_times,)
        s.
    start : PhaseStart
        The guess there.
    wanted : bool array (m,)
        Which controls are asked for; the others are 0.
    """
    reach, box = np.zeros(wanted.size), leg.path_interval()
    if not leg.paths or not np.any(wanted):
        return reach
    function = leg.once("paths", lambda: _rows(leg))
    n = times.size
    for i in np.flatnonzero(wanted):
        trials = np.concatenate([[0.0], SIZES, -SIZES])
        controls = np.zeros(
            (wanted.size, trials.size, n)
        )  # not as guessed: on a sphere each of them has no room
        controls[i] = trials[:, None]
        values = evaluate(
            function,
            np.tile(times, trials.size),
            np.tile(start.states, trials.size),
            controls.reshape(wanted.size, -1),
            leg.model.parameter_values,
        ).reshape(box.lower.size, trials.size, n)
        broken = (values < box.lower[:, None, None]) | (values > box.upper[:, None, None])
        later = np.any(broken & ~broken[:, :1], axis=0)[1:]
        sizes = np.min(np.where(later, np.tile(SIZES, 2)[:, None], np.inf), axis=0)
        reach[i] = max(sizes[(sizes > SIZES[0]) & np.isfinite(sizes)], default=0.0)
    return reach


def _rows(leg: Phase) -> Any:
    """A function of (t, x, u, p) to all path constraints, NaN where they are of free parameters, too."""
    arguments = leg.model.arguments()
    expression = leg.path_expression()
    own = {s.element_hash() for a in arguments for s in ca.vertsplit(a)}
    foreign = [s for s in ca.symvar(expression) if s.element_hash() not in own]
    if foreign:
        expression = ca.substitute(expression, ca.vertcat(*foreign), ca.SX.nan(len(foreign)))
    return ca.Function("paths", [*arguments], [ca.densify(expression)])
