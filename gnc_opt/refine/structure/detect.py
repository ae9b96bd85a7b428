"""Recognising the control structure from controls and switching functions."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import scipy

from gnc_opt.arrays import Array, Mask
from gnc_opt.model.composed import VectorControl
from gnc_opt.problem.arc import ArcKind
from gnc_opt.refine.structure.phase_structure import KindArray, PhaseStructure, choose
from gnc_opt.solution.samples import PhaseSamples

NEAR = 0.02
"""A control this close to a bound, relative to its range, is taken to sit on it."""

REACHED = 1e-3
"""A control that H determines, or a path constraint, this close to its limit (relative to its size) is at it if its
multiplier says so too."""

STILL = 1e-4
"""A state that stays this close to its bound, relative to its size, along a segment is held there."""

LINEAR = 1e-9
"""Second derivative of H in a control, over its range and in shares of H, below which H is linear in it."""

SMALL = 2e-2
"""A switching function this small over whole segments, in shares of H, marks a singular arc."""

LAST_DIGITS = 1e-14
"""Relative accuracy of a time at which a function crosses zero."""

PROBE = 1e-3
"""Share of a control's range by which it is moved to see whether a rate depends on it."""

SHORT = 2.0
"""Bangs beside a singular arc that are shorter than this many segments belong to it."""

CONVEX = 1e-6
"""Least second derivative of H in a control, over its range and in shares of H, that determines the control."""


def detect(samples: PhaseSamples) -> PhaseStructure:
    """Return the structure of a phase.

    Controls that enter H linearly follow the sign of their switching function, except where it stays near
    zero over whole segments with the control between its bounds (a singular arc, or one on a state
    constraint). Other controls are judged by their nearness to the bounds, path constraints and states by theirs and
    by their multipliers.
    """
    leg, regular, affine = samples.leg, regular_channels(samples), affine_channels(samples)
    rows, changes = [], []
    for i in range(leg.controls.size):
        labels = _linear_labels(samples, i) if affine[i] else _nonlinear_labels(samples, i)
        rows.append(labels)
        changes.append(_change_times(samples, i, labels))
    mixed = _mixed_paths(samples, regular)
    for labels in [*_path_labels(samples, mixed), *_state_labels(samples, np.asarray(rows))]:
        rows.append(labels)
        changes.append(_middles(samples, labels))
    first, last = leg.breaks[0], leg.breaks[-1]
    times = [first, *sorted({t for row in changes for t in row if first < t < last}), last]
    middles = 0.5 * (np.asarray(times[1:]) + np.asarray(times[:-1]))
    kinds = np.stack([_labels_at(row, at, middles) for row, at in zip(rows, changes, strict=True)])
    return PhaseStructure(
        tuple(float(t) for t in times),
        tuple(tuple(column) for column in kinds.T),
        (*(bool(r) for r in regular), *(bool(r) for r in mixed), *(False,) * leg.states.size),
        leg.controls.size,
        len(leg.path_labels),
    ).merged()


def affine_channels(samples: PhaseSamples) -> Mask:
    """Return which controls enter H linearly and have two finite bounds, (m,)."""
    bounds = samples.leg.control_bounds
    bounded = np.isfinite(bounds.lower) & np.isfinite(bounds.upper)
    return np.asarray((np.max(np.abs(_curvature(samples)), axis=1, initial=0.0) < LINEAR) & bounded)


def regular_channels(samples: PhaseSamples) -> Mask:
    """Return in which controls H is strictly convex all along the phase, (m,)."""
    return np.asarray(np.min(_curvature(samples), axis=1, initial=np.inf) > CONVEX)


def _curvature(samples: PhaseSamples) -> Array:
    """Second derivative of H in each control over its range, in shares of H, (m, n_samples)."""
    hessians = samples.functions.control_hessian(samples.times, samples.x, samples.u, samples.lam, samples.mu)
    scale = samples.control_scale
    return np.asarray(np.einsum("iij->ij", hessians) * scale[:, None] ** 2 / samples.hamiltonian_scale)


def switching(samples: PhaseSamples, i: int) -> Callable[[float], float]:
    """Return dH/du of channel i as a function of one time."""
    leg, functions = samples.leg, samples.functions

    def value(t: float) -> float:
        mu = leg.path_multiplier(t) if leg.path_labels else np.zeros(0)
        return float(functions.control_gradient(t, leg.x(t), leg.flown(t), leg.lam(t), mu)[i])

    return value


