r"""Pontryagin's minimum principle, condition by condition, along the flown control.

With :math:`H = w^T L + \lambda^T f`, :math:`H_a = H + \mu^T c` and :math:`\tilde\Phi = \Phi + \nu^T\psi`, a minimum
satisfies (Bryson & Ho, Applied Optimal Control, 1975, ch. 2-3; Hartl, Sethi & Vickson, SIAM Review 37(2), 1995)

* :math:`\dot\lambda = -\partial H_a/\partial x - z_x` with jumps only where a state bound pushes,
* :math:`\lambda(t_0) = -\partial\tilde\Phi/\partial x_0` and :math:`\lambda(t_f) = \partial\tilde\Phi/\partial x_f`
  in components that are free there, :math:`H(t_f) = -\partial\tilde\Phi/\partial t_f` and
  :math:`H(t_0) = \partial\tilde\Phi/\partial t_0` at free times,
* :math:`dH/dt = \partial H_a/\partial t`,
* u minimises H among the admissible controls.

Offences are made dimensionless by what the terms of H and the products lambda x amount to along the phase, so
that no choice of units or scales can hide them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gnc_opt.model.layout import Array
from gnc_opt.problem.functions import EndGradients
from gnc_opt.problem.interval import Interval
from gnc_opt.verify.feasibility import judge
from gnc_opt.verify.quality import NOTHING, Worst, worst_index
from gnc_opt.verify.samples import PhaseSamples
from gnc_opt.verify.verdict import Condition, Result

if TYPE_CHECKING:
    from gnc_opt.solution.solution import Solution

AT_BOUND = 1e-6
"""A value this close to its bound, relative to the range, sits on it."""

CLEARLY_INSIDE = 1e-2
"""A control this far from both bounds, relative to the range, is between them on purpose."""

_GRID = 9
_MOST_TIMES = 400


def adjoint(samples: list[PhaseSamples], tolerance: float) -> Condition:
    """The costates satisfy their differential equation, and jump only where a state bound pushes."""
    worst = NOTHING
    for s in samples:
        gradient = s.functions.state_gradient(s.times, s.x, s.u, s.lam, s.mu)
        worth = s.state_scale[:, None] / s.cost_scale
        residual = s.per_segment(s.lam_rate + gradient + s.state_multiplier) * worth
        i, k = worst_index(residual)
        worst = worst.or_worse(
            Worst(float(residual[i, k]), s.segment_place(k, f"costate of {s.leg.states.labels[i]}"))
        )
        breaks = s.leg.breaks[1:-1]
        if breaks.size:
            jump = s.leg.lam(breaks, "left") - s.leg.lam(breaks, "right") - s.leg.state_impulses[:, 1:-1]
            jump = np.abs(jump) * worth
            i, k = worst_index(jump)
            place = (
                f"phase {s.leg.name}, t = {breaks[k]:.6g} s, jump of the costate of {s.leg.states.labels[i]}"
            )
            worst = worst.or_worse(Worst(float(jump[i, k]), place))
    return judge(
        "adjoint equation",
        worst,
        tolerance,
        "The costates must satisfy d(lambda)/dt = -dH/dx (integral of the residual over a segment, in shares of the "
        "cost) and be continuous but for the pushes of state bounds; where not, refine the mesh or move its "
        "boundaries to the entries and exits of constrained arcs.",
    )


def transversality(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, tolerance: float
) -> Condition:
    """Costates at free end values and H at free times match the gradients of cost and constraints."""
    worst = NOTHING
    for s in samples:
        name, leg = s.leg.name, s.leg
        starts = -(s.lam[:, 0] + ends.initial_state[name])
        finals = s.lam[:, -1] - ends.final_state[name]
        worth = s.state_scale / s.cost_scale
        # The multiplier that would explain the gap must be one that the end's bounds can exert.
        for end, gap, values, box in (
            ("start", starts, s.x[:, 0], _both(leg.initial_bounds, leg.state_bounds)),
            ("end", finals, s.x[:, -1], _both(leg.final_bounds, leg.state_bounds)),
        ):
            offence = _unexplained(gap * worth, values, box, s.state_scale)
            i = int(np.argmax(offence))
            worst = worst.or_worse(
                Worst(float(offence[i]), f"phase {name}, {end}, costate of {leg.states.labels[i]}")
            )
        worst = worst.or_worse(_time_transversality(s, ends))
    return judge(
        "transversality",
        worst,
        tolerance,
        "Costates at free end values, and H at free times, must equal the gradients of cost and boundary "
        "constraints; a failure means that a cheaper end point is nearby.",
    )


def _time_transversality(s: PhaseSamples, ends: EndGradients) -> Worst:
    leg, name = s.leg, s.leg.name
    duration = leg.duration_multiplier
    gaps = np.array(
        [
            s.hamiltonian[0] - ends.initial_time[name] + duration,
            -s.hamiltonian[-1] - ends.final_time[name] - duration,
        ]
    )
    box = Interval(
        np.concatenate([leg.initial_time_bounds.lower, leg.final_time_bounds.lower]),
        np.concatenate([leg.initial_time_bounds.upper, leg.final_time_bounds.upper]),
    )
    times = np.array([leg.initial_time, leg.final_time])
    span = np.full(2, max(leg.duration, 1e-9))
    offence = _unexplained(gaps / s.hamiltonian_scale, times, box, span)
    i = int(np.argmax(offence))
    return Worst(float(offence[i]), f"phase {name}, H at its {('start', 'end')[i]}")


def _both(a: Interval, b: Interval) -> Interval:
    return Interval(np.maximum(a.lower, b.lower), np.minimum(a.upper, b.upper))


def _unexplained(multipliers: Array, values: Array, box: Interval, scale: Array) -> Array:
    """Size of bound multipliers that the bounds cannot exert: >= 0 needs the upper, <= 0 the lower bound."""
    near = AT_BOUND * scale
    at_upper, at_lower = values >= box.upper - near, values <= box.lower + near
    allowed = np.where(multipliers > 0, at_upper, at_lower)
    return np.where(allowed, 0.0, np.abs(multipliers))


def hamiltonian(samples: list[PhaseSamples], tolerance: float) -> Condition:
    """H is constant, or changes only as its explicit dependence on time says."""
    worst = NOTHING
    for s in samples:
        drift = s.functions.time_gradient(s.times, s.x, s.u, s.lam, s.mu)
        expected = s.hamiltonian[0] + np.cumsum(drift * s.weights)
        expected = expected - 0.5 * drift * s.weights
        offset = float(np.median(s.hamiltonian - expected))
        largest = float(np.max(np.abs(s.hamiltonian)))
        scale = max(largest, 1e-3 * s.hamiltonian_scale)
        band = np.abs(s.hamiltonian - expected - offset) / scale
        j = int(np.argmax(np.where(np.isnan(band), np.inf, band)))
        where = f"{s.place(j)}, H = {s.hamiltonian[j]:.8g} (median {np.median(s.hamiltonian):.8g})"
        worst = worst.or_worse(Worst(float(band[j]), where))
    return judge(
        "Hamiltonian",
        worst,
        tolerance,
        "H must be constant along a phase (or follow its explicit dependence on time); a band shows where control, "
        "costate and state do not belong together. Minimum time asks for H = -1, which transversality checks.",
    )


def _offences(s: PhaseSamples) -> tuple[Array, NDArray[np.bool_]]:
    """First-order loss in H of each control, in shares of H's scale, and whether it sits on a bound."""
    bounds, scale = s.leg.control_bounds, s.control_scale
    gradient = s.control_gradient
    near = (AT_BOUND * scale)[:, None]
    at_lower, at_upper = s.u <= bounds.lower[:, None] + near, s.u >= bounds.upper[:, None] - near
    room_down = np.where(at_lower, 0.0, np.minimum(s.u - bounds.lower[:, None], scale[:, None]))
    room_up = np.where(at_upper, 0.0, np.minimum(bounds.upper[:, None] - s.u, scale[:, None]))
    loss = np.abs(gradient) * np.where(gradient > 0, room_down, room_up) / s.hamiltonian_scale
    return loss, at_lower | at_upper


