r"""Junctions of interior arcs with bound arcs: kinks of regular controls.

If H is strictly convex in a control, the control is continuous, and it enters or leaves a bound (or a mixed path
constraint) with a kink. The cost hardly depends on the time :math:`t_k` of a kink: if the control leaves its bound too
late or too early by :math:`\delta`, its error is :math:`O(\delta)` for a time :math:`\delta`, which costs
:math:`O(\delta^3)`. As a variable of the program, the time of a kink would thus depend on discretisation errors.

States and costates have errors of :math:`O(\delta^2)` only. A kink is therefore fixed during a solve, in which the
control is fixed on one side and *unbounded* on the other. The kink then moves to the time at which the control of the
interior arc meets the bound (bound arc too short) or the switching function along the bound arc changes sign (bound arc
too long). This iteration converges quadratically.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import EQUAL, GONE, JUNCTION_OFFSET_SHARE, NEGLIGIBLE
from gnc_opt.planning.optimality.state_constraint_derivatives import StateConstraints
from gnc_opt.planning.refinement.arcs.arc_mesh import ArcMesh
from gnc_opt.planning.refinement.arcs.control_structure import PhaseStructure
from gnc_opt.planning.refinement.arcs.structure_detection import find_roots
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.piecewise_polynomial import Side

KINK_MAX_MOVE_SHARE = 0.5
"""Largest move of a junction in one pass, relative to the shorter adjacent piece."""


def move_control_kinks(constraints: StateConstraints, plan: ArcMesh) -> PhaseStructure | None:
    """Return the structure with kinks moved to the times that the solution indicates, or None if they are converged.

    Lengths of pieces may become zero or negative.
    """
    structure, samples = plan.structure, constraints.samples
    times = list(structure.times)
    for boundary in range(1, structure.n_pieces):
        if structure.has_only_kinks(boundary):
            wanted = [
                find_junction_time(constraints, structure, boundary, i)
                if structure.orders[i]
                else _find_kink_time(samples, plan, boundary, i)
                for i in structure.find_changed_arcs(boundary)
            ]
            times[boundary] = max(wanted, key=lambda t: abs(t - structure.times[boundary]))
    moves = np.abs(np.asarray(times) - np.asarray(structure.times))
    contact = [
        any(structure.orders[i] for i in structure.find_changed_arcs(k)) for k in range(1, structure.n_pieces)
    ]
    span, lengths = times[-1] - times[0], structure.piece_lengths
    beside = np.minimum(np.append(lengths, span), np.append(span, lengths))
    settled = np.where(
        [False, *contact, False],
        EQUAL * span,
        np.minimum(GONE * span, NEGLIGIBLE * beside),
    )
    if np.all(moves <= settled):
        return None
    return structure.with_switch_times(tuple(times))


def find_junction_time(
    constraints: StateConstraints, structure: PhaseStructure, boundary: int, row: int
) -> float:
    """Return the time of an arc's end, at which the q-th derivative of the row along the interior arc vanishes."""
    leg, first = constraints.samples.leg, structure.n_controls
    entered = structure.kinds[boundary][row].is_at_limit
    side: Side = "left" if entered else "right"
    time = structure.times[boundary]
    k = int(np.argmin(np.abs(leg.breaks - time)))
    step = JUNCTION_OFFSET_SHARE * (
        leg.breaks[k] - leg.breaks[k - 1] if entered else leg.breaks[k] - leg.breaks[k + 1]
    )
    times = np.array([leg.breaks[k], leg.breaks[k] - step])
    values = constraints.evaluate_time_derivative(
        row - first, structure.orders[row], times, leg.x(times, side), leg.u(times, side)
    )
    slope = (values[0] - values[1]) / step
    lengths = structure.piece_lengths
    most = KINK_MAX_MOVE_SHARE * min(lengths[boundary - 1], lengths[boundary])
    move = -values[0] / slope if slope != 0 else 0.0
    return time + float(np.clip(move, -most, most))


def _find_kink_time(samples: PhaseSamples, plan: ArcMesh, boundary: int, row: int) -> float:
    before, after = (plan.structure.kinds[k][row] for k in (boundary - 1, boundary))
    held, interior = (boundary - 1, boundary) if before.is_at_limit else (boundary, boundary - 1)
    direction = before.sign or after.sign
    pieces = plan.segment_piece_indices[samples.segments]
    for piece, number in ((interior, 0), (held, 1)):
        here = np.flatnonzero(pieces == piece)
        side: Side = "right"
        if piece < boundary:
            here, side = here[::-1], "left"

        def evaluate_signed_excess(t: Array, side: Side = side, number: int = number) -> Array:
            return direction * _evaluate_limit_excess(samples, row, direction, side, t)[number]

        reach = _find_violation_end_time(samples.times[here], evaluate_signed_excess)
        if reach is not None:
            return reach
    return plan.structure.times[boundary]


def _evaluate_limit_excess(
    samples: PhaseSamples, row: int, direction: int, side: Side, t: Array
) -> tuple[Array, Array]:
    """Return control minus limit and switching function, or path constraint minus limit and -multiplier (n_times,)."""
    leg, functions = samples.leg, samples.functions
    x, u, mu = leg.x(t, side), leg.u(t, side), leg.path_multiplier(t, side)
    values = np.vstack([u, functions.path_constraints(t, x, u)])
    slopes = np.vstack([functions.control_gradient(t, x, u, leg.lam(t, side), mu), -mu])
    limits = np.concatenate([box.get_limit(direction) for box in (leg.control_bounds, leg.path_bounds)])
    return values[row] - limits[row], slopes[row]


def _find_violation_end_time(times: Array, violation: Callable[[Array], Array]) -> float | None:
    over = violation(times) > 0
    if not over[0]:
        return None
    if np.all(over):
        return float(times[-1])
    k = int(np.argmin(over))
    return float(find_roots(violation, times[k - 1 : k], times[k : k + 1])[0])
