"""Control structure: which control sits on which bound when."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gnc_opt.arrays import Array, Indices
from gnc_opt.problem.arc import Arc, ArcKind
from gnc_opt.problem.held import Kinds

KindArray: TypeAlias = NDArray[np.object_]
"""Kinds of arcs."""


@dataclass(frozen=True)
class PhaseStructure:
    """The switches of all controls of a phase in one order.

    Attributes
    ----------
    times : tuple of float
        Start, every switch in order, end; A + 1 of them, in s.
    kinds : tuple of A tuples of ArcKind
        For each piece between neighbouring times what every row does: LOWER or UPPER at that limit, INTERIOR wherever
        it likes, SINGULAR between its bounds though it enters H linearly.
    regular : tuple of bool
        For each row whether H is strictly convex in the control, so that it enters and leaves its bounds (or the
        mixed path constraint) with kinks instead of jumps.
    n_controls : int or None
        The rows are so many controls, then path constraints, then states, at the limit that is active there or
        interior; None: controls only.
    n_paths : int
    """

    times: tuple[float, ...]
    kinds: Kinds
    regular: tuple[bool, ...] = ()
    n_controls: int | None = None
    n_paths: int = 0

    def __post_init__(self) -> None:
        if not self.regular:
            object.__setattr__(self, "regular", (False,) * len(self.kinds[0]))

    @property
    def controls(self) -> KindArray:
        """What the controls do (n_controls, A)."""
        return self.matrix()[: self.n_controls]

    @property
    def paths(self) -> KindArray:
        """What the path constraints do (n_paths, A)."""
        return self.matrix()[self._n_free : self._n_free + self.n_paths]

    @property
    def states(self) -> KindArray:
        """What the states do (n_states, A)."""
        return self.matrix()[self._n_free + self.n_paths :]

    @property
    def _n_free(self) -> int:
        """Number of controls."""
        return len(self.kinds[0]) if self.n_controls is None else self.n_controls

    @property
    def pieces(self) -> int:
        """Number of pieces A."""
        return len(self.kinds)

    @property
    def lengths(self) -> Array:
        """Length of each piece (A,), s."""
        return np.diff(np.asarray(self.times))

    def matrix(self) -> KindArray:
        """The kinds as an object array (n_rows, A)."""
        return np.asarray(self.kinds, dtype=object).T

    def constrained(self, piece: int) -> bool:
        """Whether a state bound or a path constraint is held in a piece."""
        return any(kind.at_limit for kind in self.kinds[piece][self._n_free :])

    def changes(self, boundary: int) -> list[int]:
        """Return the rows that change between a piece and the one before."""
        pair = zip(self.kinds[boundary - 1], self.kinds[boundary], strict=True)
        return [i for i, (before, after) in enumerate(pair) if before is not after]

    def kinked(self, boundary: int) -> bool:
        """Whether controls only enter or leave their bounds with a kink between a piece and the one before."""
        before, after = self.kinds[boundary - 1], self.kinds[boundary]
        return all(
            self.regular[i] and not (before[i].at_limit and after[i].at_limit) for i in self.changes(boundary)
        )

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
        return self._merged(times, (*self.kinds[:piece], *self.kinds[piece + 1 :]))

    def swapped(self, piece: int) -> PhaseStructure | None:
        """Return the structure in which the switches at the two ends of a piece change places.

        ``None`` where there is nothing to swap: at the phase's ends, or when one control switches at both ends.
        """
        if not 0 < piece < self.pieces - 1:
            return None
        rows = list(zip(*self.kinds[piece - 1 : piece + 2], strict=True))
        if any(before is not here and here is not after for before, here, after in rows):
            return None
        other = tuple(after if before is here else before for before, here, after in rows)
        return replace(self, kinds=(*self.kinds[:piece], other, *self.kinds[piece + 1 :]))

    def with_arc(self, row: int, start: float, end: float, kind: ArcKind) -> PhaseStructure:
        """Return the structure with a row at another place from ``start`` to ``end``."""
        times = sorted({*self.times, start, end})
        middles = 0.5 * (np.asarray(times[1:]) + np.asarray(times[:-1]))
        pieces = np.clip(np.searchsorted(self.times, middles) - 1, 0, self.pieces - 1)
        kinds = [list(self.kinds[k]) for k in pieces]
        for piece, middle in zip(kinds, middles, strict=True):
            if start < middle < end:
                piece[row] = kind
        return self._merged(times, tuple(tuple(piece) for piece in kinds))

    def arcs(self, phase: str, labels: tuple[str, ...]) -> tuple[Arc, ...]:
        """Return the arcs of every control, and those of active path constraints and state bounds.

        Parameters
        ----------
        labels : tuple of str
            Of all rows.
        """
        found = []
        for i, label in enumerate(labels):
            row = [self._shown(kinds, i) for kinds in self.kinds]
            starts = [0, *[k for k in range(1, self.pieces) if row[k] != row[k - 1]], self.pieces]
            for first, last in itertools.pairwise(starts):
                kind = row[first]
                if i < self._n_free or kind is not ArcKind.INTERIOR:
                    found.append(Arc(phase, label, kind, self.times[first], self.times[last]))
        return tuple(found)

    def _shown(self, kinds: tuple[ArcKind, ...], i: int) -> ArcKind:
        """The kind of one row; a control is constrained where another limit than its own determines it."""
        determined = any(kind.at_limit for kind in kinds[self._n_free :])
        return ArcKind.CONSTRAINED if i < self._n_free and not kinds[i].at_limit and determined else kinds[i]

    def merged(self) -> PhaseStructure:
        """Return the structure with equal neighbouring pieces joined."""
        return self._merged(list(self.times), self.kinds)

    def _merged(self, times: list[float], kinds: Kinds) -> PhaseStructure:
        kept = [k for k in range(len(kinds)) if k == 0 or kinds[k] != kinds[k - 1]]
        return replace(
            self, times=(*[times[k] for k in kept], times[-1]), kinds=tuple(kinds[k] for k in kept)
        )


def signs_of(kinds: KindArray) -> Indices:
    """Return -1 where a lower limit is held, +1 where an upper one is, 0 elsewhere; same shape."""
    return np.where(kinds == ArcKind.LOWER, -1, np.where(kinds == ArcKind.UPPER, 1, 0))


def choose(condition: ArrayLike, kind: ArcKind | KindArray, otherwise: ArcKind | KindArray) -> KindArray:
    """Return ``kind`` where the condition holds and ``otherwise`` elsewhere, as an object array."""
    chosen = np.where(condition, cast(Any, kind), cast(Any, otherwise))
    return np.asarray(chosen, dtype=object)
