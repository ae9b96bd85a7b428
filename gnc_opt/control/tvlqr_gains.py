"""Gains of the time-varying regulator: the Riccati equation (`gnc_opt.control.tvlqr`) backward along a reference.

A(t) and B(t) are interpolated between jumps by Chebyshev polynomials to rounding; pieces on which that fails are halved
and in the end evaluated directly.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy

from gnc_opt.arguments import read_positive
from gnc_opt.arrays import Array
from gnc_opt.control.error_dynamics import ErrorDynamics
from gnc_opt.control.quadratic_cost import QuadraticCost, Weight, read_weight, require_semidefinite
from gnc_opt.control.reference import Reference
from gnc_opt.control.riccati import Steady, gain_of, steady
from gnc_opt.control.sampled_data import SampledStep, sample, sample_along
from gnc_opt.errors import DesignError
from gnc_opt.tolerances import ROUNDING, SAME_TIME, STEP_SLACK, TINY

_NODES = 20
_INTERPOLATION_TOLERANCE = 1e-13
"""Of the interpolant, relative to the largest entry of A or B along the piece."""
_GAIN_GRID_HALVINGS = 5

_ANGLES = (np.arange(_NODES) + 0.5) * np.pi / _NODES
_POINTS = -np.cos(_ANGLES)  # first kind: none on an edge, where the controls jump
_WEIGHTS = (-1.0) ** np.arange(_NODES) * np.sin(_ANGLES)
_CHECKS = np.concatenate([[-1 + 1e-6], 0.5 * (_POINTS[1:] + _POINTS[:-1]), [1 - 1e-6]])


class LinearizationTable:
    """A (n, n) and B (n, m) of the errors along a reference; on a jump, the values after it."""

    def __init__(self, deviation: ErrorDynamics, reference: Reference) -> None:
        self.deviation, self.reference = deviation, reference
        start, end = reference.initial_time, reference.final_time
        edges = np.unique(np.clip(np.concatenate([[start, end], reference.jumps]), start, end))
        pieces = [
            p
            for left, right in itertools.pairwise(edges)
            for p in self._pieces(left, right, _GAIN_GRID_HALVINGS)
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
        bounds = np.repeat(scales, [count, values.shape[1] - count]) * _INTERPOLATION_TOLERANCE
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


class Gains(Protocol):
    """Gains and costs to go of a tracking law at any time; ``tail`` is K after the end."""

    @property
    def tail(self) -> Array: ...

    @property
    def steady(self) -> Steady | None: ...

    def K(self, t: float) -> Array:
        """Return K (n_controls, n_errors) in ``u = u_ff - K e`` at t (s)."""

    def P(self, t: float) -> Array:
        """Return P (n_errors, n_errors) at t (s): ``e' P e`` is the cost to go."""


@dataclass(frozen=True, eq=False)
class ContinuousGains:
    """Gains from the Riccati equation; see `Gains`."""

    reference: Reference
    deviation: ErrorDynamics
    table: LinearizationTable
    r: Array
    n: Array
    pieces: tuple[tuple[float, float, Callable[[float], Array]], ...]
    """From, to, and P as a dense function of time; first piece first."""
    terminal: Array
    tail: Array
    steady: Steady | None

    def P(self, t: float) -> Array:
        """See `Gains`."""
        if t >= self.reference.final_time or not self.pieces:
            return (
                self.steady.cost
                if self.steady is not None and t > self.reference.final_time
                else self.terminal
            )
        starts = [piece[0] for piece in self.pieces]
        k = max(int(np.searchsorted(starts, t, "right")) - 1, 0)
        return _unpacked(self.pieces[k][2](max(t, starts[0])), self.terminal.shape[0])

    def K(self, t: float) -> Array:
        """See `Gains`."""
        if t >= self.reference.final_time:
            return self.tail
        b = self.table(t)[1]
        return gain_of(np.zeros_like(self.terminal), b, self.r, self.n, self.P(t), sampled=False)


@dataclass(frozen=True, eq=False)
class SampledGains:
    """Gains of the discrete recursion, at the steps of dt (s) from the reference's beginning; see `Gains`."""

    initial_time: float
    dt: float
    steps: tuple[SampledStep, ...]
    """Plant and cost over each step; the steps after the end are all like the last."""
    gains: tuple[Array, ...]
    costs: tuple[Array, ...]
    """P at the beginning of each step and after the last."""
    tail: Array
    steady: Steady | None

    def index(self, t: float) -> int:
        """Return the number of the step that t lies in."""
        return max(int(np.floor((t - self.initial_time) / self.dt + STEP_SLACK)), 0)

    def P(self, t: float) -> Array:
        """See `Gains`."""
        k = self.index(t)
        if k > len(self.gains) and self.steady is not None:
            return self.steady.cost
        return self.costs[min(k, len(self.gains))]

    def K(self, t: float) -> Array:
        """See `Gains`."""
        k = self.index(t)
        return self.gains[k] if k < len(self.gains) else self.tail


