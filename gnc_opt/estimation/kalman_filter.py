r"""Kalman filter: one control step of an estimator as CasADi functions.

**Update.** With the samples y, their innovations :math:`\nu = d(y, \hat y)`, H and :math:`\Omega` of `linearization` at
the prediction and the noise covariance R, the measurements are processed sequentially. Samples that are not finite, not
due or rejected by the gate,

.. math:: \nu^T (H P H^T + R + \Omega)^{-1} \nu > \chi^2_m(\text{gate}),

are omitted. The others are whitened and processed by component, in Joseph's form,

.. math:: k = \frac{P h}{h^T P h + 1}, \qquad P \leftarrow (1 - k h^T) P (1 - k h^T)^T + k k^T .

Finally the state is corrected by the estimated error.

**Prediction** over a step h: the state by the classical Runge-Kutta method; with the Jacobian A of the dynamics at half
the step, R and D of `space`,

.. math:: F_{h,s} = D_h \, e^{A (h - s)} R_s, \qquad
   P \leftarrow F_{h,0} P F_{h,0}^T + \tfrac{h}{6} \left( F_{h,0} Q F_{h,0}^T + 4\, F_{h,h/2} Q F_{h,h/2}^T + Q \right),

by Simpson's rule with the matrix exponential to fourth order (for the noise to second order). The unscented filter
propagates its sigma points instead of the first term.

Sources: R. E. Kalman, A new approach to linear filtering and prediction problems, J. Basic Eng. 82 (1960).
R. S. Bucy, P. D. Joseph, Filtering for Stochastic Processes with Applications to Guidance (1968).
Y. Bar-Shalom, X.-R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 5.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.array_types import Array
from gnc_opt.control.control_limits_and_authority import Authority, saturate_command
from gnc_opt.estimation.bias_and_delay_augmented_model import AugmentedModel, MeasurementChannel
from gnc_opt.estimation.jacobian_and_sigma_point_linearization import (
    Approximation,
    Map,
    TangentModel,
    factorise_semidefinite,
    solve_triangular_left,
)
from gnc_opt.model.model_variables import Layout, Variable
from gnc_opt.numerical_tolerances import LARGEST

LOST_STEPS = "lost_steps"
"""Memory entry that counts consecutive control steps with missing samples."""


def create_measurement_counters(channels: Sequence[MeasurementChannel]) -> list[Variable]:
    """Return the counters in the memory, `LOST_STEPS` last."""
    entries = []
    for channel in channels:
        entries += [Variable(f"{channel.name}_{suffix}") for suffix in ("nis", "taken", "refused")]
        if channel.has_steps_without_measurement:
            entries.append(Variable(f"{channel.name}_next"))
    return [*entries, Variable(LOST_STEPS)]


class SampleCount:
    """Samples of one control step: due, accepted, rejected; ``entries`` of the memory by name, SX."""

    def __init__(self, memory: Layout, z: Any) -> None:
        self.entries = {name: z[memory.slice(name)] for name in memory.names}
        self._any_due, self._any_taken = ca.SX(0), ca.SX(0)

    def is_measurement_due(self, channel: MeasurementChannel) -> Any:
        return (
            self.entries[f"{channel.name}_next"] < 0.5 if channel.has_steps_without_measurement else ca.SX(1)
        )

    def is_measurement_valid(self, channel: MeasurementChannel, sample: Any) -> Any:
        is_finite = ca.sum1(ca.fabs(sample) <= LARGEST) == sample.shape[0]
        return (
            ca.logic_and(is_finite, self.is_measurement_due(channel))
            if channel.has_steps_without_measurement
            else is_finite
        )

    def count_and_gate_measurement(self, channel: MeasurementChannel, valid: Any, nis: Any) -> Any:
        """Count a sample with its normalised innovation squared; return whether it passes the gate."""
        name, gate = channel.name, channel.measurement.gate
        used = valid
        if gate is not None:
            passes = nis <= float(scipy.stats.chi2.ppf(gate, channel.space.errors))
            used = ca.logic_and(valid, passes)
            self.entries[f"{name}_refused"] += ca.logic_and(valid, ca.logic_not(passes))
        is_due = self.is_measurement_due(channel)
        self.entries[f"{name}_nis"] += ca.if_else(used, nis, 0)
        self.entries[f"{name}_taken"] += used
        if channel.has_steps_without_measurement:
            remaining = self.entries[f"{name}_next"]
            self.entries[f"{name}_next"] = ca.if_else(is_due, channel.period - 1, remaining - 1)
        self._any_due, self._any_taken = ca.fmax(self._any_due, is_due), ca.fmax(self._any_taken, used)
        return used

    def set_states_nan_after_dropout(self, x: Any, hold: int) -> Any:
        """Return the states x, or NaN after more than ``hold`` steps with missing samples."""
        missing_steps = ca.if_else(self._any_taken, 0, self.entries[LOST_STEPS] + self._any_due)
        self.entries[LOST_STEPS] = missing_steps
        return ca.if_else(missing_steps < hold + 0.5, x, np.nan)


COVARIANCE = "covariance"
"""Memory entry with the structural nonzeros of the lower triangle of P, column by column."""


class KalmanFilter:
    """Functions and memory of a filter; ``pattern`` is the sparsity of the lower triangle of P.

    ``noise`` (n_errors,) are noise densities of the errors, in their unit per square root of a second.
    """

    def __init__(
        self,
        augmented: AugmentedModel,
        linearization: Approximation,
        noise: Array,
        limits: Authority | None,
        substeps: int,
        hold: int,
    ) -> None:
        self.augmented, self.linearization = augmented, linearization
        self.density = ca.diag(ca.SX(ca.sparsify(ca.DM(noise**2))))
        self.limits, self.substeps, self.hold = limits, substeps, hold
        self.pattern = self._find_covariance_sparsity()
        self.memory = self._build_filter_memory_layout()

    def _build_filter_memory_layout(self) -> Layout:
        augmented = self.augmented
        entries = [Variable(f"{v.name}_hat", v.size, v.unit) for v in augmented.states.variables]
        entries += [
            Variable(COVARIANCE, self.pattern.nnz()),
            *create_measurement_counters(augmented.channels),
        ]
        return Layout("memory", tuple(entries), f"the estimator of '{augmented.model.name}'")

    def _find_covariance_sparsity(self) -> Any:
        augmented, n = self.augmented, self.augmented.errors.size
        if not self.linearization.preserves_covariance_sparsity:
            return ca.Sparsity.lower(n)
        t, x, u = (
            ca.SX.sym("t"),
            ca.SX.sym("x", augmented.space.size),
            ca.SX.sym("u", augmented.model.controls.size),
        )
        F, early, late = augmented.discretize_error_dynamics(t, x, x, u, augmented.dt, self.density)
        maps = [_compute_matrix_sparsity_mask(F)]
        if augmented.has_delay_lines:
            maps.append(_compute_matrix_sparsity_mask(self._linearize_delayed_state_shift(t, x)[1]))
        rows = np.vstack(
            [
                _compute_matrix_sparsity_mask(view.slope)
                for view in self._linearize_measurements(t, x, ca.SX(n, n))
            ]
        )
        P = np.eye(n, dtype=bool) | _compute_matrix_sparsity_mask(early) | _compute_matrix_sparsity_mask(late)
        while True:
            new = P.copy()
            for each in maps:
                new |= each @ new @ each.T
            for row in rows:
                affected = new @ row
                new |= np.outer(affected, affected)
            if np.array_equal(new, P):
                return ca.DM(ca.sparsify(ca.DM(np.tril(P).astype(float)))).sparsity()
            P = new

    def _unpack_state_and_covariance(self, z: Any) -> tuple[Any, Any]:
        half = ca.SX(self.pattern, z[self.memory.slice(COVARIANCE)])
        return z[: self.augmented.states.size], ca.tril2symm(half)

    def _pack_state_and_covariance(self, entries: dict[str, Any], x: Any, P: Any) -> Any:
        new = dict(entries)
        for name in self.augmented.states.names:
            new[f"{name}_hat"] = x[self.augmented.states.slice(name)]
        new[COVARIANCE] = ca.project(ca.tril(P), self.pattern).nz[:]
        return ca.vertcat(*[new[name] for name in self.memory.names])

    def _linearize_delayed_state_shift(self, t: Any, x: Any) -> tuple[Any, Any]:
        shift, space = self.augmented.build_delay_shift_function(), self.augmented.space
        return TangentModel().fit_linear_model(lambda own: shift(t, own), space, space, x, None)[:2]

    # --- update -------------------------------------------------------------------------------------------

    @cached_property
    def measurement_update_function(self) -> Any:
        """``(t, y, z) -> (x, z)``."""
        augmented = self.augmented
        sizes = [0, *np.cumsum([c.variable.size for c in augmented.channels]).tolist()]
        t, y, z = ca.SX.sym("t"), ca.SX.sym("y", sizes[-1]), ca.SX.sym("z", self.memory.size)
        x, P = self._unpack_state_and_covariance(z)
        views, tally = self._linearize_measurements(t, x, P), SampleCount(self.memory, z)
        error = ca.SX.zeros(augmented.errors.size)
        for channel, sample, view in zip(augmented.channels, ca.vertsplit(y, sizes), views, strict=True):
            valid = tally.is_measurement_valid(channel, sample)
            nu = solve_triangular_left(
                view.root, ca.if_else(valid, channel.space.difference(sample, view.y), 0)
            )
            gated = channel.measurement.gate is not None
            after, updated, nis = _apply_joseph_update(P, view.slope, nu, ca.SX(1) if gated else valid, error)
            used = tally.count_and_gate_measurement(channel, valid, nis)
            error, P = (
                (
                    _select_matrix_by_condition(used, after, error),
                    _select_matrix_by_condition(used, updated, P),
                )
                if gated
                else (after, updated)
            )
        x = augmented.space.retraction(x, error)
        estimate = tally.set_states_nan_after_dropout(x[: augmented.model.states.size], self.hold)
        outputs = ca.cse([estimate, self._pack_state_and_covariance(tally.entries, x, P)])
        return ca.Function("update", [t, y, z], outputs, ["t", "y", "z"], ["x", "z_next"])

    def _linearize_measurements(self, t: Any, x: Any, P: Any) -> list[_LinearizedMeasurement]:
        augmented, views = self.augmented, []
        for channel in augmented.channels:
            observed, space = augmented.build_delayed_output_function(channel), channel.space
            slope = augmented.find_constant_measurement_jacobian(channel)
            if slope is None:
                y, slope, remainder = self.linearization.fit_linear_model(
                    partial(observed, t), augmented.space, space, x, P
                )
            else:
                y, remainder = observed(t, x), ca.SX(space.errors, space.errors)
            noise = ca.SX(
                ca.diag(ca.DM(channel.measurement.read_noise_per_component("sigma", space.errors) ** 2))
            )
            root = factorise_semidefinite(noise + remainder)
            views.append(_LinearizedMeasurement(y, solve_triangular_left(root, slope), root))
        return views

    # --- prediction ---------------------------------------------------------------------------------------

    @cached_property
    def time_update_function(self) -> Any:
        """``(t, u, z) -> z``."""
        augmented = self.augmented
        t, z = ca.SX.sym("t"), ca.SX.sym("z", self.memory.size)
        command = ca.SX.sym("u", augmented.model.controls.size)
        u = saturate_command(command, self.limits)
        entries = {name: z[self.memory.slice(name)] for name in self.memory.names}
        x, P = self._unpack_state_and_covariance(z)
        space = augmented.space
        if augmented.has_delay_lines:
            shift = augmented.build_delay_shift_function()
            x, P = self.linearization.propagate_covariance(
                lambda own: shift(t, own), space, x, P, *self._linearize_delayed_state_shift(t, x)
            )
        h = augmented.dt / self.substeps
        flow = augmented.build_state_flow_function(h)
        for i in range(self.substeps):
            begin = t + i * h
            after = flow(begin, x, u)
            F, early, late = augmented.discretize_error_dynamics(begin, x, after, u, h, self.density)
            x, P = self.linearization.propagate_covariance(
                _fix_time_and_command_in_flow_map(flow, begin, u), space, x, P + early, after, F
            )
            P = P + late
        outputs = ca.cse([self._pack_state_and_covariance(entries, x, P)])
        return ca.Function("predict", [t, command, z], outputs, ["t", "u", "z"], ["z_next"])


@dataclass(frozen=True)
class _LinearizedMeasurement:
    y: Any
    slope: Any
    root: Any


def _apply_joseph_update(P: Any, H: Any, nu: Any, used: Any, error: Any) -> tuple[Any, Any, Any]:
    """Return the error and P after whitened components with slopes H (m, n), and the NIS."""
    nis = ca.SX(0)
    for i in range(H.shape[0]):
        h = ca.sparsify(H[i, :].T)
        g = P @ h
        information, left_over = 1 / (ca.dot(h, g) + 1), nu[i] - ca.dot(h, error)
        nis += left_over**2 * information
        k = used * information * g
        error = error + k * left_over
        reduced = ca.tril2symm(ca.tril(P - k @ g.T))
        if h.nnz() == 1:
            # without rounding, left h equals k; replacing it makes this column exactly zero
            (j,) = h.sparsity().row()
            reduced[:, j] = ca.if_else(used, information, 1) * P[:, j]
            P = _symmetrise_lower_triangle(reduced, j)
        else:
            P = ca.tril2symm(ca.tril(reduced + (k - reduced @ h) @ k.T))
    return error, P, nis


def _select_matrix_by_condition(condition: Any, yes: Any, no: Any) -> Any:
    """Return ``yes`` or ``no``, depending on a condition; square matrices are symmetric."""
    if yes.shape[0] != yes.shape[1]:
        return ca.if_else(condition, yes, no)
    return ca.tril2symm(ca.if_else(condition, ca.tril(yes), ca.tril(no)))


def _symmetrise_lower_triangle(matrix: Any, j: int) -> Any:
    matrix[j, :] = matrix[:, j].T
    return ca.tril2symm(ca.tril(matrix))


def _fix_time_and_command_in_flow_map(flow: Any, t: Any, u: Any) -> Map:
    return lambda x: flow(t, x, u)


def _compute_matrix_sparsity_mask(matrix: Any) -> Any:
    return np.asarray(ca.DM(matrix.sparsity(), 1).full()) > 0
