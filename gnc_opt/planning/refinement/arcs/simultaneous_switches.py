r"""Unique multipliers at simultaneous switches of several controls.

If several controls change at one time, not all from bound to bound, the multipliers are not unique. They become unique
if the controls are free in short intervals on both sides of the time; that program has a warm start.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gnc_opt.numerical_tolerances import ROUNDING
from gnc_opt.planning.direct.computation_budget import WorkBudget
from gnc_opt.planning.direct.fixed_mesh_solve import solve_problem_on_mesh
from gnc_opt.planning.nlp import SolverOptions
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind
from gnc_opt.planning.refinement.arcs.arc_mesh import ArcMesh, SubarcMesh
from gnc_opt.planning.refinement.arcs.control_structure import PhaseStructure
from gnc_opt.planning.solution.costates import NlpIterate
from gnc_opt.planning.solution.initial_nlp_point import choose_initial_nlp_point
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_from_nlp_result import build_phase_solutions
from gnc_opt.planning.transcription.transcription import transcribe_problem

FREE_SPAN = 3e-6
"""Length of the intervals, relative to the phase; in shorter ones, multipliers are dominated by rounding."""

FREE_SPAN_POINTS = 2
"""Collocation points of each interval."""

FREE_SPANS_MIN = 10.0
"""Shortest subarc with space for an interval, in interval lengths."""


def find_simultaneous_switches(structure: PhaseStructure) -> tuple[int, ...]:
    """Return the boundaries at which several controls change, with sufficiently long adjacent subarcs."""
    least = FREE_SPANS_MIN * FREE_SPAN * (structure.times[-1] - structure.times[0])
    return tuple(
        k
        for k in range(1, structure.n_subarcs)
        if sum(row < structure.n_controls for row in structure.find_changed_arcs(k)) > 1
        and not structure.has_only_kinks(k)
        and not structure.touches[k]
        and min(structure.subarc_lengths[k - 1 : k + 1]) > least
    )


def solve_with_split_switches(
    solution: Solution, plans: Mapping[str, ArcMesh], options: SolverOptions, budget: WorkBudget
) -> Solution | None:
    """Return a solution with the multipliers of the program with split switches; None if that has no solution."""
    freed, meshes = solution.need_problem("refine"), {}
    for name, plan in plans.items():
        split = split_shared_boundaries(plan)
        freed, mesh = split.fix_arcs_in_problem(freed, name), split.build_mesh()
        lengths = np.diff(mesh.breaks)  # the ends of the intervals are fixed
        movable = tuple(k for k in mesh.movable if min(lengths[k - 1 : k + 1]) > 2 * FREE_SPAN)
        meshes[name] = replace(mesh, movable=movable)
    sharper = replace(options, tolerance=min(ROUNDING, options.tolerance))
    found = solve_problem_on_mesh(freed, meshes, guess=solution, options=sharper, budget=budget)
    return _transfer_split_multipliers(solution, found, plans) if found.status.solved else None


def _transfer_split_multipliers(
    solution: Solution, other: Solution, plans: Mapping[str, ArcMesh]
) -> Solution:
    held = solution.need_problem("refine")
    for name, plan in plans.items():
        held = plan.fix_arcs_in_problem(held, name)
    meshes = {name: plan.build_mesh() for name, plan in plans.items()}
    transcription = transcribe_problem(held, meshes, solution.scheme)
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


def split_shared_boundaries(plan: ArcMesh) -> ArcMesh:
    """Return the plan with intervals before and after shared boundaries in which the changing rows are interior."""
    s = plan.structure
    shared, span = find_simultaneous_switches(s), FREE_SPAN * (s.times[-1] - s.times[0])
    times, kinds, resolutions = [s.times[0]], list[tuple[ArcKind, ...]](), list[SubarcMesh]()
    for k, (own, resolution) in enumerate(zip(s.kinds, plan.resolutions, strict=True)):
        begins, ends = k in shared, k + 1 in shared
        parts = [(s.times[k] + span, k)] if begins else []
        parts += [(s.times[k + 1] - span * ends, 0), (s.times[k + 1], k + 1)][: 1 + ends]
        for end, boundary in parts:
            changed = s.find_changed_arcs(boundary) if boundary else ()
            times.append(end)
            kinds.append(tuple(ArcKind.INTERIOR if i in changed else kind for i, kind in enumerate(own)))
            resolutions.append(SubarcMesh(1, FREE_SPAN_POINTS) if boundary else resolution)
    known = dict(zip(s.times, s.touches, strict=True))
    touches = tuple(known.get(t, ()) for t in times)
    structure = replace(s, times=tuple(times), kinds=tuple(kinds), touches=touches)
    return replace(plan, structure=structure, resolutions=tuple(resolutions))
