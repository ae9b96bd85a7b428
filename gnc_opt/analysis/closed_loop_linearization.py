r"""Linearisation of a closed loop: derivatives of its control steps along the nominal run.

The compiled step :math:`X_{k+1} = F(X_k, w_k, P)` of a loop (module `control_step_casadi_function`) contains the
plant, sensors, estimator, controller and actuators. About the nominal run without noise,

.. math::
    \delta X_{k+1} = A_k\, \delta X_k + G_k\, n_k + H_k\, \delta P, \qquad
    \delta y_k = C_k\, \delta X_k + D_k\, n_k + E_k\, \delta P,

with the standard normal numbers n of the step and the logged signals y. If all innovations are zero on the nominal run,
the covariance of a filter has no first-order effect and may be *held* constant.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.estimation.kalman_filter import COVARIANCE
from gnc_opt.simulation.block_signal_chain import ColumnLayout
from gnc_opt.simulation.closed_loop_block_connections import LoopWiring
from gnc_opt.simulation.compiled_closed_loop import MAX_STEPS_PER_CALL, CompiledLoop

OUTPUTS = ("commands", "applied")
"""Parts of the log that are linearised."""

_PARTS = ("plant", "sensor", "actuator", "push", "memory")
"""First words of the parts of X that are linearised."""


@dataclass(frozen=True, eq=False)
class LinearStep:
    """One control step: nominal X_next (n_X,), y (n_y,); derivatives in X, noise and parameters."""

    X_next: Array
    y: Array
    a: Array
    g: Array
    h: Array
    c: Array
    d: Array
    e: Array


@dataclass(frozen=True, eq=False)
class Linearization:
    """Loop without events, linearised along its nominal run; ``hold``: constant filter covariance."""

    loop: CompiledLoop
    wiring: LoopWiring
    columns: Sequence[int]
    hold: bool = False

    def __post_init__(self) -> None:
        if self.loop.replanner is not None:
            raise ArgumentError(
                "the loop re-plans in flight, which has no derivative: remove the replanner, or use monte_carlo()."
            )
        if self.loop.events.size:
            raise ArgumentError(
                f"the loop has events ('{self.loop.events.names[0]}'), whose times vary, but a "
                "linearisation needs fixed times: remove the events, or use monte_carlo()."
            )

    @cached_property
    def linearised_state_layout(self) -> ColumnLayout:
        """Layout of the linearised entries of X."""
        parts = self.loop.kernel.state.parts
        held = {"memory": len(self.filter_covariance_indices)}
        return ColumnLayout(
            tuple((name, size - held.get(name, 0)) for name, size in parts if name.split()[0] in _PARTS)
        )

    @property
    def linearised_output_layout(self) -> ColumnLayout:
        """Layout of the linearised entries of the log."""
        sizes = dict(self.loop.kernel.log.parts)
        return ColumnLayout(tuple((name, sizes[name]) for name in OUTPUTS))

    @cached_property
    def noise_slices_by_block(self) -> dict[str, slice]:
        """Slices of n for the blocks that draw random numbers, by block name."""
        blocks = {
            f"{kind} {i}": link.block.name
            for kind, links in (
                ("sensor", self.wiring.sensors),
                ("actuator", self.wiring.actuators),
                ("push", self.wiring.disturbances),
            )
            for i, link in enumerate(links)
        }
        found, at = {}, 0
        for name, size in self.loop.kernel.known.parts:
            if name in blocks:
                if size:
                    found[blocks[name]] = slice(at, at + size)
                at += size
        return found

    def differentiate_initial_loop_state(self) -> tuple[Array, Array, Array]:
        """Return the nominal initial X (n_X,), and its derivatives in the initial noise and the parameters."""
        kernel, P = self.loop.kernel, self.loop.nominal
        w, p = (ca.SX.sym(n, kernel.start.size1_in(i)) for i, n in enumerate(("w", "P")))
        first = kernel.start(w, p)
        parts = [first, ca.jacobian(first, w), ca.jacobian(first, p)]
        row = next(self._iterate_noise_free_step_inputs())
        X, by_w, by_p = (np.asarray(part.full()) for part in ca.Function("first", [w, p], parts)(row, P))
        keep = self.linearised_state_indices
        return X[:, 0], by_w[keep][:, self.noise_input_indices], by_p[keep][:, self.columns]

    def sum_normalised_innovations_squared(self) -> float:
        """Return the sum of a filter's normalised innovations squared over the nominal run; 0 without a filter."""
        memory, kernel = self.wiring.controller.memory, self.loop.kernel
        if COVARIANCE not in memory:
            return 0.0
        C, X = kernel.constants(self.loop.nominal), self.differentiate_initial_loop_state()[0]
        for row in self._iterate_noise_free_step_inputs():
            X = np.asarray(kernel.step(X, row, C)[0].full()[:, 0])
        final = kernel.state.split_vector_by_name(X)["memory"]
        return float(sum(final[memory.slice(n)].sum() for n in memory.names if n.endswith("_nis")))

    def linearize_control_steps(self, X: Array) -> Iterator[LinearStep]:
        """Yield the linearised control steps of the nominal run that starts at X (n_X,)."""
        constants = self.loop.kernel.constants
        C = np.asarray(constants(self.loop.nominal).full()[:, 0])
        by_P = self._jacobian_of_run_constants
        n = self.linearised_state_layout.size
        for k, row in enumerate(self._iterate_noise_free_step_inputs()):
            after, y, *jacobians = self._control_step_jacobian_function(
                X[self.linearised_state_indices], X[self._nonlinearised_state_indices], row, C
            )
            by_X, by_w, by_C = (np.asarray(j.full()) for j in jacobians)
            by_P_now = by_C @ by_P
            self._require_finite_step_derivatives(k, np.hstack([by_X, by_w, by_P_now]))
            X = np.asarray(after.full()[:, 0])
            outputs = np.asarray(y.full()[:, 0])
            derivatives = (by_X[:n], by_w[:n], by_P_now[:n], by_X[n:], by_w[n:], by_P_now[n:])
            yield LinearStep(X, outputs, *derivatives)

    @cached_property
    def linearised_state_indices(self) -> list[int]:
        """Indices in X of the linearised entries."""
        held = set(self.filter_covariance_indices)
        return [
            int(i)
            for name, _ in self.linearised_state_layout.parts
            for i in self._state_indices_by_variable[name]
            if i not in held
        ]

    @cached_property
    def filter_covariance_indices(self) -> list[int]:
        """Indices in X of the entries with fixed nominal values."""
        memory = self.wiring.controller.memory
        if not self.hold or COVARIANCE not in memory:
            return []
        return [int(i) for i in self._state_indices_by_variable["memory"][memory.slice(COVARIANCE)]]

    @cached_property
    def _nonlinearised_state_indices(self) -> list[int]:
        retained = set(self.linearised_state_indices)
        return [i for i in range(self.loop.kernel.state.size) if i not in retained]

    @property
    def _state_indices_by_variable(self) -> dict[str, Array]:
        kernel_state = self.loop.kernel.state
        return kernel_state.split_vector_by_name(np.arange(kernel_state.size))

    @cached_property
    def noise_input_indices(self) -> list[int]:
        """Indices of the random numbers in w."""
        return list(range(1 + self.loop.schedule.shape[0], self.loop.kernel.known.size))

    @cached_property
    def _control_step_jacobian_function(self) -> Any:
        """Return ``(retained, rest of X, w, C) -> (X_next, y, d/dX, d/dw, d/dC)``; rows: retained X_next, then y."""
        step = self.loop.kernel.step
        kind = ca.SX if step.is_a("SXFunction") else ca.MX
        places, rest = self.linearised_state_indices, self._nonlinearised_state_indices
        x, others = kind.sym("x", len(places)), kind.sym("others", len(rest))
        w, C = (kind.sym(n, step.size1_in(i)) for n, i in (("w", 1), ("C", 2)))
        after, log = step(ca.vertcat(x, others)[np.argsort([*places, *rest]).tolist()], w, C)
        logged = self.loop.kernel.log.split_vector_by_name(log)
        y = ca.vertcat(*[logged[name] for name in OUTPUTS])
        column = ca.vertcat(after[places], y)
        jacobians = [
            ca.jacobian(column, x),
            ca.jacobian(column, w)[:, self.noise_input_indices],
            ca.jacobian(column, C),
        ]
        return ca.Function("linear", [x, others, w, C], [after, y, *jacobians])

    @cached_property
    def _jacobian_of_run_constants(self) -> Array:
        constants = self.loop.kernel.constants
        p = ca.SX.sym("P", constants.size1_in(0))
        jacobian = ca.Function("by_P", [p], [ca.jacobian(constants(p), p)])
        return np.asarray(jacobian(self.loop.nominal).full())[:, self.columns]

    def _iterate_noise_free_step_inputs(self) -> Iterator[Array]:
        for _, rows in self.loop.iterate_known_values(
            0,
            np.empty((min(self.loop.n_steps, MAX_STEPS_PER_CALL), self.loop.kernel.known.size)),
        ):
            rows[:, self.noise_input_indices] = 0.0
            yield from rows

    def _require_finite_step_derivatives(self, k: int, derivatives: Array) -> None:
        bad = np.flatnonzero(~np.isfinite(derivatives).all(axis=1))
        if bad.size:
            sizes = (*self.linearised_state_layout.parts[1:], *self.linearised_output_layout.parts)
            names = [*self.loop.states.labels, *(name for name, size in sizes for _ in range(size))]
            raise ArgumentError(
                f"the derivative of '{names[bad[0]]}' of the closed loop is not finite at "
                f"{self.loop.times[k]:g} s of the nominal run: choose another nominal run, or use monte_carlo()."
            )
