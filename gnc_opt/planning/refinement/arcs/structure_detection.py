"""Detection of the control structure from controls and switching functions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gnc_opt.array_types import Array, Mask, find_equal_value_intervals
from gnc_opt.numerical_tolerances import CONVEX, MINOR, NEGLIGIBLE, NOTABLE, ROUNDING, SMALL
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind
from gnc_opt.planning.refinement.arcs.control_structure import (
    ControlEffect,
    KindArray,
    PhaseStructure,
    select_kind,
)
from gnc_opt.planning.refinement.arcs.hamiltonian_convexity import (
    LinearPathLimits,
    compute_hamiltonian_curvature,
    find_linear_path_constraints,
    mask_affine_controls,
    mask_convex_controls,
)
from gnc_opt.planning.refinement.arcs.state_constraint_contact_detection import (
    SHORT_ARC_SEGMENTS,
    ArcControl,
    add_contacts,
    find_constraint_arc_controls,
)
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution


def detect_arc_structures(solution: Solution) -> dict[str, PhaseStructure]:
    """Return the arcs of controls, path constraints and states of a solution, by phase."""
    problem = solution.need_problem("refine")
    return {
        name: add_contacts(detect_control_structure(s, find_constraint_arc_controls(problem, s)), problem, s)
        for name, s in solution.samples().items()
    }


def detect_control_structure(samples: PhaseSamples, determined: Sequence[ArcControl] = ()) -> PhaseStructure:
    """Return the structure of a phase; controls that state constraints determine, if given, are off their bounds.

    For controls linear in H, the sign of the switching function determines the kind, unless it stays near zero over
    whole segments with the control off its bounds; short bangs next to those are noise. Other controls are classified
    by their distances from the bounds, path constraints and states by distances and multipliers.
    """
    phase, regular, affine = samples.phase, mask_convex_controls(samples), mask_affine_controls(samples)
    limits = find_linear_path_constraints(samples)
    spans = [[(d.start, d.end) for d in determined if d.control == i] for i in range(phase.controls.size)]
    rows = [
        _classify_linear_arcs(samples, i, spans[i]) if affine[i] else _classify_nonlinear_arcs(samples, i)
        for i in range(phase.controls.size)
    ]
    path_jacobian = samples.functions.path_control_jacobian(samples.times, samples.x, samples.u)
    effects = _find_control_signs_in_mixed_constraints(samples, regular, path_jacobian)
    mixed = np.array([bool(row_effects) for row_effects in effects], dtype=bool)
    paths = _classify_path_constraint_arcs(samples, mixed, np.any(path_jacobian != 0, axis=2))
    for i in limits.rows:
        for path in limits.rows[i]:
            effects[path] = ((i, int(np.sign(np.sum(limits.slopes[path])))),)
        if affine[i]:
            _replace_bounds_by_path_constraints(limits, i, rows[i], paths, spans[i])
    changes = _locate_switching_times(samples, rows)
    controls = np.asarray(rows).reshape(phase.controls.size, samples.times.size)  # also without controls
    for labels in [*paths, *_classify_state_constraint_arcs(samples, controls, determined)]:
        rows.append(labels)
        jumps = np.flatnonzero(labels[1:] != labels[:-1])
        changes.append([float(t) for t in 0.5 * (samples.times[jumps] + samples.times[jumps + 1])])
    first, last = phase.breaks[0], phase.breaks[-1]
    candidates = np.unique([first, *(t for row in changes for t in row if first < t < last)])
    is_distinct = np.minimum(np.diff(candidates), last - candidates[1:]) > ROUNDING * (last - first)
    times = [first, *map(float, candidates[1:][is_distinct]), last]
    middles = 0.5 * (np.asarray(times[1:]) + np.asarray(times[:-1]))
    starts = [[first for first, _ in find_equal_value_intervals(labels)] for labels in rows]
    kinds = [row[at][np.searchsorted(t, middles)] for row, at, t in zip(rows, starts, changes, strict=True)]
    return PhaseStructure(
        tuple(float(t) for t in times),
        tuple(tuple(column) for column in np.stack(kinds).T),
        (*(bool(r) for r in regular), *(bool(r) for r in mixed), *(False,) * phase.states.size),
        phase.controls.size,
        len(phase.path_labels),
        effects=(*((),) * phase.controls.size, *effects, *((),) * phase.states.size),
    ).merge_equal_adjacent_arcs()


def _classify_linear_arcs(samples: PhaseSamples, i: int, spans: Sequence[tuple[float, float]]) -> KindArray:
    """Return LOWER, UPPER or SINGULAR at each sample for a control linear in H, SINGULAR in intervals."""
    gradient = _compute_relative_hamiltonian_change(samples, samples.control_gradient, i)
    labels = select_kind(gradient > 0, ArcKind.LOWER, ArcKind.UPPER)
    for k in _find_singular_segments(samples, i, gradient):
        labels[samples.segments == k] = ArcKind.SINGULAR
    labels[_mask_times_in_intervals(samples, spans)] = ArcKind.SINGULAR
    _absorb_short_bang_arcs(samples, i, labels, gradient)
    return labels


def _mask_times_in_intervals(samples: PhaseSamples, intervals: Sequence[tuple[float, float]]) -> Mask:
    inside = np.zeros(samples.times.size, dtype=bool)
    for start, end in intervals:
        inside |= (samples.times >= start) & (samples.times <= end)
    return inside


def _replace_bounds_by_path_constraints(
    limits: LinearPathLimits,
    i: int,
    labels: KindArray,
    paths: list[KindArray],
    spans: Sequence[tuple[float, float]],
) -> None:
    """Replace bounds of a control by tighter path constraints, except on singular arcs and in ``spans`` spans."""
    samples = limits.samples
    is_interior = ~limits.mask_samples_near_limit(i, NOTABLE * samples.control_scale[i])
    change = _compute_relative_hamiltonian_change(samples, samples.switching_functions, i)
    segments = _find_singular_segments(samples, i, change)
    interior_segments = [k for k in segments if np.mean(is_interior[samples.segments == k]) > 0.5]
    singular = np.isin(samples.segments, interior_segments)
    singular |= _mask_times_in_intervals(samples, spans)
    control_kinds, path_kinds = limits.label_control_arcs(i, samples.switching_functions[i] < 0)
    labels[:] = select_kind(singular, ArcKind.SINGULAR, control_kinds)
    for row, kinds in path_kinds.items():
        paths[row] = select_kind(singular, ArcKind.INTERIOR, kinds)


def _compute_relative_hamiltonian_change(samples: PhaseSamples, gradient: Array, i: int) -> Array:
    """Return the change of H over a control's whole range, relative to H, (n_samples,)."""
    return np.asarray(gradient[i] * samples.control_scale[i] / samples.hamiltonian_scale)


