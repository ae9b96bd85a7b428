r"""Filter: one control step of an estimator as symbolic functions.

**Update** with each measurement in turn, :math:`\nu = d(y, \hat y)` its innovation, H and :math:`\Omega` of
`linearization`, R the covariance of its noise. What is not finite, not due or refused by the gate,

.. math:: \nu^T (H P H^T + R + \Omega)^{-1} \nu > \chi^2_m(\text{gate}),

is left out. The rest is whitened and taken component by component, in Joseph's form,

.. math:: k = \frac{P h}{h^T P h + 1}, \qquad P \leftarrow (1 - k h^T) P (1 - k h^T)^T + k k^T,

so that P stays a covariance also where a good sensor meets a bad guess. A turn of an attitude by the update turns the
axes of its error, too; that is of second order and left out.

**Prediction** over the control step: noise of density Q enters at the beginning, in the middle and at the end of each
integration step h, with the weights of Simpson's rule,

.. math:: \int_0^h \Phi(h, s)\, Q\, \Phi(h, s)^T ds \approx
   \tfrac{h}{6} \left( \Phi_{h,0} Q \Phi_{h,0}^T + 4\, \Phi_{h,h/2} Q \Phi_{h,h/2}^T + Q \right),

exact for chains of two integrators and of fourth order for others.

References
----------
R. E. Kalman, A new approach to linear filtering and prediction problems, J. Basic Engineering 82 (1960).
R. S. Bucy, P. D. Joseph, Filtering for Stochastic Processes with Applications to Guidance (1968).
Y. Bar-Shalom, X.-R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 5.4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.control.estimation.augmented import AugmentedModel, Channel
from gnc_opt.control.estimation.chi_square import chi_square
from gnc_opt.control.estimation.linearization import Linearization, cholesky, solved_left
from gnc_opt.model.layout import Layout, Variable
from gnc_opt.tolerances import LARGEST

COVARIANCE = "covariance"
"""The entry of the memory with the lower triangle of P, column by column."""

LOST = "lost_steps"
"""The entry that counts control steps in a row that should have brought a sample and brought none."""


@dataclass(frozen=True)
class Filter:
    """The functions of a filter.

    Attributes
    ----------
    update : casadi.Function
        ``(t, y, z) -> (x, z)``: the estimated states of the model with the samples y at t (s), and the memory.
    predict : casadi.Function
        ``(t, u, z) -> z``: the memory at the next control step, u applied until then.
    memory : Layout
    """

    update: Any
    predict: Any
    memory: Layout


def build_filter(
    augmented: AugmentedModel, linearization: Linearization, noise: Array, substeps: int, hold: int
) -> Filter:
    """Return the filter; ``noise`` (n_errors,) are densities by error, unit per square root of a second."""
    builder = _Builder(augmented, linearization, noise, substeps, hold)
    return Filter(builder.update(), builder.predict(), builder.memory)


def memory_of(augmented: AugmentedModel) -> Layout:
    """Return the layout of a filter's memory."""
    n = augmented.errors.size
    entries = [Variable(f"{v.name}_hat", v.size, v.unit) for v in augmented.states.variables]
    entries.append(Variable(COVARIANCE, n * (n + 1) // 2))
    for channel in augmented.channels:
        entries += [Variable(f"{channel.name}_{what}") for what in ("nis", "taken", "refused")]
        if channel.counted:
            entries.append(Variable(f"{channel.name}_next"))
    return Layout("memory", (*entries, Variable(LOST)), f"the estimator of '{augmented.model.name}'")


def triangle(P: Any) -> Any:
    """Return the lower triangle of a symmetric SX as a column."""
    n = P.shape[0]
    return ca.vertcat(*[P[j:, j] for j in range(n)])


def symmetric(column: Any, n: int) -> Any:
    """Return the symmetric SX of a lower triangle."""
    return ca.tril2symm(ca.SX(ca.Sparsity.lower(n), column))


class _Builder:
    def __init__(
        self,
        augmented: AugmentedModel,
        linearization: Linearization,
        noise: Array,
        substeps: int,
        hold: int,
    ) -> None:
        self.augmented, self.linearization = augmented, linearization
        self.density = ca.SX(ca.DM(np.diag(noise**2)))
        self.substeps, self.hold = substeps, hold
        self.memory = memory_of(augmented)

    # --- update -------------------------------------------------------------------------------------------

    def update(self) -> Any:
        """Return ``(t, y, z) -> (x, z)``."""
        augmented = self.augmented
        sizes = [0, *np.cumsum([c.variable.size for c in augmented.channels]).tolist()]
        t, y, z = ca.SX.sym("t"), ca.SX.sym("y", sizes[-1]), ca.SX.sym("z", self.memory.size)
        entries = {name: z[self.memory.slice(name)] for name in self.memory.names}
        x = z[: augmented.states.size]
        P = symmetric(entries[COVARIANCE], augmented.errors.size)
        any_due, any_taken = ca.SX(0), ca.SX(0)
        for channel, sample in zip(augmented.channels, ca.vertsplit(y, sizes), strict=True):
            due = entries[f"{channel.name}_next"] < 0.5 if channel.counted else ca.SX(1)
            x, half, nis, taken, refused = self._take(channel)(t, x, ca.tril(P), sample, due)
            P = ca.tril2symm(ca.tril(half))
            entries[f"{channel.name}_nis"] += ca.if_else(taken, nis, 0)
            entries[f"{channel.name}_taken"] += taken
            entries[f"{channel.name}_refused"] += refused
            if channel.counted:
                left = entries[f"{channel.name}_next"]
                entries[f"{channel.name}_next"] = ca.if_else(due, channel.period - 1, left - 1)
            any_due, any_taken = ca.fmax(any_due, due), ca.fmax(any_taken, taken)
        entries[LOST] = ca.if_else(any_taken, 0, entries[LOST] + any_due)
        for name in augmented.states.names:
            entries[f"{name}_hat"] = x[augmented.states.slice(name)]
        entries[COVARIANCE] = triangle(P)
        own = x[: augmented.model.states.size]
        trusted = entries[LOST] < self.hold + 0.5
        told = ca.if_else(trusted, own, np.nan)
        after = ca.vertcat(*[entries[name] for name in self.memory.names])
        return ca.Function("update", [t, y, z], [told, after], ["t", "y", "z"], ["x", "z_next"])

    def _take(self, channel: Channel) -> Any:
        """Return ``(t, x, P, y, due) -> (x, P, nis, taken, refused)`` of one measurement."""
        augmented, space = self.augmented, channel.space
        n, m = augmented.errors.size, space.errors
        t, x, due = ca.SX.sym("t"), ca.SX.sym("x", augmented.states.size), ca.SX.sym("due")
        half = ca.SX.sym("P", ca.Sparsity.lower(n))
        P, y = ca.tril2symm(half), ca.SX.sym("y", channel.variable.size)
        observed = augmented.observed(channel)
        y_hat, slope, left = self.linearization.fit(
            lambda own: observed(t, own), augmented.space, space, x, P
        )
        good = ca.logic_and(ca.sum1(ca.fabs(y) <= LARGEST) == y.shape[0], due)
        innovation = ca.if_else(good, space.difference(y, y_hat), 0)
        sigma = channel.measurement.values("sigma", m)
        root = cholesky(ca.SX(ca.diag(ca.DM(sigma**2))) + left)
        nu, H = solved_left(root, innovation), solved_left(root, slope)
        gated = self._nis(P, H, nu)
        passes = ca.SX(1) if channel.measurement.gate is None else gated <= chi_square(m, channel.measurement.gate)
        taken = ca.logic_and(good, passes)
        error, after = _joseph(P, H, ca.if_else(taken, nu, 0), taken)
        new = augmented.space.retraction(x, error)
        return ca.Function(
            "take",
            [t, x, half, y, due],
            [new, ca.densify(ca.tril(after)), gated, taken, ca.logic_and(good, ca.logic_not(passes))],
        )

    @staticmethod
    def _nis(P: Any, H: Any, nu: Any) -> Any:
        """Return the squared length of a whitened innovation in its own standard deviations."""
        root = cholesky(H @ P @ H.T + ca.SX.eye(H.shape[0]))
        return ca.sumsqr(solved_left(root, nu))

    # --- prediction ---------------------------------------------------------------------------------------

    def predict(self) -> Any:
        """Return ``(t, u, z) -> z``."""
        augmented = self.augmented
        n = augmented.errors.size
        t, z = ca.SX.sym("t"), ca.SX.sym("z", self.memory.size)
        u = ca.SX.sym("u", augmented.model.controls.size)
        entries = {name: z[self.memory.slice(name)] for name in self.memory.names}
        x, P = z[: augmented.states.size], symmetric(entries[COVARIANCE], n)
        if augmented.remembers:
            x, P = self._carried(augmented.shift())(t, x, u, P)
        h = augmented.dt / self.substeps
        half, flow = h / 2, self._carried(augmented.flow(h / 2))
        for i in range(self.substeps):
            begin = t + i * h
            x, P = flow(begin, x, u, P + h / 6 * self.density)
            x, P = flow(begin + half, x, u, P + 4 * h / 6 * self.density)
            P = P + h / 6 * self.density
        for name in augmented.states.names:
            entries[f"{name}_hat"] = x[augmented.states.slice(name)]
        entries[COVARIANCE] = triangle(P)
        after = ca.vertcat(*[entries[name] for name in self.memory.names])
        return ca.Function("predict", [t, u, z], [after], ["t", "u", "z"], ["z_next"])

    def _carried(self, f: Any) -> Callable[[Any, Any, Any, Any], tuple[Any, Any]]:
        """Return ``(t, x, u, P) -> (x, P)`` of a function ``(t, x, u) -> x``."""
        space = self.augmented.space
        t, u = ca.SX.sym("t"), ca.SX.sym("u", self.augmented.model.controls.size)
        x, half = ca.SX.sym("x", space.size), ca.SX.sym("P", ca.Sparsity.lower(space.errors))
        after, P = self.linearization.carry(lambda own: f(t, own, u), space, space, x, ca.tril2symm(half))
        function = ca.Function("carried", [t, x, u, half], [after, ca.densify(ca.tril(P))])

        def carried(at: Any, own: Any, held: Any, covariance: Any) -> tuple[Any, Any]:
            new, lower = function(at, own, held, ca.tril(covariance))
            return new, ca.tril2symm(ca.tril(lower))

        return carried


def _joseph(P: Any, H: Any, nu: Any, taken: Any) -> tuple[Any, Any]:
    """Return the error that whitened components with the slopes H (m, n) and innovations nu tell, and P with them.

    Nothing changes if they are not taken.
    """
    error = ca.SX.zeros(P.shape[0])
    for i in range(H.shape[0]):
        h = H[i, :].T
        g = P @ h
        k = taken * g / (ca.dot(h, g) + 1)
        error = error + k * (nu[i] - ca.dot(h, error))
        left = P - k @ g.T
        P = ca.tril2symm(ca.tril(left - (left @ h) @ k.T + k @ k.T))
    return error, P
