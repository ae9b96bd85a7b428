"""Curvature of the Hamiltonian in each control: linear, convex or neither."""

from __future__ import annotations

import numpy as np

from gnc_opt.array_types import Array, Mask
from gnc_opt.numerical_tolerances import CONVEX, EQUAL, NOTABLE
from gnc_opt.planning.refinement.arcs.mixed_constraints import LinearPathLimits
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples


def mask_affine_controls(samples: PhaseSamples) -> Mask:
    """Return which controls are linear in H with two finite bounds or corresponding path constraints, (m,).

    Controls that are always at such path constraints are included; see `find_linear_path_constraints`.
    """
    bounds, limits = samples.leg.control_bounds, find_linear_path_constraints(samples)
    bounded = np.isfinite(bounds.lower) & np.isfinite(bounds.upper)
    linear = _mask_linear_controls(samples)
    for i in limits.rows:
        bounded[i], linear[i] = all(limits.has_path_bounds(i)), True
    return linear & bounded


def mask_nonconvex_controls(samples: PhaseSamples) -> Mask:
    """Return which controls with two finite bounds have H neither linear nor convex along the phase, (m,).

    If H is minimal at a bound, they switch between bounds like controls that are linear in H.
    """
    bounds = samples.leg.control_bounds
    bounded = np.isfinite(bounds.lower) & np.isfinite(bounds.upper)
    return np.asarray(bounded & ~_mask_linear_controls(samples) & ~mask_convex_controls(samples))


def find_linear_path_constraints(samples: PhaseSamples) -> LinearPathLimits:
    """Return the path constraints that limit a single control, one linear in H or always at its limits.

    Example of the latter: the load factor in a turn at maximum lift, whatever the curvature of H.
    """
    linear = _mask_linear_controls(samples)
    bent = LinearPathLimits.from_samples(samples, ~linear & ~mask_convex_controls(samples))
    for i in bent.rows:
        linear[i] = bent.is_always_at_limits(i)
    return LinearPathLimits.from_samples(samples, linear)


def _mask_linear_controls(samples: PhaseSamples) -> Mask:
    return np.asarray(np.max(np.abs(compute_hamiltonian_curvature(samples)), axis=1) < EQUAL)


def mask_regular_controls(samples: PhaseSamples) -> Mask:
    """Return for which controls H is strictly convex along the whole phase, (m,)."""
    return np.asarray(np.min(compute_hamiltonian_curvature(samples), axis=1, initial=np.inf) > CONVEX)


def mask_convex_controls(samples: PhaseSamples) -> Mask:
    """Return for which controls H is convex along the whole phase, and strictly convex at some times, (m,).

    If the square of a control affects a single state, H is linear while the costate of that state is zero (heat below
    its limit). If a control is coupled with others in H, such as thrust direction and magnitude, H has to be strictly
    convex along the whole phase: where it is not, the magnitude is zero and the direction may jump.
    """
    bends = compute_hamiltonian_curvature(samples)
    above, below = (np.maximum(sign * bends, 0.0) @ samples.weights for sign in (1.0, -1.0))
    at_times = np.any(bends > CONVEX, axis=1) & (below < NOTABLE * above)
    return np.asarray((at_times & ~_mask_coupled_controls(samples)) | mask_regular_controls(samples))


def _mask_coupled_controls(samples: PhaseSamples) -> Mask:
    """Return which controls have a mixed second derivative of H with another one, (m,)."""
    scale, mixed = samples.control_scale, np.max(np.abs(samples.control_hessian), axis=2, initial=0.0)
    shares = mixed * np.outer(scale, scale) / samples.hamiltonian_scale
    np.fill_diagonal(shares, 0.0)
    return np.asarray(np.any(shares > EQUAL, axis=1))


def compute_hamiltonian_curvature(samples: PhaseSamples) -> Array:
    """Return the second derivative of H in each control, scaled by its range and relative to H, (m, n_samples)."""
    scale = samples.control_scale
    return np.asarray(
        np.einsum("iij->ij", samples.control_hessian) * scale[:, None] ** 2 / samples.hamiltonian_scale
    )
