r"""Second-order sufficient conditions of a bang-bang solution.

For controls that sit on their bounds everywhere, the control problem is one of finitely many unknowns: the
switch times and the free end times, :math:`\theta`. A first-order point is a strict local minimum if (Maurer &
Osmolovskii, SIAM J. Control Optim. 42(6), 2004; Osmolovskii & Maurer, Applications to Regular and Bang-Bang Control,
SIAM 2012, ch. 5-7)

* every switching function crosses zero with a slope of the right sign where its control switches, one
  control at a time (strict bang-bang property), and
* the Hessian of the Lagrangian :math:`\Phi + \nu^T\psi` in :math:`\theta` is positive definite on the
  null space of the constraints' Jacobian.

The induced problem is built here from the model alone: explicit integration from switch to switch, differentiated
twice; neither collocation nor the solver takes part.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.problem.functions import EndGradients, end_function
from gnc_opt.solution.quality import worst_index
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.solution.solution import Solution
from gnc_opt.tolerances import AT_LIMIT, RANK, TINY
from gnc_opt.verify.verdict import Condition, Result

STEPS = 300
"""Runge-Kutta steps over the phase, and at least `LEAST_STEPS` from switch to switch."""

LEAST_STEPS = 4

BESIDE = 1e-4
"""How far from a switch its slope is taken, in shares of the shorter neighbouring segment."""

ACTIVE_PATH, ACTIVE_STATE = 1e-6, 1e-4
"""Multipliers above these, in shares of H and of the cost, are those of active constraints."""

CURVATURE = 1e-9
"""Least eigenvalue of the reduced Hessian, relative to the largest, that counts as positive."""


def strict_switches(samples: list[PhaseSamples]) -> Condition:
    """Switching functions cross zero with the right slope at every switch."""
    meaning = (
        "At a switch the switching function must pass through zero with a slope (value: smallest slope with its sign "
        "reversed, in shares of H per phase); a touching zero means that the arc next to it could vanish or grow."
    )
    least, place = np.inf, "no switch"
    for s in samples:
        slope, where = _least_slope(s)
        if slope < least:
            least, place = slope, where
    if not np.isfinite(least):
        return Condition("strict switches", Result.PASS, 0.0, 0.0, place, meaning)
    result = Result.PASS if least > 0 else Result.FAIL
    return Condition("strict switches", result, -least, 0.0, place, meaning)


def _least_slope(s: PhaseSamples) -> tuple[float, str]:
    leg = s.leg
    times = leg.breaks[list(leg.mesh.movable)] if leg.mesh.movable else np.zeros(0)
    least, place = np.inf, ""
    for t in times:
        before, after = leg.flown(t, "left"), leg.flown(t, "right")
        step = BESIDE * min(t - leg.breaks[leg.breaks < t][-1], leg.breaks[leg.breaks > t][0] - t)
        sides = np.array([t - step, t + step])
        mu = leg.path_multiplier(sides)
        values = s.functions.control_gradient(sides, leg.x(sides), leg.flown(sides), leg.lam(sides), mu)
        slopes = (
            (values[:, 1] - values[:, 0]) / (2 * step) * s.control_scale * leg.duration / s.hamiltonian_scale
        )
        # Onto a singular arc the switching function comes in flat.
        for i in np.flatnonzero(np.abs(after - before) > (1 - AT_LIMIT) * s.control_scale):
            signed = -float(np.sign(after[i] - before[i]) * slopes[i])
            if signed < least:
                least, place = signed, f"phase {leg.name}, t = {t:.6g} s, {leg.controls.labels[i]}"
    return least, place


@dataclass(frozen=True)
class InducedProblem:
    """Lagrangian of the switch-time problem at a solution.

    Attributes
    ----------
    gradient : array (n,)
    hessian : array (n, n)
    jacobian : array (n_constraints, n)
        Of the final values that are fixed and the boundary constraints.
    labels : tuple of str
        The unknowns.
    """

    gradient: Array
    hessian: Array
    jacobian: Array
    labels: tuple[str, ...]

    def reduced_hessian(self) -> Array:
        """Hessian on the null space of the constraints' Jacobian."""
        _, sizes, basis = np.linalg.svd(self.jacobian, full_matrices=True)
        rank = int(np.sum(sizes > RANK * max(float(np.max(sizes, initial=0.0)), TINY)))
        null = basis[rank:].T
        reduced = null.T @ self.hessian @ null
        return np.asarray(0.5 * (reduced + reduced.T))


def second_order(solution: Solution, samples: list[PhaseSamples], ends: EndGradients) -> Condition:
    """The reduced Hessian of the induced switch-time problem is positive definite."""
    name = "second order"
    meaning = (
        "The Hessian of the switch-time problem's Lagrangian, on directions that keep the boundary conditions, must be "
        "positive definite (value: its smallest eigenvalue with the sign reversed, cost per s^2)."
    )
    reason = _why_not(samples)
    if reason:
        return Condition(name, Result.CANNOT_TELL, float("nan"), 0.0, reason, meaning)
    s = samples[0]
    reduced = induced_problem(solution, s, ends).reduced_hessian()
    if not reduced.size:
        place = f"phase {s.leg.name}: as many conditions as switch times, nothing is left to vary"
        return Condition(name, Result.PASS, 0.0, 0.0, place, meaning)
    eigenvalues = np.linalg.eigvalsh(reduced)
    least, largest = float(eigenvalues[0]), float(np.max(np.abs(eigenvalues)))
    place = f"phase {s.leg.name}, {eigenvalues.size} degrees of freedom"
    result = Result.PASS if least > CURVATURE * largest else Result.FAIL
    return Condition(name, result, -least, 0.0, place, meaning)


