r"""Contacts of a trajectory with state constraints: detection and correction of arcs on limits and touches.

Let S(t, x) <= 0 have order q (`gnc_opt.planning.problem.state_constraint_order`), and H be strictly convex in the
controls in :math:`S^{(q)}`. The control is then continuous at both ends of an arc on the limit (Jacobson, Lele &
Speyer, J. Math. Anal. Appl. 35, 1971; Hartl, Sethi & Vickson, SIAM Review 37(2), 1995), and :math:`S^{(q)}` goes to
zero, with a kink, from the side of the interior arc. As with the kinks of module `arc_junctions`, the cost hardly
depends on time. The entry time is therefore fixed during a solve, in which the constraint is released next to the
arc; it then moves to the zero of :math:`S^{(q)}` along the interior arc. Since states and costates have second-order
errors only, this iteration converges quadratically.

A control linear in H jumps at both ends of an arc on the limit (McDanell & Powers, SIAM J. Control 9(2), 1971). The
times of such an arc are variables, like switching times; the arc begins with :math:`S = \dots = S^{(q-1)} = 0`. If all
controls in :math:`S^{(q)}` are on limits of their own, there are touches only.

The time of a touch, of order two or more, is a variable: with :math:`S = \dot S = 0` there, the cost has a strict
minimum at the time at which the multiplier of :math:`\dot S = 0` vanishes, so that the costate jumps along
:math:`\partial S/\partial x` only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.numerical_tolerances import MINOR, NEGLIGIBLE
from gnc_opt.planning.optimality.state_constraint_derivatives import StateConstraints
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.arcs.arc_mesh import ArcMesh
from gnc_opt.planning.refinement.arcs.control_structure import PhaseStructure
from gnc_opt.planning.refinement.arcs.state_constraint_contact_detection import (
    CONTACT_MIN_NODES,
    ContactNodes,
    find_contact_nodes,
)
from gnc_opt.planning.solution.defects_and_violations import compute_segment_defects
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples

BETWEEN_BOUNDS_MIN_SHARE = 0.05
"""Least distance of the mean of a control from its bounds, relative to its range, between the bounds."""


# --- controls that are determined -------------------------------------------------------------------------------


@dataclass(frozen=True)
class ArcControl:
    """A control between its bounds, from ``start`` to ``end`` (s), because it holds a state constraint on its limit.

    The constraint is a row of `StateConstraints`, the limit a kind.
    """

    control: int
    start: float
    end: float
    row: int = -1
    kind: ArcKind = ArcKind.INTERIOR


def find_constraint_arc_controls(problem: Problem, samples: PhaseSamples) -> list[ArcControl]:
    """Return the controls that keep state constraints on their limits.

    On a mesh, such a control oscillates about the value that satisfies the constraint, and its switching function about
    zero. The detection therefore uses means of both and the multiplier of the constraint.
    """
    constraints, leg = StateConstraints(problem, samples), samples.leg
    points, u = leg.point_times, np.hstack(leg.u.values)
    found = []
    rows = [row for row in range(constraints.n_rows) if constraints.get_contact_order(row)]
    for run in find_contact_nodes(constraints, rows):
        held = np.flatnonzero(run.scaled_multipliers > 0)
        start, end = run.times[held[[0, -1]]]
        inside = (points >= start) & (points <= end)
        if held.size < CONTACT_MIN_NODES or np.sum(inside) < CONTACT_MIN_NODES:
            continue
        mean = np.mean(u[:, inside], axis=1)
        at_lower, at_upper = leg.control_bounds.is_near_limits(
            mean, BETWEEN_BOUNDS_MIN_SHARE * samples.control_scale
        )
        found += [
            ArcControl(i, float(start), float(end), run.row, run.kind)
            for i, _ in constraints.rank_control_effects(run.row)
            if not at_lower[i] and not at_upper[i]
        ]
    return found


# --- detection on a mesh --------------------------------------------------------------------------------------


def add_contacts(structure: PhaseStructure, problem: Problem, samples: PhaseSamples) -> PhaseStructure:
    """Return the structure with the contacts that multipliers and constraint values of a mesh show.

    A first-order constraint with a multiplier has an arc on its limit; one of second order has an arc if the contact is
    longer than a segment, otherwise a touch. A third-order constraint has touches only, since arcs of odd order beyond
    the first have no simple junctions (Jacobson, Lele & Speyer, 1971).
    """
    constraints, first = StateConstraints(problem, samples), structure.n_controls
    held = [
        any(kinds[first + row].is_at_limit for kinds in structure.kinds) for row in range(constraints.n_rows)
    ]
    orders = [0 if held[row] else constraints.get_contact_order(row) for row in range(constraints.n_rows)]
    asked = [
        bool(order) or (on and constraints.get_contact_order(k) == 1)
        for k, (order, on) in enumerate(zip(orders, held, strict=True))
    ]
    known = structure.effects[first:]
    effects = [constraints.rank_control_effects(row) if ask else known[row] for row, ask in enumerate(asked)]
    structure = replace(
        structure, orders=(*(0,) * first, *orders), effects=(*structure.effects[:first], *effects)
    )
    for run in _find_new_contact_nodes(constraints, structure) if any(orders) else ():
        structure = run.add_contacts(structure, samples)
    return structure


def _find_new_contact_nodes(constraints: StateConstraints, structure: PhaseStructure) -> list[ContactNodes]:
    first, found = structure.n_controls, []
    for run in find_contact_nodes(constraints, np.flatnonzero(structure.orders[first:])):
        scaled_multipliers = np.where(
            structure.is_at_limit(first + run.row, run.times), 0.0, run.scaled_multipliers
        )
        if np.any(scaled_multipliers > 0):
            found.append(replace(run, row=first + run.row, scaled_multipliers=scaled_multipliers))
    return [run for run in found if not run.is_touch_at_phase_end(structure, constraints.samples)]


# --- corrections ----------------------------------------------------------------------------------------------


def add_missing_contact(constraints: StateConstraints, plan: ArcMesh) -> tuple[PhaseStructure | None, str]:
    """Return the structure with a contact at the largest missing multiplier and the action, or None."""
    s, structure = constraints.samples, plan.structure
    runs = _find_new_contact_nodes(constraints, structure)
    for run in sorted(runs, key=lambda r: float(np.max(r.scaled_multipliers)), reverse=True):
        added = run.add_contacts(structure, s)
        if added != structure:
            at = run.times[int(np.argmax(run.scaled_multipliers))]
            label = (*s.leg.path_labels, *s.leg.states.labels)[run.row - structure.n_controls]
            return added, f"active limit of {label} added at {s.describe_times(at)}"
    return None, ""


def replace_saturated_controls(
    constraints: StateConstraints, plan: ArcMesh
) -> tuple[PhaseStructure | None, str]:
    """Return the structure in which other controls keep a constraint on its limit and the action, or None.

    If a control that is linear in H reaches its bound while it keeps a limit, H is continuous only if regular controls
    keep the limit afterwards, for the short time in which the costate of the control's effect changes. Otherwise, the
    control leaves its bound before the end of the arc. The dynamics must be accurate.
    """
    samples, structure = constraints.samples, plan.structure
    if np.max(compute_segment_defects(samples)) > MINOR:
        return None, ""
    bounds, pieces = samples.leg.control_bounds, plan.segment_piece_indices[samples.segments]
    for boundary in range(1, structure.n_pieces):
        taken = structure.find_state_limit_change(boundary)
        if not taken:
            continue
        state, row = taken
        after = structure.kinds[boundary][state].is_at_limit
        piece, kind = boundary - 1 + after, structure.kinds[boundary - after][row]
        if len(structure.boundary_controls[state]) < 2 or structure.kinds[piece][row] is not ArcKind.SINGULAR:
            continue
        towards = np.flatnonzero(pieces == piece)[:: -1 if after else 1]
        limit, times = bounds.get_limit(kind.sign)[row], samples.times[towards]
        beyond = kind.sign * (samples.u_polynomial[row, towards] - limit) / samples.control_scale[row]
        within = np.flatnonzero(beyond <= 0)
        if beyond[-1] > NEGLIGIBLE and within.size:
            last = slice(within[-1], within[-1] + 2)
            ends = sorted((float(np.interp(0.0, beyond[last], times[last])), structure.times[boundary]))
            label = samples.leg.controls.labels[row]
            return structure.with_arc(
                row, ends[0], ends[1], kind
            ), f"{label} at its bound from {samples.describe_times(ends[0])}"
    return None, ""
