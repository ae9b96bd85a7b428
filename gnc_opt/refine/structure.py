"""Control structure: which control sits on which bound when."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gnc_opt.model.layout import Array
from gnc_opt.solution.arc import Arc, ArcKind

Signs = NDArray[np.int64]


@dataclass(frozen=True)
class PhaseStructure:
    """The switches of all controls of a phase in one order.

    Attributes
    ----------
    times : tuple of float
        Start, every switch in order, end; A + 1 of them, in s.
    signs : tuple of A tuples of int
        For each piece between neighbouring times the place of every control: -1 on its lower bound, +1 on its
        upper bound, 0 wherever it likes, 2 between its bounds though it enters H linearly (singular).
    """

    times: tuple[float, ...]
    signs: tuple[tuple[int, ...], ...]

    @property
    def pieces(self) -> int:
        """Number of pieces A."""
        return len(self.signs)

    @property
    def lengths(self) -> Array:
        """Length of each piece (A,), s."""
        return np.diff(np.asarray(self.times))

    def matrix(self) -> Signs:
        """Signs as an int array (n_controls, A)."""
        return np.asarray(self.signs, dtype=np.int64).T

    def at(self, times: tuple[float, ...]) -> PhaseStructure:
        """Return the same order of switches at other times."""
        return replace(self, times=times)

    def without(self, piece: int) -> PhaseStructure:
        """Return the structure after a piece has vanished; switches that cancel vanish with it."""
        middle = 0.5 * (self.times[piece] + self.times[piece + 1])
        inner = 0 < piece < self.pieces - 1
        times = [*self.times[:piece], *([middle] if inner else []), *self.times[piece + 2 :]]
        if piece == 0:
            times = [self.times[0], *self.times[2:]]
        elif piece == self.pieces - 1:
            times = [*self.times[:-2], self.times[-1]]
        return merged(tuple(times), (*self.signs[:piece], *self.signs[piece + 1 :]))

    def swapped(self, piece: int) -> PhaseStructure | None:
        """Return the structure in which the switches at the two ends of a piece change places.

        ``None`` where there is nothing to swap: at the phase's ends, or when one control switches at both ends.
        """
        if not 0 < piece < self.pieces - 1:
            return None
        before, here, after = (np.asarray(self.signs[k]) for k in (piece - 1, piece, piece + 1))
        if np.any((before != here) & (here != after)):
            return None
        other = tuple(int(v) for v in before + after - here)
        return replace(self, signs=(*self.signs[:piece], other, *self.signs[piece + 1 :]))

    def with_arc(self, channel: int, start: float, end: float, sign: int) -> PhaseStructure:
        """Return the structure with a control at another place from ``start`` to ``end``."""
        times = sorted({*self.times, start, end})
        middles = 0.5 * (np.asarray(times[1:]) + np.asarray(times[:-1]))
        pieces = np.clip(np.searchsorted(self.times, middles) - 1, 0, self.pieces - 1)
        signs = [list(self.signs[k]) for k in pieces]
        for row, middle in zip(signs, middles, strict=True):
            if start < middle < end:
                row[channel] = sign
        return merged(tuple(times), tuple(tuple(row) for row in signs))

    def arcs(self, phase: str, labels: tuple[str, ...]) -> tuple[Arc, ...]:
        """Return the arcs of every control."""
        kinds = {-1: ArcKind.LOWER, 0: ArcKind.INTERIOR, 1: ArcKind.UPPER, 2: ArcKind.SINGULAR}
        found = []
        for i, label in enumerate(labels):
            row = [signs[i] for signs in self.signs]
            starts = [0, *[k for k in range(1, self.pieces) if row[k] != row[k - 1]], self.pieces]
            for first, last in itertools.pairwise(starts):
                found.append(Arc(phase, label, kinds[row[first]], self.times[first], self.times[last]))
        return tuple(found)


def merged(times: tuple[float, ...], signs: tuple[tuple[int, ...], ...]) -> PhaseStructure:
    """Return the structure with neighbouring pieces of equal signs joined."""
    kept = [k for k in range(len(signs)) if k == 0 or signs[k] != signs[k - 1]]
    return PhaseStructure((*[times[k] for k in kept], times[-1]), tuple(signs[k] for k in kept))
