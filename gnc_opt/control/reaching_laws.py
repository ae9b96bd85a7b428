r"""Reaching laws of a sliding variable s, and boundary layers of its switching function.

Each law prescribes :math:`\dot s = -\rho(s)`; a disturbance d with :math:`|d| \le b` is added to it.

* `ConstantRate`: :math:`\rho = \eta\,\sigma(s)`, reaching time from :math:`s_0`: :math:`|s_0| / (\eta - b)`.
* `ExponentialRate`: :math:`\rho = \eta\,\sigma(s) + k s`, reaching time :math:`\ln(1 + k |s_0| / (\eta - b)) / k`.
* `SuperTwisting`: :math:`\rho = k_1 |s|^{1/2} \sigma(s) - z` with :math:`\dot z = -k_2\,\sigma(s)`; the reaching time
  is finite, but not stated.

The reaching times require :math:`b < \eta`.

:math:`\sigma` is the sign function, or its continuous approximation in a boundary layer of half width :math:`\phi`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_positive_number
from gnc_opt.array_types import Array
from gnc_opt.control.super_twisting_observer import check_super_twisting_gains
from gnc_opt.errors import DesignError
from gnc_opt.model.model_variables import read_vector

Law: TypeAlias = "ConstantRate | SuperTwisting"
Boundary: TypeAlias = "Sign | SaturationLayer"


@dataclass(frozen=True)
class Sign:
    """Ideal switching: chatters at the sampling rate within a band of ``gain * dt``.

    Parameters
    ----------
    max_slope : float
        Infinite; part of the interface of the boundary layers.

    Examples
    --------
    >>> print([float(Sign()(s)) for s in (-0.5, 0.0, 0.5)])
    [-1.0, 0.0, 1.0]
    """

    max_slope: float = np.inf

    def __call__(self, s: Any) -> Any:
        """Return sign(s), SX."""
        return ca.sign(s)

    def layer_width(self, ratio: float) -> float:
        """Return the |s| (unit of s) at which the switching function equals ``ratio`` (0 to 1)."""
        return 0.0


@dataclass(frozen=True)
class SaturationLayer:
    """sat(s / phi): linear inside the boundary layer |s| <= phi.

    Parameters
    ----------
    phi : float
        Half width of the layer, unit of s, > 0.

    Examples
    --------
    >>> print([float(SaturationLayer(0.1)(s)) for s in (-0.5, 0.05, 0.5)])
    [-1.0, 0.5, 1.0]
    """

    phi: float

    def __post_init__(self) -> None:
        read_positive_number(self.phi, "the width phi of a boundary layer")

    @property
    def max_slope(self) -> float:
        """Largest slope, 1 / phi."""
        return 1 / self.phi

    def __call__(self, s: Any) -> Any:
        """Return sat(s / phi), SX."""
        return ca.fmax(-1, ca.fmin(1, s / self.phi))

    def layer_width(self, ratio: float) -> float:
        """Return the |s| (unit of s) at which the switching function equals ``ratio`` (0 to 1)."""
        return self.phi * ratio


@dataclass(frozen=True)
class ConstantRate:
    """ds/dt = -eta sign(s).

    Parameters
    ----------
    eta : float
        Unit of s per second, > 0.

    Examples
    --------
    >>> law = ConstantRate(0.5)
    """

    eta: float

    def __post_init__(self) -> None:
        read_positive_number(self.eta, "the gain eta of a reaching law")

    @property
    def gain(self) -> float:
        """Largest disturbance that the law rejects at every s, in units of s per second."""
        return self.eta

    def rate(self, s: Any, boundary: Boundary) -> Any:
        """Return rho(s), SX."""
        return self.eta * boundary(s)

    def max_slope(self, boundary: Boundary) -> float:
        """Return the largest d rho / d s, 1/s."""
        return self.eta * boundary.max_slope

    def sliding_band(self, boundary: Boundary, bound: float) -> float:
        """Return the largest |s| that a disturbance up to ``bound`` can sustain, for continuous control."""
        return boundary.layer_width(bound / self.eta)

    def reaching_time(self, s: float, bound: float) -> float:
        """Return the longest reaching time (s) for a disturbance up to ``bound``, with ideal switching."""
        return abs(s) / (self.eta - bound)


@dataclass(frozen=True)
class ExponentialRate(ConstantRate):
    """ds/dt = -eta sign(s) - k s; faster than `ConstantRate` for large s.

    Parameters
    ----------
    eta : float
        Unit of s per second, > 0.
    k : float
        1/s.

    Examples
    --------
    >>> law = ExponentialRate(0.5, 2.0)
    """

    k: float

    def __post_init__(self) -> None:
        super().__post_init__()
        read_positive_number(self.k, "the rate k of a reaching law")

    def rate(self, s: Any, boundary: Boundary) -> Any:
        """Return rho(s), SX."""
        return super().rate(s, boundary) + self.k * s

    def max_slope(self, boundary: Boundary) -> float:
        """Return the largest d rho / d s, 1/s."""
        return super().max_slope(boundary) + self.k

    def reaching_time(self, s: float, bound: float) -> float:
        """Return the longest reaching time (s) for a disturbance up to ``bound``, with ideal switching."""
        return float(np.log1p(self.k * super().reaching_time(s, bound))) / self.k


@dataclass(frozen=True)
class SuperTwisting:
    """ds/dt = -k1 |s|^(1/2) sign(s) + z, dz/dt = -k2 sign(s): continuous command, exact zero in finite time.

    Its ``bound`` limits the *rate* of the disturbance. Finite-time stable for k2 > bound and k1 > sqrt(k2 + bound)
    (R. Seeber, M. Horn, Automatica 84, 2017, 241-243).

    Parameters
    ----------
    k1 : float
        (Unit of s)^(1/2) per second.
    k2 : float
        Unit of s per second squared.

    Examples
    --------
    >>> law = go.design_sliding_mode(
    ...     *(cart, [0.0, 0.0]), outputs="q", slopes=2.0, reaching=SuperTwisting(1.5, 1.1), boundary=Sign(),
    ...     bound=0.2, dt=0.01,
    ... )
    >>> print(go.ClosedLoop(cart, law).simulate([1.0, 0.0], tf=8.0).miss("q") < 1e-3)
    True
    """

    k1: float
    k2: float

    def __post_init__(self) -> None:
        read_positive_number(self.k1, "the gain k1 of a super-twisting law")
        read_positive_number(self.k2, "the gain k2 of a super-twisting law")

    @property
    def gain(self) -> float:
        """Largest rate of a disturbance that the law rejects, in units of s per second squared."""
        return self.k2

    def rate(self, s: Any, boundary: Boundary) -> Any:
        """Return rho(s) for z = 0, SX."""
        return self.k1 * ca.sqrt(ca.fabs(s)) * boundary(s)

    def integral_term_rate(self, s: Any, boundary: Boundary) -> Any:
        """Return dz/dt, SX."""
        return -self.k2 * boundary(s)

    def max_slope(self, boundary: Boundary) -> float:
        """Return the largest d rho / d s (1/s); infinite without a boundary layer (at s = 0)."""
        if isinstance(boundary, Sign):
            return np.inf
        return float(1.5 * self.k1 * boundary.max_slope**0.5)

    def sliding_band(self, boundary: Boundary, bound: float) -> float:
        """Return the |s| in equilibrium with a disturbance that grows at the rate ``bound``."""
        return boundary.layer_width(bound / self.k2)


def read_disturbance_bounds(law: Law, value: ArrayLike, labels: Sequence[str]) -> Array:
    """Return the disturbance bounds (n_labels,); raise `DesignError` if the gain does not exceed them."""
    if not isinstance(law, (ConstantRate, SuperTwisting)):
        raise DesignError(
            f"the reaching law is {law!r}: give ConstantRate(eta), ExponentialRate(eta, k) or SuperTwisting(k1, k2)."
        )
    bounds = read_vector(value, len(labels), "the bound of the disturbance", DesignError)
    if not np.all(np.isfinite(bounds) & (bounds >= 0)):
        raise DesignError(f"the bound of the disturbance is {bounds}: give finite numbers >= 0.")
    for label, bound in zip(labels, bounds, strict=True):
        check_disturbance_bound(law, float(bound), f"the surface of '{label}'")
    return bounds


def check_disturbance_bound(law: Law, bound: float, what: str) -> None:
    """Raise `DesignError` if a disturbance up to ``bound`` is not less than the gain of the law."""
    if isinstance(law, SuperTwisting):
        check_super_twisting_gains(law.k1, law.k2, bound, what)
    elif bound >= law.gain:
        raise DesignError(
            f"{what} may be disturbed by {bound:.6g}, not less than the gain {law.gain:.6g} of its reaching law: "
            "raise the gain above the bound."
        )
