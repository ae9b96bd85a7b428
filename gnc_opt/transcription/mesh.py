"""Mesh: how a phase is cut into segments and how many collocation points each one gets."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.errors import ProblemError
from gnc_opt.model.layout import Array


@dataclass(frozen=True)
class Mesh:
    """Segments of one phase.

    Attributes
    ----------
    breaks : tuple of float
        Segment boundaries as fractions of the phase, from 0 to 1, increasing; K + 1 of them.
    degrees : tuple of int
        Collocation points of each segment, which is the degree of its state polynomial; K of them.

    Raises
    ------
    ProblemError
        If the breaks do not increase from 0 to 1 or the numbers do not match.
    """

    breaks: tuple[float, ...]
    degrees: tuple[int, ...]

    def __post_init__(self) -> None:
        breaks = np.asarray(self.breaks, dtype=float)
        if breaks.ndim != 1 or breaks.size < 2 or not np.all(np.diff(breaks) > 0):
            raise ProblemError(f"mesh breaks must increase, at least two of them; got {self.breaks}.")
        if abs(breaks[0]) > 1e-12 or abs(breaks[-1] - 1) > 1e-12:
            raise ProblemError(f"mesh breaks are fractions from 0 to 1, but run from {breaks[0]:g} to {breaks[-1]:g}.")
        if len(self.degrees) != breaks.size - 1:
            raise ProblemError(f"mesh has {breaks.size - 1} segments but {len(self.degrees)} degrees; give one each.")
        if any(int(n) != n or n < 1 for n in self.degrees):
            raise ProblemError(f"mesh degrees must be integers >= 1; got {self.degrees}.")
        object.__setattr__(self, "breaks", (0.0, *map(float, breaks[1:-1]), 1.0))
        object.__setattr__(self, "degrees", tuple(int(n) for n in self.degrees))

    @classmethod
    def uniform(cls, segments: int, degree: int) -> Mesh:
        """Return ``segments`` equal segments of ``degree`` collocation points each."""
        if int(segments) != segments or segments < 1:
            raise ProblemError(f"a mesh needs at least one segment; got {segments!r}.")
        return cls(tuple(np.linspace(0.0, 1.0, int(segments) + 1)), (degree,) * int(segments))

    @classmethod
    def at_times(cls, times: ArrayLike, degree: int | Sequence[int]) -> Mesh:
        """Return segments whose boundaries lie at the given times, e.g. known switch times.

        Parameters
        ----------
        times : array (K + 1,)
            Increasing, including the phase's start and end (any unit).
        degree : int or sequence of K ints
        """
        t = np.asarray(times, dtype=float).reshape(-1)
        if t.size < 2 or not np.all(np.isfinite(t)) or t[-1] <= t[0]:
            raise ProblemError(f"mesh times must be finite, increasing, at least two of them; got {times}.")
        degrees = (degree,) * (t.size - 1) if isinstance(degree, (int, np.integer)) else tuple(degree)
        return cls(tuple((t - t[0]) / (t[-1] - t[0])), degrees)

    @classmethod
    def parse(cls, text: str) -> Mesh:
        """Read ``"20x3"``: 20 equal segments of 3 points."""
        match = re.fullmatch(r"\s*(\d+)\s*[x×]\s*(\d+)\s*", text)
        if not match:
            raise ProblemError(f"mesh {text!r} is not understood; write SEGMENTSxDEGREE, e.g. 20x3.")
        return cls.uniform(int(match[1]), int(match[2]))

    @property
    def segments(self) -> int:
        """Number of segments K."""
        return len(self.degrees)

    @property
    def size(self) -> int:
        """Number of collocation points N."""
        return sum(self.degrees)

    @cached_property
    def widths(self) -> Array:
        """Segment widths as fractions of the phase, shape (K,)."""
        return np.diff(np.asarray(self.breaks))

    @cached_property
    def offsets(self) -> tuple[int, ...]:
        """Index of each segment's first collocation point, and N at the end; K + 1 of them."""
        return tuple(int(i) for i in np.concatenate([[0], np.cumsum(self.degrees)]))

    def __str__(self) -> str:
        uniform = len(set(self.degrees)) == 1
        degrees = str(self.degrees[0]) if uniform else f"({min(self.degrees)}..{max(self.degrees)})"
        equal = np.allclose(self.widths, self.widths[0])
        return f"{self.segments}x{degrees}{'' if equal else ' (uneven)'}"
