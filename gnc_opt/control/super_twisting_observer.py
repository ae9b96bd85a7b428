r"""Super-twisting algorithm: finite-time convergence conditions, and a disturbance observer.

.. math:: \dot s = -k_1 |s|^{1/2} \mathrm{sgn}\,s + z, \qquad \dot z = -k_2\,\mathrm{sgn}\,s + \dot d,
   \qquad |\dot d| \le L .

s and z reach zero in finite time if k2 > L and k1 > sqrt(k2 + L)
(R. Seeber, M. Horn, Automatica 84, 2017, 241-243).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.argument_checks import read_positive_number
from gnc_opt.errors import DesignError


def check_super_twisting_gains(k1: float, k2: float, bound: float, what: str) -> None:
    """Raise `DesignError` unless k2 > bound and k1 > sqrt(k2 + bound)."""
    if k2 <= bound:
        raise DesignError(
            f"{what} may change at {bound:.6g} per second, not less than the gain k2 = {k2:.6g}: raise k2."
        )
    if k1 <= np.sqrt(k2 + bound):
        raise DesignError(
            f"the gain k1 = {k1:.6g} against {what} is not above sqrt(k2 + bound) = "
            f"{np.sqrt(k2 + bound):.6g}: raise k1."
        )


@dataclass(frozen=True)
class SuperTwistingObserver:
    r"""Estimator :math:`\hat\Gamma` of the unknown part of :math:`\dot s = \text{known} + \Gamma`.

    .. math:: \xi = \hat s - s, \quad \hat\Gamma = -k_1 |\xi|^{1/2} \mathrm{sgn}\,\xi + q, \quad
       \dot q = -k_2\,\mathrm{sgn}\,\xi, \quad \dot{\hat s} = \text{known} + \hat\Gamma,

    integrated by Euler steps. The remaining sampling error is of the order k1 sqrt(k2) dt + k2 dt.

    Attributes
    ----------
    k1, k2 : float
        Gains, k7 and k8 of Jia & Meng, J. Astronautics 43(10), 2022, eqs 16-18.
    bound : float
        Largest rate of the unknown part, in units of s per second squared; 0 if it is constant.

    Examples
    --------
    >>> from gnc_opt.control import ConstantRate, SaturationLayer, SuperTwistingObserver
    >>> law = go.design_sliding_mode(
    ...     *(cart, [0.0, 0.0]), outputs="q", slopes=2.0, reaching=ConstantRate(0.5), boundary=SaturationLayer(0.1),
    ...     observer=SuperTwistingObserver(1.5, 1.1, bound=0.2), dt=0.01,
    ... )
    >>> print(go.ClosedLoop(cart, law).simulate([1.0, 0.0], tf=8.0).miss("q") < 1e-3)
    True
    """

    k1: float
    k2: float
    bound: float = 0.0

    def __post_init__(self) -> None:
        read_positive_number(self.k1, "the gain k1 of an observer")
        read_positive_number(self.k2, "the gain k2 of an observer")
        read_positive_number(self.bound, "the bound of an observer", or_zero=True)
        check_super_twisting_gains(self.k1, self.k2, self.bound, "the estimated disturbance")

    def estimate(self, s: Any, s_hat: Any, q: Any) -> Any:
        """Return the estimate of the unknown part of ds/dt, SX."""
        xi = s_hat - s
        return q - self.k1 * ca.sqrt(ca.fabs(xi)) * ca.sign(xi)

    def update(self, s: Any, s_hat: Any, q: Any, known_rate: Any, dt: float) -> tuple[Any, Any]:
        """Return s_hat and q of the next step; ``known_rate`` is the known part of ds/dt with the applied command."""
        unknown = self.estimate(s, s_hat, q)
        return s_hat + dt * (known_rate + unknown), q - dt * self.k2 * ca.sign(s_hat - s)
