r"""Replanner: repeated solution of the optimal control problem in flight, from the estimated state.

At a control step that begins at t with the (estimated) state :math:`\hat x(t)`, the new plan begins after the latency
:math:`\lambda` with the state predicted under the controls of the old plan,

.. math:: x_0 = \hat x(t) + \int_t^{t + \lambda} f(s, x, u_{\mathrm{old}}(s)) \, ds ,

which is followed in the meantime (R. Findeisen and F. Allgoewer, Computational delay in nonlinear model predictive
control, IFAC Proc. 37 (1), 2004). If the solve fails, the old plan stays in force. The remaining problem is the problem
of the plan with shifted time limits (Bellman's principle); conditions on the whole phase or its start cannot shift.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import casadi as ca
import numpy as np

from gnc_opt.argument_checks import read_positive_number, require_type
from gnc_opt.array_types import Array
from gnc_opt.control.discrete_time_controller import Schedule
from gnc_opt.control.feedforward_and_reference_schedule import ReferenceSchedule
from gnc_opt.control.reference_trajectory import Reference
from gnc_opt.errors import ArgumentError, GncOptError, format_exception, quote_value
from gnc_opt.model.model_variables import Layout
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.numerical_tolerances import RANK, SAME_TIME
from gnc_opt.planning.problem.initial_state_clipping import clip_initial_states_to_bounds
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.simulation.dormand_prince import integrate_dormand_prince


def build_remaining_problem(problem: Problem, began: float, begin: float, start: dict[str, Array]) -> Problem:
    """Return the problem of the phase from ``begin`` (s); initial states slightly beyond a limit are moved to it."""
    (phase,) = problem.phases.values()
    span, elapsed = phase.numbers.duration, begin - began
    left = (max(float(span.lower[0]) - elapsed, 0.0), float(span.upper[0]) - elapsed)
    return clip_initial_states_to_bounds(
        problem.with_time(initial=begin, duration=left).with_initial(**start)
    )[0]


def check_remaining_problem(problem: Problem) -> None:
    """Raise `ArgumentError` if the conditions of the remaining problem differ from those of the whole phase."""
    (phase,) = problem.phases.values()
    names = [n for n in problem.parameters.names if n in phase.model.parameters]
    if names:
        raise ArgumentError(
            f"parameter '{names[0]}' of model '{phase.model.name}' is optimised in the plan of the Replanner, but "
            "is constant in flight: fix it with Model.parameter(name, number)."
        )
    whole = ca.vertcat(phase.end_states("initial"), phase.initial_time, phase.integral_symbols())
    for constraint in problem.constraints.values():
        if ca.depends_on(constraint.expression, whole):
            raise ArgumentError(
                f"constraint '{constraint.name}' of problem '{problem.name}' applies to the whole trajectory, but a "
                "Replanner would apply it to each remaining part: limit the final value of a state with the integrand "
                "as its rate, give time(duration=...), or use numbers in place of initial values."
            )
    if not _is_cost_additive(problem, phase):
        raise ArgumentError(
            f"the cost of problem '{problem.name}' is not additive over time, so that a "
            "Replanner would change the plan: write a sum of integrals and a function of the end."
        )


def _is_cost_additive(problem: Problem, phase: Phase) -> bool:
    """Return whether the optimal remainder is independent of the past: the cost gradient keeps its direction."""
    rest = ca.vertcat(
        phase.end_states("final"), phase.final_time, phase.integral_symbols(), problem.parameter_symbols()
    )
    before = ca.vertcat(phase.end_states("initial"), phase.initial_time)
    gradient = ca.Function("gradient", [before, rest], [ca.gradient(problem.cost, rest)])
    numbers = np.random.default_rng(0)
    n = phase.model.states.size
    for _ in range(3):
        y, b = numbers.uniform(2.0, 3.0, rest.numel()), numbers.uniform(0.0, 1.0, before.numel())
        later, changed = b + numbers.uniform(0.1, 0.5, b.size), y.copy()
        changed[n + 1 : n + 1 + len(phase.integrands)] += numbers.uniform(0.1, 0.5, len(phase.integrands))
        if not _are_cost_gradients_parallel(gradient(b, changed), gradient(later, y)):
            return False
    return True


def _are_cost_gradients_parallel(first: Any, second: Any) -> bool:
    a, b = (np.asarray(g.full()[:, 0]) for g in (first, second))
    sizes = np.linalg.norm(a), np.linalg.norm(b)
    if not np.isfinite(sizes).all() or min(sizes) == 0:  # inconclusive
        return True
    return bool(np.linalg.norm(a / sizes[0] - b / sizes[1]) <= RANK)


_PREDICTED = 4
"""Number of integration steps of the prediction per control step."""


class VariationSolver(Protocol):
    """Interface of a solver of problem variations, see `gnc_opt.Resolver`."""

    @property
    def solution(self) -> Solution:
        """Plan, with its problem."""

    def solve(self, problem: Problem, *, near: Solution | None = None) -> Solution:
        """Return the solution of a problem variation."""


def build_tracking_schedule(plan: Solution) -> Schedule:
    """Return the schedule of a law with constant gains that tracks a plan and then holds its final state."""
    with contextlib.suppress(ArgumentError):
        return ReferenceSchedule(Reference(plan))
    return ReferenceSchedule(Reference(plan, tail="hold"))


@dataclass(frozen=True, eq=False)
class Replanner:
    """Repeated solution of the plan's problem in flight.

    Parameters
    ----------
    resolver : callable
        Function without arguments that returns the `gnc_opt.Resolver` of the plan; called once per process.
    every : float
        Time between re-plannings, s, a multiple of the control step.
    latency : float
        Onboard computation time of a solve, s; rounded up to control steps.
    last : float
        Time before the end of the plan without re-planning, s.
    follow : callable
        ``follow(plan) -> schedule``: schedule of the controller. Default: states and controls of the plan, for
        laws with constant gains; for other laws the schedule of their design, such as
        ``lambda plan: design_tvlqr(model, Reference(plan), ...).schedule``.

    Raises
    ------
    ArgumentError
        Invalid numbers, a plan with several phases or a free initial time; constraints on the whole flight or a cost
        that is not additive, because they would apply in full to the remaining part.

    Examples
    --------
    >>> planner = Replanner(lambda: go.Resolver(solution), every=0.5, latency=0.1, last=0.5)
    >>> led = go.ClosedLoop(cart, go.feedforward(go.Reference(solution)), replanner=planner, dt=0.1)
    >>> print(f"{led.simulate([1.1, 0.0], tf=2.5).replans[0].final_time:.3f}")
    2.098
    """

    resolver: Callable[[], VariationSolver]
    every: float
    latency: float = field(default=0.0, kw_only=True)
    last: float = field(default=0.0, kw_only=True)
    follow: Callable[[Solution], Schedule] = field(default=build_tracking_schedule, kw_only=True)

    def __post_init__(self) -> None:
        if not callable(self.resolver):
            raise ArgumentError("the resolver of a Replanner is no function: write lambda: Resolver(plan).")
        if not callable(self.follow):
            raise ArgumentError("follow of a Replanner is not a function: see the class documentation.")
        set_ = object.__setattr__
        set_(self, "every", read_positive_number(self.every, "the time between two re-plannings"))
        set_(self, "last", read_positive_number(self.last, "the last part without re-planning", or_zero=True))
        set_(self, "latency", read_positive_number(self.latency, "the latency of a Replanner", or_zero=True))
        self._require_replannable_plan()

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in vars(self).items() if not k.startswith("_")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)

    @property
    def solver(self) -> VariationSolver:
        """Resolver, created at first use."""
        if "_solver" not in vars(self):
            made = self.resolver()
            if not isinstance(getattr(made, "solution", None), Solution):
                raise ArgumentError(
                    f"the resolver of a Replanner returned {quote_value(made)}: write lambda: Resolver(solve(problem))."
                )
            object.__setattr__(self, "_solver", made)
        return self._solver  # type: ignore[attr-defined,no-any-return]

    @property
    def plan(self) -> Solution:
        """Plan before the flight."""
        return self.solver.solution

    @cached_property
    def _control_step_propagation_function(self) -> Any:
        """Return ``(t, x, u, dt) -> x`` after a control step with constant controls."""
        model = self.model
        t, x, u = ca.SX.sym("t"), ca.SX.sym("x", model.states.size), ca.SX.sym("u", model.controls.size)
        dt, p = ca.SX.sym("dt"), model.parameter_values

        def evaluate_dynamics(t: Any, x: Any, _: Any) -> Any:
            return model.function(t, x, u, p)

        return ca.Function(
            "drift", [t, x, u, dt], [integrate_dormand_prince(evaluate_dynamics, t, x, dt, _PREDICTED)]
        )

    @property
    def description(self) -> str:
        """Data that determine the plans, for the fingerprint of a compiled loop."""
        about = (self.plan.need_problem("solve again").fingerprint(), repr(self.plan.objective))
        name = getattr(self.follow, "__qualname__", type(self.follow).__qualname__)
        return " ".join((*about, repr((self.every, self.latency, self.last)), name))

    @property
    def model(self) -> Model:
        """Model of the plan."""
        (phase,) = self.plan.need_problem("solve again").phases.values()
        return phase.model

    def check_controller_follows_plan(
        self, followed: Layout, signals: Layout, dt: float, row: Callable[[float], Array]
    ) -> None:
        """Raise an error if a controller does not follow the plan.

        Parameters
        ----------
        followed, signals : Layout
            Layouts of the controller.
        dt : float
            Control step, s.
        row : callable
            ``row(t)`` returns the controller's schedule row (n_signals,).
        """
        for v in self.model.states.variables:
            if v.name not in followed or followed[v.name].size != v.size:
                raise ArgumentError(
                    f"the plan of the Replanner has the state '{v.name}' ({v.size}), unknown to the controller: "
                    f"it has {list(followed.names)}; estimate it, or feed it back."
                )
        if not math.isclose(self.every / dt, round(self.every / dt), rel_tol=1e-6) or self.every < dt / 2:
            raise ArgumentError(
                f"the time between two re-plannings is {self.every:g} s: give a multiple of the control step {dt:g} s."
            )
        (phase,) = self.plan.phases.values()
        busy = self.every + self.latency + self.last
        if busy >= phase.duration:
            raise ArgumentError(
                f"the Replanner would never re-plan: every, latency and last are {busy:g} s together, and its plan "
                f"lasts {phase.duration:g} s; reduce them."
            )
        for share in (0.0, 0.5):
            t = phase.initial_time + share * phase.duration
            try:
                own, found = row(t), self.evaluate_plan_schedule(self.plan, np.array([t]), dt, signals.size)
            except GncOptError:
                raise
            except Exception as error:
                raise ArgumentError(
                    f"follow= of the Replanner failed for the original plan, {format_exception(error)}: return a "
                    "schedule, schedule(times, dt) -> (n_signals, n_times)."
                ) from error
            if not np.allclose(found[:, 0], own, rtol=1e-6, atol=1e-9):
                raise ArgumentError(
                    "the controller of the loop does not follow the plan of its Replanner: design it for "
                    "this plan, and give follow= a function that returns the schedule of a plan."
                )

    def evaluate_plan_schedule(self, plan: Solution, times: Array, dt: float, size: int) -> Array:
        """Return the schedule (size, n_times) of a plan at times (s)."""
        rows = np.asarray(self.follow(plan)(times, dt), dtype=float)
        if rows.shape != (size, times.size):
            raise ArgumentError(
                f"follow= of the Replanner gives a schedule of the shape {rows.shape} at {times.size} times: the "
                f"controller needs ({size}, {times.size})."
            )
        if not np.isfinite(rows).all():
            raise ArgumentError(
                "follow= of the Replanner gives a schedule with numbers that are not finite: correct it."
            )
        return rows

    def predict_state(self, plan: Reference, t: float, x: Array, until: float, dt: float) -> Array:
        """Return the state (n_states,) predicted at time ``until`` (s) from x at t with the controls of a plan."""
        for begin in t + dt * np.arange(round((until - t) / dt)):
            u = plan.mean_control([begin], dt)
            x = np.asarray(self._control_step_propagation_function(float(begin), x, u, dt).full()[:, 0])
        return x

    def replan_from_state(self, begin: float, x: Array, near: Solution) -> Solution:
        """Return the plan from time ``begin`` (s) and state ``x`` (n_states,), warm-started from ``near``."""
        names = self.model.states
        start = {name: x[names.slice(name)] for name in names.names}
        (phase,) = self.plan.phases.values()
        problem = build_remaining_problem(
            self.plan.need_problem("solve again"), phase.initial_time, begin, start
        )
        plan = self.solver.solve(problem, near=near)
        require_type(plan, Solution, "the result of the resolver of a Replanner", "let it return a Solution")
        (found,) = plan.phases.values()
        if not math.isclose(found.initial_time, begin, rel_tol=SAME_TIME, abs_tol=SAME_TIME):
            raise ArgumentError(
                f"the new plan begins at {found.initial_time:g} s, not at {begin:g} s: let the resolver "
                "solve the given problem."
            )
        return plan

    def _require_replannable_plan(self) -> None:
        plan = self.plan
        require_type(plan, Solution, "the plan of a Replanner", "write lambda: Resolver(solve(problem))")
        if len(plan.phases) != 1:
            raise ArgumentError(f"the plan of a Replanner has {len(plan.phases)} phases: plan in one.")
        (phase,) = plan.phases.values()
        if not phase.initial_time_bounds.is_fixed[0]:
            raise ArgumentError(
                "the plan of a Replanner does not begin at a fixed time: give time(initial=...)."
            )
        check_remaining_problem(plan.need_problem("solve again"))
        if not callable(getattr(self.solver, "solve", None)):
            raise ArgumentError(
                f"the resolver of a Replanner returned {quote_value(self.solver)}, which has no solve(): write lambda: "
                "Resolver(plan)."
            )
