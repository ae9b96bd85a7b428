"""Arcs: which control sits on which bound when."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class ArcKind(Enum):
    """Where a control is during an arc.

    A constrained control is between its bounds, where a state on its bound or an active path constraint determines it;
    the arcs of the latter are LOWER or UPPER under their own names.
    """

    LOWER = "lower"
    UPPER = "upper"
    INTERIOR = "interior"
    SINGULAR = "singular"
    CONSTRAINED = "constrained"


@dataclass(frozen=True)
class Arc:
    """One control between two of its switches, or a state or path constraint at its limit.

    Attributes
    ----------
    phase, channel : str
    kind : ArcKind
    start, end : float
        s.
    """

    phase: str
    channel: str
    kind: ArcKind
    start: float
    end: float
