"""Table: A(t) and B(t) along a reference, interpolated to rounding between its jumps.

The Riccati equation asks for the linearization thousands of times. Between jumps it is smooth, so the Chebyshev
interpolant of a few dozen values, all computed at once, is as good as the function; where it is not (by comparison
halfway between its nodes), the piece is halved, and after some halvings the function itself is used.
"""

from __future__ import annotations

import itertools

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.control.deviation import Deviation
from gnc_opt.control.reference import Reference

_NODES = 20
_TOLERANCE = 1e-13
"""Of the interpolant, relative to the largest entry of A or B along the piece."""
_HALVINGS = 5

_ANGLES = (np.arange(_NODES) + 0.5) * np.pi / _NODES
_POINTS = -np.cos(_ANGLES)  # first kind: none on an edge, where the controls jump
_WEIGHTS = (-1.0) ** np.arange(_NODES) * np.sin(_ANGLES)
_CHECKS = np.concatenate([[-1 + 1e-6], 0.5 * (_POINTS[1:] + _POINTS[:-1]), [1 - 1e-6]])


class LinearizationTable:
    """A (n, n) and B (n, m) of the errors along a reference; on a jump, the values after it.

    Parameters
    ----------
    deviation : Deviation
    reference : Reference
    """

    def __init__(self, deviation: Deviation, reference: Reference) -> None:
        self.deviation, self.reference = deviation, reference
        start, end = reference.initial_time, reference.final_time
        edges = np.unique(np.clip(np.concatenate([[start, end], reference.jumps]), start, end))
        pieces = [
            p for left, right in itertools.pairwise(edges) for p in self._pieces(left, right, _HALVINGS)
        ]
        self._starts = np.array([left for left, _, _ in pieces])
        self._parts = pieces

    def __call__(self, t: float) -> tuple[Array, Array]:
        """Return A and B at one time t (s) on the reference."""
        k = int(np.searchsorted(self._starts, t, "right")) - 1
        left, right, values = self._parts[k] if k >= 0 else (t, t, None)
        if values is None or t > right:
            return self.deviation.linearize(t, self.reference.x(t), self.reference.u(t))
        return self._split(_interpolate(values, np.array([(2 * t - left - right) / (right - left)]))[0])

    def _split(self, flat: Array) -> tuple[Array, Array]:
        n = self.deviation.errors.size
        return flat[: n * n].reshape(n, n), flat[n * n :].reshape(n, -1)

    def _pieces(self, left: float, right: float, halvings: int) -> list[tuple[float, float, Array | None]]:
        middle, half = 0.5 * (left + right), 0.5 * (right - left)
        values = self._values(middle + half * _POINTS)
        off = np.abs(_interpolate(values, _CHECKS) - self._values(middle + half * _CHECKS)).max(axis=0)
        count = self.deviation.errors.size**2
        scales = [np.abs(part).max(initial=0.0) for part in (values[:, :count], values[:, count:])]
        bounds = np.repeat(scales, [count, values.shape[1] - count]) * _TOLERANCE
        if np.all(off <= bounds):
            return [(left, right, values)]
        if halvings == 0 or not np.all(np.isfinite(values)):
            return [(left, right, None)]
        return self._pieces(left, middle, halvings - 1) + self._pieces(middle, right, halvings - 1)

    def _values(self, times: Array) -> Array:
        a, b = self.deviation.linearize_many(times, self.reference.x(times), self.reference.u(times))
        return np.hstack([a.reshape(times.size, -1), b.reshape(times.size, -1)])


def _interpolate(values: Array, points: Array) -> Array:
    """Return the interpolant (n_points, n) of values (n_nodes, n) by the barycentric formula."""
    distance = points[:, None] - _POINTS
    hit = distance == 0
    terms = _WEIGHTS / np.where(hit, 1.0, distance)
    on_node = hit.any(axis=1)
    terms[on_node] = hit[on_node]
    return np.asarray((terms @ values) / terms.sum(axis=1, keepdims=True))
