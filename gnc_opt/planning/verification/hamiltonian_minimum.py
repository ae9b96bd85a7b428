"""Global minimum of the Hamiltonian over admissible controls, by groups coupled in H or path constraints.

The minimum has a closed form for a vector control in which H is affine. If H is a convex quadratic function with affine
constraints, one descent finds it. For other groups `TRIALS` controls of a Kronecker lattice are evaluated along the
phase (gaps: Slater, Proc. Cambridge Philos. Soc. 63, 1967), and Newton's method descends from the best of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gnc_opt.array_types import Array, Indices
from gnc_opt.model.split_and_magnitude_direction_controls import VectorControl
from gnc_opt.numerical_tolerances import EQUAL, NEGLIGIBLE, RANK, ROUNDING, SMALL, TINY, set_nonfinite_to_zero
from gnc_opt.planning.optimality.cost_and_endpoint_scales import average_violation_over_time
from gnc_opt.planning.optimality.optimality_check_scales import CURVED_MIN_COST
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.verification.critical_cone import find_vector_control

TRIALS = 2**15
"""Number of trial controls per group along a phase, for minima of a small share of the controls and of the duration."""

_MAX_TIMES = 400
_MAX_STARTS = 50
_LATTICE_MARGIN = 0.05
"""Share of the range by which the lattice exceeds each bound before clipping, since minima are often at bounds."""

TRIAL_MIN_DISTANCE = 1e-8
"""Smallest distance of trial controls from the applied control, as a share of the range."""

RESOLVED_GAIN_SHARE = 3e-7
"""Share of the mean cost scale below which decreases of H are errors of multipliers, as for zero costates."""

_STARTS_REFINED = 8
_HAMILTONIAN_NEWTON_STEPS = 12
_STEP_LENGTHS = (1.0, 0.3, 0.1, 0.01, 0.001)


@dataclass(frozen=True)
class HamiltonianGain:
    """Decrease of H by other controls of a group at times (n_times,): ``gain`` in cost per second.

    ``share`` is relative to the change of H over half the range in the direction of the better control.
    """

    times: Array
    gain: Array
    share: Array


def get_control_search_bounds(s: PhaseSamples) -> tuple[Array, Array]:
    """Return bounds of the controls; if infinite, half a turn or a generous margin beyond the values that occur."""
    bounds, half_turn = s.phase.control_bounds, 0.5 * s.angular_control_periods
    margin = 2.0 * np.maximum(np.max(np.abs(s.u), axis=1), s.control_scale)
    fallback_lower = np.where(half_turn > 0, np.min(s.u, axis=1) - half_turn, -margin)
    fallback_upper = np.where(half_turn > 0, np.max(s.u, axis=1) + half_turn, margin)
    lower = np.where(np.isfinite(bounds.lower), bounds.lower, fallback_lower)
    return lower, np.where(np.isfinite(bounds.upper), bounds.upper, fallback_upper)


def draw_low_discrepancy_points(n: int, dimensions: int) -> Array:
    """Return n points of [0, 1)^d whose subsequences are evenly distributed (dimensions, n).

    They are multiples of powers of the root of x^(d + 1) = x + 1, the golden ratio for one dimension.
    """
    root = 2.0
    for _ in range(50):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    return np.outer(root ** -np.arange(1.0, dimensions + 1), 0.5 + np.arange(n)) % 1.0


def compute_joint_hamiltonian_decreases(
    s: PhaseSamples, deviation: Array, cost: float, tolerance: float
) -> tuple[list[HamiltonianGain], bool]:
    """Return the decrease for every group of controls in which H is not affine, and whether a search was needed.

    Shares refer to moves of the size of the control deviations (m,), and to the cost scale.
    """
    chosen = np.unique(np.linspace(0, s.times.size - 1, _MAX_TIMES).astype(int))
    gains, searched = [], False
    for group in s.functions.coupled_controls:
        search = _MinimumSearch(s, group, chosen, deviation, cost / s.span)
        vector = find_vector_control(s, group)
        if vector is not None:
            gains.append(search.average_hamiltonian_decrease(search.minimise_over_vector_control(vector)))
        elif not search.has_unique_minimum:
            gains.append(search.find_largest_hamiltonian_decrease(tolerance))
            searched = True
        else:
            minima = search.minimise_by_newton(search._normalised_controls, np.arange(search.chosen.size))[0]
            gains.append(search.average_hamiltonian_decrease(minima))
    return gains, searched


def minimise_hamiltonian(s: PhaseSamples) -> tuple[Array, Array]:
    """Return times (n_times,) and minimising controls (m, n_times); those with negligible slope do not change."""
    chosen = np.unique(np.linspace(0, s.times.size - 1, _MAX_TIMES).astype(int))
    lower, upper = (limit[:, None] for limit in get_control_search_bounds(s))
    slope, separable = s.control_gradient[:, chosen], s.functions.separable_controls[:, None]
    is_clear = separable & (np.abs(slope) * (upper - lower) > SMALL * s.max_hamiltonian_change)
    u = np.where(is_clear, np.where(slope > 0, lower, upper), s.u[:, chosen])
    for group in s.functions.coupled_controls:
        search = _MinimumSearch(s, group, chosen)
        vector = find_vector_control(s, group)
        u[group] = search.denormalise_controls(
            search.find_global_minima() if vector is None else search.minimise_over_vector_control(vector)
        )
    return s.times[chosen], u


@dataclass(frozen=True, eq=False)
class _MinimumSearch:
    """Search for the minimum of H over one group of controls, as shares of their ranges (group, n), at some samples."""

    s: PhaseSamples
    group: Indices
    chosen: Indices
    deviation: Array | None = None
    cost_rate: float = 0.0

    @cached_property
    def _control_search_ranges(self) -> tuple[Array, Array]:
        """Lower bounds and ranges of the controls of the group, (group, 1) each."""
        lower, upper = (limit[self.group, None] for limit in get_control_search_bounds(self.s))
        return lower, upper - lower

    @cached_property
    def _normalised_controls(self) -> Array:
        lower, span = self._control_search_ranges
        applied = self.s.u[np.ix_(self.group, self.chosen)]
        return np.asarray(np.divide(applied - lower, span, out=np.zeros_like(applied), where=span > 0))

    @cached_property
    def _path_constraint_limits(self) -> Array:
        """Limits of the path constraints, or the applied value if it exceeds them (n_paths, n) each."""
        s, bounds = self.s, self.s.phase.path_bounds
        values = s.functions.path_constraints(s.times, s.x, s.u)[:, self.chosen]
        slack = EQUAL * (s.path_scale[:, None] + np.abs(values))
        return np.stack(
            [
                np.minimum(bounds.lower[:, None], values) - slack,
                np.maximum(bounds.upper[:, None], values) + slack,
            ]
        )

    def _substitute_controls(self, shares: Array, indices: Indices) -> tuple[Array, Array, Array]:
        """Return times (n,), states and controls at samples, with the shares (group, n) of the group."""
        samples, (lower, span) = self.chosen[indices], self._control_search_ranges
        u = self.s.u[:, samples]
        u[self.group] = np.where(span > 0, lower + span * shares, u[self.group])
        return self.s.times[samples], self.s.x[:, samples], u

    def evaluate_hamiltonian(self, shares: Array, indices: Indices) -> Array:
        """Return H (n,), infinite for inadmissible controls."""
        s, (times, x, u) = self.s, self._substitute_controls(shares, indices)
        value = s.functions.hamiltonian(times, x, u, s.lam[:, self.chosen[indices]])
        admissible = np.isfinite(value)
        if np.any(s.functions.mixed_path_constraints):
            lower, upper = self._path_constraint_limits[:, :, indices]
            paths = s.functions.path_constraints(times, x, u)
            is_inside = (paths >= lower) & (paths <= upper)
            admissible &= np.all(is_inside | ~s.functions.mixed_path_constraints[:, None], axis=0)
        return np.where(admissible, value, np.inf)

    def _project_onto_path_constraints(self, shares: Array, indices: Indices) -> Array:
        """Return controls that violate a path constraint, moved to its limit by Gauss-Newton steps."""
        functions = self.s.functions
        if not np.any(functions.mixed_path_constraints):
            return shares
        shares, cols = shares.copy(), np.arange(indices.size)
        for _ in range(_HAMILTONIAN_NEWTON_STEPS):
            times, x, u = self._substitute_controls(shares[:, cols], indices[cols])
            paths = functions.path_constraints(times, x, u)
            gap = np.clip(paths, *self._path_constraint_limits[:, :, indices[cols]]) - paths
            is_violated = np.any(gap != 0, axis=0) & np.all(np.isfinite(paths), axis=0)
            if not np.any(is_violated):
                break
            cols, gap = cols[is_violated], gap[:, is_violated]
            rows = self._evaluate_path_constraint_gradients(shares[:, cols], indices[cols])
            inverse = np.linalg.pinv(np.where((gap != 0).T[:, :, None], rows, 0.0), rcond=RANK)
            shares[:, cols] = np.clip(shares[:, cols] + np.einsum("nij,jn->in", inverse, gap), 0.0, 1.0)
        return shares

    def _evaluate_path_constraint_gradients(self, shares: Array, indices: Indices) -> Array:
        jacobian = (
            self.s.functions.path_control_jacobian(*self._substitute_controls(shares, indices))[:, self.group]
            * self._control_search_ranges[1]
        )
        return set_nonfinite_to_zero(np.moveaxis(jacobian, 2, 0))

    def evaluate_hamiltonian_derivatives(
        self, shares: Array, indices: Indices, mu: Array | None = None
    ) -> tuple[Array, Array]:
        """Return gradient (group, n) and Hessian (n, group, group) in shares of the range; zero if not finite."""
        s, group, (times, x, u) = self.s, self.group, self._substitute_controls(shares, indices)
        lam, span = s.lam[:, self.chosen[indices]], self._control_search_ranges[1]
        gradient = s.functions.switching_functions(times, x, u, lam)[group] * span
        mu = np.zeros((len(s.phase.path_labels), indices.size)) if mu is None else mu
        hessian = s.functions.control_hessian(times, x, u, lam, mu)[np.ix_(group, group)]
        curvature = np.moveaxis(hessian * span[:, None] * span[None, :], 2, 0)
        return set_nonfinite_to_zero(gradient), set_nonfinite_to_zero(curvature)

    @cached_property
    def has_unique_minimum(self) -> bool:
        """Whether H, apart from jumps, is a convex quadratic function of the controls with affine constraints."""
        if not self.s.functions.is_hamiltonian_quadratic_in(self.group):
            return False
        all_times = np.arange(self.chosen.size)
        gradient, hessian = self.evaluate_hamiltonian_derivatives(self._normalised_controls, all_times)
        eigenvalues = np.linalg.eigvalsh(hessian)
        if np.any(eigenvalues[:, 0] < -EQUAL * np.max(np.abs(eigenvalues))):
            return False
        step = draw_low_discrepancy_points(all_times.size, self.group.size) - self._normalised_controls
        _, _, u = self._substitute_controls(self._normalised_controls + step, all_times)
        s = self.s
        value = s.functions.hamiltonian(s.times[self.chosen], s.x[:, self.chosen], u, s.lam[:, self.chosen])
        first, second = np.sum(gradient * step, axis=0), 0.5 * np.einsum("in,nij,jn->n", step, hessian, step)
        chosen_values = s.hamiltonian[self.chosen]
        magnitudes = np.abs(chosen_values) + np.abs(first) + np.abs(second) + s.hamiltonian_scale
        return bool(np.all(np.abs(value - chosen_values - first - second) <= EQUAL * magnitudes))

    def minimise_over_vector_control(self, vector: VectorControl) -> Array:
        """Return the minimising controls (group, n_times) of a vector in which H is affine, in closed form."""
        s, layout = self.s, self.s.phase.controls
        magnitude, direction = (layout.slice(part) for part in vector.parts)
        times, x, u = self._substitute_controls(self._normalised_controls, np.arange(self.chosen.size))
        applied = u[direction].copy()
        u[magnitude], u[direction] = 1.0, 0.0
        slope = s.functions.switching_functions(times, x, u, s.lam[:, self.chosen])
        strength = np.linalg.norm(slope[direction], axis=0)
        u[direction] = np.divide(-slope[direction], strength, out=applied, where=strength > 0)
        smallest, largest = (limit[magnitude, None] for limit in get_control_search_bounds(s))
        u[magnitude] = np.where(slope[magnitude] > strength, smallest, largest)
        lower, span = self._control_search_ranges
        offset = u[self.group] - lower
        return np.asarray(np.divide(offset, span, out=np.zeros_like(offset), where=span > 0))

    def denormalise_controls(self, shares: Array) -> Array:
        """Return the controls (group, n_times) for shares of their range; as applied without a range."""
        lower, span = self._control_search_ranges
        return np.where(span > 0, lower + span * shares, self.s.u[np.ix_(self.group, self.chosen)])

    def find_global_minima(self) -> Array:
        """Return the minimising controls (group, n_times) from descents from all trial points."""
        shares, _, _, _, best = self._sample_trial_controls()
        return self._minimise_from_best_points(np.zeros((self.group.size, 0)), shares[:, best])

    def find_largest_hamiltonian_decrease(self, tolerance: float) -> HamiltonianGain:
        """Return the result of a search; improvements are continued to all times."""
        shares, indices, value, first, best = self._sample_trial_controls()
        times = np.unique(np.linspace(0, self.chosen.size - 1, _MAX_STARTS).astype(int))
        starts = np.concatenate([best[times], first[times]])  # the first point of each time is arbitrary
        minimisers, minima = self.minimise_by_newton(
            np.concatenate([shares[:, starts], self._normalised_controls[:, times]], axis=1),
            np.concatenate([indices[starts], times]),
        )
        points = np.concatenate([shares[:, best], minimisers], axis=1)
        times = np.concatenate([indices[best], indices[starts], times])
        values = np.concatenate([value[best], minima])
        gain, share = self._compute_decrease(points, values, times)
        if np.max(share) <= tolerance:
            largest = np.zeros((2, self.chosen.size))
            for row, values in zip(largest, (gain, share), strict=True):
                np.maximum.at(row, times, values)
            return HamiltonianGain(self.s.times[self.chosen], *largest)
        order = np.argsort(-share)[: times.size // 4]
        best_of = points[:, order[:: max(1, order.size // _STARTS_REFINED)]]
        return self.average_hamiltonian_decrease(self._minimise_from_best_points(best_of, shares[:, best]))

    def _sample_trial_controls(self) -> tuple[Array, Indices, Array, Indices, Indices]:
        """Return trial points, their times, H, and the first and the best point of each time.

        Half of them are distributed over the range, the others at log-uniform distances from the applied control.
        """
        n, k = self.chosen.size, self.group.size
        times = np.repeat(np.arange(n), TRIALS // n)
        points, applied = draw_low_discrepancy_points(times.size, k), self._normalised_controls[:, times]
        shares = np.clip((1 + 2 * _LATTICE_MARGIN) * points - _LATTICE_MARGIN, 0.0, 1.0)
        is_near = np.arange(times.size) % 2 == 1
        signed = 2.0 * points - 1.0
        distance = np.sign(signed) * TRIAL_MIN_DISTANCE ** (1.0 - np.abs(signed))
        shares[:, is_near] = np.clip(applied + distance, 0.0, 1.0)[:, is_near]
        single_control = np.flatnonzero(np.arange(times.size) % 4 >= 2)
        varied = (single_control // 4) % k
        points_on_lines = applied[:, single_control]
        points_on_lines[varied, np.arange(single_control.size)] = shares[varied, single_control]
        shares[:, single_control] = points_on_lines
        value, first_points = self.evaluate_hamiltonian(shares, times), np.arange(n) * (times.size // n)
        return shares, times, value, first_points, first_points + np.argmin(value.reshape(n, -1), axis=1)

    def _minimise_from_best_points(self, other_points: Array, best: Array) -> Array:
        times = np.arange(self.chosen.size)
        trials = np.stack(
            [self._normalised_controls, best, *(np.tile(w[:, None], times.size) for w in other_points.T)]
        )
        lowest = np.argmin([self.evaluate_hamiltonian(w, times) for w in trials], axis=0)
        return self.minimise_by_newton(trials[lowest, :, times].T, times)[0]

    def average_hamiltonian_decrease(self, shares: Array) -> HamiltonianGain:
        """Return the decrease of H by controls (group, n_times), averaged over short times."""
        all_times, times = np.arange(self.chosen.size), self.s.times[self.chosen]
        gain, share = self._compute_decrease(shares, self.evaluate_hamiltonian(shares, all_times), all_times)
        return HamiltonianGain(times, *average_violation_over_time(times, np.stack([gain, share])))

    def _compute_decrease(self, shares: Array, value: Array, indices: Indices) -> tuple[Array, Array]:
        """Return decreases of H by shares (group, n) with a value of H (n,), and their relative sizes (n,)."""
        gain = np.nan_to_num(self.s.hamiltonian[self.chosen[indices]] - value, posinf=0.0)
        magnitude = np.fmax(self.s.hamiltonian_term_magnitudes[self.chosen[indices]], np.abs(value))
        resolved = np.maximum(ROUNDING * magnitude, RESOLVED_GAIN_SHARE * self.cost_rate)
        gain = np.where(gain > resolved, gain, 0.0)
        return gain, gain / (
            self._compute_largest_hamiltonian_change(shares - self._normalised_controls[:, indices]) + gain
        )

    def _compute_largest_hamiltonian_change(self, moves: Array) -> Array:
        """Return the largest change of H along the phase by moves (group, n) scaled to the control deviations."""
        s, group = self.s, self.group
        scale = s.control_span[group, None]
        if self.deviation is not None:
            scale = np.where(self.deviation[group, None] > 0, self.deviation[group, None], scale)
        physical = moves * self._control_search_ranges[1]
        length = np.max(np.abs(physical) / scale, axis=0)
        direction = np.divide(physical, length, out=np.zeros_like(physical), where=length > 0)
        slopes = s.switching_functions[np.ix_(group, self.chosen)]
        curvature = s.control_hessian[np.ix_(group, group, self.chosen)]
        with np.errstate(invalid="ignore"):  # roots have infinite slope at zero
            pairs = direction[:, None] * direction
            second_order = 0.5 * np.tensordot(curvature, pairs, axes=([0, 1], [0, 1]))
        change = np.fmax(np.abs(slopes.T @ direction), np.abs(second_order))
        return np.asarray(
            np.maximum(np.max(set_nonfinite_to_zero(change), axis=0), CURVED_MIN_COST * self.cost_rate)
        )

    def minimise_by_newton(self, shares: Array, indices: Indices) -> tuple[Array, Array]:
        """Return the controls reached by Newton's method with decreasing H within the bounds, and their H."""
        shares = self._project_onto_path_constraints(shares.copy(), indices)
        value = self.evaluate_hamiltonian(shares, indices)
        active = np.arange(indices.size)
        for _ in range(_HAMILTONIAN_NEWTON_STEPS):
            step = self._compute_newton_step(shares[:, active], indices[active])
            trial_times = np.tile(indices[active], len(_STEP_LENGTHS))
            trials = np.concatenate([shares[:, active] + a * step for a in _STEP_LENGTHS], axis=1)
            trials = self._project_onto_path_constraints(np.clip(trials, 0.0, 1.0), trial_times)
            values = self.evaluate_hamiltonian(trials, trial_times).reshape(-1, active.size)
            lowest = np.argmin(values, axis=0)
            lowest_values = values[lowest, np.arange(active.size)]
            better = lowest_values < value[active] - NEGLIGIBLE * self.s.hamiltonian_rounding_level
            if not np.any(better):
                break
            shares[:, active[better]] = trials[:, (lowest * active.size + np.arange(active.size))[better]]
            value[active[better]] = lowest_values[better]
            active = active[better]
        return shares, value

    def _compute_newton_step(self, shares: Array, indices: Indices) -> Array:
        """Return Newton's step (group, n) along active bounds and path constraints."""
        gradient, hessian = self.evaluate_hamiltonian_derivatives(shares, indices)
        at_bound = ((shares <= 0) & (gradient > 0)) | ((shares >= 1) & (gradient < 0))
        free = np.where(at_bound, 0.0, 1.0).T
        tangent = free[:, :, None] * np.eye(free.shape[1])
        if np.any(self.s.functions.mixed_path_constraints):
            rows, mu = self._compute_path_multipliers(shares, indices, gradient, free)
            tangent = tangent - np.linalg.pinv(rows, rcond=RANK) @ rows
            hessian = self.evaluate_hamiltonian_derivatives(shares, indices, mu)[1]
        sizes, axes = np.linalg.eigh(tangent @ hessian @ tangent)
        slope = (np.swapaxes(axes, 1, 2) @ tangent @ gradient.T[:, :, None])[:, :, 0]
        steepest = np.max(np.abs(slope), axis=1)
        sizes = np.abs(sizes)
        floor = np.maximum(EQUAL * np.max(sizes, axis=1), SMALL * steepest)
        step = -np.einsum("nij,nj->in", axes, slope / np.maximum(sizes, np.maximum(floor, TINY)[:, None]))
        return np.asarray(np.where(at_bound, 0.0, step / np.maximum(1.0, np.max(np.abs(step), axis=0))))

    def _compute_path_multipliers(
        self, shares: Array, indices: Indices, gradient: Array, free: Array
    ) -> tuple[Array, Array]:
        """Return derivatives (n, n_paths, group) and multipliers (n_paths, n) of active path constraints."""
        functions = self.s.functions
        paths = functions.path_constraints(*self._substitute_controls(shares, indices))
        lower, upper = self._path_constraint_limits[:, :, indices]
        slack = 2.0 * EQUAL * (self.s.path_scale[:, None] + np.abs(paths))
        at_least, at_most = paths <= lower + slack, paths >= upper - slack
        active = (at_least | at_most) & functions.mixed_path_constraints[:, None] & np.isfinite(paths)
        rows = self._evaluate_path_constraint_gradients(shares, indices) * free[:, None, :]
        mu = np.zeros_like(paths)
        for _ in range(2):  # limits with inadmissible multipliers are released
            active_rows = np.where(active.T[:, :, None], rows, 0.0)
            mu = -np.einsum("nij,in->jn", np.linalg.pinv(active_rows, rcond=RANK), gradient)
            active &= (at_least & (mu <= 0)) | (at_most & (mu >= 0))
        return np.where(active.T[:, :, None], rows, 0.0), np.where(active, mu, 0.0)
