r"""Reference magnitudes of the optimality check: control deviation, reach of the states, cost scale.

Every quantity that the check compares with its tolerance is a displacement, a gradient or a price, and is divided by
what variations of the controls that are as large as the applied ones bring about.

**Control deviation** :math:`q_k(t)`: how far the applied control is from its mean over the phase, at least a tenth of
the mean deviation; or the distance :math:`|H_u| / \mathrm{rms}(H_{uu})` to the minimum of H if that is larger (at most
ten deviations, and a finite range). A control that neither moves nor is pulled has its size, an idle one the deviation
that costs as much as those of the others. Declared ranges do not enter.

**Reach**: displacements by variations with :math:`\int \delta u_k^2 / q_k\,dt \le \int q_k\,dt` fill the ellipsoid of

.. math:: W(t) = \Phi W_0 \Phi^T
          + \sum_k \int q_k\,ds \int_0^t \Phi(t, s)\, b_k\, q_k\, b_k^T\, \Phi(t, s)^T ds,

the weighted controllability Gramian (W. S. Levine, ed., The Control Handbook, 2011, ch. 5). :math:`W_0` is zero for
given starts, the end of another phase for linked ones, and the size of the state for free ones; free parameters
add their own columns. Displacements d count as :math:`|C^{-1/2}(d/r)|`, gradients g as :math:`|C^{1/2}(r g)|` with
:math:`r_i = \sqrt{W_{ii}}` and the correlation matrix C of W.

**Cost scale**: :math:`\int \sum_k |H_{u_k}| q_k + \tfrac12 \sum_{kl} |H_{u_k u_l}| q_k q_l\,dt` over all phases, the
second difference of the end cost over the reach, and the duration times cost rates if it is free.

Invariances (tests in `test_reference_scales.py`): measures do not depend on units and origins of states, controls, time
and cost; on frames that move; on regular mixtures of the states; on declared ranges; on states without effect; on the
order of statements. Neither do they on constants or total derivatives in the cost.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.arrays import Array
from gnc_opt.model.evaluation import evaluate_columns
from gnc_opt.planning.problem.functions import end_gradients, end_values, phase_functions
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.extract import model_parameters
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.solution.scales import steering
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.tolerances import RANK, TINY, magnitude

STEADY_SHARE = 1e-7
"""A control that moves, or is pulled, by less than this share of its size is constant; least reach in sizes."""

PEAK_SHARE = 1e-2
"""Least rms deviation of a control, in shares of its largest one."""

MEAN_SHARE = 0.1
"""Least deviation of a control at any time, in shares of its mean over the phase."""

MOST_PULL = 10.0
"""Most deviation by the pull of H, in deviations of a control that moves."""

REST_SHARE = 1e-7
"""A control below this share of what the motion asks for, or below its square of its span, is rounding."""

BESIDE = 1.3
"""Multiple of a control at which its effect is compared with that at its value."""

STILL_SHARE = 1e-4
"""A state that moves by less than this share of its reach is still."""

LEAST_CORRELATION = 1e-6
"""Least eigenvalue of the correlation matrix of the reach."""

CELLS = 40
"""Cells of a phase, at least, in which its linearised dynamics are constant."""

VANISHED_SHARE = 1e-6
"""First- and second-order changes of the cost below this share of their terms are rounding."""

RESOLVED_COST_SHARE = 1e-9
"""Least cost of control deviations, in shares of the second-order change of the cost over the reach of the states:
below, controls and costates are rounding."""

SINGULAR_SHARE = 1e-3
"""Where H is affine in all controls, first-order changes of the cost below this share of its second-order change over
the reach of the states are those of singular arcs."""

ROUGH_SAMPLES = 5
"""One of so many samples is used for a magnitude that need not be exact."""

LEAST_COST_SHARE = 1e-9
"""Least cost scale, in shares of the objective."""

STEP_SHARE = 1e-4
"""Step of second differences by parameters, in shares of their size."""

_LARGEST_GROWTH = 60.0
"""Logarithm of the largest growth of errors that is told."""

_EXPONENT = 25.0
"""Largest entry of an exponent, against overflow along dynamics that are much faster than a cell."""


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """Displacements of the states that control variations bring about.

    Attributes
    ----------
    radius : array (n,)
        Largest displacement of each state.
    axes : array (n, n)
        Eigenvectors of the correlation matrix, in columns.
    shares : array (n,)
        Square roots of its eigenvalues.
    """

    radius: Array
    axes: Array
    shares: Array

    @classmethod
    def of(cls, gramian: Array, radius: Array) -> Ellipsoid:
        """Take the correlation from a Gramian (n, n), and the sizes as given (n,)."""
        sizes = np.sqrt(np.maximum(np.diag(gramian), 0.0))
        reached = sizes > 0
        scale = np.where(reached, sizes, 1.0)
        correlation = gramian / scale / scale[:, None]
        correlation[~reached], correlation[:, ~reached] = 0.0, 0.0
        correlation[np.diag_indices_from(correlation)] = 1.0
        values, axes = np.linalg.eigh(0.5 * (correlation + correlation.T))
        return cls(radius, axes, np.sqrt(np.clip(values, LEAST_CORRELATION, None)))

    def displacement(self, moved: Array) -> Array:
        """Return displacements (n, ...) in shares of the ellipsoid (...)."""
        parts = np.tensordot(self.axes.T, _shares(moved, self.radius), 1)
        return np.asarray(np.linalg.norm(parts / _column(self.shares, parts), axis=0))

    def change(self, gradient: Array) -> Array:
        """Return the largest change of a quantity with gradients (n, ...) over the ellipsoid (...)."""
        scaled = np.asarray(gradient) * _column(self.radius, gradient)
        parts = np.tensordot(self.axes.T, scaled, 1)
        return np.asarray(np.linalg.norm(parts * _column(self.shares, parts), axis=0))

    @property
    def principal(self) -> Array:
        """Principal semi-axes (n, n), in columns."""
        return np.asarray(self.radius[:, None] * self.axes * self.shares)

    @property
    def directions(self) -> Array:
        """The same with 1 for states that nothing moves: derivatives exist there too."""
        radius = np.where(self.radius > 0, self.radius, 1.0)
        return np.asarray(radius[:, None] * self.axes * self.shares)


Reach = tuple[Ellipsoid, Ellipsoid, Ellipsoid, Ellipsoid]
"""At the start, along a phase, at its end; at its end with the integrals."""


@dataclass(frozen=True, eq=False)
class PhaseScales:
    """Reference magnitudes of a phase.

    Attributes
    ----------
    deviation : array (m, n_samples)
        Of the controls.
    start, along, end : Ellipsoid
        Reach of the states at the start, in the mean along the phase, and at the end.
    control_cost : array (m,)
        What deviations of each control cost, without those of the others.
    """

    deviation: Array
    start: Ellipsoid
    along: Ellipsoid
    end: Ellipsoid
    control_cost: Array


@dataclass(frozen=True, eq=False)
class Scales:
    """Reference magnitudes of a solution.

    Attributes
    ----------
    phases : mapping from phase to PhaseScales
    cost : float
        Positive.
    change_of_cost : float
        What control deviations change the cost by, those included that cancel to first order.
    parameters : array (n_free_parameters,)
        Deviations of the free parameters.
    ends : EndPoints
    reach : mapping from phase to Reach
    links : mapping from phase to mapping from phase to array
        Derivatives of the start of a phase by ends of earlier ones; under "" the projection on what is free there.
    constraints : tuple of array (n_constraints,)
        First and second differences of the boundary constraints over the reach of the ends, and their terms.
    """

    phases: Mapping[str, PhaseScales]
    cost: float
    change_of_cost: float
    parameters: Array
    ends: EndPoints
    reach: Mapping[str, Reach]
    links: Mapping[str, Mapping[str, Array]]
    constraints: tuple[Array, Array, Array]

    @classmethod
    def of(cls, solution: Solution, samples: list[PhaseSamples]) -> Scales:
        """Measure a solution whose numbers are those of its problem."""
        problem = solution.need_problem("verify")
        lasting = [s for s in samples if s.has_length]
        ends, order = EndPoints.of(solution, samples), sorted(samples, key=lambda s: s.leg.initial_time)
        links = _links(problem, solution, order)
        deviations = {s.leg.name: control_deviation(s) for s in samples}
        gramians = _gramians(links, order, deviations, {})
        reach = {s.leg.name: _reach(s, gramians[s.leg.name]) for s in samples}
        changed = sum(_cost_of_states(s, reach[s.leg.name][1]) for s in lasting)
        changed += sum(float(np.sum(_control_costs(s, deviations[s.leg.name]))) for s in samples)
        changed += ends.curvature(reach)
        least = RESOLVED_COST_SHARE * changed
        costs, resolved = {}, {}
        for s in samples:
            resolved[s.leg.name] = _resolved(s, deviations[s.leg.name], least)
            costs[s.leg.name] = _control_costs(s, resolved[s.leg.name])
        flat = sum(float(np.sum(c)) for c in costs.values())
        for s in lasting:
            resolved[s.leg.name] = _with_idle(s, resolved[s.leg.name], flat)
        if any(np.any(resolved[name] != deviations[name]) for name in resolved):
            deviations = resolved
            gramians = _gramians(links, order, deviations, {})
            reach = {s.leg.name: _reach(s, gramians[s.leg.name]) for s in samples}
        cost = sum(_cost_of_controls(s, deviations[s.leg.name]) for s in samples)
        cost += sum(map(_cost_of_time, samples, [ends.time_cost(s) for s in samples]))
        controlled = any(s.leg.controls.size for s in lasting)
        cost += ends.curvature(reach, constrained=not controlled)
        if cost < SINGULAR_SHARE * changed and not any(np.any(s.control_hessian) for s in lasting):
            # Along singular arcs controls change the cost by way of the states only.
            cost = changed + sum(_cost_of_each_state(s, reach[s.leg.name][1]) for s in lasting)
            costs = {name: np.full_like(own, cost) for name, own in costs.items()}
        cost = max(cost, LEAST_COST_SHARE * abs(solution.objective), least)
        parameters = _parameter_deviations(problem, solution, samples, cost)
        if parameters.size:
            columns = {s.leg.name: _parameter_columns(s) * parameters for s in lasting}
            gramians = _gramians(links, order, deviations, columns)
            reach = {s.leg.name: _reach(s, gramians[s.leg.name]) for s in samples}
        cost = max(cost, TINY)
        phases = {name: PhaseScales(deviations[name], *reach[name][:3], costs[name]) for name in deviations}
        return cls(phases, cost, changed, parameters, ends, reach, links, ends.constraints(reach, parameters))


# --- controls ---------------------------------------------------------------------------------------------


def control_deviation(s: PhaseSamples) -> Array:
    """Return how far the applied control deviates, or is pulled, from its mean (m, n_samples); zero if idle."""
    lasts, u = max(float(np.sum(s.weights)), TINY), s.u
    about = _finite(np.abs(u - (u @ s.weights / lasts)[:, None]))
    size = np.max(np.abs(_finite(u)), axis=1, initial=0.0)
    mean = about @ s.weights / lasts
    moved = np.fmax(np.sqrt(about**2 @ s.weights / lasts), PEAK_SHARE * np.max(about, axis=1, initial=0.0))
    bends = np.sqrt(_finite(np.einsum("iij->ij", s.control_hessian)) ** 2 @ s.weights / lasts)
    bounds = s.leg.control_bounds
    extent = np.where(np.isfinite(bounds.upper - bounds.lower), bounds.upper - bounds.lower, np.inf)
    slope = np.abs(_finite(s.switching))
    pull = np.where(slope > 0, np.inf, 0.0)
    pull = np.minimum(np.divide(slope, bends[:, None], out=pull, where=bends[:, None] > 0), extent[:, None])
    moves = moved > STEADY_SHARE * size
    pull = np.where(moves[:, None], np.minimum(pull, MOST_PULL * moved[:, None]), pull)
    pull = np.where(np.isfinite(pull), pull, size[:, None])
    deviation = np.fmax(np.fmax(about, MEAN_SHARE * mean[:, None]), pull)
    pulled = np.sqrt(pull**2 @ s.weights / lasts) > STEADY_SHARE * size
    steady = ~moves & ~pulled
    deviation = np.where(steady[:, None], _steady(s, size, bends)[:, None], deviation)
    return np.fmax(deviation, _at_rest(s, np.fmax(size, np.max(deviation, axis=1, initial=0.0)))[:, None])


def _steady(s: PhaseSamples, size: Array, bends: Array) -> Array:
    """Return the deviation of controls that are constant (m,): their size, unless that is nothing beside the cost."""
    lasts = max(float(np.sum(s.weights)), TINY)
    cost = np.abs(s.functions.weights @ s.functions.integrands(s.times, s.x, s.u)) @ s.weights / lasts
    worth = np.sqrt(np.divide(2 * cost, bends, out=np.zeros_like(bends), where=bends > 0))
    idle = size <= LEAST_COST_SHARE * worth
    still = np.max(np.abs(s.x - s.x[:, :1]), initial=0.0) <= LEAST_COST_SHARE * np.max(
        np.abs(s.x), initial=1.0
    )
    return np.where(idle, worth if still else 0.0, size)


def _at_rest(s: PhaseSamples, size: Array) -> Array:
    """Return the deviation of controls that all are rounding, neither moved nor pulled, at rest (m,); else zero.

    It is what the motion asks of them; where nothing moves either, their span in the program is all that is left.
    """
    asked, rounding = steering(s.leg, s.functions), REST_SHARE**2 * s.control_span
    if not np.all(size <= np.fmax(REST_SHARE * asked, rounding)):
        return np.zeros_like(size)
    # Where the effect of a control vanishes at its value only, as that of an angle of 180 degrees, it is not rounding.
    own, beside = (
        np.max(
            np.abs(_finite(s.functions.input_jacobian(s.times, s.x, factor * s.u))), axis=(0, 2), initial=0.0
        )
        for factor in (1.0, BESIDE)
    )
    share = np.divide(own, beside, out=np.ones_like(own), where=beside > own)
    if not np.all(size <= share * np.fmax(REST_SHARE * asked, rounding)):
        return np.zeros_like(size)
    return np.asarray(np.where(asked > rounding, asked, s.control_span))


def _resolved(s: PhaseSamples, deviation: Array, cost: float) -> Array:
    """Return deviations of controls in which H curves that are no smaller than those that a least cost allows."""
    bends = np.abs(_finite(np.einsum("iij->ij", s.control_hessian))) @ s.weights
    least = np.sqrt(np.divide(2 * cost, bends, out=np.zeros_like(bends), where=bends > 0))
    return np.fmax(deviation, least[:, None])


def _with_idle(s: PhaseSamples, deviation: Array, cost: float) -> Array:
    """Return deviations with idle controls at what costs as much as those of all others."""
    idle = np.max(deviation, axis=1, initial=0.0) <= 0
    if not np.any(idle):
        return deviation
    lasts = max(float(np.sum(s.weights)), TINY)
    bends = np.abs(_finite(np.einsum("iij->ij", s.control_hessian))) @ s.weights
    equal = np.sqrt(np.divide(2 * cost, bends, out=np.zeros_like(bends), where=bends > 0))
    extent = s.leg.control_bounds.upper - s.leg.control_bounds.lower
    other = np.where(np.isfinite(extent) & (bends == 0) & (lasts > TINY), extent, equal)
    return np.where(idle[:, None], other[:, None], deviation)


def _control_costs(s: PhaseSamples, deviation: Array) -> Array:
    """Return what deviations of each control alone cost (m,), to first and to second order."""
    first = np.abs(_finite(s.switching)) * deviation
    second = 0.5 * np.abs(_finite(np.einsum("iij->ij", s.control_hessian))) * deviation**2
    return np.asarray((first + second) @ s.weights)


def _cost_of_controls(s: PhaseSamples, deviation: Array) -> float:
    """Return what deviations of all controls cost; where H neither slopes nor curves, what their terms amount to."""
    bends = np.abs(_finite(s.control_hessian))
    first = np.sum(np.abs(_finite(s.switching)) * deviation, axis=0) @ s.weights
    second = 0.5 * np.einsum("ijt,it,jt,t->", bends, deviation, deviation, s.weights)
    slopes = np.abs(_finite(s.cost_slope)), np.abs(_finite(s.switching - s.cost_slope))
    terms = max(float(np.sum(v * deviation, axis=0) @ s.weights) for v in slopes)
    told = float(first + second)
    return told if told > VANISHED_SHARE * terms else terms


def _cost_of_states(s: PhaseSamples, ellipsoid: Ellipsoid) -> float:
    """Return the largest half second difference of the integral of H over the reach of the states, roughly."""
    changes = second_differences(s, ellipsoid.principal, STEP_SHARE, ROUGH_SAMPLES)[1] / STEP_SHARE
    return float(np.max(np.abs(_finite(changes)), initial=0.0))


def _cost_of_each_state(s: PhaseSamples, ellipsoid: Ellipsoid) -> float:
    """Return the sum of the half second differences of the integral of H over the reach of each state alone."""
    moves = np.diag(ellipsoid.radius)
    changes = second_differences(s, moves, STEP_SHARE, ROUGH_SAMPLES)[1] / STEP_SHARE
    return float(np.sum(np.abs(_finite(changes))))


def second_differences(s: PhaseSamples, moves: Array, step: float, every: int = 1) -> Array:
    """Return the central first and half the second difference per step of the integral of H along moves (2, n).

    Of every sample, or of some of them only.
    """
    x, u, lam, times = s.x[:, ::every], s.u[:, ::every], s.lam[:, ::every], s.times[::every]
    count, weights = 2 * moves.shape[1], every * s.weights[::every]
    moved = step * np.hstack([moves, -moves])
    places = (x[:, None, :] + moved[:, :, None]).reshape(x.shape[0], -1)
    values = s.functions.hamiltonian(np.tile(times, count), places, np.tile(u, count), np.tile(lam, count))
    change = (values.reshape(count, -1) - s.hamiltonian[::every]) @ weights
    ahead, behind = change[: count // 2], change[count // 2 :]
    return np.asarray(0.5 * np.stack([ahead - behind, ahead + behind]) / step)


def _cost_of_time(s: PhaseSamples, slope: float) -> float:
    """Return the duration times cost rates where it is free, else zero."""
    if s.lasts_as_told:
        return 0.0
    rate = np.abs(s.functions.weights @ s.functions.integrands(s.times, s.x, s.u)) @ s.weights
    return float(rate) + s.span * slope


# --- states -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Gramian:
    """W at the start, its mean and W at the end of a phase (n, n); at its end with the integrals; growth of errors."""

    start: Array
    mean: Array
    end: Array
    whole: Array
    growth: float = 1.0


def _gramians(
    links: Mapping[str, Mapping[str, Array]],
    samples: list[PhaseSamples],
    deviations: Mapping[str, Array],
    columns: Mapping[str, Array],
) -> dict[str, _Gramian]:
    """Return the Gramian of every phase, in the order of their initial times."""
    found: dict[str, _Gramian] = {}
    for s in samples:
        others = {name: row for name, row in links[s.leg.name].items() if name}
        start = _start_covariance(s, others, links[s.leg.name][""], found)
        found[s.leg.name] = _gramian(s, deviations[s.leg.name], start, columns.get(s.leg.name))
    return found


def _gramian(s: PhaseSamples, deviation: Array, start: Array, columns: Array | None) -> _Gramian:
    leg = s.leg
    if not s.has_length:
        return _Gramian(start, start, start, np.pad(start, (0, leg.integrals.size)))
    n, n_integrals = start.shape[0], leg.integrals.size
    edges, parts = cells_of(leg.breaks), -(-CELLS // leg.mesh.segments)
    middles, widths = 0.5 * (edges[:-1] + edges[1:]), np.diff(edges)
    x, u = leg.x(middles), leg.flown(middles)
    with np.errstate(all="ignore"):
        by_state = np.moveaxis(s.functions.state_jacobian(middles, x, u), 2, 0)
        by_control = np.moveaxis(s.functions.input_jacobian(middles, x, u), 2, 0)
        integrands = [_integrand_gradients(s, middles, x, u, i) for i in range(n_integrals)]
    by_state, by_control = _finite(by_state), _finite(by_control)
    if n_integrals:  # integrals are states that nothing depends on
        slopes = [np.stack([row[k] for row in integrands], axis=1) for k in (0, 1)]
        by_state = np.concatenate([by_state, _finite(slopes[0])], axis=1)
        by_state = np.concatenate([by_state, np.zeros((*by_state.shape[:2], n_integrals))], axis=2)
        by_control = np.concatenate([by_control, _finite(slopes[1])], axis=1)
        start = np.pad(start, ((0, n_integrals), (0, n_integrals)))
    half = exponentials(0.5 * widths[:, None, None] * by_state)
    weighted = deviation * s.weights
    starts = np.searchsorted(s.segments, np.arange(leg.mesh.segments))
    per_cell = np.repeat(np.add.reduceat(weighted, starts, axis=1) / parts, parts, axis=1)
    strength = np.sum(weighted, axis=1)[:, None] * per_cell
    moved = np.zeros((start.shape[0], 0 if columns is None else columns.shape[2]))
    total, mean, lasts = start.copy(), np.zeros_like(start), float(edges[-1] - edges[0])
    whole = total
    for k, width in enumerate(widths):
        push = half[k] @ by_control[k]
        step = half[k] @ half[k]
        following = step @ total @ step.T + (push * strength[:, k]) @ push.T
        if columns is not None:
            moved = step @ moved + width * half[k] @ columns[k]
        if not np.all(np.isfinite(following)):
            break
        total, before = following, whole
        whole = total + moved @ moved.T
        mean += 0.5 * width / lasts * (before + whole)
    fastest = np.max(np.linalg.eigvals(by_state).real, axis=1, initial=0.0)
    growth = float(np.exp(min(float(np.sum(fastest * widths)), _LARGEST_GROWTH)))
    return _Gramian(start[:n, :n], mean[:n, :n], whole[:n, :n], whole, growth)


def exponentials(matrices: Array) -> Array:
    """Return matrix exponentials (n_matrices, n, n); those of large norm, of matrices that are reduced to it."""
    sizes = np.max(np.abs(np.linalg.eigvals(matrices)), axis=1, initial=0.0)
    reduced = np.minimum(1.0, np.divide(_EXPONENT, sizes, out=np.ones_like(sizes), where=sizes > 0))
    return np.asarray(scipy.linalg.expm(matrices * reduced[:, None, None]))


def cells_of(breaks: Array) -> Array:
    """Return the edges of the cells of a phase with given mesh boundaries: segments in equal parts."""
    parts = -(-CELLS // (breaks.size - 1))
    shares = np.arange(parts) / parts
    return np.append((breaks[:-1, None] + shares * np.diff(breaks)[:, None]).ravel(), breaks[-1])


def _integrand_gradients(s: PhaseSamples, times: Array, x: Array, u: Array, i: int) -> tuple[Array, Array]:
    """Return derivatives of an integrand by states and controls (n_times, n) and (n_times, m)."""
    alone = replace(s.functions, weights=np.eye(s.functions.weights.size)[i])
    none = np.zeros_like(x), np.zeros((len(s.leg.path_labels), times.size))
    return alone.state_gradient(times, x, u, *none).T, alone.switching(times, x, u, none[0]).T


def _reach(s: PhaseSamples, gramian: _Gramian) -> Reach:
    """Return the reach at the start, along the phase and at the end, there also with the integrals."""
    size = np.max(np.abs(_finite(s.x)), axis=1, initial=0.0)
    moved = np.max(np.abs(_finite(s.x - s.x[:, :1])), axis=1, initial=0.0)
    along, end, start = (
        np.sqrt(np.maximum(np.diag(w), 0.0)) for w in (gramian.mean, gramian.end, gramian.start)
    )
    if not s.has_length:  # nothing moves: sizes have to do
        along = end = magnitude(size)
    moving = (moved > STILL_SHARE / gramian.growth * along) & (moved > STEADY_SHARE * size)
    radius = np.where(moving, np.minimum(along, moved), along)
    final = np.where(moving, np.minimum(end, moved), end)
    if not s.lasts_as_told:  # what controls do not reach is reached by the time at which the flow arrives
        radius, final = (np.where(r > STILL_SHARE * moved, r, np.fmax(r, moved)) for r in (radius, final))
    least = STEADY_SHARE * size
    radius, final = np.fmax(radius, least), np.fmax(final, least)
    initial = np.where(start > 0, start, radius)
    return (
        Ellipsoid.of(gramian.start, initial),
        Ellipsoid.of(gramian.mean, radius),
        Ellipsoid.of(gramian.end, final),
        Ellipsoid.of(gramian.whole, np.append(final, np.sqrt(np.diag(gramian.whole)[final.size :]))),
    )


def _start_covariance(
    s: PhaseSamples, links: Mapping[str, Array], left: Array, found: Mapping[str, _Gramian]
) -> Array:
    """Return W at the start of a phase: zero where given, by links to other phases, else by the size of the state."""
    size = np.max(np.abs(_finite(s.x)), axis=1, initial=0.0)
    moved = np.max(np.abs(_finite(s.x - s.x[:, :1])), axis=1, initial=0.0)
    size = np.where(moved > STEADY_SHARE * size, moved, size)
    size = np.where(size > 0, size, _width(s.leg.state_bounds))
    own = left * np.where(size > 0, size, 1.0)
    covariance = own @ own.T
    for name, response in links.items():
        covariance = covariance + response @ found[name].end @ response.T
    return covariance


def _links(problem: Problem, solution: Solution, samples: list[PhaseSamples]) -> dict[str, dict[str, Array]]:
    """Return how the start of each phase follows the ends of earlier ones (n, n_other), by linear constraints."""
    jacobians, found = _link_jacobians(problem, solution), {}
    for k, s in enumerate(samples):
        leg = s.leg
        free = np.flatnonzero(~leg.initial_bounds.fixed)
        size = np.max(np.abs(_finite(s.x)), axis=1, initial=0.0)
        unit = np.where(size > 0, size, 1.0)[free]
        own = jacobians[leg.name][0][:, free] * unit
        linked = np.any(own != 0, axis=1)
        earlier = [other.leg.name for other in samples[:k]]
        for name, (at_start, at_end) in jacobians.items():
            linked &= ~np.any(at_start != 0, axis=1) if name != leg.name else True
            linked &= ~np.any(at_end != 0, axis=1) if name not in earlier else True
        others = [name for name in earlier if np.any(jacobians[name][1][linked])]
        linked &= (
            np.any([np.any(jacobians[name][1] != 0, axis=1) for name in others], axis=0) if others else False
        )
        inverse = np.linalg.pinv(own[linked], rcond=RANK)
        left = np.zeros((leg.states.size, leg.states.size))
        left[np.ix_(free, free)] = unit[:, None] * (np.eye(free.size) - inverse @ own[linked]) / unit
        found[leg.name] = {"": left}
        for name in others:
            response = np.zeros((leg.states.size, solution.phases[name].states.size))
            response[free] = -unit[:, None] * (inverse @ jacobians[name][1][linked])
            found[leg.name][name] = response
    return found


def _link_jacobians(problem: Problem, solution: Solution) -> dict[str, tuple[Array, Array]]:
    """Return derivatives of the boundary constraints by initial and final states (n_constraints, n), by phase."""
    function = problem.once("end jacobians", lambda: _end_jacobians(problem))
    arguments: list[Any] = []
    for leg in solution.phases.values():
        arguments += _end_arguments(leg)
    found = function(*arguments, solution.parameter_values)
    found = [v.full() for v in (found if isinstance(found, (tuple, list)) else [found])]
    return {name: (found[2 * k], found[2 * k + 1]) for k, name in enumerate(solution.phases)}


def _end_jacobians(problem: Problem) -> Any:
    ends = end_values(problem)
    arguments = [ca.SX.sym("v", ends.size1_in(i)) for i in range(ends.n_in())]
    column = ends(*arguments)[:-1]
    states = [arguments[6 * k + i] for k in range(len(problem.phases)) for i in (0, 1)]
    return ca.Function("end_jacobians", arguments[:-1], [ca.densify(ca.jacobian(column, v)) for v in states])


# --- parameters -------------------------------------------------------------------------------------------


def _parameter_deviations(
    problem: Problem, solution: Solution, samples: list[PhaseSamples], cost: float
) -> Array:
    """Return the deviations of the free parameters (n,): what costs as much as the controls, else their size."""
    values, box = solution.parameter_values, problem.parameter_interval()
    if not values.size:
        return np.zeros(0)
    extent = _width(box)
    size = np.where(np.abs(values) > 0, np.abs(values), np.where(extent > 0, extent, 1.0))
    bends = np.zeros(values.size)
    for i in range(values.size):
        step = np.zeros(values.size)
        step[i] = STEP_SHARE * size[i]
        slopes = [_parameter_slope(problem, solution, samples, values + sign * step)[i] for sign in (1, -1)]
        bends[i] = (slopes[0] - slopes[1]) / (2 * step[i])
    bends = np.where(np.isfinite(bends), bends, 0.0)
    equal = np.sqrt(np.divide(2 * cost, bends, out=np.full(values.size, np.inf), where=bends > 0))
    return np.asarray(np.where(np.isfinite(equal), equal, size))


def _parameter_slope(problem: Problem, solution: Solution, samples: list[PhaseSamples], q: Array) -> Array:
    """Return the derivative of the Lagrangian by the parameters at other values of them (n,)."""
    ends = {}
    slope = np.zeros(q.size)
    for s in samples:
        p = model_parameters(problem, problem.phases[s.leg.name], q)
        ends[s.leg.name] = [*_end_arguments(s.leg)[:5], p]
        functions = phase_functions(problem, s.leg.name, p, q, s.functions.weights)
        slope += functions.parameter_gradient(s.times, s.x, s.u, s.lam, s.mu) @ s.weights
    return slope + end_gradients(problem, ends, q, solution.constraint_multipliers).parameters


def _parameter_columns(s: PhaseSamples) -> Array:
    """Return derivatives of the rates by the free parameters at the middles of cells (n_cells, n_states, n)."""
    leg = s.leg
    edges = cells_of(leg.breaks)
    middles = 0.5 * (edges[:-1] + edges[1:])
    x, u = leg.x(middles), leg.flown(middles)
    mu = np.zeros((len(leg.path_labels), middles.size))
    idle = s.functions.parameter_gradient(middles, x, u, np.zeros_like(x), mu)
    rows = []
    for i in range(x.shape[0]):
        costates = np.zeros_like(x)
        costates[i] = 1.0
        rows.append(s.functions.parameter_gradient(middles, x, u, costates, mu) - idle)
    for i in range(leg.integrals.size):
        alone = replace(s.functions, weights=np.eye(leg.integrals.size)[i])
        rows.append(alone.parameter_gradient(middles, x, u, np.zeros_like(x), mu))
    return np.moveaxis(_finite(np.stack(rows)), 2, 0)


# --- ends -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class EndPoints:
    """Cost and boundary constraints as functions of all ends.

    Attributes
    ----------
    solution : Solution
    samples : list of PhaseSamples
    values : list of array
        States, times, integrals and parameters of every phase, then the free parameters.
    gradients : EndGradients
        Without multipliers.
    """

    solution: Solution
    samples: list[PhaseSamples]
    values: list[Array]
    gradients: Any

    @classmethod
    def of(cls, solution: Solution, samples: list[PhaseSamples]) -> EndPoints:
        problem = solution.need_problem("verify")
        ends = {name: _end_arguments(leg) for name, leg in solution.phases.items()}
        values = [np.atleast_1d(v) for arguments in ends.values() for v in arguments]
        nothing = np.zeros(solution.constraint_multipliers.size)
        gradients = end_gradients(problem, ends, solution.parameter_values, nothing)
        return cls(solution, samples, [*values, solution.parameter_values], gradients)

    def time_cost(self, s: PhaseSamples) -> float:
        """Return the cost per second of moving the ends of a phase in time."""
        name = s.leg.name
        return float(abs(self.gradients.initial_time[name]) + abs(self.gradients.final_time[name]))

    def curvature(self, reach: Mapping[str, Reach], *, constrained: bool = False) -> float:
        """Return the largest half second difference of the end cost over the reach of the ends.

        With the boundary constraints and their multipliers if asked for.
        """
        found = self._differences(self._moves(reach))
        if found is None:
            return 0.0
        change = found[1][-1]
        if constrained:
            sense = self.solution.need_problem("verify").sense
            change = np.append(self.solution.constraint_multipliers, sense) @ found[1]
        return 0.5 * float(np.max(np.abs(change), initial=0.0))

    def constraints(self, reach: Mapping[str, Reach], parameters: Array) -> tuple[Array, Array, Array]:
        """Return how far the reach moves each boundary constraint, to first and second order, and its terms."""
        n = self.solution.constraint_multipliers.size
        if not n:
            return np.zeros(0), np.zeros(0), np.zeros(0)
        moves = self._moves(reach)
        for i, size in enumerate(parameters):
            moves.append(self._move({len(self.values) - 1: size * np.eye(parameters.size)[i]}))
        for k, s in enumerate(self.samples):
            if not s.lasts_as_told:
                moves += self._shifted(k, s)
        found = self._differences(moves)
        jacobians = _link_jacobians(self.solution.need_problem("verify"), self.solution)
        terms = np.zeros(n)
        for k, name in enumerate(self.solution.phases):
            for by_state, place in zip(jacobians[name], (6 * k, 6 * k + 1), strict=True):
                terms += np.abs(by_state) @ np.abs(self.values[place])
        terms += np.abs(self.gradients.constraints)
        if found is None:
            return np.zeros(n), np.zeros(n), terms
        first, second = (np.sqrt(np.sum(v[:-1] ** 2, axis=1)) for v in found)
        return first, second, terms

    def _moves(self, reach: Mapping[str, Reach], *, still: bool = False) -> list[list[Array]]:
        """Return moves of the ends along their principal axes, of length 1 for what nothing moves if asked for."""
        moves = []
        for k, s in enumerate(self.samples):
            start, _, _, end = reach[s.leg.name]
            free, n = ~s.leg.initial_bounds.fixed, s.leg.states.size
            for column in ((start.directions if still else start.principal)[:, free] * free[:, None]).T:
                moves.append(self._move({6 * k: column}))
            for column in (end.directions if still else end.principal).T:
                moves.append(self._move({6 * k + 1: column[:n], 6 * k + 4: column[n:]}))
        return moves

    def _move(self, changes: Mapping[int, Array]) -> list[Array]:
        return [changes.get(k, np.zeros_like(v)) for k, v in enumerate(self.values)]

    def _shifted(self, k: int, s: PhaseSamples) -> list[list[Array]]:
        """Return moves of the ends of a phase along its flow, together with their times, by its duration."""
        moves = []
        bounds = (s.leg.initial_time_bounds, s.leg.final_time_bounds)
        for at, place, box in ((0, 6 * k, bounds[0]), (-1, 6 * k + 1, bounds[1])):
            if not box.fixed[0]:
                rate = s.functions.rates(s.times[[at]], s.x[:, [at]], s.u[:, [at]])[:, 0]
                step = STEP_SHARE * s.span
                moves.append(self._move({place: _finite(rate) * step, place + 2: np.array([step])}))
        return moves

    def kink(self, reach: Mapping[str, Reach], parameters: Array, step: float) -> Array:
        """Return slopes and half second differences of the Lagrangian per step over the reach, by directions (2, n)."""
        moves = self._moves(reach, still=True)
        moves += [
            self._move({len(self.values) - 1: size * np.eye(parameters.size)[i]})
            for i, size in enumerate(parameters)
        ]
        for k, s in enumerate(self.samples):
            for place, box in ((6 * k + 2, s.leg.initial_time_bounds), (6 * k + 3, s.leg.final_time_bounds)):
                if not box.fixed[0]:
                    moves.append(self._move({place: np.array([s.span])}))
        found = self._differences([[step * v for v in move] for move in moves])
        if found is None:
            return np.zeros((2, 0))
        sense = self.solution.need_problem("verify").sense
        weights = np.append(self.solution.constraint_multipliers, sense)
        return np.stack([weights @ found[0], 0.5 * (weights @ found[1])]) / step

    def _differences(self, moves: list[list[Array]]) -> tuple[Array, Array] | None:
        """Return central first and second differences (n_constraints + 1, n_moves) of constraints and cost."""
        if not moves:
            return None
        columns = []
        for k, value in enumerate(self.values):
            steps = np.stack([move[k] for move in moves], axis=1)
            columns.append(np.hstack([value[:, None], value[:, None] + steps, value[:, None] - steps]))
        nu = np.zeros(self.solution.constraint_multipliers.size)
        problem = self.solution.need_problem("verify")
        with np.errstate(all="ignore"):
            found = evaluate_columns(end_values(problem), 1 + 2 * len(moves), *columns, nu)
            base, ahead, behind = found[:, :1], found[:, 1 : 1 + len(moves)], found[:, 1 + len(moves) :]
            first, second = 0.5 * (ahead - behind), ahead + behind - 2 * base
        return _finite(first), _finite(second)


def _end_arguments(leg: PhaseSolution) -> list[Any]:
    first, last = leg.x(leg.breaks[0]), leg.x(leg.breaks[-1], "left")
    return [first, last, leg.initial_time, leg.final_time, leg.integrals, leg.parameters]


# --- arrays -----------------------------------------------------------------------------------------------


def _finite(values: Array) -> Array:
    return np.where(np.isfinite(values), values, 0.0)


def _column(scale: Array, values: Array) -> Array:
    return scale.reshape(-1, *([1] * (np.ndim(values) - 1)))


def _shares(values: Array, scale: Array) -> Array:
    """Return values (n, ...) in shares of a scale (n,); zero stays zero, anything else over zero is infinite."""
    column = np.broadcast_to(_column(scale, values), np.shape(values))
    nothing = np.where(np.asarray(values) == 0, 0.0, np.inf)
    return np.divide(values, column, out=nothing, where=column > 0)


def _width(box: Interval) -> Array:
    width = box.upper - box.lower
    return np.where(np.isfinite(width), width, 0.0)
