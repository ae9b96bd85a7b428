r"""Model predictive control: a quadratic programme at every step, linear along the reference.

Over N steps, :math:`e_{j+1} = A_j e_j + B_j v_j`, :math:`u_j = u_{ff,j} + v_j`, with plant and cost sampled exactly.
With :math:`v_j = -K_j e_j + w_j`, K of the Riccati recursion, the cost is a sum of squares,

.. math:: e_0^T P_0 e_0 + \sum_j w_j^T S_j w_j, \qquad S_j = R_j + B_j^T P_{j+1} B_j = L_j L_j^T,

and the programme for :math:`\omega_j = L_j^T w_j` finds the point of least norm within the limits. Without an active
limit :math:`\omega = 0`, and no solver is called. Limits of controls and rates are hard; those of states are soft
(exact penalty) unless named hard. If the solver fails, the law clips the regulator's command and raises an alarm.

Sources: J. B. Rawlings, D. Q. Mayne, M. M. Diehl, Model Predictive Control, 2nd ed. (2017), sec. 1.3, 2.5.
J. A. Rossiter, B. Kouvaritakis, M. J. Rice, A numerically robust state-space approach to stable-predictive control
strategies, Automatica 34 (1998): the change of variables.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias, get_args

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_mapping, read_positive, suggesting_keywords
from gnc_opt.arrays import Array
from gnc_opt.control.active_set_qp import ProgrammeCode, flight_law
from gnc_opt.control.control_limits import (
    Limits,
    clip,
    read_limits,
    reference_beyond,
    require_reserve,
    reserve_shares,
)
from gnc_opt.control.controller import Controller, initial_state_function, law
from gnc_opt.control.design_report import DesignReport, ReportEntry
from gnc_opt.control.dropout import with_dropout_handling
from gnc_opt.control.error_dynamics import ErrorDynamics
from gnc_opt.control.feedforward import ReferenceSchedule, reference_signals, reference_times
from gnc_opt.control.horizon_qp import Horizon, Rows
from gnc_opt.control.lqr import regulator_facts
from gnc_opt.control.quadratic_cost import Weight, read_cost, read_weight, require_semidefinite
from gnc_opt.control.reference import Reference, read_plant
from gnc_opt.control.riccati import gain_of
from gnc_opt.control.tvlqr_gains import SampledGains, riccati_gains
from gnc_opt.environment import one_thread
from gnc_opt.errors import ArgumentError, DesignError, did_you_mean, shown, unknown_name
from gnc_opt.model.model import Model
from gnc_opt.model.variables import Layout, Variable, as_vector
from gnc_opt.tolerances import ROUNDING, SAME_TIME, STEP_SLACK, alike

QpSolver: TypeAlias = Literal["piqp", "osqp", "daqp"]


QP_TOLERANCE = 1e-6
"""Largest residual of the optimality conditions, limits scaled to [-1, 1], that counts as solved."""

_HORIZON_MAX_STEPS = 2000
"""Of a horizon: their matrices are designed one by one, and a programme has unknowns for each."""

_PIQP = {"eps_abs": 1e-13, "eps_rel": 1e-13, "eps_duality_gap_abs": 1e-13, "eps_duality_gap_rel": 1e-13}
_PIQP |= {"delta_init": 1e-8}  # its own 1e-4 holds large multipliers back, until they pass for infeasible
_OPTIONS: dict[str, dict[str, Any]] = {
    "piqp": {"piqp": {"verbose": False, **_PIQP}},
    "daqp": {"daqp": {"primal_tol": 1e-9, "dual_tol": 1e-9}},
    "osqp": {"osqp": {"verbose": False, "eps_abs": 1e-8, "eps_rel": 1e-8, "max_iter": 20000, "polish": True}},
}


@one_thread()
@suggesting_keywords
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
    terminal: Weight | Literal["riccati"] = "riccati",
    state_penalty: float = 1e3,
    solver: QpSolver | None = None,
    name: str = "MPC",
) -> Controller:
    """Return a model predictive controller that follows a reference within limits.

    Parameters
    ----------
    model : Model
    reference : Reference or array (n_states,)
        A state is kept, with the control that does so.
    Q, R, N
        As in `design_lqr`; sampled exactly.
    horizon : float
        s, a whole number of control steps.
    dt : float
        Control step, s.
    limits : (lower, upper)
        Of the controls.
    rate_limits : float or array (n_controls,), optional
        Largest change of each control per second.
    state_limits : mapping, optional
        ``{"v_L": (lower, upper)}``, at the steps; may be infinite. Soft, unless named in ``hard``.
    hard : sequence of str
        States whose limits are hard: if they cannot be kept, the alarm is raised.
    terminal : weight or "riccati"
        Of the errors at the end of the horizon; ``"riccati"`` is the cost to go of the (time-varying) regulator.
    state_penalty : float
        Price of leaving a state limit by half its range, relative to the cost to go of an error as large.
    solver : {"piqp", "osqp", "daqp"}, optional
        Interior-point, operator-splitting or dual active-set method. Default: "piqp" with limited states, else
        "daqp".
    name : str

    Returns
    -------
    Controller
        Memory ``previous_command``, ``plan``, ``multipliers`` (warm start) and the alarm ``qp_failed``.

    Raises
    ------
    DesignError
        As in `design_tvlqr`; limits that are empty, exclude the feedforward or are of a rotation.

    Warns
    -----
    ProblemWarning
        Limits of states exclude the reference.

    Examples
    --------
    >>> law = go.design_mpc(
    ...     cart, [0.0, 0.0], Q=1, R=1, horizon=1.0, dt=0.1, limits=(-0.2, 0.2)
    ... )
    >>> u, _ = law(0.0, [1.0, 0.0])
    >>> print(np.round(u, 6))
    [-0.2]
    """
    reference = read_plant(model, reference, "design_mpc")
    limited = read_mapping(state_limits, "state_limits of design_mpc()", 'write {"v": (-1.0, 1.0)}')
    solver = solver or ("piqp" if limited else "daqp")
    if solver not in get_args(QpSolver):
        raise ArgumentError(
            f"there is no QP solver {shown(solver)}: {did_you_mean(str(solver), get_args(QpSolver))}"
        )
    dt = read_positive(dt, "the control step dt")
    count = _steps(read_positive(horizon, "the horizon"), dt)
    deviation = ErrorDynamics(model)
    gains = riccati_gains(deviation, reference, read_cost(model, Q, R, N), dt=dt)
    assert isinstance(gains, SampledGains)
    bounds = read_limits(model, limits)
    if bounds is None:
        raise ArgumentError("design_mpc() has no limits of the controls: give (lower, upper).")
    if not np.all(np.isfinite(bounds)):  # the programme is scaled by their range
        raise ArgumentError(
            f"the limits of design_mpc() are {shown(limits)}: give finite ones, beyond what is ever commanded where "
            "there is none."
        )
    end = None
    if not isinstance(terminal, str):
        end = read_weight(terminal, model.errors, "the terminal weight")
        require_semidefinite(end, model.errors.labels, "the terminal weight")
    elif terminal != "riccati":
        raise ArgumentError(f'terminal is {shown(terminal)}: write "riccati" or give a weight.')
    price = read_positive(state_penalty, "the state penalty") * np.diag(gains.costs[-1])
    require_reserve(reference, bounds, reference_times(reference))
    change = None if rate_limits is None else _rates(rate_limits, model, dt)
    in_x, in_e, *of_states = _state_rows(deviation, limited, hard, price)
    rows = Rows(*bounds, change, in_x, in_e, *of_states)
    beyond = reference_beyond(reference, rows.states, rows.state_lower, rows.state_upper)
    windows = _Windows(gains, count, end)
    schedule = _Schedule(ReferenceSchedule(reference), windows, rows.states)
    signals = reference_signals(reference, *schedule.more())
    step, start, memory = _law(deviation, schedule, rows, signals, solver)
    easy = _law(deviation, schedule, rows, signals, solver, easy=True)[0]
    plain = Controller(
        name=name,
        step=step,
        easy=easy,
        start=start,
        states=model.states,
        commands=model.controls,
        signals=signals,
        memory=memory,
        schedule=schedule,
        dt=dt,
        alarms=("qp_failed",),
        span=(reference.initial_time, reference.final_time),
        explanation=DesignReport(
            f"{name} of '{model.name}' along {reference!r}",
            (
                *_facts(gains, windows, rows, model.states, solver),
                *beyond,
                *reserve_shares(reference, bounds),
            ),
        ),
    )
    code = _programme_code(windows, rows, model)
    return with_dropout_handling(replace(plain, flight=flight_law(code, deviation, plain, reference)))


@dataclass(frozen=True, eq=False)
class _Windows:
    """The linear dynamics over a horizon from a step's number: A - B K, B L^-T, K, L^-T, (N, ., .) each."""

    gains: SampledGains
    count: int
    terminal: Array | None

    @property
    def constant(self) -> bool:
        """Whether every step of the reference is like the last."""
        last = self.gains.steps[-1]
        return all(alike(s.a, last.a) and alike(s.b, last.b) for s in self.gains.steps)

    def __call__(self, first: int) -> tuple[Array, Array, Array, Array]:
        steps, costs = self.gains.steps, self.gains.costs
        p = costs[min(first + self.count, len(costs) - 1)] if self.terminal is None else self.terminal
        found = []
        for k in reversed(range(first, first + self.count)):
            s = steps[min(k, len(steps) - 1)]
            gain = gain_of(s.a, s.b, s.r, s.n, p, sampled=True)
            weight = s.r + s.b.T @ p @ s.b
            p = s.q + s.a.T @ p @ s.a - (s.b.T @ p @ s.a + s.n.T).T @ gain
            p = 0.5 * (p + p.T)
            root = np.linalg.inv(np.linalg.cholesky(weight)).T
            found.append((s.a - s.b @ gain, s.b @ root, gain, root))
        a, f, k_, g = (np.stack(matrices) for matrices in zip(*reversed(found), strict=True))
        return a, f, k_, g


