"""Where arcs on path constraints begin: held there as along the arc, which a program's rows do not say.

In the critical cone the variation of a path constraint without controls vanishes along an arc on which it pushes, and
by continuity where the arc begins. A program of Gauss collocation has rows at its points only, and leaves a segment
one variation that vanishes at all of them, the Legendre polynomial: which leads beyond the limit between the points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from gnc_opt.arrays import Mask
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.transcription.numbering import PhasePart
from gnc_opt.verify.atoms import path_gradients_at_boundaries
from gnc_opt.verify.critical_cone import CriticalCone


def held_from_their_start(cone: CriticalCone, samples: Sequence[PhaseSamples]) -> CriticalCone:
    """Return the cone with its path constraints held where their arcs begin, too."""
    point = cone.point
    found = []
    for s in samples:
        part = point.transcription.parts[s.leg.name]
        rows, starts = np.nonzero(_begins(cone, s, part))
        if not rows.size:
            continue
        breaks = np.interp(part.collocation.mesh.breaks, s.leg.mesh.breaks, s.leg.breaks)
        at = breaks, s.leg.x(breaks), s.leg.flown(breaks)
        places, gradients = path_gradients_at_boundaries(point.transcription, part, s.functions, at)
        values = gradients[:, rows, starts] * point.scaling.variables[places[:, starts]]
        lines = np.tile(np.arange(rows.size), places.shape[0])
        shape = rows.size, point.x.size
        found.append(
            scipy.sparse.csc_array((values.ravel(), (lines, places[:, starts].ravel())), shape=shape)
        )
    return replace(cone, further=scipy.sparse.vstack(found, format="csc")) if found else cone


def _begins(cone: CriticalCone, s: PhaseSamples, part: PhasePart) -> Mask:
    """At which boundaries (n_paths, K) an arc begins: held at all points of the segment, and not of the one before."""
    collocation = part.collocation
    held = cone.strong[cone.point.x.size :][collocation.path_rows]
    along = np.zeros((collocation.n_paths, collocation.mesh.segments + 1), dtype=bool)
    for row in s.pure_paths:
        along[row, 1:] = np.logical_and.reduceat(held[row], collocation.mesh.offsets[:-1])
    return np.asarray(along[:, 1:] & ~along[:, :-1])