def _linear_labels(samples: PhaseSamples, i: int) -> KindArray:
    """LOWER, UPPER or SINGULAR at each sample for a control that enters H linearly."""
    gradient = samples.control_gradient[i] * samples.control_scale[i] / samples.hamiltonian_scale
    labels = choose(gradient > 0, ArcKind.LOWER, ArcKind.UPPER)
    for k in _singular_segments(samples, i, gradient):
        labels[samples.segments == k] = ArcKind.SINGULAR
    _absorb(samples, i, labels, gradient)
    return labels


def _absorb(samples: PhaseSamples, i: int, labels: KindArray, gradient: Array) -> None:
    """Give short bangs beside a singular arc to it that are noise or chatter.

    Along those the switching function stays small, or the control is nowhere near the bound that its sign asks for.
    """
    bounds = samples.leg.control_bounds
    wanted = np.where(labels == ArcKind.LOWER, bounds.lower[i], bounds.upper[i])
    miss = np.abs(samples.u[i] - wanted) / samples.control_scale[i]
    noise = np.empty(labels.size, dtype=bool)
    edges = [0, *(np.flatnonzero(labels[1:] != labels[:-1]) + 1), labels.size]
    for first, last in itertools.pairwise(edges):
        noise[first:last] = np.max(np.abs(gradient[first:last])) < SMALL or np.mean(miss[first:last]) > 0.5
    _spread(samples, labels, ArcKind.SINGULAR, noise)


def _spread(samples: PhaseSamples, labels: KindArray, label: ArcKind, candidates: Mask) -> None:
    """Let arcs of a label swallow neighbours shorter than `SHORT` segments, if all of those are candidates."""
    lengths = np.diff(samples.leg.breaks)[samples.segments]
    grown = True
    while grown:
        grown = False
        changes = (labels[1:] != labels[:-1]) | (candidates[1:] != candidates[:-1])
        edges = [0, *(np.flatnonzero(changes) + 1), labels.size]
        for first, last in itertools.pairwise(edges):
            beside = label in labels[max(first - 1, 0) : first] or label in labels[last : last + 1]
            short = samples.times[last - 1] - samples.times[first] < SHORT * np.max(lengths[first:last])
            if labels[first] != label and candidates[first] and beside and short:
                labels[first:last], grown = label, True
                break


def _singular_segments(samples: PhaseSamples, i: int, gradient: Array) -> list[int]:
    """Segments on which the control lies between its bounds while its switching function stays small.

    A switch smears over one segment, too, but there the switching function leaves zero at once; so a lone
    segment does not count.
    """
    leg = samples.leg
    bounds, margin = leg.control_bounds, NEAR * samples.control_scale[i]
    found = []
    for k, values in enumerate(leg.u.values):
        inside = (values[i] > bounds.lower[i] + margin) & (values[i] < bounds.upper[i] - margin)
        small = np.max(np.abs(gradient[samples.segments == k])) < SMALL
        if small and np.mean(inside) > 0.5:
            found.append(k)
    return [k for k in found if k - 1 in found or k + 1 in found]


def _nonlinear_labels(samples: PhaseSamples, i: int) -> KindArray:
    at_lower, at_upper = samples.leg.control_bounds.near(samples.u, REACHED * samples.control_scale)
    gradient = samples.control_gradient[i]
    return _at_limits(at_lower[i] & (gradient > 0), at_upper[i] & (gradient < 0))


def _mixed_paths(samples: PhaseSamples, regular: Mask) -> Mask:
    """Which path constraints are inequalities on controls that H determines: they become active with a kink.

    The length of a direction does not: it is at its limit all along but where the direction does not matter.
    """
    leg = samples.leg
    lengths = [v.length for v in leg.composed_controls if isinstance(v, VectorControl)]
    slopes = samples.functions.path_control_jacobian(samples.times, samples.x, samples.u)
    depends = np.any(slopes != 0, axis=2)
    inequality = (leg.path_bounds.lower < leg.path_bounds.upper) & ~np.isin(leg.path_labels, lengths)
    return np.asarray(inequality & np.any(depends, axis=1) & ~np.any(depends & ~regular, axis=1))


