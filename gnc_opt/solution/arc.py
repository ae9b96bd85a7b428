"""Arcs: which control sits on which bound when."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class ArcKind(Enum):
    """Where a control is during an arc."""

    LOWER = "lower"
    UPPER = "upper"
    INTERIOR = "interior"
    SINGULAR = "singular"


@dataclass(frozen=True)
class Arc:
    """One control between two of its switches.

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
