"""Piecewise polynomials in time: continuous representation of a collocation solution, and its applied control."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array
from gnc_opt.array_types import Array, Indices, Mask
from gnc_opt.errors import ArgumentError, quote_value
from gnc_opt.numerical_tolerances import AT_LIMIT, ROUNDING, replace_zeros_by_one
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.transcription.quadrature import (
    MAX_POINTS,
    CollocationRule,
    build_differentiation_matrix,
    compute_barycentric_weights,
    interpolate_barycentric,
)

Side: TypeAlias = Literal["left", "right"]

MAX_NODES = 2 * MAX_POINTS

CACHED_BASES, CACHED_TIMES = 48, 4000
"""Size of the basis cache: number of sets and times per set; about 10 MB."""


def subdivide_intervals(edges: Array, parts: int) -> Array:
    """Return the edges of intervals (n + 1,) divided into equal parts (n * parts + 1,)."""
    return np.append(np.linspace(edges[:-1], edges[1:], parts, endpoint=False, axis=1), edges[-1])


@dataclass(frozen=True, eq=False)
class PiecewisePolynomial:
    """Vector function of time with one polynomial per segment; it may jump at the breaks.

    Arguments are copied and read-only: ``breaks`` (K + 1,), strictly increasing, s; ``nodes`` (m_k,) of each segment on
    [-1, 1], distinct, at most 128; ``values`` (n, m_k) there. Others raise ArgumentError.
    """

    breaks: Array
    nodes: tuple[Array, ...]
    values: tuple[Array, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "breaks", _make_read_only_copy(self.breaks))
        frozen = {id(x): _make_read_only_copy(x) for x in self.nodes}  # most segments share their nodes
        object.__setattr__(self, "nodes", tuple(frozen[id(x)] for x in self.nodes))
        object.__setattr__(self, "values", tuple(_make_read_only_copy(v) for v in self.values))
        vector = self.breaks.ndim == 1 and self.breaks.size > 1
        if not (vector and np.isfinite(self.breaks).all() and (np.diff(self.breaks) > 0).all()):
            raise ArgumentError(
                f"breaks must be at least two finite, strictly increasing times, got {self.breaks}"
            )
        _check_nodes_and_values(self.breaks.size - 1, self.nodes, self.values)

    def __call__(self, t: ArrayLike, side: Side = "right") -> Array:
        """Return the values at times t (s), (n,) for a scalar, (n, m) for an array; up to 1e-12 outside is clamped.

        ``side`` is the segment used at an interior break: the one that starts ("right") or ends there ("left"). Times
        outside the span or NaN, and unknown sides, raise ArgumentError.
        """
        if not isinstance(side, str) or side not in ("left", "right"):
            raise ArgumentError(
                f"the side of a segment boundary is {quote_value(side)}: give 'left' or 'right'."
            )
        times = self._clamp_times(np.atleast_1d(read_float_array(t, "the time")))
        result = np.empty((self.values[0].shape[0], times.size))
        build = _get_interpolation_bases if times.size <= CACHED_TIMES else _build_interpolation_bases
        for group, columns, segments, basis in build(*self._breaks_and_nodes, times.tobytes(), side):
            values = self._segment_values_by_node_group[group][:, :, segments]
            result[:, columns] = np.einsum("mnt,tm->nt", values, basis)
        return result if np.ndim(t) else result[:, 0]

    def evaluate_at_normalised_times(self, tau: ArrayLike) -> Array:
        """Return the values at ``tau`` on [-1, 1] of all segments: (n, K, len(tau))."""
        points = np.atleast_1d(read_float_array(tau, "the place"))
        result = np.empty((self.values[0].shape[0], len(self.nodes), points.size))
        groups = _group_segments_by_equal_nodes(self._breaks_and_nodes[1])
        groups_with_values = zip(groups, self._segment_values_by_node_group, strict=True)
        for (nodes, weights, positions), values in groups_with_values:
            basis = interpolate_barycentric(nodes, weights, points)
            result[:, positions >= 0] = np.tensordot(values, basis, axes=(0, 1))
        return result

    def derivative(self) -> PiecewisePolynomial:
        """Return the time derivative, on the same nodes; per second."""
        rates = 2.0 / np.diff(self.breaks)
        distinct = {id(x): x for x in self.nodes}
        matrices = {key: build_differentiation_matrix(x, x).T for key, x in distinct.items()}
        pieces = zip(self.nodes, self.values, rates, strict=True)
        values = tuple(rate * v @ matrices[id(x)] for x, v, rate in pieces)
        return PiecewisePolynomial(self.breaks, self.nodes, values)

    def _clamp_times(self, times: Array) -> Array:
        if times.ndim != 1:
            raise ArgumentError(f"the time has the shape {times.shape}: give a scalar or a vector.")
        first, last = self.breaks[0], self.breaks[-1]
        if times.size and times.min() >= first and times.max() <= last:
            return times
        slack = ROUNDING * max(abs(first), abs(last), last - first)
        outside = ~((times >= first - slack) & (times <= last + slack))  # also true for NaN
        if outside.any():
            raise ArgumentError(
                f"time {times[outside][0]} is outside the span {first} to {last} of the phase: "
                "choose a time within it."
            )
        return np.clip(times, first, last)

    @cached_property
    def _breaks_and_nodes(self) -> tuple[bytes, tuple[bytes, ...]]:
        """Breaks and nodes, shared by the signals of a solution."""
        return self.breaks.tobytes(), tuple(x.tobytes() for x in self.nodes)

    @cached_property
    def _segment_values_by_node_group(self) -> list[Array]:
        """Values (m, n, n_alike) of the segments in each group of equal nodes."""
        groups = [
            np.flatnonzero(positions >= 0)
            for _, _, positions in _group_segments_by_equal_nodes(self._breaks_and_nodes[1])
        ]
        return [np.stack([self.values[k].T for k in segments], axis=2) for segments in groups]


_LagrangeBasis: TypeAlias = tuple[int, Indices, Indices, Array]
"""Times in one group of segments: the group, their indices, the index of each segment in the group, the basis."""


@lru_cache(maxsize=CACHED_BASES)
def _group_segments_by_equal_nodes(nodes: tuple[bytes, ...]) -> tuple[tuple[Array, Array, Indices], ...]:
    """Return nodes, their barycentric weights, and the index of each segment in each group of equal nodes, else -1."""
    groups: dict[bytes, list[int]] = {}
    for k, x in enumerate(nodes):
        groups.setdefault(x, []).append(k)
    node_groups = []
    for x, segments in groups.items():
        positions = np.full(len(nodes), -1)
        positions[segments] = np.arange(len(segments))
        node_groups.append((np.frombuffer(x), compute_barycentric_weights(np.frombuffer(x)), positions))
    return tuple(node_groups)


def _build_interpolation_bases(
    breaks: bytes, nodes: tuple[bytes, ...], sample_times: bytes, side: Side
) -> tuple[_LagrangeBasis, ...]:
    """Return the bases at times within the interval, by group."""
    edges, times, bases = np.frombuffer(breaks), np.frombuffer(sample_times), []
    segment = edges[1:-1].searchsorted(times, side)
    initial, final = edges[segment], edges[segment + 1]
    tau = ((times - initial) - (final - times)) / (final - initial)
    for group, (group_nodes, weights, positions) in enumerate(_group_segments_by_equal_nodes(nodes)):
        columns = np.flatnonzero(positions[segment] >= 0)
        if columns.size:
            basis = interpolate_barycentric(group_nodes, weights, tau[columns])
            bases.append((group, columns, positions[segment][columns], basis))
    return tuple(bases)


_get_interpolation_bases = lru_cache(maxsize=CACHED_BASES)(_build_interpolation_bases)


def _check_nodes_and_values(count: int, nodes: tuple[Array, ...], values: tuple[Array, ...]) -> None:
    if not count == len(nodes) == len(values):
        raise ArgumentError(f"{count} segments, but {len(nodes)} sets of nodes and {len(values)} of values")
    checked: set[tuple[tuple[int, ...], bytes]] = set()  # most segments have equal nodes
    for k, (x, v) in enumerate(zip(nodes, values, strict=True)):
        key = (x.shape, x.tobytes())
        vector = x.ndim == 1 and 1 <= x.size <= MAX_NODES
        if key not in checked and not (vector and (abs(x) <= 1).all() and np.unique(x).size == x.size):
            raise ArgumentError(f"segment {k}: need 1 to {MAX_NODES} distinct nodes in [-1, 1], got {x}")
        checked.add(key)
        if v.ndim != 2 or v.shape != (len(values[0]), x.size):
            raise ArgumentError(
                f"segment {k}: values have shape {v.shape}, need (components, {x.size}) throughout"
            )


def _make_read_only_copy(values: ArrayLike) -> Array:
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


_SATURATION_TIMES = np.linspace(-1.0, 1.0, 33)


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
        values, bounds = self.polynomial.evaluate_at_normalised_times(_SATURATION_TIMES), self.bounds
        sizes = np.where(bounds.is_fixed, np.abs(bounds.upper), bounds.interval_width_or_zero)
        width = replace_zeros_by_one(sizes)
        over = np.max(values, axis=2) - bounds.upper[:, None] > AT_LIMIT * width[:, None]
        under = bounds.lower[:, None] - np.min(values, axis=2) > AT_LIMIT * width[:, None]
        return np.asarray(over | under)

    @cached_property
    def _quadrature_cell_edges(self) -> tuple[Array, ...]:
        """Cell edges of each segment (n_k + 1,), s."""
        edges = []
        for k, rule in enumerate(self.rules):
            left, right = self.polynomial.breaks[k], self.polynomial.breaks[k + 1]
            fractions = np.concatenate([[0.0], np.cumsum(rule.weights)]) / 2.0
            edges.append(left + (right - left) * fractions)
        return tuple(edges)

    @cached_property
    def jump_times(self) -> Array:
        """Times of possible discontinuities, including the ends, in ascending order."""
        constant = np.flatnonzero(self.is_piecewise_constant.any(axis=0))
        cells = [self._quadrature_cell_edges[k] for k in constant]
        return np.unique(np.concatenate([self.polynomial.breaks, *cells]))

    def evaluate_clipped_polynomial(self, t: ArrayLike, side: Side = "right") -> Array:
        """Return the polynomial clipped to the bounds; for guesses, not for propagation."""
        values = self.polynomial(t, side)
        lower, upper = (b if values.ndim == 1 else b[:, None] for b in (self.bounds.lower, self.bounds.upper))
        return np.minimum(np.maximum(values, lower), upper)

    def __call__(self, t: ArrayLike, side: Side = "right") -> Array:
        """Return the values at times t (s): shape (m,) for a scalar, (m, n_times) for an array."""
        times = np.atleast_1d(read_float_array(t, "the time"))
        values = self.evaluate_clipped_polynomial(times, side)
        segment = self.polynomial.breaks[1:-1].searchsorted(times, side)
        for k in np.unique(segment[np.any(self.is_piecewise_constant, axis=0)[segment]]):
            channels, columns = np.flatnonzero(self.is_piecewise_constant[:, k]), np.flatnonzero(segment == k)
            cell = np.searchsorted(self._quadrature_cell_edges[k], times[columns], side) - 1
            cell = np.clip(cell, 0, self.rules[k].n - 1)
            nodal = np.clip(self.polynomial.values[k], self.bounds.lower[:, None], self.bounds.upper[:, None])
            values[np.ix_(channels, columns)] = nodal[np.ix_(channels, cell)]
        return values if np.ndim(t) else values[:, 0]
