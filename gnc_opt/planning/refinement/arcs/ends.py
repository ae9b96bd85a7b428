r"""Path constraints at the ends of a phase, for which a mesh of Gauss points has no row.

Where the cost wants a constraint :math:`c(t, x) \le 0` to leave its limit at an end of a phase, because another phase
begins there or the cost counts that state, a mesh without a point at the end lets it: beyond the last point the limit
binds nothing. An arc that begins with the phase needs the constraint on its limit at that end: nothing else keeps its
first segment from oscillating about it.
"""

from __future__ import annotations

import numpy as np

from gnc_opt.arrays import Mask
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.refinement.arcs.structure import PhaseStructure
from gnc_opt.planning.solution.samples import PhaseSamples


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
