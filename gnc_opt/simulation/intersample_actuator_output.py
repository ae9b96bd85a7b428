r"""Actuator outputs within a minor step: constant, or exponential after a lag.

After a lag a component is

.. math:: y(s) = v + c\, e^{-s/\tau},

with s the time since the start of the minor step. Within an integration step of length :math:`\sigma` the exponential
is projected onto quadratic polynomials,

.. math:: e^{-\sigma \nu / \tau} \approx \sum_{j=0}^{2} (2j + 1) (-1)^j e^{-\xi} i_j(\xi) P_j(2\nu - 1), \qquad
   \xi = \frac{\sigma}{2\tau},

with Legendre polynomials P_j and modified spherical Bessel functions i_j of the first kind. Three moments are exact.

Source: NIST Digital Library of Mathematical Functions, 10.47.7, 10.53.3, 18.18.19 (imaginary argument).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca

Decay: TypeAlias = Callable[[Any], Any]
"""``decay(tau)``: exp(-s / tau) at a time s, or its approximation; SX columns."""

Input: TypeAlias = Callable[[int, float], Any]
"""``u(k, node)``: value in integration step k at ``node`` (0 to 1); SX column."""


@dataclass(frozen=True)
class ActuatorWaveform:
    """Actuator output within a minor step.

    Attributes
    ----------
    mean : SX column
    at : callable, optional
        ``at(decay)`` returns the value for the exponentials ``decay``; None: constant, equal to the mean.
    """

    mean: Any
    at: Callable[[Decay], Any] | None = None

    def evaluate_actuator_waveform(self, decay: Decay) -> Any:
        """Return the value for the exponentials ``decay``."""
        return self.mean if self.at is None else self.at(decay)

    def apply_function_to_waveform(self, function: Callable[[Any], Any]) -> ActuatorWaveform:
        """Return the wave after a memoryless block."""
        value_at = self.at
        return ActuatorWaveform(
            function(self.mean), None if value_at is None else lambda decay: function(value_at(decay))
        )

    def sample_runge_kutta_stage_inputs(self, begin: Any, sigma: Any) -> Input:
        """Return the input for integration steps of length ``sigma`` from ``begin`` (s)."""
        projected = _ProjectedDecay(begin, sigma)
        return lambda k, node: self.evaluate_actuator_waveform(lambda tau: projected(tau, k, node))


def stack_actuator_waveforms(waves: Sequence[ActuatorWaveform]) -> ActuatorWaveform:
    mean = ca.vertcat(*[wave.mean for wave in waves])
    if all(wave.at is None for wave in waves):
        return ActuatorWaveform(mean)
    return ActuatorWaveform(
        mean, lambda decay: ca.vertcat(*[wave.evaluate_actuator_waveform(decay) for wave in waves])
    )


class _ProjectedDecay:
    """Quadratic approximation of exp(-s / tau) in integration steps of length ``sigma`` from ``begin`` (s)."""

    def __init__(self, begin: Any, sigma: Any) -> None:
        self.begin, self.sigma = begin, sigma
        self._known: dict[int, tuple[Any, Any, list[Any]]] = {}

    def __call__(self, tau: Any, k: int, node: float) -> Any:
        if id(tau) not in self._known:
            rates = -self.begin / tau, -self.sigma / tau
            self._known[id(tau)] = (
                ca.exp(rates[0]),
                ca.exp(rates[1]),
                project_exponential_on_legendre(-0.5 * rates[1]),
            )
        first, ratio, (c0, c1, c2) = self._known[id(tau)]
        z = 2 * node - 1
        return first * ratio**k * (c0 + c1 * z + c2 * (0.5 * (3 * z**2 - 1)))


def project_exponential_on_legendre(xi: Any) -> list[Any]:
    """Return the coefficients of P_0 to P_2 for exp(-2 xi nu), nu from 0 to 1; SX column, xi >= 0."""
    small, square = xi < 0.5, xi**2  # cancellation; the series has an error of 1e-13
    decayed = ca.exp(-xi)
    sinh, cosh = 0.5 * (1 - decayed**2), 0.5 * (1 + decayed**2)  # scaled by exp(-xi)
    bessel = [sinh / xi, (xi * cosh - sinh) / square]
    bessel.append(bessel[0] - 3 / xi * bessel[1])
    coefficients, power, odd = [], ca.SX.ones(xi.shape[0]), 1.0
    for j, closed in enumerate(bessel):
        total = ca.SX.ones(xi.shape[0])
        for k in range(6, 0, -1):
            total = 1 + square / (2 * k * (2 * j + 2 * k + 1)) * total
        series = decayed * power / odd * total
        coefficients.append((2 * j + 1) * (-1) ** j * ca.if_else(small, series, closed))
        power, odd = power * xi, odd * (2 * j + 3)
    return coefficients
