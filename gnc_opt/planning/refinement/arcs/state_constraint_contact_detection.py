r"""Contacts of a trajectory with state constraints: detection and correction of arcs on limits and touches.

Let S(t, x) <= 0 have order q (`gnc_opt.planning.problem.state_constraint_order`), and H be strictly convex in the
controls in :math:`S^{(q)}`. The control is then continuous at both ends of an arc on the limit (Jacobson, Lele &
Speyer, J. Math. Anal. Appl. 35, 1971; Hartl, Sethi & Vickson, SIAM Review 37(2), 1995), and :math:`S^{(q)}` goes to
zero, with a kink, from the side of the interior arc. As with the kinks of module `structure_update`, the entry time is
fixed during a solve, in which the constraint is released next to the arc; it then moves to the zero of :math:`S^{(q)}`
along the interior arc.

A control linear in H jumps at both ends of an arc on the limit (McDanell & Powers, SIAM J. Control 9(2), 1971). The
times of such an arc are variables, like switching times; the arc begins with :math:`S = \dots = S^{(q-1)} = 0`. If all
controls in :math:`S^{(q)}` are on limits of their own, there are touches only.

The time of a touch, of order two or more, is a variable: with :math:`S = \dot S = 0` there, the cost has a strict
minimum at the time at which the multiplier of :math:`\dot S = 0` vanishes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gnc_opt.array_types import Array, find_true_value_intervals
from gnc_opt.numerical_tolerances import ACTIVE, MINOR, NEGLIGIBLE, NOTABLE, SMALL
from gnc_opt.planning.optimality.active_state_constraints import StateConstraints
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.redundant_bounds import find_monotone_states
from gnc_opt.planning.refinement.arcs.arc_mesh import ArcMesh
from gnc_opt.planning.refinement.arcs.control_structure import Correction, PhaseStructure
from gnc_opt.planning.solution.defects_and_violations import compute_segment_defects
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples

SHORT_ARC_SEGMENTS = 2.0
"""Arcs shorter than this number of segments, and shifts of a time by less, may be errors of the mesh."""

TOUCH_MAX_NODES = 5
"""A contact of second order over at most this number of nodes is a touch at first."""

CONTACT_MIN_NODES = 3
"""Number of neighbouring nodes with positive multipliers for which a control keeps a constraint on its limit.

