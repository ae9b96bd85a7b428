"""Gains of the time-varying LQR: backward integration of the Riccati equation along a reference."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy

from gnc_opt.argument_checks import read_positive_number
from gnc_opt.array_types import Array
from gnc_opt.control.quadratic_cost import QuadraticCost, Weight, read_weight_matrix, require_semidefinite
from gnc_opt.control.reference_trajectory import Reference
from gnc_opt.control.riccati import (
    LqrSolution,
    compute_lqr_gain,
    solve_algebraic_riccati,
    step_riccati_backward,
)
from gnc_opt.control.sampled_data_discretization import (
    SampledStep,
    discretize_plant_and_cost,
    discretize_time_varying_plant,
)
from gnc_opt.control.tracking_error_dynamics import ErrorDynamics
from gnc_opt.errors import DesignError
from gnc_opt.numerical_tolerances import ROUNDING, SAME_TIME, STEP_SLACK, TINY


@dataclass(frozen=True, eq=False)
class ContinuousGains:
    """Gains of the Riccati differential equation; ``tail`` is K after ``final_time``."""

    reference: Reference
    deviation: ErrorDynamics
    r: Array
    n: Array
    pieces: tuple[tuple[float, float, Callable[[float], Array]], ...]
    """Start, end and dense output of P for each piece, in order of time."""
    terminal: Array
    tail: Array
    steady: LqrSolution | None

    def P(self, t: float) -> Array:
        """Return P (n_errors, n_errors) at t (s): ``e' P e`` is the cost to go."""
        if t >= self.reference.final_time or not self.pieces:
            steady = self.steady if t > self.reference.final_time else None
            return self.terminal if steady is None else steady.cost
        starts = [piece[0] for piece in self.pieces]
        k = max(int(np.searchsorted(starts, t, "right")) - 1, 0)
        return self.pieces[k][2](max(t, starts[0])).reshape(self.terminal.shape)

    def K(self, t: float) -> Array:
        """Return K (n_controls, n_errors) in ``u = u_ff - K e`` at t (s)."""
        if t >= self.reference.final_time:
            return self.tail
        b = self.deviation.linearize(t, self.reference.x(t), self.reference.u(t))[1]
        return compute_lqr_gain(np.zeros_like(self.terminal), b, self.r, self.n, self.P(t), sampled=False)


@dataclass(frozen=True, eq=False)
class SampledGains:
    """Gains of the discrete Riccati recursion, at multiples of dt (s) from the start of the reference."""

    initial_time: float
    dt: float
    steps: tuple[SampledStep, ...]
    """Plant and cost of each step; the last one also applies after the end."""
    gains: tuple[Array, ...]
    costs: tuple[Array, ...]
    """P at the start of each step and after the last."""
    tail: Array
    steady: LqrSolution | None

    def get_control_step_index(self, t: float) -> int:
        return max(int(np.floor((t - self.initial_time) / self.dt + STEP_SLACK)), 0)

    def P(self, t: float) -> Array:
        """Return P (n_errors, n_errors) at t (s): ``e' P e`` is the cost to go."""
        k = self.get_control_step_index(t)
        if k > len(self.gains) and self.steady is not None:
            return self.steady.cost
        return self.costs[min(k, len(self.gains))]

    def K(self, t: float) -> Array:
        """Return K (n_controls, n_errors) in ``u = u_ff - K e`` at t (s)."""
        k = self.get_control_step_index(t)
        return self.gains[k] if k < len(self.gains) else self.tail


Gains: TypeAlias = ContinuousGains | SampledGains


def compute_riccati_gains(
    deviation: ErrorDynamics,
    reference: Reference,
    cost: QuadraticCost,
    *,
    terminal: Weight | None = None,
    dt: float | None = None,
) -> Gains:
    """Return the gains along a reference, continuous or sampled with dt (s)."""
    end = None if terminal is None else _read_terminal_weight(terminal, deviation)
    if dt is not None:
        return _iterate_riccati_recursion(
            deviation, reference, cost, end, read_positive_number(dt, "the control step dt")
        )
    t_f = reference.final_time
    a, b = deviation.linearize(t_f, reference.x(t_f), reference.control_after_final_time)
    regulator = _design_terminal_lqr((a, b), cost, deviation, end, sampled=False)
    last = regulator.cost if end is None and regulator is not None else end
    assert last is not None
    tail = (
        regulator.gain
        if regulator is not None
        else compute_lqr_gain(a, b, cost.r, cost.n, last, sampled=False)
    )
    pieces = _integrate_riccati_equation(deviation, reference, cost, last)
    return ContinuousGains(reference, deviation, cost.r, cost.n, pieces, last, tail, regulator)


def _read_terminal_weight(terminal: Weight, deviation: ErrorDynamics) -> Array:
    weight = read_weight_matrix(terminal, deviation.errors, "the terminal weight")
    require_semidefinite(weight, deviation.errors.labels, "the terminal weight")
    return weight


def _design_terminal_lqr(
    plant: tuple[Array, Array],
    cost: QuadraticCost,
    deviation: ErrorDynamics,
    end: Array | None,
    *,
    sampled: bool,
) -> LqrSolution | None:
    """Return the steady regulator after the end; ``None`` if there is none but a terminal weight is given."""
    try:
        return solve_algebraic_riccati(*plant, *cost, deviation.errors.labels, sampled=sampled)
    except DesignError as error:
        if end is None:
            why = str(error).rstrip(".")
            raise DesignError(f"after the end of the reference {why}; or give a terminal weight.") from error
        return None


