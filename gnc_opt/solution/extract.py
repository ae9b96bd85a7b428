r"""From the solver's vectors to a solution: unscaling and covector mapping.

The Lagrangian of the program is, up to terms that do not depend on the dynamics,

.. math:: \mathcal L = \Phi + \dots + \sum_j m_j^T F_j, \qquad F_j = \Delta\, f(t_j, X_j, U_j),

with :math:`m = W^T \Lambda` the multipliers that the constraint rows lay on the point values. A quadrature of
:math:`\int \lambda^T f\,dt` with weights :math:`\omega_j` (fractions of the phase, sum 1) has the same form, hence in
every scheme

.. math:: \lambda(t_j) = m_j / \omega_j .

For LG this is :math:`-\Lambda_j / w_j`, Gauss weights w_j. At segment boundaries the costate is the derivative
of the segment's part of the Lagrangian with respect to the shared boundary state, + at its start, - at its end:
:math:`\lambda(t_0) = \partial J^* / \partial x_0` in the continuous problem is the same statement. Bound
multipliers z_j and path multipliers of a point become densities :math:`z_j / (\omega_j \Delta)`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gnc_opt.model.layout import Array
from gnc_opt.problem.functions import EndGradients, end_gradients, phase_functions
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.phase_solution import PhaseSolution, piecewise
from gnc_opt.solution.polynomial import PiecewisePolynomial
from gnc_opt.transcription.collocation import PhaseCollocation
from gnc_opt.transcription.mesh import Mesh
from gnc_opt.transcription.transcription import PhasePart, Transcription

_SHORTEST = 1e-9
"""Phases shorter than this (s) are drawn this long, so that a vanishing phase can still be evaluated."""


@dataclass(frozen=True)
class Iterate:
    """The solver's vectors in physical units; multipliers belong to the minimised functional.

    Attributes
    ----------
    x : array (n_variables,)
    lam_x : array (n_variables,)
        Multipliers of the variables' bounds.
    lam_g : array (n_constraints,)
        Multipliers of the rows.
    """

    x: Array
    lam_x: Array
    lam_g: Array


def model_parameters(problem: Problem, leg: Phase, q: Array) -> Array:
    """Return a phase's model parameters (n,), optimised ones replaced by their values in q."""
    p = leg.model.parameter_values
    for name in problem.parameters.names:
        if name in leg.model.parameters:
            p[leg.model.parameters.slice(name)] = q[problem.parameters.slice(name)]
    return p


def extract_phases(
    transcription: Transcription, problem: Problem, iterate: Iterate
) -> tuple[dict[str, PhaseSolution], EndGradients]:
    """Return the solution of every phase, and the end-point gradients at the solution."""
    q = iterate.x[transcription.parameter_places]
    nu = iterate.lam_g[transcription.constraint_rows]
    extended = np.concatenate([iterate.x, transcription.fixed_times(problem)])
    integrals = {name: _integrals(transcription, problem, name, extended, q) for name in transcription.parts}
    ends: dict[str, list[Any]] = {}
    for name, part in transcription.parts.items():
        states = iterate.x[part.collocation.boundary_states]
        times = extended[part.times[[0, -1]]]
        p = model_parameters(problem, problem.phases[name], q)
        ends[name] = [states[:, 0], states[:, -1], times[0], times[1], integrals[name], p]
    gradients = end_gradients(problem, ends, q, nu)
    phases = {
        name: _extract_phase(transcription, problem, part, iterate, integrals[name], gradients)
        for name, part in transcription.parts.items()
    }
    return phases, gradients


def _integrals(transcription: Transcription, problem: Problem, name: str, extended: Array, q: Array) -> Array:
    leg, part = problem.phases[name], transcription.parts[name]
    if not leg.integrands:
        return np.zeros(0)
    collocation = part.collocation
    times, spans = _point_times(collocation, extended[part.times])
    p = model_parameters(problem, leg, q)
    functions = phase_functions(problem, name, p, q, np.zeros(len(leg.integrands)))
    values = functions.integrands(
        times,
        extended[collocation.point_states],
        extended[collocation.point_controls],
    )
    return np.asarray(values @ (collocation.quadrature * spans))