@dataclass(frozen=True, eq=False)
class _Schedule:
    """Rows x_ref, mean controls over the horizon, limited states over the horizon, and the dynamics if they change."""

    reference: ReferenceSchedule
    windows: _Windows
    limited: tuple[int, ...]

    def more(self) -> list[Variable]:
        """Return the variables after the reference's own."""
        gains, count = self.windows.gains, self.windows.count
        n, m = gains.steps[-1].b.shape
        sizes = {"horizon_ff": m * (count - 1), "horizon_ref": len(self.limited) * count}
        if not self.windows.constant:
            sizes |= {"horizon_A": count * n * n, "horizon_F": count * n * m, "horizon_K": count * m * n}
            sizes |= {"horizon_G": count * m * m}
        return [Variable(name, size) for name, size in sizes.items() if size]

    def __call__(self, times: Array, dt: float) -> Array:
        times, count = np.atleast_1d(times), self.windows.count
        grid = times[:, None] + dt * np.arange(count + 1)
        _, where, back = np.unique(np.round(grid / dt / STEP_SLACK), return_index=True, return_inverse=True)
        here = grid.ravel()[where]  # every time once, though horizons overlap
        reference = self.reference.reference
        u = reference.mean_control(here, dt)[:, back.reshape(grid.shape)]
        x = reference.x(here)[:, back.reshape(grid.shape)]
        rows = [x[:, :, 0], *(u[:, :, j] for j in range(count))]
        rows += [x[list(self.limited), :, j] for j in range(1, count + 1) if self.limited]
        if not self.windows.constant:
            numbers = [self.windows.gains.index(float(t)) for t in times]
            columns = [np.concatenate([m.ravel() for m in self.windows(k)]) for k in numbers]
            rows.append(np.stack(columns, axis=1))
        return np.vstack(rows)