def _absorb_short_bang_arcs(samples: PhaseSamples, i: int, labels: KindArray, gradient: Array) -> None:
    """Assign short bangs next to a singular arc to it if the switching function is small or the control far off."""
    bounds = samples.phase.control_bounds
    bound_values = np.where(labels == ArcKind.LOWER, bounds.lower[i], bounds.upper[i])
    distance = np.abs(samples.u[i] - bound_values) / samples.control_scale[i]
    is_noise = np.empty(labels.size, dtype=bool)
    for first, last in find_equal_value_intervals(labels):
        is_small = np.max(np.abs(gradient[first:last])) < NOTABLE
        is_noise[first:last] = is_small or np.mean(distance[first:last]) > 0.5
    _absorb_short_arcs(samples, labels, ArcKind.SINGULAR, is_noise)


def _absorb_short_arcs(samples: PhaseSamples, labels: KindArray, label: ArcKind, candidates: Mask) -> None:
    """Assign the adjacent arcs shorter than `SHORT_ARC_SEGMENTS` segments to arcs of a label, if all are candidates."""
    segment_lengths = np.diff(samples.phase.breaks)[samples.segments]
    has_changed = True
    while has_changed:
        has_changed = False
        for first, last in find_equal_value_intervals(np.stack([labels, candidates])):
            is_adjacent = label in labels[max(first - 1, 0) : first] or label in labels[last : last + 1]
            length = samples.times[last - 1] - samples.times[first]
            is_short = length < SHORT_ARC_SEGMENTS * np.max(segment_lengths[first:last])
            if labels[first] != label and candidates[first] and is_adjacent and is_short:
                labels[first:last], has_changed = label, True
                break


