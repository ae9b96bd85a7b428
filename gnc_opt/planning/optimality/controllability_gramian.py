"""Reach of the states: ellipsoid of the displacements caused by control deviations.

The ellipsoid follows from the weighted controllability Gramian, see the module `optimality_check_scales`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy

from gnc_opt.array_types import Array, Mask, compute_interval_midpoints
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_batch
from gnc_opt.numerical_tolerances import (
    EQUAL,
    NEGLIGIBLE,
    RANK,
    ROUNDING,
    replace_tiny_by_one,
    replace_zeros_by_one,
    set_nonfinite_to_zero,
)
from gnc_opt.planning.problem.hamiltonian_functions import evaluate_endpoint_gradients
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.piecewise_polynomial import subdivide_intervals
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.state_and_control_scales import SPAN_MIN_SHARE, STILL_STATE_SHARE

GRAMIAN_MIN_CELLS = 40
"""Smallest number of cells of a phase with constant linearised dynamics."""

_EXPONENT_MAX_ENTRY = 25.0
"""Largest entry of a matrix exponent; avoids overflow for dynamics much faster than a cell."""


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """Ellipsoid of state displacements caused by control variations.

    ``radius`` (n,) is the largest displacement of each state, ``reached`` whether controls move it. ``axes`` (n, n) and
    ``shares`` (n,) are eigenvectors, as columns, and square roots of the eigenvalues of the correlation matrix.
    """

    radius: Array
    axes: Array
    shares: Array
    reached: Mask | np.bool_ = np.True_

    @classmethod
    def from_gramian(cls, gramian: Array, radius: Array, smallest: float = ROUNDING) -> Ellipsoid:
        """Return the ellipsoid of a Gramian (n, n), with eigenvalues of at least ``smallest`` and given radii (n,)."""
        sizes = np.sqrt(np.maximum(np.diag(gramian), 0.0))
        is_nonzero = sizes > 0
        scale = np.where(is_nonzero, sizes, 1.0)
        correlation = gramian / scale / scale[:, None]
        correlation[~is_nonzero], correlation[:, ~is_nonzero] = 0.0, 0.0
        correlation[np.diag_indices_from(correlation)] = 1.0
        values, axes = np.linalg.eigh(0.5 * (correlation + correlation.T))
        return cls(radius, axes, np.sqrt(np.clip(values, smallest, None)), is_nonzero)

    def normalise_displacement(self, shift: Array) -> Array:
        """Return displacements (n, ...) relative to the ellipsoid (...)."""
        column = np.broadcast_to(_reshape_scale_for_time_series(self.radius, shift), np.shape(shift))
        unreached = np.where(np.asarray(shift) == 0, 0.0, np.inf)  # 0/0 is 0
        shares = np.divide(shift, column, out=unreached, where=column > 0)
        parts = np.tensordot(self.axes.T, shares, 1)
        return np.asarray(np.linalg.norm(parts / _reshape_scale_for_time_series(self.shares, parts), axis=0))

    def support_function(self, gradient: Array) -> Array:
        """Return the largest change of a quantity with gradients (n, ...) over the ellipsoid (...)."""
        scaled = np.asarray(gradient) * _reshape_scale_for_time_series(self.radius, gradient)
        parts = np.tensordot(self.axes.T, scaled, 1)
        return np.asarray(np.linalg.norm(parts * _reshape_scale_for_time_series(self.shares, parts), axis=0))

    @property
    def semi_axes(self) -> Array:
        """Principal semi-axes (n, n), as columns."""
        return np.asarray(self.radius[:, None] * self.axes * self.shares)

    @property
    def nonzero_semi_axes(self) -> Array:
        """Principal semi-axes with 1 for states without displacement, for derivatives."""
        radius = replace_zeros_by_one(self.radius)
        return np.asarray(radius[:, None] * self.axes * self.shares)


class Reach(NamedTuple):
    """Ellipsoids of the states of a phase, and of final states and integrals (``end_with_integrals``)."""

    start: Ellipsoid
    along: Ellipsoid
    end: Ellipsoid
    end_with_integrals: Ellipsoid


@dataclass(frozen=True, eq=False)
class _Gramian:
    """Controllability Gramian W of a phase: at the start, mean, at the end (n, n), with integrals; decay of errors."""

    start: Array
    mean: Array
    end: Array
    whole: Array
    decay: float = 1.0


def compute_control_gramians(
    links: Mapping[str, Mapping[str, Array]],
    samples: list[PhaseSamples],
    deviations: Mapping[str, Array],
    columns: Mapping[str, Array],
) -> dict[str, _Gramian]:
    """Return the Gramian of every phase, in order of the initial times."""
    gramians: dict[str, _Gramian] = {}
    for s in samples:
        earlier = {name: row for name, row in links[s.phase.name].items() if name}
        start = _build_initial_gramian(s, earlier, links[s.phase.name][""], gramians)
        gramians[s.phase.name] = _integrate_gramian(
            s, deviations[s.phase.name], start, columns.get(s.phase.name)
        )
    return gramians


def _integrate_gramian(s: PhaseSamples, deviation: Array, start: Array, columns: Array | None) -> _Gramian:
    """Return Gramians of the states reached by deviations of controls, and of parameters if ``columns`` are given."""
    phase = s.phase
    if not s.has_duration:
        return _Gramian(start, start, start, np.pad(start, (0, phase.integrals.size)))
    n, n_integrals = start.shape[0], phase.integrals.size
    n_cells = -(-GRAMIAN_MIN_CELLS // phase.mesh.segments)
    widths, _, by_state, by_control, _ = linearise_dynamics(s)
    by_state = np.pad(by_state, ((0, 0), (0, 0), (0, n_integrals)))  # without influence of the integrals
    start = np.pad(start, (0, n_integrals))
    half = exponentiate_matrices(0.5 * widths[:, None, None] * by_state)
    impulses = s.integrate_over_segments(deviation)
    strength = np.sum(impulses, axis=1)[:, None] * np.repeat(impulses / n_cells, n_cells, axis=1)
    responses = np.zeros((start.shape[0], 0 if columns is None else columns.shape[2]))
    total, mean, duration = start.copy(), np.zeros_like(start), float(phase.breaks[-1] - phase.breaks[0])
    with_parameters = total
    for k, width in enumerate(widths):
        effect = half[k] @ by_control[k]
        step = half[k] @ half[k]
        next_total = step @ total @ step.T + (effect * strength[:, k]) @ effect.T
        if columns is not None:
            responses = step @ responses + width * half[k] @ columns[k]
        if not np.all(np.isfinite(next_total)):
            break
        total, previous = next_total, with_parameters
        with_parameters = total + responses @ responses.T
        mean += 0.5 * width / duration * (previous + with_parameters)
    fastest = np.max(np.linalg.eigvals(by_state).real, axis=1, initial=0.0)
    decay = float(np.exp(-np.sum(fastest * widths)))
    return _Gramian(start[:n, :n], mean[:n, :n], with_parameters[:n, :n], with_parameters, decay)


def differentiate_final_state_by_controls(s: PhaseSamples) -> tuple[Array, Array]:
    """Return derivatives of the end in the controls (n, m, n_cells) at the centres of cells, and these times."""
    n, m = s.phase.states.size, s.phase.controls.size
    widths, times, by_state, by_control, _ = linearise_dynamics(s)
    halves, transition = exponentiate_matrices(0.5 * widths[:, None, None] * by_state[:, :n]), np.eye(n)
    responses = np.zeros((n, m, widths.size))
    for k in reversed(range(widths.size)):
        transition = transition @ halves[k]
        responses[:, :, k] = transition @ by_control[k, :n]
        transition = transition @ halves[k]
    return times, responses


def linearise_dynamics(s: PhaseSamples) -> tuple[Array, Array, Array, Array, Array]:
    """Return widths and centres of cells, and finite Jacobians of rates and integrands in x, u and q there.

    The Jacobians are (n_cells, n_states + n_integrals, ...).
    """
    f, edges = s.functions, subdivide_mesh_segments(s.phase.breaks)

    def build_jacobian_function() -> Any:
        symbols = [ca.SX.sym("v", f.functions["rates"].size1_in(i)) for i in range(8)]
        rates = ca.vertcat(*(f.functions[name](*symbols) for name in ("rates", "integrands")))
        jacobian = ca.jacobian(rates, ca.vertcat(symbols[1], symbols[2], symbols[7]))
        return ca.Function("linearised", [*symbols[:3], *symbols[6:]], [ca.densify(ca.vec(jacobian.T))])

    key, times = "rate and integrand jacobian", compute_interval_midpoints(edges)
    if key not in f.functions:
        f.functions[key] = build_jacobian_function()
    x, u = s.phase.x(times), s.phase.applied(times)
    with np.errstate(all="ignore"):
        values = evaluate_casadi_batch(f.functions[key], times.size, times[None], x, u, f.p, f.q)
    jacobians = set_nonfinite_to_zero(values.T.reshape(times.size, -1, len(x) + len(u) + f.q.size))
    by_state, by_control, by_parameter = np.split(jacobians, [len(x), len(x) + len(u)], axis=2)
    return np.diff(edges), times, by_state, by_control, by_parameter


def exponentiate_matrices(matrices: Array) -> Array:
    """Return matrix exponentials (n_matrices, n, n); matrices of large norm are scaled down."""
    sizes = np.max(np.abs(np.linalg.eigvals(matrices)), axis=1, initial=0.0)
    reduced = np.minimum(1.0, np.divide(_EXPONENT_MAX_ENTRY, sizes, out=np.ones_like(sizes), where=sizes > 0))
    return np.asarray(scipy.linalg.expm(matrices * reduced[:, None, None]))


def subdivide_mesh_segments(breaks: Array) -> Array:
    """Return the cell edges of a phase with given mesh breaks: segments divided into equal parts."""
    return subdivide_intervals(breaks, -(-GRAMIAN_MIN_CELLS // (breaks.size - 1)))


def compute_phase_reachable_sets(s: PhaseSamples, gramian: _Gramian, typical: Array) -> Reach:
    """Return the reach at the start, along the phase, at the end, and at the end with the integrals.

    ``typical`` (n,) are magnitudes of the states; displacements far below them are rounding errors.
    """
    size, motion = (np.max(np.abs(set_nonfinite_to_zero(v)), axis=1) for v in (s.x, s.x - s.x[:, :1]))
    matrices = gramian.mean, gramian.end, gramian.start
    mean, end, start = (np.sqrt(np.maximum(np.diag(w), 0.0)) for w in matrices)
    if not s.has_duration:  # without motion, magnitudes are used
        mean = end = replace_tiny_by_one(size)
    has_moved = (motion > STILL_STATE_SHARE * gramian.decay * mean) & (motion > SPAN_MIN_SHARE * size)
    radius = initial = np.where(has_moved, np.minimum(mean, motion), mean)
    final = np.where(has_moved, np.minimum(end, motion), end)
    if not s.has_fixed_duration:  # uncontrollable states vary with the arrival time
        radius, final = (
            np.where(r > STILL_STATE_SHARE * motion, r, np.fmax(r, motion)) for r in (radius, final)
        )
    smallest = np.fmax(SPAN_MIN_SHARE * size, EQUAL * typical)
    radius, final = np.fmax(radius, smallest), np.fmax(final, smallest)
    initial = np.where(start > 0, start, np.fmax(initial, smallest))
    with_integrals = np.append(final, np.sqrt(np.diag(gramian.whole)[final.size :]))
    return Reach(
        Ellipsoid.from_gramian(gramian.start, initial),
        Ellipsoid.from_gramian(gramian.mean, radius, NEGLIGIBLE),  # defects have the errors of interpolation
        Ellipsoid.from_gramian(gramian.end, final),
        Ellipsoid.from_gramian(gramian.whole, with_integrals),
    )


def _build_initial_gramian(
    s: PhaseSamples, links: Mapping[str, Array], projection: Array, gramians: Mapping[str, _Gramian]
) -> Array:
    """Return W at the start of a phase: 0 if fixed, from links to other phases, else the magnitude of the state."""
    size, motion = (np.max(np.abs(set_nonfinite_to_zero(v)), axis=1) for v in (s.x, s.x - s.x[:, :1]))
    size = np.where(motion > SPAN_MIN_SHARE * size, motion, size)
    size = np.where(size > 0, size, s.phase.state_bounds.interval_width_or_zero)
    free_part = projection * replace_zeros_by_one(size)
    covariance = free_part @ free_part.T
    for name, response in links.items():
        covariance = covariance + response @ gramians[name].end @ response.T
    return covariance


def differentiate_linked_initial_states(
    problem: Problem, solution: Solution, samples: list[PhaseSamples]
) -> dict[str, dict[str, Array]]:
    """Return the derivatives of the start of each phase in the ends of earlier ones (n, n_other)."""
    jacobians, links = evaluate_boundary_jacobians(problem, solution), {}
    for k, s in enumerate(samples):
        phase = s.phase
        free = np.flatnonzero(~phase.initial_bounds.is_fixed)
        size = np.max(np.abs(set_nonfinite_to_zero(s.x)), axis=1)
        unit = replace_zeros_by_one(size)[free]
        by_start = jacobians[phase.name][0][:, free] * unit
        linked = np.any(by_start != 0, axis=1)
        earlier = [other.phase.name for other in samples[:k]]
        for name, (at_start, at_end) in jacobians.items():
            linked &= ~np.any(at_start != 0, axis=1) if name != phase.name else True
            linked &= ~np.any(at_end != 0, axis=1) if name not in earlier else True
        names = [name for name in earlier if np.any(jacobians[name][1][linked])]
        linked &= (
            np.any([np.any(jacobians[name][1] != 0, axis=1) for name in names], axis=0) if names else False
        )
        inverse = np.linalg.pinv(by_start[linked], rcond=RANK)
        project = np.zeros((phase.states.size, phase.states.size))
        project[np.ix_(free, free)] = unit[:, None] * (np.eye(free.size) - inverse @ by_start[linked]) / unit
        links[phase.name] = {"": project}
        for name in names:
            response = np.zeros((phase.states.size, solution.phases[name].states.size))
            response[free] = -unit[:, None] * (inverse @ jacobians[name][1][linked])
            links[phase.name][name] = response
    return links


def evaluate_boundary_jacobians(problem: Problem, solution: Solution) -> dict[str, tuple[Array, Array]]:
    """Return the boundary Jacobians in initial and final states (n_constraints, n), by phase."""
    ends = {name: phase.endpoint_arguments for name, phase in solution.phases.items()}
    units = np.vstack(
        [np.zeros((1, len(solution.constraint_labels))), np.eye(len(solution.constraint_labels))]
    )
    rows = [evaluate_endpoint_gradients(problem, ends, solution.parameter_values, nu) for nu in units]
    jacobians = {}
    for name in ends:
        gradients = (
            np.stack([getattr(row, end)[name] for row in rows]) for end in ("initial_state", "final_state")
        )
        at_start, at_end = (g[1:] - g[0] for g in gradients)
        jacobians[name] = at_start, at_end
    return jacobians


def _reshape_scale_for_time_series(scale: Array, values: Array) -> Array:
    return scale.reshape(-1, *([1] * (np.ndim(values) - 1)))
