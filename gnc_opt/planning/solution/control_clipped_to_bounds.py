"""Applied (saturated) control: control signal within its bounds, also between nodes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_array
from gnc_opt.array_types import Array, Mask
from gnc_opt.numerical_tolerances import AT_LIMIT, floor_magnitudes
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial, Side
from gnc_opt.planning.transcription.quadrature import CollocationRule

_SATURATION_SAMPLES = 33


@dataclass(frozen=True, eq=False)
class SaturatedControl:
    """Control signal within its bounds; ``rules``: collocation rule of each segment, with the nodes of the polynomial.

    If the collocation polynomial of a channel stays within its bounds over a segment, it is used unchanged. If it
    overshoots (as at bang-bang nodes), the value of each node is constant over a cell as long as the quadrature weight
    of the node: within the bounds, and with the same impulse as the polynomial.
    """

    polynomial: PiecewisePolynomial
    bounds: Interval
    rules: tuple[CollocationRule, ...]

    @cached_property
    def is_piecewise_constant(self) -> Mask:
        """Whether each channel is piecewise constant in each segment, shape (m, K): beyond bounds by `AT_LIMIT`."""
        values = self.polynomial.evaluate_in_segments(np.linspace(-1.0, 1.0, _SATURATION_SAMPLES))
        slack = AT_LIMIT * _compute_bound_ranges(self.bounds)
        over = np.max(values, axis=2) - self.bounds.upper[:, None] > slack[:, None]
        under = self.bounds.lower[:, None] - np.min(values, axis=2) > slack[:, None]
        return np.asarray(over | under)

    @cached_property
    def _quadrature_cell_edges(self) -> tuple[Array, ...]:
        """Cell edges of each segment (n_k + 1,), s."""
        edges = []
        for k, rule in enumerate(self.rules):
            left, right = self.polynomial.breaks[k], self.polynomial.breaks[k + 1]
            shares = np.concatenate([[0.0], np.cumsum(rule.weights)]) / 2.0
            edges.append(left + (right - left) * shares)
        return tuple(edges)

    @cached_property
    def jump_times(self) -> Array:
        """Times of possible discontinuities, including the ends, in ascending order."""
        pieces = [self.polynomial.breaks]
        pieces += [
            self._quadrature_cell_edges[k] for k in np.flatnonzero(self.is_piecewise_constant.any(axis=0))
        ]
        return np.unique(np.concatenate(pieces))

    def evaluate_clipped_polynomial(self, t: ArrayLike, side: Side = "right") -> Array:
        """Return the polynomial clipped to the bounds; for guesses, not for propagation."""
        values = self.polynomial(t, side)
        lower, upper = (b if values.ndim == 1 else b[:, None] for b in (self.bounds.lower, self.bounds.upper))
        return np.minimum(np.maximum(values, lower), upper)

    def __call__(self, t: ArrayLike, side: Side = "right") -> Array:
        """Return the values at times t (s): shape (m,) for a scalar, (m, n_times) for an array."""
        times = np.atleast_1d(read_array(t, "the time"))
        values = self.evaluate_clipped_polynomial(times, side)
        segment = self.polynomial.breaks[1:-1].searchsorted(times, side)
        for k in np.unique(segment[np.any(self.is_piecewise_constant, axis=0)[segment]]):
            channels, here = np.flatnonzero(self.is_piecewise_constant[:, k]), np.flatnonzero(segment == k)
            cell = np.searchsorted(self._quadrature_cell_edges[k], times[here], side) - 1
            cell = np.clip(cell, 0, self.rules[k].n - 1)
            nodal = np.clip(self.polynomial.values[k], self.bounds.lower[:, None], self.bounds.upper[:, None])
            values[np.ix_(channels, here)] = nodal[np.ix_(channels, cell)]
        return values if np.ndim(t) else values[:, 0]


def _compute_bound_ranges(bounds: Interval) -> Array:
    """Return the ranges of bounds; for fixed controls their magnitude; 1 if both are zero or infinite."""
    span = bounds.upper - bounds.lower
    fixed = floor_magnitudes(np.where(bounds.is_fixed, np.abs(bounds.upper), 0.0))
    return np.where(np.isfinite(span) & ~bounds.is_fixed, span, fixed)
