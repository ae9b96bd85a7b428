"""The reference that one run follows, as re-planning in flight changes it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.control.reference import Reference
from gnc_opt.errors import GncOptError, format_error
from gnc_opt.model.model import Model
from gnc_opt.model.trajectory import Trajectory
from gnc_opt.model.variables import Layout
from gnc_opt.tolerances import STEP_SLACK


@dataclass(frozen=True)
class Replan:
    """A re-planning in flight.

    Attributes
    ----------
    time : float
        When it was begun, s.
    effective : float
        When the new plan begins, s.
    solve_s : float
        s.
    failure : str
        Why there is no new plan; "" if there is one.
    final_time : float
        End of the new plan, s; NaN without one.
    objective : float
    way : str
        See `gnc_opt.planning.solver.SolveMethod`.

    Examples
    --------
    >>> from gnc_opt.guidance import Replanner
    >>> planner = Replanner(lambda: go.Resolver(solution), every=0.5, latency=0.1, last=0.5)
    >>> led = go.ClosedLoop(cart, go.feedforward(go.Reference(solution)), replanner=planner, dt=0.1)
    >>> (first, *others) = led.simulate([1.1, 0.0], tf=2.5).replans
    >>> print(first.time, round(first.effective, 6), first.failed, first.way)
    0.5 0.6 False switch times
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
        """Whether the old plan was kept."""
        return bool(self.failure)


@runtime_checkable
class PlanUpdater(Protocol):
    """Re-planning ``every`` so many s, with a ``latency``, not after ``last`` s before the end."""

    every: float
    latency: float
    last: float

    @property
    def plan(self) -> Trajectory:
        """The plan before the run."""

    @property
    def model(self) -> Model:
        """Of the plan."""

    @property
    def description(self) -> str:
        """Everything that decides the plans, for the fingerprint of a compiled loop."""

    def check(self, followed: Layout, signals: Layout, dt: float, row: Callable[[float], Array]) -> None:
        """Raise `ArgumentError` if a controller does not follow the plan."""

    def predicted(self, plan: Reference, t: float, x: Array, until: float, dt: float) -> Array:
        """Return the state (n_states,) that the controls of a plan reach from x at t until a time (s)."""

    def solved(self, begin: float, x: Array, near: Any) -> Any:
        """Return the plan from a time (s) and a state (n_states,) on, near a known one."""

    def rows(self, plan: Any, times: Array, dt: float, size: int) -> Array:
        """Return the schedule (size, n_times) of a plan at times (s)."""


class ActiveReference:
    """The rows ``schedule`` (n_signals, n_steps + 1) of one run; re-planning changes a copy.

    ``places`` are the rows (n_followed,) of the reference, or None.
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

    def reference_at(self, times: Array) -> Array | None:
        """Return what is followed (n_followed, n_times) at these times (s), linear between control steps."""
        if self.places is None:
            return None
        return np.stack([np.interp(times, self.times, row) for row in self.schedule[self.places]])

    def replan_if_due(self, step: int, x: Array) -> None:
        """Re-plan at a control step, from the estimated states (n_followed,), if a new plan is due."""
        planner = self.replanner
        assert planner is not None
        t, late = float(self.times[step]), math.ceil(planner.latency / self.dt - STEP_SLACK)
        if step + late >= self.times.size - 1:
            return
        if self.times[step + late] >= self._path.final_time - planner.last:
            return
        if self.replans and t < self.replans[-1].effective - self.dt / 2:
            return  # the one before is not ready yet
        names = planner.model.states.names
        start = np.concatenate([x[self.followed.slice(n)] for n in names])
        self.replans.append(self._replan(planner, step, step + late, start))

    def _replan(self, planner: PlanUpdater, step: int, first: int, x: Array) -> Replan:
        """Plan for the steps from ``first`` on; what cannot be solved leaves the old plan."""
        t, begin = float(self.times[step]), float(self.times[first])
        begun = time.perf_counter()
        try:
            if not np.isfinite(x).all():
                raise GncOptError("the estimated state is not a number")
            state = planner.predicted(self._path, t, x, begin, self.dt)
            plan = planner.solved(begin, state, self._plan)
            rows = planner.rows(plan, self.times[first:], self.dt, self.schedule.shape[0])
            path = Reference(plan, tail="hold")
        except Exception as error:  # in flight any failure of a solver or design keeps the old plan
            return Replan(t, begin, time.perf_counter() - begun, format_error(error))
        self.schedule[:, first:] = rows
        self._plan, self._path = plan, path
        way, cost = str(plan.provenance.get("way", "")), float(plan.objective)
        return Replan(t, begin, time.perf_counter() - begun, "", path.final_time, cost, way)
