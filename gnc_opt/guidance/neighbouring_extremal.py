r"""Neighbouring-extremal feedback: a smooth plan whose controls and end follow what is measured.

With K and g of `accessory` along the plan,

.. math:: u = u_{ff} - K(t) (x - x_{ref}(t)), \qquad \hat t_f = t_f + g(t) (x - x_{ref}(t))

are the controls and the end of the problem solved again from x, to first order: what is left is of second order in the
deviation (Bryson and Ho, Applied Optimal Control, 1975, chapter 6). Towards an end at which states are given K grows
without bound; in the last part of the flight it stays as it is, and so it does after the end.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np
import scipy

from gnc_opt.arguments import expect, read_positive
from gnc_opt.arrays import Array
from gnc_opt.control.controller import Controller, first_memory, law
from gnc_opt.control.design_report import Explanation, Fact
from gnc_opt.control.dropout import bridge_dropouts
from gnc_opt.control.feedforward import ReferenceSchedule, reference_signals
from gnc_opt.environment import one_thread
from gnc_opt.errors import ArgumentError
from gnc_opt.guidance.accessory_problem import Feedback, SmoothPlan, feedback
from gnc_opt.model.variables import Layout, Variable
from gnc_opt.planning.solution.propagation import state_magnitudes
from gnc_opt.planning.solution.solution import Solution

BENT = 0.1
"""Share of the largest deviation by which a flight may differ from its first-order prediction where that is valid."""

_SIZES = 0.5 ** np.arange(10)
"""Deviations of the start that are tried, in shares of the magnitude of a state."""

_SMALL = 1e-4
"""One from which the first order is taken, in those shares."""

_STEPS = 100


@one_thread()
def design_neighbouring_extremal(
    solution: Solution, *, last: float, dt: float | None = None, name: str = "neighbouring-extremal feedback"
) -> Controller:
    """Design the feedback of controls and end time on which the neighbours of a smooth optimal plan lie.

    Parameters
    ----------
    solution : Solution
        Refined, of one phase in which no limit is active; states at the end are given, or free with a cost.
    last : float
        Length of the last part, s, in which the gains stay as they are at its beginning: shorter is closer to the
        optimum, and asks more of the controls for what is measured wrongly.
    dt : float, optional
        Control step, s; default any that is short beside ``last``.
    name : str
        For messages and reports.

    Returns
    -------
    Controller
        Signals ``<state>_ref``, ``<control>_ff``, ``K`` (row by row), ``end_gain``, ``planned_end``; its memory has the
        ``final_time`` (s) as it is expected now. Commands are not clipped.

    Raises
    ------
    DesignError
        A limit is active, H is not strictly convex in the controls, a time is conjugate to the end, or the controls do
        not move all states; the message names what to do.
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
        start=first_memory(t, x, r, end),
        states=model.states,
        commands=model.controls,
        signals=signals,
        memory=Layout("memory", (Variable("final_time", 1, "s"),), f"controller '{name}'"),
        schedule=schedule,
        dt=step,
        span=(plan.leg.initial_time, plan.leg.final_time),
        explanation=Explanation(f"{name} of '{plan.name}'", tuple(_facts(plan, found, schedule))),
    )
    return bridge_dropouts(controller)


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


def _facts(plan: SmoothPlan, found: Feedback, schedule: ExtremalSchedule) -> list[Fact]:
    states, controls = ", ".join(plan.leg.states.labels), ", ".join(plan.leg.controls.labels)
    facts = [
        Fact("end", plan.leg.final_time, "s", "free" if plan.free_end else "given"),
        Fact("largest gain", np.max(np.abs(found.gain), axis=0), "", f"of |K(t)|, rows: {controls}"),
        Fact("gains stay from", float(found.times[-1]), "s"),
    ]
    if plan.free_end:
        facts.append(
            Fact(
                "end by deviation", found.end_gain[0], "", f"s per unit of each state at the start: {states}"
            )
        )
    remark = (
        f"deviations at the start, each alone and both ways, whose flights first order tells to {BENT:.0%}"
    )
    return [*facts, Fact("valid for", validity(plan, schedule), "", f"{remark}: {states}")]


def validity(plan: SmoothPlan, schedule: ExtremalSchedule) -> Array:
    """Return the largest of the deviations tried of each state at the start for which the first order is valid.

    The flight under the continuous law, until the gains stay, differs by less than `BENT` of its largest deviation from
    the first-order one, the end moves by less than that share of the flight, and no control leaves its limits.
    """
    magnitudes = state_magnitudes(plan.leg)
    n = magnitudes.size
    shares = np.append(_SIZES, _SMALL)
    columns = [
        sign * share * magnitudes[i] * np.eye(n)[i] for i in range(n) for sign in (1, -1) for share in shares
    ]
    flown, within = _flown(plan, schedule, np.stack([*columns, np.zeros(n)], axis=1))
    off = (flown[..., :-1] - flown[..., -1:]) / magnitudes[:, None]  # of the flight from where it was planned
    off, within = off.reshape(-1, n, n, 2, shares.size), within[:-1].reshape(n, 2, shares.size)
    linear = off[..., -1:] / _SMALL * shares
    bent = np.max(np.linalg.norm(off - linear, axis=1), axis=0)
    most = np.max(np.linalg.norm(linear, axis=1), axis=0)
    shift = np.abs(schedule.feedback.end_gain[0] * magnitudes)[:, None] * shares / plan.leg.duration
    valid = (np.all((bent <= BENT * most) & within, axis=1) & (shift <= BENT))[:, :-1]
    return np.array(
        [magnitudes[i] * (_SIZES[np.argmax(row)] if row.any() else 0.0) for i, row in enumerate(valid)]
    )


def _flown(plan: SmoothPlan, schedule: ExtremalSchedule, starts: Array) -> tuple[Array, Array]:
    """Return the deviations (n_times, n_states, n) of flights from deviations (n_states, n), and whether controls stay
    within their limits (n,)."""
    reference, rates = plan.reference, plan.functions.rates
    n, m, count = plan.leg.states.size, plan.leg.controls.size, starts.shape[1]
    times = np.linspace(plan.leg.initial_time, schedule.feedback.times[-1], _STEPS + 1)
    within = np.ones(count, dtype=bool)

    def rate(t: float, x: Array) -> Array:
        K = schedule.gains(np.array([t]))[: m * n].reshape(m, n)
        u = reference.u(t)[:, None] - K @ (x - reference.x(t)[:, None])
        within[plan.beyond(u)] = False
        return rates(np.full(count, t), x, u)

    x = reference.x(times[0])[:, None] + starts
    found = [starts]
    with np.errstate(all="ignore"):
        for t, h in zip(times[:-1], np.diff(times), strict=True):
            k1 = rate(t, x)
            k2 = rate(t + h / 2, x + h / 2 * k1)
            k3 = rate(t + h / 2, x + h / 2 * k2)
            k4 = rate(t + h, x + h * k3)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            found.append(x - reference.x(t + h)[:, None])
    return np.array(found), within
