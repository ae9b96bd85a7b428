r"""Costates along arcs on which a path constraint without controls is held.

At the end of such an arc the measure of the constraint may have an atom. A programme of Gauss collocation holds the
constraint at the points, and has no row at the end that could bear the atom, since it would say once more what those
of the points say. There the atom is spread over the points' multipliers, which oscillate, while the costates at the
points, which come from the rows of the dynamics, are those of the continuous problem. So they are what is kept:

* the one-sided costates at both ends of the segment continue the points, as far as the gradient of the constraint
  can explain the difference, which is then part of the jump there;
* the density of the multiplier is what the adjoint equation leaves for it, along that gradient.

For bounds of states `gnc_opt.solution.covector` does the same from the rows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.arrays import Array, Mask
from gnc_opt.problem.functions import PhaseFunctions
from gnc_opt.problem.held import Held
from gnc_opt.solution.phase_solution import PhaseSolution
from gnc_opt.solution.polynomial import PiecewisePolynomial, Side
from gnc_opt.transcription.quadrature import interpolation_matrix
from gnc_opt.transcription.scheme import GAUSS

SIDES: tuple[Side, Side] = ("right", "left")
"""From which side the start and the end of a segment belong to it."""


def settle_held_paths(leg: PhaseSolution, held: Held | None, functions: PhaseFunctions) -> PhaseSolution:
    """Return the solution of a phase with the costates and multipliers of what is held along its segments."""
    if held is None or not held.paths or leg.scheme != GAUSS:
        return leg
    at_limit = (
        np.array([[kind.at_limit for kind in row] for row in held.paths]) & ~functions.mixed_paths[:, None]
    )
    if not np.any(at_limit):
        return leg
    start, end, values = leg.lam_start.copy(), leg.lam_end.copy(), [v.copy() for v in leg.lam.values]
    for k in np.flatnonzero(np.any(at_limit, axis=0)):
        rows, here = np.flatnonzero(at_limit[:, k]), slice(leg.mesh.offsets[k], leg.mesh.offsets[k + 1])
        continued = leg.point_costates[:, here] @ interpolation_matrix(leg.rules[k].points, [-1.0, 1.0]).T
        for ends, column in ((start, 0), (end, 1)):
            time, side = leg.breaks[k + column], SIDES[column]
            gradients = functions.path_state_jacobian(time, leg.x(time, side), leg.u(time, side))[rows].T
            ends[:, k] += gradients @ _fit(gradients, continued[:, column] - ends[:, k])
        values[k][:, -1] = end[:, k]
    lam = PiecewisePolynomial(leg.breaks, leg.lam.nodes, tuple(values))
    multipliers = _with_densities(leg, lam, functions, np.repeat(at_limit, leg.mesh.degrees, axis=1))
    return replace(leg, lam=lam, lam_start=start, lam_end=end, path_multipliers=multipliers)


def _with_densities(
    leg: PhaseSolution, lam: PiecewisePolynomial, functions: PhaseFunctions, at_limit: Mask
) -> Array:
    """The multipliers of path constraints, where they are at their limits what the adjoint equation leaves for them.

    ``at_limit`` and the result (n_paths, N).
    """
    mu = leg.path_multipliers.copy()
    here = np.flatnonzero(np.any(at_limit, axis=0))
    times, others = leg.point_times[here], np.where(at_limit, 0.0, mu)[:, here]
    x, u = leg.x(times), leg.u(times)
    left = -lam.derivative()(times) - functions.state_gradient(times, x, u, lam(times), others)
    gradients = functions.path_state_jacobian(times, x, u)
    for j, point in enumerate(here):
        rows = np.flatnonzero(at_limit[:, point])
        mu[rows, point] = _fit(gradients[rows, :, j].T, left[:, j])
    return mu


def _fit(directions: Array, vector: Array) -> Array:
    """Least-squares coefficients of a vector (n,) by directions (n, n_rows)."""
    return np.asarray(np.linalg.lstsq(directions, vector, rcond=None)[0])
