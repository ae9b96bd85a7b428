r"""Sliding-mode control: surfaces of outputs of any relative degree, with reaching laws and boundary layers.

For an output error e of relative degree r the surface and the law are

.. math:: s = \Big(\frac{d}{dt} + \lambda\Big)^{r-1} e = e^{(r-1)} + \dots + c_1 \dot e + c_0 e, \qquad
   u = E^{-1}\big( -a - c_{r-2} e^{(r-1)} - \dots - c_0 \dot e - \hat\Gamma - \rho(s) \big),

so that :math:`\dot s = -\rho(s) + d` with the disturbance d. On s = 0 the error has the poles of the surface as long as
d is smaller than the gain of the reaching law. If s leaves its layer or grows, the law raises an alarm. Laws with
super-twisting have no such alarm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array, read_positive_number, suggest_keywords
from gnc_opt.array_types import Array
from gnc_opt.control.control_limits_and_authority import (
    Authority,
    Limits,
    read_control_limits,
    report_control_authority,
    saturate_command,
)
from gnc_opt.control.decoupling_matrix_inverse import (
    DETERMINANT_MIN_SHARE,
    ZERO_DYNAMICS_MAX_GROWTH,
    GuardedInverse,
    GuardedLaw,
    MemoryEntry,
    build_guarded_decoupling_inverse,
    build_singularity_guarded_controller,
    require_stable_zero_dynamics,
)
from gnc_opt.control.design_report import DesignReport, ReportEntry
from gnc_opt.control.discrete_time_controller import Controller
from gnc_opt.control.input_output_linearization import (
    OutputErrors,
    Outputs,
    get_output_component_setting,
    output_errors,
)
from gnc_opt.control.reaching_laws import (
    Boundary,
    ExponentialRate,
    Law,
    SaturationLayer,
    Sign,
    SuperTwisting,
    read_disturbance_bounds,
)
from gnc_opt.control.reference_trajectory import Reference, read_design_reference
from gnc_opt.control.sampled_data_discretization import (
    compute_characteristic_polynomial,
    compute_spectral_radius,
    discretize_zero_order_hold,
)
from gnc_opt.control.super_twisting_observer import SuperTwistingObserver
from gnc_opt.errors import DesignError, quote_value
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.threads_and_package_versions import limit_to_one_thread


def _build_sliding_mode_command(
    s: Any,
    drift: Any,
    errors: OutputErrors,
    inverse: GuardedInverse,
    switching: SwitchingControl,
    observer: SuperTwistingObserver | None,
) -> tuple[list[MemoryEntry], Any]:
    """Return the memory of the law and its command."""
    n, dt = errors.n_outputs, switching.dt
    control_input, twist = switching.solve_for_reaching_law_input(s, drift)
    memory = [
        MemoryEntry("s", ca.SX.sym("s", n), s, s),
        *twist,
        *switching.create_disturbance_exceeds_gain_alarm(s),
    ]
    if observer is None:
        return memory, inverse(control_input)
    assert dt is not None
    s_hat, q = ca.SX.sym("s_hat", n), ca.SX.sym("disturbance", n)
    u = inverse(control_input - observer.estimate(s, s_hat, q))
    known_rate = drift + errors.decoupling @ saturate_command(u, switching.limits)
    s_next, q_next = observer.update(s, s_hat, q, known_rate, dt)
    return [
        *memory,
        MemoryEntry("s_hat", s_hat, s, s_next),
        MemoryEntry("disturbance", q, ca.SX.zeros(n), q_next),
    ], u


def _require_stable_sampled_loop(
    labels: Sequence[str], coefficients: Sequence[Array], switching: SwitchingControl
) -> None:
    """Raise `DesignError` if large sampled errors grow at this control step."""
    if switching.dt is None:
        return
    k = switching.reaching.k if isinstance(switching.reaching, ExponentialRate) else 0.0
    for label, c in zip(labels, coefficients, strict=True):
        gain = k * c + np.append(0.0, c[:-1]) if k else c[:-1]
        if not gain.size:
            continue
        a, b = discretize_zero_order_hold(np.eye(gain.size, k=1), np.eye(gain.size)[:, [-1]], switching.dt)
        radius = compute_spectral_radius(a - b @ gain[None])
        if radius >= 1:
            raise DesignError(
                f"control steps of {switching.dt:g} s are too long for the surface of '{label}': away from it "
                f"the sampled errors grow by a factor of {radius:.4g} per step; give a shorter dt, smaller slopes or a "
                "smaller rate k."
            )


def _sum_weighted_output_derivatives(c: Array, chain: Any, order: int) -> Any:
    """Return the sum of c_k times the derivative of order k + ``order`` of a chain, SX."""
    return sum((float(c_k) * chain[k + order] for k, c_k in enumerate(c)), ca.SX(0))


def _report_sliding_surface(
    errors: OutputErrors, coefficients: Sequence[Array], switching: SwitchingControl
) -> list[ReportEntry]:
    """Return poles, the band of s and the resulting steady error, and the sampling limit."""
    pairs = list(zip(errors.labels, coefficients, strict=True))
    poles = [
        ReportEntry(f"surface poles of {label}", np.roots(c[::-1]), "1/s") for label, c in pairs if c.size > 1
    ]
    facts = [*poles, *switching.report_sliding_bands()]
    if not isinstance(switching.boundary, Sign):
        is_real = all(np.allclose(np.roots(c[::-1]).imag, 0) for c in coefficients)
        steady = [band / c[0] for band, c in zip(switching.sliding_bands, coefficients, strict=True)]
        remark = "in the units of the outputs, from the band of s"
        facts += [ReportEntry("steady error bound", np.array(steady), remark=remark)] if is_real else []
    return facts


@dataclass(frozen=True, eq=False)
class SwitchingControl:
    """Switching part: disturbance bounds of ds/dt, control step (s), control limits (n_controls,)."""

    reaching: Law
    boundary: Boundary
    bounds: Array
    dt: float | None
    limits: Authority | None

    @property
    def sliding_bands(self) -> Array:
        """Largest |s| that disturbances at their bounds can sustain, per surface, for continuous control."""
        return np.array([self.reaching.sliding_band(self.boundary, float(b)) for b in self.bounds])

    def solve_for_reaching_law_input(self, s: Any, drift: Any) -> tuple[Any, list[MemoryEntry]]:
        """Return E u for which ``ds/dt = drift + E u`` satisfies the reaching law, and its memory entries; SX."""
        control_input = -drift - self.reaching.rate(s, self.boundary)
        if not isinstance(self.reaching, SuperTwisting):
            return control_input, []
        assert self.dt is not None
        size = self.bounds.size
        twist = ca.SX.sym("twist", size)
        twist_next = twist + self.dt * self.reaching.integral_term_rate(s, self.boundary)
        return control_input + twist, [MemoryEntry("twist", twist, ca.SX.zeros(size), twist_next)]

    def create_disturbance_exceeds_gain_alarm(self, s: Any, *, stays: bool = True) -> list[MemoryEntry]:
        """Return the alarm's memory for disturbances above the gain; see `create_boundary_layer_exit_alarm`."""
        first = s if stays else ca.SX.zeros(s.shape)
        edge = self.boundary.layer_width(1.0)
        if isinstance(self.reaching, SuperTwisting):
            return []
        return create_boundary_layer_exit_alarm(
            s, first, edge + 2 * self.reaching.gain * (self.dt or 0.0), stays=stays
        )

    def report_sliding_bands(self) -> list[ReportEntry]:
        """Return the report entries of the bands of s and the sampling limit."""
        remark = "largest |s| in continuous control with a disturbance at its bound, in the units of s"
        facts = [ReportEntry("band of s", self.sliding_bands, remark=remark)]
        slope = self.reaching.max_slope(self.boundary)
        if np.isfinite(slope):
            remark = "longer control steps chatter in the boundary layer"
            facts.append(ReportEntry("sampling limit", 2 / slope, "s", remark))
        return facts

    def report_switching_authority(self, errors: OutputErrors, reference: Reference) -> list[ReportEntry]:
        """Return the report entry of the control authority margin with a finite switching gain."""
        if isinstance(self.reaching, SuperTwisting):  # unbounded command
            return report_control_authority(reference, self.limits, dt=self.dt, required=True)
        gain = self.reaching.gain

        def compute_required_switching_authority(times: Array) -> Array:
            matrices = errors.pair.evaluate_expression_on_reference(reference, times, errors.decoupling)
            return np.stack([np.sum(np.abs(np.linalg.pinv(m)), axis=1) * gain for m in matrices], axis=1)

        return report_control_authority(
            reference, self.limits, gain=compute_required_switching_authority, dt=self.dt, required=True
        )


