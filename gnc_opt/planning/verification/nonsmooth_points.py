r"""Smoothness: dynamics and integrands must be differentiable along the trajectory.

If a trajectory crosses a surface :math:`g(x) = 0` at which they jump, the costate jumps by a multiple of
:math:`\partial g/\partial x` (A. E. Bryson & Y.-C. Ho, Applied Optimal Control, 1975, section 3.7). Between two phases,
linkages and the condition g = 0 account for this multiple; inside a phase it is not represented.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array, Mask, find_sign_changes
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_batch
from gnc_opt.numerical_tolerances import AT_LIMIT, MINOR, ROUNDING, SAME_TIME, SMALL, replace_tiny_by_one
from gnc_opt.planning.optimality.optimality_check_scales import (
    EndPoints,
    Scales,
    compute_hamiltonian_differences,
)
from gnc_opt.planning.optimality.sampling_at_narrow_peaks import find_zero_times
from gnc_opt.planning.problem.kink_detection import KinkFunctions, find_nonsmooth_operations, has_kinks
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.optimality_verdict import Condition, ConditionResult
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples

KINKS = "kinks"

MEANING = (
    "Dynamics and integrands must be differentiable along the trajectory. If they jump at a state, the costates jump "
    "too, which the other conditions do not include: end a phase at that state and link() the next phase to it. If the "
    "trajectory stays on a kink, gradients are not unique: state the kink as a constraint."
)


KINK_STEPS = 1e-4, 1e-6
"""Steps of second differences, relative to the reach."""

FIXED_DIRECTIONS = 8
"""Number of directions that are tested in addition to the principal axes where kinks may meet."""

KINK_MIN_RATIO = 0.3
"""Smallest ratio of the second differences per step at both steps; it is 1 at a kink."""


@dataclass(frozen=True)
class KinkPoint:
    """Worst nonsmooth point: a crossed ``jump``, ``of_states`` or of controls alone, ``resolved``: of known effect."""

    value: float
    where: str
    jump: bool = False
    of_states: bool = True
    resolved: bool = True


def find_nonsmooth_point(problem: Problem, samples: list[PhaseSamples], tolerance: float) -> KinkPoint | None:
    """Return the first jump that a trajectory crosses inside a phase, else a kink on which it stays, else None."""
    candidates = []
    for s in samples:
        kinks = find_nonsmooth_operations(problem, problem.phases[s.phase.name])
        if kinks is None:
            continue
        values = _evaluate_kink_arguments(s, kinks, s.times_inside_segments, s.x, s.u)
        for i, row in enumerate(values):
            signed = np.flatnonzero(row)  # samples on the surface are on neither side
            for k in find_sign_changes(row[signed]):
                jump = _find_jump_of_state_rates(s, kinks, i, s.times[signed[[k, k + 1]]], tolerance)
                if jump is not None:
                    return jump
        candidates.append(_find_longest_interval_on_kink(s, kinks, values))
    return max(filter(None, candidates), key=lambda point: point.of_states, default=None)


def check_concave_kinks(kink: KinkPoint | None, fails: bool, *, falls: bool) -> Condition:
    """Return the condition; it affects only ``minimum`` if nothing jumps and no other condition ``fails``."""
    if kink is None:
        return Condition(KINKS, ConditionResult.PASS, 0.0, 0.0, "the trajectory crosses no jump", MEANING)
    if falls:
        meaning = "The cost decreases on both sides of a kink, so a nearby trajectory has a lower cost."
        return Condition(KINKS, ConditionResult.FAIL, kink.value, 0.0, kink.where, meaning)
    sufficient = not kink.jump and not fails
    return Condition(
        KINKS, ConditionResult.INCONCLUSIVE, kink.value, 0.0, kink.where, MEANING, sufficient=sufficient
    )


def mark_condition_inconclusive_at_kink(condition: Condition, kink: KinkPoint) -> Condition:
    """Return a failed condition that requires smoothness as inconclusive.

    The minimum principle compares values of H and does not require smoothness in the controls.
    """
    compares_values = condition.name == "minimum principle" and not kink.of_states
    if condition.result is not ConditionResult.FAIL or compares_values:
        return condition
    return replace(
        condition,
        result=ConditionResult.INCONCLUSIVE,
        where=f"{condition.where}; not smooth: {kink.where}",
        loss=None,
        unit="",
    )


def find_concave_kink(samples: list[PhaseSamples], scales: Scales) -> KinkPoint | None:
    """Return a kink at which the cost decreases to both sides, else one of the ends that is not convex, else None.

    It evaluates ends, times, integrals and parameters, and states of phases on one of their kinks: second differences
    of the Lagrangian that are proportional to the step.
    """
    ends, problem = scales.ends, scales.ends.solution.need_problem("verify")
    has_boundary_kinks = has_kinks(ca.vertcat(problem.cost, problem.constraint_expression()))
    if has_boundary_kinks:
        ends = _CombinedDirections(ends.solution, ends.samples, ends.values, ends.gradients)
    of_ends = [
        ends.compute_end_lagrangian_differences(scales.reach, scales.parameters, step) for step in KINK_STEPS
    ]
    pairs = [("the end cost or a boundary constraint decreases on both sides of a kink", of_ends)]
    for s in samples:
        axes = moves = scales.phases[s.phase.name].along.nonzero_semi_axes
        if find_nonsmooth_operations(problem, problem.phases[s.phase.name]) is not None:
            moves = axes @ _build_unit_directions(axes.shape[1])[0]
        pair = _compute_hamiltonian_differences_by_step(s, moves[:, : axes.shape[1] + FIXED_DIRECTIONS])
        # If sums and differences of directions meet a kink, some of these directions meet it, too.
        if np.any(_mask_kinks(pair[0], pair[1], scales.cost)):
            pair = _compute_hamiltonian_differences_by_step(s, moves)
        pairs.append((f"phase {s.phase.name}: H decreases on both sides of a kink in the states", pair))
    for location, (coarse, fine) in pairs:
        decrease = _find_largest_cost_decrease_at_kink(coarse, fine, scales.cost)
        if decrease > 0:
            return KinkPoint(decrease, location)
    excess = (
        min(map(_find_largest_second_difference_excess, of_ends)) / scales.cost
        if has_boundary_kinks and of_ends[0].size
        else 0.0
    )
    location = "kinks of the end cost or a boundary constraint meet and are not convex: not all directions are tested"
    return KinkPoint(excess / (1 + excess), location, resolved=False) if excess > SMALL else None


class _CombinedDirections(EndPoints):
    """End points whose differences are evaluated along combinations of the given moves."""

    def _compute_endpoint_finite_differences(self, moves: Array) -> tuple[Array, Array]:
        return super()._compute_endpoint_finite_differences(moves @ _build_unit_directions(moves.shape[1])[0])


def _build_unit_directions(n: int) -> tuple[Array, Array]:
    """Return axes, fixed directions, sums and differences of their pairs, as unit vectors (n, k), and lengths (k,)."""
    fixed = np.random.default_rng(0).standard_normal((n, FIXED_DIRECTIONS))
    base = np.hstack([np.eye(n), fixed / np.linalg.norm(fixed, axis=0)])
    i, j = np.triu_indices(base.shape[1], 1)
    directions = np.hstack([base, base[:, i] + base[:, j], base[:, i] - base[:, j]])
    lengths = np.linalg.norm(directions, axis=0)
    return directions / np.maximum(lengths, ROUNDING), lengths


def _find_largest_second_difference_excess(differences: Array) -> float:
    """Return by how much second differences along sums of directions exceed the sums of those along each."""
    n = round(np.sqrt(differences.shape[1]))  # directions of `_build_unit_directions` without pairs
    change = differences[1] * _build_unit_directions(n - FIXED_DIRECTIONS)[1]
    i, j = np.triu_indices(n, 1)
    return float(np.max(change[n:] - np.tile(change[i] + change[j], 2), initial=0.0))


def _compute_hamiltonian_differences_by_step(s: PhaseSamples, moves: Array) -> list[Array]:
    return [compute_hamiltonian_differences(s, moves, step) for step in KINK_STEPS]


def _find_largest_cost_decrease_at_kink(coarse: Array, fine: Array, cost: float) -> float:
    """Return the largest decrease at a kink, relative to the cost scale (at most 1); zero without a decrease."""
    decrease = float(np.max(np.where(_mask_kinks(coarse, fine, cost), -coarse[1], 0.0), initial=0.0))
    return decrease / (cost + decrease)


def _mask_kinks(coarse: Array, fine: Array, cost: float) -> Mask:
    """Return along which moves the second difference is proportional to the step, beyond rounding (n,)."""
    ratio = np.divide(fine[1], coarse[1], out=np.zeros_like(fine[1]), where=coarse[1] != 0)
    large = np.abs(coarse[1]) >= SMALL * np.maximum(np.abs(coarse[0]), cost)
    return np.asarray((ratio >= KINK_MIN_RATIO) & large & np.all(np.isfinite(fine), axis=0))


def _evaluate_kink_arguments(
    s: PhaseSamples, kinks: KinkFunctions, times: Array, x: Array, u: Array
) -> Array:
    numbers = s.functions.p, s.functions.q
    return evaluate_casadi_batch(kinks.arguments, times.size, times[None], x, u, *numbers)


def _find_jump_of_state_rates(
    s: PhaseSamples, kinks: KinkFunctions, i: int, between: Array, tolerance: float
) -> KinkPoint | None:
    """Return the jump of dx/dt and integrands where an argument changes sign between two times."""

    def evaluate_arguments(times: Array) -> Array:
        return _evaluate_kink_arguments(s, kinks, times, s.phase.x(times), s.phase.applied(times))

    offset = SAME_TIME * s.span  # samples may belong to another segment
    crossing = find_zero_times(evaluate_arguments, np.array([i]), between[:1] + offset, between[1:] - offset)
    sides = np.clip(np.append(crossing - offset, crossing + offset), *s.phase.breaks[[0, -1]])
    x, u = s.phase.x(sides), np.repeat(s.phase.applied(sides)[:, :1], 2, axis=1)
    rates = np.abs(np.diff(s.functions.state_rates(sides, x, u)))[:, 0] * s.span / s.state_scale
    integrands = s.functions.weights @ np.abs(np.diff(s.functions.integrands(sides, x, u)))[:, 0] * s.span
    jump = float(np.max(np.append(rates, abs(integrands) / s.cost_scale)))
    if not jump > tolerance:
        return None
    location = f"{s.describe_time(float(crossing[0]))}: {kinks.words[i]} makes dx/dt or an integrand jump"
    return KinkPoint(jump, location, True)


def _find_longest_interval_on_kink(s: PhaseSamples, kinks: KinkFunctions, values: Array) -> KinkPoint | None:
    """Return the longest interval in which an argument stays at zero, if it is not merely crossed."""
    sizes = replace_tiny_by_one(np.max(np.abs(values), axis=1))
    at_zero = np.abs(values) <= AT_LIMIT * sizes[:, None]
    lengths = np.sum(at_zero * s.weights, axis=1) / s.span
    is_long = lengths > MINOR
    if not np.any(is_long):
        return None
    of_states = bool(np.any(is_long & kinks.is_state_dependent))  # kinks in states have priority
    i = int(np.argmax(np.where(kinks.is_state_dependent == of_states, lengths, 0.0)))
    j = int(np.argmax(at_zero[i]))
    where = f"from {s.describe_sample(j)}: stays on the kink of {kinks.words[i]}, {100 * lengths[i]:.1f} % of the phase"
    return KinkPoint(float(lengths[i]), where, of_states=of_states)
