r"""Newton's method for switching times.

With every control on a bound, the problem has finitely many unknowns: the switching times, the ends of the phase and
the multipliers of the end conditions. Trajectory, Jacobian and Hessian are integrated explicitly (module
`bang_bang_sensitivity`), so that an iteration costs a few propagations, while a solve of the collocated problem
factorises matrices of all its points. Subarcs of zero length are removed, and arcs are added where switching functions
have the wrong sign. The resulting structure is the initial guess of the collocated problem.

Far from the optimum, every step evaluates its own derivatives; near it, the matrices of the last step are reused as
long as the steps decrease sufficiently fast (module `bang_bang_extremal`).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import AT_LIMIT, INNER_TOLERANCE_SHARE, NOTABLE, TINY
from gnc_opt.planning.optimality.bang_bang_sensitivity import FLOW_INITIAL_STEPS
from gnc_opt.planning.optimality.switching_time_problem import Switches
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind
from gnc_opt.planning.problem.bounds import stack_intervals
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.arcs.control_structure import PhaseStructure, select_kind
from gnc_opt.planning.refinement.switching.bang_bang_extremal import (
    BangBangExtremal,
    NewtonStep,
    compute_newton_step,
    compute_simplified_newton_step,
)
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution

NEWTON_MAX_STEPS = 40
"""Largest number of Newton steps of all structures together."""

SIMPLIFIED_NEWTON_MAX_STEP = 1e-4
"""Largest step, relative to the phase, whose matrices are reused in the following steps."""

SIMPLIFIED_STEPS_PER_FULL_STEP = 3
"""Number of steps with reused matrices that cost as much as one with its own matrices."""

SIMPLIFIED_NEWTON_MAX_STEPS = 12
"""Largest number of steps with reused matrices."""

NEWTON_REMAINDER_FACTOR = 100.0
"""Estimated error after a Newton step over the square of the step length, both relative to the phase."""

GUESS_ACCURACY = 1e-8
"""Relative accuracy of the cost of a trajectory that is the initial guess of a collocated problem."""

FLOW_MAX_STEPS = 8 * FLOW_INITIAL_STEPS
"""Number of steps of the finest grid."""

ARC_MAX_SHRINK_SHARE = 0.8
"""Largest reduction of an arc in one step, relative to its length."""

SWITCH_MAX_MOVE_SHARE = 0.04
"""Largest change of a switching time in one step, relative to the phase."""

STEP_MIN_SHARE = 0.2
"""Least fraction of a step after the limit `ARC_MAX_SHRINK_SHARE`; below it, the limiting arc is removed."""


def find_optimal_switching_times(
    solution: Solution,
    structure: PhaseStructure,
    accuracy: float = GUESS_ACCURACY,
    known_step: NewtonStep | None = None,
) -> tuple[PhaseStructure, BangBangExtremal] | None:
    """Return optimal switching times and their trajectory; arcs are removed and added if necessary.

    The grid is refined until the change of the cost, estimated from a trajectory on a grid `STEP_PARTS` times as fine,
    is below the accuracy. Near an optimum the cost depends on the switching times to second order: their error,
    relative to the phase, is of the order of the square root of the accuracy. Matrices and grid of a ``known_step``, at
    the optimum of a similar problem with this structure, are tried first.

    Returns the structure after the remaining Newton step, and the trajectory before it, which may be less accurate or
    lack an arc (`BangBangExtremal.is_cost_accurate`); limits between the ends are not checked. None if the method does
    not apply or does not converge.
    """
    problem, s = solution.need_problem("solve"), next(iter(solution.samples().values()))
    if not _is_newton_applicable(problem, s, structure):
        return None
    switches = _list_control_switches(s, structure)
    steps, extremal = FLOW_INITIAL_STEPS, None
    if known_step is not None:
        steps = known_step.steps
        extremal = _iterate_near_known_step(problem, s, switches, known_step, accuracy, steps)
    if extremal is None or extremal.missing_bang_arc is not None:
        extremal = _iterate_to_optimal_switches(problem, s, switches, accuracy, steps)
    while extremal is not None and extremal.step.gain >= accuracy and steps < FLOW_MAX_STEPS:
        steps *= 2
        finer = _iterate_near_known_step(problem, s, extremal.switches, extremal.step, accuracy, steps)
        extremal = finer or extremal
    if extremal is None:
        return None
    switches = _shift_switching_times(extremal.switches, extremal.step.change)
    return _build_arc_structure(structure, s, switches), extremal


def _iterate_to_optimal_switches(
    problem: Problem, s: PhaseSamples, switches: Switches, accuracy: float, steps: int
) -> BangBangExtremal | None:
    """Return the converged trajectory whose switching functions have the required signs, or None."""
    for _ in range(NEWTON_MAX_STEPS):
        step = compute_newton_step(problem, s, switches, steps)
        if step is None:
            return None
        share, shrinking_arc = _limit_newton_step(switches, step)
        if shrinking_arc and share < STEP_MIN_SHARE:
            switches = _remove_bang_arc(switches, shrinking_arc)
        elif share < 1 or step.get_relative_step_size(switches) > SIMPLIFIED_NEWTON_MAX_STEP:
            switches = _shift_switching_times(switches, share * step.change)
        else:
            extremal = _iterate_newton_steps(problem, s, switches, step, accuracy)
            if extremal is None or extremal.missing_bang_arc is None:
                return extremal
            switches = _insert_bang_arc(extremal.switches, *extremal.missing_bang_arc)
    return None


def _iterate_near_known_step(
    problem: Problem, s: PhaseSamples, switches: Switches, known_step: NewtonStep, accuracy: float, steps: int
) -> BangBangExtremal | None:
    """Return the trajectory near given switching times that the matrices of a known step lead to, or None."""
    step = compute_simplified_newton_step(problem, s, switches, known_step, steps)
    return _iterate_newton_steps(problem, s, switches, step, accuracy)


def _iterate_newton_steps(
    problem: Problem, s: PhaseSamples, switches: Switches, step: NewtonStep | None, accuracy: float
) -> BangBangExtremal | None:
    """Return the converged trajectory near given switching times, starting with a known step, or None.

    Steps reuse the matrices of the previous one as long as they decrease sufficiently fast.
    """
    previous = math.inf  # length of the previous step, if it had the same matrices
    for _ in range(SIMPLIFIED_NEWTON_MAX_STEPS):
        if step is None or _limit_newton_step(switches, step)[0] < 1:
            return None
        length = step.get_relative_step_size(switches)
        relative_error = _compute_switching_time_error(step, switches, accuracy)
        if relative_error < NOTABLE:
            return BangBangExtremal.integrate_phase(problem, s, switches, step)
        switches = _shift_switching_times(switches, step.change)
        contraction = min(length / previous if previous < math.inf else NEWTON_REMAINDER_FACTOR * length, 1.0)
        if relative_error * contraction < NOTABLE:
            extremal = BangBangExtremal.integrate_phase(problem, s, switches, step)
            if extremal is None:
                return None
            if _compute_switching_time_error(extremal.step, switches, accuracy) < INNER_TOLERANCE_SHARE:
                return extremal
        if relative_error * contraction ** (1 + SIMPLIFIED_STEPS_PER_FULL_STEP) > NOTABLE:
            step, previous = compute_newton_step(problem, s, switches, step.steps), math.inf
        else:
            step, previous = compute_simplified_newton_step(problem, s, switches, step, step.steps), length
    return None


def _compute_switching_time_error(step: NewtonStep, switches: Switches, accuracy: float) -> float:
    """Return the error of switching times relative to that permitted by an accuracy of the cost."""
    return max(step.gain / accuracy, step.get_relative_step_size(switches) / math.sqrt(accuracy))


def _is_newton_applicable(problem: Problem, s: PhaseSamples, structure: PhaseStructure) -> bool:
    """Return whether switching and end times are the only unknowns, and all end conditions are equalities."""
    phase = s.phase
    boxes = (phase.final_bounds, phase.initial_time_bounds, phase.final_time_bounds, phase.duration_bounds)
    bounds = stack_intervals(boxes)
    values = np.append(s.x[:, -1], [phase.initial_time, phase.final_time, phase.duration])
    scales = np.append(np.ptp(s.x, axis=1), np.full(3, s.span))
    at_one_sided_limit = np.logical_or(*bounds.is_near_limits(values, AT_LIMIT * scales)) & ~bounds.is_fixed
    return (
        len(problem.phases) == 1
        and s.functions.q.size == 0
        and bool(np.all(structure.active[: structure.n_controls]))
        and not np.any(structure.active[structure.n_controls :])
        and not any(structure.touches)
        and bool(np.all(phase.initial_bounds.is_fixed))
        and bool(np.all(problem.get_boundary_constraint_bounds().is_fixed))
        and not np.any(at_one_sided_limit)
    )


def _list_control_switches(s: PhaseSamples, structure: PhaseStructure) -> Switches:
    bounds = s.phase.control_bounds
    pairs = [(t, i) for k, t in enumerate(structure.times[1:-1], 1) for i in structure.find_changed_arcs(k)]
    first = np.where(structure.control_arc_kinds[:, 0] == ArcKind.UPPER, bounds.upper, bounds.lower)
    times, channels = (np.array([f[k] for f in pairs], dtype=kind) for k, kind in ((0, float), (1, int)))
    ends = np.array([structure.times[0], structure.times[-1]])
    return Switches(times, channels, first, ends, bounds.lower + bounds.upper, ())


def _build_arc_structure(old: PhaseStructure, s: PhaseSamples, switches: Switches) -> PhaseStructure:
    piecewise = switches.build_piecewise_control(switches.chronological_switch_order)
    at_upper = piecewise.controls == s.phase.control_bounds.upper[:, None]
    kinds = select_kind(at_upper, ArcKind.UPPER, ArcKind.LOWER)
    other_kinds = np.full((len(old.regular) - kinds.shape[0], kinds.shape[1]), ArcKind.INTERIOR)
    nonempty = np.diff(piecewise.times) > 0
    times = tuple(map(float, piecewise.times[np.append(nonempty, True)]))
    columns = tuple(map(tuple, np.vstack([kinds, other_kinds]).T[nonempty]))
    return replace(old, times=times, kinds=columns, touches=()).merge_equal_adjacent_arcs()


def _list_arc_switches(switches: Switches) -> list[tuple[int, int]]:
    """Return the unknowns (0 start, 1 to n switches, n + 1 end) at both ends of every arc of every control."""
    arcs: list[tuple[int, int]] = []
    for i in range(switches.first.size):
        channel_switches = np.flatnonzero(switches.channels == i)
        channel_switches = channel_switches[np.argsort(switches.times[channel_switches], kind="stable")]
        unknowns = [0, *(int(k) + 1 for k in channel_switches), switches.times.size + 1]
        arcs += itertools.pairwise(unknowns)
    return arcs


def _limit_newton_step(switches: Switches, step: NewtonStep) -> tuple[float, tuple[int, int] | None]:
    """Return the largest fraction of a step with positive lengths of all arcs, and the limiting arc."""
    times = np.concatenate([switches.ends[:1], switches.times, switches.ends[1:]])
    largest_move = SWITCH_MAX_MOVE_SHARE * (switches.ends[1] - switches.ends[0])
    share, limiting = min(1.0, largest_move / max(float(np.max(np.abs(step.change))), TINY)), None
    for begin, end in _list_arc_switches(switches):
        shrinks = step.change[begin] - step.change[end]
        largest_shrinkage = ARC_MAX_SHRINK_SHARE * (times[end] - times[begin])
        if shrinks > 0 and largest_shrinkage < share * shrinks:
            share, limiting = largest_shrinkage / shrinks, (begin, end)
    return share, limiting


def _shift_switching_times(switches: Switches, change: Array) -> Switches:
    times = switches.times + change[1:-1]
    return replace(switches, times=times, ends=switches.ends + change[[0, -1]])


def _remove_bang_arc(switches: Switches, arc: tuple[int, int]) -> Switches:
    begin, end = arc
    first = switches.first.copy()
    removed = [k - 1 for k in (begin, end) if 0 < k <= switches.times.size]
    if begin == 0 and removed:
        i = switches.channels[removed[0]]
        first[i] = switches.toggled[i] - first[i]
    times, channels = np.delete(switches.times, removed), np.delete(switches.channels, removed)
    return replace(switches, times=times, channels=channels, first=first)


def _insert_bang_arc(switches: Switches, i: int, start: float, end: float) -> Switches:
    first, added = switches.first.copy(), [t for t in (start, end) if switches.ends[0] < t < switches.ends[1]]
    if start <= switches.ends[0]:
        first[i] = switches.toggled[i] - first[i]
    times = np.concatenate([switches.times, added])
    channels = np.concatenate([switches.channels, np.full(len(added), i)])
    return replace(switches, times=times, channels=channels, first=first)
