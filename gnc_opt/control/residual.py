"""Residual of a reference: how far its states are from moving as its model says under its controls."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.polynomial.legendre import leggauss

from gnc_opt.arrays import Array
from gnc_opt.model.model import Model

Signal: TypeAlias = Callable[[Array], Array]
"""Of times (n,), columns (size, n)."""

_TIMES = 24
"""Times at which a reference is looked at, spread over its pieces."""
_SPREAD = 0.618
"""They are multiples of this, modulo one: regular to no period."""
_STEPS = (1e-3, 1e-4, 1e-5)
"""Steps over which states are compared, relative to the piece: the shortest resolve what changes fast."""
_NODES = 4
_ROUNDED = 8 * np.finfo(float).eps
_TOLERANCE = 1e-3
"""Share of the terms of a rate by which it may be off: more is told."""


def residual(model: Model, x: Signal, u: Signal, edges: Array) -> str:
    """Return which state is furthest from obeying the model, when and by how much; "" where all do.

    At some times between ``edges`` (s), which no jump may lie between, the change of the states over short steps is
    compared with the integral of f(t, x, u) over them. What several lengths of steps agree upon is the residual. It
    counts relative to the terms that a rate is made of: itself and the sums of ``|df/dx| |x|`` and ``|df/du| |u|``.
    """
    times, longest = _looked_at(edges)
    left = np.min([_defect(model, x, u, times, share * longest) for share in _STEPS], axis=0)
    return _told(model, times, left, x(times), u(times))


def _looked_at(edges: Array) -> tuple[Array, Array]:
    """Return times between the edges, and the lengths of the pieces that they lie in (s)."""
    lengths = np.diff(edges)
    pieces = np.unique(np.linspace(0, lengths.size - 1, _TIMES).astype(int))
    each = -(-_TIMES // pieces.size)
    share = 0.99 * (np.arange(1, each + 1) * _SPREAD % 1.0)  # the longest step ends within the piece
    times = edges[pieces, None] + lengths[pieces, None] * share
    return times.ravel(), np.repeat(lengths[pieces], each)


def _defect(model: Model, x: Signal, u: Signal, times: Array, h: Array) -> Array:
    """Return the mean of |dx/dt - f| over steps of h (s), less what rounding of the states may do to it."""
    nodes, weights = leggauss(_NODES)
    inner = (times[:, None] + 0.5 * h[:, None] * (1 + nodes)).ravel()
    rates = model.f(inner, x(inner), u(inner)).reshape(model.states.size, times.size, _NODES)
    first, last = x(times), x(times + h)
    off = np.abs((last - first) / h - 0.5 * rates @ weights)
    return np.asarray(np.maximum(off - _ROUNDED * (np.abs(first) + np.abs(last)) / h, 0.0))


def _told(model: Model, times: Array, left: Array, x: Array, u: Array) -> str:
    terms = np.abs(model.f(times, x, u)) + left
    for j, t in enumerate(times):
        a, b = model.linearize(float(t), x[:, j], u[:, j])
        terms[:, j] += np.abs(a) @ np.abs(x[:, j]) + np.abs(b) @ np.abs(u[:, j])
    scale = np.max(terms, axis=1, keepdims=True)
    share = np.nan_to_num(left / np.where(scale > 0, scale, 1.0))
    i, k = np.unravel_index(int(np.argmax(share)), share.shape)
    if not share[i, k] > _TOLERANCE:
        return ""
    per_second = f"{model.states.units[i]} per second".strip()
    return (
        f"'{model.states.labels[i]}' moves by {left[i, k]:.3g} {per_second} otherwise than the model says at t = "
        f"{times[k]:.4g} s, {100 * share[i, k]:.3g} % of what its rate is made of"
    )
