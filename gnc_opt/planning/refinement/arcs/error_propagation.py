r"""Errors along arcs on path constraints without controls, and where they come from.

Held at the n Gauss points of a segment, such a constraint says nothing of the segment's ends: what the state polynomial
is off across the limit at the start, a multiple of the Legendre polynomial :math:`P_n`, comes back at the end with the
sign :math:`(-1)^n`, and neither shorter segments nor more points there make it smaller. (The stability function of a
Gauss method has the modulus 1 at infinity; Hairer, Lubich & Roche, The Numerical Solution of Differential-Algebraic
Systems by Runge-Kutta Methods, 1989.) The error of one segment is so that of all behind it: they are not to be made
finer, but it.

What a segment leaves out itself shows in how far its Legendre coefficients have fallen before they rise again to that
of :math:`P_n`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from gnc_opt.arrays import Array, Mask
from gnc_opt.planning.problem.arcs import ArcKind
from gnc_opt.planning.refinement.arcs.structure import PhaseStructure
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.tolerances import TINY

SLOWEST = 0.1
"""Decades per point that are expected at least."""


def on_carrying_arcs(structure: PhaseStructure) -> Mask:
    """Return which pieces are on a path constraint without controls, (A,)."""
    first, last = len(structure.controls), len(structure.controls) + len(structure.paths)
    orders = np.array(structure.orders[first:last], dtype=int)[:, None]
    held = (structure.paths == ArcKind.LOWER) | (structure.paths == ArcKind.UPPER)
    return np.asarray(np.any(held & (orders > 0), axis=0))


@dataclass(frozen=True)
class Decay:
    """How the Legendre coefficients of the states fall in every segment, in shares of what these move.

    Attributes
    ----------
    left : array (K,)
        The smallest ones, by pairs of neighbours.
    rates : array (K,)
        Decades by which a point more makes them smaller.
    """

    left: Array
    rates: Array

    @classmethod
    def of(cls, samples: PhaseSamples) -> Decay:
        """Return that of a solution."""
        found = [_decay(samples, k) for k in range(samples.leg.mesh.segments)]
        return cls(np.array([left for left, _ in found]), np.array([rate for _, rate in found]))

    def own_errors(self, carrying: Mask, errors: Array) -> Array:
        """Return what segments are to blame for: along arcs that carry errors on, their share of the largest one.

        Parameters
        ----------
        carrying : bool array (K,)
            Which segments are on such arcs.
        errors : array (K,)
            Between their points.
        """
        if not np.any(carrying):
            return errors
        shares = self.left / max(float(np.max(self.left[carrying])), TINY)
        return np.where(carrying, shares * np.max(errors[carrying]), errors)


def _decay(samples: PhaseSamples, k: int) -> tuple[float, float]:
    leg = samples.leg
    nodes, values = leg.x.nodes[k], leg.x.values[k] / samples.state_scale[:, None]
    coefficients = np.linalg.solve(legendre.legvander(nodes, nodes.size - 1), values.T)
    sizes = np.maximum(np.max(np.abs(coefficients), axis=1), TINY)
    pairs = np.maximum(sizes[1:], sizes[:-1])
    lowest = int(np.argmin(pairs))
    rate = np.log10(pairs[0] / pairs[lowest]) / lowest if lowest else SLOWEST
    return float(pairs[lowest]), float(max(rate, SLOWEST))