def _find_singular_segments(samples: PhaseSamples, i: int, gradient: Array) -> list[int]:
    """Return the segments on which the control is off its bounds and its switching function stays small.

    A single segment does not count: it may contain a switch.
    """
    phase = samples.phase
    bounds, margin = phase.control_bounds, NOTABLE * samples.control_scale[i]
    segments = []
    for k, values in enumerate(phase.u.values):
        is_interior = (values[i] > bounds.lower[i] + margin) & (values[i] < bounds.upper[i] - margin)
        is_small = np.max(np.abs(gradient[samples.segments == k])) < NOTABLE
        if is_small and np.mean(is_interior) > 0.5:
            segments.append(k)
    return [k for k in segments if k - 1 in segments or k + 1 in segments]


def _classify_nonlinear_arcs(samples: PhaseSamples, i: int) -> KindArray:
    """Return LOWER, UPPER or INTERIOR at each sample."""
    at_lower, at_upper = samples.phase.control_bounds.is_near_limits(samples.u, SMALL * samples.control_scale)
    gradient = samples.control_gradient[i]
    return _label_arcs_at_limits(at_lower[i] & (gradient > 0), at_upper[i] & (gradient < 0))


def _find_control_signs_in_mixed_constraints(
    samples: PhaseSamples, regular: Mask, slopes: Array
) -> list[tuple[ControlEffect, ...]]:
    """Return the controls of each mixed path constraint with the signs of its slopes in them, 0 if they change.

    Mixed path constraints are inequalities on regular controls, which become active with a kink; not norms of
    directions.
    """
    phase, depends = samples.phase, np.any(slopes != 0, axis=2)
    norms = [v.direction_norm_constraint_name for v in phase.vector_controls]
    inequality = (phase.path_bounds.lower < phase.path_bounds.upper) & ~np.isin(phase.path_labels, norms)
    depends &= (inequality & ~np.any(depends & ~regular, axis=1))[:, None]
    signs = np.where(np.all(slopes > 0, axis=2), 1, np.where(np.all(slopes < 0, axis=2), -1, 0))
    pairs = zip(signs, depends, strict=True)
    return [tuple((int(i), int(row[i])) for i in np.flatnonzero(row_depends)) for row, row_depends in pairs]


def _classify_path_constraint_arcs(samples: PhaseSamples, mixed: Mask, depends: Mask) -> list[KindArray]:
    """Return LOWER, INTERIOR or UPPER at each sample for every path constraint; INTERIOR except for mixed ones.

    If H has no curvature in any control of a constraint (``depends``: (n_paths, n_controls)), the multiplier vanishes.
    """
    if not mixed.size:
        return []
    values = samples.functions.path_constraints(samples.times, samples.x, samples.u)
    is_curved = compute_hamiltonian_curvature(samples) > CONVEX
    has_no_multiplier = np.abs(samples.mu) <= NEGLIGIBLE * np.max(np.abs(samples.mu), axis=1, keepdims=True)
    linear = has_no_multiplier & np.array([~np.any(is_curved[controls], axis=0) for controls in depends])
    margin = SMALL * np.max(np.abs(values), axis=1)
    at_lower, at_upper = samples.phase.path_bounds.is_near_limits(values, margin)
    at_lower, at_upper = at_lower & (linear | (samples.mu < 0)), at_upper & (linear | (samples.mu > 0))
    return list(_label_arcs_at_limits(mixed[:, None] & at_lower, mixed[:, None] & at_upper))


