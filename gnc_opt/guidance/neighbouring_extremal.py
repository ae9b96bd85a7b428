r"""Neighbouring-extremal feedback: a smooth plan with controls and end corrected by measurements.

With K and g of `accessory` along the plan,

.. math:: u = u_{ff} - K(t) (x - x_{ref}(t)), \qquad \hat t_f = t_f + g(t) (x - x_{ref}(t))

are the controls and the end of the problem solved again from x, with an error of second order in the deviation (Bryson
and Ho, Applied Optimal Control, 1975, chapter 6). As K grows without bound towards a fixed end, it is constant in the
last part of the flight and after the end.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np
import scipy

from gnc_opt.arguments import expect, read_positive
from gnc_opt.arrays import Array
from gnc_opt.control.controller import Controller, initial_state_function, law
from gnc_opt.control.design_report import DesignReport, ReportEntry
from gnc_opt.control.dropout import with_dropout_handling
from gnc_opt.control.feedforward import ReferenceSchedule, reference_signals
from gnc_opt.environment import one_thread
from gnc_opt.errors import ArgumentError
from gnc_opt.guidance.accessory_problem import Feedback, SmoothPlan, feedback
from gnc_opt.model.variables import Layout, Variable
from gnc_opt.planning.solution.solution import Solution


@one_thread()
def design_neighbouring_extremal(
    solution: Solution, *, last: float, dt: float | None = None, name: str = "neighbouring-extremal feedback"
) -> Controller:
    """Return the feedback of controls and end time on which the neighbours of a smooth optimal plan lie.

    Parameters
    ----------
    solution : Solution
        Refined, of one phase in which no limit is active; states at the end are given, or free with a cost.
    last : float
        Length of the last part, s, with constant gains: shorter is closer to the optimum, with more noise.
    dt : float, optional
        Control step, s; default: any that is short compared with ``last``.
    name : str

    Returns
    -------
    Controller
        Signals ``<state>_ref``, ``<control>_ff``, ``K`` (row by row), ``end_gain``, ``planned_end``; its memory has the
        ``final_time`` (s) as it is expected now. Commands are not clipped.

    Raises
    ------
    DesignError
        A limit is active, H is not strictly convex in the controls, a time is conjugate to the end, or the
        controls do not affect all states; the message names the remedy.
    ArgumentError
        Bad numbers.

    Examples
    --------
    >>> gentle = go.Problem("least effort")
    >>> leg = gentle.phase("leg", cart)
    >>> leg.time(initial=0.0, final=2.0)
    >>> leg.initial(q=1.0, v=0.0)
    >>> leg.final(q=0.0, v=0.0)
    >>> gentle.minimize(leg.integral(0.5 * cart.symbol("a") ** 2))
    >>> guidance = go.design_neighbouring_extremal(go.solve(gentle), last=0.2)
    >>> u, _ = guidance(0.0, [1.1, 0.0], dt=1e-6)
    >>> print(f"{u[0]:.4f}")  # -6 q / T^2
    -1.6500
    """
    expect(solution, Solution, "the plan of design_neighbouring_extremal()", "give a refined Solution")
    plan = SmoothPlan.of(solution)
    length = read_positive(last, "the last part of design_neighbouring_extremal()")
    if length >= plan.leg.duration:
        raise ArgumentError(
            f"the last part of {length:g} s is no part of a flight of {plan.leg.duration:g} s: shorten it."
        )
    step = None if dt is None else read_positive(dt, f"the control step of '{name}'")
    found = feedback(plan, length)
    schedule = ExtremalSchedule(found, plan.leg.final_time, ReferenceSchedule(plan.reference))
    model, n, m = plan.reference.model, plan.leg.states.size, plan.leg.controls.size
    signals = reference_signals(
        plan.reference, Variable("K", m * n), Variable("end_gain", n), Variable("planned_end", 1, "s")
    )
    t, x, r, z = (ca.SX.sym(k, size) for k, size in (("t", 1), ("x", n), ("r", signals.size), ("z", 1)))
    off = x - r[:n]
    u = r[n : n + m] - ca.reshape(r[signals.slice("K")], n, m).T @ off
    end = r[signals.slice("planned_end")] + ca.dot(r[signals.slice("end_gain")], off)
    controller = Controller(
        name=name,
        step=law(t, x, r, z, u, end),
        start=initial_state_function(t, x, r, end),
        states=model.states,
        commands=model.controls,
        signals=signals,
        memory=Layout("memory", (Variable("final_time", 1, "s"),), f"controller '{name}'"),
        schedule=schedule,
        dt=step,
        span=(plan.leg.initial_time, plan.leg.final_time),
        explanation=DesignReport(f"{name} of '{plan.name}'", tuple(_facts(plan, found))),
    )
    return with_dropout_handling(controller)


@dataclass(frozen=True, eq=False)
class ExtremalSchedule:
    """Rows x_ref, mean control u_ff, K row by row, g and t_f, for given times (n,) and step (s)."""

    feedback: Feedback
    final_time: float
    reference: ReferenceSchedule = field(repr=False)

    def __post_init__(self) -> None:
        flat = self.feedback.gain.reshape(self.feedback.times.size, -1)
        table = np.hstack([flat, self.feedback.end_gain])
        object.__setattr__(self, "_gains", scipy.interpolate.CubicSpline(self.feedback.times, table))

    def gains(self, times: Array) -> Array:
        """Return K row by row and g at times (n,), (n_controls n_states + n_states, n)."""
        ends = self.feedback.times[[0, -1]]
        return np.asarray(self._gains(np.clip(times, *ends)).T)  # type: ignore[attr-defined]

    def __call__(self, times: Array, dt: float) -> Array:
        end = np.full((1, np.size(times)), self.final_time)
        return np.vstack([self.reference(times, dt), self.gains(np.atleast_1d(times)), end])


def _facts(plan: SmoothPlan, found: Feedback) -> list[ReportEntry]:
    states, controls = ", ".join(plan.leg.states.labels), ", ".join(plan.leg.controls.labels)
    facts = [
        ReportEntry("end", plan.leg.final_time, "s", "free" if plan.free_end else "given"),
        ReportEntry("largest gain", np.max(np.abs(found.gain), axis=0), "", f"of |K(t)|, rows: {controls}"),
        ReportEntry("gains stay from", float(found.times[-1]), "s"),
    ]
    if plan.free_end:
        facts.append(
            ReportEntry(
                "end by deviation", found.end_gain[0], "", f"s per unit of each state at the start: {states}"
            )
        )
    return facts
