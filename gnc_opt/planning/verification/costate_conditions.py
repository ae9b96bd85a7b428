r"""Pontryagin's minimum principle: costates, Hamiltonian and multipliers.

With :math:`H = w^T L + \lambda^T f`, :math:`H_a = H + \mu^T c` and :math:`\tilde\Phi = \Phi + \nu^T\psi`, a minimum
satisfies (Bryson & Ho, Applied Optimal Control, 1975, ch. 2-3; Hartl, Sethi & Vickson, SIAM Review 37(2), 1995)

* :math:`\dot\lambda = -\partial H_a/\partial x - z_x` with jumps only where a state
  constraint pushes (module `pushes`),
* :math:`\lambda(t_0) = -\partial\tilde\Phi/\partial x_0` and :math:`\lambda(t_f) = \partial\tilde\Phi/\partial x_f`
  in components that are free there, :math:`H(t_f) = -\partial\tilde\Phi/\partial t_f` and
  :math:`H(t_0) = \partial\tilde\Phi/\partial t_0` at free times,
* :math:`dH/dt = \partial H_a/\partial t`, with jumps where a state constraint that moves pushes,
* u minimises H among the admissible controls (module `controls`).

Offences are made dimensionless by what the terms of H and the products lambda x amount to along the phase, so
that no choice of units or scales can hide them.

Path constraints that are met at an end of a phase only, as boundary constraints.

Where :math:`c(t, x) \le 0` is reached at :math:`t_f`, say, and not before, it pushes with an atom
:math:`\eta \ge 0` there: :math:`\lambda(t_f) = \partial\Phi/\partial x_f + \eta\,\partial c/\partial x` (Hartl, Sethi &
Vickson, SIAM Review 37(2), 1995, theorem 4.1). So it is a condition on the end with :math:`\nu = \eta`, and that is how
the second order and normality take it: neither the points of a mesh nor switch times know of a limit at the ends.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array, Indices
from gnc_opt.planning.optimality.cost_scale import parameter_scale
from gnc_opt.planning.optimality.costate_jumps import end_push, jumps_explained, pushed_beside
from gnc_opt.planning.problem.constraints import make_constraint
from gnc_opt.planning.problem.functions import EndGradients
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.solution.quality import NOTHING, Worst, worst_index
from gnc_opt.planning.solution.samples import COSTATE_MIN_SHARE_OF_COST, PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.verdict import Condition
from gnc_opt.planning.verification.feasibility import judge
from gnc_opt.planning.verification.recomputed import ends_of
from gnc_opt.tolerances import AT_LIMIT

ENDS = (("initial", 0), ("final", -1))
"""The ends of a phase and their samples."""


def with_end_limits(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients
) -> tuple[Solution, EndGradients]:
    """Return the solution of the problem with these boundary constraints, their multipliers with it, and its ends."""
    met = [(s, end, at, rows) for s in samples for end, at in ENDS if (rows := _met_at(s, at)).size]
    if not met:
        return solution, ends
    problem, pushes = solution.need_problem("verify").clone(), [solution.constraint_multipliers]
    for s, end, at, rows in met:
        leg = problem.phases[s.leg.name]
        box = leg.path_interval()
        for row in rows:
            label = f"{s.leg.path_labels[row]}, {end} end of phase {s.leg.name}"
            expression = _at_end(leg, row, end)
            problem.constraints[label] = make_constraint(
                label, expression, box.lower[row], box.upper[row], None, f"constraint '{label}'"
            )
        pushes.append(end_push(s, at, ends).multipliers[rows])
    problem.changed()
    stated = replace(
        solution,
        problem=problem,
        constraint_multipliers=np.concatenate(pushes),
        constraint_labels=problem.constraint_labels(),
    )
    return stated, ends_of(stated)


def _met_at(s: PhaseSamples, at: int) -> Indices:
    """Path constraints without controls that are at a limit at an end of the phase, and not at the point beside it."""
    leg, pure = s.leg, s.pure_paths
    if not pure.size:
        return pure
    end, point = s.times[[at]], leg.point_times[[at]]
    values = np.hstack([s.functions.paths(t, leg.x(t), leg.flown(t)) for t in (end, point)])
    near = (
        np.any(leg.path_bounds.near(values, AT_LIMIT * s.path_scale), axis=0)
        & ~leg.path_bounds.fixed[:, None]
    )
    return np.asarray(pure[near[pure, 0] & ~near[pure, 1]])


def _at_end(leg: Phase, row: int, end: str) -> ca.SX:
    t, x, _, _ = leg.model.arguments()
    time = leg.initial_time if end == "initial" else leg.final_time
    return ca.substitute(leg.path_expression()[int(row)], ca.vertcat(t, x), ca.vertcat(time, leg.ends(end)))


def adjoint(samples: list[PhaseSamples], tolerance: float) -> Condition:
    """The costates satisfy their differential equation, and jump only where a state constraint pushes."""
    worst = NOTHING
    for s in samples:
        residual = s.adjoint_residual
        i, k = worst_index(residual)
        worst = worst.or_worse(
            Worst(float(residual[i, k]), s.segment_place(k, f"costate of {s.leg.states.labels[i]}"))
        )
        if s.leg.mesh.segments > 1:
            jumps = np.abs(jumps_explained(s)[0]) * s.state_scale[:, None] / s.cost_scale
            i, k = worst_index(jumps)
            place = f"phase {s.leg.name}, t = {s.leg.breaks[k + 1]:.6g} s, jump of the costate of "
            worst = worst.or_worse(Worst(float(jumps[i, k]), place + s.leg.states.labels[i]))
    return judge(
        "adjoint equation",
        worst,
        tolerance,
        "The costates must satisfy d(lambda)/dt = -dH/dx (integral of the residual over a segment, in shares of the "
        "cost) and jump only as active state constraints push, in the right direction; where not, refine the mesh or "
        "move its boundaries to the entries and exits of constrained arcs.",
    )


def transversality(samples: list[PhaseSamples], ends: EndGradients, tolerance: float) -> Condition:
    """Costates at free end values and H at free times match the gradients of cost and constraints."""
    worst = NOTHING
    for s in samples:
        worth = s.state_scale / s.cost_scale
        # The multiplier that would explain the gap must be one that the end's bounds can exert.
        pushes = {end: end_push(s, at, ends) for end, at in (("start", 0), ("end", -1))}
        for (end, push), at in zip(pushes.items(), (0, -1), strict=True):
            left = (push.gap - push.explained) * worth
            offence = _unexplained(left, s.x[:, at], push.limits, s.state_scale)
            i = int(np.argmax(offence))
            place = f"phase {s.leg.name}, {end}, costate of {s.leg.states.labels[i]}"
            worst = worst.or_worse(Worst(float(offence[i]), place))
        drifts = np.array([push.drift for push in pushes.values()])
        worst = worst.or_worse(_time_transversality(s, ends, drifts))
    return judge(
        "transversality",
        worst,
        tolerance,
        "Costates at free end values, and H at free times, must equal the gradients of cost and boundary "
        "constraints; a failure means that a cheaper end point is nearby.",
    )


def _time_transversality(s: PhaseSamples, ends: EndGradients, pushes: Array) -> Worst:
    """Of free times; ``pushes`` is what path constraints that depend on time do at both ends (module `pushes`)."""
    leg, name = s.leg, s.leg.name
    limits, lasts = leg.duration_bounds, np.array([leg.duration])
    # A multiplier of the duration counts only if a bound of the duration can exert it.
    exerted = np.array([leg.duration_multiplier])
    alone = np.copysign(_unexplained(exerted, lasts, limits, lasts), exerted)
    duration = float((exerted - alone)[0])
    gaps = np.array(
        [
            s.hamiltonian[0] - ends.initial_time[name] + duration,
            -s.hamiltonian[-1] - ends.final_time[name] - duration,
        ]
    )
    gaps -= pushes
    box = Interval(
        np.concatenate([leg.initial_time_bounds.lower, leg.final_time_bounds.lower]),
        np.concatenate([leg.initial_time_bounds.upper, leg.final_time_bounds.upper]),
    )
    times = np.array([leg.initial_time, leg.final_time])
    reach = box.upper - box.lower
    span = np.maximum(s.span, np.where(np.isfinite(reach), reach, 0.0))
    # A multiplier is told for times that are variables only.
    told = np.where(leg.time_multipliers != 0, np.abs(leg.time_multipliers - gaps), 0.0)
    offence = np.maximum(_unexplained(gaps, times, box, span), told) / s.hamiltonian_scale
    i = int(np.argmax(offence))
    worst = Worst(float(offence[i]), f"phase {name}, H at its {('start', 'end')[i]}")
    excess = float(np.abs(alone[0])) / s.hamiltonian_scale
    return worst.or_worse(Worst(excess, f"phase {name}, multiplier of its duration"))


def _unexplained(multipliers: Array, values: Array, box: Interval, scale: Array) -> Array:
    """Size of bound multipliers that the bounds cannot exert: >= 0 needs the upper, <= 0 the lower bound."""
    at_lower, at_upper = box.near(values, AT_LIMIT * scale)
    # A given value takes any multiplier; whether it is met is for the boundary conditions to say.
    allowed = np.where(multipliers > 0, at_upper, at_lower) | box.fixed
    return np.where(allowed, 0.0, np.abs(multipliers))


def hamiltonian(samples: list[PhaseSamples], tolerance: float) -> Condition:
    """H is constant, or changes only as its explicit dependence on time, and that of constraints that push, says."""
    worst = NOTHING
    for s in samples:
        drift = s.functions.time_gradient(s.times, s.x, s.u, s.lam, s.mu)
        expected = s.integral_from_start(drift)
        if s.leg.mesh.segments > 1:
            expected += np.append(0.0, np.cumsum(jumps_explained(s)[1]))[s.segments]
        levels = s.hamiltonian - expected
        told = levels[np.isfinite(levels)]
        offset = float(np.median(told)) if told.size else 0.0
        band = np.abs(levels - offset) / s.hamiltonian_scale
        j = int(np.argmax(np.where(np.isnan(band), np.inf, band)))
        where = f"{s.place(j)}, H = {s.hamiltonian[j]:.8g} (median {np.median(s.hamiltonian):.8g})"
        worst = worst.or_worse(Worst(float(band[j]), where))
    return judge(
        "Hamiltonian",
        worst,
        tolerance,
        "H must be constant along a phase (or follow its explicit dependence on time; band in shares of its terms); "
        "a band shows where control, costate and state do not belong together. Minimum time asks for H = -1, which "
        "transversality checks.",
    )


def complementarity(
    solution: Solution,
    samples: list[PhaseSamples],
    ends: EndGradients,
    amounts: Array,
    tolerance: float,
) -> Condition:
    """Multipliers push only at limits, and inwards.

    Parameters
    ----------
    amounts : array (n_constraints,)
        By how much the flight can change each boundary constraint (module `magnitude`).
    """
    worst = _end_multipliers(solution, samples, ends, amounts)
    for s in samples:
        worst = worst.or_worse(_impulses(s))
        leg = s.leg
        times = leg.point_times
        x, u = leg.x(times), np.hstack(leg.u.values)
        paths = s.functions.paths(times, x, u)
        # A density counts by its share of the segment: a tiny cell beside a jump may hold a large one.
        shares = np.concatenate([rule.weights / 2 for rule in leg.rules])
        for labels, multipliers, values, box, scale, worth in (
            (
                leg.states.labels,
                leg.state_multipliers,
                x,
                leg.state_bounds,
                s.state_scale,
                s.cost_scale / s.span,
            ),
            (
                leg.controls.labels,
                leg.control_multipliers,
                u,
                leg.control_bounds,
                s.control_span,
                s.joint_worth,
            ),
            (
                leg.path_labels,
                leg.path_multipliers,
                paths,
                leg.path_bounds,
                s.path_scale,
                _path_worth(s)[:, None],
            ),
        ):
            if labels:
                offence = _slack_offence(multipliers, values, box, scale) * shares / worth
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


def _path_worth(s: PhaseSamples) -> Array:
    """What multipliers of path constraints are measured against: controls, or states where none enters (n_paths,)."""
    worth = np.full(len(s.leg.path_labels), s.joint_worth)
    worth[s.pure_paths] = s.cost_scale / s.span
    return worth


def _end_multipliers(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, amounts: Array
) -> Worst:
    """Multipliers of boundary constraints that are not at the limit which could exert them."""
    problem, nu = solution.problem, solution.constraint_multipliers
    assert problem is not None, "verify refuses solutions without a problem"
    if not (nu.size and samples):
        return NOTHING
    box, values = problem.constraint_interval(), ends.constraints
    worth = max(s.cost_scale for s in samples)
    offence = _slack_offence(nu[:, None], values[:, None], box, amounts)[:, 0] / worth
    i = int(np.argmax(offence))
    return Worst(float(offence[i]), f"multiplier of constraint {solution.constraint_labels[i]}")


def _impulses(s: PhaseSamples) -> Worst:
    """Impulses of state bounds at inner segment boundaries that are not at the limit which could exert them."""
    leg, breaks = s.leg, s.leg.breaks[1:-1]
    if not breaks.size:
        return NOTHING
    impulses, beside = leg.state_impulses[:, 1:-1], pushed_beside(s, leg.state_multipliers)
    made_up_for = np.clip(impulses, np.minimum(-beside, 0.0), np.maximum(-beside, 0.0))
    offence = _slack_offence(impulses - made_up_for, leg.x(breaks), leg.state_bounds, s.state_scale)
    offence = offence / s.cost_scale
    i, k = worst_index(offence)
    return Worst(
        float(offence[i, k]), f"phase {leg.name}, t = {breaks[k]:.6g} s, impulse on {leg.states.labels[i]}"
    )


def _slack_offence(multipliers: Array, values: Array, box: Interval, scale: Array) -> Array:
    """|multiplier| times the room to the limit that could exert it (at most the scale)."""
    room_up = np.minimum(np.abs(box.upper[:, None] - values), scale[:, None])
    room_down = np.minimum(np.abs(values - box.lower[:, None]), scale[:, None])
    return np.abs(multipliers) * np.where(multipliers > 0, room_up, room_down)


def parameters(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, amounts: Array, tolerance: float
) -> Condition:
    """The cost is stationary in the free parameters.

    Parameters
    ----------
    amounts : array (n_free_parameters,)
        What the cost changes by each, per unit of it (module `magnitude`).
    """
    problem = solution.problem
    assert problem is not None, "verify refuses solutions without a problem"
    values, box = solution.parameter_values, problem.parameter_interval()
    scale = parameter_scale(solution)
    # The end terms cancel at a minimum, hence what the cost amounts to is the yardstick, not their sum.
    amount = max((s.cost_magnitude for s in samples), default=0.0)
    gradient, size = ends.parameters.copy(), np.maximum(amounts, COSTATE_MIN_SHARE_OF_COST * amount / scale)
    for s in samples:
        if gradient.size:
            density = s.functions.parameter_gradient(s.times, s.x, s.u, s.lam, s.mu)
            atoms = _parameter_atoms(s, ends)
            gradient = gradient + density @ s.weights + np.sum(atoms, axis=1)
            size = size + np.abs(density) @ s.weights + np.sum(np.abs(atoms), axis=1)
    worst = Worst(0.0, "no free parameter")
    if gradient.size:
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


def _parameter_atoms(s: PhaseSamples, ends: EndGradients) -> Array:
    """What pushes of no duration do to parameters, where path constraints are touched or met at an end (q, n_atoms)."""
    leg = s.leg
    pushes = [end_push(s, at, ends).multipliers for at in (0, -1)]
    atoms = np.column_stack([pushes[0], jumps_explained(s)[2], pushes[1]])
    times = leg.breaks[[0, *range(1, leg.mesh.segments), -1]]
    x, u = (np.hstack([p(times[:-1]), p(times[-1:], "left")]) for p in (leg.x, leg.flown))
    none = np.zeros_like(x)
    by_parameter, idle = (
        s.functions.parameter_gradient(times, x, u, none, mu) for mu in (atoms, 0.0 * atoms)
    )
    return np.asarray(by_parameter - idle)
