r"""Optimum: the switch times of least time for a plan as it is flown, with its second-order condition.

Of :math:`L = t_f + \nu^T \psi(\tau)` Newton's method finds

.. math:: \begin{pmatrix} H & S^T \\ S & 0 \end{pmatrix} \begin{pmatrix} \delta\tau \\ \delta\nu \end{pmatrix} =
   -\begin{pmatrix} \nabla_\tau L \\ \psi \end{pmatrix}, \qquad S = \psi_\tau, \quad H = L_{\tau\tau},

from the switch times of the solution. It is a strict minimum if S has full rank and H is positive definite where
:math:`S \delta\tau = 0` (Maurer and Osmolovskii, SIAM J. Control Optim. 42(6), 2004): then the minimum moves smoothly
with the initial state, and the guidance exists.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from gnc_opt.arrays import Array
from gnc_opt.control.neighbouring.prediction import Prediction
from gnc_opt.errors import DesignError
from gnc_opt.tolerances import RANK, TINY

_DIFFERENCE = 4e-5
"""Step of the central differences, in shares of the duration: their errors are squares of it."""

_STEPS = 20
_LARGEST = 0.02
"""Of a step, in shares of the duration."""

_SETTLED = 1e-8
"""Step at which Newton's method has ended, in shares of the duration."""

_MET = 1e-6
"""By how much the switch times that are found may miss the end, in shares of the duration by which they would have to
move for it."""

_STATIONARY = 1e-3
"""Gradient of the Lagrangian (s/s) above which the switch times are not those of least time."""

_CURVED = 1e-6
"""Least curvature, times the duration: below it the condition cannot be told from its failure."""


@dataclass(frozen=True)
class Optimum:
    """Switch times of least time.

    Attributes
    ----------
    tau : array (n_unknowns,)
        Switch times and the end, s.
    nu : array (n_errors,)
        Multipliers of the final state, s per its unit.
    S : array (n_errors, n_unknowns)
    H : array (n_unknowns, n_unknowns)
    curvature : float
        Least eigenvalue of H where S vanishes, times the duration; infinite where that is nowhere.
    """

    tau: Array
    nu: Array
    S: Array
    H: Array
    curvature: float


def find_optimum(prediction: Prediction) -> Optimum:
    """Return the optimum next to the plan.

    Raises
    ------
    DesignError
        The switch times cannot steer the end, are not those of least time, or fail the second-order condition.
    """
    plan = prediction.plan
    name, tau = plan.reference.model.name, plan.times.copy()
    duration = tau[-1] - plan.initial_time
    errors = plan.reference.model.errors.size
    if tau.size < errors:
        raise DesignError(
            f"{tau.size - 1} switches and the end of the plan of '{name}' cannot meet {errors} conditions at the end: "
            "such a plan cannot be corrected by them; follow it by design_tvlqr()."
        )
    step = np.full(tau.size, np.inf)
    for _ in range(_STEPS):
        optimum, gradient, psi = _derivatives(prediction, tau, _DIFFERENCE * duration)
        if not _steers(optimum.S) or np.max(np.abs(step)) <= _SETTLED * duration:
            break
        kkt = np.block([[optimum.H, optimum.S.T], [optimum.S, np.zeros((errors, errors))]])
        step = np.linalg.lstsq(kkt, -np.concatenate([gradient, psi]), rcond=RANK)[0][: tau.size]
        tau = tau + step * min(1.0, _LARGEST * duration / max(np.max(np.abs(step)), TINY))
    if not _steers(optimum.S) and not np.isfinite(step).all():
        raise DesignError(
            f"the switch times of the plan of '{name}' cannot steer all states at its end: follow it by design_tvlqr()."
        )
    missed = np.max(np.abs(psi) / _lengths(optimum.S))  # steps vanish where the end cannot be met, too
    if np.max(np.abs(step)) > _SETTLED * duration or missed > _MET * duration or not _steers(optimum.S):
        raise DesignError(
            f"no switch times of least time were found beside those of the plan of '{name}': give the regulator a "
            "smaller reserve or a shorter last part."
        )
    if np.max(np.abs(gradient)) > _STATIONARY:
        raise DesignError(
            f"the switch times of the plan of '{name}' are not those of least time (gradient "
            f"{np.max(np.abs(gradient)):.2g} s/s): minimise the final time, and refine the solution."
        )
    if not optimum.curvature > _CURVED:
        raise DesignError(
            f"the plan of '{name}' fails the second-order condition (least curvature {optimum.curvature:.2g} "
            "along what keeps the end): its switch times do not follow the state uniquely; follow it by "
            "design_tvlqr()."
        )
    return optimum


def _lengths(S: Array) -> Array:
    return np.asarray(np.maximum(np.linalg.norm(S, axis=1), TINY))


def _steers(S: Array) -> bool:
    """Whether every condition at the end can be moved by itself."""
    sizes = np.linalg.svd(S / _lengths(S)[:, None], compute_uv=False)
    return bool(sizes[-1] > RANK * sizes[0])


def _derivatives(prediction: Prediction, tau: Array, d: float) -> tuple[Optimum, Array, Array]:
    """Return S, H and the multipliers of least squares at these times, with the gradient of L and psi."""
    plan = prediction.plan
    nothing = np.zeros(plan.reference.model.errors.size)

    def ends(times: Array, nu: Array = nothing) -> tuple[Array, Array]:
        psi, slope = prediction.ends(plan.initial_time, plan.initial, times, nu)
        return psi.full()[:, 0], slope.full()[:, 0]

    moves = d * np.eye(tau.size)
    S = np.stack([(ends(tau + m)[0] - ends(tau - m)[0]) / (2 * d) for m in moves], axis=1)
    g = np.eye(tau.size)[-1]
    nu = np.linalg.lstsq(S.T, -g, rcond=None)[0]
    psi, slope = ends(tau, nu)
    H = np.stack([(ends(tau + m, nu)[1] - ends(tau - m, nu)[1]) / (2 * d) for m in moves], axis=1)
    H = 0.5 * (H + H.T)
    kernel = scipy.linalg.null_space(S)
    curvatures = np.linalg.eigvalsh(kernel.T @ H @ kernel)
    least = float(curvatures[0]) * (tau[-1] - plan.initial_time) if curvatures.size else np.inf
    return Optimum(tau.copy(), nu, S, H, least), g + slope, psi
