"""Switching times condition: no shift of control jumps lowers the cost to second order.

If every switch is an unknown, `bang_bang_second_order_conditions` applies. At phase boundaries and for coincident
switches, `switching_time_variations` integrates the trajectory with shifted jumps.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gnc_opt.array_types import Array, Mask
from gnc_opt.numerical_tolerances import AT_LIMIT, SAME_TIME, SMALL
from gnc_opt.planning.optimality.optimality_check_scales import Scales
from gnc_opt.planning.problem.hamiltonian_functions import EndGradients
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.defects_and_violations import Worst
from gnc_opt.planning.solution.optimality_verdict import Condition
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.verification.active_limits_and_touch_points import (
    find_costate_jumps,
    mask_controls_set_by_active_limits,
    mask_limits_with_multipliers,
)
from gnc_opt.planning.verification.bang_bang_second_order_conditions import explain_why_not_bang_bang
from gnc_opt.planning.verification.feasibility import combine_condition_results
from gnc_opt.planning.verification.switching_time_variations import Jump, ShiftedTrajectory

MAX_COMBINED_JUMPS = 24
"""Largest number of jumps whose shifts are combined; with more jumps, not all combinations are tested."""

_MEANING = (
    "Shifts of switching times that preserve the end conditions must not lower the cost to second order. The value is "
    "the decrease of the cost by the named shifts, relative to the cost."
)


def check_switching_times(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, scales: Scales
) -> Condition:
    """Return the condition that no shift of switching times lowers the cost to second order."""
    problem = solution.need_problem("verify")
    jumps = find_control_jumps(problem, samples) if all(s.has_duration for s in samples) else []
    location = f"{len(jumps) or 'no'} switch{'es' if len(jumps) > 1 else ''} between control limits"
    if jumps and _are_control_jump_times_variables(jumps, samples):
        jumps, location = [], f"{location}, tested by the second-order condition"
    jumps = sorted(jumps, key=lambda jump: jump.time)
    groups = [jumps[k : k + MAX_COMBINED_JUMPS] for k in range(0, len(jumps), MAX_COMBINED_JUMPS)]
    ordered = sorted(samples, key=lambda s: s.phase.initial_time)
    shifted = [ShiftedTrajectory(solution, ordered, ends, scales, group) for group in groups]
    decreases = list(filter(None, (group.find_second_order_cost_decrease() for group in shifted)))
    location += f": not all shifts of more than {MAX_COMBINED_JUMPS} are combined" if len(groups) > 1 else ""
    worst, certain = max(decreases, key=lambda f: (f[1], f[0].value), default=(Worst(0.0, location), False))
    result = combine_condition_results(len(groups) <= 1 and not decreases, certain)
    return Condition("switching times", result, worst.value, 0.0, worst.where, _MEANING, sufficient=True)


def _are_control_jump_times_variables(jumps: list[Jump], samples: list[PhaseSamples]) -> bool:
    """Return whether every jump is an unknown of the second-order condition: bang-bang arcs, or movable breaks with the
    jump of a single control and no active state limit."""
    if any(jump.beyond for jump in jumps):
        return False
    if not explain_why_not_bang_bang(samples):
        return True
    times = [(jump.phase, jump.time) for jump in jumps]
    limited = any(np.any(mask_limits_with_multipliers(s, s.times)) or find_costate_jumps(s) for s in samples)
    movable = all(s.phase.mesh.movable for s in samples)
    return movable and not limited and len(set(times)) == len(times)


def find_control_jumps(problem: Problem, samples: list[PhaseSamples]) -> list[Jump]:
    """Return the jumps of the applied controls inside phases and between consecutive phases."""
    jumps = []
    ordered = sorted(samples, key=lambda s: s.phase.initial_time)
    for s in ordered:
        phase, change = s.phase, np.maximum(np.ptp(s.u, axis=1), s.control_span)
        inner = phase.breaks[1:-1]
        before, after = phase.applied(inner, "left"), phase.applied(inner)
        large = np.abs(after - before) > SMALL * change[:, None]
        for i, k in np.argwhere(large & ~_mask_constrained_controls(problem, s, inner)):
            jumps.append(Jump(phase.name, float(inner[k]), int(i), before[i, k], after[i, k]))
    for s, following in itertools.pairwise(ordered):
        a, b = s.phase, following.phase
        if abs(a.final_time - b.initial_time) > SAME_TIME * s.span or a.controls.labels != b.controls.labels:
            continue
        before, after = a.applied(a.breaks[-1]), b.applied(b.breaks[0])
        is_constrained = _mask_constrained_controls(problem, s, a.breaks[-1:]) | _mask_constrained_controls(
            problem, following, b.breaks[:1]
        )
        large = np.abs(after - before) > SMALL * s.control_scale
        for i in np.flatnonzero(large & ~is_constrained[:, 0]):
            if all(_is_control_at_bound(p, v, int(i)) for p in (s, following) for v in (before, after)):
                jumps.append(Jump(a.name, float(a.breaks[-1]), int(i), before[i], after[i], beyond=b.name))
    ends = {s.phase.name: (s.phase.initial_time, s.phase.final_time) for s in samples}
    return [replace(jump, shorter_arc=_compute_adjacent_arc_duration(jump, jumps, ends)) for jump in jumps]


def _compute_adjacent_arc_duration(
    jump: Jump, jumps: list[Jump], ends: Mapping[str, tuple[float, float]]
) -> float:
    limits = ends[jump.phase][0], ends[jump.beyond or jump.phase][1]
    times = [*limits, *(other_jump.time for other_jump in jumps if other_jump.channel == jump.channel)]
    return float(min(abs(jump.time - t) for t in times if t != jump.time))


def _is_control_at_bound(s: PhaseSamples, u: Array, i: int) -> bool:
    scale = max(float(np.ptp(s.u[i])), abs(float(u[i])))
    bounds = s.phase.control_bounds
    return bool(min(abs(u[i] - bounds.lower[i]), abs(bounds.upper[i] - u[i])) <= AT_LIMIT * scale)


def _mask_constrained_controls(problem: Problem, s: PhaseSamples, times: Array) -> Mask:
    """Return whether an active path constraint or state limit determines each control near times, (m, n_times)."""
    nearest = np.argmin(np.abs(s.times[:, None] - times), axis=0)
    sides = [np.clip(nearest + k, 0, s.times.size - 1) for k in (-3, 3)]
    lower, upper = s.phase.control_bounds.is_near_limits(s.u, AT_LIMIT * np.max(np.abs(s.u), axis=1))
    # Near the end of an arc at a limit, its multiplier may be negligible.
    has_multiplier = np.any(s.state_multiplier != 0, axis=0) | np.any(s.mu != 0, axis=0)
    inner = ~(lower | upper) & has_multiplier
    masks = [mask_controls_set_by_active_limits(problem, s, s.times[side]) | inner[:, side] for side in sides]
    return np.asarray(masks[0] | masks[1])
