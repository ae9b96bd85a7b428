"""Arcs: mesh segments on which controls, path constraints and states are at their limits."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.errors import ProblemError, quote_value
from gnc_opt.planning.problem.bounds import Interval


class ArcKind(Enum):
    """Position of a control, path constraint or state relative to its limits on an arc.

    A constrained control is interior and determined by an active state or path constraint. A released control may
    exceed its limits; this kind occurs only during a solve.
    """

    LOWER = "lower"
    UPPER = "upper"
    INTERIOR = "interior"
    SINGULAR = "singular"
    CONSTRAINED = "constrained"
    RELEASED = "released"

    @property
    def sign(self) -> int:
        """-1 at the lower limit, +1 at the upper one, 0 at neither."""
        return _SIGNS.get(self, 0)

    @property
    def is_at_limit(self) -> bool:
        """Whether the constraint is active on the arc."""
        return self in _SIGNS

    @classmethod
    def from_sign(cls, sign: int) -> ArcKind:
        """Return LOWER for -1, UPPER for +1 and INTERIOR for 0."""
        return _OF_SIGNS[sign]


_SIGNS = {ArcKind.LOWER: -1, ArcKind.UPPER: 1}
_OF_SIGNS = {-1: ArcKind.LOWER, 0: ArcKind.INTERIOR, 1: ArcKind.UPPER}


@dataclass(frozen=True)
class Arc:
    """Control between two of its switches, or an active state or path constraint.

    Attributes
    ----------
    phase, channel : str
    kind : ArcKind
    start, end : float
        Start and end time, s.

    Examples
    --------
    >>> for arc in solution.structure:
    ...     print(arc.channel, arc.kind.value, f"{arc.start:.6f} to {arc.end:.6f} s")
    a lower 0.000000 to 1.000000 s
    a upper 1.000000 to 2.000000 s
    """

    phase: str
    channel: str
    kind: ArcKind
    start: float
    end: float


Kinds: TypeAlias = "tuple[tuple[ArcKind, ...], ...]"
"""Arc kinds, one tuple per row with one entry per segment."""

PRESCRIBABLE_KINDS = (ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.RELEASED)
"""Arc kinds that a user may prescribe for a control, path constraint or state."""


@dataclass(frozen=True)
class SmoothControl:
    """Control (row index) that is one polynomial of the given degree on segments ``first, ..., last - 1``."""

    control: int
    first: int
    last: int
    degree: int


@dataclass(frozen=True)
class Junction:
    """Mesh break at which a state constraint becomes active or inactive.

    Attributes
    ----------
    constraint : int
        Row of the path constraints, followed by the states.
    boundary : int
        Index of the mesh break; 0 and K are the ends of the phase.
    kind : ArcKind
        LOWER or UPPER: the active limit.
    conditions : int
        Number of conditions: the constraint is at its limit, and its first ``conditions - 1`` derivatives along the
        dynamics vanish.
    tangent : int
        -1 or 1: the first derivative that contains controls also vanishes, with the controls of the previous or next
        segment; 0: not prescribed. For a mixed path constraint (order 0) the constraint itself is at its limit.
    """

    constraint: int
    boundary: int
    kind: ArcKind
    conditions: int
    tangent: int = 0


@dataclass(frozen=True)
class FixedArcs:
    """Prescribed arcs: rows of K kinds; interior means free within the limits."""

    controls: Kinds
    paths: Kinds = ()
    states: Kinds = ()
    smooth: tuple[SmoothControl, ...] = ()
    junctions: tuple[Junction, ...] = ()


def read_arc_kinds(
    values: ArrayLike, labels: tuple[str, ...], limits: Interval, what: str, where: str
) -> Kinds:
    """Return kinds (n, K) from kinds or signs (-1 lower limit, 0 interior, +1 upper limit); see `Phase.hold`."""
    try:
        kinds = np.atleast_2d(np.asarray(values, dtype=object))
    except (TypeError, ValueError):  # symbols, or objects without conversion
        kinds = np.empty((0, 0), dtype=object)
    read = [[_read_arc_kind(entry) for entry in row] for row in kinds] if kinds.ndim == 2 else []
    if len(read) != len(labels) or any(kind not in PRESCRIBABLE_KINDS for row in read for kind in row):
        names = ", ".join(kind.name for kind in PRESCRIBABLE_KINDS)
        raise ProblemError(
            f"arcs of {where} must be -1, 0 and +1, or {names} of ArcKind, in an array of {len(labels)} rows ({what} "
            f"{', '.join(labels)}) and one column per segment; got {quote_value(values)} of shape {kinds.shape}."
        )
    for limit, ends in ((ArcKind.LOWER, limits.lower), (ArcKind.UPPER, limits.upper)):
        for label, row, end in zip(labels, read, ends, strict=True):
            if limit in row and not np.isfinite(end):
                raise ProblemError(f"{where} cannot hold '{label}' on a bound that it does not have.")
    return tuple(tuple(kind for kind in row if kind is not None) for row in read)


def _read_arc_kind(entry: Any) -> ArcKind | None:
    if isinstance(entry, ArcKind):
        return entry
    is_sign = (
        isinstance(entry, (int, float, np.number)) and not isinstance(entry, bool) and entry in (-1, 0, 1)
    )
    return ArcKind.from_sign(int(entry)) if is_sign else None
