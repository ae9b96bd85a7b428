r"""Minimum-norm multipliers for dependent constraints.

If a combination of equality constraints is satisfied by every change of the variables, :math:`J_F^T r = 0`, any
multiple of r may be added to the multipliers. Examples: all four components of a quaternion fixed at the end; a state
on an active arc that is implied by another active arc. An interior-point method may return so large a multiple that the
costates lose all digits.

The result minimises :math:`|\lambda_x + J_A^T r|^2 + \epsilon |\lambda - r|^2` (A: states on arcs): a limit implied by
another one has no multiplier, and the remaining null-space part has minimum norm. The least-squares problem is solved
by its augmented system (Bjorck, Numerical Methods for Least Squares Problems, 1996, sec. 1.1.5). Multipliers of
inequalities and bounds do not change; those of fixed variables are adapted to preserve stationarity.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import EQUAL, NEGLIGIBLE, ROUNDING, max_norm
from gnc_opt.planning.nlp import NlpPoint, NlpResult
from gnc_opt.planning.nlp.partially_separable_nlp import convert_casadi_to_scipy
from gnc_opt.planning.transcription.transcription import Transcription

NULL_SPACE_MIN_SHARE = 0.5
"""Smallest null-space part, as a share of the largest multiplier, that is removed."""


def minimise_multiplier_norm(transcription: Transcription, point: NlpPoint, result: NlpResult) -> NlpResult:
    """Return a result without the null-space part of the multipliers of dependent equality constraints."""
    largest = max_norm(result.lam_g)
    if not 0.0 < largest < np.inf:
        return result
    rows, fixed = np.equal(point.lbg, point.ubg), np.equal(point.lbx, point.ubx)
    jacobian = convert_casadi_to_scipy(transcription.nlp.jac_g(result.x, point.p)[1]).tocsr()[rows].tocsc()
    on_arcs = fixed & transcription.mask_interior_states()  # those on active arcs
    multipliers = result.lam_g[rows], result.lam_x[on_arcs]
    r = _project_to_null_space(jacobian[:, ~fixed], jacobian[:, on_arcs], *multipliers)
    change = jacobian.T @ r
    size = np.max(np.abs(r))
    if size < NULL_SPACE_MIN_SHARE * largest or np.max(np.abs(change[~fixed])) > EQUAL * size:
        return result
    lam_g, lam_x = result.lam_g.copy(), result.lam_x.copy()
    lam_g[rows] -= r
    lam_x[fixed] += change[fixed]
    return replace(result, lam_g=lam_g, lam_x=lam_x)


def _project_to_null_space(free: Any, along: Any, rows: Array, limits: Array) -> Array:
    """Return the part r of the row multipliers (m,) that the variables ``free`` (m, n) do not determine."""
    m, n = free.shape
    weight = NEGLIGIBLE * scipy.sparse.eye_array(m) + along @ along.T
    blocks = [[weight, free], [free.T, -ROUNDING * scipy.sparse.eye_array(n)]]
    system = scipy.sparse.block_array(blocks, format="csc")
    right = np.concatenate([NEGLIGIBLE * rows - along @ limits, np.zeros(n)])
    factors = scipy.sparse.linalg.splu(system)
    solution = factors.solve(right)
    return np.asarray((solution + factors.solve(right - system @ solution))[:m])
