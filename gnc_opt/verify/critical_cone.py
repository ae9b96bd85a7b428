"""The variations of a solution that its active limits leave free, on its mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gnc_opt.arrays import Array, Indices, Mask
from gnc_opt.solution.phase_solution import piecewise
from gnc_opt.solution.polynomial import PiecewisePolynomial
from gnc_opt.solution.program_point import WEAK, ProgramLimits, ProgramPoint
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.tolerances import AT_LIMIT, TINY
from gnc_opt.transcription.collocation import PhaseCollocation
from gnc_opt.transcription.numbering import PhasePart

BEYOND = 1e-2
"""A variation beyond an active limit by more than this share of its own largest leaves it."""


@dataclass(frozen=True, eq=False)
class CriticalCone:
    """The variations of a point that are free to first order.

    Attributes
    ----------
    point : ProgramPoint
    strong, weak : bool array (n_variables + n_constraints,)
        Variables and rows that are held, and those at a limit that does not push: they may leave it to one side.
    unit : sparse (n_variables, n_variations) or None
        Scaled variables per variation of size 1, if it is not one for each (module `goh`).
    further : sparse (n, n_variables) or None
        What is held beside rows of the program (module `arc_starts`).
    """

    point: ProgramPoint
    strong: Mask
    weak: Mask
    unit: Any = None
    further: Any = None

    @classmethod
    def of(cls, point: ProgramPoint) -> CriticalCone:
        """Tell from the gradient of the Lagrangian which limits push.

        Along an arc on a limit the variation of what is limited vanishes, by continuity at the arc's ends too: a
        node at the limit is held where it shares a segment with one that is pushed there. The push of a control comes
        to zero at the ends of its arcs, which move with the times; on its nodes next to them it may be as small as any.
        """
        strong, weak = [], []
        for limits, values, multipliers, lines in (
            (point.variables, point.x, point.multiplier_densities[0], _variable_lines(point)),
            (point.rows, point.values, point.multiplier_densities[1], _path_lines(point)),
        ):
            told = ProgramLimits.of(limits.box, values, multipliers, limits.labels)
            doubtful = told.weak(values, multipliers)
            held = told.active & ~doubtful
            _close_arcs(lines, values, held & ~limits.box.fixed, held, doubtful)
            strong.append(held)
            weak.append(doubtful)
        return cls(point, np.concatenate(strong), np.concatenate(weak))

    def admits(self, direction: Array, samples: list[PhaseSamples]) -> bool:
        """Whether a direction stays within the limits: weakly active ones at the nodes, active ones between them."""
        point = self.point
        changes = np.concatenate([direction, point.jacobian @ direction])[self.weak]
        values = np.concatenate([point.x, point.values])[self.weak]
        lower, upper = (
            np.concatenate([getattr(limits.box, side) for limits in (point.variables, point.rows)])[self.weak]
            for side in ("lower", "upper")
        )
        outwards = np.where(values - lower < upper - values, -changes, changes)
        between = [self._outwards_between(s, direction) for s in samples]
        return bool(np.all(np.concatenate([outwards, *between]) <= BEYOND))

    def _outwards_between(self, s: PhaseSamples, direction: Array) -> Array:
        """How far a direction leads states and path constraints beyond active limits, in shares of its largest."""
        part = self.point.transcription.parts[s.leg.name]
        change = direction * self.point.scaling.variables
        breaks = np.interp(part.collocation.mesh.breaks, s.leg.mesh.breaks, s.leg.breaks)
        dx = s.sample(_through_nodes(breaks, part.collocation, change))
        rules = part.collocation.rules
        du = s.sample(piecewise(breaks, rules, change[part.collocation.point_controls]))
        by_state = s.functions.path_state_jacobian(s.times, s.x, s.u)
        by_control = s.functions.path_control_jacobian(s.times, s.x, s.u)
        dc = np.einsum("ijk,jk->ik", by_state, dx) + np.einsum("ijk,jk->ik", by_control, du)
        paths = s.functions.paths(s.times, s.x, s.u)
        worst = []
        for values, changes, box, scale in (
            (s.x, dx, s.leg.state_bounds, s.state_scale),
            (paths, dc, s.leg.path_bounds, s.path_scale),
        ):
            at_lower, at_upper = box.near(values, AT_LIMIT * scale)
            free = ~box.fixed[:, None]
            beyond = np.where(at_upper & free, changes, 0.0) - np.where(at_lower & free, changes, 0.0)
            largest = np.maximum(np.max(np.abs(changes), axis=1, initial=0.0), TINY)
            worst.append(np.max(beyond, axis=1, initial=0.0) / largest)
        return np.concatenate(worst)


def _variable_lines(point: ProgramPoint) -> list[Indices]:
    """Variables of each state along each segment, start and end included, and of each control at its points."""
    parts: list[PhasePart] = list(point.transcription.parts.values())
    return [
        row
        for part in parts
        for k in range(part.collocation.mesh.segments)
        for row in (
            *_nodes(part.collocation, k),
            *_at_points(part.collocation, part.collocation.point_controls, k),
        )
    ]


def _path_lines(point: ProgramPoint) -> list[Indices]:
    """Rows of each path constraint along each segment."""
    parts: list[PhasePart] = list(point.transcription.parts.values())
    return [
        row
        for part in parts
        for k in range(part.collocation.mesh.segments)
        for row in _at_points(part.collocation, part.collocation.path_rows, k)
    ]


def _close_arcs(lines: list[Indices], values: Array, pushed: Mask, held: Mask, doubtful: Mask) -> None:
    """Hold, in place, what is at the same limit as a pushed node of its line."""
    for line in lines:
        if not (np.any(pushed[line]) and np.any(doubtful[line])):
            continue
        limits = values[line[pushed[line]]]
        same = np.any(np.abs(values[line][:, None] - limits) <= 2 * WEAK, axis=1) & doubtful[line]
        held[line[same]], doubtful[line[same]] = True, False


def _at_points(collocation: PhaseCollocation, places: Indices, k: int) -> Indices:
    """Those of all places (n, n_points) that lie in a segment."""
    return np.asarray(places[:, collocation.mesh.offsets[k] : collocation.mesh.offsets[k + 1]])


def _nodes(collocation: PhaseCollocation, k: int) -> Indices:
    """Variables of the states at the start, the points and the end of a segment, each once (n_states, nodes)."""
    points = _at_points(collocation, collocation.point_states, k)
    start, end = collocation.boundary_states[:, [k]], collocation.boundary_states[:, [k + 1]]
    family = collocation.family
    middle = points[:, int(family.starts_at_point) : points.shape[1] - int(family.ends_at_point)]
    return np.asarray(np.hstack([start, middle, end]))


def _through_nodes(breaks: Array, collocation: PhaseCollocation, change: Array) -> PiecewisePolynomial:
    """Return the polynomials through the varied states at the start, the points and the end of each segment."""
    values = tuple(change[_nodes(collocation, k)] for k in range(collocation.mesh.segments))
    nodes = tuple(np.union1d(rule.points, [-1.0, 1.0]) for rule in collocation.rules)
    return PiecewisePolynomial(breaks, nodes, values)
