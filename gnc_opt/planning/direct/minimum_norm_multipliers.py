r"""Multipliers where conditions depend on each other: those of least norm.

If some combination of equality constraints is satisfied by every motion of the variables, :math:`J_F^T r = 0`, any
multiple of r may be added to the multipliers. Examples: all four components of a quaternion prescribed at its end; a
state on an arc of its limit, which follows from an arc of another limit. An interior-point method leaves the multiple
where its iterates drifted, which may be so far out that no digit of the costates is left.

The result has the least :math:`|\lambda_x + J_A^T r|^2 + \epsilon |\lambda - r|^2`: a limit that another one implies
(A: states on arcs) has no multiplier, and what is left open then is as small as possible. The least-squares problem is
solved by its augmented system (Bjorck, Numerical Methods for Least Squares Problems, 1996, sec. 1.1.5). Inequalities
and bounds keep their multipliers; those of fixed variables take what the rows give up, so that stationarity stays.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from gnc_opt.arrays import Array, Mask
from gnc_opt.planning.nlp import NlpPoint, NlpResult
from gnc_opt.planning.optimality.nlp_point import to_scipy_sparse
from gnc_opt.planning.transcription.transcription import Transcription
from gnc_opt.tolerances import NEGLIGIBLE

NULL_SPACE_MIN_SHARE = 0.5
"""Least share of the largest multiplier that the part in the null space has if that has drifted."""

REGULARISATION = 1e-13
"""Regularisation of the least-squares problem, whose matrix has rows of size 1."""

NULL_RESIDUAL = 1e-10
"""A null vector's largest residual, in shares of its largest component."""


def minimum_norm_multipliers(transcription: Transcription, point: NlpPoint, result: NlpResult) -> NlpResult:
    """Return a result without what dependent equality constraints leave open in its multipliers."""
    largest = np.max(np.abs(result.lam_g), initial=0.0)
    if not 0.0 < largest < np.inf:
        return result
    rows, fixed = np.equal(point.lbg, point.ubg), np.equal(point.lbx, point.ubx)
    jacobian = to_scipy_sparse(transcription.nlp.jac_g(result.x, point.p)[1]).tocsr()[rows].tocsc()
    along = fixed & _mask_phase_states(transcription)
    r = _null_space_part(jacobian[:, ~fixed], jacobian[:, along], result.lam_g[rows], result.lam_x[along])
    left = jacobian.T @ r
    if np.max(np.abs(r)) < NULL_SPACE_MIN_SHARE * largest or np.max(
        np.abs(left[~fixed])
    ) > NULL_RESIDUAL * np.max(np.abs(r)):
        return result
    lam_g, lam_x = result.lam_g.copy(), result.lam_x.copy()
    lam_g[rows] -= r
    lam_x[fixed] += left[fixed]
    return replace(result, lam_g=lam_g, lam_x=lam_x)


def _mask_phase_states(transcription: Transcription) -> Mask:
    """Which variables are states within a phase (n_variables,): fixed ones are on an arc of their limit."""
    found: Mask = np.zeros(transcription.n_variables, dtype=bool)
    for part in transcription.parts.values():
        found[part.collocation.point_states] = True
        found[part.collocation.boundary_states[:, 1:-1]] = True
        found[part.collocation.boundary_states[:, [0, -1]]] = False
    return found


def _null_space_part(free: Any, along: Any, rows: Array, limits: Array) -> Array:
    """Return the part r of the multipliers of rows (m,) that the variables ``free`` (m, n) leave open."""
    m, n = free.shape
    weight = NEGLIGIBLE * scipy.sparse.eye_array(m) + along @ along.T
    system = scipy.sparse.block_array(
        [[weight, free], [free.T, -REGULARISATION * scipy.sparse.eye_array(n)]], format="csc"
    )
    wanted = np.concatenate([NEGLIGIBLE * rows - along @ limits, np.zeros(n)])
    factors = scipy.sparse.linalg.splu(system)
    found = factors.solve(wanted)
    return np.asarray((found + factors.solve(wanted - system @ found))[:m])