def build_switching_control(
    reaching: Law,
    boundary: Boundary,
    names: tuple[Model, Sequence[str]],
    bound: ArrayLike,
    limits: Limits | None,
    dt: float | None,
    *,
    memory: bool = False,
) -> SwitchingControl:
    """Return the switching part of the named surfaces of a model; a law with ``memory`` requires dt."""
    model, labels = names
    bounds = read_disturbance_bounds(reaching, bound, labels)
    return SwitchingControl(
        reaching,
        boundary,
        bounds,
        _read_control_sample_time(reaching, boundary, dt, needed=memory),
        read_control_limits(model, limits),
    )


def _read_control_sample_time(
    reaching: Law, boundary: Boundary, dt: float | None, *, needed: bool
) -> float | None:
    """Return dt; raise `DesignError` if it is missing or unstable in the layer (s+ = (1 - dt slope) s)."""
    if not isinstance(boundary, (Sign, SaturationLayer)):
        raise DesignError(f"the boundary is {boundary!r}: give Sign() or SaturationLayer(phi).")
    if dt is None:
        if needed or isinstance(reaching, SuperTwisting):
            raise DesignError("a law with memory is designed for one length of control steps: give dt, in s.")
        return None
    dt = read_positive_number(dt, "the control step dt", DesignError)
    slope = reaching.max_slope(boundary)
    if np.isfinite(slope) and slope * dt >= 2:
        raise DesignError(
            f"control steps of {dt:g} s are too long for the switching gain: gain * dt / phi = {slope * dt:.4g} "
            f"is not below 2; give dt < {2 / slope:.4g} s, a wider boundary layer or a smaller gain."
        )
    return dt