def _law(
    deviation: ErrorDynamics,
    schedule: _Schedule,
    rows: Rows,
    signals: Layout,
    solver: str,
    *,
    easy: bool = False,
) -> tuple[Any, Any, Layout]:
    """Return the law, the first memory and its layout; ``easy``: without the solver, with a flag of validity."""
    states, m = deviation.model.states.size, rows.lower.size
    count, limited = schedule.windows.count, len(schedule.limited)
    t, x, r = ca.MX.sym("t"), ca.MX.sym("x", states), ca.MX.sym("r", signals.size)
    x_ref, *given = ca.vertsplit(
        r, [0, states, states + m * count, states + (m + limited) * count, signals.size]
    )
    u_ff = given[0]
    sx, sx_ref = ca.SX.sym("x", states), ca.SX.sym("x_ref", states)
    error = ca.Function("e", [sx, sx_ref], [deviation.expression(sx, sx_ref)])
    e = error(x, x_ref)
    horizon = _horizon(schedule, rows, given[2], solver)
    size, n_rows = horizon.unknowns, horizon.equations + rows.count * count
    z = ca.MX.sym("z", m + size + n_rows + 1)
    previous, plan, multipliers, alarm = ca.vertsplit(
        z, [0, m, m + size, m + size + n_rows, m + size + n_rows + 1]
    )
    found = _unlimited(schedule, rows, (e, *given, previous), solver)
    if easy:
        (y, solved), lam_a = found, ca.MX.zeros(multipliers.shape[0])
    else:
        known = (e, *given, previous, plan, multipliers)
        y, lam_a, solved = _solution(schedule, rows, known, found, solver)

    lower, upper = ca.DM(rows.lower), ca.DM(rows.upper)
    if rows.change is not None:
        lower, upper = ca.fmax(lower, previous - rows.change), ca.fmin(upper, previous + rows.change)
    row, regulator = horizon.first_command(e, u_ff[:m])
    u = clip(regulator + ca.if_else(solved, row @ y, 0), lower, upper)
    after = ca.vertcat(
        u,
        ca.if_else(solved, y, 0),
        ca.if_else(solved, lam_a, 0),
        ca.if_else(solved, alarm, 1),
    )
    parts = {"previous_command": m, "plan": size, "multipliers": n_rows, "qp_failed": 1}
    memory = Layout("memory", tuple(Variable(k, v) for k, v in parts.items()), "the memory of the controller")
    first = clip(u_ff[:m], rows.lower, rows.upper)
    return (
        law(t, x, r, z, u, after, *([solved] if easy else [])),
        initial_state_function(t, x, r, ca.vertcat(first, ca.MX.zeros(size + n_rows + 1))),
        memory,
    )


