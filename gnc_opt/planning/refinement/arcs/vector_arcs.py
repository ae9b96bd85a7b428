r"""Vector controls of which only the product matters: arcs along which the whole vector is singular.

With :math:`T = s\,n`, where neither cost nor dynamics nor constraints know the norm but by T (least time, say), H is
least on the sphere :math:`|T| = T_{max}` wherever :math:`H_T` is not zero: a bang of the vector. Where it vanishes
along an arc, as it does in flight at a top speed, magnitude and direction are not unique, and the direction alone says
everything: the magnitude is kept at its limit, and the direction moves within the unit ball, each of its components
singular but for those that hold state constraints on their limits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.arrays import Array, Indices, Mask
from gnc_opt.model.composed_controls import VectorControl
from gnc_opt.planning.problem.arcs import ArcKind
from gnc_opt.planning.refinement.arcs.curvature import SINGULAR_SHARE_OF_H
from gnc_opt.planning.refinement.arcs.structure import KindArray, choose
from gnc_opt.planning.solution.polynomial import PiecewisePolynomial
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.tolerances import EQUAL

SINGULAR_MAX_NORM_SHARE = 0.95
"""A vector whose mean along a segment is longer than this share of its limit is no singular one."""


@dataclass(frozen=True, eq=False)
class ProductVector:
    """A vector control that is within a ball, and of which only the product of magnitude and direction matters.

    Attributes
    ----------
    vector : VectorControl
    magnitude : int
        Row of the magnitude among the controls.
    direction : int array (n,)
        Rows of the direction.
    length : int
        Row of the limit of the direction's length among the path constraints.
    most : float
        Upper limit of the norm.
    """

    vector: VectorControl
    magnitude: int
    direction: Indices
    length: int
    most: float

    def singular(self, s: PhaseSamples) -> Mask:
        """Return along which segments the vector is singular (K,); on a mesh it swings there, and so does H_T."""
        weights = np.concatenate([rule.weights for rule in s.leg.rules])
        u, times = np.hstack(s.leg.u.values), s.leg.point_times
        flown = u[self.magnitude] * u[self.direction]
        u[self.magnitude], u[self.direction] = self.most, 0.0
        pull = s.functions.switching(times, s.leg.x(times), u, s.leg.point_costates)[self.direction]
        means = [
            np.linalg.norm(np.add.reduceat(values * weights, s.leg.mesh.offsets[:-1], axis=1) / 2.0, axis=0)
            for values in (pull, flown)
        ]
        scale = np.ones(s.leg.mesh.segments) * s.hamiltonian_scale
        found = (means[0] < SINGULAR_SHARE_OF_H * scale) & (means[1] < SINGULAR_MAX_NORM_SHARE * self.most)
        beside = np.convolve(found, [1, 0, 1], "same") > 0
        return np.asarray(found & beside)


def product_vectors(s: PhaseSamples) -> Iterator[ProductVector]:
    """Yield the vector controls of which only the product matters, to H and to all path constraints."""
    leg, layout = s.leg, s.leg.controls
    vectors = [
        c for c in leg.composed_controls if isinstance(c, VectorControl) and c.length in leg.path_labels
    ]
    for vector in vectors:
        places = np.arange(layout.size)
        (magnitude,), direction = (
            places[layout.slice(vector.magnitude)],
            places[layout.slice(vector.direction)],
        )
        length = leg.path_labels.index(vector.length)
        box = leg.control_bounds
        within = leg.path_bounds.lower[length] < leg.path_bounds.upper[length]
        if not within or box.lower[magnitude] > 0 or not np.isfinite(box.upper[magnitude]):
            continue
        found = ProductVector(vector, int(magnitude), direction, length, float(box.upper[magnitude]))
        if _depends_on_product_only(s, found):
            yield found


def _depends_on_product_only(s: PhaseSamples, v: ProductVector) -> bool:
    """Whether s f_s = n . f_n for H and all path constraints but the length: a function of the product alone."""
    u = s.u.copy()
    u[v.magnitude] = 0.5 * v.most  # inconclusive at zero and for zero length
    u[v.direction] = np.array([0.6, *[0.8] * (v.direction.size - 1)])[:, None]
    slopes = s.functions.switching(s.times, s.x, u, s.lam)
    rows = s.functions.path_control_jacobian(s.times, s.x, u)
    others = np.delete(rows, v.length, axis=0)

    def differs(slope: Array) -> bool:
        by_size, by_direction = slope[v.magnitude] * u[v.magnitude], slope[v.direction] * u[v.direction]
        amount = np.abs(by_size) + np.sum(np.abs(by_direction), axis=0)
        return bool(np.any(np.abs(by_size - np.sum(by_direction, axis=0)) > EQUAL * amount))

    return not differs(slopes) and not any(differs(row) for row in others)


def label_vectors(s: PhaseSamples, rows: list[KindArray]) -> dict[int, tuple[int, ...]]:
    """Tell where vectors are singular: their magnitudes stay at the limit, their directions are singular there.

    Returns the rows of the directions, by the path constraint on their length.
    """
    found = {}
    for v in product_vectors(s):
        found[v.length] = tuple(int(i) for i in v.direction)
        singular = v.singular(s)[s.segments]
        rows[v.magnitude][:] = ArcKind.UPPER
        for i in v.direction:
            rows[i][:] = choose(singular, ArcKind.SINGULAR, ArcKind.INTERIOR)
    return found


def with_magnitudes_at_limits(solution: Solution) -> Solution:
    """Return the solution with the same vectors, the magnitudes at their limits wherever only the product matters."""
    for name, leg in solution.phases.items():
        if not any(isinstance(c, VectorControl) for c in leg.composed_controls):
            continue
        u, values = leg.u, [v.copy() for v in leg.u.values]
        for v in product_vectors(solution.samples()[name]):
            for here in values:
                here[v.direction] *= here[v.magnitude] / v.most
                here[v.magnitude] = v.most
        changed = replace(leg, u=PiecewisePolynomial(u.breaks, u.nodes, tuple(values)))
        solution = replace(solution, phases={**solution.phases, name: changed})
    return solution