SWITCHING_GAIN_EXCEEDED = "switching_gain_exceeded"
"""Name of the alarm."""

LAYER_EXIT_MIN_STEPS = 10
"""Consecutive control steps outside the boundary layer that raise the alarm; fewer may be noise."""


def create_boundary_layer_exit_alarm(s: Any, first: Any, edge: float, *, stays: bool) -> list[MemoryEntry]:
    """Return the memory of an alarm for abs(s) > ``edge`` > 0; without ``stays`` only steps with growing s count."""
    if edge <= 0:
        return []
    n = s.shape[0]
    outside_steps, flag = ca.SX.sym("away", n), ca.SX.sym(SWITCHING_GAIN_EXCEEDED)
    distance = ca.SX.sym("distance", n)
    is_started, outside, size = outside_steps > -0.5, ca.fabs(s) > edge, ca.fabs(s)
    # consecutive steps outside; before sliding starts, steps on which s has grown, counted from -1 downward
    growing = ca.if_else(size > distance, outside_steps - 1, -1)
    after = ca.if_else(outside, ca.if_else(is_started, outside_steps + 1, growing), 0 if stays else -1)
    raised = ca.fmax(flag, ca.mmax(ca.fmax(after, -1 - after)) > LAYER_EXIT_MIN_STEPS - 0.5)
    return [
        MemoryEntry("away", outside_steps, -ca.SX.ones(n), after),
        MemoryEntry("distance", distance, ca.fabs(first), size),
        MemoryEntry(SWITCHING_GAIN_EXCEEDED, flag, ca.SX(0), raised, alarm=True),
    ]


Slopes: TypeAlias = float | Sequence[Any] | Mapping[str, Any]
"""Slope lambda (1/s): a number, one per component, or a mapping from outputs to lambda or to the r - 1 poles."""


