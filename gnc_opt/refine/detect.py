"""Recognising the control structure from controls and switching functions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from gnc_opt.model.layout import Array
from gnc_opt.refine.structure import PhaseStructure, Signs, merged
from gnc_opt.verify.samples import PhaseSamples

NEAR = 0.02
"""A control this close to a bound, relative to its range, is taken to sit on it."""

SMALL = 2e-2
"""A switching function this small over whole segments, in shares of H, marks a singular arc."""


def detect(samples: PhaseSamples) -> PhaseStructure:
    """Return the structure of a phase.

    Controls that enter H linearly follow the sign of their switching function, except where it stays near
    zero over whole segments with the control between its bounds (a singular arc, or one on a state
    constraint). Other controls are judged by their nearness to the bounds.
    """
    rows, changes = [], set()
    for i in range(samples.leg.controls.size):
        labels = _linear_labels(samples, i) if affine_channels(samples)[i] else _nonlinear_labels(samples, i)
        rows.append(labels)
        changes |= set(_change_times(samples, i, labels))
    first, last = samples.leg.breaks[0], samples.leg.breaks[-1]
    times = [first, *sorted(t for t in changes if first < t < last), last]
    middles = 0.5 * (np.asarray(times[1:]) + np.asarray(times[:-1]))
    signs = np.stack([_labels_at(samples, i, row, middles) for i, row in enumerate(rows)])
    return merged(tuple(float(t) for t in times), tuple(tuple(int(v) for v in column) for column in signs.T))


def affine_channels(samples: PhaseSamples) -> NDArray[np.bool_]:
    """Return which controls enter H linearly and have two finite bounds, (m,)."""
    hessians = samples.functions.control_hessian(samples.times, samples.x, samples.u, samples.lam, samples.mu)
    scale = samples.control_scale
    curvature = np.abs(np.einsum("iij->ij", hessians)) * scale[:, None] ** 2 / samples.hamiltonian_scale
    bounds = samples.leg.control_bounds
    bounded = np.isfinite(bounds.lower) & np.isfinite(bounds.upper)
    return np.asarray((np.max(curvature, axis=1, initial=0.0) < 1e-9) & bounded)


def switching(samples: PhaseSamples, i: int) -> Callable[[float], float]:
    """Return dH/du of channel i as a function of one time."""
    leg, functions = samples.leg, samples.functions

    def value(t: float) -> float:
        mu = leg.path_multiplier(t) if leg.path_labels else np.zeros(0)
        return float(functions.control_gradient(t, leg.x(t), leg.flown(t), leg.lam(t), mu)[i])

    return value


def _linear_labels(samples: PhaseSamples, i: int) -> Signs:
    """-1, +1 or 2 (singular) at each sample for a control that enters H linearly."""
    gradient = samples.control_gradient[i] * samples.control_scale[i] / samples.hamiltonian_scale
    labels = np.where(gradient > 0, -1, 1)
    for k in _singular_segments(samples, i, gradient):
        labels[samples.segments == k] = 2
    return labels


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


def _nonlinear_labels(samples: PhaseSamples, i: int) -> Signs:
    bounds, margin = samples.leg.control_bounds, 1e-3 * samples.control_scale[i]
    gradient = samples.control_gradient[i]
    at_lower = (samples.u[i] < bounds.lower[i] + margin) & (gradient > 0)
    at_upper = (samples.u[i] > bounds.upper[i] - margin) & (gradient < 0)
    return np.where(at_lower, -1, np.where(at_upper, 1, 0))


def _change_times(samples: PhaseSamples, i: int, labels: Signs) -> list[float]:
    """Times at which a channel's label changes; sign changes of the switching function are polished."""
    changes = []
    for j in np.flatnonzero(labels[1:] != labels[:-1]):
        left, right = samples.times[j], samples.times[j + 1]
        polish = labels[j] * labels[j + 1] == -1 and right > left
        changes.append(root(switching(samples, i), left, right) if polish else 0.5 * (left + right))
    return changes


def root(function: Callable[[float], float], left: float, right: float) -> float:
    """Return a zero between left and right, or their middle where the signs do not differ."""
    if function(left) * function(right) >= 0:
        return 0.5 * (left + right)
    return float(brentq(function, left, right, xtol=1e-14 * max(1.0, abs(right))))


def _labels_at(samples: PhaseSamples, i: int, labels: Signs, times: Array) -> Signs:
    """Labels of a channel at times that lie between its changes."""
    changes = np.asarray(_change_times(samples, i, labels))
    starts = np.concatenate([[0], np.flatnonzero(labels[1:] != labels[:-1]) + 1])
    return labels[starts][np.searchsorted(changes, times)] if changes.size else np.full(times.size, labels[0])
