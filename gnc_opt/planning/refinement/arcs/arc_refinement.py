"""Refinement of pieces whose solution does not satisfy dynamics or adjoint equations between the nodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind
from gnc_opt.planning.refinement.arcs.arc_mesh import ArcMesh, PieceMesh
from gnc_opt.planning.solution.defects_and_violations import compute_segment_defects
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.tolerances import EQUAL, MINOR, TINY


def refine_arc_mesh_by_residuals(samples: PhaseSamples, plan: ArcMesh, tol: float) -> ArcMesh | None:
    """Return the plan with finer pieces where dynamics or adjoint equations are violated, or None."""
    errors = compute_segment_defects(samples)
    residual = np.abs(samples.adjoint_residual(samples.u_polynomial, samples.mu))
    worth = samples.state_scale[:, None] / samples.cost_scale
    # Multipliers along a state constraint contain differences of rounding errors that grow on finer pieces.
    contact = np.array([plan.structure.has_constraint_contact(k) for k in range(plan.structure.n_pieces)])
    residual = np.where(contact[plan.segment_piece_indices], 0.0, samples.segment_integrals(residual))
    per_segment = np.maximum(np.max(errors, axis=0), np.max(residual * worth, axis=0))
    by_piece = np.split(per_segment, plan.piece_boundary_breaks[1:-1])
    wanted = tuple(
        choose_finer_piece_mesh(r, errors, gradient, tol)
        for r, errors, gradient in zip(
            plan.resolutions, by_piece, compute_singular_arc_gradients(samples, plan), strict=True
        )
    )
    return replace(plan, resolutions=wanted) if wanted != plan.resolutions else None


def choose_finer_piece_mesh(r: PieceMesh, errors: Array, gradient: float, tol: float) -> PieceMesh:
    """Return the resolution with more points or a higher control degree, whichever has the larger error.

    ``errors`` (segments,) are those of states and costates in every segment of the piece.
    """
    smoother = r.raise_control_degree(gradient) if gradient > EQUAL else r
    if smoother != r and gradient > max(float(np.max(errors)), MINOR):
        return smoother
    if np.all(errors <= tol):
        return smoother
    return r.refine_for_error_decades(np.log10(np.clip(np.nan_to_num(errors, nan=np.inf), TINY, 1.0) / tol))


def compute_singular_arc_gradients(samples: PhaseSamples, plan: ArcMesh) -> Array:
    """Return the largest |dH/du| of singular controls in every piece (A,), relative to H."""
    kinds = plan.structure.control_arc_kinds[:, plan.segment_piece_indices[samples.segments]]
    gain = np.abs(samples.control_gradient) * samples.control_scale[:, None] / samples.hamiltonian_scale
    per_sample = np.max(np.where(kinds == ArcKind.SINGULAR, gain, 0.0), axis=0, initial=0.0)
    worst = np.zeros(plan.structure.n_pieces)
    np.maximum.at(worst, plan.segment_piece_indices[samples.segments], per_sample)
    return worst