def _unlimited(schedule: _Schedule, rows: Rows, given: tuple[Any, ...], solver: str) -> list[Any]:
    """Return the regulator's unknowns and whether they satisfy all limits, by elementary operations."""
    symbols = [ca.SX.sym(f"i{k}", argument.shape[0]) for k, argument in enumerate(given)]
    e, u_ff, x_limited, matrices, previous = symbols
    alone = _horizon(schedule, rows, matrices, solver).alone(e, u_ff, x_limited, previous)
    return list(ca.Function("alone", symbols, list(alone))(*given))


def _solution(
    schedule: _Schedule, rows: Rows, known: tuple[Any, ...], found: list[Any], solver: str
) -> list[Any]:
    """Return unknowns, multipliers and success: those ``found`` if they meet no limit, else the solver's."""
    # the programme is only built where it is solved
    regulated, inside = found
    symbols = [ca.MX.sym(f"i{k}", argument.shape[0]) for k, argument in enumerate((*known, regulated))]
    e, u_ff, x_limited, matrices, previous, x0, lam0, rest = symbols
    task = _horizon(schedule, rows, matrices, solver).programme(e, u_ff, x_limited, previous)
    shape = {"h": task.h.sparsity(), "a": task.a.sparsity()}
    qp = ca.conic("qp", solver, shape, {**_OPTIONS[solver], "error_on_fail": False})
    # far outside soft limits multipliers are as large as their prices, which only the interior point minds
    size = 1 / float(np.max(rows.roots, initial=1.0)) if solver == "piqp" else 1.0
    least = np.full(rest.shape[0], -np.inf)
    least[task.free :] = 0  # slacks are not negative
    sides = {"a": task.a, "lba": task.low, "uba": task.high, "lbx": least}
    answer = qp(h=size * task.h, g=size * task.g, **sides, x0=x0, lam_a0=size * lam0)
    lam_a, lam_x = answer["lam_a"] / size, answer["lam_x"] / size
    solved = task.optimality_residual(answer["x"], lam_a, lam_x) <= QP_TOLERANCE
    solve = ca.Function("solve", symbols, [answer["x"], lam_a, solved])
    keep = ca.Function("keep", symbols, [rest, ca.MX.zeros(lam0.shape[0]), ca.MX(1)])
    either = ca.Function.if_else("either", keep, solve)  # calls one of them
    return list(either(inside, *known, regulated))


def _horizon(schedule: _Schedule, rows: Rows, matrices: Any, solver: str) -> Horizon:
    """Return the horizon in the form for a solver, with its matrices from the schedule's row."""
    scale = _error_scale(schedule.windows)
    return Horizon(rows, _matrices(schedule, matrices), scale, condensed=solver == "daqp")


def _programme_code(windows: _Windows, rows: Rows, model: Model) -> ProgrammeCode:
    """Return the programme for flight code, with the matrices of every step of the reference."""
    last, sliding = len(windows.gains.steps) - 1, windows.terminal is None
    firsts = [last + windows.count] if windows.constant else range(last + 1)
    found = [windows(k) for k in firsts]
    parts = [np.concatenate([w[i][:1] if sliding else w[i] for w in found]) for i in range(4)]
    return ProgrammeCode(rows, rows.roots, tuple(parts), sliding, windows.count, model.states.size)


def _error_scale(windows: _Windows) -> Array:
    """Return the scales of the errors: an error of one scale costs one."""
    costs = np.diag(windows.gains.costs[-1])
    return np.asarray(1 / np.sqrt(np.where(costs > 0, costs, 1.0)))


def _matrices(schedule: _Schedule, r: Any) -> list[list[Any]]:
    """Return A - B K, B L^-T, K, L^-T of each step: constant, or from the end of the schedule's row."""
    windows, place = schedule.windows, 0
    if windows.constant:
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


