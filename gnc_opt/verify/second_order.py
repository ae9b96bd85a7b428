r"""Second-order sufficient conditions of a bang-bang solution.

For controls that sit on their bounds everywhere, the control problem is one of finitely many unknowns: the
switch times and the free end times, :math:`\theta`. A first-order point is a strict local minimum if (Maurer &
Osmolovskii, SIAM J. Control Optim. 42(6), 2004; Osmolovskii & Maurer, Applications to Regular and Bang-Bang Control,
SIAM 2012, ch. 5-7)

* every switching function crosses zero with a slope of the right sign where its control switches, one
  control at a time (strict bang-bang property), and
* the Hessian of the Lagrangian :math:`\Phi + \nu^T\psi` in :math:`\theta` is positive definite on the
  null space of the constraints' Jacobian.

The induced problem is built from the model alone: explicit integration from switch to switch, differentiated
twice (module `bang_bang_flow`); neither collocation nor the solver takes part.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.problem.functions import EndGradients, end_function
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.quality import worst_index
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.solution.solution import Solution
from gnc_opt.tolerances import AT_LIMIT, RANK, TINY
from gnc_opt.verify.bang_bang_flow import bang_bang_flow
from gnc_opt.verify.verdict import Condition, Result

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
    if least == np.inf:
        return Condition("strict switches", Result.PASS, 0.0, 0.0, place, meaning, sufficient=True)
    result = Result.PASS if least > 0 else Result.FAIL
    return Condition("strict switches", result, -least, 0.0, place, meaning, sufficient=True)


def _least_slope(s: PhaseSamples) -> tuple[float, str]:
    leg = s.leg
    times = leg.breaks[list(leg.mesh.movable)]
    if not (times.size and leg.controls.size):
        return np.inf, ""
    before, after = leg.flown(times, "left"), leg.flown(times, "right")
    neighbours = np.searchsorted(leg.breaks, times)
    widths = np.minimum(times - leg.breaks[neighbours - 1], leg.breaks[neighbours + 1] - times)
    sides = np.concatenate([times - BESIDE * widths, times + BESIDE * widths])
    mu = leg.path_multiplier(sides)
    values = s.functions.control_gradient(sides, leg.x(sides), leg.flown(sides), leg.lam(sides), mu)
    early, late = np.hsplit(values, 2)
    unit = s.control_scale[:, None] * leg.duration / s.hamiltonian_scale
    slopes = (late - early) / (2 * BESIDE * widths) * unit
    # Onto a singular arc the switching function comes in flat.
    switches = np.abs(after - before) > (1 - AT_LIMIT) * s.control_scale[:, None]
    signed = np.where(switches, -np.sign(after - before) * slopes, np.inf)
    signed[np.isnan(signed)] = -np.inf
    i, j = np.unravel_index(np.argmin(signed), signed.shape)
    return float(signed[i, j]), f"phase {leg.name}, t = {times[j]:.6g} s, {leg.controls.labels[i]}"


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
        return Condition(name, Result.CANNOT_TELL, float("nan"), 0.0, reason, meaning, sufficient=True)
    s = samples[0]
    reduced = induced_problem(solution, s, ends).reduced_hessian()
    if not reduced.size:
        place = f"phase {s.leg.name}: as many conditions as switch times, nothing is left to vary"
        return Condition(name, Result.PASS, 0.0, 0.0, place, meaning, sufficient=True)
    eigenvalues = np.linalg.eigvalsh(reduced)
    least, largest = float(eigenvalues[0]), float(np.max(np.abs(eigenvalues)))
    place = f"phase {s.leg.name}, {eigenvalues.size} degrees of freedom"
    result = Result.PASS if least > CURVATURE * largest else Result.FAIL
    return Condition(name, result, -least, 0.0, place, meaning, sufficient=True)


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
    times = leg.breaks[list(leg.mesh.anchors)]
    free_start = np.flatnonzero(leg.initial_bounds.lower != leg.initial_bounds.upper)
    fixed_end = np.flatnonzero(leg.final_bounds.lower == leg.final_bounds.upper)
    flow = bang_bang_flow(problem, s, times, free_start)
    derivatives = problem.once("end derivatives", lambda: _end_derivatives(problem))
    numbers = (s.functions.p, s.functions.q, solution.constraint_multipliers)
    at_ends, ends_hessian, ends_jacobian = (v.full() for v in derivatives(flow.initial, flow.final, *numbers))
    at_start, at_end = np.split(at_ends.ravel(), 2)
    at_end[fixed_end] += (s.lam[:, -1] - ends.final_state[leg.name])[fixed_end]
    changes = np.vstack([flow.initial_sensitivity, flow.final_sensitivity])
    gradient = np.concatenate([at_start, at_end]) @ changes
    hessian = changes.T @ ends_hessian @ changes + flow.curvature(at_end)
    jacobian = np.vstack([flow.final_sensitivity[fixed_end], ends_jacobian @ changes])
    labels = [f"time {k}" for k in range(times.size)]
    labels += [f"initial {leg.states.labels[i]}" for i in free_start]
    free = np.ones(len(labels), dtype=bool)
    free[0], free[times.size - 1] = ~leg.initial_time_bounds.fixed[0], ~leg.final_time_bounds.fixed[0]
    return InducedProblem(
        gradient[free], hessian[np.ix_(free, free)], jacobian[:, free], tuple(np.array(labels)[free])
    )


def _end_derivatives(problem: Problem) -> Any:
    """Gradient and Hessian of the cost and the constraints with their multipliers, and the constraints' Jacobian.

    A CasADi Function of (states, integrals, time) at the start, the same at the end, p, q and nu; all derivatives are
    by the first two.
    """
    ends = end_function(problem)
    x0, xf, t0, tf, integrals, p, q, nu = (ca.SX.sym("v", ends.size1_in(i)) for i in range(8))
    cost, constraints, *_ = ends(x0, xf, t0, tf, integrals, p, q, nu)
    unused = ca.SX.sym("unused", integrals.shape[0])
    start, final = ca.vertcat(x0, unused, t0), ca.vertcat(xf, integrals, tf)
    varied = ca.vertcat(start, final)
    hessian, gradient = ca.hessian(problem.sense * cost + ca.dot(nu, constraints), varied)
    jacobian = ca.jacobian(constraints, varied)
    return ca.Function("end_derivatives", [start, final, p, q, nu], [gradient, hessian, jacobian])