def _point_times(collocation: PhaseCollocation, anchors: Array) -> tuple[Array, Array]:
    """Times of the collocation points and the durations of their arcs, (N,) each."""
    spans = np.diff(anchors)[collocation.point_arcs]
    return anchors[collocation.point_arcs] + collocation.arc_fractions * spans, spans


def _mesh_in_time(mesh: Mesh, anchors: Array) -> tuple[Mesh, Array]:
    """The mesh with its movable boundaries where they ended, and all boundary times (K + 1,)."""
    spans = np.maximum(np.diff(anchors), _SHORTEST)
    starts = anchors[0] + np.concatenate([[0.0], np.cumsum(spans)])
    breaks = np.append(starts[mesh.segment_arcs] + mesh.arc_starts * spans[mesh.segment_arcs], starts[-1])
    if not mesh.movable:
        return mesh, breaks
    fractions = (breaks - breaks[0]) / (breaks[-1] - breaks[0])
    return Mesh(tuple(fractions), mesh.degrees, mesh.movable), breaks


def _extract_phase(
    transcription: Transcription,
    problem: Problem,
    part: PhasePart,
    iterate: Iterate,
    integrals: Array,
    gradients: EndGradients,
) -> PhaseSolution:
    leg, collocation = problem.phases[part.name], part.collocation
    q = iterate.x[transcription.parameter_places]
    anchors = np.concatenate([iterate.x, transcription.fixed_times(problem)])[part.times]
    times, spans = _point_times(collocation, anchors)
    functions = phase_functions(
        problem, part.name, model_parameters(problem, leg, q), q, gradients.integrals[part.name]
    )
    x, u = iterate.x[collocation.point_states], iterate.x[collocation.point_controls]
    lam = _point_costates(collocation, iterate.lam_g)
    weights = collocation.quadrature * np.maximum(spans, _SHORTEST)
    paths = iterate.lam_g[collocation.path_rows] / weights
    rates = functions.rates(times, x, u)
    gradient = functions.state_gradient(times, x, u, lam, paths)
    start, end = _boundary_costates(collocation, iterate.lam_g, weights * gradient)
    mesh, breaks = _mesh_in_time(collocation.mesh, anchors)
    numbers = leg.numbers
    assert numbers.initial_time is not None and numbers.final_time is not None
    return PhaseSolution(
        name=part.name,
        scheme=collocation.scheme,
        mesh=mesh,
        initial_time=float(anchors[0]),
        final_time=float(anchors[-1]),
        states=leg.model.states,
        controls=leg.model.controls,
        model_parameters=leg.model.parameters,
        path_labels=leg.path_labels,
        integral_labels=tuple(leg.integrands),
        x=_state_polynomial(collocation, breaks, iterate.x, rates * spans),
        u=piecewise(breaks, collocation.rules, u),
        lam=_costate_polynomial(collocation, breaks, lam, end),
        lam_start=start,
        lam_end=end,
        path_multipliers=paths,
        state_multipliers=_point_bound_multipliers(collocation, iterate.lam_x) / weights,
        control_multipliers=iterate.lam_x[collocation.point_controls] / weights,
        state_impulses=iterate.lam_x[collocation.boundary_states],
        time_multipliers=_time_multipliers(part, iterate.lam_x),
        duration_multiplier=transcription.duration_multiplier(part.name, iterate.lam_g),
        integrals=integrals,
        integral_weights=gradients.integrals[part.name],
        parameters=functions.p,
        state_bounds=numbers.states,
        control_bounds=numbers.controls,
        path_bounds=leg.path_interval(),
        initial_bounds=numbers.initial,
        final_bounds=numbers.final,
        initial_time_bounds=numbers.initial_time,
        final_time_bounds=numbers.final_time,
        duration_bounds=numbers.duration,
    )


def _point_costates(collocation: PhaseCollocation, rows: Array) -> Array:
    """Costates at the collocation points (n_states, N): m_j / omega_j."""
    pieces = []
    for k, rule in enumerate(collocation.rules):
        # The factor w_k / 2 of both the multipliers and the quadrature weights cancels.
        pieces.append(-rows[collocation.dynamics_rows[k]] @ collocation.dynamics_matrix(k) / rule.weights)
    return np.hstack(pieces)