def _inside(s: PhaseSamples) -> NDArray[np.bool_]:
    """Where each control is clearly between its bounds, (m, n_samples)."""
    bounds, margin = s.leg.control_bounds, (CLEARLY_INSIDE * s.control_scale)[:, None]
    return np.asarray((s.u > bounds.lower[:, None] + margin) & (s.u < bounds.upper[:, None] - margin))


def stationarity(samples: list[PhaseSamples], tolerance: float) -> Condition:
    """dH/du vanishes where a control is between its bounds."""
    worst = NOTHING
    for s in samples:
        loss, on_bound = _offences(s)
        worst = worst.or_worse(_worst_control(s, np.where(on_bound, 0.0, loss)))
    return judge(
        "stationarity",
        worst,
        tolerance,
        "Where a control is strictly between its bounds, dH/du (with path multipliers) must vanish (first-order gain "
        "in H that is left). A bang-bang control smeared over a switch fails here: put a mesh boundary on the switch.",
    )


def control_signs(samples: list[PhaseSamples], tolerance: float) -> Condition:
    """Each control on a bound sits on the right one for its switching function."""
    worst = NOTHING
    for s in samples:
        loss, on_bound = _offences(s)
        worst = worst.or_worse(_worst_control(s, np.where(on_bound, loss, 0.0)))
    return judge(
        "control signs",
        worst,
        tolerance,
        "A control on its lower bound needs a switching function dH/du >= 0, on its upper bound <= 0 (first-order gain "
        "in H that is left). A wrong sign means a switch in the wrong place, or an arc that is missing.",
    )


