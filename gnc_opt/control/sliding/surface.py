"""Surfaces of output errors and the law that drives them to zero, whoever chose their coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.arrays import Array
from gnc_opt.control.controller import Controller
from gnc_opt.control.explanation import Explanation, Fact
from gnc_opt.control.guard import (
    GuardedLaw,
    Inverse,
    Memory,
    check_zero_dynamics,
    determinant_on,
    guarded_controller,
    guarded_inverse,
)
from gnc_opt.control.lie import OutputErrors
from gnc_opt.control.limits import saturated
from gnc_opt.control.reference import Reference
from gnc_opt.control.rehearsal import FINENESS, Path, Rehearsal, Trial, drift_facts, limit_facts, rehearse
from gnc_opt.control.sampling import spectral_radius, zero_order_hold
from gnc_opt.control.schedule import reference_times
from gnc_opt.control.sliding.reaching import ExponentialRate
from gnc_opt.control.sliding.super_twisting import SuperTwistingObserver
from gnc_opt.control.sliding.switching import SlidingOptions, Switching
from gnc_opt.errors import DesignError
from gnc_opt.model.layout import as_point

_SETTLED = 40.0
"""An impulse response is integrated over this many time constants of its slowest pole."""
_RESPONSE_STEPS = 4000
_SPAN = 20.0
"""A rehearsal lasts this many time constants of the slowest pole of the surface, and the reaching time."""


def surface_controller(
    name: str,
    title: str,
    errors: OutputErrors,
    reference: Reference,
    coefficients: Sequence[Array],
    options: SlidingOptions,
) -> Controller:
    """Return the controller that drives surfaces of output errors to zero.

    ``coefficients`` holds c_0, ..., c_{r-2}, 1 for each component.

    Raises
    ------
    DesignError
        Steps too long for the surface, and what the parts refuse.
    """
    switching = options.switching(errors.pair.model, errors.labels)
    _require_decay(errors.labels, coefficients, switching)
    inverse = guarded_inverse(errors, reference, options.guard)
    zeros = check_zero_dynamics(errors, reference, options.growth)
    pairs = list(zip(coefficients, errors.chains, strict=True))
    s = ca.vertcat(*[_weigh(c, chain, 0) for c, chain in pairs])
    drift = errors.drift + ca.vertcat(*[_weigh(c[:-1], chain, 1) for c, chain in pairs])
    switching = replace(switching, stretch=_stretch(drift, errors, reference, switching.dt))
    memory, u = _command(s, drift, errors, inverse, switching, options.observer)
    facts = [
        Fact("relative degrees", np.array(errors.degrees), remark=", ".join(errors.labels)),
        *_surface_facts(errors, coefficients, switching),
        Fact("smallest determinant on the reference", inverse.lowest, remark=f"largest {inverse.scale:.6g}"),
        *zeros,
        *switching.reserve(errors, reference),
    ]
    return guarded_controller(
        name,
        errors.pair,
        reference,
        GuardedLaw(u, inverse.regular, tuple(memory)),
        dt=switching.dt,
        explanation=Explanation(title, tuple(facts)),
        rehearsal=_reaching(errors, s, coefficients, reference, switching, inverse, options),
    )


def _command(
    s: Any,
    drift: Any,
    errors: OutputErrors,
    inverse: Inverse,
    switching: Switching,
    observer: SuperTwistingObserver | None,
) -> tuple[list[Memory], Any]:
    """Return the memory and the command of the law."""
    n, dt = errors.size, switching.dt
    wanted, twist = switching.demand(s, drift)
    # s of the last step, for the log
    memory = [Memory("s", ca.SX.sym("s", n), s, s), *twist, *switching.watch(s)]
    if observer is None:
        return memory, inverse(wanted)
    assert dt is not None
    s_hat, q = ca.SX.sym("s_hat", n), ca.SX.sym("disturbance", n)
    u = inverse(wanted - observer.estimate(s, s_hat, q))
    known = drift + errors.decoupling @ saturated(u, switching.limits)
    s_next, q_next = observer.update(s, s_hat, q, known, dt)
    return [*memory, Memory("s_hat", s_hat, s, s_next), Memory("disturbance", q, ca.SX.zeros(n), q_next)], u


def _stretch(drift: Any, errors: OutputErrors, reference: Reference, dt: float | None) -> float:
    """Return by what factor surfaces move further over a step than their rates at its beginning say, 1 or more.

    Under a held command ds/dt = drift + E u goes on to change: where the law commands nu = E u + drift, at the rate
    a nu, a = d(drift + E u)/dx df/du E^+, to first order about the reference.
    """
    if dt is None:
        return 1.0
    pair = errors.pair
    slope = ca.jacobian(drift + errors.decoupling @ pair.u, pair.x) @ ca.jacobian(pair.f, pair.u)
    times = reference_times(reference)
    grown = [
        row[i] + np.sum(np.abs(np.delete(row, i)))
        for j, e in zip(
            pair.along(reference, times, slope), pair.along(reference, times, errors.decoupling), strict=True
        )
        for i, row in enumerate(j @ np.linalg.pinv(e))
    ]
    share = dt * max(0.0, float(np.max(grown)))
    return float(np.expm1(share) / share) if share > 0 else 1.0


def _require_decay(labels: Sequence[str], coefficients: Sequence[Array], switching: Switching) -> None:
    """Refuse steps over which the errors, sampled, grow from afar.

    The law holds e^(r) = -sum c_k e^(k+1) - rho over a step. From afar only what is linear in rho counts, k s: the
    rest is bounded or grows like |s|^alpha. Without k, s itself neither decays nor grows: the rates alone are judged.
    """
    if switching.dt is None:
        return
    k = switching.reaching.k if isinstance(switching.reaching, ExponentialRate) else 0.0
    for label, c in zip(labels, coefficients, strict=True):
        gain = k * c + np.append(0.0, c[:-1]) if k else c[:-1]
        if not gain.size:
            continue
        a, b = zero_order_hold(np.eye(gain.size, k=1), np.eye(gain.size)[:, [-1]], switching.dt)
        radius = spectral_radius(a - b @ gain[None])
        if radius >= 1:
            raise DesignError(
                f"control steps of {switching.dt:g} s are too long for the surface of '{label}': away from it "
                f"the sampled errors grow by a factor of {radius:.4g} per step; give a shorter dt, smaller slopes or a "
                "smaller rate k."
            )


def _weigh(c: Array, chain: Any, order: int) -> Any:
    """Return the sum of c_k times the derivative of order k + ``order`` of a chain, SX."""
    return sum((float(c_k) * chain[k + order] for k, c_k in enumerate(c)), ca.SX(0))


def _surface_facts(errors: OutputErrors, coefficients: Sequence[Array], switching: Switching) -> list[Fact]:
    """Return poles, the band of s and the steady error that it allows, and the sampling limit."""
    pairs = list(zip(errors.labels, coefficients, strict=True))
    poles = [Fact(f"surface poles of {label}", np.roots(c[::-1]), "1/s") for label, c in pairs if c.size > 1]
    facts, bands = [*poles, *switching.facts()], switching.sampled_bands
    if bands is not None:
        steady = np.array([band * _peak_gain(c) for band, c in zip(bands, coefficients, strict=True)])
        facts.append(Fact("steady error bound", steady, remark="of the outputs, from the band of s"))
    return facts


def _reaching(
    errors: OutputErrors,
    s: Any,
    coefficients: Sequence[Array],
    reference: Reference,
    switching: Switching,
    inverse: Inverse,
    options: SlidingOptions,
) -> Rehearsal | None:
    """Return the rehearsal of a start: how long the surface takes, with what the limits leave of the command."""
    start = options.start
    if start is None:
        return None
    t, pair, reaching = reference.initial_time, errors.pair, switching.reaching
    x = as_point(start, pair.x.numel(), "the state at the start", DesignError)
    first = np.asarray(pair.function(s)(t, x, reference.u(t), reference.x(t), reference.u(t)).full())[:, 0]
    ideal = np.array(
        [reaching.reaching_time(float(v), float(b)) for v, b in zip(first, switching.bounds, strict=True)]
    )
    rates = np.concatenate([np.empty(0), *[np.roots(c[::-1]) for c in coefficients]])
    slope = reaching.slope(switching.boundary)
    rates = np.abs(np.append(rates.real, slope if np.isfinite(slope) else 1.0))
    step = FINENESS / float(np.max(rates)) if switching.dt is None else switching.dt
    span = max(
        _SPAN / float(np.min(rates)),
        reference.duration,
        float(np.max(ideal[np.isfinite(ideal)], initial=0.0)),
    )

    def rehearsal(controller: Controller) -> list[Fact]:
        def watch(path: Path) -> Fact:
            return determinant_on(path, errors, reference, inverse, options.guard)

        path = rehearse(controller, Trial(errors, reference, x, switching.limits, step, span), watch)
        times, remark = ideal, "upper bound with ideal switching and the disturbance at its bound"
        if path.cut(switching.limits).any():
            times, remark = (
                _arrivals(path, controller, first, switching),
                "rehearsed within the limits, undisturbed",
            )
        return [
            Fact("s at the start", first),
            Fact("reaching time", times, "s", remark),
            *limit_facts(path, switching.limits, step),
            *drift_facts(path, errors, reference),
        ]

    return rehearsal


def _arrivals(path: Path, controller: Controller, first: Array, switching: Switching) -> Array:
    """Return when each s first changes its sign or enters its boundary layer (s after the start)."""
    s = path.memory[controller.memory.slice("s")][:, 1:]  # that of the step before
    layer = 1 / switching.boundary.slope
    there = (s * first[:, None] <= 0) | (np.abs(s) <= np.maximum(layer, switching.bands)[:, None])
    times = path.times[:-1] - path.times[0]
    return np.array([times[np.argmax(row)] if row.any() else np.inf for row in there])


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
    span, steps = _SETTLED / float(np.min(-poles.real)), _RESPONSE_STEPS
    forward = scipy.linalg.expm(companion * span / steps)
    state = scipy.linalg.expm(companion * 0.5 * span / steps)[:, -1]
    total = 0.0
    for _ in range(steps):
        total += abs(state[0]) * span / steps
        state = forward @ state
    return total
