"""The quadratic programme of a horizon: prediction, limits as rows, and the judgement of its solution.

Its unknowns are omega, (m per step), and one slack for each limited state and step; its cost is half the square of
their norm and a linear price of the slacks. `gnc_opt.control.predictive.mpc` tells why.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array

_LEAST_PRICE = 1e-6
"""Of a state that costs nothing; its limit must still cost something."""
_FAR = 1e6
"""A row this far from its limit, in ranges, is as good as without one."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Limits of one step.

    Attributes
    ----------
    lower, upper : array (m,)
        Of the controls.
    change : array (m,) or None
        Largest change of the controls from step to step.
    states, errors : tuple of int
        Places of the limited states in x and in e.
    state_lower, state_upper : array (n_limited,)
    price : array (n_limited,)
        Weight of each limited state's excess, squared.
    """

    lower: Array
    upper: Array
    change: Array | None
    states: tuple[int, ...]
    errors: tuple[int, ...]
    state_lower: Array
    state_upper: Array
    price: Array

    @property
    def count(self) -> int:
        """Rows of one step."""
        return self.lower.size * (1 if self.change is None else 2) + len(self.below) + len(self.above)

    @property
    def below(self) -> list[int]:
        """Limited states that have a lower limit."""
        return [int(i) for i in np.flatnonzero(np.isfinite(self.state_lower))]

    @property
    def above(self) -> list[int]:
        """Limited states that have an upper limit."""
        return [int(i) for i in np.flatnonzero(np.isfinite(self.state_upper))]

    @property
    def state_scale(self) -> Array:
        """Half the range of each limited state; where one side is open, the size of the other (or 1)."""
        half = 0.5 * (self.state_upper - self.state_lower)
        one = np.where(np.isfinite(self.state_lower), np.abs(self.state_lower), np.abs(self.state_upper))
        return np.where(np.isfinite(half), half, np.where(np.isfinite(one) & (one > 0), one, 1.0))


@dataclass(frozen=True, eq=False)
class Programme:
    """``min omega'omega/2 + g'omega`` within ``low <= a omega <= high``, rows scaled to [-1, 1]; MX.

    The first ``free`` unknowns may have any sign; the slacks after them are not negative.
    """

    g: Any
    a: Any
    low: Any
    high: Any
    free: int

    def optimality_residual(self, omega: Any, lam_a: Any, lam_x: Any) -> Any:
        """Return the largest violation of the optimality conditions; multipliers are positive at upper limits.

        Stationarity and complementarity are relative to the largest multiplier or gradient, if that is above 1.
        """
        size = ca.fmax(1, ca.fmax(ca.norm_inf(lam_a), ca.fmax(ca.norm_inf(lam_x), ca.norm_inf(self.g))))
        stationary = ca.norm_inf(omega + self.g + self.a.T @ lam_a + lam_x) / size
        value = self.a @ omega
        outside = ca.mmax(ca.fmax(ca.fmax(value - self.high, self.low - value), 0))
        gap_high, gap_low = ca.fmin(self.high - value, _FAR), ca.fmin(value - self.low, _FAR)
        slack = ca.norm_inf(ca.fmax(lam_a, 0) * gap_high) + ca.norm_inf(ca.fmin(lam_a, 0) * gap_low)
        found = [stationary, outside, slack / size]
        if omega.shape[0] > self.free:
            slacks, multipliers = omega[self.free :], lam_x[self.free :]
            found += [ca.mmax(ca.fmax(-slacks, 0)), ca.mmax(ca.fmax(multipliers, 0)) / size]
            found.append(ca.norm_inf(multipliers * slacks) / size)
        return sum(found)  # not the maximum: fmax would hide what is not a number


def prediction(matrices: list[list[Any]]) -> tuple[Any, Any, Any, Any]:
    """Return v_e, v_w, e_e, e_w: ``v = v_e e_0 + v_w omega`` over the steps, ``e = e_e e_0 + e_w omega`` at their ends.

    ``matrices`` lists A - B K, B L^-T, K and L^-T of each step.
    """
    a, f, k, g = matrices
    n, m = f[0].shape
    count = len(a)
    by_start, by_plan = ca.DM.eye(n), ca.DM.zeros(n, m * count)
    v_e, v_w, e_e, e_w = [], [], [], []
    for j in range(count):
        v_e.append(-k[j] @ by_start)
        v_w.append(_in_place(g[j], j, count) - k[j] @ by_plan)
        by_start, by_plan = a[j] @ by_start, a[j] @ by_plan + _in_place(f[j], j, count)
        e_e.append(by_start)
        e_w.append(by_plan)
    return ca.vertcat(*v_e), ca.vertcat(*v_w), ca.vertcat(*e_e), ca.vertcat(*e_w)


def programme(
    rows: Rows, u_free: Any, v_w: Any, x_ref: Any, e_free: Any, e_w: Any, previous: Any
) -> Programme:
    """Return the programme of a horizon.

    Parameters
    ----------
    rows : Rows
    u_free, e_free : column
        Controls over the steps and errors at their ends without omega.
    v_w, e_w : matrix
        What omega does to them.
    x_ref : column
        Reference of the limited states at the ends of the steps.
    previous : column (m,)
        The command before the horizon.
    """
    m = rows.lower.size
    count = v_w.shape[0] // m
    parts = [_between(u_free, v_w, np.tile(rows.lower, count), np.tile(rows.upper, count))]
    if rows.change is not None:
        most = np.tile(rows.change, count)
        rest = m * (count - 1)
        # split, not sliced: of one step nothing is left, and it must be nothing of the right width
        from_ = u_free - ca.vertcat(previous, ca.vertsplit(u_free, [0, rest, rest + m])[0])
        before = ca.vertsplit(v_w, [0, rest, rest + m])[0]
        by_plan = v_w - ca.vertcat(ca.DM.zeros(m, v_w.shape[1]), before)
        parts.append(_between(from_, by_plan, -most, most))
    hard = [ca.vertcat(*column) for column in zip(*parts, strict=True)]
    gradient = ca.DM.zeros(m * count)
    if not rows.states:
        return Programme(gradient, hard[0], hard[1], hard[2], m * count)
    price, soft = _soft(rows, count, x_ref, e_free, e_w)
    wide = ca.horzcat(hard[0], ca.DM.zeros(hard[0].shape[0], price.shape[0]))
    below, above = (ca.vertcat(hard[k], soft[k]) for k in (1, 2))
    return Programme(ca.vertcat(gradient, price), ca.vertcat(wide, soft[0]), below, above, m * count)


def _soft(rows: Rows, count: int, x_ref: Any, e_free: Any, e_w: Any) -> tuple[Any, tuple[Any, Any, Any]]:
    """Return the linear price of the slacks, and the rows of the limited states."""
    scale, n, limited = rows.state_scale, e_w.shape[0] // count, len(rows.states)
    # priced linearly and squared; in units of the root of its price the square has the weight one
    root = np.sqrt(np.maximum(rows.price * scale**2, _LEAST_PRICE))
    matrices, lows, highs = [], [], []
    for side, which, limit in ((-1, rows.below, rows.state_lower), (1, rows.above, rows.state_upper)):
        for j in range(count):
            for i in which:
                place = j * n + rows.errors[i]
                unit = ca.DM(1, limited * count)
                unit[0, j * limited + i] = -side / root[i]
                matrices.append(ca.horzcat(e_w[place, :] / scale[i], unit))
                rest = (limit[i] - x_ref[j * limited + i] - e_free[place]) / scale[i]
                lows.append(-ca.inf if side > 0 else rest)
                highs.append(rest if side > 0 else ca.inf)
    return ca.DM(np.tile(root, count)), (ca.vertcat(*matrices), ca.vertcat(*lows), ca.vertcat(*highs))


def _between(value: Any, by_plan: Any, lower: Array, upper: Array) -> tuple[Any, Any, Any]:
    """The rows of ``lower <= value + by_plan omega <= upper``, scaled to [-1, 1]."""
    scale, middle = 2 / (upper - lower), 0.5 * (upper + lower)
    offset = (value - middle) * scale
    return ca.diag(ca.DM(scale)) @ by_plan, -1 - offset, 1 - offset


def _in_place(block: Any, j: int, count: int) -> Any:
    height, width = block.shape
    return ca.horzcat(ca.DM.zeros(height, width * j), block, ca.DM.zeros(height, width * (count - j - 1)))
