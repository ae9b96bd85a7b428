r"""Curvature of the Hamiltonian in each control, and path constraints that limit controls linear in H.

Examples of such constraints: thrust per mass, thrust by altitude, load factors. With :math:`c(t, x, u) = a(t, x) u +
b(t, x) \le \bar c`, the sign of the switching function :math:`H_u` (without :math:`\mu`) determines whether the control
is as large or as small as its bounds and the constraint allow. At :math:`(\bar c - b) / a` the constraint is at its
limit and determines the control, with :math:`\mu = -H_u / a` (Hartl, Sethi & Vickson, SIAM Review 37(2), 1995, section
4). The control jumps at both ends of such an arc: they are switches.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gnc_opt.array_types import Array, Mask
from gnc_opt.numerical_tolerances import CONVEX, EQUAL, NOTABLE
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind
from gnc_opt.planning.refinement.arcs.control_structure import KindArray, select_kind
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples

SLOPE_PROBE_SHARE = 0.1
"""Change of a control, relative to its range, that tests whether a slope depends on the control."""


def mask_affine_controls(samples: PhaseSamples) -> Mask:
    """Return which controls, with two finite limits, are linear in H or always at path constraints, (m,)."""
    bounds, limits = samples.phase.control_bounds, find_linear_path_constraints(samples)
    bounded = np.isfinite(bounds.lower) & np.isfinite(bounds.upper)
    linear = _mask_linear_controls(samples)
    for i in limits.rows:
        bounded[i], linear[i] = np.all(np.isfinite(limits.find_tightest_limits(i))), True
    return linear & bounded


def find_linear_path_constraints(samples: PhaseSamples) -> LinearPathLimits:
    """Return the path constraints that limit a single control, linear in H or always at its limits."""
    linear = _mask_linear_controls(samples)
    limits = LinearPathLimits.from_samples(samples, ~linear & ~mask_convex_controls(samples))
    for i in limits.rows:
        linear[i] = limits.is_control_always_at_limits(i)
    return LinearPathLimits.from_samples(samples, linear)


def _mask_linear_controls(samples: PhaseSamples) -> Mask:
    return np.asarray(np.max(np.abs(compute_hamiltonian_curvature(samples)), axis=1) < EQUAL)


def mask_regular_controls(samples: PhaseSamples) -> Mask:
    """Return for which controls H is strictly convex along the whole phase, (m,)."""
    return np.asarray(np.min(compute_hamiltonian_curvature(samples), axis=1, initial=np.inf) > CONVEX)


def mask_convex_controls(samples: PhaseSamples) -> Mask:
    """Return for which controls H is convex along the whole phase, and strictly convex at some times, (m,).

    H is linear while the costate of a state that only the square of the control affects is zero. If a control is
    coupled with others in H, such as a direction with a magnitude, H has to be strictly convex along the whole phase.
    """
    curvature = compute_hamiltonian_curvature(samples)
    positive, negative = (np.maximum(sign * curvature, 0.0) @ samples.weights for sign in (1.0, -1.0))
    is_convex = np.any(curvature > CONVEX, axis=1) & (negative < NOTABLE * positive)
    scale, coupling = samples.control_scale, np.max(np.abs(samples.control_hessian), axis=2, initial=0.0)
    relative = coupling * np.outer(scale, scale) / samples.hamiltonian_scale
    np.fill_diagonal(relative, 0.0)
    return np.asarray((is_convex & np.all(relative <= EQUAL, axis=1)) | mask_regular_controls(samples))


def compute_hamiltonian_curvature(samples: PhaseSamples) -> Array:
    """Return the second derivative of H in each control, scaled by its range and relative to H, (m, n_samples)."""
    curvature = np.einsum("iij->ij", samples.control_hessian)
    return np.asarray(curvature * samples.control_scale[:, None] ** 2 / samples.hamiltonian_scale)


@dataclass(frozen=True, eq=False)
class LinearPathLimits:
    """Path constraints linear in one control each: ``rows`` by control, ``slopes`` (n_paths, n_samples)."""

    samples: PhaseSamples
    rows: Mapping[int, tuple[int, ...]]
    slopes: Array

    @classmethod
    def from_samples(cls, samples: PhaseSamples, linear: Mask) -> LinearPathLimits:
        """Return the path constraints on one control each, among controls that are linear in H (``linear``: (m,))."""
        phase, rows_by_control = samples.phase, dict[int, tuple[int, ...]]()
        slopes = np.zeros((len(phase.path_labels), samples.times.size))
        if not (phase.path_labels and np.any(linear)):
            return cls(samples, rows_by_control, slopes)
        jacobian = samples.functions.path_control_jacobian(samples.times, samples.x, samples.u)
        probe = samples.u + SLOPE_PROBE_SHARE * samples.control_scale[:, None]
        probed = samples.functions.path_control_jacobian(samples.times, samples.x, probe)
        constant = np.abs(probed - jacobian) <= EQUAL * np.max(np.abs(jacobian), axis=(1, 2), keepdims=True)
        depends = np.any(jacobian != 0, axis=2)
        inequality = phase.path_bounds.lower < phase.path_bounds.upper
        for i in np.flatnonzero(linear):
            is_single = depends[:, i] & (np.sum(depends, axis=1) == 1) & np.all(constant[:, i], axis=1)
            rows = np.flatnonzero(is_single & inequality)
            if rows.size:
                rows_by_control[int(i)] = tuple(int(row) for row in rows)
                slopes[rows] = jacobian[rows, i]
        return cls(samples, rows_by_control, slopes)

    def mask_samples_near_limit(self, control: int, margin: float) -> Mask:
        """Return where a control is within a margin of the limits that its path constraints impose, (n_samples,)."""
        uppers, lowers = self._compute_admissible_controls(control)
        u = self.samples.u[control]
        lower, upper = np.max([*lowers.values()], axis=0), np.min([*uppers.values()], axis=0)
        return np.asarray((u - lower <= margin) | (upper - u <= margin))

    def is_control_always_at_limits(self, control: int) -> bool:
        """Return whether a control is at the bound or constraint that minimises H along the whole phase."""
        s, (lower, upper) = self.samples, self.find_tightest_limits(control)
        distance = np.where(s.switching_functions[control] < 0, upper - s.u[control], s.u[control] - lower)
        return bool(np.mean(np.abs(distance) <= NOTABLE * s.control_scale[control]) > 1 - NOTABLE)

    def find_tightest_limits(self, control: int) -> tuple[Array, Array]:
        """Return the smallest and largest values that the bounds and constraints of a control allow, (n_samples,)."""
        uppers, lowers = self._compute_admissible_controls(control)
        bounds, size = self.samples.phase.control_bounds, self.samples.times.size
        lower, upper = np.full(size, bounds.lower[control]), np.full(size, bounds.upper[control])
        return np.max([lower, *lowers.values()], axis=0), np.min([upper, *uppers.values()], axis=0)

    def label_control_arcs(self, control: int, upward: Mask) -> tuple[KindArray, dict[int, KindArray]]:
        """Return the kinds of a control at the limit given by ``upward`` (n_samples,), and of active constraints."""
        bounds = self.samples.phase.control_bounds
        control_kinds = select_kind(upward, ArcKind.UPPER, ArcKind.LOWER)
        uppers, lowers = self._compute_admissible_controls(control)
        tightest = np.where(upward, bounds.upper[control], bounds.lower[control])
        path_kinds: dict[int, KindArray] = {}
        for row in self.rows[control]:
            row_limit = np.where(upward, uppers[row], lowers[row])
            tighter = np.where(upward, row_limit < tightest, row_limit > tightest)
            tightest = np.where(tighter, row_limit, tightest)
            control_kinds = select_kind(tighter, ArcKind.SINGULAR, control_kinds)
            for other, kinds in path_kinds.items():
                path_kinds[other] = select_kind(tighter, ArcKind.INTERIOR, kinds)
            limit = select_kind(upward == (self.slopes[row] > 0), ArcKind.UPPER, ArcKind.LOWER)
            path_kinds[row] = select_kind(tighter, limit, ArcKind.INTERIOR)
        return control_kinds, path_kinds

    def _compute_admissible_controls(self, control: int) -> tuple[dict[int, Array], dict[int, Array]]:
        """Return the largest and smallest values of a control that each of its constraints allows, (n_samples,)."""
        s, bounds = self.samples, self.samples.phase.path_bounds
        u, values = s.u[control], s.functions.path_constraints(s.times, s.x, s.u)
        uppers, lowers = dict[int, Array](), dict[int, Array]()
        for row in self.rows[control]:
            slope = np.where(self.slopes[row] == 0, np.nan, self.slopes[row])
            admissible = u + (np.array([bounds.lower[row], bounds.upper[row]])[:, None] - values[row]) / slope
            uppers[row] = np.where(np.isnan(slope), np.inf, np.max(admissible, axis=0))
            lowers[row] = np.where(np.isnan(slope), -np.inf, np.min(admissible, axis=0))
        return uppers, lowers