def _worst_control(s: PhaseSamples, loss: Array) -> Worst:
    if not loss.size:
        return NOTHING
    i, j = worst_index(loss)
    return Worst(float(loss[i, j]), s.place(j, s.leg.controls.labels[i]))


def minimum(samples: list[PhaseSamples], tolerance: float) -> Condition:
    """No other admissible control has a smaller H (sampled)."""
    meaning = (
        "At every time the control must give the smallest H among all admissible ones, not only a stationary one "
        "(checked against a grid of other controls; share of H's scale that could be gained)."
    )
    worst = NOTHING
    for s in samples:
        if s.leg.controls.size:
            worst = worst.or_worse(_sampled_minimum(s))
    return judge("minimum principle", worst, tolerance, meaning)


def _sampled_minimum(s: PhaseSamples) -> Worst:
    chosen = np.unique(np.linspace(0, s.times.size - 1, _MOST_TIMES).astype(int))
    times, x, u, lam = s.times[chosen], s.x[:, chosen], s.u[:, chosen], s.lam[:, chosen]
    base = s.functions.hamiltonian(times, x, u, lam)
    gain = np.zeros(chosen.size)
    for other in _other_controls(s, u):
        value = s.functions.hamiltonian(times, x, other, lam)
        admissible = _admissible(s, times, x, other) & np.isfinite(value)
        gain = np.maximum(gain, np.where(admissible, base - value, 0.0))
    gain = np.where(np.isnan(base), np.inf, gain / s.hamiltonian_scale)
    j = int(np.argmax(gain))
    return Worst(float(gain[j]), s.place(int(chosen[j])))


def _other_controls(s: PhaseSamples, u: Array) -> list[Array]:
    """Controls that differ from u in one channel, and the corners of the box where they are few."""
    bounds, m = s.leg.control_bounds, u.shape[0]
    reach = 2.0 * np.maximum(np.max(np.abs(u), axis=1), s.control_scale)
    lower = np.where(np.isfinite(bounds.lower), bounds.lower, -reach)
    upper = np.where(np.isfinite(bounds.upper), bounds.upper, reach)
    others = []
    for i in range(m):
        for value in np.linspace(lower[i], upper[i], _GRID):
            other = u.copy()
            other[i] = value
            others.append(other)
    if m <= 6:
        for corner in range(2**m):
            high = (corner >> np.arange(m)) & 1
            others.append(np.tile(np.where(high, upper, lower)[:, None], u.shape[1]))
    return others


