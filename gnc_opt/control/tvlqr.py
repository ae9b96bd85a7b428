r"""Time-varying linear-quadratic regulator along a reference.

Backward in time along the reference, with :math:`v = u - u_{ff}` and the errors e of `ErrorDynamics`,

.. math:: -\dot P = A^T P + P A - K^T R K + Q, \qquad K = R^{-1} (B^T P + N^T), \qquad P(t_f) = S,

and :math:`u = u_{ff} - K(t)\, e` minimises :math:`e^T S e + \int e^T Q e + v^T R v + 2 e^T N v \, dt` to first order.
With dt, plant and cost are sampled along the reference, and the discrete recursion is used.

Source: B. D. O. Anderson, J. B. Moore, Optimal Control: Linear Quadratic Methods (1990), section 2.3.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import require_type, suggest_keywords
from gnc_opt.array_types import Array
from gnc_opt.control.control_limits_and_authority import Limits, read_control_limits, report_control_authority
from gnc_opt.control.design_report import DesignReport, ReportEntry
from gnc_opt.control.discrete_time_controller import Controller, initial_state_function, law_function
from gnc_opt.control.feedforward_and_reference_schedule import (
    ReferenceSchedule,
    build_reference_signal_layout,
    choose_reference_sample_times,
)
from gnc_opt.control.lqr import report_regulator_poles_and_margins
from gnc_opt.control.measurement_dropouts import with_dropout_handling
from gnc_opt.control.quadratic_cost import Weight, read_quadratic_cost, report_quadratic_cost
from gnc_opt.control.reference_trajectory import Reference
from gnc_opt.control.tracking_error_dynamics import ErrorDynamics
from gnc_opt.control.tvlqr_gains import Gains, SampledGains, compute_riccati_gains
from gnc_opt.model.model_variables import Layout, Variable
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.threads_and_package_versions import limit_to_one_thread


@dataclass(frozen=True, eq=False)
class GainSchedule:
    """Schedule with x_ref, mean control u_ff and K (row by row), for times (n,) and a step (s)."""

    gains: Gains
    reference: ReferenceSchedule = field(repr=False)

    def __call__(self, times: Array, dt: float) -> Array:
        rows = np.stack([self.gains.K(float(t)).ravel() for t in np.atleast_1d(times)], axis=1)
        return np.vstack([self.reference(times, dt), rows])


@limit_to_one_thread()
@suggest_keywords
def design_tvlqr(
    model: Model,
    reference: Reference,
    *,
    Q: Weight,
    R: Weight,
    N: ArrayLike | None = None,
    terminal: Weight | None = None,
    dt: float | None = None,
    limits: Limits | None = None,
    name: str = "TVLQR",
) -> Controller:
    """Return a time-varying linear-quadratic regulator that follows a reference.

    Parameters
    ----------
    model : Model
    reference : Reference
    Q, R, N
        As in `design_lqr`.
    terminal : weight, optional
        Weight S of the final errors; default: the steady cost to go after ``final_time``.
    dt : float, optional
        Control step, s, of a zero-order hold. Default: the continuous gains.
    limits : (lower, upper), optional
        Limits of the controls, for the reported control authority margin. Commands are not clipped.
    name : str

    Returns
    -------
    Controller
        Without memory; signals ``<state>_ref``, ``<control>_ff``, ``K``. ``controller.schedule.gains``: K(t), P(t).

    Raises
    ------
    DesignError
        Weights not (semi)definite; without ``terminal``, a plant at ``final_time`` not stabilisable or detectable.

    Examples
    --------
    >>> reference = go.Reference(solution)
    >>> tracker = go.design_tvlqr(cart, reference, Q=1, R=1, dt=0.05)
    >>> run = go.ClosedLoop(cart, tracker, dt=0.05).simulate(x0=[1.01, 0.0], tf=4.0)
    >>> print(run.miss("q") < 1e-3)
    True
    """
    require_type(
        reference,
        Reference,
        "the reference of design_tvlqr()",
        "write Reference(solution), or give another Reference",
    )
    deviation = ErrorDynamics(model)
    cost = read_quadratic_cost(model, Q, R, N)
    gains = compute_riccati_gains(deviation, reference, cost, terminal=terminal, dt=dt)
    bounds = read_control_limits(model, limits)
    step, start = _build_tvlqr_law(deviation)
    facts = [*report_quadratic_cost(cost, reference), *_report_tvlqr_design(deviation, reference, gains)]
    facts += report_control_authority(reference, bounds)
    regulator = Controller(
        name=name,
        step=step,
        start=start,
        states=model.states,
        commands=model.controls,
        signals=build_reference_signal_layout(
            reference, Variable("K", model.controls.size * deviation.errors.size)
        ),
        memory=Layout("memory", (), "a law without memory"),
        schedule=GainSchedule(gains, ReferenceSchedule(reference)),
        dt=dt,
        span=(reference.initial_time, reference.final_time),
        explanation=DesignReport(f"{name} of '{model.name}'", tuple(facts)),
    )
    return with_dropout_handling(regulator)


def _build_tvlqr_law(deviation: ErrorDynamics) -> tuple[Any, Any]:
    states, controls, errors = (
        layout.size for layout in (deviation.model.states, deviation.model.controls, deviation.errors)
    )
    t, x, z = ca.SX.sym("t"), ca.SX.sym("x", states), ca.SX.sym("z", 0)
    r = ca.SX.sym("r", states + controls + controls * errors)
    x_ref, u_ff = r[:states], r[states : states + controls]
    gain = ca.reshape(r[states + controls :], errors, controls).T  # row by row
    u = u_ff - gain @ deviation.state_error_expression(x, x_ref)
    return law_function(t, x, r, z, u, z), initial_state_function(t, x, r, ca.SX(0, 1))


def _report_tvlqr_design(deviation: ErrorDynamics, reference: Reference, gains: Gains) -> list[ReportEntry]:
    times = choose_reference_sample_times(reference, 40)
    largest = np.max([np.abs(gains.K(float(t))) for t in times], axis=0)
    eigenvalues = np.array([np.linalg.eigvalsh(gains.P(float(t)))[[0, -1]] for t in times])
    rows = ", ".join(deviation.model.controls.labels)
    facts = [
        ReportEntry("largest gain", largest, "", f"largest |K(t)| of the reference, rows: {rows}"),
        ReportEntry(
            "gain after the end",
            gains.tail,
            "",
            "constant, for the final state" if gains.steady is not None else "the last one, constant",
        ),
        ReportEntry(
            "smallest eigenvalue of the Riccati solution P",
            float(eigenvalues[:, 0].min()),
            "",
            "over the reference",
        ),
        ReportEntry(
            "largest eigenvalue of the Riccati solution P",
            float(eigenvalues[:, 1].max()),
            "",
            "over the reference",
        ),
    ]
    dt = gains.dt if isinstance(gains, SampledGains) else None
    if gains.steady is not None:
        t_f = reference.final_time
        a, b = deviation.linearize(t_f, reference.x(t_f), reference.control_after_final_time)
        if dt is not None:
            a, b = gains.steps[-1].a, gains.steps[-1].b  # type: ignore[union-attr]
        facts += report_regulator_poles_and_margins(
            gains.steady, (a, b), dt, name="closed-loop poles after the end"
        )
    return facts
