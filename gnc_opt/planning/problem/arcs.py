"""Arcs: intervals on which controls, path constraints and states are held at their limits, segment by segment."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.errors import ProblemError, shown
from gnc_opt.planning.problem.interval import Interval


class ArcKind(Enum):
    """Where a control, path constraint or state is during an arc.

    A constrained control is within its bounds and follows from a state or path constraint at its limit. During the
    solution only, a released control may leave its limits.
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
    def at_limit(self) -> bool:
        """Whether the arc is at a limit."""
        return self in _SIGNS

    @classmethod
    def of_sign(cls, sign: int) -> ArcKind:
        """Return LOWER for -1, UPPER for +1 and INTERIOR for 0."""
        return _OF_SIGNS[sign]


_SIGNS = {ArcKind.LOWER: -1, ArcKind.UPPER: 1}
_OF_SIGNS = {-1: ArcKind.LOWER, 0: ArcKind.INTERIOR, 1: ArcKind.UPPER}


@dataclass(frozen=True)
class Arc:
    """One control between two of its switches, or a state or path constraint at its limit.

    Attributes
    ----------
    phase, channel : str
    kind : ArcKind
    start, end : float
        s.

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
"""Rows of kinds, one per segment or piece."""

MAY_BE_TOLD = (ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.RELEASED)
"""Kinds of arc that a user may prescribe for a control, path constraint or state."""


@dataclass(frozen=True)
class Smooth:
    """One polynomial of a degree for a control, by its row, over the segments ``first, ..., last - 1``."""

    control: int
    first: int
    last: int
    degree: int


@dataclass(frozen=True)
class Junction:
    """A mesh boundary at which a state constraint meets its limit.

    Attributes
    ----------
    constraint : int
        Row among the path constraints, then the states.
    boundary : int
        Index of the mesh break; 0 and K are the phase's ends.
    kind : ArcKind
        LOWER or UPPER: the limit that is met.
    conditions : int
        So many conditions hold there: the constraint is at its limit, and its first ``conditions - 1`` derivatives
        along the dynamics vanish.
    tangent : int
        -1 or 1: the derivative in which controls appear vanishes, too, with those of the segment before or after; 0:
        nothing is said of it. Of a path constraint with controls, order 0, that is its own value: it is at its limit.
    """

    constraint: int
    boundary: int
    kind: ArcKind
    conditions: int
    tangent: int = 0


@dataclass(frozen=True)
class Held:
    """Prescribed arcs, rows of K kinds each; interior means free within the limits."""

    controls: Kinds
    paths: Kinds = ()
    states: Kinds = ()
    smooth: tuple[Smooth, ...] = ()
    junctions: tuple[Junction, ...] = ()


def read_arc_kinds(
    given: ArrayLike,
    labels: tuple[str, ...],
    limits: Interval,
    what: str,
    where: str,
) -> Kinds:
    """Return kinds (n, K), given as kinds or as signs (-1 lower limit, 0 within, +1 upper limit); see `Phase.hold`."""
    try:
        kinds = np.atleast_2d(np.asarray(given, dtype=object))
    except (TypeError, ValueError):  # symbols, or objects that refuse
        kinds = np.empty((0, 0), dtype=object)
    read = [[_read_arc_kind(entry) for entry in row] for row in kinds] if kinds.ndim == 2 else []
    if len(read) != len(labels) or any(kind not in MAY_BE_TOLD for row in read for kind in row):
        names = ", ".join(kind.name for kind in MAY_BE_TOLD)
        raise ProblemError(
            f"arcs of {where} must be -1, 0 and +1, or {names} of ArcKind, in an array of {len(labels)} rows ({what} "
            f"{', '.join(labels)}) and one column per segment; got {shown(given)} of shape {kinds.shape}."
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
    return ArcKind.of_sign(int(entry)) if is_sign else None