def _admissible(s: PhaseSamples, times: Array, x: Array, u: Array) -> NDArray[np.bool_]:
    """Where controls respect the path constraints that depend on controls."""
    bounds = s.leg.path_bounds
    if not s.leg.path_labels:
        return np.ones(times.size, dtype=bool)
    values = s.functions.paths(times, x, u)
    mixed = np.any(s.functions.path_control_jacobian(times, x, u) != 0, axis=(1, 2))
    inside = (values >= bounds.lower[:, None] - AT_BOUND) & (values <= bounds.upper[:, None] + AT_BOUND)
    return np.asarray(np.all(inside | ~mixed[:, None], axis=0))


def complementarity(samples: list[PhaseSamples], tolerance: float) -> Condition:
    """Multipliers push only at limits, and inwards."""
    worst = NOTHING
    for s in samples:
        leg = s.leg
        times = leg.point_times
        x, u = leg.x(times), np.hstack(leg.u.values)
        paths = s.functions.paths(times, x, u)
        path_scale = np.maximum(np.max(np.abs(paths), axis=1, initial=0.0), 1e-6)
        span = leg.duration if leg.duration > 0 else 1.0
        for labels, multipliers, values, box, scale, worth in (
            (
                leg.states.labels,
                leg.state_multipliers,
                x,
                leg.state_bounds,
                s.state_scale,
                s.cost_scale / span,
            ),
            (
                leg.controls.labels,
                leg.control_multipliers,
                u,
                leg.control_bounds,
                s.control_scale,
                s.hamiltonian_scale,
            ),
            (leg.path_labels, leg.path_multipliers, paths, leg.path_bounds, path_scale, s.hamiltonian_scale),
        ):
            if labels:
                offence = _slack_offence(multipliers, values, box, scale) / worth
                i, j = worst_index(offence)
                where = f"phase {leg.name}, t = {times[j]:.6g} s, multiplier of {labels[i]}"
                worst = worst.or_worse(Worst(float(offence[i, j]), where))
    return judge(
        "complementarity",
        worst,
        tolerance,
        "Multipliers of bounds and path constraints must vanish away from the limit and push inwards at it; a failure "
        "means a tighter solver tolerance is needed, or that the multipliers belong to another trajectory.",
    )


def _slack_offence(multipliers: Array, values: Array, box: Interval, scale: Array) -> Array:
    """|multiplier| times the room to the limit that could exert it (at most the scale)."""
    room_up = np.minimum(np.abs(box.upper[:, None] - values), scale[:, None])
    room_down = np.minimum(np.abs(values - box.lower[:, None]), scale[:, None])
    return np.abs(multipliers) * np.where(multipliers > 0, room_up, room_down)


def legendre_clebsch(samples: list[PhaseSamples], tolerance: float) -> Condition:
    """The Hessian of H in the controls that are not on a bound is positive definite (strengthened form)."""
    name = "Legendre-Clebsch"
    meaning = (
        "In controls between their bounds the Hessian of H must be positive definite (value: smallest eigenvalue with "
        "its sign reversed, in shares of H's scale): negative curvature means a maximum, none leaves it open."
    )
    places = [(value, place) for value, place in map(_least_curvature, samples) if place is not None]
    if not places:
        return Condition(name, Result.PASS, 0.0, -tolerance, "no control between its bounds", meaning)
    least, place = min(places, key=lambda item: item[0])
    result = Result.PASS if least >= tolerance else Result.CANNOT_TELL if least > -tolerance else Result.FAIL
    return Condition(name, result, -least, -tolerance, place, meaning)


def _least_curvature(s: PhaseSamples) -> tuple[float, str | None]:
    hessians = s.functions.control_hessian(s.times, s.x, s.u, s.lam, s.mu)
    scaled = hessians * s.control_scale[:, None, None] * s.control_scale[None, :, None] / s.hamiltonian_scale
    interior = _inside(s)
    least, place = np.inf, None
    for j in range(s.times.size):
        curvature = _reduced_curvature(s, j, scaled[:, :, j], interior[:, j])
        if curvature is not None and curvature < least:
            least, place = curvature, s.place(j)
    return float(least), place


