"""Quadratic program (QP) of a prediction horizon, and the optimality residual of its solution.

Unknowns are omega (m per step) and a slack for each soft state limit and step; see `gnc_opt.control.mpc`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array

_MIN_PENALTY = 1e-6
"""Penalty of a violated state limit if the state has no weight."""
_INACTIVE_ROW_DISTANCE = 1e6
"""Value of the scaled row of an infinite limit, in ranges."""


@dataclass(frozen=True, eq=False)
class StepLimits:
    """Limits of one step: controls (m,), their change, and states with the penalty of a squared violation."""

    lower: Array
    upper: Array
    change: Array | None
    states: tuple[int, ...]
    errors: tuple[int, ...]
    state_lower: Array
    state_upper: Array
    price: Array

    @property
    def n_constraints_per_step(self) -> int:
        return (
            self.lower.size * (1 if self.change is None else 2)
            + len(self.lower_limited_states)
            + len(self.upper_limited_states)
        )

    @property
    def soft_limited_states(self) -> list[int]:
        """Indices of the limited states with a slack."""
        return [int(i) for i in np.flatnonzero(np.isfinite(self.price))]

    @property
    def lower_limited_states(self) -> list[int]:
        return [int(i) for i in np.flatnonzero(np.isfinite(self.state_lower))]

    @property
    def upper_limited_states(self) -> list[int]:
        return [int(i) for i in np.flatnonzero(np.isfinite(self.state_upper))]

    @property
    def state_scale(self) -> Array:
        """Half the range of each limited state; for a one-sided limit, its magnitude (or 1)."""
        half = 0.5 * (self.state_upper - self.state_lower)
        one = np.where(np.isfinite(self.state_lower), np.abs(self.state_lower), np.abs(self.state_upper))
        return np.where(np.isfinite(half), half, np.where(np.isfinite(one) & (one > 0), one, 1.0))

    @property
    def penalty_square_roots(self) -> Array:
        """Square roots of the penalties; scaled by them, squared slacks have weight one."""
        penalty = self.price[self.soft_limited_states] * self.state_scale[self.soft_limited_states] ** 2
        return np.sqrt(np.maximum(penalty, _MIN_PENALTY))


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """``min y'y/2 + g'y`` subject to ``low <= a y <= high``; unknowns from ``free`` on are slacks >= 0."""

    g: Any
    a: Any
    low: Any
    high: Any
    free: int

    def compute_kkt_residual(self, y: Any, lam_a: Any, lam_x: Any) -> Any:
        """Return the largest relative residual of the optimality conditions; multipliers are > 0 at upper limits."""
        size = ca.fmax(1, ca.fmax(ca.norm_inf(lam_a), ca.fmax(ca.norm_inf(lam_x), ca.norm_inf(self.g))))
        stationary = ca.norm_inf(y + self.g + self.a.T @ lam_a + lam_x) / size
        value, high, low, lam = self.a @ y, self.high, self.low, lam_a
        violation = ca.mmax(ca.fmax(ca.fmax(value - high, low - value), 0))
        gap_high, gap_low = (
            ca.fmin(high - value, _INACTIVE_ROW_DISTANCE),
            ca.fmin(value - low, _INACTIVE_ROW_DISTANCE),
        )
        slack = ca.norm_inf(ca.fmax(lam, 0) * gap_high) + ca.norm_inf(ca.fmin(lam, 0) * gap_low)
        residuals = [stationary, violation, slack / size]
        if y.shape[0] > self.free:
            slacks, multipliers = y[self.free :], lam_x[self.free :]
            residuals += [ca.mmax(ca.fmax(-slacks, 0)), ca.mmax(ca.fmax(multipliers, 0)) / size]
            residuals.append(ca.norm_inf(multipliers * slacks) / size)
        return sum(residuals)  # a sum, since fmax ignores NaN


@dataclass(frozen=True, eq=False)
class PredictionHorizon:
    """Matrices of the steps of a horizon: A - B K, B L^-T, K, L^-T."""

    rows: StepLimits
    matrices: list[list[Any]]

    @property
    def n_steps(self) -> int:
        return len(self.matrices[0])

    @property
    def n_sign_free_qp_variables(self) -> int:
        """Number of unknowns without sign restriction."""
        return self.n_steps * self.rows.lower.size

    @property
    def n_qp_variables(self) -> int:
        return self.n_sign_free_qp_variables + self.n_steps * len(self.rows.soft_limited_states)

    def build_horizon_qp(self, e_0: Any, u_ff: Any, x_ref: Any, previous: Any) -> QuadraticProgram:
        """Return the QP for initial errors, feedforward, limited states and previous command (m,)."""
        rows, m, errors = self.rows, self.rows.lower.size, self._predict_tracking_errors(e_0)
        commands = [
            self._predict_mpc_command(j, errors[j], u_ff[m * j : m * (j + 1)]) for j in range(self.n_steps)
        ]
        limits = [_build_scaled_limit_constraints(*command, rows.lower, rows.upper) for command in commands]
        if rows.change is not None:
            first = (ca.DM(m, self.n_qp_variables), previous)
            for row, u in commands:
                limits.append(
                    _build_scaled_limit_constraints(row - first[0], u - first[1], -rows.change, rows.change)
                )
                first = (row, u)
        limits += self._build_state_limit_constraints(x_ref, errors)
        a, low, high = (ca.vertcat(*parts) for parts in zip(*limits, strict=True))
        gradient = np.zeros(self.n_qp_variables)
        gradient[self.n_sign_free_qp_variables :] = np.tile(self.rows.penalty_square_roots, self.n_steps)
        return QuadraticProgram(ca.DM(gradient), ca.densify(a), low, high, self.n_sign_free_qp_variables)

    def is_unconstrained_regulator_feasible(self, e_0: Any, u_ff: Any, x_ref: Any, previous: Any) -> Any:
        """Return whether the unconstrained regulator satisfies all limits; arguments as in `build_horizon_qp`."""
        rows, m = self.rows, self.rows.lower.size
        e, room, limited = e_0, [], len(rows.states)
        for j, (a, _, k, _) in enumerate(zip(*self.matrices, strict=True)):
            u = u_ff[m * j : m * (j + 1)] - k @ e
            room += [u - rows.lower, rows.upper - u]
            if rows.change is not None:
                room += [u - previous + rows.change, rows.change - u + previous]
                previous = u
            e = a @ e
            x = [x_ref[limited * j + i] + e[place] for i, place in enumerate(rows.errors)]
            room += [x[i] - rows.state_lower[i] for i in rows.lower_limited_states]
            room += [rows.state_upper[i] - x[i] for i in rows.upper_limited_states]
        return ca.mmin(ca.vertcat(*room)) >= 0

    def _predict_tracking_errors(self, e_0: Any) -> list[tuple[Any, Any]]:
        """Return the errors before and after each step, as (coefficients of the unknowns, constant)."""
        errors = [(ca.DM(e_0.shape[0], self.n_qp_variables), e_0)]
        for j, (a, f) in enumerate(zip(*self.matrices[:2], strict=True)):
            rows, free = errors[-1]
            errors.append(
                (a @ rows + self._pad_coefficients_with_zero_columns(self.rows.lower.size * j, f), a @ free)
            )
        return errors

    def _predict_mpc_command(self, j: int, errors: tuple[Any, Any], u_ff: Any) -> tuple[Any, Any]:
        """Return the command of step j as (coefficients of the unknowns, constant), from the errors before it."""
        (rows, free), k, g = errors, self.matrices[2][j], self.matrices[3][j]
        return self._pad_coefficients_with_zero_columns(
            self.rows.lower.size * j, g
        ) - k @ rows, u_ff - k @ free

    def _pad_coefficients_with_zero_columns(self, begin: int, block: Any) -> Any:
        height, end = block.shape[0], begin + block.shape[1]
        return ca.horzcat(ca.DM(height, begin), block, ca.DM(height, self.n_qp_variables - end))

    def _build_state_limit_constraints(
        self, x_ref: Any, errors: list[tuple[Any, Any]]
    ) -> list[tuple[Any, Any, Any]]:
        """Return (row, lower, upper) of the scaled state limits at every step of the horizon."""
        rows, limited, scale = self.rows, len(self.rows.states), self.rows.state_scale
        constraints = []
        for side, states, limit in (
            (-1, rows.lower_limited_states, rows.state_lower),
            (1, rows.upper_limited_states, rows.state_upper),
        ):
            for j in range(self.n_steps):
                for i in states:
                    row, free = (part[rows.errors[i], :] for part in errors[j + 1])
                    row = row / scale[i]
                    if i in rows.soft_limited_states:
                        slack = rows.soft_limited_states.index(i)
                        place = self.n_sign_free_qp_variables + j * len(rows.soft_limited_states) + slack
                        row = row + self._pad_coefficients_with_zero_columns(
                            place, ca.DM(-side / rows.penalty_square_roots[slack])
                        )
                    distance = (limit[i] - x_ref[j * limited + i] - free) / scale[i]
                    constraints.append((row, *((-ca.inf, distance) if side > 0 else (distance, ca.inf))))
        return constraints


def _build_scaled_limit_constraints(row: Any, value: Any, lower: Array, upper: Array) -> tuple[Any, Any, Any]:
    scale, middle = 2 / (upper - lower), 0.5 * (upper + lower)
    offset = (value - middle) * scale
    return ca.diag(ca.DM(scale)) @ row, -1 - offset, 1 - offset
