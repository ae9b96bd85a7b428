r"""Waves: what an actuator puts out within a minor step, and how it is integrated with the plant.

On each of its parts a component is

.. math:: y(s) = v + g\,(s - b) + c\, e^{-(s - b)/\tau},

with s the time since the minor step began and b the beginning of the part. Where a part begins, the
integration begins anew. Within an integration step of length :math:`\sigma` the exponential is projected on
parabolas,

.. math:: e^{-\sigma \nu / \tau} \approx \sum_{j=0}^{2} (2j + 1) (-1)^j e^{-\xi} i_j(\xi) P_j(2\nu - 1), \qquad
   \xi = \frac{\sigma}{2\tau},

P_j Legendre's polynomials and i_j the modified spherical Bessel functions of the first kind: the first three
moments are exact for any :math:`\tau`.

Source: NIST Digital Library of Mathematical Functions, 10.47.7 (i_j), 10.53.3 (its series), 18.18.19 with an imaginary
argument (the expansion).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import casadi as ca

Input: TypeAlias = Callable[[int, float], Any]
"""``u(k, node)``: the value in the k-th integration step of a piece, at ``node`` (0 to 1) of it; SX column."""


@dataclass(frozen=True)
class Part:
    """A stretch of a wave from ``begin`` (s, since the minor step began); SX columns v, g and c of the equation."""

    begin: Any
    value: Any
    slope: Any
    decay: Any

    def at(self, s: Any, tau: Any) -> Any:
        """Return the value at s (since the minor step began)."""
        late = s - self.begin
        straight = self.value + self.slope * late
        return straight if tau is None else straight + self.decay * ca.exp(-late / tau)


@dataclass(frozen=True)
class Wave:
    """The output of an actuator within a minor step.

    Attributes
    ----------
    mean : SX column
    parts : tuple of Part
        In the order of time; none where the output is held at its mean.
    tau : SX column or None
        Time constants of the decays.
    breaks : tuple of SX
        Times (s) at which components change their parts.
    after : callable, optional
        What blocks without memory make of the components.
    """

    mean: Any
    parts: tuple[Part, ...] = ()
    tau: Any = None
    breaks: tuple[Any, ...] = ()
    after: Callable[[Any], Any] | None = None

    @property
    def held(self) -> bool:
        """Whether it keeps one value."""
        return not self.parts

    @property
    def straight(self) -> bool:
        """Whether it consists of straight lines, which a lag can follow."""
        return self.tau is None and self.after is None

    @property
    def stepped(self) -> bool:
        """Whether it consists of held values, which a rate limit can follow."""
        return self.straight and all(part.slope.is_zero() for part in self.parts)

    def pieces(self, h: float) -> list[tuple[Part, Any]]:
        """Return the parts with their ends (s)."""
        zero = ca.SX.zeros(self.mean.shape[0])
        parts = self.parts or (Part(zero, self.mean, zero, zero),)
        return list(zip(parts, [*(part.begin for part in parts[1:]), zero + h], strict=True))

    def mapped(self, function: Callable[[Any], Any]) -> Wave:
        """Return what a block without memory makes of it at every time."""
        if self.held:
            return Wave(function(self.mean))
        before = self.after
        both = function if before is None else lambda y: function(before(y))
        return replace(self, mean=function(self.mean), after=both)

    def averaged(self) -> Wave:
        """Return it held at its mean: for blocks that cannot follow it."""
        return self if self.held else Wave(self.mean)

    def input(self, begin: Any, end: Any, steps: int) -> Input:
        """Return its values for the integration from ``begin`` to ``end`` (s), between breaks, in equal steps."""
        if self.held:
            return lambda k, node: self.mean
        part = self._between(begin, end)
        sigma = (end - begin) / steps
        first = part.value + part.slope * (begin - part.begin)
        decay = None if self.tau is None else _Decay(part, self.tau, begin, sigma)

        def value(k: int, node: float) -> Any:
            y = first + part.slope * sigma * (k + node)
            y = y if decay is None else y + decay(k, node)
            return y if self.after is None else self.after(y)

        return value

    def at(self, begin: Any, end: Any, s: Any) -> Any:
        """Return the value at s, between two times between which there is no break (s)."""
        if self.held:
            return self.mean
        y = self._between(begin, end).at(s, self.tau)
        return y if self.after is None else self.after(y)

    def _between(self, begin: Any, end: Any) -> Part:
        """Return the part of each component between two times."""
        part, *later = self.parts
        for other in later:
            now = 0.5 * (begin + end) > other.begin
            part = Part(
                *(ca.if_else(now, b, a) for a, b in zip(_entries(part), _entries(other), strict=True))
            )
        return part


def stacked(waves: Sequence[Wave], h: float) -> Wave:
    """Return several waves as one column; waves distorted by memoryless blocks are averaged."""
    if len(waves) == 1:
        return waves[0]
    if all(wave.held for wave in waves) or any(wave.after is not None for wave in waves):
        return Wave(ca.vertcat(*[wave.mean for wave in waves]))
    count = max(len(wave.parts) for wave in waves)
    columns = [[part for part, _ in wave.pieces(h)] for wave in waves]
    for parts in columns:
        last = parts[-1]
        never = Part(0 * last.begin + h, last.value, 0 * last.slope, 0 * last.decay)
        parts += [never] * (max(count, 1) - len(parts))
    joined = tuple(
        Part(*(ca.vertcat(*entries) for entries in zip(*(_entries(p) for p in together), strict=True)))
        for together in zip(*columns, strict=True)
    )
    taus = [ca.SX.ones(w.mean.shape[0]) if w.tau is None else w.tau for w in waves]
    return Wave(
        ca.vertcat(*[wave.mean for wave in waves]),
        joined,
        None if all(wave.tau is None for wave in waves) else ca.vertcat(*taus),
        tuple(b for wave in waves for b in wave.breaks),
    )


def cut(wave: Wave, begin: int, end: int) -> Wave:
    """Return some of the components."""
    if wave.held:
        return Wave(wave.mean[begin:end])
    whole = wave.after
    if whole is not None:
        return replace(wave, mean=wave.mean[begin:end], after=lambda y: whole(y)[begin:end])
    return Wave(
        wave.mean[begin:end],
        tuple(Part(*(entry[begin:end] for entry in _entries(part))) for part in wave.parts),
        None if wave.tau is None else wave.tau[begin:end],
        wave.breaks,
    )


class _Decay:
    """The projected exponential of a part in the integration steps of a piece."""

    def __init__(self, part: Part, tau: Any, begin: Any, sigma: Any) -> None:
        self.first = part.decay * ca.exp(-(begin - part.begin) / tau)
        self.ratio = ca.exp(-sigma / tau)
        self.coefficients = projection(0.5 * sigma / tau)
        self.shapes: dict[float, Any] = {}

    def __call__(self, k: int, node: float) -> Any:
        if node not in self.shapes:
            z = 2 * node - 1
            legendre = (1.0, z, 0.5 * (3 * z**2 - 1))
            self.shapes[node] = sum(e * p for e, p in zip(self.coefficients, legendre, strict=True))
        return self.first * self.ratio**k * self.shapes[node]


def projection(xi: Any) -> list[Any]:
    """Return the coefficients of P_0 to P_2 for exp(-2 xi nu), nu from 0 to 1; SX column, xi >= 0."""
    small, square = xi < 0.5, xi**2  # closed forms lose digits there; the series keeps 1e-13
    decayed = ca.exp(-xi)
    sinh, cosh = 0.5 * (1 - decayed**2), 0.5 * (1 + decayed**2)  # times exp(-xi)
    bessel = [sinh / xi, (xi * cosh - sinh) / square]
    bessel.append(bessel[0] - 3 / xi * bessel[1])
    found, power, odd = [], ca.SX.ones(xi.shape[0]), 1.0
    for j, closed in enumerate(bessel):
        total = ca.SX.ones(xi.shape[0])
        for k in range(6, 0, -1):
            total = 1 + square / (2 * k * (2 * j + 2 * k + 1)) * total
        series = decayed * power / odd * total
        found.append((2 * j + 1) * (-1) ** j * ca.if_else(small, series, closed))
        power, odd = power * xi, odd * (2 * j + 3)
    return found


def _entries(part: Part) -> tuple[Any, ...]:
    return part.begin, part.value, part.slope, part.decay
