"""Curvature of the Hamiltonian in each control: linear, convex or neither."""

from __future__ import annotations

import numpy as np

from gnc_opt.arrays import Array, Mask
from gnc_opt.planning.refinement.arcs.mixed_constraints import LinearLimits
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.tolerances import CONVEX, EQUAL, NOTABLE

SINGULAR_SHARE_OF_H = 2e-2
"""A switching function this small over whole segments, in shares of H, marks a singular arc."""


def affine_controls(samples: PhaseSamples) -> Mask:
    """Return which controls enter H linearly and have two finite bounds, or path constraints in their place, (m,).

    Or are pressed to their ends: `linear_path_limits`.
    """
    bounds, limits = samples.leg.control_bounds, linear_path_limits(samples)
    bounded = np.isfinite(bounds.lower) & np.isfinite(bounds.upper)
    linear = _linear_controls(samples)
    for i in limits.rows:
        bounded[i], linear[i] = all(limits.has_path_bounds(i)), True
    return linear & bounded


def nonconvex_controls(samples: PhaseSamples) -> Mask:
    """Return in which controls between two finite bounds H is neither linear nor convex along the phase, (m,).

    Where H is least at a bound they jump from one to the other, as those do that it is linear in.
    """
    bounds = samples.leg.control_bounds
    bounded = np.isfinite(bounds.lower) & np.isfinite(bounds.upper)
    return np.asarray(bounded & ~_linear_controls(samples) & ~convex_controls(samples))


def linear_path_limits(samples: PhaseSamples) -> LinearLimits:
    """Return the path constraints that limit one control each that enters H linearly, or is pressed to its ends.

    A turn at the most lift, or the largest load factor, has no use for less of it, however H may bend.
    """
    linear = _linear_controls(samples)
    bent = LinearLimits.from_samples(samples, ~linear & ~convex_controls(samples))
    for i in bent.rows:
        linear[i] = bent.stays_at_limits(i)
    return LinearLimits.from_samples(samples, linear)


def _linear_controls(samples: PhaseSamples) -> Mask:
    return np.asarray(np.max(np.abs(hamiltonian_curvature(samples)), axis=1, initial=0.0) < EQUAL)


def regular_controls(samples: PhaseSamples) -> Mask:
    """Return in which controls H is strictly convex all along the phase, (m,)."""
    return np.asarray(np.min(hamiltonian_curvature(samples), axis=1, initial=np.inf) > CONVEX)


def convex_controls(samples: PhaseSamples) -> Mask:
    """Return in which controls H is convex all along the phase, and strictly at times, (m,).

    It is linear in a control whose square moves a state alone, where the costate of that state is zero: heat, beyond
    its limit. A control that is coupled with others in H, as the direction of a thrust is with its magnitude, has to be
    strictly convex all along: where it is not, its value is zero, and it may jump.
    """
    bends = hamiltonian_curvature(samples)
    above, below = (np.maximum(sign * bends, 0.0) @ samples.weights for sign in (1.0, -1.0))
    at_times = np.any(bends > CONVEX, axis=1) & (below < NOTABLE * above)
    return np.asarray((at_times & ~_coupled_controls(samples)) | regular_controls(samples))


def _coupled_controls(samples: PhaseSamples) -> Mask:
    """Return which controls have a second derivative of H with another one, (m,)."""
    scale, mixed = samples.control_scale, np.max(np.abs(samples.control_hessian), axis=2, initial=0.0)
    shares = mixed * np.outer(scale, scale) / samples.hamiltonian_scale
    np.fill_diagonal(shares, 0.0)
    return np.asarray(np.any(shares > EQUAL, axis=1))


def hamiltonian_curvature(samples: PhaseSamples) -> Array:
    """Second derivative of H in each control over its range, in shares of H, (m, n_samples)."""
    scale = samples.control_scale
    return np.asarray(
        np.einsum("iij->ij", samples.control_hessian) * scale[:, None] ** 2 / samples.hamiltonian_scale
    )
