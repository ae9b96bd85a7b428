r"""Feedback linearisation: output errors as decoupled chains of integrators.

With output errors e of relative degrees r and :math:`e^{(r)} = a + E u`, the law

.. math:: u = E^{-1}(v - a), \qquad v = -K \eta, \qquad \eta = (e,\ \dot e,\ \dots),

assigns the poles of K to the errors wherever E is invertible. The zero dynamics are not controlled and must be stable.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array, read_positive_number
from gnc_opt.array_types import Array
from gnc_opt.control.control_limits_and_authority import Limits, read_control_limits, report_control_authority
from gnc_opt.control.decoupling_matrix_inverse import (
    DETERMINANT_MIN_SHARE,
    ZERO_DYNAMICS_MAX_GROWTH,
    GuardedLaw,
    build_guarded_decoupling_inverse,
    build_singularity_guarded_controller,
    require_stable_zero_dynamics,
)
from gnc_opt.control.design_report import DesignReport, ReportEntry, format_number
from gnc_opt.control.discrete_time_controller import Controller
from gnc_opt.control.input_output_linearization import (
    OutputErrors,
    Outputs,
    get_output_component_setting,
    output_errors,
)
from gnc_opt.control.reference_trajectory import Reference, read_design_reference
from gnc_opt.control.sampled_data_discretization import (
    compute_characteristic_polynomial,
    compute_spectral_radius,
    discretize_zero_order_hold,
)
from gnc_opt.errors import DesignError
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.threads_and_package_versions import limit_to_one_thread


@limit_to_one_thread()
def design_feedback_linearization(
    model: Model,
    reference: Reference | ArrayLike,
    *,
    outputs: Outputs,
    poles: Sequence[complex] | Mapping[str, Sequence[complex]],
    guard: float = DETERMINANT_MIN_SHARE,
    growth: float = ZERO_DYNAMICS_MAX_GROWTH,
    fallback: ArrayLike | None = None,
    limits: Limits | None = None,
    dt: float | None = None,
    name: str = "feedback linearisation",
) -> Controller:
    """Return a controller that assigns poles to the output errors by feedback linearisation.

    Parameters
    ----------
    model : Model
        Affine in its controls.
    reference : Reference or array (n_states,)
    outputs : name, names, expressions or mapping
        See `Outputs`. For attitudes use a state with a declared difference.
    poles : sequence (r,), or mapping from outputs to sequences
        Poles of the error dynamics, 1/s.
    guard : float
        Smallest determinant of E at which the law is applied, relative to the largest on the reference.
    growth : float
        Largest growth rate of the zero dynamics that is accepted, 1/s.
    fallback : array (n_controls, n_errors), optional
        Gain K of u = u_ref - K e where E is singular; default: the last command is repeated. Alarm ``singular``.
    limits : (lower, upper), optional
        Limits of the controls; the control authority margin is reported.
    dt : float, optional
        Length of a control step, s; the sampled chains are checked for stability.
    name : str

    Raises
    ------
    DesignError
        Undefined relative degree, singular E on the reference, unstable poles or zero dynamics, long steps.

    To check a distant initial state, simulate with ``Saturation``; ``CONTROLLER_ALARM`` means that E became singular.

    Examples
    --------
    >>> law = go.design_feedback_linearization(cart, [0.0, 0.0], outputs="q", poles=[-1.0, -2.0])
    >>> u, _ = law(0.0, [1.0, 0.0], dt=0.1)
    >>> print(np.round(u, 6))  # (s + 1)(s + 2) = s^2 + 3 s + 2
    [-2.]
    """
    reference = read_design_reference(model, reference, "design_feedback_linearization")
    errors = output_errors(model, reference, outputs)
    pair = errors.pair
    authority = read_control_limits(model, limits)
    inverse = build_guarded_decoupling_inverse(errors, reference, guard)
    zeros = require_stable_zero_dynamics(errors, reference, growth)
    gain = _place_error_poles(errors, poles)
    closed = _compute_closed_loop_poles(errors, gain)
    facts = [
        ReportEntry("reference", reference.description),
        ReportEntry("relative degrees", np.array(errors.relative_degrees), remark=", ".join(errors.labels)),
        ReportEntry("K", gain, remark="rows: outputs; columns: all e, then all rates, ..."),
        ReportEntry("closed-loop poles", closed, "1/s"),
        inverse.smallest_decoupling_determinant,
        *zeros,
        *_report_sampled_loop_stability(errors, gain, dt),
        *report_control_authority(reference, authority, required=True),
    ]
    orders = _list_output_derivative_orders(errors)
    chain_errors = ca.vertcat(*[errors.chains[i][k] for i, k in orders])
    u = inverse(-ca.DM(gain) @ chain_errors - errors.drift)
    spare = None
    if fallback is not None:
        shape = (pair.u.numel(), model.errors.size)
        spare_gain = read_float_array(fallback, "the fallback gain", DesignError)
        if spare_gain.shape != shape:
            raise DesignError(
                f"the fallback gain has the shape {spare_gain.shape}: give {shape}, controls by errors."
            )
        spare = pair.u_ref - ca.DM(spare_gain) @ model.state_error_expression(pair.x, pair.x_ref)

    return build_singularity_guarded_controller(
        name,
        pair,
        reference,
        GuardedLaw(u, inverse.regular, fallback=spare),
        dt=dt,
        explanation=DesignReport(f"feedback linearisation of '{model.name}'", tuple(facts)),
    )


def _list_output_derivative_orders(errors: OutputErrors) -> list[tuple[int, int]]:
    """Return (component, order) of the entries of eta, sorted by order, then by component."""
    return [
        (i, k)
        for k in range(max(errors.relative_degrees))
        for i, r in enumerate(errors.relative_degrees)
        if k < r
    ]


def _build_integrator_chain_matrices(errors: OutputErrors) -> tuple[Array, Array]:
    """Return A and B of the chains of integrators, in the order of eta."""
    orders = _list_output_derivative_orders(errors)
    a, b = np.zeros((len(orders), len(orders))), np.zeros((len(orders), errors.n_outputs))
    for row, (i, k) in enumerate(orders):
        if k + 1 < errors.relative_degrees[i]:
            a[row, orders.index((i, k + 1))] = 1.0
        else:
            b[row, i] = 1.0
    return a, b


def _place_error_poles(
    errors: OutputErrors, poles: Sequence[complex] | Mapping[str, Sequence[complex]]
) -> Array:
    """Return the gains (n_outputs, n_derivatives) of output errors and their derivatives."""
    a, b = _build_integrator_chain_matrices(errors)
    gain = np.zeros((errors.n_outputs, len(_list_output_derivative_orders(errors))))
    for column, (i, k) in enumerate(_list_output_derivative_orders(errors)):
        label, degree = errors.labels[i], errors.relative_degrees[i]
        gain[i, column] = _compute_pole_placement_gains(errors, label, degree, poles)[k]
    closed_loop = np.linalg.eigvals(a - b @ gain)
    if np.max(closed_loop.real) >= 0:
        raise DesignError(
            f"the errors would not decay: the poles are {format_number(closed_loop)} 1/s; "
            "give poles with negative real parts."
        )
    return gain


def _compute_pole_placement_gains(errors: OutputErrors, label: str, degree: int, poles: Any) -> Array:
    """Return the gains (degree,) of one chain, lowest order first."""
    if isinstance(poles, Mapping):
        poles = get_output_component_setting(label, poles, errors, "the linearisation")
        if poles is None:
            raise DesignError(f"output '{label}' has no poles: give {degree}.")
    row = np.atleast_1d(np.asarray(poles, dtype=complex))
    if row.shape != (degree,):
        raise DesignError(
            f"output '{label}' has relative degree {degree}: give {degree} poles, not {row.size}."
        )
    polynomial = compute_characteristic_polynomial(row)
    if polynomial is None:
        raise DesignError(
            f"the poles {row} of output '{label}' are not in conjugate pairs: give the conjugate of each, too."
        )
    return polynomial[:0:-1]


def _compute_closed_loop_poles(errors: OutputErrors, gain: Array) -> Array:
    a, b = _build_integrator_chain_matrices(errors)
    return np.asarray(np.linalg.eigvals(a - b @ gain))


def _report_sampled_loop_stability(errors: OutputErrors, gain: Array, dt: float | None) -> list[ReportEntry]:
    if dt is None:
        return []
    dt = read_positive_number(dt, "the control step dt", DesignError)
    a, b = _build_integrator_chain_matrices(errors)
    held_a, held_b = discretize_zero_order_hold(a, b, dt)
    radius = compute_spectral_radius(held_a - held_b @ gain)
    if radius >= 1:
        raise DesignError(
            f"control steps of {dt:g} s are too long for these poles: the sampled errors have the spectral radius "
            f"{radius:.4g}; give a shorter dt or slower poles."
        )
    return [ReportEntry("sampled spectral radius", radius, remark=f"steps of {dt:g} s")]