def _classify_state_constraint_arcs(
    samples: PhaseSamples, controls: KindArray, determined: Sequence[ArcControl] = ()
) -> list[KindArray]:
    """Return LOWER, INTERIOR or UPPER at each sample for every state.

    A state has an arc on its bound along segments on which it stays there while its rate depends on a singular control,
    and wherever the bound has a multiplier. Arcs do not include an end of the phase with another given value.
    """
    first = len(samples.phase.path_labels)
    phase, rows, is_driven = samples.phase, [], _mask_states_driven_by_singular_controls(samples, controls)
    ends = ((0, phase.initial_bounds), (phase.mesh.segments - 1, phase.final_bounds))
    for i in range(phase.states.size):
        labels = np.full(samples.times.size, ArcKind.INTERIOR)
        margin = MINOR * samples.state_scale[i]
        limits = (
            (ArcKind.UPPER, phase.state_bounds.upper[i], phase.state_bounds.upper[i] - samples.x[i]),
            (ArcKind.LOWER, phase.state_bounds.lower[i], samples.x[i] - phase.state_bounds.lower[i]),
        )
        for kind, _, distance in limits:
            for k in range(phase.mesh.segments):
                in_segment = samples.segments == k
                if np.all(distance[in_segment] < margin) and is_driven[i, in_segment][in_segment.sum() // 2]:
                    labels[in_segment] = kind
        for kind, limit, _ in limits if np.any(labels != ArcKind.INTERIOR) else ():
            excluded = [k for k, box in ends if not box.lower[i] - margin <= limit <= box.upper[i] + margin]
            is_admissible = ~np.isin(samples.segments, excluded)
            contact_intervals = [(d.start, d.end) for d in determined if (d.row, d.kind) == (first + i, kind)]
            labels[_mask_times_in_intervals(samples, contact_intervals) & is_admissible] = kind
            _absorb_short_arcs(samples, labels, kind, is_driven[i] & is_admissible)
        rows.append(labels)
    return rows


def _mask_states_driven_by_singular_controls(samples: PhaseSamples, controls: KindArray) -> Mask:
    """Return where the rate of a state depends on a singular control, (n_states, n_samples)."""
    driven, rates = np.zeros(samples.x.shape, dtype=bool), samples.functions.state_rates
    singular = controls == ArcKind.SINGULAR
    for channel in np.flatnonzero(np.any(singular, axis=1)):
        varied = samples.u.copy()
        varied[channel] += SMALL * samples.control_scale[channel]
        changed = rates(samples.times, samples.x, varied) != rates(samples.times, samples.x, samples.u)
        driven |= changed & singular[channel]
    return driven


def _label_arcs_at_limits(at_lower: Mask, at_upper: Mask) -> KindArray:
    otherwise = select_kind(at_upper, ArcKind.UPPER, ArcKind.INTERIOR)
    return select_kind(at_lower, ArcKind.LOWER, otherwise)


def _locate_switching_times(samples: PhaseSamples, rows: list[KindArray]) -> list[list[float]]:
    """Return the times at which each control's label changes: zeros of switching functions, else between samples."""
    times, times_by_row = samples.times, list[list[float]]()
    for row, slope in zip(rows, samples.control_gradient, strict=True):
        times_by_row.append([])
        for j in np.flatnonzero(row[1:] != row[:-1]):
            crosses = row[j].is_at_limit and row[j + 1].is_at_limit and slope[j] * slope[j + 1] < 0
            fraction = slope[j] / (slope[j] - slope[j + 1]) if crosses else 0.5
            times_by_row[-1].append(float(times[j] + fraction * (times[j + 1] - times[j])))
    return times_by_row
