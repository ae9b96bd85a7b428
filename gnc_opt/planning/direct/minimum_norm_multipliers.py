r"""Multipliers where conditions depend on each other: the least ones.

Where some combination of equality constraints is satisfied by every motion of the variables, :math:`J_F^T r = 0` (all
four components of a quaternion prescribed at its end, say), any multiple of r may be added to the multipliers. An
interior-point method leaves it where its iterates drifted, which may be so far out that no digit of the costates is
left. So what is kept is the solution of least norm, :math:`\lambda - r` with r the part of :math:`\lambda` in the null
space of :math:`J_F^T`: r is the residual of the least-squares problem :math:`\min_w |\lambda - J_F w|`, solved by its
augmented system (Bjorck, Numerical Methods for Least Squares Problems, 1996, sec. 1.1.5). Inequalities and bounds keep
their multipliers; those of fixed variables take what the rows give up, so that stationarity stays what it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from gnc_opt.arrays import Array
from gnc_opt.planning.nlp import NlpPoint, NlpResult
from gnc_opt.planning.optimality.program_point import as_sparse
from gnc_opt.planning.transcription.transcription import Transcription

LARGE_MULTIPLIER = 1e2
"""Scaled multipliers from which they may have drifted; most of well-scaled programs are smaller."""

NULL_SPACE_MIN_SHARE = 0.5
"""Least share of the largest multiplier that the part in the null space has if that has drifted."""

REGULARISATION = 1e-13
"""Regularisation of the least-squares problem, whose matrix has rows of size 1."""

NULL_RESIDUAL = 1e-10
"""A null vector's largest residual, in shares of its largest component."""


def minimum_norm_multipliers(transcription: Transcription, point: NlpPoint, result: NlpResult) -> NlpResult:
    """Return a result without what dependent equality constraints leave open in its multipliers."""
    largest = np.max(np.abs(result.lam_g), initial=0.0)
    if not LARGE_MULTIPLIER < largest < np.inf:
        return result
    rows, fixed = point.lbg == point.ubg, point.lbx == point.ubx
    jacobian = as_sparse(transcription.nlp.jac_g(result.x, point.p)[1]).tocsr()[rows].tocsc()
    r = _null_space_part(jacobian[:, ~fixed], result.lam_g[rows])
    left = jacobian.T @ r
    if np.max(np.abs(r)) < NULL_SPACE_MIN_SHARE * largest or np.max(
        np.abs(left[~fixed])
    ) > NULL_RESIDUAL * np.max(np.abs(r)):
        return result
    lam_g, lam_x = result.lam_g.copy(), result.lam_x.copy()
    lam_g[rows] -= r
    lam_x[fixed] += left[fixed]
    return replace(result, lam_g=lam_g, lam_x=lam_x)


def _null_space_part(matrix: scipy.sparse.csc_array, values: Array) -> Array:
    """Return the part of ``values`` (m,) that no combination of the columns of a matrix (m, n) has."""
    m, n = matrix.shape
    system = scipy.sparse.block_array(
        [[scipy.sparse.eye_array(m), matrix], [matrix.T, -REGULARISATION * scipy.sparse.eye_array(n)]],
        format="csc",
    )
    factors, wanted = scipy.sparse.linalg.splu(system), np.concatenate([values, np.zeros(n)])
    found = factors.solve(wanted)
    return np.asarray((found + factors.solve(wanted - system @ found))[:m])
