"""Reference of a single run, with in-flight re-planning."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.control.reference_trajectory import Reference
from gnc_opt.errors import GncOptError, format_exception
from gnc_opt.model.model_variables import Layout
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.model.trajectory_protocol import Trajectory
from gnc_opt.numerical_tolerances import STEP_SLACK


@dataclass(frozen=True)
class Replan:
    """Record of an in-flight re-planning.

    Attributes
    ----------
    time : float
        Start of the re-planning, s.
    effective : float
        Time from which the new plan is followed, s.
    solve_s : float
        Computation time, s.
    failure : str
        Cause of a failure; "" if a new plan was found.
    final_time : float
        End of the new plan, s; NaN after a failure.
    objective : float
    way : str
        See `gnc_opt.planning.optimal_control_solver.SolveMethod`.

    Examples
    --------
    >>> from gnc_opt.guidance import Replanner
    >>> planner = Replanner(lambda: go.Resolver(solution), every=0.5, latency=0.1, last=0.5)
    >>> led = go.ClosedLoop(cart, go.feedforward(go.Reference(solution)), replanner=planner, dt=0.1)
    >>> (first, *others) = led.simulate([1.1, 0.0], tf=2.5).replans
    >>> print(first.time, round(first.effective, 6), first.failed, first.way)
    0.5 0.6 False switching times
    """

    time: float
    effective: float
    solve_s: float
    failure: str = ""
    final_time: float = math.nan
    objective: float = math.nan
    way: str = ""

    @property
    def failed(self) -> bool:
        """Whether the re-planning failed and the old plan was kept."""
        return bool(self.failure)


@runtime_checkable
class PlanUpdater(Protocol):
    """Re-planning with period ``every`` (s) and ``latency`` (s), until ``last`` s before the end of the plan."""

    every: float
    latency: float
    last: float

    @property
    def plan(self) -> Trajectory:
        """Plan before the run."""

    @property
    def model(self) -> Model:
        """Model of the plan."""

    @property
    def description(self) -> str:
        """Text that determines the plans, part of the fingerprint of a compiled loop."""

    def check_controller_follows_plan(
        self, followed: Layout, signals: Layout, dt: float, row: Callable[[float], Array]
    ) -> None:
        """Raise `ArgumentError` if the controller does not follow the plan."""

    def predict_state(self, plan: Reference, t: float, x: Array, until: float, dt: float) -> Array:
        """Return the state (n_states,) predicted at time ``until`` (s) from x at t with the controls of a plan."""

    def replan_from_state(self, begin: float, x: Array, known_plan: Any) -> Any:
        """Return the plan from a time (s) and a state (n_states,), warm-started from a known plan."""

    def evaluate_plan_schedule(self, plan: Any, times: Array, dt: float, size: int) -> Array:
        """Return the schedule (size, n_times) of a plan at the given times (s)."""


class ActiveReference:
    """Rows ``schedule`` (n_signals, n_steps + 1) of one run; re-planning changes a copy.

    ``places`` are the indices (n_followed,) of the reference rows, or None.
    """

    def __init__(
        self,
        replanner: PlanUpdater | None,
        times: Array,
        schedule: Array,
        dt: float,
        followed: Layout,
        places: Any,
    ) -> None:
        self.replanner, self.times, self.schedule, self.dt = replanner, times, schedule, dt
        self.followed, self.places = followed, places
        self.replans: list[Replan] = []
        if replanner is not None:
            self.schedule = schedule.copy()
            self._plan, self._path = replanner.plan, Reference(replanner.plan, tail="hold")

    def interpolate_reference(self, times: Array) -> Array | None:
        """Return the reference (n_followed, n_times) at times (s), linear between control steps."""
        if self.places is None:
            return None
        return np.stack([np.interp(times, self.times, row) for row in self.schedule[self.places]])

    def replan_reference_if_due(self, step: int, x: Array) -> None:
        """Start a re-planning at a control step if one is due, from the estimated states (n_followed,)."""
        planner = self.replanner
        assert planner is not None
        t, late = float(self.times[step]), math.ceil(planner.latency / self.dt - STEP_SLACK)
        if step + late >= self.times.size - 1:
            return
        if self.times[step + late] >= self._path.final_time - planner.last:
            return
        if self.replans and t < self.replans[-1].effective - self.dt / 2:
            return  # the previous plan is not in force yet
        names = planner.model.states.names
        start = np.concatenate([x[self.followed.slice(n)] for n in names])
        self.replans.append(self._replan_remaining_trajectory(planner, step, step + late, start))

    def _replan_remaining_trajectory(self, planner: PlanUpdater, step: int, first: int, x: Array) -> Replan:
        """Re-plan the steps from ``first`` on; the old plan is kept if the solve fails."""
        t, begin = float(self.times[step]), float(self.times[first])
        solve_start = time.perf_counter()
        try:
            if not np.isfinite(x).all():
                raise GncOptError("the estimated state is not a number")
            state = planner.predict_state(self._path, t, x, begin, self.dt)
            plan = planner.replan_from_state(begin, state, self._plan)
            rows = planner.evaluate_plan_schedule(plan, self.times[first:], self.dt, self.schedule.shape[0])
            path = Reference(plan, tail="hold")
        except Exception as error:  # any failure of a solver or design keeps the old plan
            return Replan(t, begin, time.perf_counter() - solve_start, format_exception(error))
        self.schedule[:, first:] = rows
        self._plan, self._path = plan, path
        method, cost = str(plan.provenance.get("way", "")), float(plan.objective)
        return Replan(t, begin, time.perf_counter() - solve_start, "", path.final_time, cost, method)
