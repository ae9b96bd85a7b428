"""Arcs: which control sits on which bound when."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class ArcKind(Enum):
    """Where a control, path constraint or state is during an arc.

    A constrained control is between its bounds, where a state on its bound or an active path constraint determines it;
    the arcs of the latter are LOWER or UPPER under their own names. A released one may leave its limits, which tells
    the structure loop where its arc has to end, and an eased one by a tenth of its range only; no arc of a finished
    solution is released or eased.
    """

    LOWER = "lower"
    UPPER = "upper"
    INTERIOR = "interior"
    SINGULAR = "singular"
    CONSTRAINED = "constrained"
    RELEASED = "released"
    EASED = "eased"

    @property
    def sign(self) -> int:
        """-1 at the lower limit, +1 at the upper one, 0 at neither."""
        return _SIGNS.get(self, 0)

    @property
    def at_limit(self) -> bool:
        """Whether it sits on a limit."""
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