def riccati_gains(
    deviation: ErrorDynamics,
    reference: Reference,
    cost: QuadraticCost,
    *,
    terminal: Weight | None = None,
    dt: float | None = None,
) -> ContinuousGains | SampledGains:
    """Return the gains along a reference, continuous or (with dt, s) sampled."""
    end = None if terminal is None else _terminal(terminal, deviation)
    if dt is not None:
        return _sampled(deviation, reference, cost, end, read_positive(dt, "the control step dt"))
    t_f = reference.final_time
    a, b = deviation.linearize(t_f, reference.x(t_f), resting_control(reference))
    regulator = _tail_regulator((a, b), cost, deviation, end, sampled=False)
    last = regulator.cost if end is None and regulator is not None else end
    assert last is not None
    tail = regulator.gain if regulator is not None else gain_of(a, b, cost.r, cost.n, last, sampled=False)
    table = LinearizationTable(deviation, reference)
    pieces = _integrate(table, reference, cost, last)
    return ContinuousGains(reference, deviation, table, cost.r, cost.n, pieces, last, tail, regulator)


def _terminal(terminal: Weight, deviation: ErrorDynamics) -> Array:
    weight = read_weight(terminal, deviation.errors, "the terminal weight")
    require_semidefinite(weight, deviation.errors.labels, "the terminal weight")
    return weight


def resting_control(reference: Reference) -> Array:
    """Return the control after the end of the reference, or at its end if there is no after."""
    tail = reference.tail_control
    return reference.u(reference.final_time) if tail is None else tail


def _tail_regulator(
    plant: tuple[Array, Array],
    cost: QuadraticCost,
    deviation: ErrorDynamics,
    end: Array | None,
    *,
    sampled: bool,
) -> Steady | None:
    """The steady regulator after the end; with a terminal weight the design can do without one."""
    try:
        return steady(*plant, *cost, deviation.errors.labels, sampled=sampled)
    except DesignError as error:
        if end is None:
            told = str(error).rstrip(".")
            raise DesignError(f"after the end of the reference {told}; or give a terminal weight.") from error
        return None


def _integrate(
    linearize: LinearizationTable, reference: Reference, cost: QuadraticCost, last: Array
) -> tuple[tuple[float, float, Callable[[float], Array]], ...]:
    q, r, n = cost
    size = last.shape[0]
    inverse = np.linalg.inv(r)
    start, end = reference.initial_time, reference.final_time
    if end <= start:
        return ()
    edges = np.unique(np.clip(np.concatenate([[start, end], reference.jumps]), start, end))
    edges = edges[np.append(True, np.diff(edges) > ROUNDING * (end - start))]
    edges[-1] = end
    packed, pieces = _packed(last), []
    for left, right in reversed(list(itertools.pairwise(edges))):
        nudge = SAME_TIME * (right - left)

        def slope(t: float, y: Array, low: float = left + nudge, high: float = right - nudge) -> Array:
            a, b = linearize(min(max(t, low), high))  # this side of the jumps
            p = _unpacked(y, size)
            half = b.T @ p + n.T
            flow = a.T @ p
            return -_packed(flow + flow.T - half.T @ inverse @ half + q)

        scale = max(float(np.max(np.abs(packed))), TINY)
        found = scipy.integrate.solve_ivp(
            slope, (right, left), packed, method="DOP853", rtol=1e-11, atol=1e-13 * scale, dense_output=True
        )
        if not found.success or not np.all(np.isfinite(found.y[:, -1])):
            raise DesignError(
                f"the Riccati equation cannot be continued before {found.t[-1]:.6g} s ({found.message}): weigh errors "
                "less or controls more."
            )
        pieces.append((float(left), float(right), found.sol))
        packed = found.y[:, -1]
    return tuple(reversed(pieces))


def _sampled(
    deviation: ErrorDynamics, reference: Reference, cost: QuadraticCost, end: Array | None, dt: float
) -> SampledGains:
    t_0, t_f = reference.initial_time, reference.final_time
    a, b = deviation.linearize(t_f, reference.x(t_f), resting_control(reference))
    resting = sample(a, b, *cost, dt)
    regulator = _tail_regulator(
        (resting.a, resting.b), QuadraticCost(resting.q, resting.r, resting.n), deviation, end, sampled=True
    )
    p = regulator.cost if end is None and regulator is not None else end
    assert p is not None
    count = int(np.ceil((t_f - t_0) / dt - STEP_SLACK))
    table = LinearizationTable(deviation, reference)

    def linearize(t: float) -> tuple[Array, Array]:
        return (a, b) if t > t_f else table(t)

    steps = [
        sample_along(linearize, *cost, t_0 + k * dt, dt, np.append(reference.jumps, t_f))
        for k in range(count)
    ]
    gains, costs = [], [p]
    for step in reversed(steps):
        gain = gain_of(step.a, step.b, step.r, step.n, p, sampled=True)
        half = step.b.T @ p @ step.a + step.n.T
        p = step.q + step.a.T @ p @ step.a - half.T @ gain
        p = 0.5 * (p + p.T)
        gains.append(gain)
        costs.append(p)
    tail = (
        regulator.gain if regulator is not None else gains[0] if gains else np.zeros((b.shape[1], a.shape[0]))
    )
    ordered = tuple(reversed(gains)), tuple(reversed(costs))
    return SampledGains(t_0, dt, (*steps, resting), *ordered, tail, regulator)


def _packed(p: Array) -> Array:
    return np.asarray(p[np.triu_indices(p.shape[0])])


def _unpacked(packed: Array, size: int) -> Array:
    p = np.zeros((size, size))
    p[np.triu_indices(size)] = packed
    return p + np.triu(p, 1).T
