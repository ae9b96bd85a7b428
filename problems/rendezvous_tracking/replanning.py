r"""Re-planning of the rendezvous: the planning problem is solved every few seconds from the estimated state.

A plan uses the share `PLANNED` of the control authority; the margin is for the regulator. Every `EVERY` seconds a new
minimum-time plan is computed on the mesh of the publication. It starts from the state predicted for the time `LATENCY`
that the solve takes on board. No new plan starts in the last `LAST` seconds.

The regulator must be available for any plan without a design. Each axis is a double integrator of mass m or moment J,
whose linear-quadratic regulator has the closed form

.. math:: u = u_{ref} - k_1 e - k_2 \dot e, \qquad k_1 = \sqrt{q_1 / r}, \qquad k_2 = \sqrt{q_2 / r + 2 m k_1},

with the weights of the other regulators. Forces are transformed to body axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt import control
from gnc_opt.array_types import Array
from gnc_opt.control.discrete_time_controller import Schedule
from gnc_opt.control.feedforward_and_reference_schedule import (
    ReferenceSchedule,
    StackedSchedule,
    build_reference_signal_layout,
)
from gnc_opt.estimation import output_feedback
from gnc_opt.guidance import Replanner
from gnc_opt.model.model_variables import Layout, Variable
from gnc_opt.simulation import ClosedLoop
from gnc_opt.spacecraft import apply, mrp_difference, mrp_to_dcm
from problems.rendezvous import INERTIA, MASS
from problems.rendezvous_tracking.control import ACCEPTED, CORRECTIONS, DT, SETTLING, plan
from problems.rendezvous_tracking.guidance import Measured

PLANNED = 0.97
"""Share of the authority that the plans use."""
EVERY, LATENCY, LAST = 4.0, 0.5, 8.0
"""Of the re-planning, s: how often, how long a solve takes on board, and before which end the plan stays."""


@cache
def resolver(case: int) -> go.Resolver:
    """Return what knows the plan; one per process."""
    return go.Resolver(plan(case, PLANNED, refined=False), cold=False)


@dataclass(frozen=True)
class Arrival:
    """The schedule of when a plan ends, (1, n)."""

    time: float

    def __call__(self, times: Array, dt: float) -> Array:
        return np.full((1, len(times)), self.time)


def follow(solution: go.Solution) -> Schedule:
    """Return what the regulator has to know of a plan: its states and controls, and its end."""
    return _schedule(control.Reference(solution))


def _schedule(reference: control.Reference) -> Schedule:
    return StackedSchedule(ReferenceSchedule(reference), Arrival(reference.final_time))


def follower(reference: control.Reference) -> control.Controller:
    """Return the regulator about a plan, which remembers when that ends."""
    signals = build_reference_signal_layout(reference, Variable("arrival", 1, "s"))
    t, x, row, z = (ca.SX.sym(n, k) for n, k in (("t", 1), ("x", 12), ("row", signals.size), ("z", 1)))
    planned, fed = row[:12], row[12:18]
    turn = mrp_difference(planned[3:6], x[3:6])
    torque = _gains("sigma", "omega", "T_B", np.asarray(INERTIA))
    force = _gains("r_L", "v_L", "F_B", np.full(3, MASS))
    push = force[0] * (planned[9:] - x[9:]) + force[1] * (planned[6:9] - x[6:9])
    u = fed + ca.vertcat(
        torque[0] * turn + torque[1] * (planned[:3] - x[:3]), apply(mrp_to_dcm(x[3:6]), push)
    )
    facts = [
        control.ReportEntry(f"gains of {what}", np.concatenate(each))
        for what, each in (("attitude and rate", torque), ("position and velocity", force))
    ]
    return control.with_dropout_handling(
        control.Controller(
            name="follower",
            step=control.law_function(t, x, row, z, u, row[18]),
            start=control.initial_state_function(t, x, row, row[18]),
            states=reference.model.states,
            commands=reference.model.controls,
            signals=signals,
            memory=Layout("memory", (Variable("final_time", 1, "s"),)),
            schedule=_schedule(reference),
            dt=DT,
            explanation=control.DesignReport(f"follower of '{reference.model.name}'", tuple(facts)),
        )
    )


def _gains(error: str, rate: str, command: str, inertia: Array) -> tuple[Array, Array]:
    """Return k_1 and k_2 of three axes."""
    k_1 = np.full(3, CORRECTIONS[command] / ACCEPTED[error])
    return k_1, np.sqrt((CORRECTIONS[command] / ACCEPTED[rate]) ** 2 + 2 * inertia * k_1)


@dataclass(frozen=True)
class Replanned(Measured):
    """The loop that plans again; its ``solution`` is the first plan of the case."""

    case: int = 1

    @cached_property
    def follower(self) -> control.Controller:
        """The regulator about the first plan."""
        return follower(self.reference)

    def controller(self, name: str = "re-planned") -> control.Controller:
        """Return the regulator fed by the filter."""
        return output_feedback(self.follower, self.filter)

    def loop(self, controller: control.Controller) -> ClosedLoop:
        """Return the loop of `measured` with the re-planner."""
        again = Replanner(partial(resolver, self.case), EVERY, latency=LATENCY, last=LAST, follow=follow)
        return replace(super().loop(controller), replanner=again)

    @property
    def end(self) -> float:
        """When the runs are evaluated, s."""
        return self.reference.final_time + SETTLING