def _reduced_curvature(s: PhaseSamples, j: int, hessian: Array, interior: NDArray[np.bool_]) -> float | None:
    """Least eigenvalue on interior controls, tangent to active mixed path constraints; None if none is free."""
    free = np.flatnonzero(interior)
    if not free.size:
        return None
    reduced = hessian[np.ix_(free, free)]
    if s.leg.path_labels:
        t, x, u = s.times[j], s.x[:, j], s.u[:, j]
        values = s.functions.paths(t, x, u)
        box = s.leg.path_bounds
        near = 1e-5 * np.maximum(1.0, np.abs(values))
        active = (values >= box.upper - near) | (values <= box.lower + near)
        rows = s.functions.path_control_jacobian(t, x, u)[np.ix_(active, free)] * s.control_scale[free]
        _, sizes, basis = np.linalg.svd(rows, full_matrices=True)
        rank = int(np.sum(sizes > 1e-9 * max(1.0, float(np.max(sizes, initial=0.0)))))
        tangent = basis[rank:].T
        if not tangent.shape[1]:
            return None
        reduced = tangent.T @ reduced @ tangent
    return float(np.linalg.eigvalsh(0.5 * (reduced + reduced.T))[0])


def singular_arcs(samples: list[PhaseSamples], tolerance: float) -> Condition:
    """No control is between its bounds where H does not determine it."""
    meaning = (
        "Where a control is between its bounds, dH/du and the curvature of H both vanish: H does not determine the "
        "control there, and first-order conditions alone do not prove it (a singular arc, or a chattering solution)."
    )
    total, place = 0.0, "nowhere"
    for s in samples:
        loss, inside = _offences(s)[0], _inside(s)
        hessians = s.functions.control_hessian(s.times, s.x, s.u, s.lam, s.mu)
        curvature = (
            np.abs(np.einsum("iij->ij", hessians)) * s.control_scale[:, None] ** 2 / s.hamiltonian_scale
        )
        singular = inside & (loss <= tolerance) & (curvature <= tolerance)
        lengths = np.sum(singular * s.weights, axis=1) / max(s.leg.duration, 1e-9)
        if lengths.size and lengths.max() > total:
            i = int(np.argmax(lengths))
            total = float(lengths[i])
            j = int(np.flatnonzero(singular[i])[0])
            place = f"from {s.place(j, s.leg.controls.labels[i])}, {100 * total:.1f} % of the phase"
    result = Result.PASS if total <= tolerance else Result.CANNOT_TELL
    return Condition("singular arcs", result, total, tolerance, place, meaning)


def parameters(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, tolerance: float
) -> Condition:
    """The cost is stationary in the free parameters."""
    problem = solution.problem
    assert problem is not None, "verify refuses solutions without a problem"
    gradient = ends.parameters.copy()
    size = np.abs(gradient)
    for s in samples:
        if gradient.size:
            density = s.functions.parameter_gradient(s.times, s.x, s.u, s.lam, s.mu)
            gradient = gradient + density @ s.weights
            size = size + np.abs(density) @ s.weights
    worst = Worst(0.0, "no free parameter")
    if gradient.size:
        box = problem.parameter_interval()
        values = solution.parameter_values
        scale = np.maximum(np.abs(values), 1e-6)
        # L + z q stationary: the multiplier a bound would have to exert is -gradient.
        offence = _unexplained(-gradient / np.where(size > 0, size, 1.0), values, box, scale)
        i = int(np.argmax(offence))
        worst = Worst(float(offence[i]), f"parameter {solution.free_parameters.labels[i]}")
    return judge(
        "parameters",
        worst,
        tolerance,
        "The derivative of the cost (with constraints) with respect to a free parameter must vanish, or push against "
        "the bound on which it sits.",
    )
