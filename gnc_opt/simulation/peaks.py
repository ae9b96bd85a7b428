"""Peaks: the largest values of rows between nodes with slopes, by looking closely where it pays.

Branch and bound: an interval in which no row can be larger than what has been found is left alone; of the others those
that promise most are cut into parts. What an interval promises is where the tangents of its ends meet, which a concave
row does not exceed, or the peak of the cubic through its ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gnc_opt.arrays import Array

FINE = 1e-9
"""How far a peak may be above what is found, relative to max(1, |y|)."""

AT_ONCE = 8
"""Intervals that are looked at together."""

_ROUNDS = 2000
"""For what has no end, as slopes that are infinite."""

_SHORTEST = 1e-7
"""Of a control step: what a switch hides in less is not looked for."""


@dataclass(frozen=True)
class Nodes:
    """Rows at times of n pieces of a way.

    Attributes
    ----------
    s : array (n_nodes, n)
        Times.
    z, slope : array (n_rows, n_nodes, n)
    switch, switch_slope : array (n_switches, n_nodes, n)
        What the rows bend or jump at zero of.
    """

    s: Array
    z: Array
    slope: Array
    switch: Array
    switch_slope: Array

    def some(self, count: int) -> Nodes:
        """Return those of the first pieces."""
        return Nodes(*(array[..., :count] for array in vars(self).values()))

    def promise(self) -> Array:
        """Return what the rows do not exceed between neighbouring nodes, (n_rows, n_nodes - 1, n).

        If they are concave there or cubics: minus infinity where these say that the ends are the largest. Where one
        switch is of another sign at the other end, what their slopes could lead to; where several are, or one may be
        meanwhile, infinity.
        """
        length = np.diff(self.s, axis=0)
        z, slope, switch, tilt = (
            (array[:, :-1], array[:, 1:]) for array in (self.z, self.slope, self.switch, self.switch_slope)
        )
        found = _highest(length, z[0], slope[0], z[1], slope[1])
        if len(self.switch):
            turns = np.sum(np.sign(switch[0]) != np.sign(switch[1]), axis=0)
            with np.errstate(invalid="ignore"):  # slopes may be none where rows are numbers
                leads = np.maximum(*(a + length * np.abs(b) for a, b in zip(z, slope, strict=True)))
            found = np.where(turns > 0, np.fmax(found, leads), found)
            hidden = turns > 1
            for sign in (1.0, -1.0):
                side = [sign * array for array in (switch[0], tilt[0], switch[1], tilt[1])]
                below = (side[0] < 0) & (side[2] < 0)
                hidden |= np.any(below & (_highest(length, *side) > 0), axis=0)
            found = np.where(hidden & (length > _SHORTEST * self.s.max()), np.inf, found)
        return np.where(length > 0, found, -np.inf)

    def integrals(self) -> Array:
        """Return the integrals over time of the cubics between the nodes, (n_rows, n_nodes - 1, n)."""
        length = np.diff(self.s, axis=0)
        with np.errstate(invalid="ignore"):
            bend = self.slope[:, :-1] - self.slope[:, 1:]
        bend = np.where(np.isfinite(bend), bend, 0.0)  # slopes may be none where rows are numbers
        return np.asarray(0.5 * length * (self.z[:, :-1] + self.z[:, 1:]) + length**2 / 12 * bend)


def _highest(length: Array, z0: Array, slope0: Array, z1: Array, slope1: Array) -> Array:
    """Return the height at which the tangents of both ends meet, or of the cubic's peak; minus infinity if neither is
    between."""
    with np.errstate(all="ignore"):
        a, b, rise = length * slope0, length * slope1, z1 - z0
        meet = np.where((a > 0) & (b < 0), z0 + a * np.clip((rise - b) / (a - b), 0.0, 1.0), -np.inf)
        # z0 + a nu + c nu^2 + d nu^3; its peak by the root of the derivative without cancellation
        c, d = 3 * rise - 2 * a - b, a + b - 2 * rise
        nu = a / (np.sqrt(c**2 - 3 * d * a) - c)
        peak = np.where((nu > 0) & (nu < 1), z0 + nu * (a + nu * (c + nu * d)), -np.inf)
        return np.asarray(np.fmax(meet, peak))


@dataclass(frozen=True)
class Intervals:
    """Intervals of pieces of a way.

    Attributes
    ----------
    piece : int array (n,)
    first, last : array (n,)
        s.
    promise, integral : array (n_rows, n)
        What the rows do not exceed there, and their integrals over time.
    """

    piece: Any
    first: Array
    last: Array
    promise: Array
    integral: Array

    @classmethod
    def of(cls, piece: Any, nodes: Nodes) -> Intervals:
        """Return those between the nodes of pieces of such numbers (n,)."""
        first, last, count = nodes.s[:-1], nodes.s[1:], len(nodes.z)
        place = np.broadcast_to(piece, first.shape)
        rows = (array.reshape(count, -1) for array in (nodes.promise(), nodes.integrals()))
        return cls(place.ravel(), first.ravel(), last.ravel(), *rows)

    def some(self, which: Any) -> Intervals:
        """Return some of them."""
        return Intervals(*(array[..., which] for array in vars(self).values()))

    def and_(self, others: Intervals) -> Intervals:
        """Return them with others."""
        both = zip(vars(self).values(), vars(others).values(), strict=True)
        return Intervals(*(np.concatenate(pair, axis=-1) for pair in both))


def climb(best: Array, nodes: Nodes, look: Callable[[Intervals], Nodes]) -> tuple[Array, Array]:
    """Return the largest values of rows and their integrals over time, (n_rows,).

    Parameters
    ----------
    best : array (n_rows,)
        The largest found elsewhere.
    nodes : Nodes
    look : callable
        Returns the nodes in `AT_ONCE` intervals.
    """
    intervals = Intervals.of(np.arange(nodes.s.shape[1]), nodes)
    best, total = np.maximum(best, nodes.z.max(axis=(1, 2))), intervals.integral.sum(axis=1)
    for _ in range(_ROUNDS):
        size = np.maximum(1.0, np.abs(best))[:, None]
        more = np.max((intervals.promise - best[:, None]) / size, axis=0, initial=-np.inf)
        intervals, more = intervals.some(more > FINE), more[more > FINE]
        if not more.size:
            break
        order = np.argsort(-more, kind="stable")
        closer = intervals.some(order[:AT_ONCE])
        found = look(intervals.some(np.resize(order[:AT_ONCE], AT_ONCE))).some(closer.piece.size)
        parts = Intervals.of(closer.piece, found)
        best = np.fmax(best, found.z.max(axis=(1, 2)))
        total += parts.integral.sum(axis=1) - closer.integral.sum(axis=1)
        intervals = intervals.some(order[AT_ONCE:]).and_(parts)
    return best, total
