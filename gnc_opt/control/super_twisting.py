r"""Super-twisting: convergence in finite time, and an observer of unmodelled disturbances.

.. math:: \dot s = -k_1 |s|^{1/2} \mathrm{sgn}\,s + z, \qquad \dot z = -k_2\,\mathrm{sgn}\,s + \dot d,
   \qquad |\dot d| \le L .

With :math:`\zeta = (|s|^{1/2} \mathrm{sgn}\,s,\ z)` this is :math:`\dot\zeta = |s|^{-1/2} A(w)\,\zeta`,

.. math:: A(w) = \begin{pmatrix} -k_1/2 & 1/2 \\ -k_2 + w L & 0 \end{pmatrix}, \qquad |w| \le 1 .

If :math:`A(\pm L)^T P + P A(\pm L) \le -Q`, then :math:`V = \zeta^T P \zeta` obeys
:math:`\dot V \le -\gamma V^{1/2}`, and s and z are zero after at most

.. math:: T = \frac{2}{\gamma} V_0^{1/2}, \qquad
   \gamma = \frac{\lambda_{\min}(P)^{1/2}\, \lambda_{\min}(Q)}{\lambda_{\max}(P)}

(J. Moreno, M. Osorio, IEEE Trans. Autom. Control 57(4), 2012, 1035-1040). k2 > L, k1 > sqrt(k2 + L)
(R. Seeber, M. Horn, Automatica 84, 2017, 241-243) suffices for convergence, without this bound on the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.arguments import read_positive
from gnc_opt.arrays import Array
from gnc_opt.errors import DesignError


def check_gains(k1: float, k2: float, bound: float, what: str) -> None:
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


def convergence_time(k1: float, k2: float, s: float, *, z: float = 0.0, bound: float = 0.0) -> float:
    """Return a time (s) after which s and z (with the disturbance of rate ``bound``) stay at zero, or inf."""
    # In units of k1^2 the gain k1 is 1; time keeps its unit.
    p, decay = _lyapunov(k2 / k1**2, bound / k1**2)
    if decay <= 0:
        return np.inf
    zeta = np.array([np.sign(s) * np.sqrt(abs(s)) / k1, z / k1**2])
    low, high = np.linalg.eigvalsh(p)
    return float(2 * np.sqrt(zeta @ p @ zeta) * high / (np.sqrt(low) * decay))


def _lyapunov(k2: float, bound: float) -> tuple[Array, float]:
    """Return P, best of a few for the bound, and the least decay lambda_min(Q) for |w| <= 1, with k1 = 1."""
    shapes = np.array([[[-0.5, 0.5], [-k2 + w * bound, 0.0]] for w in (-1.0, 0.0, 1.0)])
    best, found = (-np.inf, -np.inf), np.eye(2)
    for weight in np.logspace(-3, 3, 61):
        p = scipy.linalg.solve_continuous_lyapunov(shapes[1].T, -np.diag([1.0, weight]))
        low, high = np.linalg.eigvalsh(p)
        decay = min(float(np.linalg.eigvalsh(-(a.T @ p + p @ a))[0]) for a in shapes)
        best, found = max((best, found), ((decay * np.sqrt(low) / high, decay), p), key=lambda pair: pair[0])
    return found, best[1]


@dataclass(frozen=True)
class SuperTwistingObserver:
    r"""Estimate :math:`\hat\Gamma` of the unknown part of :math:`\dot s = \text{known} + \Gamma`.

    .. math:: \xi = \hat s - s, \quad \hat\Gamma = -k_1 |\xi|^{1/2} \mathrm{sgn}\,\xi + q, \quad
       \dot q = -k_2\,\mathrm{sgn}\,\xi, \quad \dot{\hat s} = \text{known} + \hat\Gamma,

    by Euler steps. The sampled error that is left is of the order k1 sqrt(k2) dt + k2 dt.

    Attributes
    ----------
    k1, k2 : float
        The k7 and k8 of Jia & Meng, J. Astronautics 43(10), 2022, eqs 16-18.
    bound : float
        Largest rate of the unknown part, in units of s per second squared; 0: constant.

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
        read_positive(self.k1, "the gain k1 of an observer")
        read_positive(self.k2, "the gain k2 of an observer")
        read_positive(self.bound, "the bound of an observer", or_zero=True)
        check_gains(self.k1, self.k2, self.bound, "what the observer estimates")

    def estimate(self, s: Any, s_hat: Any, q: Any) -> Any:
        """Return the estimate of the unknown rate, SX."""
        xi = s_hat - s
        return q - self.k1 * ca.sqrt(ca.fabs(xi)) * ca.sign(xi)

    def update(self, s: Any, s_hat: Any, q: Any, known: Any, dt: float) -> tuple[Any, Any]:
        """Return s_hat and q of the next step; ``known`` is the known rate of s with the command in force."""
        unknown = self.estimate(s, s_hat, q)
        return s_hat + dt * (known + unknown), q - dt * self.k2 * ca.sign(s_hat - s)
