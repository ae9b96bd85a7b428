r"""Integral sliding mode: robust version of a nominal law, without a reaching phase.

With the errors e relative to the reference and B = :math:`\partial\dot e / \partial u`, let :math:`w = G(x_r)\,e` with
G = B^+ or B^T. The sliding variable

.. math:: s(t) = w(t) - w(0) - \int_0^t \dot w\big|_{u_{nom}} d\tau

is the deviation from the undisturbed nominal motion. It starts at zero, and :math:`u = u_{nom} - E^{-1} \rho(s)` with
:math:`E = \partial\dot w / \partial u` keeps it there. :math:`\dot w` is evaluated with the nonlinear model (A. Imani,
M. Bahrami, eqs 22-31, use linear dynamics). The integral assumes a constant nominal command over each step and uses the
trapezoidal rule with end corrections,

.. math:: \int g\,d\tau = \tfrac{h}{2}(g_0 + g_1) + \tfrac{h^2}{12}(\dot g_0 - \dot g_1) + O(h^5) .
"""

from __future__ import annotations

from typing import Any, Literal, TypeAlias, get_args

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array
from gnc_opt.array_types import Array
from gnc_opt.control.control_limits_and_authority import Limits, saturate_command
from gnc_opt.control.decoupling_matrix_inverse import (
    DETERMINANT_MIN_SHARE,
    GuardedLaw,
    MemoryEntry,
    NominalController,
    build_guarded_decoupling_inverse,
    build_singularity_guarded_controller,
)
from gnc_opt.control.design_report import DesignReport, ReportEntry
from gnc_opt.control.discrete_time_controller import Controller
from gnc_opt.control.input_output_linearization import OutputErrors, PlantPair, build_output_derivative_chains
from gnc_opt.control.reaching_laws import Boundary, Law
from gnc_opt.control.reference_trajectory import Reference, read_design_reference
from gnc_opt.control.sampled_data_discretization import compute_spectral_radius, discretize_zero_order_hold
from gnc_opt.control.sliding_mode import build_switching_control
from gnc_opt.control.tracking_error_dynamics import ErrorDynamics
from gnc_opt.errors import DesignError, suggest_similar_name
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.numerical_tolerances import is_rank_deficient
from gnc_opt.threads_and_package_versions import limit_to_one_thread

Projection: TypeAlias = Literal["pseudo-inverse", "transpose"]


@limit_to_one_thread()
def design_integral_sliding_mode(
    model: Model,
    reference: Reference | ArrayLike,
    *,
    nominal: Controller | ArrayLike,
    reaching: Law,
    boundary: Boundary,
    dt: float,
    projection: Projection = "pseudo-inverse",
    bound: ArrayLike = 0.0,
    limits: Limits | None = None,
    guard: float = DETERMINANT_MIN_SHARE,
    name: str = "integral sliding mode",
) -> Controller:
    """Return an integral sliding-mode controller around a nominal law.

    Parameters
    ----------
    model : Model
        Affine in its controls.
    reference : Reference or array (n_states,)
    nominal : Controller, or array (n_controls, n_errors)
        Nominal law in closed form, such as LQR or TVLQR; or the gain K of u = u_ref - K e.
    reaching : ConstantRate, ExponentialRate or SuperTwisting
    boundary : Sign or SaturationLayer
    dt : float
        Length of a control step, s.
    projection : {"pseudo-inverse", "transpose"}
        Choice of G. With B^+ a matched disturbance enters ds/dt unchanged; with B^T it is multiplied by B^T B.
    bound : float or array (n_controls,)
        Largest disturbance of ds/dt; for `SuperTwisting` the largest rate of the disturbance.
    limits : (lower, upper), optional
        Limits of the controls, checked along the reference; saturation is not treated as a disturbance.
    guard : float
        Smallest determinant of E, relative to the largest on the reference; below it the nominal law acts alone.
    name : str

    Raises
    ------
    DesignError
        Dependent controls, disturbance larger than the gain, gain larger than the control authority, too long steps, or
        a nominal law that is unstable at the final state or not in closed form.

    Examples
    --------
    >>> from gnc_opt.control import ConstantRate, SaturationLayer
    >>> from gnc_opt.simulation import ConstantDisturbance
    >>> reaching = {"reaching": ConstantRate(0.5), "boundary": SaturationLayer(0.1)}
    >>> law = go.design_integral_sliding_mode(cart, [0, 0], nominal=regulator, **reaching, bound=0.2, dt=0.1)
    >>> for each in (regulator, law):
    ...     windy = go.ClosedLoop(cart, each, disturbances=[ConstantDisturbance("wind", 0.2, on="a")])
    ...     print(f"{windy.simulate([1.0, 0.0], tf=20.0).miss('q'):.2f} m off")
    0.22 m off
    0.00 m off
    """
    reference = read_design_reference(model, reference, "design_integral_sliding_mode")
    pair = PlantPair.from_affine_model(model)
    switching = build_switching_control(reaching, boundary, (model, model.controls.labels), bound, limits, dt)
    errors, singular = _build_projected_sliding_surface(pair, reference, projection)
    inverse = build_guarded_decoupling_inverse(errors, reference, guard)
    inner, u_nominal, facts = _read_nominal_controller(pair, reference, nominal, dt)

    s, integral = _build_integral_sliding_surface(errors, dt)
    control_input, twist = switching.solve_for_reaching_law_input(s, ca.SX.zeros(errors.n_outputs))
    u = u_nominal + inverse(control_input)
    memory = [
        *twist,
        *switching.create_disturbance_exceeds_gain_alarm(s, stays=False),
        *integral(u_nominal + (saturate_command(u, switching.limits) - u)),
    ]
    facts += [
        ReportEntry("s at the start", 0.0, remark="no reaching phase"),
        *switching.report_sliding_bands(),
        ReportEntry("singular values of B", singular, remark=f"at the start; G is the {projection}"),
        *switching.report_switching_authority(errors, reference),
    ]
    return build_singularity_guarded_controller(
        name,
        pair,
        reference,
        GuardedLaw(u, inverse.regular, tuple(memory), fallback=u_nominal, nominal=inner),
        dt=switching.dt,
        explanation=DesignReport(f"integral sliding mode of '{model.name}'", tuple(facts)),
    )


