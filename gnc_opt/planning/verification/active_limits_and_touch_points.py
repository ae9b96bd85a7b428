r"""Active state limits in the Lagrangian of a shifted trajectory (module `switching_time_variations`).

A limit with a touch point at :math:`t_k` and the multiplier :math:`\eta`, the costate jump along its gradient,
adds :math:`\eta \max_t g(t, x(t))`. The touch point moves with the trajectory: if g changes by :math:`\Delta g` and its
rate by :math:`\Delta\dot g` at :math:`t_k`, its maximum changes to second order by

.. math:: \Delta g - \frac{\Delta\dot g^2}{2 \ddot g}

with :math:`\ddot g` on the side to which the touch point moves (Hermant, SIAM J. Control Optim. 48(3), 2009, for
second-order limits).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.array_types import Array, Mask
from gnc_opt.numerical_tolerances import NEGLIGIBLE, SMALL
from gnc_opt.planning.optimality.active_state_constraints import StateConstraints
from gnc_opt.planning.problem.hamiltonian_functions import PhaseFunctions
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.state_constraint_order import get_constraint_order
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples

ACTIVE_LIMIT_TIMES = 24
"""Largest number of times per phase at which limits active along arcs are imposed."""


def find_costate_jumps(s: PhaseSamples) -> dict[float, Array]:
    """Return the costate jumps (n,) that affect the cost, by time."""
    inner = s.phase.breaks[1:-1]
    jumps = s.phase.lam(inner, "left") - s.phase.lam(inner, "right")
    sizes = np.max(np.abs(jumps) * s.state_scale[:, None], axis=0)
    large = sizes > NEGLIGIBLE * s.cost_scale
    return {float(t): jump for t, jump in zip(inner[large], jumps.T[large], strict=True)}


def compute_touch_point_lagrangian(
    problem: Problem, s: PhaseSamples, functions: PhaseFunctions, time: float, jump: Array, x: Array
) -> Array:
    """Return the change of the Lagrangian due to a costate jump (n,), for states (n, n_columns) at its time.

    ``functions`` contain the parameters of each column; the last column is the reference trajectory. The part
    of the jump that no active limit explains is multiplied by the change of the states.
    """
    rows, n_columns = StateConstraints(problem, s), x.shape[1]
    shifted = StateConstraints(problem, replace(s, functions=functions))
    t, change = np.full(n_columns, time), x - x[:, -1:]
    before, after = (
        np.repeat(s.phase.applied(time, side)[:, None], n_columns, axis=1) for side in ("left", "right")
    )
    values = shifted.evaluate_constraints(t, x, after)
    at_limit = np.any(rows.is_near_limits(values)[..., -1], axis=0)
    active = [int(i) for i in np.flatnonzero(at_limit) if rows.get_order_of_constraint_contact(int(i))]
    by_path = functions.path_state_jacobian(t, x, after)[..., -1]
    gradients = np.concatenate([by_path, np.eye(len(x))])[active]
    multipliers = np.linalg.lstsq((gradients * s.state_scale).T, jump * s.state_scale, rcond=None)[0]
    lagrangian = (jump - multipliers @ gradients) @ change
    for i, eta in zip(active, multipliers, strict=True):
        lagrangian += eta * (values[i] - values[i, -1])
        if rows.get_order_of_constraint_contact(i) < 2:
            continue
        slope = shifted.evaluate_time_derivative(i, 1, t, x, after)
        slope -= slope[-1]
        second_rate = np.where(
            eta * slope > 0, *(shifted.evaluate_time_derivative(i, 2, t, x, u) for u in (after, before))
        )
        if np.all(-np.sign(eta) * second_rate * s.span**2 > SMALL * rows.row_scales[i]):
            lagrangian -= eta * slope**2 / (2 * second_rate)
    return np.asarray(lagrangian)


def mask_limits_with_multipliers(s: PhaseSamples, times: Array) -> Mask:
    """Return whether path constraints and state bounds affect the cost at times (n_rows, n_times), in this order."""
    density = np.vstack([s.phase.path_multiplier(times), s.phase.state_multiplier(times)])
    scale = np.concatenate([s.path_scale, s.state_scale])[:, None]
    return np.asarray(np.abs(density) * scale * s.span > NEGLIGIBLE * s.cost_scale)


def mask_controls_set_by_active_limits(problem: Problem, s: PhaseSamples, times: Array) -> Mask:
    """Return whether an active path constraint or state limit determines each control (m, n_times)."""
    mask = np.zeros((s.phase.controls.size, times.size), dtype=bool)
    for row, active in enumerate(mask_limits_with_multipliers(s, times)):
        if np.any(active):
            mask[list(get_constraint_order(problem, problem.phases[s.phase.name], row).controls)] |= active
    return mask


def evaluate_active_limit_gradients(s: PhaseSamples, edges: Array) -> dict[float, list[Array]]:
    """Return the gradients (n,) of limits active along arcs at cell edges, scaled by their effect on the cost."""
    times = edges[1:-1]
    times = times[:: max(1, times.size // ACTIVE_LIMIT_TIMES)]
    if not times.size or not np.any(active := mask_limits_with_multipliers(s, times)):
        return {}
    phase, by_time = s.phase, {}
    units = np.repeat(np.eye(phase.states.size)[:, :, None], times.size, axis=2)
    by_path = s.functions.path_state_jacobian(times, phase.x(times), phase.applied(times))
    density = np.vstack([phase.path_multiplier(times), phase.state_multiplier(times)])
    gradients = np.concatenate([by_path, units]) * (s.span / s.cost_scale * density)[:, None]
    for k in np.flatnonzero(np.any(active, axis=0)):
        by_time[float(times[k])] = list(gradients[active[:, k], :, k])
    return by_time