class _PlantMatrices:
    """A and B along a piece of a reference; one call for all times of an integration step takes a tenth of the time."""

    def __init__(self, deviation: ErrorDynamics, reference: Reference, start: float, end: float) -> None:
        self.deviation, self.reference, self.span = deviation, reference, (start, end)
        self._known: dict[float, tuple[Array, Array]] = {}

    def linearize(self, times: Array) -> None:
        """Evaluate the matrices at the times (n,) of the next step."""
        clipped = np.clip(times, *self.span)  # one-sided limit at jumps
        a, b = self.deviation.linearize_error_dynamics_at_times(
            clipped, self.reference.x(clipped), self.reference.u(clipped)
        )
        self._known = dict(zip(times.tolist(), zip(a, b, strict=True), strict=True))

    def get_plant_matrices_at_time(self, t: float) -> tuple[Array, Array]:
        """Return A and B at t (s); unexpected times, those of a rejected step, are evaluated one by one."""
        if t not in self._known:
            self.linearize(np.array([t]))
        return self._known[t]


def _integrate_riccati_equation(
    deviation: ErrorDynamics, reference: Reference, cost: QuadraticCost, last: Array
) -> tuple[tuple[float, float, Callable[[float], Array]], ...]:
    """Return the Riccati matrix backwards from ``last`` as (start, end, function of time) of each smooth interval."""
    q, r, n = cost
    inverse = np.linalg.inv(r)
    start, end = reference.initial_time, reference.final_time
    if end <= start:
        return ()
    edges = np.unique(np.clip(np.concatenate([[start, end], reference.jumps]), start, end))
    edges = edges[np.append(True, np.diff(edges) > ROUNDING * (end - start))]
    edges[-1] = end
    final, pieces = last.ravel(), []
    for left, right in reversed(list(itertools.pairwise(edges))):
        nudge = SAME_TIME * (right - left)
        plant = _PlantMatrices(deviation, reference, left + nudge, right - nudge)

        def evaluate_riccati_rate(t: float, y: Array, plant: _PlantMatrices = plant) -> Array:
            a, b = plant.get_plant_matrices_at_time(t)
            p = y.reshape(last.shape)
            half = b.T @ p + n.T
            flow = a.T @ p
            return -np.ravel(flow + flow.T - half.T @ inverse @ half + q)

        scale = max(float(np.max(np.abs(final))), TINY)
        solver = scipy.integrate.DOP853(
            evaluate_riccati_rate, right, final, left, rtol=1e-11, atol=1e-13 * scale
        )
        times, parts, message = [right], [], ""
        while solver.status == "running":
            step = max(left, solver.t - solver.h_abs) - solver.t
            plant.linearize(solver.t + step * np.append(solver.C, solver.C_EXTRA))
            message = solver.step() or ""
            times.append(solver.t)
            parts.append(solver.dense_output() if solver.status != "failed" else None)
        if solver.status == "failed" or not np.all(np.isfinite(solver.y)):
            raise DesignError(
                f"the Riccati equation cannot be continued before {solver.t:.6g} s ({message}): choose "
                "smaller weights of errors or larger weights of controls."
            )
        pieces.append((float(left), float(right), scipy.integrate.OdeSolution(times, parts)))
        final = solver.y
    return tuple(reversed(pieces))


def _iterate_riccati_recursion(
    deviation: ErrorDynamics, reference: Reference, cost: QuadraticCost, end: Array | None, dt: float
) -> SampledGains:
    t_0, t_f = reference.initial_time, reference.final_time
    a, b = deviation.linearize(t_f, reference.x(t_f), reference.control_after_final_time)
    resting = discretize_plant_and_cost(a, b, *cost, dt)
    regulator = _design_terminal_lqr(
        (resting.a, resting.b), QuadraticCost(resting.q, resting.r, resting.n), deviation, end, sampled=True
    )
    p = regulator.cost if end is None and regulator is not None else end
    assert p is not None
    count = int(np.ceil((t_f - t_0) / dt - STEP_SLACK))

    def linearize_plant_within_control_step(times: Array) -> tuple[Array, Array]:
        after_end, within = times > t_f, np.minimum(times, t_f)
        u = np.where(after_end, reference.control_after_final_time[:, None], reference.u(within))
        return deviation.linearize_error_dynamics_at_times(within, reference.x(within), u)

    steps = [
        discretize_time_varying_plant(
            linearize_plant_within_control_step, *cost, t_0 + k * dt, dt, np.append(reference.jumps, t_f)
        )
        for k in range(count)
    ]
    gains, costs = [], [p]
    for step in reversed(steps):
        gain, p = step_riccati_backward(step, p)
        gains.append(gain)
        costs.append(p)
    tail = (
        regulator.gain if regulator is not None else gains[0] if gains else np.zeros((b.shape[1], a.shape[0]))
    )
    ordered = tuple(reversed(gains)), tuple(reversed(costs))
    return SampledGains(t_0, dt, (*steps, resting), *ordered, tail, regulator)
