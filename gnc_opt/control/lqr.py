r"""Linear-quadratic regulator: continuous or sampled, with optional integral action.

In the error coordinates of `ErrorDynamics`, ``de/dt = A e + B v`` with v = u - u_ff. The law
:math:`v = -K e - K_i \zeta` minimises

.. math:: \int e^T Q e + v^T R v + 2 e^T N v + \zeta^T Q_i \zeta \; dt, \qquad \dot\zeta = C e .

With dt, plant and cost are sampled exactly for a zero-order hold, and :math:`\zeta_{k+1} = \zeta_k + dt\, C e_k`. With
limits, :math:`K_i^+ (v - \mathrm{sat}\, v)` is added to the integral (anti-windup by Hanus' conditioning).

Sources: G. F. Franklin, J. D. Powell, M. Workman, Digital Control of Dynamic Systems, 3rd ed. (1998), ch. 9.
R. Hanus, M. Kinnaert, J.-L. Henrotte, Conditioning technique, a general anti-windup and bumpless transfer method,
Automatica 23 (1987).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_optional_mapping, read_positive_number, suggest_keywords
from gnc_opt.array_types import Array
from gnc_opt.control.control_limits_and_authority import (
    Authority,
    Limits,
    clip_to_limits,
    read_control_limits,
    report_control_authority,
)
from gnc_opt.control.design_report import DesignReport, ReportEntry
from gnc_opt.control.discrete_time_controller import Controller, initial_state_function, law_function
from gnc_opt.control.feedforward_and_reference_schedule import (
    ReferenceSchedule,
    build_reference_signal_layout,
    choose_reference_sample_times,
)
from gnc_opt.control.loop_margins import compute_stability_margins
from gnc_opt.control.measurement_dropouts import with_dropout_handling
from gnc_opt.control.quadratic_cost import (
    QuadraticCost,
    Weight,
    read_quadratic_cost,
    report_quadratic_cost,
    require_definite,
)
from gnc_opt.control.reference_trajectory import Reference, read_design_reference
from gnc_opt.control.riccati import LqrSolution, require_stabilizable, solve_algebraic_riccati
from gnc_opt.control.sampled_data_discretization import convert_to_continuous_poles, discretize_plant_and_cost
from gnc_opt.control.tracking_error_dynamics import ErrorDynamics
from gnc_opt.errors import ArgumentError, DesignError, unknown_name_error
from gnc_opt.model.model_variables import Layout, Variable, read_vector
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.numerical_tolerances import SMALL, are_jacobians_equal
from gnc_opt.threads_and_package_versions import limit_to_one_thread


def report_regulator_poles_and_margins(
    regulator: LqrSolution,
    plant: tuple[Array, Array],
    dt: float | None,
    *,
    name: str = "closed-loop poles",
    remark: str = "slowest first",
) -> list[ReportEntry]:
    """Return the report entries of a regulator and its plant (A, B), continuous or sampled with dt (s)."""
    poles = convert_to_continuous_poles(regulator.poles, dt)
    residual = "of the Riccati equation, relative to its largest term"
    return [
        ReportEntry(name, poles, "1/s", remark),
        *_report_stability_margins(*plant, regulator.gain, dt),
        ReportEntry("Riccati residual", regulator.residual, "", residual),
    ]


def _report_stability_margins(a: Array, b: Array, gain: Array, dt: float | None) -> list[ReportEntry]:
    margins = compute_stability_margins(a, b, gain, dt)
    alpha, down = margins.disk, np.where(margins.gain_down > SMALL, margins.gain_down, 0.0)
    disk_text = f"stable for factors of all gains from {max(2 - alpha, 0) / (2 + alpha):.3g} to its inverse"
    return [
        ReportEntry("gain margin up", margins.gain_up, "", "largest factor of the gain, other loops closed"),
        ReportEntry("gain margin down", down, "", "smallest factor of the gain, other loops closed"),
        ReportEntry("phase margin", np.degrees(margins.phase), "deg", "of each control, other loops closed"),
        ReportEntry("delay margin", margins.delay, "s", "of each control, other loops closed"),
        ReportEntry("disk margin", alpha, "", disk_text),
    ]


@limit_to_one_thread()
@suggest_keywords
def design_lqr(
    model: Model,
    reference: Reference | ArrayLike,
    *,
    Q: Weight,
    R: Weight,
    N: ArrayLike | None = None,
    dt: float | None = None,
    integral: Mapping[str, ArrayLike] | None = None,
    limits: Limits | None = None,
    name: str = "LQR",
) -> Controller:
    """Return a linear-quadratic regulator about an equilibrium or a reference with constant A and B.

    Parameters
    ----------
    model : Model
    reference : Reference or array (n_states,)
        Equilibrium state, or a reference with constant A and B; otherwise use `design_tvlqr`.
    Q, R : weight
        Weights of the errors (n_errors, n_errors) and controls: matrices, diagonals, or entries by name, see `bryson`.
    N : array (n_errors, n_controls), optional
        Weight of the products of errors and controls.
    dt : float, optional
        Control step, s, of a zero-order hold. Default: the continuous gain, for any step.
    integral : mapping, optional
        States or outputs with integral action, with weights ``1 / (largest acceptable integral)^2``.
    limits : (lower, upper), optional
        Limits of the controls, for anti-windup and the reported control authority margin. Commands are not clipped.
    name : str

    Returns
    -------
    Controller
        Signals ``<state>_ref``, ``<control>_ff``; memory ``integral_<name>``.

    Raises
    ------
    DesignError
        Not stabilisable or detectable (names the mode), weights not (semi)definite, or A or B not constant.

    Examples
    --------
    For a double integrator and unit weights the gains are 1 and sqrt(3):

    >>> regulator = go.design_lqr(cart, [0.0, 0.0], Q=1, R=1)
    >>> u, memory = regulator(0.0, [1.0, 1.0], dt=0.1)
    >>> print(np.round(u, 4))
    [-2.7321]
    """
    reference = read_design_reference(model, reference, "design_lqr")
    deviation = ErrorDynamics(model)
    a, b = require_constant_linearization(deviation, reference)
    cost = read_quadratic_cost(model, Q, R, N)
    integrals = _build_lqr_integral_states(deviation, reference, integral)
    solution, plant = _solve_augmented_riccati(deviation, (a, b), cost, integrals, dt)
    bounds = read_control_limits(model, limits)
    step, start, memory = _build_lqr_law(model, deviation, solution.gain, integrals, bounds)
    signals = build_reference_signal_layout(
        reference, *([Variable("step", 1, "s")] if integrals.n_states else [])
    )
    facts = [
        *report_quadratic_cost(cost, reference),
        *_report_lqr_design(solution, plant, model.controls, dt),
    ]
    facts += report_control_authority(reference, bounds)
    regulator = Controller(
        name=name,
        step=step,
        start=start,
        states=model.states,
        commands=model.controls,
        signals=signals,
        memory=memory,
        schedule=_StepSchedule(ReferenceSchedule(reference))
        if integrals.n_states
        else ReferenceSchedule(reference),
        dt=dt,
        span=(reference.initial_time, reference.final_time),
        explanation=DesignReport(f"{name} of '{model.name}'", tuple(facts)),
    )
    return with_dropout_handling(regulator)


@dataclass(frozen=True, eq=False)
class _IntegralStates:
    """Integral states: layout, linearised output matrix ``C`` (size, n_errors) and weights."""

    memory: Layout
    names: tuple[str, ...]
    matrix: Array
    weight: Array

    @property
    def n_states(self) -> int:
        return self.memory.size


@dataclass(frozen=True, eq=False)
class _StepSchedule:
    schedule: ReferenceSchedule

    def __call__(self, times: Array, dt: float) -> Array:
        return np.vstack([self.schedule(times, dt), np.full((1, np.size(times)), dt)])


def require_constant_linearization(deviation: ErrorDynamics, reference: Reference) -> tuple[Array, Array]:
    """Return A and B if they are constant along the reference; otherwise raise `DesignError`."""
    times = choose_reference_sample_times(reference, 25)
    controls = reference.u(times)
    pairs = [deviation.linearize(t, reference.x(t), controls[:, k]) for k, t in enumerate(times)]
    a, b = pairs[-1]
    for t, pair in zip(times, pairs, strict=True):
        for what, found, last in (("A", pair[0], a), ("B", pair[1], b)):
            if not are_jacobians_equal(found, last):
                change = np.max(np.abs(found - last))
                raise DesignError(
                    f"{what} of '{deviation.model.name}' changes along the reference, by {change:.3g} between "
                    f"{t:g} s and {times[-1]:g} s: use design_tvlqr(), or a constant reference."
                )
    return a, b


def _build_lqr_integral_states(
    deviation: ErrorDynamics, reference: Reference, integral: Mapping[str, ArrayLike] | None
) -> _IntegralStates:
    model = deviation.model
    variables, rows, weights = [], [], []
    costs = read_optional_mapping(integral, "integral of design_lqr()", 'write {"q": 1.0}, a weight by name')
    for name, weight in costs.items():
        if name in model.errors:
            variable = model.errors[name]
            matrix = np.eye(model.errors.size)[model.errors.slice(name)]
        elif name in model.outputs:
            variable = model.outputs[name]
            matrix = deviation.linearize_output(
                name,
                reference.final_time,
                reference.x(reference.final_time),
                reference.u(reference.final_time),
            )
        else:
            raise unknown_name_error(
                "state or output", name, f"model '{model.name}'", [*model.errors.names, *model.outputs.names]
            )
        unit = f"{variable.unit} s" if variable.unit else "s"
        variables.append(Variable(f"integral_{name}", variable.size, unit))
        rows.append(matrix)
        weights.append(
            read_vector(weight, variable.size, f"the weight of the integral of '{name}'", ArgumentError)
        )
    memory = Layout("memory", tuple(variables), "the integral action")
    diagonal = np.concatenate(weights) if weights else np.zeros(0)
    require_definite(np.diag(diagonal), memory.labels, "the weight")
    matrix = np.vstack(rows) if rows else np.zeros((0, model.errors.size))
    return _IntegralStates(memory, tuple(costs), matrix, np.diag(diagonal))


def _solve_augmented_riccati(
    deviation: ErrorDynamics,
    plant: tuple[Array, Array],
    cost: QuadraticCost,
    integrals: _IntegralStates,
    dt: float | None,
) -> tuple[LqrSolution, tuple[Array, Array]]:
    """Return the LQR of the plant with integral states, and its matrices A and B; sampled with a step ``dt``."""
    (a, b), (q, r, n) = plant, cost
    labels = deviation.errors.labels + integrals.memory.labels
    k, c = integrals.n_states, integrals.matrix
    if dt is None:
        one, per_step = np.zeros((k, k)), 1.0
    else:
        per_step = read_positive_number(dt, "the control step dt")
        # before sampling, so that the message contains the continuous eigenvalue
        require_stabilizable(a, b, deviation.errors.labels)
        discrete = discretize_plant_and_cost(a, b, q, r, n, per_step)
        a, b, q, r, n = discrete.a, discrete.b, discrete.q, discrete.r, discrete.n
        one = np.eye(k)
    m = b.shape[1]
    wide_a = np.block([[a, np.zeros((a.shape[0], k))], [per_step * c, one]])
    wide_b = np.vstack([b, np.zeros((k, m))])
    wide_q = np.block(
        [[q, np.zeros((a.shape[0], k))], [np.zeros((k, a.shape[0])), per_step * integrals.weight]]
    )
    wide_n = np.vstack([n, np.zeros((k, m))])
    return solve_algebraic_riccati(wide_a, wide_b, wide_q, r, wide_n, labels, sampled=dt is not None), (
        wide_a,
        wide_b,
    )


def _build_lqr_law(
    model: Model, deviation: ErrorDynamics, gain: Array, integrals: _IntegralStates, limits: Authority | None
) -> tuple[object, object, Layout]:
    """Return the law and its initial state as CasADi Functions, and the names of its memory."""
    states, controls = model.states.size, model.controls.size
    t, x = ca.SX.sym("t"), ca.SX.sym("x", states)
    r = ca.SX.sym("r", states + controls + (1 if integrals.n_states else 0))
    z = ca.SX.sym("z", integrals.n_states)
    x_ref, u_ff = r[:states], r[states : states + controls]
    e = deviation.state_error_expression(x, x_ref)
    k_e, k_i = gain[:, : e.shape[0]], gain[:, e.shape[0] :]
    u, z_next = u_ff - ca.DM(k_e) @ e, z
    if integrals.n_states:
        u = u - ca.DM(k_i) @ z
        z_next = z + r[-1] * _compute_integral_state_rates(deviation, integrals, t, x, x_ref, e)
        if limits is not None:
            z_next += ca.DM(np.linalg.pinv(k_i)) @ (u - clip_to_limits(u, *limits))
    return (
        law_function(t, x, r, z, u, z_next),
        initial_state_function(t, x, r, ca.SX.zeros(integrals.n_states)),
        integrals.memory,
    )


def _compute_integral_state_rates(
    deviation: ErrorDynamics, integrals: _IntegralStates, t: ca.SX, x: ca.SX, x_ref: ca.SX, e: ca.SX
) -> ca.SX:
    model = deviation.model
    parts = []
    for name in integrals.names:
        if name in model.errors:
            parts.append(e[model.errors.slice(name)])
        else:
            parts.append(
                deviation.output_expression(name, t, x) - deviation.output_expression(name, t, x_ref)
            )
    return ca.vertcat(*parts)


def _report_lqr_design(
    solution: LqrSolution, plant: tuple[Array, Array], controls: Layout, dt: float | None
) -> list[ReportEntry]:
    poles = convert_to_continuous_poles(solution.poles, dt)
    facts = [
        ReportEntry("gain", solution.gain, "", "K in u = u_ff - K e, rows: " + ", ".join(controls.labels))
    ]
    if dt is not None:
        facts.append(ReportEntry("sampled poles", solution.poles, "", "z"))
    fastest = np.isinf(poles)
    damping = np.where(
        fastest, 1.0, -np.where(fastest, 0.0, poles.real) / np.abs(np.where(fastest, 1.0, poles))
    )
    facts.append(ReportEntry("damping", damping, "", "of each closed-loop pole"))
    remark = "slowest first" if dt is None else "ln(z)/dt, slowest first"
    return [*facts, *report_regulator_poles_and_margins(solution, plant, dt, remark=remark)]
