r"""Sliding mode: surfaces from outputs of any relative degree, reaching laws, boundary layers.

For an output error e of relative degree r the surface and the law are

.. math:: s = \Big(\frac{d}{dt} + \lambda\Big)^{r-1} e = e^{(r-1)} + \dots + c_1 \dot e + c_0 e, \qquad
   u = E^{-1}\big( -a - c_{r-2} e^{(r-1)} - \dots - c_0 \dot e - \hat\Gamma - \rho(s) \big),

so that :math:`\dot s = -\rho(s) + d` with whatever the model leaves out, d. On s = 0 the error follows the poles of
the surface whatever d is, as long as it stays below the gain of the reaching law.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from gnc_opt.arguments import read_numbers
from gnc_opt.control.controller import Controller
from gnc_opt.control.explanation import Explanation, Fact
from gnc_opt.control.guard import (
    GUARD,
    Inverse,
    Memory,
    clip,
    guarded_controller,
    guarded_inverse,
    read_plant,
)
from gnc_opt.control.lie import OutputErrors, Outputs, output_errors
from gnc_opt.control.linear.lqr import Limits, read_limits
from gnc_opt.control.reference import Reference
from gnc_opt.control.sliding.checks import check_step, check_zero_dynamics, reserve_facts
from gnc_opt.control.sliding.reaching import (
    Boundary,
    Law,
    Sign,
    SuperTwisting,
    read_bounds,
)
from gnc_opt.control.sliding.super_twisting import SuperTwistingObserver
from gnc_opt.errors import DesignError, unknown_name
from gnc_opt.model.layout import Array, as_vector
from gnc_opt.model.model import Model

Slopes: TypeAlias = float | Sequence[Any] | Mapping[str, Any]
"""lambda (1/s) for all outputs, a sequence with one lambda per output component, or a mapping from outputs to lambda
or to the r - 1 poles of the surface."""

GROWTH = 1e-9
"""Zero dynamics count as unstable when they grow faster than this, 1/s."""


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
    start: ArrayLike | None = None,
    dt: float | None = None,
    guard: float = GUARD,
    growth: float = GROWTH,
    name: str = "sliding mode",
) -> Controller:
    """Design a sliding-mode controller that follows the outputs of a reference.

    Parameters
    ----------
    model : Model
        Affine in its controls.
    reference : Reference or array (n_states,)
        Its control should keep it on the model's dynamics: it is the feedforward.
    outputs : name, names, expressions or mapping
        See `Outputs`; at most as many components as controls.
    slopes : float, sequence or mapping
        See `Slopes`; not needed for outputs of relative degree 1.
    reaching : ConstantRate, ExponentialRate, PowerRate or SuperTwisting
    boundary : Sign, SaturationLayer or TanhLayer
    bound : float or array (n_outputs,)
        Largest disturbance of the r-th derivatives of the outputs; for `SuperTwisting` its largest rate.
    observer : SuperTwistingObserver, optional
        Estimates the disturbance, which the law then cancels; the reaching law has to cover only what is left.
    limits : (lower, upper), optional
        Authority, each a number or (n_controls,): checked along the reference, and the observer takes the
        limited command for the one in force. The law itself does not limit its command.
    start : array (n_states,), optional
        State from which it begins, for the reaching time in `Controller.explain`.
    dt : float, optional
        Length of a control step, s; needed by laws with memory.
    guard : float
        Smallest determinant of the decoupling matrix, relative to its largest on the reference.
    growth : float
        Fastest growth of the zero dynamics that is accepted, 1/s; raise it for slow drifts that a mission survives.
    name : str
        For messages and reports.

    Returns
    -------
    Controller

    Raises
    ------
    DesignError
        Undefined relative degree, singular decoupling matrix, disturbances above the gain, gain above the
        authority, steps too long for the boundary layer, unstable surface or zero dynamics.
    """
    reference = read_plant(model, reference, "design_sliding_mode")
    errors = output_errors(model, reference, outputs)
    coefficients = [
        np.atleast_1d(np.poly(poles)).real[::-1].astype(float) for poles in _surface_poles(errors, slopes)
    ]  # c_0 ... c_{r-2}, 1
    title = f"sliding mode of '{model.name}' on {', '.join(errors.labels)}"
    return surface_controller(
        name,
        title,
        errors,
        reference,
        coefficients,
        reaching=reaching,
        boundary=boundary,
        bound=bound,
        observer=observer,
        limits=limits,
        start=start,
        dt=dt,
        guard=guard,
        growth=growth,
    )


def surface_controller(
    name: str,
    title: str,
    errors: OutputErrors,
    reference: Reference,
    coefficients: Sequence[Array],
    *,
    reaching: Law,
    boundary: Boundary,
    bound: ArrayLike,
    observer: SuperTwistingObserver | None,
    limits: Limits | None,
    start: ArrayLike | None,
    dt: float | None,
    guard: float,
    growth: float,
) -> Controller:
    """Return the controller that drives surfaces of output errors to zero; arguments as `design_sliding_mode`.

    ``coefficients`` holds c_0, ..., c_{r-2}, 1 for each component.
    """
    pair = errors.pair
    bounds = read_bounds(reaching, bound, errors.labels)
    dt = check_step(reaching, boundary, dt, needed=observer is not None)
    authority = read_limits(pair.model, limits)
    inverse = guarded_inverse(errors, reference, guard)
    zeros = check_zero_dynamics(errors, reference, growth)
    pairs = list(zip(coefficients, errors.chains, strict=True))
    s = ca.vertcat(*[_weigh(c, chain, 0) for c, chain in pairs])
    drift = errors.drift + ca.vertcat(*[_weigh(c[:-1], chain, 1) for c, chain in pairs])
    memory, u = _command(s, drift, errors, inverse, reaching, boundary, observer, authority, dt)
    facts = [
        Fact("relative degrees", np.array(errors.degrees), remark=", ".join(errors.labels)),
        *_surface_facts(errors, coefficients, reaching, boundary, bounds, dt),
        *_reaching_facts(errors, s, reference, reaching, bounds, start),
        Fact("smallest determinant on the reference", inverse.lowest, remark=f"largest {inverse.scale:.6g}"),
        *zeros,
        *reserve_facts(errors, reference, authority, reaching, s, dt),
    ]
    return guarded_controller(
        name,
        pair,
        reference,
        command=u,
        fallback=None,
        regular=inverse.regular,
        memory=memory,
        dt=dt,
        explanation=Explanation(title, tuple(facts)),
    )


def _command(
    s: Any,
    drift: Any,
    errors: OutputErrors,
    inverse: Inverse,
    reaching: Law,
    boundary: Boundary,
    observer: SuperTwistingObserver | None,
    limits: tuple[Array, Array] | None,
    dt: float | None,
) -> tuple[list[Memory], Any]:
    """Return the memory and the command of the law."""
    n = errors.size
    memory = [Memory("s", ca.SX.sym("s", n), s, s)]  # of the last step, for the log
    wanted = -drift - reaching.rate(s, boundary)
    if isinstance(reaching, SuperTwisting):
        assert dt is not None
        twist = ca.SX.sym("twist", n)
        wanted += twist
        grown = twist + dt * reaching.memory_rate(s, boundary)
        memory.append(Memory("twist", twist, ca.SX.zeros(n), grown))
    if observer is None:
        return memory, inverse(wanted)
    assert dt is not None
    s_hat, q = ca.SX.sym("s_hat", n), ca.SX.sym("disturbance", n)
    u = inverse(wanted - observer.estimate(s, s_hat, q))
    known = drift + errors.decoupling @ clip(u, limits)
    s_next, q_next = observer.update(s, s_hat, q, known, dt)
    return [*memory, Memory("s_hat", s_hat, s, s_next), Memory("disturbance", q, ca.SX.zeros(n), q_next)], u


def _weigh(c: Array, chain: Any, order: int) -> Any:
    """Return the sum of c_k times the derivative of order k + ``order`` of a chain, SX."""
    return sum((float(c_k) * chain[k + order] for k, c_k in enumerate(c)), ca.SX(0))


def _surface_poles(errors: OutputErrors, slopes: Slopes) -> list[Array]:
    """Return the r - 1 poles of each surface, checked."""
    found = []
    for i, (label, r) in enumerate(zip(errors.labels, errors.degrees, strict=True)):
        given = _slope_of(errors, slopes, label, i) if r > 1 else []
        poles = np.asarray(given, dtype=complex)
        if poles.ndim == 0:
            poles = np.full(r - 1, -poles)
        if poles.shape != (r - 1,):
            raise DesignError(
                f"output '{label}' has relative degree {r}: give lambda, or {r - 1} pole{'s' * (r > 2)}, "
                f"not {poles.size}."
            )
        if not np.all(poles.real < 0) or np.any(np.abs(np.poly(poles).imag) > 1e-9 * np.abs(np.poly(poles))):
            raise DesignError(
                f"the surface of output '{label}' has the poles {poles}: give lambda > 0, or poles with negative "
                "real parts in conjugate pairs."
            )
        found.append(poles)
    return found


def _slope_of(errors: OutputErrors, slopes: Slopes, label: str, index: int) -> Any:
    if isinstance(slopes, Mapping):
        known = [*errors.labels, *(other.partition("[")[0] for other in errors.labels)]
        for key in slopes:
            if key not in known:
                raise unknown_name("output", key, "the surface", errors.labels)
        base = label.partition("[")[0]
        if label not in slopes and base not in slopes:
            raise DesignError(f"output '{label}' has relative degree > 1: give its slope lambda, in 1/s.")
        return slopes[label] if label in slopes else slopes[base]
    if isinstance(slopes, Sequence):
        if len(slopes) != errors.size:
            raise DesignError(
                f"{len(slopes)} slopes are given for {errors.size} surfaces ({', '.join(errors.labels)}): give lambda, "
                "in 1/s, for all or one for each."
            )
        return slopes[index]
    return float(read_numbers(slopes, "lambda, the slope of a surface", DesignError).reshape(()))


def _surface_facts(
    errors: OutputErrors,
    coefficients: Sequence[Array],
    reaching: Law,
    boundary: Boundary,
    bounds: Array,
    dt: float | None,
) -> list[Fact]:
    """Return poles, the band of s and the steady error that it allows, and the sampling limit."""
    facts = []
    for label, c in zip(errors.labels, coefficients, strict=True):
        if c.size > 1:
            facts.append(Fact(f"surface poles of {label}", np.roots(c[::-1]), "1/s"))
    bands = np.array([reaching.band(boundary, float(b)) for b in bounds])
    facts.append(
        Fact("band of s", bands, remark="where a disturbance at its bound may hold s, continuous control")
    )
    if dt is not None and isinstance(boundary, Sign) and np.isfinite(reaching.gain):
        facts.append(Fact("chattering band of s", reaching.gain * dt, remark="one control step at full gain"))
    steady = np.array([band * _peak_gain(c) for band, c in zip(bands, coefficients, strict=True)])
    facts.append(Fact("steady error bound", steady, remark="of the outputs, from the band of s"))
    slope = reaching.slope(boundary)
    if np.isfinite(slope):
        facts.append(
            Fact("sampling limit", 2 / slope, "s", "longer control steps chatter in the boundary layer")
        )
    return facts


def _reaching_facts(
    errors: OutputErrors, s: Any, reference: Reference, reaching: Law, bounds: Array, start: ArrayLike | None
) -> list[Fact]:
    if start is None:
        return []
    t, pair = reference.initial_time, errors.pair
    x = as_vector(start, pair.x.numel(), "the state at the start", DesignError)
    first = np.asarray(pair.function(s)(t, x, reference.u(t), reference.x(t), reference.u(t)).full())[:, 0]
    times = [reaching.reaching_time(float(v), float(b)) for v, b in zip(first, bounds, strict=True)]
    remark = "upper bound with ideal switching and the disturbance at its bound"
    return [Fact("s at the start", first), Fact("reaching time", np.array(times), "s", remark)]


def _peak_gain(c: Array) -> float:
    """Return the largest |e| that |s| <= 1 can cause: the integral of the impulse response of 1 / c(p)."""
    if c.size == 1:
        return 1.0
    poles = np.roots(c[::-1])
    if np.allclose(poles.imag, 0):
        return float(1 / c[0])  # the response of real poles never changes its sign
    companion = np.zeros((c.size - 1, c.size - 1))
    companion[:-1, 1:] = np.eye(c.size - 2)
    companion[-1] = -c[:-1]
    span, steps = 40 / float(np.min(-poles.real)), 4000
    forward = expm(companion * span / steps)
    state = expm(companion * 0.5 * span / steps)[:, -1]
    total = 0.0
    for _ in range(steps):
        total += abs(state[0]) * span / steps
        state = forward @ state
    return total