def _why_not(samples: list[PhaseSamples]) -> str:
    """Why the induced problem cannot be built, or nothing."""
    if len(samples) != 1:
        return "several phases: the induced problem of one phase says nothing about the others"
    s = samples[0]
    at_lower, at_upper = s.leg.control_bounds.near(s.u, AT_LIMIT * s.control_scale)
    on_bound = at_lower | at_upper
    if not np.all(on_bound):
        i, j = worst_index((~on_bound).astype(float))
        return f"{s.place(j, s.leg.controls.labels[i])}: a control between its bounds"
    if np.max(np.abs(s.leg.path_multipliers), initial=0.0) > ACTIVE_PATH * s.hamiltonian_scale:
        return "an active path constraint"
    worth = np.abs(s.leg.state_multipliers) * s.state_scale[:, None] * s.leg.duration
    if np.max(worth, initial=0.0) > ACTIVE_STATE * s.cost_scale:
        return "an active state bound"
    return ""


def induced_problem(solution: Solution, s: PhaseSamples, ends: EndGradients) -> InducedProblem:
    """Differentiate the induced problem of a single-phase bang-bang solution at its switch times."""
    problem, leg = solution.problem, s.leg
    assert problem is not None, "verify refuses solutions without a problem"
    anchors = leg.breaks[list(leg.mesh.anchors)]
    first, last = 0, anchors.size - 1
    free_start = np.flatnonzero(leg.initial_bounds.lower != leg.initial_bounds.upper)
    fixed_end = np.flatnonzero(leg.final_bounds.lower == leg.final_bounds.upper)
    times = ca.MX.sym("times", anchors.size)
    start = ca.MX.sym("start", free_start.size)
    initial = ca.MX(ca.DM(leg.x(leg.breaks[0])))
    if free_start.size:
        initial[free_start.tolist()] = start
    final = _flow(s, initial, times, anchors)
    n = leg.states.size
    cost, constraints, *_ = end_function(problem)(
        initial,
        final[:n],
        times[first],
        times[last],
        final[n:],
        s.functions.p,
        s.functions.q,
        np.zeros(len(problem.constraint_labels())),
    )
    rows = ca.vertcat(final[fixed_end.tolist()], constraints)
    nu_end = (s.lam[:, -1] - ends.final_state[leg.name])[fixed_end]
    lagrangian = problem.sense * cost + ca.dot(
        ca.DM(np.append(nu_end, solution.constraint_multipliers)), rows
    )
    kept = [
        k
        for k in range(anchors.size)
        if not (k == first and leg.initial_time_bounds.fixed[0])
        and not (k == last and leg.final_time_bounds.fixed[0])
    ]
    unknowns = ca.vertcat(times, start)
    places = [*kept, *range(anchors.size, anchors.size + free_start.size)]
    hessian, gradient = ca.hessian(lagrangian, unknowns)
    function = ca.Function("induced", [unknowns], [gradient, hessian, ca.jacobian(rows, unknowns)])
    point = np.concatenate([anchors, leg.x(leg.breaks[0])[free_start]])
    g, h, j = (np.asarray(v.full()) for v in function(point))
    labels = [f"time {k}" for k in kept] + [f"initial {leg.states.labels[i]}" for i in free_start]
    return InducedProblem(g.ravel()[places], h[np.ix_(places, places)], j[:, places], tuple(labels))


def _flow(s: PhaseSamples, initial: Any, times: Any, anchors: Array) -> Any:
    """Final states and integrals (MX) after flying each piece's constant control between symbolic times."""
    step, n_integrals = _runge_kutta_step(s)
    state = ca.vertcat(initial, ca.MX(n_integrals, 1), times[0])
    span = anchors[-1] - anchors[0]
    for k, (left, right) in enumerate(pairwise(anchors)):
        count = LEAST_STEPS + int(np.ceil(STEPS * (right - left) / span))
        control = s.leg.flown(0.5 * (left + right))
        width = (times[k + 1] - times[k]) / count
        state = step.fold(count)(state, ca.repmat(ca.vertcat(width, ca.DM(control)), 1, count))
    return state[:-1]


def _runge_kutta_step(s: PhaseSamples) -> tuple[Any, int]:
    """One classical fourth-order step of (x, integrals, t) as a CasADi Function of (state, [width; control])."""
    rates, integrands = s.functions.functions["rates"], s.functions.functions["integrands"]
    n, m, n_integrals = s.leg.states.size, s.leg.controls.size, s.leg.integrals.size
    state, inputs = ca.SX.sym("state", n + n_integrals + 1), ca.SX.sym("inputs", 1 + m)
    width, control = inputs[0], inputs[1:]

    def derivative(z: Any) -> Any:
        numbers = (
            np.zeros(n),
            np.zeros(len(s.leg.path_labels)),
            s.functions.weights,
            s.functions.p,
            s.functions.q,
        )
        here = (z[-1], z[:n], control, *numbers)
        return ca.vertcat(rates(*here), integrands(*here), 1)

    k1 = derivative(state)
    k2 = derivative(state + 0.5 * width * k1)
    k3 = derivative(state + 0.5 * width * k2)
    k4 = derivative(state + width * k3)
    return ca.Function(
        "step", [state, inputs], [state + width / 6 * (k1 + 2 * k2 + 2 * k3 + k4)]
    ), n_integrals
