"""Second order of switching times: no shift of the jumps of controls lowers the cost.

Where every switch is an unknown of its own, the module `bang_bang_second_order` decides. Elsewhere, at boundaries of
phases and where switches coincide, the trajectory is integrated with shifted jumps (module `shifted_trajectory`).
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.planning.optimality.reference_scales import Scales
from gnc_opt.planning.problem.functions import EndGradients
from gnc_opt.planning.solution.quality import Worst
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.verdict import Condition
from gnc_opt.planning.verification.bang_bang_second_order import explain_inapplicable_theorem
from gnc_opt.planning.verification.feasibility import combine_condition_results
from gnc_opt.planning.verification.shifted_trajectory import Jump, ShiftedTrajectory
from gnc_opt.tolerances import AT_LIMIT, SAME_TIME, SMALL, TINY

MOST_TOGETHER = 24
"""Jumps whose shifts are combined, at most; not all combinations of more are tested."""

_MEANING = (
    "Shifts of switching times that keep the end conditions must not lower the cost to second order (value: fall at "
    "the named shifts, in shares of the cost scale): a cheaper trajectory has its switches there."
)


def check_switching_times(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, scales: Scales
) -> Condition:
    """No shift of switching times lowers the cost to second order."""
    jumps = find_jumps(samples) if all(s.has_duration for s in samples) else []
    place = f"{len(jumps) or 'no'} switch{'es' if len(jumps) > 1 else ''}"
    if jumps and _are_all_jumps_free_times(jumps, samples, scales):
        jumps, place = [], f"{place}: see second order"
    jumps = sorted(jumps, key=lambda jump: jump.time)
    groups = [jumps[k : k + MOST_TOGETHER] for k in range(0, len(jumps), MOST_TOGETHER)]
    order = sorted(samples, key=lambda s: s.leg.initial_time)
    shifted = [ShiftedTrajectory(solution, order, ends, scales, group) for group in groups]
    falls = list(filter(None, (group.find_second_order_decrease() for group in shifted)))
    place += f": not all shifts of more than {MOST_TOGETHER} are combined" if len(groups) > 1 else ""
    worst = max(falls, key=lambda fall: fall.value, default=Worst(0.0, place))
    result = combine_condition_results(len(groups) <= 1, bool(falls))
    return Condition("switching times", result, worst.value, 0.0, worst.where, _MEANING, sufficient=True)


def _are_all_jumps_free_times(jumps: list[Jump], samples: list[PhaseSamples], scales: Scales) -> bool:
    """Whether the second order has every jump as an unknown of its own: bang-bang arcs, or boundaries of a movable mesh
    at which one control jumps and no limit of the states acts."""
    if any(jump.beyond for jump in jumps):
        return False
    if not explain_inapplicable_theorem(samples):
        return True
    times = [(jump.phase, jump.time) for jump in jumps]
    limited = any(_has_active_path_or_state_limit(s, scales) for s in samples)
    movable = all(s.leg.mesh.movable for s in samples)
    return movable and not limited and len(set(times)) == len(times)


def _has_active_path_or_state_limit(s: PhaseSamples, scales: Scales) -> bool:
    """Whether a limit of states is reached inside the phase, or another path constraint acts for more than rounding."""
    reach, pure = scales.phases[s.leg.name].along.radius, np.zeros(len(s.leg.path_labels), dtype=bool)
    pure[s.pure_paths] = True
    paths = s.functions.paths(s.times, s.x, s.u)
    at_states = np.logical_or(*s.leg.state_bounds.near(s.x, AT_LIMIT * reach))
    at_paths = np.logical_or(*s.leg.path_bounds.near(paths, AT_LIMIT * s.path_scale))[pure]
    if np.any(at_states[:, 1:-1]) or np.any(at_paths[:, 1:-1]):
        return True
    pushes = np.max(np.abs(s.mu[~pure]), axis=1, initial=0.0) * s.path_scale[~pure]
    return bool(np.max(pushes, initial=0.0) * s.span > AT_LIMIT * scales.cost)


def find_jumps(samples: list[PhaseSamples]) -> list[Jump]:
    """Return the jumps of the applied controls inside phases and between phases that follow each other."""
    jumps = []
    order = sorted(samples, key=lambda s: s.leg.initial_time)
    for s in order:
        leg, change = s.leg, np.ptp(s.u, axis=1)
        inner = leg.breaks[1:-1]
        if inner.size:
            size = np.abs(leg.applied(inner) - leg.applied(inner, "left"))
            for i, k in np.argwhere(size > SMALL * np.maximum(change, TINY)[:, None]):
                if not _is_constrained(s, int(i), float(inner[k])):
                    jumps.append((s, float(inner[k]), int(i), ""))
    for s, following in itertools.pairwise(order):
        a, b = s.leg, following.leg
        if abs(a.final_time - b.initial_time) > SAME_TIME * s.span or a.controls.labels != b.controls.labels:
            continue
        before, after = a.applied(a.breaks[-1], "left"), b.applied(b.breaks[0])
        change = np.maximum(np.ptp(s.u, axis=1), np.ptp(following.u, axis=1))
        size = np.abs(after - before)
        for i in np.flatnonzero(size > SMALL * np.maximum(change, size)):
            straight = not (
                _is_constrained(s, int(i), a.breaks[-1]) or _is_constrained(following, int(i), b.breaks[0])
            )
            on_bounds = all(_is_on_bound(p, v, int(i)) for p in (s, following) for v in (before, after))
            if straight and on_bounds:
                jumps.append((s, float(a.breaks[-1]), int(i), b.name))
    ends = {s.leg.name: (s.leg.initial_time, s.leg.final_time) for s in samples}
    return [
        Jump(s.leg.name, t, i, _shorter_adjacent_arc(jumps, ends, s, t, i, beyond), beyond)
        for s, t, i, beyond in jumps
    ]


def _shorter_adjacent_arc(
    jumps: list[Any], ends: Any, s: PhaseSamples, time: float, channel: int, beyond: str
) -> float:
    first, last = ends[s.leg.name]
    last = ends[beyond][1] if beyond else last
    others = [t for _, t, i, _ in jumps if i == channel and t != time]
    return float(min(abs(time - t) for t in [first, last, *others] if t != time))


def _is_on_bound(s: PhaseSamples, u: Array, i: int) -> bool:
    scale = max(float(np.ptp(s.u[i])), abs(float(u[i])), TINY)
    bounds = s.leg.control_bounds
    return bool(min(abs(u[i] - bounds.lower[i]), abs(bounds.upper[i] - u[i])) <= AT_LIMIT * scale)


def _is_constrained(s: PhaseSamples, i: int, time: float) -> bool:
    """Whether an active path constraint, or one of the states, determines a control next to a time."""
    beside = int(np.argmin(np.abs(s.times - time)))
    at = np.unique(np.clip([beside - 3, beside + 3], 0, s.times.size - 1))
    u = s.u[:, at]
    lower, upper = s.leg.control_bounds.near(u, AT_LIMIT * np.max(np.abs(s.u), axis=1, initial=0.0))
    between = ~(lower | upper)[i]
    if np.any(between & (np.any(s.state_multiplier[:, at] != 0, axis=0) | np.any(s.mu[:, at] != 0, axis=0))):
        return True
    if not s.leg.path_labels:
        return False
    jacobian = s.functions.path_control_jacobian(s.times[at], s.x[:, at], u)[:, i]
    return bool(np.any((jacobian != 0) & (np.abs(s.mu[:, at]) > 0)))
