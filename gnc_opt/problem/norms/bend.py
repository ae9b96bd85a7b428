r"""Kinks that bend along one control: at numbers, however the rest of the problem stands.

The largest of :math:`e_0, \ldots, e_k` is :math:`e_0 + c \max_i(\alpha_i u + \beta_i)` if all differences from
:math:`e_0` are affine in one control u, with a common factor c >= 0 of anything else. The largest of those lines is one
line, and more of it beyond each corner, where the next line takes over.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.problem.norms.domain import Domain, drawn
from gnc_opt.problem.norms.extrema import Pieces
from gnc_opt.tolerances import EQUAL


@dataclass(frozen=True, eq=False)
class Bend:
    """A kink that is convex, or concave, and piecewise linear in a control.

    Attributes
    ----------
    node : casadi.SX
    sense : int
        1 if it is convex, -1 if it is concave.
    base, factor : casadi.SX
        Its value is ``base + factor (slope u + offset + sum of rise_k max(u - corner_k, 0))``.
    place : int
        Of the control.
    slope, offset : float
    corners, rises : tuple of float
        In order; rises are positive.
    """

    node: Any
    sense: int
    base: Any
    factor: Any
    place: int
    slope: float
    offset: float
    corners: tuple[float, ...]
    rises: tuple[float, ...]

    @classmethod
    def of(
        cls, node: Any, sense: int, found: Pieces, controls: Mapping[int, Any], domain: Domain
    ) -> Bend | None:
        """Return the bend that a kink is; None if it is of several controls, or where it bends is no number.

        Parameters
        ----------
        node : casadi.SX
        sense : int
            1 if it is the largest of the pieces, -1 if it is the least.
        found : list of casadi.SX
            The pieces.
        controls : mapping
            Symbols of the controls in question by their places.
        domain : Domain
        """
        gaps = ca.vertcat(*(sense * (e - found[0]) for e in found))
        for place, u in controls.items():
            slopes = ca.jacobian(gaps, u)
            if not slopes.nnz() or any(ca.which_depends(gaps, u, 2, True)):
                continue
            lines = _lines(gaps, slopes, u)
            if lines is None:
                continue
            first, alpha, beta = lines
            factor = slopes[first]
            sign = domain.sign(factor)
            if sign != 0:
                own = _envelope(sign * alpha, sign * beta)
                return cls(node, sense, found[0], sense * sign * factor, place, *own)
        return None

    def expressed(self, u: Any, beyond: Mapping[float, Any]) -> Any:
        """Return its value with expressions for what the control is beyond each corner."""
        more = [rise * beyond[corner] for corner, rise in zip(self.corners, self.rises, strict=True)]
        return self.base + self.factor * (self.slope * u + self.offset + sum(more))


def _lines(gaps: Any, slopes: Any, u: Any) -> tuple[int, Array, Array] | None:
    """Return the row of the first slope, and slopes and offsets of all in its units; None if those are no numbers."""
    first = next(i for i in range(slopes.numel()) if not slopes[i].is_zero())
    alpha, beta = ca.densify(slopes) / slopes[first], ca.substitute(gaps, u, 0.0) / slopes[first]
    values = drawn(ca.vertcat(alpha, beta))
    if not np.all(np.isfinite(values)):
        return None
    spread = np.ptp(values, axis=1)
    if np.any(spread > EQUAL * np.maximum(1.0, np.max(np.abs(values), axis=1))):
        return None
    n = slopes.numel()
    return first, np.median(values[:n], axis=1), np.median(values[n:], axis=1)


def _envelope(alpha: Array, beta: Array) -> tuple[float, float, tuple[float, ...], tuple[float, ...]]:
    """Return slope and offset of the line that is the largest far to the left, corners and rises of the slope there."""
    order = np.lexsort((-beta, alpha))
    at = order[0]
    slope, offset = float(alpha[at]), float(beta[at])
    corners: list[float] = []
    rises: list[float] = []
    while True:
        steeper = [i for i in order if alpha[i] > alpha[at]]
        if not steeper:
            return slope, offset, tuple(corners), tuple(rises)
        meets = {i: float((beta[at] - beta[i]) / (alpha[i] - alpha[at])) for i in steeper}
        corner = min(meets.values())
        following = max((i for i in steeper if meets[i] == corner), key=lambda i: alpha[i])
        corners.append(corner + 0.0)
        rises.append(float(alpha[following] - alpha[at]))
        at = following


def corners_of(bends: Iterable[Bend]) -> tuple[float, ...]:
    """Return the corners of all of them, in order."""
    return tuple(sorted({corner for bend in bends for corner in bend.corners}))
