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
    regular : tuple of bool
        For each row whether H is strictly convex in the control, so that it enters and leaves its bounds (or the
        mixed path constraint) with kinks instead of jumps.
    n_controls : int or None
        The rows of the signs are so many controls, then path constraints, then states, -1 and +1 standing for the
        limit that is active there; None: controls only.
    n_paths : int
    """

    times: tuple[float, ...]
    signs: tuple[tuple[int, ...], ...]
    regular: tuple[bool, ...] = ()
    n_controls: int | None = None
    n_paths: int = 0

    def __post_init__(self) -> None:
        if not self.regular:
            object.__setattr__(self, "regular", (False,) * len(self.signs[0]))

    @property
    def controls(self) -> Signs:
        """Signs of the controls (n_controls, A)."""
        return self.matrix()[: self.n_controls]

    @property
    def paths(self) -> Signs:
        """Signs of the path constraints (n_paths, A)."""
        first = len(self.signs[0]) if self.n_controls is None else self.n_controls
        return self.matrix()[first : first + self.n_paths]

    @property
    def states(self) -> Signs:
        """Signs of the state bounds (n_states, A)."""
        first = len(self.signs[0]) if self.n_controls is None else self.n_controls
        return self.matrix()[first + self.n_paths :]

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

    def constrained(self, piece: int) -> bool:
        """Whether a state bound or a path constraint is held in a piece."""
        return any(self.signs[piece][len(self.controls) :])

    def changes(self, boundary: int) -> list[int]:
        """Return the controls that change place between a piece and the one before."""
        pair = zip(self.signs[boundary - 1], self.signs[boundary], strict=True)
        return [i for i, (before, after) in enumerate(pair) if before != after]

    def kinked(self, boundary: int) -> bool:
        """Whether controls only enter or leave their bounds with a kink between a piece and the one before."""
        before, after = self.signs[boundary - 1], self.signs[boundary]
        return all(self.regular[i] and before[i] * after[i] == 0 for i in self.changes(boundary))

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
        return self._merged(times, (*self.signs[:piece], *self.signs[piece + 1 :]))

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
        return self._merged(times, tuple(tuple(row) for row in signs))

    def arcs(self, phase: str, labels: tuple[str, ...]) -> tuple[Arc, ...]:
        """Return the arcs of every control, and those of active path constraints and state bounds.

        Parameters
        ----------
        labels : tuple of str
            Of all rows.
        """
        found = []
        free = len(self.controls)
        for i, label in enumerate(labels):
            row = [_kind(signs, i, free) for signs in self.signs]
            starts = [0, *[k for k in range(1, self.pieces) if row[k] != row[k - 1]], self.pieces]
            for first, last in itertools.pairwise(starts):
                kind = row[first]
                if i < free or kind is not ArcKind.INTERIOR:
                    found.append(Arc(phase, label, kind, self.times[first], self.times[last]))
        return tuple(found)

    def merged(self) -> PhaseStructure:
        """Return the structure with neighbouring pieces of equal signs joined."""
        return self._merged(list(self.times), self.signs)

    def _merged(self, times: list[float], signs: tuple[tuple[int, ...], ...]) -> PhaseStructure:
        kept = [k for k in range(len(signs)) if k == 0 or signs[k] != signs[k - 1]]
        return replace(
            self, times=(*[times[k] for k in kept], times[-1]), signs=tuple(signs[k] for k in kept)
        )


_KINDS = {-1: ArcKind.LOWER, 0: ArcKind.INTERIOR, 1: ArcKind.UPPER, 2: ArcKind.SINGULAR}


def _kind(signs: tuple[int, ...], i: int, n_controls: int) -> ArcKind:
    """The kind of arc of one row; a control is constrained where another limit than its own determines it."""
    if i < n_controls and signs[i] in (0, 2) and any(signs[n_controls:]):
        return ArcKind.CONSTRAINED
    return _KINDS[signs[i]]