def _steps(horizon: float, dt: float) -> int:
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


def _rates(value: ArrayLike, model: Model, dt: float) -> Array:
    rates = as_vector(value, model.controls.size, "the rate limits", ArgumentError)
    bad = np.flatnonzero(~(rates > 0))
    if bad.size:
        raise DesignError(
            f"the rate limit of control '{model.controls.labels[bad[0]]}' is {rates[bad[0]]:g}: give a number > 0."
        )
    return rates * dt


def _subtracts(deviation: ErrorDynamics, name: str) -> bool:
    """Whether the error of a state is x - x_ref, tested at a point without symmetries."""
    states, rows = deviation.model.states, deviation.model.states.slice(name)
    x, x_ref = np.cos(1.0 + np.arange(states.size)), np.sin(2.0 + np.arange(states.size))
    e = deviation(x, x_ref)[deviation.errors.slice(name)]
    return e.size == states[name].size and np.allclose(e, (x - x_ref)[rows], rtol=ROUNDING, atol=ROUNDING)


def _state_rows(
    deviation: ErrorDynamics,
    limits: Mapping[str, tuple[ArrayLike, ArrayLike]],
    hard: Sequence[str],
    price: Array,
) -> tuple[tuple[int, ...], tuple[int, ...], Array, Array, Array]:
    """Places of the limited states in x and in e, their limits and the prices of their errors."""
    model = deviation.model
    in_x: list[int] = []
    in_e: list[int] = []
    lower: list[float] = []
    upper: list[float] = []
    prices: list[float] = []
    if isinstance(hard, str) or not isinstance(hard, Sequence):
        raise ArgumentError(f"hard of design_mpc() is {shown(hard)}: give a list of states.")
    for name in hard:
        if name not in limits:
            raise unknown_name("limited state", name, "state_limits", limits)
    for name, pair in limits.items():
        place = model.states.slice(name)
        size = model.states[name].size
        if not _subtracts(deviation, name):
            raise DesignError(
                f"the error of state '{name}' is not a difference: a limit of it is not linear; leave it to R and Q."
            )
        if not isinstance(pair, Sequence | np.ndarray) or len(pair) != 2:
            raise ArgumentError(f"the limits of state '{name}' are {shown(pair)}: give (lower, upper).")
        low, high = (as_vector(v, size, f"the limits of state '{name}'", ArgumentError) for v in pair)
        if not np.all(low < high):
            raise DesignError(
                f"the limits of state '{name}' leave no room: {low} to {high}; give lower < upper."
            )
        in_x += range(model.states.size)[place]
        in_e += range(model.errors.size)[model.errors.slice(name)]
        lower += list(low)
        upper += list(high)
        place = model.errors.slice(name)
        prices += [np.inf] * size if name in hard else list(price[place])
    return tuple(in_x), tuple(in_e), np.array(lower), np.array(upper), np.array(prices)


def _facts(
    gains: SampledGains, windows: _Windows, rows: Rows, states: Layout, solver: str
) -> list[ReportEntry]:
    m, count = rows.lower.size, windows.count
    n = windows.gains.steps[-1].a.shape[0]
    size, limits = (m + n + len(rows.soft)) * count, (n + rows.count) * count
    remark = f"{size} unknowns, {limits} rows, by {solver}"
    first = windows(0)
    facts = [
        ReportEntry("horizon", count * gains.dt, "s", f"{count} steps; {remark}"),
        *_limit_facts(rows, states),
        ReportEntry("dynamics along the horizon", "constant" if windows.constant else "from the schedule"),
        ReportEntry("gain at the start", first[2][0], "", "K of the first command where no limit is met"),
    ]
    if gains.steady is not None:
        last = gains.steps[-1]
        remark = "without limits, after the end; slowest first"
        facts += regulator_facts(gains.steady, (last.a, last.b), gains.dt, remark=remark)
    return facts


def _limit_facts(rows: Rows, states: Layout) -> list[ReportEntry]:
    """Return the facts about which limits are hard and which soft."""
    soft = [states.labels[rows.states[i]] for i in rows.soft]
    hard = [states.labels[place] for i, place in enumerate(rows.states) if i not in rows.soft]
    rates = ["rates of controls"] if rows.change is not None else []
    facts = [ReportEntry("hard limits", ", ".join(["controls", *rates, *hard]), remark="kept, or alarm")]
    return facts + (
        [ReportEntry("soft limits", ", ".join(soft), remark="left as little as possible")] if soft else []
    )
