r"""Path constraints at the ends of a phase, for which a mesh of Gauss points has no row.

Where the cost wants a constraint :math:`c(t, x) \le 0` to leave its limit at an end of a phase, because another phase
begins there or the cost counts that state, a mesh without a point at the end lets it: beyond the last point the limit
binds nothing. Along an arc on the limit all segments take part in that, each in the opposite sense of its neighbour,
and what they show is no arc any more. With the constraint on its limit at that end they show it. An arc that begins
with the phase needs that, too: nothing else keeps its first segment from that wave.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.arrays import Mask
from gnc_opt.planning.direct.solve_mesh import SolveLimits, solve_mesh
from gnc_opt.planning.nlp import SolverOptions
from gnc_opt.planning.problem.arcs import ArcKind, Junction
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.refinement.arcs.structure import PhaseStructure
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.tolerances import AT_LIMIT


def with_ends_met(
    solution: Solution, *, options: SolverOptions | None = None, limits: SolveLimits | None = None
) -> Solution | None:
    """Return the solution on its mesh with path constraints on their limits where they break them at ends of phases.

    Constraints in which controls appear are left alone: those are no affair of the end alone.

    Parameters
    ----------
    solution : Solution
        Of a problem in which no arcs are held.
    options : SolverOptions, optional
    limits : SolveLimits, optional
        When to give up.

    Returns
    -------
    Solution or None
        None if nothing is broken at an end. It may not be solved.
    """
    problem = stated = solution.need_problem("refine")
    for name, s in solution.samples().items():
        found = _broken_ends(s)
        if found:
            free = np.zeros((s.leg.controls.size, s.leg.mesh.segments), dtype=int)
            problem = problem.with_arcs(name, arcs=free, junctions=found)
    if problem is stated:
        return None
    met = solve_mesh(
        problem, scheme=solution.scheme, guess=solution, options=options, limits=limits or SolveLimits()
    )
    return replace(met, problem=stated)


def _broken_ends(s: PhaseSamples) -> tuple[Junction, ...]:
    """Where path constraints without controls are beyond a limit at an end of the phase."""
    found = []
    for at, boundary in ((0, 0), (-1, s.leg.mesh.segments)):
        values = s.functions.paths(s.times[at], s.x[:, at], s.u[:, at])
        near, box = AT_LIMIT * s.path_scale, s.leg.path_bounds
        for row in s.pure_paths:
            if values[row] > box.upper[row] + near[row]:
                found.append(Junction(int(row), boundary, ArcKind.UPPER, 1))
            elif values[row] < box.lower[row] - near[row]:
                found.append(Junction(int(row), boundary, ArcKind.LOWER, 1))
    return tuple(found)


def with_starts_on_limits(structure: PhaseStructure, leg: Phase, samples: PhaseSamples) -> PhaseStructure:
    """Return the structure with path constraints of first order touched at the start of the phase, too, if held there.

    The points of an arc leave the state at its start free. Within the phase a junction puts it on the limit; at the
    start given states do, and limits of the phase before.
    """
    first = len(structure.controls)
    for row in range(first, first + structure.n_paths):
        kind = structure.kinds[0][row]
        if kind.at_limit and structure.orders[row] == 1 and not structure.touches[0]:
            slope = samples.functions.path_state_jacobian(samples.times[0], samples.x[:, 0], samples.u[:, 0])
            if np.any(slope[row - first] * samples.state_scale * _begin_freely(leg, samples)):
                structure = structure.with_touch(row, structure.times[0], kind)
    return structure


def _begin_freely(leg: Phase, samples: PhaseSamples) -> Mask:
    """Return which states are neither given at the start nor handed over by a phase with path constraints (n,)."""
    found: Mask = ~samples.leg.initial_bounds.fixed
    for name in leg.model.states.names:
        before = leg.handed_over(name)
        if before is not None and before[0].path_labels:
            found[leg.model.states.slice(name)] = False
    return found
