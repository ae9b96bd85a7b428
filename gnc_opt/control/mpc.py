r"""Linear model predictive control: a quadratic program (QP) at every step, linearised along the reference.

Over N steps, :math:`e_{j+1} = A_j e_j + B_j v_j`, :math:`u_j = u_{ff,j} + v_j`, with plant and cost sampled exactly.
With :math:`v_j = -K_j e_j + w_j`, K of the Riccati recursion, the cost is a sum of squares,

.. math:: e_0^T P_0 e_0 + \sum_j w_j^T S_j w_j, \qquad S_j = R_j + B_j^T P_{j+1} B_j = L_j L_j^T,

and the QP for :math:`\omega_j = L_j^T w_j` has the point of least norm within the limits as its solution. If no limit
is active, :math:`\omega = 0` and no solver is called. Limits of controls and rates are hard; those of states are soft
(exact penalty) unless named hard. If the solver fails, the law clips the regulator's command and raises an alarm.

Sources: J. B. Rawlings, D. Q. Mayne, M. M. Diehl, Model Predictive Control, 2nd ed. (2017), sec. 1.3, 2.5.
J. A. Rossiter, B. Kouvaritakis, M. J. Rice, A numerically robust state-space approach to stable-predictive control
strategies, Automatica 34 (1998): the change of variables.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_optional_mapping, read_positive_number, suggest_keywords
from gnc_opt.array_types import Array
from gnc_opt.control.active_set_qp_c_code import (
    QpCode,
    build_mpc_law_for_c_export,
    build_mpc_memory_layout,
    clip_command_and_rate,
)
from gnc_opt.control.control_limits_and_authority import (
    Limits,
    clip_to_limits,
    read_control_limits,
    report_control_authority,
    report_reference_limit_violation,
)
from gnc_opt.control.design_report import DesignReport, ReportEntry
from gnc_opt.control.discrete_time_controller import Controller, initial_state_function, law_function
from gnc_opt.control.feedforward_and_reference_schedule import (
    ReferenceSchedule,
    build_reference_signal_layout,
)
from gnc_opt.control.lqr import report_regulator_poles_and_margins
from gnc_opt.control.measurement_dropouts import with_dropout_handling
from gnc_opt.control.mpc_horizon_qp import PredictionHorizon, StepLimits
from gnc_opt.control.quadratic_cost import Weight, read_quadratic_cost, report_quadratic_cost
from gnc_opt.control.reference_trajectory import Reference, read_design_reference
from gnc_opt.control.riccati import step_riccati_backward
from gnc_opt.control.tracking_error_dynamics import ErrorDynamics
from gnc_opt.control.tvlqr_gains import SampledGains, compute_riccati_gains
from gnc_opt.errors import ArgumentError, DesignError, quote_value, unknown_name_error
from gnc_opt.model.model_variables import Layout, Variable, read_vector
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.numerical_tolerances import ROUNDING, SAME_TIME, STEP_SLACK, are_jacobians_equal
from gnc_opt.threads_and_package_versions import limit_to_one_thread

QP_TOLERANCE = 1e-6
"""Largest residual of the optimality conditions of a solved QP, with limits scaled to [-1, 1]."""

_HORIZON_MAX_STEPS = 500
"""Largest number of steps of a horizon; each step has its own matrices and unknowns."""

_DAQP = {"primal_tol": 1e-11, "dual_tol": 1e-12}


@limit_to_one_thread()
@suggest_keywords
def design_mpc(
    model: Model,
    reference: Reference | ArrayLike,
    *,
    Q: Weight,
    R: Weight,
    horizon: float,
    dt: float,
    limits: Limits,
    rate_limits: ArrayLike | None = None,
    state_limits: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
    hard: Sequence[str] = (),
    N: ArrayLike | None = None,
    state_penalty: float = 1e3,
    name: str = "MPC",
) -> Controller:
    """Return a model predictive controller that follows a reference within limits.

    Parameters
    ----------
    model : Model
    reference : Reference or array (n_states,)
        A state is regulated with its trim control.
    Q, R, N
        As in `design_lqr`; the cost is sampled exactly.
    horizon : float
        Length of the horizon, s, a whole number of control steps.
    dt : float
        Control step, s.
    limits : (lower, upper)
        Limits of the controls, finite.
    rate_limits : float or array (n_controls,), optional
        Largest change of each control per second.
    state_limits : mapping, optional
        ``{"v_L": (lower, upper)}``, enforced at the steps; may be infinite. Soft, unless named in ``hard``.
    hard : sequence of str
        States with hard limits; if they cannot be satisfied, the alarm is raised.
    state_penalty : float
        Penalty of violating a state limit by half its range, relative to the cost to go of an error of that size.
    name : str

    Returns
    -------
    Controller
        Memory ``previous_command`` and the alarm ``qp_failed``.

    Raises
    ------
    DesignError
        As in `design_tvlqr`; limits that are empty, exclude the feedforward or apply to a rotation.

    Warns
    -----
    ProblemWarning
        The reference violates limits of states.

    Examples
    --------
    >>> law = go.design_mpc(
    ...     cart, [0.0, 0.0], Q=1, R=1, horizon=1.0, dt=0.1, limits=(-0.2, 0.2)
    ... )
    >>> u, _ = law(0.0, [1.0, 0.0])
    >>> print(np.round(u, 6))
    [-0.2]
    """
    reference = read_design_reference(model, reference, "design_mpc")
    limited = read_optional_mapping(state_limits, "state_limits of design_mpc()", 'write {"v": (-1.0, 1.0)}')
    dt = read_positive_number(dt, "the control step dt")
    count = _read_horizon_length(read_positive_number(horizon, "the horizon"), dt)
    deviation = ErrorDynamics(model)
    cost = read_quadratic_cost(model, Q, R, N)
    gains = compute_riccati_gains(deviation, reference, cost, dt=dt)
    assert isinstance(gains, SampledGains)
    bounds = read_control_limits(model, limits)
    if bounds is None:
        raise ArgumentError("design_mpc() has no limits of the controls: give (lower, upper).")
    if not np.all(np.isfinite(bounds)):  # the QP is scaled by their range
        raise ArgumentError(
            f"the limits of design_mpc() are {quote_value(limits)}: give finite limits, "
            "larger than any command if a control has none."
        )
    penalty = read_positive_number(state_penalty, "the state penalty") * np.diag(gains.costs[-1])
    margin = report_control_authority(reference, bounds, required=True)
    change = None if rate_limits is None else _read_command_rate_limits(rate_limits, model, dt)
    in_x, in_e, *of_states = _read_state_limits(deviation, limited, hard, penalty)
    rows = StepLimits(*bounds, change, in_x, in_e, *of_states)
    violation = report_reference_limit_violation(reference, rows.states, rows.state_lower, rows.state_upper)
    windows = _LtvModel(gains, count)
    schedule = _HorizonSchedule(ReferenceSchedule(reference), windows, rows.states)
    signals = build_reference_signal_layout(reference, *schedule.list_reference_preview_variables())
    law_ = _MpcLaw(deviation, schedule, rows, signals)
    plain = Controller(
        name=name,
        step=law_.build_mpc_law(),
        unconstrained_law=law_.build_mpc_law(unconstrained=True),
        start=law_.build_initial_command_function(),
        states=model.states,
        commands=model.controls,
        signals=signals,
        memory=build_mpc_memory_layout(model.controls.size),
        schedule=schedule,
        dt=dt,
        alarms=("qp_failed",),
        span=(reference.initial_time, reference.final_time),
        explanation=DesignReport(
            f"{name} of '{model.name}'",
            (
                *report_quadratic_cost(cost, reference),
                *_report_mpc_design(gains, windows, rows, model.states),
                *violation,
                *margin,
            ),
        ),
    )
    code = _build_horizon_qp_code(windows, rows, model)
    return with_dropout_handling(
        replace(plain, codegen_law=build_mpc_law_for_c_export(code, deviation, plain, reference))
    )


@dataclass(frozen=True, eq=False)
class _LtvModel:
    """Linear dynamics over a horizon from a given step: A - B K, B L^-T, K, L^-T, (N, ., .) each."""

    gains: SampledGains
    count: int

    @property
    def is_time_invariant(self) -> bool:
        """Whether all steps of the reference have the same matrices."""
        last = self.gains.steps[-1]
        return all(
            are_jacobians_equal(s.a, last.a) and are_jacobians_equal(s.b, last.b) for s in self.gains.steps
        )

    def __call__(self, first: int) -> tuple[Array, Array, Array, Array]:
        steps, costs = self.gains.steps, self.gains.costs
        p = costs[min(first + self.count, len(costs) - 1)]
        stages = []
        for k in reversed(range(first, first + self.count)):
            s = steps[min(k, len(steps) - 1)]
            weight = s.r + s.b.T @ p @ s.b
            gain, p = step_riccati_backward(s, p)
            root = np.linalg.inv(np.linalg.cholesky(weight)).T
            stages.append((s.a - s.b @ gain, s.b @ root, gain, root))
        a, f, k_, g = (np.stack(matrices) for matrices in zip(*reversed(stages), strict=True))
        return a, f, k_, g


@dataclass(frozen=True, eq=False)
class _HorizonSchedule:
    """Rows: x_ref, mean controls and limited states over the horizon, and the dynamics if they vary."""

    reference: ReferenceSchedule
    windows: _LtvModel
    limited: tuple[int, ...]

    def list_reference_preview_variables(self) -> list[Variable]:
        """Return the additional variables after those of the reference."""
        gains, count = self.windows.gains, self.windows.count
        n, m = gains.steps[-1].b.shape
        sizes = {"horizon_ff": m * (count - 1), "horizon_ref": len(self.limited) * count}
        if not self.windows.is_time_invariant:
            sizes |= {"horizon_A": count * n * n, "horizon_F": count * n * m, "horizon_K": count * m * n}
            sizes |= {"horizon_G": count * m * m}
        return [Variable(name, size) for name, size in sizes.items() if size]

    def __call__(self, times: Array, dt: float) -> Array:
        times, count = np.atleast_1d(times), self.windows.count
        grid = times[:, None] + dt * np.arange(count + 1)
        _, first, back = np.unique(np.round(grid / dt / STEP_SLACK), return_index=True, return_inverse=True)
        here = grid.ravel()[first]  # every time once, since horizons overlap
        reference = self.reference.reference
        u = reference.mean_control(here, dt)[:, back.reshape(grid.shape)]
        x = reference.x(here)[:, back.reshape(grid.shape)]
        rows = [x[:, :, 0], *(u[:, :, j] for j in range(count))]
        rows += [x[list(self.limited), :, j] for j in range(1, count + 1) if self.limited]
        if not self.windows.is_time_invariant:
            numbers = [self.windows.gains.get_control_step_index(float(t)) for t in times]
            columns = [np.concatenate([m.ravel() for m in self.windows(k)]) for k in numbers]
            rows.append(np.stack(columns, axis=1))
        return np.vstack(rows)


@dataclass(frozen=True, eq=False)
class _MpcLaw:
    """MPC law in MX; the unconstrained law is valid where the regulator satisfies all limits."""

    deviation: ErrorDynamics
    schedule: _HorizonSchedule
    rows: StepLimits
    signals: Layout

    def build_mpc_law(self, *, unconstrained: bool = False) -> Any:
        """Return the law ``(t, x, r, z) -> (u, z_next)``; the unconstrained law has a validity flag as third output."""
        t, x, r, z = self._create_mpc_law_symbols()
        e, u_ff, x_limited, matrices, previous, alarm = self._split_mpc_law_inputs(x, r, z)
        m, data = self.rows.lower.size, (e, u_ff, x_limited, matrices, previous)
        within_limits = self._build_horizon_qp_function(
            "inside", ca.SX, lambda horizon, *a: [horizon.is_unconstrained_regulator_feasible(*a)]
        )(*data)
        omega, solved = ca.MX.zeros(m), within_limits
        if not unconstrained:
            keep = self._build_horizon_qp_function("keep", ca.MX, lambda *_: [ca.MX.zeros(m), ca.MX(1)])
            solve = ca.Function.if_else(
                "either", keep, self._build_horizon_qp_function("solve", ca.MX, self._solve_horizon_qp)
            )
            omega, solved = solve(within_limits, *data)  # evaluates only one branch
        _, _, k, g = (parts[0] for parts in _compute_closed_loop_matrices(self.schedule, matrices))
        u = clip_command_and_rate(u_ff[:m] - k @ e + g @ ca.if_else(solved, omega, 0), previous, self.rows)
        after = ca.vertcat(u, ca.if_else(solved, alarm, 1))
        return law_function(t, x, r, z, u, after, *([solved] if unconstrained else []))

    def build_initial_command_function(self) -> Any:
        """Return the function of the initial memory: the feedforward, clipped to its limits."""
        t, x, r, z = self._create_mpc_law_symbols()
        m, u_ff = self.rows.lower.size, self._split_mpc_law_inputs(x, r, z)[1]
        first = clip_to_limits(u_ff[:m], self.rows.lower, self.rows.upper)
        return initial_state_function(t, x, r, ca.vertcat(first, 0))

    def _create_mpc_law_symbols(self) -> tuple[Any, Any, Any, Any]:
        sizes = (1, self.deviation.model.states.size, self.signals.size, self.rows.lower.size + 1)
        t, x, r, z = (ca.MX.sym(name, size) for name, size in zip("txrz", sizes, strict=True))
        return t, x, r, z

    def _split_mpc_law_inputs(self, x: Any, r: Any, z: Any) -> list[Any]:
        """Return e, feedforward and limited states over the horizon, its matrices, previous command and alarm."""
        states, m = x.shape[0], self.rows.lower.size
        count, limited = self.schedule.windows.count, len(self.schedule.limited)
        edges = [0, states, states + m * count, states + (m + limited) * count, r.shape[0]]
        x_ref, *horizon_data = ca.vertsplit(r, edges)
        sx, sx_ref = ca.SX.sym("x", states), ca.SX.sym("x_ref", states)
        error = ca.Function("e", [sx, sx_ref], [self.deviation.state_error_expression(sx, sx_ref)])
        return [error(x, x_ref), *horizon_data, *ca.vertsplit(z, [0, m, m + 1])]

    def _build_horizon_qp_function(self, name: str, kind: Any, outputs: Callable[..., list[Any]]) -> Any:
        """Return the function of the horizon and the symbolic arguments of its QP."""
        count, (n, m) = self.schedule.windows.count, self.schedule.windows.gains.steps[-1].b.shape
        rest = 0 if self.schedule.windows.is_time_invariant else count * (n + m) ** 2
        sizes = (n, m * count, len(self.schedule.limited) * count, rest, m)
        e, u_ff, x_limited, matrices, previous = arguments = [kind.sym("i", size) for size in sizes]
        horizon = PredictionHorizon(self.rows, _compute_closed_loop_matrices(self.schedule, matrices))
        return ca.Function(name, arguments, outputs(horizon, e, u_ff, x_limited, previous))

    def _solve_horizon_qp(self, horizon: PredictionHorizon, *known: Any) -> list[Any]:
        """Return the first unknowns of the QP solution, and whether it satisfies the optimality conditions."""
        task = horizon.build_horizon_qp(*known)
        one = ca.DM.eye(horizon.n_qp_variables)
        shape = {"h": one.sparsity(), "a": task.a.sparsity()}
        unbounded = np.full(horizon.n_qp_variables, -np.inf)
        unbounded[task.free :] = 0  # slacks are >= 0
        solver = ca.conic("qp", "daqp", shape, {"daqp": _DAQP, "error_on_fail": False})
        answer = solver(h=one, g=task.g, a=task.a, lba=task.low, uba=task.high, lbx=unbounded)
        solved = task.compute_kkt_residual(answer["x"], answer["lam_a"], answer["lam_x"]) <= QP_TOLERANCE
        return [answer["x"][: self.rows.lower.size], solved]


def _build_horizon_qp_code(windows: _LtvModel, rows: StepLimits, model: Model) -> QpCode:
    """Return the QP for C export, with the matrices of every step of the reference."""
    last = len(windows.gains.steps) - 1
    firsts = [last + windows.count] if windows.is_time_invariant else range(last + 1)
    found = [windows(k) for k in firsts]
    parts = [np.concatenate([w[i][:1] for w in found]) for i in range(4)]
    return QpCode(rows, rows.penalty_square_roots, tuple(parts), windows.count, model.states.size)


def _compute_closed_loop_matrices(schedule: _HorizonSchedule, r: Any) -> list[list[Any]]:
    """Return A - B K, B L^-T, K, L^-T of each step, constant or from the end of the schedule row."""
    windows, place = schedule.windows, 0
    if windows.is_time_invariant:
        last = len(windows.gains.steps) - 1 + windows.count
        return [[ca.DM(matrix) for matrix in matrices] for matrices in windows(last)]
    n, m = windows.gains.steps[-1].b.shape
    found = []
    for height, width in ((n, n), (n, m), (m, n), (m, m)):
        parts = []
        for _ in range(windows.count):
            parts.append(ca.reshape(r[place : place + height * width], width, height).T)
            place += height * width
        found.append(parts)
    return found


def _read_horizon_length(horizon: float, dt: float) -> int:
    count = round(horizon / dt)
    if count < 1 or not np.isclose(count * dt, horizon, rtol=SAME_TIME):
        raise ArgumentError(
            f"a horizon of {horizon:g} s is no whole number of steps of {dt:g} s: give k * dt, k >= 1."
        )
    if count > _HORIZON_MAX_STEPS:
        raise ArgumentError(
            f"a horizon of {horizon:g} s has {count} steps of {dt:g} s: give {_HORIZON_MAX_STEPS} at most."
        )
    return count


def _read_command_rate_limits(value: ArrayLike, model: Model, dt: float) -> Array:
    rates = read_vector(value, model.controls.size, "the rate limits", ArgumentError)
    low = np.flatnonzero(~(rates > 0))
    if low.size:
        raise DesignError(
            f"the rate limit of control '{model.controls.labels[low[0]]}' is {rates[low[0]]:g}: give a number > 0."
        )
    return rates * dt


def _is_state_error_simple_difference(deviation: ErrorDynamics, name: str) -> bool:
    """Return whether the error of a state is x - x_ref, tested at a generic point."""
    states, rows = deviation.model.states, deviation.model.states.slice(name)
    x, x_ref = np.cos(1.0 + np.arange(states.size)), np.sin(2.0 + np.arange(states.size))
    e = deviation(x, x_ref)[deviation.errors.slice(name)]
    return e.size == states[name].size and np.allclose(e, (x - x_ref)[rows], rtol=ROUNDING, atol=ROUNDING)


def _read_state_limits(
    deviation: ErrorDynamics,
    limits: Mapping[str, tuple[ArrayLike, ArrayLike]],
    hard: Sequence[str],
    penalty: Array,
) -> tuple[tuple[int, ...], tuple[int, ...], Array, Array, Array]:
    """Return the indices of the limited states in x and in e, their limits and the weights of their errors."""
    model = deviation.model
    in_x: list[int] = []
    in_e: list[int] = []
    lower: list[float] = []
    upper: list[float] = []
    penalties: list[float] = []
    if isinstance(hard, str) or not isinstance(hard, Sequence):
        raise ArgumentError(f"hard of design_mpc() is {quote_value(hard)}: give a list of states.")
    for name in hard:
        if name not in limits:
            raise unknown_name_error("limited state", name, "state_limits", limits)
    for name, pair in limits.items():
        place = model.states.slice(name)
        size = model.states[name].size
        if not _is_state_error_simple_difference(deviation, name):
            raise DesignError(
                f"the error of state '{name}' is not a difference: its limits are not linear; use Q instead."
            )
        if not isinstance(pair, Sequence | np.ndarray) or len(pair) != 2:
            raise ArgumentError(f"the limits of state '{name}' are {quote_value(pair)}: give (lower, upper).")
        low, high = (read_vector(v, size, f"the limits of state '{name}'", ArgumentError) for v in pair)
        if not np.all(low < high):
            raise DesignError(f"the limits of state '{name}' are empty: {low} to {high}; give lower < upper.")
        in_x += range(model.states.size)[place]
        in_e += range(model.errors.size)[model.errors.slice(name)]
        lower += list(low)
        upper += list(high)
        place = model.errors.slice(name)
        penalties += [np.inf] * size if name in hard else list(penalty[place])
    return tuple(in_x), tuple(in_e), np.array(lower), np.array(upper), np.array(penalties)


def _report_mpc_design(
    gains: SampledGains, windows: _LtvModel, rows: StepLimits, states: Layout
) -> list[ReportEntry]:
    m, count = rows.lower.size, windows.count
    size, limits = (m + len(rows.soft_limited_states)) * count, rows.n_constraints_per_step * count
    remark = f"{size} unknowns, {limits} rows"
    first = windows(0)
    facts = [
        ReportEntry("horizon", count * gains.dt, "s", f"{count} steps; {remark}"),
        *_report_hard_and_soft_state_limits(rows, states),
        ReportEntry(
            "dynamics along the horizon", "constant" if windows.is_time_invariant else "from the schedule"
        ),
        ReportEntry("gain at the start", first[2][0], "", "K of the first command where no limit is met"),
    ]
    if gains.steady is not None:
        last = gains.steps[-1]
        remark = "without limits, after the end; slowest first"
        facts += report_regulator_poles_and_margins(gains.steady, (last.a, last.b), gains.dt, remark=remark)
    return facts


def _report_hard_and_soft_state_limits(rows: StepLimits, states: Layout) -> list[ReportEntry]:
    soft = [states.labels[rows.states[i]] for i in rows.soft_limited_states]
    hard = [states.labels[place] for i, place in enumerate(rows.states) if i not in rows.soft_limited_states]
    rates = ["rates of controls"] if rows.change is not None else []
    facts = [ReportEntry("hard limits", ", ".join(["controls", *rates, *hard]), remark="satisfied, or alarm")]
    return facts + (
        [ReportEntry("soft limits", ", ".join(soft), remark="violated as little as possible")] if soft else []
    )
