"""A small closed loop for tests: classical Runge-Kutta between control steps that hold their command."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from gnc_opt.control import Controller, Reference, output_errors
from gnc_opt.model import Model


@dataclass(frozen=True)
class Steps:
    """times (n+1,), x (n_states, n+1), u (n_controls, n), z (n_memory, n+1)."""

    controller: Controller
    times: np.ndarray
    x: np.ndarray
    u: np.ndarray
    z: np.ndarray

    def memory(self, name: str) -> np.ndarray:
        return self.z[self.controller.memory.slice(name)]


def step_through(
    controller: Controller,
    plant: Model,
    x0,
    *,
    dt: float,
    tf: float,
    t0: float = 0.0,
    disturbance: Callable[[np.ndarray], np.ndarray] | None = None,
    limits=None,
    minor: int = 1,
) -> Steps:
    """``disturbance(times)`` (n_controls, n_times) adds to the command, after it has been limited."""
    n = round((tf - t0) / dt)
    times = t0 + dt * np.arange(n + 1)
    constant = controller.span is not None and controller.span[0] == controller.span[1]
    rows = controller.schedule(times[:1] if constant else times[:-1], dt)
    rows = np.broadcast_to(rows, (rows.shape[0], n))
    x0 = np.asarray(x0, dtype=float)
    z0 = controller.start(t0, x0, rows[:, 0]).full()
    # the disturbance at the beginning, the middle and the end of each minor step
    inner = (times[:-1, None] + dt * np.arange(2 * minor + 1) / (2 * minor)).reshape(-1)
    d = np.zeros((plant.controls.size, inner.size)) if disturbance is None else disturbance(inner)
    d = d.reshape(plant.controls.size, n, -1).transpose(2, 0, 1).reshape(-1, n)
    one = _control_step(controller, plant, dt, minor, limits)
    state, u = one.mapaccum(n)(np.concatenate([x0, z0[:, 0]]), times[:-1], rows, d)
    state = np.column_stack([np.concatenate([x0, z0[:, 0]]), state.full()])
    return Steps(controller, times, state[: x0.size], u.full(), state[x0.size :])


def _control_step(controller: Controller, plant: Model, dt: float, minor: int, limits):
    nx, nz, nu = plant.states.size, controller.memory.size, plant.controls.size
    state, t = ca.SX.sym("state", nx + nz), ca.SX.sym("t")
    r, d = ca.SX.sym("r", controller.signals.size), ca.SX.sym("d", nu * (2 * minor + 1))
    x, h = state[:nx], dt / minor
    u, z = controller.step(t, x, r, state[nx:])
    applied = u if limits is None else ca.fmax(limits[0], ca.fmin(limits[1], u))
    for j in range(minor):
        begin, middle, end = (d[nu * (2 * j + i) : nu * (2 * j + i + 1)] for i in range(3))
        tj, p = t + j * h, plant.parameter_values
        k1 = plant.function(tj, x, applied + begin, p)
        k2 = plant.function(tj + h / 2, x + h / 2 * k1, applied + middle, p)
        k3 = plant.function(tj + h / 2, x + h / 2 * k2, applied + middle, p)
        k4 = plant.function(tj + h, x + h * k3, applied + end, p)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.Function("one", [state, t, r, d], [ca.vertcat(x, z), u])


def decoupling_matrix(model: Model, outputs, x) -> np.ndarray:
    """Return E (n_outputs, n_controls) at the state x (n_states,)."""
    here = Reference.constant(model, x, np.zeros(model.controls.size))
    errors = output_errors(model, here, outputs)
    return errors.pair.evaluate_expression_on_reference(here, np.zeros(1), errors.decoupling)[0]
