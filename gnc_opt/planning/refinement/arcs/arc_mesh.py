"""Mesh of a control structure: subarcs, their segments and degrees, fixed and movable boundaries."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.array_types import Array, Indices
from gnc_opt.numerical_tolerances import NOTABLE
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind, Junction, SmoothControl
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.arcs.control_structure import PhaseStructure, select_kind
from gnc_opt.planning.transcription.mesh import Mesh

FIRST_DEGREE, ARC_MAX_DEGREE = 6, 12
"""First number of collocation points of a subarc, and largest number in one segment."""

SINGULAR_DEGREE, MAX_SINGULAR_DEGREE = 4, 28
"""Initial and largest degree of the polynomial of a control over a singular subarc."""

DEGREE_GAIN_RATIO = 0.3
"""Largest ratio of dH/du after and before a useful rise of the degree of a singular control."""

INTERIOR_DEGREE, INTERIOR_SEGMENTS = 9, 8
"""First degree of an interior subarc, and number of segments of one that is the whole phase."""

ARC_MAX_SEGMENTS = 64
"""Largest number of segments of a subarc."""

STEPS_PER_SEGMENT = 4
"""Number of integration steps per segment of `ARC_MAX_DEGREE` points. Over 6 steps of order 8, a polynomial can be less
accurate than the steps, and another pass follows."""

ADDED_POINTS_MIN = 3
"""Least number of points that are added; each one of a smooth subarc reduces the error by a decade."""


@dataclass(frozen=True)
class SubarcMesh:
    """Segments of a subarc and their collocation degree.

    ``smooth`` is the degree of the polynomials of singular controls over the whole subarc (0: no polynomials),
    ``gradient`` the largest dH/du with the previous one; ``edges`` are inner segment boundaries as fractions of the
    subarc (empty: segments of equal length).
    """

    segments: int = 1
    degree: int = FIRST_DEGREE
    smooth: int = 0
    gradient: float = np.inf
    edges: tuple[float, ...] = ()

    @property
    def segment_boundaries(self) -> Array:
        """Segment boundaries as fractions of the subarc: (segments + 1,) from 0 to 1."""
        if self.edges:
            return np.array([0.0, *self.edges, 1.0])
        return np.linspace(0.0, 1.0, self.segments + 1)

    def refine_to_reduce_errors(self, decades: Array) -> SubarcMesh:
        """Return a mesh that reduces the errors by decades (segments,); the finest one is returned unchanged.

        Points are added first. At `ARC_MAX_DEGREE` points, the segments with the largest positive decades are halved;
        with a polynomial control all are.
        """
        largest = float(np.max(decades))
        if largest <= 0:
            return self
        if self.degree < ARC_MAX_DEGREE:
            added_points = ADDED_POINTS_MIN if self.smooth else max(ADDED_POINTS_MIN, math.ceil(largest))
            return replace(self, degree=min(self.degree + added_points, ARC_MAX_DEGREE))
        halved = np.flatnonzero((decades > 0) | (self.smooth > 0))
        return self._halve_segments(halved[np.argsort(-decades[halved], kind="stable")])

    def _halve_segments(self, candidates: Indices) -> SubarcMesh:
        """Return the mesh with halved segments, in the given order, up to `ARC_MAX_SEGMENTS` segments."""
        halved = candidates[: max(0, ARC_MAX_SEGMENTS - self.segments)]
        if not halved.size:
            return self
        boundaries, count = self.segment_boundaries, self.segments + halved.size
        if count == 2 * self.segments and not self.edges:
            return replace(self, segments=count)
        middles = 0.5 * (boundaries[halved] + boundaries[halved + 1])
        edges = tuple(map(float, np.sort(np.append(boundaries[1:-1], middles))))
        return replace(self, segments=count, edges=edges)

    def raise_control_degree(self, gradient: float) -> SubarcMesh:
        """Return the mesh with a higher degree of singular controls, and enough points for it and the states.

        It is unchanged if the last higher degree hardly reduced dH/du: the rest is rounding, or the control is not
        smooth.
        """
        if self.smooth == 0 or gradient > DEGREE_GAIN_RATIO * self.gradient:
            return self
        new_degree = min(self.smooth + 4, MAX_SINGULAR_DEGREE)
        degree = min(self.degree + ADDED_POINTS_MIN, ARC_MAX_DEGREE)
        raised = replace(self, smooth=new_degree, degree=degree, gradient=gradient)
        n_segments = math.ceil(2 * new_degree / degree)
        return raised if n_segments <= self.segments else replace(raised, segments=n_segments, edges=())


@dataclass(frozen=True)
class ArcMesh:
    """Structure of one phase, and one `SubarcMesh` per subarc.

    With ``loose``, state constraints are also released next to their touch points, so that the interior-point barrier
    does not affect the solution there; without limits, a structure that lacks a contact may have no solution.
    """

    structure: PhaseStructure
    subarc_meshes: tuple[SubarcMesh, ...]
    loose: bool = False

    @classmethod
    def from_structure(cls, structure: PhaseStructure) -> ArcMesh:
        """Return the mesh with the coarsest subarcs."""
        subarcs = range(structure.n_subarcs)
        return cls(structure, tuple(_choose_coarse_subarc_mesh(structure, k) for k in subarcs))

    @classmethod
    def from_integration_steps(cls, structure: PhaseStructure, times: Array) -> ArcMesh:
        """Return a mesh with segments of the highest degree, each over few of the integration steps ``times`` (s)."""
        steps = np.histogram(times[:-1], structure.times)[0]
        segments = np.clip(np.rint(steps / STEPS_PER_SEGMENT), 1, ARC_MAX_SEGMENTS)
        return cls(structure, tuple(SubarcMesh(int(n), ARC_MAX_DEGREE) for n in segments))

    @classmethod
    def from_refined_mesh(cls, structure: PhaseStructure, mesh: Mesh) -> ArcMesh:
        """Return the segments of a refined mesh, or few segments if its breaks do not match the structure."""
        coarse = cls.from_structure(structure)
        times = np.asarray(structure.times)
        boundaries, breaks = (times - times[0]) / (times[-1] - times[0]), np.asarray(mesh.breaks)
        indices = np.argmin(np.abs(breaks[:, None] - boundaries), axis=0)
        if np.any(np.diff(indices) < 1) or np.max(np.abs(breaks[indices] - boundaries)) > NOTABLE:
            return coarse
        # Times of the samples and of the mesh differ.
        new_times = times[0] + breaks[indices] * (times[-1] - times[0])
        subarcs = zip(itertools.pairwise(map(int, indices)), coarse.subarc_meshes, strict=True)
        return replace(
            coarse,
            structure=structure.with_switch_times(tuple(map(float, new_times))),
            subarc_meshes=tuple(_read_subarc_mesh(mesh, *subarc, first) for subarc, first in subarcs),
        )

    def replace_control_structure(self, structure: PhaseStructure) -> ArcMesh:
        """Return the coarsest mesh of another structure."""
        return replace(ArcMesh.from_structure(structure), loose=self.loose)

    @property
    def segment_subarc_indices(self) -> Indices:
        """Subarc of every segment (K,)."""
        return np.repeat(np.arange(self.structure.n_subarcs), [r.segments for r in self.subarc_meshes])

    @property
    def subarc_boundary_breaks(self) -> tuple[int, ...]:
        """Indices of the mesh breaks between subarcs, including both ends; A + 1 of them."""
        return (0, *(int(n) for n in np.cumsum([r.segments for r in self.subarc_meshes])))

    def build_mesh(self) -> Mesh:
        """Return the mesh, with movable breaks between subarcs except at kinks, which are fixed."""
        times = [self.structure.times[0]]
        degrees: list[int] = []
        for k, subarc_mesh in enumerate(self.subarc_meshes):
            left, right = self.structure.times[k], self.structure.times[k + 1]
            times += [left + (right - left) * float(share) for share in subarc_mesh.segment_boundaries[1:]]
            degrees += [subarc_mesh.degree] * subarc_mesh.segments
        fractions = (np.asarray(times) - times[0]) / (times[-1] - times[0])
        boundary_breaks, s = self.subarc_boundary_breaks, self.structure
        movable = tuple(boundary_breaks[k] for k in range(1, s.n_subarcs) if not s.has_only_control_kinks(k))
        return Mesh(tuple(fractions), tuple(degrees), movable)

    def fix_arcs_in_problem(self, problem: Problem, phase: str) -> Problem:
        """Return the problem with controls, path constraints and states fixed according to the structure."""
        structure, segments = self.structure, self.segment_subarc_indices
        kinds = structure.arc_kind_matrix()
        kinds = select_kind(kinds == ArcKind.SINGULAR, ArcKind.INTERIOR, kinds)
        # Released rows: interior regular controls are unbounded, as their excess shows where the arc has to end.
        released = structure.mask_constraints_near_contacts(self.loose)
        released |= structure.mask_rows_near_limit_changes()
        released |= np.asarray(structure.regular, dtype=bool)[:, None]
        kinds = select_kind(released & (kinds == ArcKind.INTERIOR), ArcKind.RELEASED, kinds)[:, segments]
        n_controls = structure.n_controls
        control_kinds, path_kinds, state_kinds = np.split(kinds, [n_controls, n_controls + structure.n_paths])
        return problem.with_fixed_arcs(
            phase,
            arcs=control_kinds,
            paths=path_kinds if path_kinds.size else None,
            states=state_kinds if np.any(state_kinds != ArcKind.INTERIOR) else None,
            smooth=self._define_control_polynomials(),
            junctions=self._list_state_constraint_junctions(),
        )

    def _list_state_constraint_junctions(self) -> tuple[Junction, ...]:
        """Return the entries and touch points of state constraints that determine a control.

        Inside the phase, a touch requires S = dS/dt = 0; at its ends S = 0, which Gauss points do not impose.
        """
        structure, n_controls = self.structure, self.structure.n_controls
        junctions: list[tuple[int, int, ArcKind, int, int]] = []
        for k in range(1, structure.n_subarcs):
            control_limit_rows = structure.find_state_to_control_limit_change(k)[:1]
            for i in structure.find_changed_arcs(k):
                before, after, order = structure.kinds[k - 1][i], structure.kinds[k][i], structure.orders[i]
                if after.is_at_limit and (order or i in control_limit_rows):
                    junctions.append((k, i, after, order, -1 if i in control_limit_rows else 0))
                elif i in control_limit_rows:
                    junctions.append((k, i, before, 0, 1))
            junctions += [(k, i, kind, 2, 0) for i, kind in structure.touches[k]]
            paths = [i for i in structure.find_control_limit_replacement(k) if i >= n_controls]
            for i in paths[:1]:
                before, after = structure.kinds[k - 1][i], structure.kinds[k][i]
                junctions.append((k, i, after, 0, -1) if after.is_at_limit else (k, i, before, 0, 1))
        junctions += [(k, i, kind, 1, 0) for k in (0, -1) for i, kind in structure.touches[k]]
        return tuple(
            Junction(i - n_controls, self.subarc_boundary_breaks[k], kind, conditions, tangent)
            for k, i, kind, conditions, tangent in junctions
        )

    def _define_control_polynomials(self) -> tuple[SmoothControl, ...]:
        polynomials, breaks = [], self.subarc_boundary_breaks
        for i, row in enumerate(self.structure.control_arc_kinds):
            for k in np.flatnonzero(row == ArcKind.SINGULAR):
                subarc_mesh = self.subarc_meshes[k]
                if (
                    i not in self.structure.find_controls_fixed_by_limits(int(k))
                    and subarc_mesh.smooth
                    and subarc_mesh.smooth < subarc_mesh.segments * subarc_mesh.degree - 1
                ):
                    polynomials.append(SmoothControl(i, breaks[k], breaks[k + 1], subarc_mesh.smooth))
        return tuple(polynomials)


def _read_subarc_mesh(mesh: Mesh, first: int, last: int, coarsest: SubarcMesh) -> SubarcMesh:
    """Return the segments of a mesh between two breaks, with the highest control degree that their points allow."""
    breaks, degree = np.asarray(mesh.breaks[first : last + 1]), max(mesh.degrees[first:last])
    edges = (breaks[1:-1] - breaks[0]) / (breaks[-1] - breaks[0])
    smooth = min(max(coarsest.smooth, (last - first) * degree // 2), MAX_SINGULAR_DEGREE)
    return SubarcMesh(last - first, degree, smooth if coarsest.smooth else 0, edges=tuple(map(float, edges)))


def _choose_coarse_subarc_mesh(structure: PhaseStructure, subarc: int) -> SubarcMesh:
    kinds, share = structure.kinds[subarc], structure.subarc_lengths[subarc] / structure.subarc_lengths.sum()
    singular = {i for i, kind in enumerate(kinds) if kind is ArcKind.SINGULAR}
    if singular - structure.find_controls_fixed_by_limits(subarc):
        return SubarcMesh(2, FIRST_DEGREE, SINGULAR_DEGREE)
    if ArcKind.INTERIOR in structure.control_arc_kinds[:, subarc]:
        degree = FIRST_DEGREE if structure.has_constraint_contact(subarc) else INTERIOR_DEGREE
        return SubarcMesh(int(np.ceil(INTERIOR_SEGMENTS * share)), degree)
    return SubarcMesh()
