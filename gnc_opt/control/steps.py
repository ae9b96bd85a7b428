"""Steps: how times and steps of a loop are counted, and which differences are mere rounding."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import casadi as ca

from gnc_opt.errors import ArgumentError
from gnc_opt.tolerances import SAME_TIME


def whole_steps(duration: float, step: float, what: str) -> int:
    """Return how many steps make up a duration (s); refuse what is no multiple."""
    count = round(duration / step)
    if count < 0 or abs(count * step - duration) > SAME_TIME * max(step, duration):
        raise ArgumentError(
            f"{what} is {duration:g} s, not a multiple of the step of {step:g} s: choose one."
        )
    return count


def started_steps(duration: float, step: float) -> int:
    """Return how many steps begin within a duration (s)."""
    return math.ceil(duration / step - SAME_TIME)


def is_first(phase: Any) -> Any:
    """Return whether a phase (SX), which counts steps from 0, is at its beginning."""
    return phase < 0.5


def next_phase(phase: Any, count: int) -> Any:
    """Return the phase (SX) after a step: 0 again after ``count`` of them."""
    return ca.if_else(phase > count - 1.5, 0.0, phase + 1)


def in_order(times: Sequence[Any]) -> list[Any]:
    """Return SX scalars in ascending order."""
    times = list(times)
    for last in range(len(times) - 1, 0, -1):
        for i in range(last):
            times[i], times[i + 1] = ca.fmin(times[i], times[i + 1]), ca.fmax(times[i], times[i + 1])
    return times