def point_multipliers(collocation: PhaseCollocation, costates: Array, end_costates: Array) -> list[Array]:
    """Invert the covector mapping: multipliers of each segment's rows for given costates.

    Parameters
    ----------
    costates : array (n_states, N)
        At the collocation points.
    end_costates : array (n_states, K)
        At the segment ends (used by LG only).
    """
    pieces = []
    for k, rule in enumerate(collocation.rules):
        here = costates[:, collocation.mesh.offsets[k] : collocation.mesh.offsets[k + 1]]
        wanted = -here * rule.weights
        if collocation.scheme == "LG":
            pieces.append(np.hstack([wanted, -end_costates[:, [k]]]))
        else:
            matrix = collocation.dynamics_matrix(k)
            pieces.append(np.linalg.lstsq(matrix.T, wanted.T, rcond=None)[0].T)
    return pieces


def _boundary_costates(collocation: PhaseCollocation, rows: Array, point_gradients: Array) -> tuple[Array, Array]:
    """Costates at each segment's start and end, (n_states, K) each.

    ``point_gradients`` (n_states, N) is the derivative of the point terms of the Lagrangian with respect to
    the states at the points; it counts where a collocation point is a segment boundary.
    """
    starts, ends = [], []
    for k in range(collocation.mesh.segments):
        derivative = rows[collocation.dynamics_rows[k]] @ collocation.state_matrix(k)
        first, last = collocation.mesh.offsets[k], collocation.mesh.offsets[k + 1] - 1
        start, end = derivative[:, 0], derivative[:, -1]
        if collocation.scheme in ("LGR", "LGL"):
            start = start + point_gradients[:, first]
        if collocation.scheme == "LGL":
            end = end + point_gradients[:, last]
        starts.append(start)
        ends.append(-end)
    return np.stack(starts, axis=1), np.stack(ends, axis=1)


def _point_bound_multipliers(collocation: PhaseCollocation, lam_x: Array) -> Array:
    """Multipliers of state bounds at points that are not segment boundaries, (n_states, N)."""
    multipliers = lam_x[collocation.point_states].copy()
    shared = np.isin(collocation.point_states, collocation.boundary_states)
    multipliers[shared] = 0.0
    return multipliers


def _time_multipliers(part: PhasePart, lam_x: Array) -> Array:
    return np.asarray([lam_x[place] if place < lam_x.size else 0.0 for place in part.times[[0, -1]]])


def _state_polynomial(
    collocation: PhaseCollocation, breaks: Array, variables: Array, scaled_rates: Array
) -> PiecewisePolynomial:
    """The scheme's state polynomial; ``scaled_rates`` (n_states, N) are dx/dt times the arc's duration."""
    nodes, values = [], []
    for k, rule in enumerate(collocation.rules):
        states = variables[collocation.segment_nodes(k)]
        if collocation.scheme == "LG":
            states = states[:, :-1]
        if collocation.scheme == "LGL":
            here = scaled_rates[:, collocation.mesh.offsets[k] : collocation.mesh.offsets[k + 1]]
            extra = ~np.isin(rule.state_nodes, rule.points)
            path = rule.integrate_to(rule.state_nodes[extra])
            middle = states[:, [0]] + 0.5 * collocation.mesh.arc_widths[k] * here @ path.T
            full = np.empty((states.shape[0], rule.n + 1))
            full[:, ~extra], full[:, extra] = states, middle
            states = full
        nodes.append(rule.state_nodes)
        values.append(states)
    return PiecewisePolynomial(breaks, tuple(nodes), tuple(values))


def _costate_polynomial(
    collocation: PhaseCollocation, breaks: Array, lam: Array, end: Array
) -> PiecewisePolynomial:
    """Costates through the points and, for LG, each segment's end."""
    if collocation.scheme != "LG":
        return piecewise(breaks, collocation.rules, lam)
    nodes, values = [], []
    for k, rule in enumerate(collocation.rules):
        here = lam[:, collocation.mesh.offsets[k] : collocation.mesh.offsets[k + 1]]
        nodes.append(np.append(rule.points, 1.0))
        values.append(np.hstack([here, end[:, [k]]]))
    return PiecewisePolynomial(breaks, tuple(nodes), tuple(values))


