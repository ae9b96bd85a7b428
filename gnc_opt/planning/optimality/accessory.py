r"""Accessory equations: first-order variations of states and costates about a smooth extremal.

Variations of an extremal whose H is strictly convex in the controls that are off their limits satisfy the linear
Hamiltonian system

.. math::
   \dot X &= A X - B \Lambda, \qquad A = f_x - f_u H_{uu}^{-1} H_{ux}, \quad B = f_u H_{uu}^{-1} f_u^T, \\
   \dot \Lambda &= -C X - A^T \Lambda, \qquad C = H_{xx} - H_{xu} H_{uu}^{-1} H_{ux}

(Bryson and Ho, Applied Optimal Control, 1975, section 6.3). States and controls are scaled by their sizes and
:math:`\Lambda` by the cost, so that all have similar magnitude.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy

from gnc_opt.arrays import Array, Mask
from gnc_opt.model.evaluation import evaluate
from gnc_opt.planning.problem.functions import PhaseFunctions
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.propagation import state_magnitudes


class Slopes(NamedTuple):
    """Second derivatives of H and first ones of the dynamics, time first, in shares of states and controls."""

    by_uu: Array
    by_ux: Array
    by_xx: Array
    f_x: Array
    f_u: Array


@dataclass(frozen=True, eq=False)
class AccessoryEquations:
    """The accessory equations of a phase.

    Attributes
    ----------
    control_size : array (n_controls,)
        What controls are measured in.
    """

    leg: PhaseSolution
    functions: PhaseFunctions
    control_size: Array

    @cached_property
    def state_size(self) -> Array:
        """Scales of the states: their largest magnitudes; a constant state may vary like any other."""
        return state_magnitudes(self.leg)

    def slopes(self, times: Array) -> Slopes:
        """Return the derivatives at some times (n_times,)."""
        leg, n = self.leg, self.leg.states.size
        size = np.concatenate([self.state_size, self.control_size])
        numbers = (self.functions.weights, self.functions.p, self.functions.q)
        flat = evaluate(self._derivatives, times, leg.x(times), leg.flown(times), leg.lam(times), *numbers)
        second = flat[: size.size**2].reshape(size.size, size.size, -1) * size[:, None, None] * size[:, None]
        slope = (
            flat[size.size**2 :].reshape(n, size.size, -1) / self.state_size[:, None, None] * size[:, None]
        )
        second, slope = second.transpose(2, 0, 1), slope.transpose(2, 0, 1)
        return Slopes(
            second[:, n:, n:], second[:, n:, :n], second[:, :n, :n], slope[:, :, :n], slope[:, :, n:]
        )

    def matrices(self, times: Array, worth: float, free: Callable[[Array], Mask] | None = None) -> Array:
        """Return the matrices of the system in (X, Lambda) at some times, (n_times, 2n, 2n).

        Parameters
        ----------
        times : array (n_times,)
        worth : float
            Unit of the costates.
        free : function, optional
            Returns which of the controls (n_controls, n_times) are off their limits, (n_times, n_controls); the others
            do not vary. Default: all are.
        """
        by_uu, by_ux, by_xx, f_x, f_u = self.slopes(times)
        n = f_x.shape[1]
        if free is not None:
            off = free(self.leg.flown(times))
            f_u = np.where(off[:, None, :], f_u, 0.0)
            by_ux = np.where(off[:, :, None], by_ux, 0.0)
            by_uu = on_free(by_uu, off)
        solved = np.linalg.solve(by_uu, np.concatenate([by_ux, f_u.transpose(0, 2, 1)], axis=2))
        own, across = f_x - f_u @ solved[:, :, :n], f_u @ solved[:, :, n:]
        down = (by_xx - by_ux.transpose(0, 2, 1) @ solved[:, :, :n]) / worth
        upper = np.concatenate([own, -worth * across], axis=2)
        return np.concatenate([upper, np.concatenate([-down, -own.transpose(0, 2, 1)], axis=2)], axis=1)

    def flows(
        self,
        times: Array,
        worth: float,
        free: Callable[[Array], Mask] | None = None,
        *,
        backward: bool = False,
    ) -> Array:
        """Return the flow of (X, Lambda) over each step between times, from its beginning or backward, (k, 2n, 2n).

        By Magnus' expansion of fourth order, which keeps it symplectic (Iserles et al., Acta Numerica 9, 2000).
        Arguments as of `matrices`.
        """
        width, middle = np.diff(times), 0.5 * (times[:-1] + times[1:])
        early, late = (
            self.matrices(middle + sign * width / np.sqrt(12), worth, free) for sign in (-1.0, 1.0)
        )
        h = width[:, None, None]
        exponent = 0.5 * h * (early + late) + np.sqrt(3) / 12 * h**2 * (late @ early - early @ late)
        return np.asarray(scipy.linalg.expm(-exponent if backward else exponent))

    @cached_property
    def _derivatives(self) -> Any:
        """``(t, x, u, lam, weights, p, q)`` to the Hessian of H and the Jacobian of f by (x, u), row by row."""
        functions = self.functions.functions
        t, x, u, lam, mu, weights, p, q = (
            ca.SX.sym("v", functions["hamiltonian"].size1_in(i)) for i in range(8)
        )
        both, none = ca.vertcat(x, u), ca.SX.zeros(mu.shape[0])
        hessian = ca.hessian(functions["hamiltonian"](t, x, u, lam, none, weights, p, q), both)[0]
        slope = ca.jacobian(functions["rates"](t, x, u, lam, none, weights, p, q), both)
        flat = [ca.densify(ca.vec(e.T)) for e in (hessian, slope)]
        return ca.Function("accessory", [t, x, u, lam, weights, p, q], [ca.vertcat(*flat)])


def on_free(hessians: Array, free: Mask) -> Array:
    """Return Hessians (n_times, m, m) on the free controls (n_times, m), the identity on the others."""
    both = free[:, :, None] & free[:, None, :]
    return np.where(both, hessians, np.eye(free.shape[1]))


def fine_times(leg: PhaseSolution, steps: int, least: int) -> Array:
    """Return times (k + 1,) of about so many steps over a phase, more than ``least`` in every segment of its mesh."""
    pieces = [
        np.linspace(left, right, least + int(steps * (right - left) / leg.duration) + 1)[:-1]
        for left, right in zip(leg.breaks[:-1], leg.breaks[1:], strict=True)
    ]
    return np.append(np.concatenate(pieces), leg.breaks[-1])
