r"""Directions of vectors that vanish: nothing depends on them, they do not vary, and a push begins where it pays.

With a magnitude s and a direction n, :math:`H = H_0 + s\,(c + \sigma \cdot n)`. Where s = 0 any n will do; a push
would begin along :math:`-\sigma`, and the switching function of s is :math:`c - |\sigma|` (Lawden's primer vector,
Optimal Trajectories for Space Navigation, 1963), whatever the direction that was stored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gnc_opt.arrays import Array, Indices
from gnc_opt.model.composed import VectorControl
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.tolerances import AT_LIMIT
from gnc_opt.verify.critical_cone import CriticalCone

SURELY = 0.99
"""A collocation point between samples that are idle by this share is so itself."""


def lone_vector(s: PhaseSamples, group: Indices) -> VectorControl | None:
    """Return the vector control that a group consists of, if H is affine in it and only its length is limited."""
    layout = s.leg.controls
    for vector in s.leg.composed_controls:
        if not isinstance(vector, VectorControl):
            continue
        places = [np.arange(layout.size)[layout.slice(part)] for part in vector.parts]
        if not np.array_equal(np.sort(np.concatenate(places)), group):
            continue
        bends = s.functions.functions["switching"].jac_sparsity(0, 2)
        limited = s.functions.functions["paths"].jac_sparsity(0, 2)
        curved = {(i, j) for i, j in zip(bends.row(), bends.get_col(), strict=True) if i in group}
        across = {(int(i), int(j)) for i in places[0] for j in places[1]}
        rows = {
            s.leg.path_labels[i] for i, j in zip(limited.row(), limited.get_col(), strict=True) if j in group
        }
        if curved <= across | {(j, i) for i, j in across} and rows == {vector.length}:
            return vector
    return None


def aimed_gradient(s: PhaseSamples, times: Array, x: Array, u: Array, lam: Array, mu: Array) -> Array:
    """Return d(H + mu.c)/du (m, n_times), by a magnitude that is zero as if its direction were the best."""
    gradient = s.functions.control_gradient(times, x, u, lam, mu)
    for vector in filter(None, (lone_vector(s, group) for group in s.functions.coupled_controls)):
        magnitude, direction = (s.leg.controls.slice(part) for part in vector.parts)
        at = np.flatnonzero(u[magnitude][0] <= AT_LIMIT * s.control_scale[magnitude][0])
        if not at.size:
            continue
        pushing = u[:, at].copy()
        pushing[magnitude] = 1.0
        sigma = s.functions.switching(times[at], x[:, at], pushing, lam[:, at])[direction]
        along = np.sum(sigma * pushing[direction], axis=0)
        gradient[magnitude, at] -= along + np.linalg.norm(sigma, axis=0)
    return gradient


def without_idle_directions(cone: CriticalCone, samples: Sequence[PhaseSamples]) -> CriticalCone:
    """Return the cone with directions held where their magnitude is: the length of what is held is no row of it.

    Angles that do nothing while another control is held are held, too.
    """
    strong = cone.strong.copy()
    for s in samples:
        collocation = cone.point.transcription.parts[s.leg.name].collocation
        places, times = (
            collocation.point_controls,
            s.leg.initial_time + s.leg.duration * collocation.fractions,
        )
        for i in np.flatnonzero(np.any(s.idle, axis=1)):
            alone = np.interp(times, s.times, s.idle[i]) > SURELY
            strong[places[i, alone & np.any(cone.strong[places], axis=0)]] = True
        for vector in s.leg.composed_controls:
            if not isinstance(vector, VectorControl):
                continue
            magnitude, direction = (
                collocation.point_controls[s.leg.controls.slice(part)] for part in vector.parts
            )
            size = cone.point.x[magnitude[0]] * cone.point.scaling.variables[magnitude[0]]
            scale = s.control_scale[s.leg.controls.slice(vector.magnitude)][0]
            idle = strong[magnitude[0]] & (size <= AT_LIMIT * scale)
            length = collocation.path_rows[s.leg.path_labels.index(vector.length)]
            strong[direction[:, idle]] = True
            strong[cone.point.x.size + length[idle]] = False
    return replace(cone, strong=strong)
