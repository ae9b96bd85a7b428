r"""Neighbouring-optimal guidance of a bang-bang plan: feedback corrections of switching times and final time.

At each control step, with start t and state x, the remaining switching times and the final time change by

.. math:: (S^T W S + \epsilon H + \lambda) \, \delta\tau = -(S^T W \psi + \epsilon \nabla_\tau L),

with :math:`\psi`, :math:`\nabla_\tau L` of `PlanPrediction` at the current :math:`\tau` and x, and S, H, :math:`\nu`
of the plan (`PlanOptimum`). This is a Newton step to the neighbouring extremal, which satisfies the end conditions in
minimum time (Bryson and Ho, Applied Optimal Control, section 6.4). If fewer switches than conditions remain, the
weights W distribute the error; :math:`\lambda` fixes switches with little effect. In the final part of the trajectory a
regulator tracks the remaining plan, integrated backward from the end.

The optimum is found by Newton's method on :math:`L = t_f + \nu^T \psi(\tau)`, starting from the solution,

.. math:: \begin{pmatrix} H & S^T \\ S & 0 \end{pmatrix} \begin{pmatrix} \delta\tau \\ \delta\nu \end{pmatrix} =
   -\begin{pmatrix} \nabla_\tau L \\ \psi \end{pmatrix}, \qquad S = \psi_\tau, \quad H = L_{\tau\tau} .

It is a strict minimum if S has full rank and H is positive definite on the null space of S (Maurer and Osmolovskii,
SIAM J. Control Optim. 42(6), 2004).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.argument_checks import read_positive_number, require_type
from gnc_opt.array_types import Array
from gnc_opt.control.design_report import DesignReport, ReportEntry
from gnc_opt.control.discrete_time_controller import Controller, initial_state_function, law_function
from gnc_opt.control.feedforward_and_reference_schedule import (
    ReferenceSchedule,
    build_reference_signal_layout,
)
from gnc_opt.control.measurement_dropouts import with_dropout_handling
from gnc_opt.control.quadratic_cost import Weight, read_weight_matrix, require_definite
from gnc_opt.errors import ArgumentError, DesignError, quote_value
from gnc_opt.guidance.bang_bang_final_state_prediction import PlanPrediction, RegulatedEnd, SwitchingPlan
from gnc_opt.model.model_variables import Layout, Variable
from gnc_opt.numerical_tolerances import CONVEX, RANK, TINY
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.simulation.step_size_selection import MAX_SUBSTEPS
from gnc_opt.threads_and_package_versions import limit_to_one_thread

_END_ERROR_MAX_SHARE = 1e-6
"""Largest end error, as the change of switching times that corrects it, in shares of the duration."""

_STATIONARY_MAX_GRADIENT = 1e-3
"""Largest gradient of the Lagrangian (s/s) at which the switching times count as time-optimal."""


@dataclass(frozen=True)
class PlanOptimum:
    """Optimal tau (s), nu (n_errors,), S, H; ``curvature``: smallest eigenvalue of H on the null space of S."""

    tau: Array
    nu: Array
    S: Array
    H: Array
    curvature: float


def find_neighbouring_optimum(prediction: PlanPrediction) -> PlanOptimum:
    """Return the optimum next to the plan; raise `DesignError` if its conditions fail."""
    plan = prediction.plan
    name, tau = plan.reference.model.name, plan.times.copy()
    duration = tau[-1] - plan.initial_time
    errors = plan.reference.model.errors.size
    if tau.size < errors:
        raise DesignError(
            f"{tau.size - 1} switches and the end of the plan of '{name}' cannot meet {errors} conditions at the end: "
            "neighbouring-optimal guidance does not apply; use design_tvlqr()."
        )
    first, _, _ = _differentiate_terminal_conditions(prediction, tau)
    if not _has_independent_terminal_conditions(first.S):
        raise DesignError(
            f"the switching times of the plan of '{name}' cannot control all final states: use design_tvlqr()."
        )

    def evaluate_terminal_residual(y: Array) -> Array:
        """Return the gradient of L, and psi as changes of switching times that correct it, as shares of t_f."""
        psi, slope = prediction.terminal_conditions_function(
            plan.initial_time, plan.initial_state, y[: tau.size] * duration, y[tau.size :]
        )
        stationary = slope.full()[:, 0] + np.eye(tau.size)[-1]
        return np.concatenate(
            [stationary, psi.full()[:, 0] / _compute_jacobian_row_norms(first.S) / duration]
        )

    found = scipy.optimize.root(
        evaluate_terminal_residual, np.concatenate([tau / duration, first.nu]), method="hybr"
    )
    optimum, gradient, psi = _differentiate_terminal_conditions(prediction, found.x[: tau.size] * duration)
    missed = np.max(np.abs(psi) / _compute_jacobian_row_norms(optimum.S))
    if (
        not np.isfinite(missed)
        or missed > _END_ERROR_MAX_SHARE * duration
        or not _has_independent_terminal_conditions(optimum.S)
    ):
        raise DesignError(
            f"no minimum-time switching times were found near those of the plan of '{name}': use a "
            "smaller reserve or a shorter last part."
        )
    if np.max(np.abs(gradient)) > _STATIONARY_MAX_GRADIENT:
        raise DesignError(
            f"the switching times of the plan of '{name}' are not time-optimal (gradient "
            f"{np.max(np.abs(gradient)):.2g} s/s): minimise the final time, and refine the solution."
        )
    if not optimum.curvature > CONVEX:
        raise DesignError(
            f"the plan of '{name}' fails the second-order condition (smallest curvature {optimum.curvature:.2g} "
            "in the null space of the end conditions): its switching times are not a function of the state; use "
            "design_tvlqr()."
        )
    return optimum


def _compute_jacobian_row_norms(S: Array) -> Array:
    return np.asarray(np.maximum(np.linalg.norm(S, axis=1), TINY))


def _has_independent_terminal_conditions(S: Array) -> bool:
    """Return whether the end conditions can be changed independently."""
    sizes = np.linalg.svd(S / _compute_jacobian_row_norms(S)[:, None], compute_uv=False)
    return bool(sizes[-1] > RANK * sizes[0])


def _differentiate_terminal_conditions(
    prediction: PlanPrediction, tau: Array
) -> tuple[PlanOptimum, Array, Array]:
    """Return S, H and the least-squares multipliers at these times, with the gradient of L and psi."""
    plan, g = prediction.plan, np.eye(tau.size)[-1]

    times, nu = ca.SX.sym("tau", tau.size), ca.SX.sym("nu", plan.reference.model.errors.size)
    psi, slope = prediction.terminal_conditions_function(plan.initial_time, plan.initial_state, times, nu)
    outputs = [psi, slope, ca.jacobian(psi, times), ca.jacobian(slope, times)]
    function = ca.Function("derivatives", [times, nu], outputs)

    def evaluate_terminal_derivatives(multipliers: Array) -> list[Array]:
        return [np.asarray(each.full()) for each in function(tau, multipliers)]

    nu = np.linalg.lstsq(evaluate_terminal_derivatives(np.zeros(nu.size1()))[2].T, -g, rcond=None)[0]
    psi, slope, S, H = evaluate_terminal_derivatives(nu)
    psi, slope, H = psi[:, 0], slope[:, 0], 0.5 * (H + H.T)
    kernel = scipy.linalg.null_space(S)
    curvatures = np.linalg.eigvalsh(kernel.T @ H @ kernel)
    least = float(curvatures[0]) * (tau[-1] - plan.initial_time) if curvatures.size else np.inf
    return PlanOptimum(tau.copy(), nu, S, H, least), g + slope, psi


PREDICTION_MAX_ERROR = 0.1
"""Largest end error of the predicted plan, in shares of the accepted errors; more steps per arc reduce it."""

_TIME = 0.03
"""Weight of the flight time in units of squared accepted errors per duration of the plan."""

_CORRECTION_WEIGHT_SHARE = 0.04
"""Correction, as a share of the duration, whose weight equals an accepted error."""


@limit_to_one_thread()
def design_neighbouring_optimal(
    solution: Solution,
    regulator: Controller,
    *,
    Q: Weight,
    last: float,
    dt: float | None = None,
    name: str = "neighbouring-optimal guidance",
    reserve: float = 0.1,
    delay: float = 0.0,
) -> Controller:
    """Return a controller that corrects the switching times and the final time of a minimum-time bang-bang plan.

    Parameters
    ----------
    solution : Solution
        Refined solution with one phase, free final time and all final states fixed, without constraints other than
        limits of controls (limits of states are not checked).
    regulator : Controller
        Tracks the final part and holds the final state; its design must track references, such as `design_lqr` about
        the final state.
    Q : weight
        Weights of the final errors, 1 over the squares of the accepted errors: see `bryson`.
    last : float
        Length of the final part, s; switches in it are not corrected.
    dt : float, optional
        Control step, s; default: the regulator's.
    name : str
    reserve : float
        Share of the planned controls reserved for the regulator in the final part, in [0, 1).
    delay : float
        Delay of the actuators, s: commands are issued earlier by this time. A lag counts with its time constant.

    Returns
    -------
    Controller
        Its memory contains the current ``switching_times`` and ``final_time`` (s), ``tracking`` (1 in the final part),
        ``miss`` (predicted, in shares of the accepted errors) and the regulator's memory.

    Raises
    ------
    DesignError
        The plan is not bang-bang or not time-optimal, its switches cannot control the end, or it fails the second-order
        condition; the message contains a remedy.
    ArgumentError
        A regulator of another model or without a reference, or invalid numbers.

    Examples
    --------
    >>> Q = go.bryson(cart.states, q=0.01, v=0.01)
    >>> guided = go.design_neighbouring_optimal(solution, regulator, Q=Q, last=0.5)
    >>> print(guided.explain()["switches"])
    1
    """
    require_type(solution, Solution, "the plan of design_neighbouring_optimal()", "give a refined Solution")
    require_type(
        regulator, Controller, "the regulator of design_neighbouring_optimal()", "give design_lqr(...)"
    )
    plan = SwitchingPlan.from_bang_bang_solution(solution)
    inner = regulator.without_dropout_handling or regulator
    step = inner.step_length(dt)
    _require_regulator_matches_plan_layout(inner, plan)
    weight = read_weight_matrix(Q, plan.reference.model.errors, "the weight Q")
    require_definite(weight, plan.reference.model.errors.labels, "the weight Q")
    read_positive_number(reserve, "the reserve of neighbouring-optimal guidance", or_zero=True)
    if reserve >= 1:
        raise ArgumentError(f"the reserve is {quote_value(reserve)}: give a share in [0, 1).")
    read_positive_number(delay, "the delay of neighbouring-optimal guidance", or_zero=True)
    ending = _read_terminal_regulation_interval(last, reserve, plan)
    prediction = _choose_integration_steps_per_arc(plan, ending, weight)
    optimum = find_neighbouring_optimum(prediction)
    guidance = _NeighbouringGuidance(prediction, optimum, weight, inner, step, delay)
    signals = build_reference_signal_layout(plan.reference)
    law_, start = guidance.build_guidance_law_functions(signals.size)
    own = (
        Variable("switching_times", plan.times.size - 1, "s"),
        Variable("final_time", 1, "s"),
        Variable("tracking"),
        Variable("miss"),
    )
    controller = Controller(
        name=name,
        step=law_,
        start=start,
        states=inner.states,
        commands=inner.commands,
        signals=signals,
        memory=Layout("memory", (*own, *inner.memory.variables), f"controller '{name}'"),
        schedule=ReferenceSchedule(plan.reference),
        dt=step,
        alarms=inner.alarms,
        span=(plan.reference.initial_time, plan.reference.final_time),
        explanation=DesignReport(
            f"{name} of '{plan.reference.model.name}'", tuple(guidance.build_guidance_design_report())
        ),
    )
    return with_dropout_handling(controller)


def _require_regulator_matches_plan_layout(regulator: Controller, plan: SwitchingPlan) -> None:
    model = plan.reference.model
    for what, found, needed in (
        ("states", regulator.states, model.states),
        ("commands", regulator.commands, model.controls),
    ):
        if found.labels != needed.labels:
            raise ArgumentError(
                f"the regulator '{regulator.name}' has the {what} {list(found.names)}, the plan {list(needed.names)}: "
                "design it with the model of the plan."
            )
    if regulator.signals.labels != build_reference_signal_layout(plan.reference).labels:
        raise ArgumentError(
            f"the regulator '{regulator.name}' needs the signals {list(regulator.signals.names)}, but guidance only "
            "provides a reference: use one with constant gains, such as design_lqr() about the final state."
        )


def _read_terminal_regulation_interval(last: float, reserve: float, plan: SwitchingPlan) -> RegulatedEnd:
    length = read_positive_number(last, "the last part of design_neighbouring_optimal()", or_zero=True)
    duration = plan.times[-1] - plan.initial_time
    if length >= duration:
        raise ArgumentError(
            f"the last part of {length:g} s is not shorter than the flight of {duration:g} s: reduce it."
        )
    return RegulatedEnd(length, reserve)


def _choose_integration_steps_per_arc(
    plan: SwitchingPlan, ending: RegulatedEnd, weight: Array
) -> PlanPrediction:
    """Return the prediction with enough steps per arc to reproduce the end of the plan."""
    nothing, steps = np.zeros(len(weight)), 1
    while True:
        psi = PlanPrediction(plan, RegulatedEnd(0.0, 0.0), steps).terminal_conditions_function(
            plan.initial_time, plan.initial_state, plan.times, nothing
        )[0]
        off = float(np.sqrt(psi.full()[:, 0] @ weight @ psi.full()[:, 0]))
        if off <= PREDICTION_MAX_ERROR:
            return PlanPrediction(plan, ending, steps)
        if steps >= MAX_SUBSTEPS:
            raise DesignError(
                f"the plan of '{plan.reference.model.name}' with its switching times misses its end by {off:.2g} "
                "of the accepted errors: refine the solution."
            )
        steps *= 2


@dataclass(frozen=True, eq=False)
class _NeighbouringGuidance:
    prediction: PlanPrediction
    optimum: PlanOptimum
    weight: Array
    regulator: Controller
    dt: float
    delay: float

    @property
    def plan(self) -> SwitchingPlan:
        return self.prediction.plan

    @cached_property
    def switching_time_correction_function(self) -> Any:
        """Return ``(t, x, tau) -> (tau, miss)``: one correction of the times after t + delay."""
        plan, best = self.plan, self.optimum
        t, x, tau = ca.SX.sym("t"), ca.SX.sym("x", plan.initial_state.size), ca.SX.sym("tau", best.tau.size)
        psi, slope = self.prediction.terminal_conditions_function(t, x, tau, best.nu)
        duration = plan.times[-1] - plan.initial_time
        price = _TIME / duration
        system = best.S.T @ self.weight @ best.S + price * best.H
        right = (best.S.T @ self.weight) @ psi + price * (slope + ca.DM(np.eye(best.tau.size)[-1]))
        open_ = ca.vertcat(*[tau[k] > t + self.delay for k in range(best.tau.size - 1)], 1)
        matrix = (open_ @ open_.T) * system + ca.diag(
            ca.if_else(open_, (_CORRECTION_WEIGHT_SHARE * duration) ** -2, 1)
        )
        step = -ca.ldl_solve(open_ * right, *ca.ldl(matrix, False))
        miss = ca.sqrt(psi.T @ self.weight @ psi)
        return ca.Function(
            "correct",
            [t, x, tau],
            [self._enforce_order_of_switching_times(t, tau, open_, tau + open_ * step), miss],
        )

    def _enforce_order_of_switching_times(self, t: Any, tau: Any, open_: Any, new: Any) -> Any:
        """Return the corrected times: not in the past, in the order of each control's switches, the final time last."""
        soonest, found = t + self.delay, ca.vertsplit(new)
        before: dict[int, Any] = {}
        for k, channel in enumerate(self.plan.channels):
            least = ca.fmax(soonest, before[channel]) if channel in before else soonest
            found[k] = before[channel] = ca.if_else(open_[k], ca.fmax(new[k], least), tau[k])
        found[-1] = ca.fmax(found[-1], soonest)
        return ca.vertcat(*found)

    def build_guidance_law_functions(self, n_signals: int) -> tuple[Any, Any]:
        """Return the law and its initial state as CasADi Functions of ``n_signals`` reference signals."""
        n, inner = self.optimum.tau.size, self.regulator
        t, x, r = ca.SX.sym("t"), ca.SX.sym("x", self.plan.initial_state.size), ca.SX.sym("r", n_signals)
        z = ca.SX.sym("z", n + 2 + inner.memory.size)
        planned, tracked, own = z[:n], z[n], z[n + 2 :]
        tau, miss = self.switching_time_correction_function(t, x, planned)
        tracking = ca.logic_or(tracked, t + self.dt / 2 >= planned[-1] - self.prediction.ending.length)
        tau = ca.if_else(tracking, planned, tau)
        means = self.prediction.average_controls_over_step(t + self.delay, self.dt, tau)
        row = ca.vertcat(self.prediction.planned_state_function(t, tau), means)
        command, memory = inner.step(t, x, row, own)
        u = ca.if_else(tracking, command, means)
        after = ca.vertcat(tau, tracking, miss, ca.if_else(tracking, memory, own))
        first = ca.vertcat(self.optimum.tau, 0, 0, inner.start(t, x, r))
        return law_function(t, x, r, z, u, after), initial_state_function(t, x, r, first)

    # --- design report ------------------------------------------------------------------------------------

    def build_guidance_design_report(self) -> list[ReportEntry]:
        plan, best, ending = self.plan, self.optimum, self.prediction.ending
        margin = f"with a control margin of {100 * ending.reserve:g} %"
        free = "of the scaled final time, end conditions satisfied"
        fixed = "the end conditions determine the switching times"
        return [
            ReportEntry("final time", best.tau[-1], "s", f"{margin}; {plan.times[-1]:.6g} s as planned"),
            ReportEntry(
                "switches", str(len(plan.channels)), "", f"for {best.S.shape[0]} conditions at the end"
            ),
            ReportEntry("smallest curvature", best.curvature, "", free)
            if np.isfinite(best.curvature)
            else ReportEntry("smallest curvature", "none", "", fixed),
            ReportEntry("final part", ending.length, "s", f"'{self.regulator.name}' follows the plan"),
            ReportEntry("steps per arc", str(self.prediction.steps), "", "Runge-Kutta prediction of order 4"),
            ReportEntry(
                "operations",
                str(self.switching_time_correction_function.n_instructions()),
                "",
                "of one correction",
            ),
        ]