The same number of neighbouring nodes off a limit of higher order, with zero multipliers, separates two touches if it
includes all points of a segment. With fewer nodes this is uncertain: along an arc the multiplier may vanish, and a
polynomial on the limit at some of its points may oscillate between the others."""

BETWEEN_BOUNDS_MIN_SHARE = 0.05
"""Least distance of the mean of a control from its bounds, relative to its range, between the bounds."""


@dataclass(frozen=True, eq=False)
class ContactNodes:
    """Neighbouring nodes of a mesh near a limit of a row, some of them with a multiplier.

    ``scaled_multipliers`` are relative to the cost; zero if negligible.
    """

    row: int
    kind: ArcKind
    times: Array
    scaled_multipliers: Array

    def add_contact_arcs(self, structure: PhaseStructure, samples: PhaseSamples) -> PhaseStructure:
        """Return the structure with the arcs or touches that the multipliers of these nodes show."""
        active, order = self.scaled_multipliers > 0, structure.orders[self.row]
        nodes, (first, last) = np.flatnonzero(active), samples.phase.breaks[[0, -1]]
        touches = structure.list_touch_times(self.row, self.kind)
        nearby_touches = [t for t in touches if self.times[0] <= t <= self.times[-1]]
        is_long = nodes[-1] - nodes[0] >= TOUCH_MAX_NODES
        if order == 2 and (is_long or nearby_touches) and self._find_unsaturated_controls(structure):
            active[nodes[0] : nodes[-1]], order = True, 1  # inside an arc, multipliers may vanish
        if order == 1:
            active[1:-1] |= active[:-2] & active[2:]  # a boundary of the mesh may have no multiplier
        for a, b in find_true_value_intervals(active):
            phase_end = self._find_phase_end_with_touch_point(structure, a, b, samples)
            if phase_end is not None:
                structure = structure.with_touch_point(self.row, structure.times[phase_end], self.kind)
                continue
            if order == 1:
                start = self._compute_midpoint_to_previous_node(a, first)
                end = self._compute_midpoint_to_previous_node(b, last)
                entry_time = self._find_nearby_switch_time(structure, start, samples, 0)
                exit_time = self._find_nearby_switch_time(structure, end, samples, 1)
                start, end = (entry_time, exit_time) if entry_time < exit_time else (start, end)
                start, end = min([start, *nearby_touches]), max([end, *nearby_touches])
                structure = structure.with_inserted_arc(self.row, float(start), float(end), self.kind)
                continue
            time = float(np.average(self.times[a:b], weights=self.scaled_multipliers[a:b]))
            if first < time < last:
                structure = structure.with_touch_point(self.row, time, self.kind)
        return structure

    def _find_phase_end_with_touch_point(
        self, structure: PhaseStructure, a: int, b: int, samples: PhaseSamples
    ) -> int | None:
        """Return the end of the phase, 0 or -1, at which free states touch a path constraint, or None.

        Gauss points do not impose the constraint there: the multiplier of the adjacent points replaces it.
        """
        s, phase, path = samples, samples.phase, self.row - structure.n_controls
        if b - a > TOUCH_MAX_NODES or path >= structure.n_paths:
            return None
        for end, end_bounds, node in ((0, phase.initial_bounds, a), (-1, phase.final_bounds, b - 1)):
            slope = s.functions.path_state_jacobian(s.times[end], s.x[:, end], s.u[:, end])[path]
            includes_end = self.times[node] == phase.point_times[end]
            if includes_end and np.any(slope * s.state_scale * ~end_bounds.is_fixed):
                return end
        return None

    def is_touch_at_phase_end(self, structure: PhaseStructure, samples: PhaseSamples) -> bool:
        """Return whether the multipliers stem from the interior-point barrier next to a touched end of the phase."""
        end = self._find_phase_end_with_touch_point(structure, 0, self.times.size, samples)
        return end is not None and (self.row, self.kind) in structure.touches[end]

    def _find_unsaturated_controls(self, structure: PhaseStructure) -> list[int]:
        """Return the boundary controls that are off their bounds for most of the contact."""
        active_times = self.times[self.scaled_multipliers > 0]
        subarcs = np.clip(np.searchsorted(structure.times, active_times) - 1, 0, structure.n_subarcs - 1)
        controls = structure.boundary_arc_controls[self.row]
        return [i for i in controls if np.mean([structure.kinds[k][i].is_at_limit for k in subarcs]) < 0.5]

    def _find_nearby_switch_time(
        self, structure: PhaseStructure, time: float, samples: PhaseSamples, side: int
    ) -> float:
        """Return the time of a nearby switch of a control that keeps the constraint on its limit, or the given time.

        A single such control leaves its bound at the start of the arc (side 0) and reaches one at its end (side 1).
        """
        breaks, boundary_arc_controls = samples.phase.breaks, structure.boundary_arc_controls[self.row]
        segment = int(np.clip(np.searchsorted(breaks, time) - 1, 0, breaks.size - 2))
        distance = SHORT_ARC_SEGMENTS * float(breaks[segment + 1] - breaks[segment])
        switches = []
        for k in range(1, structure.n_subarcs):
            switch_time = structure.times[k]
            if abs(switch_time - time) >= distance or structure.has_only_control_kinks(k):
                continue
            interior_kinds = structure.kinds[k - 1 if side == 0 else k]
            changed = [i for i in structure.find_changed_arcs(k) if i in boundary_arc_controls]
            if changed and (len(boundary_arc_controls) > 1 or interior_kinds[changed[0]].is_at_limit):
                switches.append(switch_time)
        return min(switches, key=lambda t: abs(t - time), default=time)

    def _compute_midpoint_to_previous_node(self, node: int, end: float) -> float:
        """Return the midpoint between a node and the previous one; for the first node, an adjacent end of the phase."""
        times = self.times if node == 0 else self.times[::-1]
        if 0 < node < times.size:
            return float(0.5 * (self.times[node - 1] + self.times[node]))
        outer, inner = times[[0, min(1, times.size - 1)]]
        return float(end if abs(end - outer) <= abs(outer - inner) else outer)


def find_contact_nodes(constraints: StateConstraints, rows: Iterable[int]) -> list[ContactNodes]:
    """Return the runs of neighbouring nodes near a limit of the ``rows``, each with some nonzero multiplier."""
    s, rows = constraints.samples, list(rows)
    contacts: list[ContactNodes] = []
    if not rows:
        return contacts
    offsets, points = s.phase.mesh.point_offsets, s.phase.point_times
    times, values, multipliers = _evaluate_constraints_at_nodes(constraints)
    implied = _find_implied_limits(constraints)
    for row in rows:
        for kind, limit in constraints.list_finite_limits(int(row)):
            if (row, kind) in implied:
                continue
            near = np.abs(values[row] - limit) < NOTABLE * constraints.row_scales[row]
            scaled_multipliers = kind.sign * multipliers[row] * constraints.row_scales[row] / s.cost_scale
            threshold = max(SMALL * float(np.max(scaled_multipliers)), ACTIVE)
            scaled_multipliers = np.where(near & (scaled_multipliers > threshold), scaled_multipliers, 0.0)
            near[1:-1] |= near[:-2] & near[2:]  # a polynomial may oscillate between two nodes on the limit
            if constraints.get_order_of_constraint_contact(int(row)) > 1:
                is_off_limit = np.abs(values[row] - limit) > SMALL * constraints.row_scales[row]
                for a, b in find_true_value_intervals(is_off_limit & (scaled_multipliers == 0)):
                    is_off_point = np.isin(points, times[a:b])
                    covers = any(np.all(is_off_point[first:last]) for first, last in pairwise(offsets))
                    near[a:b] &= b - a < CONTACT_MIN_NODES or not covers
            runs = [(a, b) for a, b in find_true_value_intervals(near) if np.any(scaled_multipliers[a:b] > 0)]
            contacts += [ContactNodes(int(row), kind, times[a:b], scaled_multipliers[a:b]) for a, b in runs]
    return contacts


def _find_implied_limits(constraints: StateConstraints) -> set[tuple[int, ArcKind]]:
    """Return the rows and limits of monotone states, which their values at the ends of the phase imply."""
    problem, phase = constraints.problem, constraints.samples.phase
    monotone = find_monotone_states(problem, problem.phases[phase.name], undriven=True)
    both = zip((ArcKind.LOWER, ArcKind.UPPER), monotone, strict=True)
    return {(len(phase.path_labels) + int(i), kind) for kind, own in both for i in np.flatnonzero(own)}


def _evaluate_constraints_at_nodes(constraints: StateConstraints) -> tuple[Array, Array, Array]:
    """Return times of points and inner boundaries, values of the rows and their multipliers, (n_rows, n_nodes)."""
    phase = constraints.samples.phase
    inner, (points, x, u) = phase.breaks[1:-1], phase.point_trajectory
    times = np.concatenate([points, inner])
    x, u = np.hstack([x, phase.x(inner)]), np.hstack([u, phase.u(inner)])
    densities = np.vstack([phase.path_multipliers, phase.state_multipliers]) * phase.point_weights
    # Path constraints are not imposed at boundaries: the multiplier there is the mean of both sides.
    paths = densities[: len(phase.path_labels)]
    first = np.array(phase.mesh.point_offsets[1:-1], dtype=int)
    left, right = paths[:, first - 1], paths[:, first]
    atoms = np.vstack([np.where(left * right > 0, 0.5 * (left + right), 0.0), phase.state_impulses[:, 1:-1]])
    order = np.argsort(times, kind="stable")
    multipliers = np.hstack([densities, atoms])[:, order]
    return times[order], constraints.evaluate_constraints(times, x, u)[:, order], multipliers


@dataclass(frozen=True)
class ArcControl:
    """A control between its bounds from ``start`` to ``end`` (s); it keeps a row of `StateConstraints` on a limit."""

    control: int
    start: float
    end: float
    row: int = -1
    kind: ArcKind = ArcKind.INTERIOR


def find_constraint_arc_controls(problem: Problem, samples: PhaseSamples) -> list[ArcControl]:
    """Return the controls that keep state constraints on their limits.

    On a mesh, control and switching function oscillate about their values; means of both and the multiplier are used.
    """
    constraints, phase = StateConstraints(problem, samples), samples.phase
    points, u = phase.point_times, np.hstack(phase.u.values)
    arc_controls = []
    rows = [row for row in range(constraints.n_rows) if constraints.get_order_of_constraint_contact(row)]
    for run in find_contact_nodes(constraints, rows):
        active = np.flatnonzero(run.scaled_multipliers > 0)
        start, end = run.times[active[[0, -1]]]
        in_contact = (points >= start) & (points <= end)
        if active.size < CONTACT_MIN_NODES or np.sum(in_contact) < CONTACT_MIN_NODES:
            continue
        mean, margin = np.mean(u[:, in_contact], axis=1), BETWEEN_BOUNDS_MIN_SHARE * samples.control_scale
        saturated = np.logical_or(*phase.control_bounds.is_near_limits(mean, margin))
        holders = [i for i, _ in constraints.rank_controls_by_constraint_effect(run.row) if not saturated[i]]
        arc_controls += [ArcControl(i, float(start), float(end), run.row, run.kind) for i in holders]
    return arc_controls


def add_contacts(structure: PhaseStructure, problem: Problem, samples: PhaseSamples) -> PhaseStructure:
    """Return the structure with the contacts that multipliers and constraint values of a mesh show.

    A first-order constraint with a multiplier has an arc on its limit; one of second order has an arc if the contact is
    longer than a segment, otherwise a touch. A third-order constraint has touches only (Jacobson, Lele & Speyer, 1971).
    """
    constraints, first = StateConstraints(problem, samples), structure.n_controls
    has_arc, orders, effects = np.any(structure.active[first:], axis=1), [0] * first, list(structure.effects)
    for row, row_has_arc in enumerate(has_arc):
        order = constraints.get_order_of_constraint_contact(row)
        orders.append(0 if row_has_arc else order)
        if order:
            effects[first + row] = constraints.rank_controls_by_constraint_effect(row)
    structure = replace(structure, orders=tuple(orders), effects=tuple(effects))
    for run in _find_new_contact_nodes(constraints, structure) if any(orders) else ():
        structure = run.add_contact_arcs(structure, samples)
    return structure


def _find_new_contact_nodes(constraints: StateConstraints, structure: PhaseStructure) -> list[ContactNodes]:
    first, contacts = structure.n_controls, []
    for run in find_contact_nodes(constraints, np.flatnonzero(structure.orders[first:])):
        is_known = structure.is_at_limit(first + run.row, run.times)
        scaled_multipliers = np.where(is_known, 0.0, run.scaled_multipliers)
        if np.any(scaled_multipliers > 0):
            contacts.append(replace(run, row=first + run.row, scaled_multipliers=scaled_multipliers))
    return [run for run in contacts if not run.is_touch_at_phase_end(structure, constraints.samples)]


def add_missing_contact(constraints: StateConstraints, arc_mesh: ArcMesh) -> Correction:
    """Return the structure with a contact at the largest missing multiplier and the action, or None."""
    s, structure = constraints.samples, arc_mesh.structure
    runs = _find_new_contact_nodes(constraints, structure)
    for run in sorted(runs, key=lambda r: float(np.max(r.scaled_multipliers)), reverse=True):
        new_structure = run.add_contact_arcs(structure, s)
        if new_structure != structure:
            time = run.times[int(np.argmax(run.scaled_multipliers))]
            label = (*s.phase.path_labels, *s.phase.states.labels)[run.row - structure.n_controls]
            return new_structure, f"active limit of {label} added at {s.describe_times(time)}"
    return None, ""


def replace_saturated_arc_controls(constraints: StateConstraints, arc_mesh: ArcMesh) -> Correction:
    """Return the structure in which other controls keep a constraint on its limit and the action, or None.

    If a control linear in H reaches its bound while it keeps a limit, H is continuous only if regular controls keep the
    limit afterwards. Otherwise, the control leaves its bound before the end of the arc. The dynamics must be accurate.
    """
    samples, structure = constraints.samples, arc_mesh.structure
    if np.max(compute_segment_defects(samples)) > MINOR:
        return None, ""
    bounds, subarcs = samples.phase.control_bounds, arc_mesh.segment_subarc_indices[samples.segments]
    for boundary in range(1, structure.n_subarcs):
        rows = structure.find_state_to_control_limit_change(boundary)
        if not rows:
            continue
        state, row = rows
        is_limit_after = structure.kinds[boundary][state].is_at_limit
        subarc, kind = boundary - 1 + is_limit_after, structure.kinds[boundary - is_limit_after][row]
        samples_of_arc = np.flatnonzero(subarcs == subarc)[:: -1 if is_limit_after else 1]
        limit, times = bounds.get_limit_by_sign(kind.sign)[row], samples.times[samples_of_arc]
        excess = kind.sign * (samples.u_polynomial[row, samples_of_arc] - limit) / samples.control_scale[row]
        within = np.flatnonzero(excess <= 0)
        if excess[-1] > NEGLIGIBLE and within.size:
            last = slice(within[-1], within[-1] + 2)
            at_limit = float(np.interp(0.0, excess[last], times[last]))
            start, end = sorted((at_limit, structure.times[boundary]))
            label = samples.phase.controls.labels[row]
            action = f"{label} at its bound from {samples.describe_times(start)}"
            return structure.with_inserted_arc(row, start, end, kind), action
    return None, ""