def _path_labels(samples: PhaseSamples, mixed: Mask) -> list[KindArray]:
    """LOWER, INTERIOR or UPPER at each sample for every path constraint; INTERIOR for all but mixed ones."""
    if not mixed.size:
        return []
    values = samples.functions.paths(samples.times, samples.x, samples.u)
    at_lower, at_upper = samples.leg.path_bounds.near(values, REACHED * np.max(np.abs(values), axis=1))
    at_lower, at_upper = at_lower & (samples.mu < 0), at_upper & (samples.mu > 0)
    return list(_at_limits(mixed[:, None] & at_lower, mixed[:, None] & at_upper))


def _state_labels(samples: PhaseSamples, controls: KindArray) -> list[KindArray]:
    """LOWER, INTERIOR or UPPER at each sample for every state.

    A state counts as held along segments on which it stays on its bound while some singular control could move
    it at once (a bound of first order).
    """
    leg, rows = samples.leg, []
    for i in range(leg.states.size):
        labels = np.full(samples.times.size, ArcKind.INTERIOR)
        margin = STILL * samples.state_scale[i]
        for kind, distance in (
            (ArcKind.UPPER, leg.state_bounds.upper[i] - samples.x[i]),
            (ArcKind.LOWER, samples.x[i] - leg.state_bounds.lower[i]),
        ):
            for k in range(leg.mesh.segments):
                here = samples.segments == k
                if np.all(distance[here] < margin) and _commanded(samples, i, controls, here):
                    labels[here] = kind
            if np.any(labels == kind):
                _spread(samples, labels, kind, np.any(controls == ArcKind.SINGULAR, axis=0))
        rows.append(labels)
    return rows


def _commanded(samples: PhaseSamples, state: int, controls: KindArray, here: Mask) -> bool:
    """Whether a singular control enters the rate of a state."""
    columns = np.flatnonzero(here)
    j = columns[columns.size // 2]
    x, u = samples.x[:, j], samples.u[:, j]
    rate = samples.functions.rates(samples.times[j], x, u)[state]
    for channel in np.flatnonzero(controls[:, j] == ArcKind.SINGULAR):
        moved = u.copy()
        moved[channel] += PROBE * samples.control_scale[channel]
        if samples.functions.rates(samples.times[j], x, moved)[state] != rate:
            return True
    return False


def _at_limits(at_lower: Mask, at_upper: Mask) -> KindArray:
    return choose(at_lower, ArcKind.LOWER, choose(at_upper, ArcKind.UPPER, ArcKind.INTERIOR))


def _middles(samples: PhaseSamples, labels: KindArray) -> list[float]:
    """Times between samples of different labels."""
    jumps = np.flatnonzero(labels[1:] != labels[:-1])
    return [float(t) for t in 0.5 * (samples.times[jumps] + samples.times[jumps + 1])]


def _change_times(samples: PhaseSamples, i: int, labels: KindArray) -> list[float]:
    """Times at which a channel's label changes; sign changes of the switching function are polished."""
    changes = []
    for j in np.flatnonzero(labels[1:] != labels[:-1]):
        left, right = samples.times[j], samples.times[j + 1]
        polish = labels[j].at_limit and labels[j + 1].at_limit and right > left
        changes.append(root(switching(samples, i), left, right) if polish else 0.5 * (left + right))
    return changes


def root(function: Callable[[float], float], left: float, right: float) -> float:
    """Return a zero between left and right, or their middle where the signs do not differ."""
    if function(left) * function(right) >= 0:
        return 0.5 * (left + right)
    return crossing(function, left, right)


def crossing(function: Callable[[float], float], left: float, right: float) -> float:
    """Return a zero between two times (s) where the signs differ, to the last digits of a time."""
    return float(scipy.optimize.brentq(function, left, right, xtol=LAST_DIGITS * max(1.0, abs(right))))


def _labels_at(labels: KindArray, changes: list[float], times: Array) -> KindArray:
    """Labels of a channel at times that lie between its changes."""
    starts = np.concatenate([[0], np.flatnonzero(labels[1:] != labels[:-1]) + 1])
    return np.asarray(labels[starts][np.searchsorted(changes, times)])