@limit_to_one_thread()
@suggest_keywords
def design_sliding_mode(
    model: Model,
    reference: Reference | ArrayLike,
    *,
    outputs: Outputs,
    slopes: Slopes = (),
    reaching: Law,
    boundary: Boundary,
    bound: ArrayLike = 0.0,
    observer: SuperTwistingObserver | None = None,
    limits: Limits | None = None,
    dt: float | None = None,
    guard: float = DETERMINANT_MIN_SHARE,
    growth: float = ZERO_DYNAMICS_MAX_GROWTH,
    name: str = "sliding mode",
) -> Controller:
    """Return a sliding-mode controller that tracks the outputs of a reference.

    Parameters
    ----------
    model : Model
        Affine in its controls.
    reference : Reference or array (n_states,)
        Its control is the feedforward and should satisfy the model's dynamics.
    outputs : name, names, expressions or mapping
        See `Outputs`; at most as many components as controls.
    slopes : float, sequence or mapping
        See `Slopes`; not needed for outputs of relative degree 1.
    reaching : ConstantRate, ExponentialRate or SuperTwisting
    boundary : Sign or SaturationLayer
    bound : float or array (n_outputs,)
        Largest disturbance of the r-th derivatives of the outputs; for `SuperTwisting` its largest rate of change.
    observer : SuperTwistingObserver, optional
        Estimates the disturbance, which the law then compensates.
    limits : (lower, upper), optional
        Limits of the controls, numbers or (n_controls,): checked along the reference, and applied to the command that
        the observer uses. The law itself does not limit its command.
    dt : float, optional
        Length of a control step, s; required by laws with memory.
    guard : float
        Smallest determinant of the decoupling matrix, relative to its largest on the reference.
    growth : float
        Largest accepted growth rate of the zero dynamics, 1/s; raise it for slow drifts that are acceptable.
    name : str

    Raises
    ------
    DesignError
        Undefined relative degree, singular decoupling matrix, disturbances above the gain, gain above the
        authority, steps too long for the boundary layer or the slopes, unstable surface or zero dynamics.

    Notes
    -----
    ``reaching.reaching_time(s, bound)`` returns the reaching time with ideal switching.

    Examples
    --------
    >>> from gnc_opt.control import ConstantRate, SaturationLayer
    >>> law = go.design_sliding_mode(
    ...     *(cart, [0.0, 0.0]), outputs="q", slopes=2.0, bound=0.2,
    ...     reaching=ConstantRate(0.5), boundary=SaturationLayer(0.1),
    ... )
    >>> u, _ = law(0.0, [1.0, 0.0], dt=0.01)
    >>> print(u)  # far from the surface: the full rate
    [-0.5]
    """
    reference = read_design_reference(model, reference, "design_sliding_mode")
    errors = output_errors(model, reference, outputs)
    coefficients = _compute_sliding_surface_coefficients(errors, slopes)
    law = (reaching, boundary, (model, errors.labels), bound, limits, dt)
    switching = build_switching_control(*law, memory=observer is not None)
    _require_stable_sampled_loop(errors.labels, coefficients, switching)
    inverse = build_guarded_decoupling_inverse(errors, reference, guard)
    zeros = require_stable_zero_dynamics(errors, reference, growth)
    pairs = list(zip(coefficients, errors.chains, strict=True))
    s = ca.vertcat(*[_sum_weighted_output_derivatives(c, chain, 0) for c, chain in pairs])
    drift = errors.drift + ca.vertcat(
        *[_sum_weighted_output_derivatives(c[:-1], chain, 1) for c, chain in pairs]
    )
    memory, u = _build_sliding_mode_command(s, drift, errors, inverse, switching, observer)
    facts = [
        ReportEntry("reference", reference.description),
        ReportEntry("relative degrees", np.array(errors.relative_degrees), remark=", ".join(errors.labels)),
        *_report_sliding_surface(errors, coefficients, switching),
        inverse.smallest_decoupling_determinant,
        *zeros,
        *switching.report_switching_authority(errors, reference),
    ]
    return build_singularity_guarded_controller(
        name,
        errors.pair,
        reference,
        GuardedLaw(u, inverse.regular, tuple(memory)),
        dt=switching.dt,
        explanation=DesignReport(
            f"sliding mode of '{model.name}' on {', '.join(errors.labels)}", tuple(facts)
        ),
    )


def _compute_sliding_surface_coefficients(errors: OutputErrors, slopes: Slopes) -> list[Array]:
    """Return the characteristic polynomial of each output's surface, constant term first."""
    coefficients = []
    for i, (label, r) in enumerate(zip(errors.labels, errors.relative_degrees, strict=True)):
        slope = _read_sliding_surface_slope(errors, slopes, label, i) if r > 1 else []
        try:
            poles = np.asarray(slope, dtype=complex)
        except (TypeError, ValueError):
            raise DesignError(
                f"the slope of output '{label}' is {quote_value(slope)}: give lambda, in 1/s, or poles."
            ) from None
        if poles.ndim == 0:
            poles = np.full(r - 1, -poles)
        if poles.shape != (r - 1,):
            raise DesignError(
                f"output '{label}' has relative degree {r}: give lambda, or {r - 1} pole{'s' * (r > 2)}, "
                f"not {poles.size}."
            )
        polynomial = compute_characteristic_polynomial(poles)
        if polynomial is None or not np.all(poles.real < 0):
            raise DesignError(
                f"the surface of output '{label}' has the poles {poles}: give lambda > 0, or poles with negative "
                "real parts in conjugate pairs."
            )
        coefficients.append(polynomial[::-1])
    return coefficients


def _read_sliding_surface_slope(errors: OutputErrors, slopes: Slopes, label: str, index: int) -> Any:
    if isinstance(slopes, Mapping):
        slope = get_output_component_setting(label, slopes, errors, "the surface")
        if slope is None:
            raise DesignError(f"output '{label}' has relative degree > 1: give its slope lambda, in 1/s.")
        return slope
    if isinstance(slopes, Sequence):
        if len(slopes) != errors.n_outputs:
            raise DesignError(
                f"{len(slopes)} slopes for {errors.n_outputs} surfaces ({', '.join(errors.labels)}): give lambda, "
                "in 1/s, for all or one for each."
            )
        return slopes[index]
    return float(read_float_array(slopes, "lambda, the slope of a surface", DesignError).reshape(()))
