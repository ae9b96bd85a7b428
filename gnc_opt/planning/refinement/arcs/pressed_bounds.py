"""Interior arcs whose control stays at a bound, where H is least all along."""

from __future__ import annotations

import numpy as np

from gnc_opt.planning.problem.arcs import ArcKind
from gnc_opt.planning.refinement.arcs.arc_mesh import Plan
from gnc_opt.planning.refinement.arcs.structure import PhaseStructure
from gnc_opt.planning.solution.samples import PhaseSamples

PRESSED = 1e-6
"""First-order gain in H, in shares of H, that a bound keeps from being had: less may be the solver's rounding."""

WEAK = 0.1
"""Share of the largest of these below which the barrier may keep the control off its bound."""

NEAR = 1e-3
"""Shares of a control's range up to which the barrier keeps it off its bound where H presses it there."""


def unpinned(
    samples: PhaseSamples, plan: Plan, left: set[tuple[str, PhaseStructure]]
) -> tuple[PhaseStructure | None, str]:
    """Return the structure with such an arc on its bound and what was done, or None if there is none.

    An arc between one on a bound and the end of the phase keeps such a place however its ends are moved: the nodes keep
    the control within its bounds, and what is solved is another problem only by the noise that the barrier leaves.
    Structures that have been left are not tried again: an arc that was just added may be on its bound at first.
    """
    structure, pieces = plan.structure, plan.segment_pieces[samples.segments]
    gain = samples.control_gradient * samples.control_scale[:, None] / samples.hamiltonian_scale
    at_lower, at_upper = samples.leg.control_bounds.near(samples.u_polynomial, NEAR * samples.control_scale)
    interior = (structure.controls == ArcKind.INTERIOR) & ~structure.limited_by_paths()
    for i, piece in np.argwhere(interior):
        if i in structure.determined(piece):
            continue
        pull = np.where(pieces == piece, gain[i], 0.0)
        strong = np.abs(pull) > max(PRESSED, WEAK * np.max(np.abs(pull)))
        for at_bound, side, kind in ((at_lower[i], 1.0, ArcKind.LOWER), (at_upper[i], -1.0, ArcKind.UPPER)):
            if np.any(strong) and np.all((at_bound & (side * pull > 0))[strong]):
                begin, end = structure.times[piece : piece + 2]
                other, label = structure.with_arc(i, begin, end, kind), samples.leg.controls.labels[i]
                if (samples.leg.name, other.at(())) not in left:
                    return other, f"{label} on its bound from {begin:.4g} s"
    return None, ""
