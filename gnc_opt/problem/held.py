"""Controls, path constraints and states that are held at their limits segment by segment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gnc_opt.arguments import read_numbers
from gnc_opt.errors import ProblemError
from gnc_opt.problem.interval import Interval

Signs = NDArray[np.int64]

RELEASED = 3
"""The place of what may leave its limits."""

HOLDS = (-1, 0, 1, RELEASED)
"""All places: at the lower limit, within the limits, at the upper limit, released."""


@dataclass(frozen=True)
class Smooth:
    """One polynomial for a control over neighbouring segments.

    Attributes
    ----------
    control : int
        Row of the control.
    first, last : int
        The segments ``first, ..., last - 1``.
    degree : int
        Of the polynomial.
    """

    control: int
    first: int
    last: int
    degree: int


@dataclass(frozen=True)
class Held:
    """What is held, each (n, K) as tuples: -1 lower limit, 0 within limits, +1 upper limit, 3 released."""

    controls: tuple[tuple[int, ...], ...]
    paths: tuple[tuple[int, ...], ...] = ()
    states: tuple[tuple[int, ...], ...] = ()
    smooth: tuple[Smooth, ...] = ()


def read_signs(
    given: ArrayLike,
    labels: tuple[str, ...],
    limits: Interval,
    allowed: tuple[int, ...],
    kind: str,
    where: str,
) -> tuple[tuple[int, ...], ...]:
    """Return signs (n, K) as tuples of ints; see `Phase.hold`.

    Raises
    ------
    ProblemError
        Another shape, other values, or something to be held at a limit that it does not have.
    """
    signs = np.atleast_2d(read_numbers(given, f"the arcs of {where}", ProblemError))
    if signs.ndim != 2 or signs.shape[0] != len(labels) or not np.all(np.isin(signs, allowed)):
        numbers = ", ".join(f"{a:+d}" if abs(a) == 1 else str(a) for a in allowed)
        raise ProblemError(
            f"arcs of {where} must be among {numbers} in an array of {len(labels)} rows ({kind} "
            f"{', '.join(labels)}) and one column per segment; got shape {signs.shape}."
        )
    for sign, ends in ((-1, limits.lower), (1, limits.upper)):
        endless = np.flatnonzero(np.any(signs == sign, axis=1) & ~np.isfinite(ends))
        if endless.size:
            raise ProblemError(
                f"{where} cannot hold '{labels[endless[0]]}' on a bound that it does not have."
            )
    return tuple(tuple(int(v) for v in row) for row in signs)
