r"""Costates where switches of several controls share one time.

A program with one unknown for several switches knows only that the sum of their values vanishes there: its
multipliers are not unique, and those that the solver returns need not make each switching function vanish. The
multipliers that do are those of the induced problem, which has an unknown for every switch (module
`gnc_opt.planning.optimality.switching_problem`). From the solver's they differ by a solution of the
homogeneous adjoint equation,

.. math:: \delta\dot\lambda = -f_x^T\,\delta\lambda - L_x^T\,\delta w, \qquad
          \delta\lambda(t_f) = \delta\,\frac{\partial\tilde\Phi}{\partial x_f} + \delta\nu_f,

with the weights w of the integrals and the multipliers :math:`\nu_f` of values held at the end.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.planning.optimality.switches import Switches
from gnc_opt.planning.optimality.switching_problem import InducedProblem, Unknowns
from gnc_opt.planning.problem.functions import EndGradients, PhaseFunctions
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.polynomial import PiecewisePolynomial
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.quadrature import gauss_rule
from gnc_opt.planning.verification.bang_bang_second_order import least_squares, obstacle
from gnc_opt.planning.verification.recomputed import ends_of, from_problem

REFINEMENT = 4
"""Of the integration of the induced problem."""

COSTATE_POINTS_PER_SEGMENT = 16
"""Of the integration of costates, in every segment."""


def settle_costates(solution: Solution) -> Solution:
    """Return a bang-bang solution with costates that make every switching function vanish at its switches.

    Solutions without simultaneous switches, and those that are not bang-bang, are returned as they are.
    """
    samples = list(solution.samples().values())
    if obstacle(samples) or all(len(group) == 1 for s in samples for group in Switches.of(s).groups):
        return solution
    judged = from_problem(solution)
    samples = list(judged.samples().values())
    switches = {s.leg.name: Switches.of(s) for s in samples}
    before = ends_of(judged)
    unknowns = Unknowns.of(judged, samples, switches)
    pieces = {name: s.pieces(next(s.orders())) for name, s in switches.items()}
    induced = InducedProblem.of(judged, samples, before, unknowns, pieces, REFINEMENT)
    active, _, norms, multipliers = least_squares(induced.gradient, induced.conditions.jacobian, induced)
    change = np.zeros(induced.conditions.values.size)
    change[active] = multipliers / norms - induced.conditions.multipliers[active]
    n_states, n_constraints = sum(s.leg.states.size for s in samples), judged.constraint_multipliers.size
    at_ends, of_constraints = change[:n_states], change[n_states : n_states + n_constraints]
    nu = solution.constraint_multipliers + of_constraints
    after = ends_of(replace(judged, constraint_multipliers=nu))
    phases, row = {}, 0
    for s in samples:
        name, n = s.leg.name, s.leg.states.size
        final = at_ends[row : row + n] + after.final_state[name] - before.final_state[name]
        weights = after.integrals[name] - before.integrals[name]
        phases[name] = _shifted(solution.phases[name], s, final, weights, before, after)
        row += n
    return replace(solution, phases=phases, constraint_multipliers=nu)


def _backwards(
    leg: PhaseSolution, functions: PhaseFunctions, final: Array
) -> Iterator[tuple[int, PiecewisePolynomial]]:
    """Yield every segment, the last one first, with the solution of the linear adjoint equation along it.

    On each segment Gauss's method of order 2 `COSTATE_POINTS_PER_SEGMENT`: one linear system, whatever the
    equation's stiffness.
    """
    rule, n = gauss_rule(COSTATE_POINTS_PER_SEGMENT), final.size
    left, right = leg.breaks[:-1], leg.breaks[1:]
    times = (left[:, None] + 0.5 * (right - left)[:, None] * (1 + rule.points)).ravel()
    x, u, no_path = leg.x(times), leg.flown(times), np.zeros((len(leg.path_labels), times.size))

    def rates(change: Array) -> Array:
        costates = np.tile(change[:, None], times.size)
        return -functions.state_gradient(times, x, u, costates, no_path).reshape(
            n, -1, COSTATE_POINTS_PER_SEGMENT
        )

    forcing = rates(np.zeros(n))
    columns = np.stack([rates(unit) - forcing for unit in np.eye(n)], axis=1)  # (n, n, K, POINTS)
    nodes = np.concatenate([[-1.0], rule.points, [1.0]])
    to_end = rule.weights - rule.integration
    at_end = final
    for k in reversed(range(left.size)):
        half = 0.5 * (right[k] - left[k])
        system = np.einsum("ij,abj->aibj", half * to_end, columns[:, :, k]).reshape(
            n * COSTATE_POINTS_PER_SEGMENT, n * COSTATE_POINTS_PER_SEGMENT
        )
        known = at_end[:, None] - half * forcing[:, k] @ to_end.T
        inside = np.linalg.solve(np.eye(n * COSTATE_POINTS_PER_SEGMENT) + system, known.ravel()).reshape(
            n, COSTATE_POINTS_PER_SEGMENT
        )
        slopes = np.einsum("abj,bj->aj", columns[:, :, k], inside) + forcing[:, k]
        at_start = at_end - half * slopes @ rule.weights
        values = np.column_stack([at_start, inside, at_end])
        yield k, PiecewisePolynomial(np.array([left[k], right[k]]), (nodes,), (values,))
        at_end = at_start


def _shifted(
    leg: PhaseSolution,
    s: PhaseSamples,
    final: Array,
    weights: Array,
    before: EndGradients,
    after: EndGradients,
) -> PhaseSolution:
    """The phase with costates changed by the homogeneous solution that ends with a given change."""
    functions = replace(s.functions, weights=weights)
    lam = leg.lam
    values, starts, ends, points = [], [], [], []
    at_end = final
    for k, run in _backwards(leg, functions, final):
        nodes = leg.breaks[k] + 0.5 * (leg.breaks[k + 1] - leg.breaks[k]) * (1 + lam.nodes[k])
        values.append(lam.values[k] + run(nodes))
        points.append(
            run(leg.breaks[k] + 0.5 * (leg.breaks[k + 1] - leg.breaks[k]) * (1 + leg.rules[k].points))
        )
        starts.append(run(leg.breaks[k]))
        ends.append(at_end)
        at_end = starts[-1]
    at_start, change = at_end, np.hstack(points[::-1])
    times = leg.point_times
    x, u = leg.x(times), leg.flown(times)
    mu = np.zeros((len(leg.path_labels), times.size))
    impulses = leg.state_impulses.copy()
    name = leg.name
    impulses[:, 0] -= at_start + after.initial_state[name] - before.initial_state[name]
    impulses[:, -1] += final - (after.final_state[name] - before.final_state[name])
    edges, x_ends = (
        leg.breaks[[0, -1]],
        np.stack([leg.x(leg.breaks[0]), leg.x(leg.breaks[-1], "left")], axis=1),
    )
    u_ends = np.stack([leg.flown(leg.breaks[0]), leg.flown(leg.breaks[-1], "left")], axis=1)
    first, last = functions.hamiltonian(edges, x_ends, u_ends, np.stack([at_start, final], axis=1))
    by_time = np.array(
        [
            after.initial_time[name] - before.initial_time[name],
            after.final_time[name] - before.final_time[name],
        ]
    )
    at_times = np.array([first, -last]) - by_time
    return replace(
        leg,
        time_multipliers=leg.time_multipliers + np.where(leg.time_multipliers != 0, at_times, 0.0),
        lam=PiecewisePolynomial(lam.breaks, lam.nodes, tuple(values[::-1])),
        lam_start=leg.lam_start + np.stack(starts[::-1], axis=1),
        lam_end=leg.lam_end + np.stack(ends[::-1], axis=1),
        point_costates=leg.point_costates + change,
        control_multipliers=leg.control_multipliers - functions.control_gradient(times, x, u, change, mu),
        state_impulses=impulses,
        integral_weights=leg.integral_weights + weights,
    )
