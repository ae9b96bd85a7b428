"""Mesh: segments of a phase and their numbers of collocation points."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array, read_integer, require_type
from gnc_opt.array_types import Array, Indices
from gnc_opt.errors import ProblemError, quote_value
from gnc_opt.numerical_tolerances import ROUNDING


@dataclass(frozen=True)
class Mesh:
    """Segments of one phase.

    Attributes
    ----------
    breaks : tuple of float
        Segment boundaries as fractions of the phase, increasing from 0 to 1; K + 1 values.
    degrees : tuple of int
        Number of collocation points of each segment, equal to the degree of its state polynomial; K values.
    movable : tuple of int
        Indices of interior breaks that are optimised. The other breaks keep their relative position between movable
        breaks and the ends of the phase.

    Raises
    ------
    ProblemError
        The breaks do not increase from 0 to 1, the numbers do not match, or a movable break does not exist.

    Examples
    --------
    >>> print(go.Mesh.parse("20x3").segments, go.Mesh.uniform(2, 5))
    20 2x5
    """

    breaks: tuple[float, ...]
    degrees: tuple[int, ...]
    movable: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        breaks = read_float_array(self.breaks, "the breaks of a mesh", ProblemError)
        if breaks.ndim != 1 or breaks.size < 2 or not np.all(np.diff(breaks) > 0):
            raise ProblemError(
                f"the breaks of a mesh are {quote_value(self.breaks)}: give two or more that increase."
            )
        if abs(breaks[0]) > ROUNDING or abs(breaks[-1] - 1) > ROUNDING:
            raise ProblemError(
                f"the breaks of a mesh run from {breaks[0]:g} to {breaks[-1]:g}: give fractions from 0 to 1."
            )
        degrees = read_float_array(self.degrees, "the degrees of a mesh", ProblemError)
        if degrees.shape != (breaks.size - 1,):
            raise ProblemError(
                f"a mesh has {breaks.size - 1} segments, but {degrees.size} degrees: give one each."
            )
        if not np.all((degrees >= 1) & (degrees == np.floor(degrees)) & np.isfinite(degrees)):
            raise ProblemError(f"the degrees of a mesh are {quote_value(self.degrees)}: give integers >= 1.")
        movable = set(
            read_float_array(self.movable, "the movable breaks of a mesh", ProblemError).ravel().tolist()
        )
        if not movable <= set(range(1, breaks.size - 1)):
            raise ProblemError(
                f"the movable breaks of a mesh are {quote_value(self.movable)}: "
                f"choose among its interior breaks 1 to {breaks.size - 2}."
            )
        object.__setattr__(self, "movable", tuple(sorted(int(i) for i in movable)))
        object.__setattr__(self, "breaks", (0.0, *map(float, breaks[1:-1]), 1.0))
        object.__setattr__(self, "degrees", tuple(int(n) for n in self.degrees))

    @classmethod
    def uniform(cls, segments: int, degree: int) -> Mesh:
        """Return ``segments`` equal segments of ``degree`` collocation points each."""
        n = read_integer(segments, "the number of segments of a mesh", 1, ProblemError)
        return cls(tuple(np.linspace(0.0, 1.0, n + 1)), (degree,) * n)

    @classmethod
    def at_times(cls, times: ArrayLike, degree: int | Sequence[int], *, movable: bool = False) -> Mesh:
        """Return a mesh with boundaries at the given times (their initial values if movable).

        Parameters
        ----------
        times : array (K + 1,)
            Increasing, including the phase's start and end (any unit).
        degree : int or sequence of K ints
        movable : bool
            Whether the solver may move the interior boundaries, e.g. to the switching times of a bang-bang control.
        """
        t = read_float_array(times, "the times of a mesh", ProblemError).ravel()
        if t.size < 2 or not np.all(np.isfinite(t)) or not np.all(np.diff(t) > 0):
            raise ProblemError(
                f"the times of a mesh are {quote_value(times)}: give two or more, finite and increasing."
            )
        counts = read_float_array(degree, "the degrees of a mesh", ProblemError)
        degrees: Any = tuple(counts) if counts.ndim else (degree,) * (t.size - 1)
        require_type(movable, bool, "movable of a mesh", "write movable=True")
        interior = tuple(range(1, t.size - 1)) if movable else ()
        return cls(tuple((t - t[0]) / (t[-1] - t[0])), degrees, interior)

    @classmethod
    def parse(cls, text: str) -> Mesh:
        """Return the mesh of a text: ``"20x3"`` is 20 equal segments with 3 points each."""
        match = re.fullmatch(r"\s*(\d+)\s*[x×]\s*(\d+)\s*", text) if isinstance(text, str) else None
        if not match:
            raise ProblemError(
                f"mesh {quote_value(text)} is not understood: write SEGMENTSxDEGREE, e.g. 20x3."
            )
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
    def segment_widths(self) -> Array:
        """Segment widths as fractions of the phase, shape (K,)."""
        return np.diff(np.asarray(self.breaks))

    @cached_property
    def arc_breaks(self) -> tuple[int, ...]:
        """Breaks whose times are given or variables: 0, the movable ones, K. Arcs lie between them."""
        return (0, *self.movable, self.segments)

    @cached_property
    def segment_arcs(self) -> Indices:
        """Arc index of each segment, shape (K,)."""
        return np.searchsorted(
            np.asarray(self.movable, dtype=np.int64), np.arange(self.segments), side="right"
        )

    @cached_property
    def arc_starts(self) -> Array:
        """Each segment's start as a fraction of its arc, shape (K,)."""
        breaks, anchors = np.asarray(self.breaks), np.asarray(self.arc_breaks)
        first, last = breaks[anchors[self.segment_arcs]], breaks[anchors[self.segment_arcs + 1]]
        return np.asarray((breaks[:-1] - first) / (last - first))

    @cached_property
    def arc_widths(self) -> Array:
        """Segment widths as fractions of their arcs, shape (K,)."""
        breaks, anchors = np.asarray(self.breaks), np.asarray(self.arc_breaks)
        first, last = breaks[anchors[self.segment_arcs]], breaks[anchors[self.segment_arcs + 1]]
        return np.asarray(self.segment_widths / (last - first))

    @cached_property
    def point_offsets(self) -> tuple[int, ...]:
        """Index of each segment's first collocation point, and N at the end; K + 1 of them."""
        return tuple(int(i) for i in np.concatenate([[0], np.cumsum(self.degrees)]))

    def __str__(self) -> str:
        uniform = len(set(self.degrees)) == 1
        degrees = str(self.degrees[0]) if uniform else f"({min(self.degrees)}..{max(self.degrees)})"
        equal = np.allclose(self.segment_widths, self.segment_widths[0])
        kind = " (free breakpoints)" if self.movable else "" if equal else " (uneven)"
        return f"{self.segments}x{degrees}{kind}"


MeshLike: TypeAlias = "Mesh | str"
"""A mesh, or "20x3" for 20 equal segments of 3 points."""

DEFAULT_MESH = Mesh.uniform(20, 4)


def read_meshes(
    given: MeshLike | Mapping[str, MeshLike] | None, phases: Iterable[str], problem: str
) -> dict[str, Mesh]:
    """Return a mesh for every phase from one for all, one for each, or none (the default); or raise `ProblemError`."""
    if not isinstance(given, Mapping):
        return dict.fromkeys(phases, DEFAULT_MESH if given is None else _parse_mesh_entry(given))
    missing = [name for name in phases if name not in given]
    if missing:
        raise ProblemError(
            f"the mesh of problem '{problem}' lacks phase '{missing[0]}': give every phase one."
        )
    return {name: _parse_mesh_entry(mesh) for name, mesh in given.items()}


def _parse_mesh_entry(mesh: MeshLike) -> Mesh:
    if isinstance(mesh, Mesh):
        return mesh
    if isinstance(mesh, str):
        return Mesh.parse(mesh)
    raise ProblemError(f"{quote_value(mesh)} is not a mesh: give Mesh.uniform(20, 3) or '20x3'.")
