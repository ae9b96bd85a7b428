r"""Unique multipliers at simultaneous switches of several controls.

If several controls change at one time, not all from bound to bound, the multipliers are not unique. They become unique
if the controls are free in short intervals on both sides of the time; that program has a warm start.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.numerical_tolerances import ROUNDING
from gnc_opt.planning.direct.computation_budget import WorkBudget
from gnc_opt.planning.direct.fixed_mesh_solve import solve_problem_on_mesh
from gnc_opt.planning.nlp import SolverOptions
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind, Kinds
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.arcs.arc_mesh import ArcMesh
from gnc_opt.planning.refinement.arcs.control_structure import KindArray, PhaseStructure
from gnc_opt.planning.solution.costates import NlpIterate
from gnc_opt.planning.solution.initial_nlp_point import choose_initial_nlp_point
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_from_nlp_result import build_phase_solutions
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.transcription import transcribe_problem

FREE_SPAN = 3e-6
"""Length of the intervals, relative to the phase; in shorter ones, multipliers are dominated by rounding."""

FREE_SPAN_POINTS = 2
"""Collocation points of each interval."""

FREE_SPANS_MIN = 10.0
"""Shortest piece with space for an interval, in interval lengths."""


def find_simultaneous_switches(structure: PhaseStructure) -> tuple[int, ...]:
    """Return the boundaries at which several controls change, with sufficiently long adjacent pieces."""
    least = FREE_SPANS_MIN * FREE_SPAN * (structure.times[-1] - structure.times[0])
    return tuple(
        k
        for k in range(1, structure.n_pieces)
        if sum(row < structure.n_controls for row in structure.find_changed_arcs(k)) > 1
        and not structure.has_only_kinks(k)
        and not structure.touches[k]
        and min(structure.piece_lengths[k - 1 : k + 1]) > least
    )


def solve_with_split_switches(
    solution: Solution, plans: Mapping[str, ArcMesh], options: SolverOptions, budget: WorkBudget
) -> Solution | None:
    """Return a solution with the multipliers of the program with split switches; None if that has no solution."""
    freed = solution.need_problem("refine")
    meshes = {}
    for name, plan in plans.items():
        freed, meshes[name] = _free_split_intervals(plan, freed, name)
    sharper = replace(options, tolerance=min(ROUNDING, options.tolerance))
    found = solve_problem_on_mesh(freed, meshes, guess=solution, options=sharper, budget=budget)
    return _transfer_split_multipliers(solution, found, plans) if found.status.solved else None


def _transfer_split_multipliers(
    solution: Solution, other: Solution, plans: Mapping[str, ArcMesh]
) -> Solution:
    held = solution.need_problem("refine")
    for name, plan in plans.items():
        held = plan.fix_arcs_in_problem(held, name)
    transcription = transcribe_problem(
        held, {name: plan.build_mesh() for name, plan in plans.items()}, solution.scheme
    )
    own, others = (choose_initial_nlp_point(transcription, held, s) for s in (solution, other))
    assert others.lam_x is not None and others.lam_g is not None, "a solution has multipliers"
    iterate = NlpIterate(own.x, others.lam_x, others.lam_g)
    phases, _ = build_phase_solutions(transcription, held, iterate)
    return replace(
        solution,
        phases=phases,
        parameter_multipliers=iterate.lam_x[transcription.parameter_places],
        constraint_multipliers=iterate.lam_g[transcription.constraint_rows],
    )


def _free_split_intervals(plan: ArcMesh, problem: Problem, name: str) -> tuple[Problem, Mesh]:
    """Return the problem with the arcs of a plan, free in the intervals at shared boundaries, and its mesh."""
    problem = plan.fix_arcs_in_problem(problem, name)
    cuts, mesh, held = _SplitMesh.from_plan(plan), plan.build_mesh(), problem.phases[name].numbers.arcs
    assert held is not None, "just held"
    twin = problem.with_fixed_arcs(
        name,
        arcs=cuts.expand_arc_kinds(held.controls),
        paths=cuts.expand_arc_kinds(held.paths) if held.paths else None,
        states=cuts.expand_arc_kinds(held.states) if held.states else None,
        smooth=tuple(
            replace(s, first=cuts.get_first_split_segment(s.first), last=cuts.get_end_split_segment(s.last))
            for s in held.smooth
        ),
        junctions=tuple(
            replace(j, boundary=cuts.map_segment_to_split_mesh(j.boundary)) for j in held.junctions
        ),
    )
    return twin, cuts.build_mesh(mesh)


@dataclass(frozen=True)
class _SplitMesh:
    """Segments of a mesh, and boundaries with an interval on either side."""

    segments: int
    boundaries: tuple[int, ...]

    @classmethod
    def from_plan(cls, plan: ArcMesh) -> _SplitMesh:
        ends = plan.piece_boundary_breaks
        return cls(ends[-1], tuple(ends[k] for k in find_simultaneous_switches(plan.structure)))

    def map_segment_to_split_mesh(self, old: int) -> int:
        return old + 2 * sum(b < old for b in self.boundaries) + (old in self.boundaries)

    def get_first_split_segment(self, old: int) -> int:
        """Return the first new segment, after the interval, of an old segment."""
        return self.map_segment_to_split_mesh(old) + (old in self.boundaries)

    def get_end_split_segment(self, old: int) -> int:
        """Return the end (exclusive) of the new segments, before the interval, of the old segments up to ``old``."""
        return self.map_segment_to_split_mesh(old) - (old in self.boundaries)

    def expand_arc_kinds(self, rows: Kinds) -> KindArray:
        """Return the kinds by rows and new segments; rows that change at a boundary are free in its intervals."""
        return np.array([self._expand_arc_kinds_of_row(row) for row in rows], dtype=object)

    def _expand_arc_kinds_of_row(self, row: tuple[ArcKind, ...]) -> list[ArcKind]:
        found: list[ArcKind] = []
        for k, kind in enumerate(row):
            if k in self.boundaries:
                same = row[k - 1] is kind
                found += [kind if same else ArcKind.INTERIOR] * 2
            found.append(kind)
        return found

    def build_mesh(self, old: Mesh) -> Mesh:
        """Return the mesh with the intervals; shared boundaries are fixed."""
        breaks, degrees = [0.0], []
        for k, (end, degree) in enumerate(zip(old.breaks[1:], old.degrees, strict=True)):
            if k in self.boundaries:
                breaks.append(old.breaks[k] + FREE_SPAN)
                degrees.append(FREE_SPAN_POINTS)
            degrees.append(degree)
            if k + 1 in self.boundaries:
                breaks.append(end - FREE_SPAN)
                degrees.append(FREE_SPAN_POINTS)
            breaks.append(end)
        movable = tuple(self.map_segment_to_split_mesh(k) for k in old.movable if k not in self.boundaries)
        return Mesh(tuple(breaks), tuple(degrees), movable)