def _build_projected_sliding_surface(
    pair: PlantPair, reference: Reference, projection: Projection
) -> tuple[OutputErrors, Array]:
    """Return w = G e as an output of relative degree 1, and the singular values of B at the start."""
    if projection not in get_args(Projection):
        raise DesignError(
            f"there is no projection {projection!r}: {suggest_similar_name(str(projection), get_args(Projection))}"
        )
    e = pair.model.state_error_expression(pair.x, pair.x_ref)
    b = ca.densify(
        ca.simplify(
            pair.replace_plant_by_reference_variables(ca.jacobian(pair.compute_lie_derivative(e), pair.u))
        )
    )
    first = pair.evaluate_expression_on_reference(reference, np.array([reference.initial_time]), b)[0]
    singular: Array = np.asarray(np.linalg.svd(first, compute_uv=False), dtype=float)
    if first.shape[0] < first.shape[1] or is_rank_deficient(singular):
        raise DesignError(
            f"the controls of model '{pair.model.name}' have linearly dependent effects on its states (singular "
            f"values of B: {singular}): allocate them first, and design for independent controls."
        )
    if projection == "transpose":
        g = b.T
    elif b.is_constant():
        g = ca.SX(np.linalg.pinv(first))
    else:
        g = ca.solve(b.T @ b, b.T)
    return build_output_derivative_chains(pair, reference, {"s": g @ e}), singular


def _build_integral_sliding_surface(errors: OutputErrors, dt: float) -> tuple[Any, Any]:
    """Return s, and a function from the nominal command to the memory entries of s."""
    pair = errors.pair
    w = ca.vertcat(*[chain[0] for chain in errors.chains])
    g = errors.drift + errors.decoupling @ pair.u
    g_rate = pair.compute_lie_derivative(g)
    previous = ca.SX.sym("u_nominal", pair.u.numel()), ca.SX.sym("u_ref_held", pair.u.numel())
    commands = ca.vertcat(pair.u, pair.u_ref)
    previous_part = ca.substitute(dt / 2 * g - dt**2 / 12 * g_rate, commands, ca.vertcat(*previous))
    present_part = dt / 2 * g + dt**2 / 12 * g_rate
    first, behind = ca.SX.sym("w_start", errors.n_outputs), ca.SX.sym("integral", errors.n_outputs)
    s = (w - first) - (behind + previous_part)
    # The integral is empty at the first step: subtract the right-end contribution of a step before it at u_ref.
    initial = -ca.substitute(previous_part, ca.vertcat(*previous), ca.vertcat(pair.u_ref, pair.u_ref))

    def build_integral_surface_memory(u_nominal: Any) -> list[MemoryEntry]:
        ahead = ca.substitute(present_part, pair.u, u_nominal)
        return [
            MemoryEntry("w_start", first, w, first),
            MemoryEntry("integral", behind, initial, behind + previous_part + ahead),
            MemoryEntry("u_nominal", previous[0], pair.u_ref, u_nominal),
            MemoryEntry("u_ref_held", previous[1], pair.u_ref, pair.u_ref),
            MemoryEntry("s", ca.SX.sym("s", errors.n_outputs), ca.SX.zeros(errors.n_outputs), s),
        ]

    return s, build_integral_surface_memory


def _read_nominal_controller(
    pair: PlantPair, reference: Reference, nominal: Controller | ArrayLike, dt: float
) -> tuple[NominalController | None, Any, list[ReportEntry]]:
    """Return the nominal controller (``None`` for a gain), its command and its report entries."""
    if isinstance(nominal, Controller):
        nominal.step_length(dt)
        inner = NominalController(nominal, pair)
        return inner, inner.command, [ReportEntry("nominal law", nominal.name), *nominal.explanation.facts]
    gain = read_float_array(nominal, "the nominal gain K", DesignError)
    shape = (pair.u.numel(), pair.model.errors.size)
    if gain.shape != shape:
        raise DesignError(f"the nominal gain K has the shape {gain.shape}: give {shape}, controls by errors.")
    e = pair.model.state_error_expression(pair.x, pair.x_ref)
    poles, radius = _compute_nominal_loop_poles(pair, reference, gain, dt)
    if np.max(poles.real) >= 0 or radius >= 1:
        raise DesignError(
            f"the nominal gain is not stable at the end of the reference: poles {poles} 1/s, spectral radius "
            f"{radius:.6g} with steps of {dt:g} s; design it with design_lqr."
        )
    facts = [
        ReportEntry("reference", reference.description),
        ReportEntry("K", gain),
        ReportEntry("nominal poles", poles, "1/s"),
        ReportEntry("nominal spectral radius", radius),
    ]
    return None, pair.u_ref - ca.DM(gain) @ e, facts


def _compute_nominal_loop_poles(
    pair: PlantPair, reference: Reference, gain: Array, dt: float
) -> tuple[Array, float]:
    """Return the poles of A - B K at the end of the reference, and the spectral radius of the sampled loop."""
    t = reference.final_time
    a, b = ErrorDynamics(pair.model).linearize(t, reference.x(t), reference.u(t))
    held_a, held_b = discretize_zero_order_hold(a, b, dt)
    return np.asarray(np.linalg.eigvals(a - b @ gain)), compute_spectral_radius(held_a - held_b @ gain)
