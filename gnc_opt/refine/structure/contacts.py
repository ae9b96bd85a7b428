r"""Contacts of a trajectory with state constraints: arcs on a limit and touches, found and mended.

Let S(t, x) <= 0 have order q (`gnc_opt.problem.constraint_order`), and H be strictly convex in the controls that
:math:`S^{(q)}` depends on. Then the control is continuous where an arc on the limit begins and ends (Jacobson, Lele &
Speyer, J. Math. Anal. Appl. 35, 1971; Hartl, Sethi & Vickson, SIAM Review 37(2), 1995): there :math:`S^{(q)}` comes to
zero, with a kink, from the side of the interior arc. As with the kinks of module `junctions`, the cost hardly depends
on the time; so an entry is kept where it is during a solve, in which the constraint may be left beside the arc, and
then moves to where :math:`S^{(q)}` of the interior arc vanishes. Since states and costates are wrong in second order
only, repeating this converges quadratically.

A control that enters H linearly jumps to where it holds the limit, and back (McDanell & Powers, SIAM J. Control 9(2),
1971). The times of such an arc are variables, as those of switches; it begins with
:math:`S = \dots = S^{(q-1)} = 0`. Where all controls of :math:`S^{(q)}` are on limits of their own there are touches
only.

The time of a touch, of order two or more, is a variable: with :math:`S = \dot S = 0` there the cost has a strict
minimum at the time at which the multiplier of :math:`\dot S = 0` vanishes, so that the costate jumps along
:math:`\partial S/\partial x` alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.arrays import Array, Indices, Mask
from gnc_opt.problem.arc import ArcKind
from gnc_opt.problem.problem import Problem
from gnc_opt.refine.error import states_at_points
from gnc_opt.refine.structure.ends import with_starts_on_limits
from gnc_opt.refine.structure.phase_structure import PhaseStructure
from gnc_opt.refine.structure.ringing import without_ringing
from gnc_opt.refine.structure.state_constraints import NEAR, StateConstraints
from gnc_opt.refine.structure.tidy import with_possible_ends, without_overlaps
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.tolerances import TINY

PUSHING = 1e-3
"""Share of the largest push of a constraint that counts as one, ..."""

WORTH = 1e-5
"""... if that is worth this share of the cost."""

SHORT = 2.0
"""Closer than so many segments, an arc begins or ends where a control that holds it switches."""

TURNING = 0.05
"""Share of a singular arc along which a vector is at its limit to begin with, to turn there."""

FEW = 5
"""A contact of second order over no more nodes than this is a touch to begin with."""

LASTING = 3
"""So many nodes in a row at which a constraint pushes say that a control holds it there."""

SWINGING = 0.05
"""A control is between its bounds on average if the mean is this far from them, relative to its range."""

EXCEEDED = 1e-8
"""A constraint beyond its limit by this share of what it moves is left."""

ODD = 1e-6
"""A push of the wrong direction worth this share of the cost says that there is no contact."""


# --- controls that are determined -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Determined:
    """A control between its bounds, from ``start`` to ``end`` (s), because it holds a state constraint on its limit.

    The constraint is a row of `StateConstraints`, the limit a kind.
    """

    control: int
    start: float
    end: float
    row: int = -1
    kind: ArcKind = ArcKind.INTERIOR


def determined(problem: Problem, samples: PhaseSamples) -> list[Determined]:
    """Return the controls that hold state constraints on their limits.

    On a mesh such a control swings about what holds the constraint, and so does its switching function about zero: at
    single times neither says anything. Their means do, and the pushes of the constraint.
    """
    constraints, leg = StateConstraints(problem, samples), samples.leg
    points, u = leg.point_times, np.hstack(leg.u.values)
    found = []
    rows = [row for row in range(constraints.size) if constraints.order(row)]
    for run in _pushing_runs(constraints, rows):
        held = np.flatnonzero(run.worth > 0)
        start, end = run.times[held[[0, -1]]]
        inside = (points >= start) & (points <= end)
        if held.size < LASTING or np.sum(inside) < LASTING:
            continue
        mean = np.mean(u[:, inside], axis=1)
        at_lower, at_upper = leg.control_bounds.near(mean, SWINGING * samples.control_scale)
        found += [
            Determined(i, float(start), float(end), run.row, run.kind)
            for i in constraints.holders(run.row)
            if not at_lower[i] and not at_upper[i]
        ]
    return found


# --- found on a mesh ------------------------------------------------------------------------------------------


def with_contacts(structure: PhaseStructure, problem: Problem, samples: PhaseSamples) -> PhaseStructure:
    """Return the structure with the contacts that multipliers and slacks of a mesh show.

    A constraint of first order that pushes is on its limit; one of higher order is where it stays there over
    more than a segment, else it touches; one of third order only touches, as arcs of odd order beyond the first have no
    simple junctions (Jacobson, Lele & Speyer, 1971).
    """
    constraints, first = StateConstraints(problem, samples), len(structure.controls)
    held = [any(kinds[first + row].at_limit for kinds in structure.kinds) for row in range(constraints.size)]
    orders = [0 if held[row] else constraints.order(row) for row in range(constraints.size)]
    asked = [
        bool(order) or (on and constraints.order(k) == 1)
        for k, (order, on) in enumerate(zip(orders, held, strict=True))
    ]
    known = structure.holders[first:]
    holders = [constraints.holders(row) if ask else known[row] for row, ask in enumerate(asked)]
    known = structure.leans[first:]
    leans = [constraints.leans(row) if ask else known[row] for row, ask in enumerate(asked)]
    structure = replace(
        structure,
        orders=(*(0,) * first, *orders),
        holders=(*((),) * first, *holders),
        leans=(*((),) * first, *leans),
    )
    if not any(orders):
        return without_ringing(without_overlaps(structure), constraints, SHORT)
    for run in _runs_of_pushes(constraints, structure):
        structure = run.added(structure, samples)
    structure = without_ringing(structure, constraints, SHORT)
    longest = SHORT * float(np.max(np.diff(samples.leg.breaks)))
    structure = with_possible_ends(without_overlaps(structure), longest)
    return with_starts_on_limits(structure, problem.phases[samples.leg.name], samples)


@dataclass(frozen=True, eq=False)
class _Run:
    """Neighbouring nodes of a mesh near a limit at some of which a constraint pushes.

    Attributes
    ----------
    row : int
        Of the structure.
    kind : ArcKind
    times, worth : array
        Of the nodes, and of the pushes there in shares of the cost; zero where there is none that counts.
    """

    row: int
    kind: ArcKind
    times: Array
    worth: Array

    def added(self, structure: PhaseStructure, samples: PhaseSamples) -> PhaseStructure:
        """Return the structure with the contacts of the nodes."""
        runs, order = _runs(self.worth > 0), structure.orders[self.row]
        first, last = samples.leg.breaks[[0, -1]]
        free = self._free(structure)
        beside = [t for t in structure.touching(self.row, self.kind) if self.times[0] <= t <= self.times[-1]]
        if (
            order == 2 and free and (runs[-1][1] - runs[0][0] > FEW or beside)
        ):  # between its ends an arc need not push
            runs, order = [(runs[0][0], runs[-1][1])], 1
        if order == 1:
            runs = _joined(runs)
            if len(structure.holders[self.row]) > 1:
                runs = self._along_singular(runs, structure, samples)
        for a, b in runs:
            at_end = self._end_touched(structure, a, b, samples)
            if at_end is not None:
                structure = structure.with_touch(self.row, structure.times[at_end], self.kind)
                continue
            if order == 1:
                start, end = self._between(a, first), self._between(b, last)
                switches = [self._switch(structure, t, samples, k) for k, t in enumerate((start, end))]
                if switches[0] < switches[1]:
                    start, end = switches
                turned = structure
                if len(structure.holders[self.row]) > 1:
                    start, end = self._up_to_arcs(structure, start, end, samples)
                    turned = self._turned(structure, start, end)
                structure = turned.with_arc(
                    self.row, float(min([start, *beside])), float(max([end, *beside])), self.kind
                )
                continue
            time = float(np.average(self.times[a:b], weights=self.worth[a:b]))
            if first < time < last:
                structure = structure.with_touch(self.row, time, self.kind)
        return structure

    def _end_touched(self, structure: PhaseStructure, a: int, b: int, samples: PhaseSamples) -> int | None:
        """The end of the phase, 0 or -1, at which alone a path constraint is met by free states, or None.

        A mesh of Gauss points has no row there, so that its points beside the end push for it.
        """
        leg, path = samples.leg, self.row - len(structure.controls)
        if b - a > FEW or path >= structure.n_paths:
            return None
        points, ends = leg.point_times, ((0, leg.initial_bounds, a), (-1, leg.final_bounds, b - 1))
        for end, given, node in ends:
            slope = samples.functions.path_state_jacobian(
                samples.times[end], samples.x[:, end], samples.u[:, end]
            )
            if self.times[node] == points[end] and np.any(slope[path] * samples.state_scale * ~given.fixed):
                return end
        return None

    def known(self, structure: PhaseStructure, samples: PhaseSamples) -> bool:
        """Whether it is what the barrier of an interior-point method leaves beside an end that is touched already."""
        end = self._end_touched(structure, 0, self.times.size, samples)
        return end is not None and (self.row, self.kind) in structure.touches[end]

    def beside_slide(self, structure: PhaseStructure, samples: PhaseSamples) -> bool:
        """Whether it is in the segment beside an end of an arc of its own that is where the solver wants it.

        A vector turns fast there: what pushes is the mesh, which has to be finer.
        """
        pushing, breaks = self.times[self.worth > 0], samples.leg.breaks
        for k in range(1, structure.pieces):
            if self.row in structure.changes(k) and structure.slides(k):
                at = int(np.argmin(np.abs(breaks - structure.times[k])))
                if np.all((pushing >= breaks[at - 1]) & (pushing <= breaks[at + 1])):
                    return True
        return False

    def possible(self, structure: PhaseStructure) -> bool:
        """Whether it can be a contact: one of first order stays on its limit, which takes a control that is free."""
        return structure.orders[self.row] > 1 or bool(self._free(structure))

    def _free(self, structure: PhaseStructure) -> list[int]:
        """Controls that can hold the constraint and are on no limit of their own where it pushes, for the most part."""
        pushing = self.times[self.worth > 0]
        pieces = np.clip(np.searchsorted(structure.times, pushing) - 1, 0, structure.pieces - 1)
        return [
            i
            for i in structure.holders[self.row]
            if np.mean([structure.kinds[k][i].at_limit for k in pieces]) < 0.5
        ]

    def _switch(self, structure: PhaseStructure, time: float, samples: PhaseSamples, side: int) -> float:
        """Where a control that holds the constraint switches close by, or the time itself: it does that to hold it.

        The one holder of an arc is on no bound along it: it leaves one at the start (side 0), and meets one at the end
        (side 1). It does neither where another arc of its begins or ends.
        """
        breaks, holders = samples.leg.breaks, structure.holders[self.row]
        segment = int(np.clip(np.searchsorted(breaks, time) - 1, 0, breaks.size - 2))
        reach = SHORT * float(breaks[segment + 1] - breaks[segment])
        switches = []
        for k in range(1, structure.pieces):
            at = structure.times[k]
            if abs(at - time) >= reach or structure.kinked(k):
                continue
            if len(holders) == 1 and self._others(structure, *sorted((at, time))):
                continue
            outer = structure.kinds[k - 1 if side == 0 else k]
            changed = [i for i in structure.changes(k) if i in holders]
            if changed and (len(holders) > 1 or outer[changed[0]].at_limit):
                switches.append(at)
        return min(switches, key=lambda t: abs(t - time), default=time)

    def _others(self, structure: PhaseStructure, start: float, end: float) -> bool:
        """Whether another constraint with the same holders is on a limit for some of a time."""
        return any(
            kinds[row].at_limit and structure.times[k] < end and structure.times[k + 1] > start
            for row in np.flatnonzero(structure.orders)
            for k, kinds in enumerate(structure.kinds)
            if row != self.row and structure.holders[row] == structure.holders[self.row]
        )

    def _up_to_arcs(
        self, structure: PhaseStructure, start: float, end: float, samples: PhaseSamples
    ) -> tuple[float, float]:
        """Return the ends of an arc, extended to arcs on the same limit that are close by."""
        reach = SHORT * float(np.max(np.diff(samples.leg.breaks)[self._segments(samples)]))
        for k, kinds in enumerate(structure.kinds):
            if kinds[self.row] is self.kind:
                entry, leave = structure.times[k : k + 2]
                if start < entry < end + reach:
                    end = max(end, entry)
                if start - reach < leave < end:
                    start = min(start, leave)
        return start, end

    def _turned(self, structure: PhaseStructure, start: float, end: float) -> PhaseStructure:
        """Return the structure with singular vectors beside an arc at their limits for a while, to turn on it.

        The solver finds out how long; a very short arc is no place to begin.
        """
        turned = structure
        for k in range(1, structure.pieces):
            time = structure.times[k]
            for near, other, far in ((k - 1, k, structure.times[k + 1]), (k, k - 1, structure.times[k - 1])):
                if time != (end if near < k else start):
                    continue
                room = max(TURNING - (end - start) / abs(far - time), 0.0) * (far - time)
                first, last = sorted((time, time + room))
                for i in structure.holders[self.row]:
                    kinds = structure.kinds[near][i], structure.kinds[other][i]
                    if kinds == (ArcKind.INTERIOR, ArcKind.SINGULAR) and room:
                        turned = turned.with_arc(i, first, last, ArcKind.INTERIOR)
        return turned

    def _segments(self, samples: PhaseSamples) -> Indices:
        """The segments of the nodes."""
        breaks = samples.leg.breaks
        return np.clip(np.searchsorted(breaks, self.times) - 1, 0, breaks.size - 2)

    def _along_singular(
        self, runs: list[tuple[int, int]], structure: PhaseStructure, samples: PhaseSamples
    ) -> list[tuple[int, int]]:
        """Join close runs between which a singular control may hold the limit: on a mesh it swings, as pushes do."""
        reach = SHORT * float(np.max(np.diff(samples.leg.breaks)[self._segments(samples)]))
        joined = runs[:1]
        for a, b in runs[1:]:
            before, after = self.times[joined[-1][1] - 1], self.times[a]
            piece = int(np.searchsorted(structure.times[1:-1], 0.5 * (before + after)))
            kinds = [structure.kinds[piece][i] for i in structure.holders[self.row]]
            if after - before < reach and ArcKind.SINGULAR in kinds:
                joined[-1] = (joined[-1][0], b)
            else:
                joined.append((a, b))
        return joined

    def _between(self, node: int, end: float) -> float:
        """Time between a node and the one before; beyond the first and last, the phase's end if that is next."""
        times, size = self.times, self.times.size
        if 0 < node < size:
            return float(0.5 * (times[node - 1] + times[node]))
        outer, inner = (
            (times[0], times[min(1, size - 1)]) if node == 0 else (times[-1], times[max(-2, -size)])
        )
        return float(end if abs(end - outer) <= abs(outer - inner) else outer)


def _runs_of_pushes(constraints: StateConstraints, structure: PhaseStructure) -> list[_Run]:
    """Where constraints push that determine a control, but for the contacts of the structure."""
    first, found = len(structure.controls), []
    for run in _pushing_runs(constraints, np.flatnonzero(structure.orders[first:])):
        worth = np.where(structure.contact(first + run.row, run.times), 0.0, run.worth)
        if np.any(worth > 0):
            found.append(replace(run, row=first + run.row, worth=worth))
    return [
        run
        for run in found
        if run.possible(structure)
        and not run.known(structure, constraints.samples)
        and not run.beside_slide(structure, constraints.samples)
    ]


def _pushing_runs(constraints: StateConstraints, rows: Iterable[int]) -> list[_Run]:
    """Where constraints of some rows push."""
    s, rows = constraints.samples, list(rows)
    found: list[_Run] = []
    if not rows:
        return found
    times, values, pushes = _at_nodes(constraints)
    for row in rows:
        for kind, limit in constraints.limits(int(row)):
            near = np.abs(values[row] - limit) < NEAR * constraints.scales[row]
            worth = kind.sign * pushes[row] * constraints.scales[row] / s.cost_scale
            worth = np.where(near & (worth > max(PUSHING * float(np.max(worth)), WORTH)), worth, 0.0)
            near[1:-1] |= near[:-2] & near[2:]  # between two nodes on the limit a polynomial may swing
            runs = [(a, b) for a, b in _runs(near) if np.any(worth[a:b] > 0)]
            found += [_Run(int(row), kind, times[a:b], worth[a:b]) for a, b in runs]
    return found


def _at_nodes(constraints: StateConstraints) -> tuple[Array, Array, Array]:
    """Times of points and inner boundaries, rows there and what they push on costates (n_rows, n_nodes)."""
    leg = constraints.samples.leg
    inner, points = leg.breaks[1:-1], leg.point_times
    weights = np.concatenate([r.weights for r in leg.rules]) * np.repeat(
        0.5 * np.diff(leg.breaks), leg.mesh.degrees
    )
    times = np.concatenate([points, inner])
    x = np.hstack([states_at_points(leg), leg.x(inner)])
    u = np.hstack([*leg.u.values, leg.u(inner)])
    densities = np.vstack([leg.path_multipliers, leg.state_multipliers]) * weights
    # Path constraints have no row at a boundary: there they push as long as they do on both sides.
    paths = densities[: len(leg.path_labels)]
    first = np.array(leg.mesh.offsets[1:-1], dtype=int)
    left, right = paths[:, first - 1], paths[:, first]
    atoms = np.vstack([np.where(left * right > 0, 0.5 * (left + right), 0.0), leg.state_impulses[:, 1:-1]])
    order = np.argsort(times, kind="stable")
    pushes = np.hstack([densities, atoms])[:, order]
    return times[order], constraints.values(times, x, u)[:, order], pushes


def _joined(runs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Join runs with one node between them: a boundary of the mesh, where a limit held at the points may be left."""
    joined = runs[:1]
    for a, b in runs[1:]:
        if a - joined[-1][1] == 1:
            joined[-1] = (joined[-1][0], b)
        else:
            joined.append((a, b))
    return joined


def _runs(here: Mask) -> list[tuple[int, int]]:
    """First places, and those after the last ones, of the runs in which something holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], here, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


# --- mended ---------------------------------------------------------------------------------------------------


def wrong_touch(constraints: StateConstraints, structure: PhaseStructure) -> tuple[int, int] | None:
    """Return boundary and row of a touch whose limit would have to pull, or None."""
    s, first = constraints.samples, len(structure.controls)
    for k, touches in enumerate(structure.touches):
        for row, kind in touches:
            time = float(s.leg.breaks[np.argmin(np.abs(s.leg.breaks - structure.times[k]))])
            gradient = constraints.gradient(row - first, time, s.leg.x(time), s.leg.u(time)) * s.state_scale
            jump = (s.leg.lam(time, "left") - s.leg.lam(time, "right")) * s.state_scale
            push = kind.sign * float(gradient @ jump) / max(float(np.linalg.norm(gradient)), TINY)
            if push < -ODD * s.cost_scale:
                return k, row
    return None


def pushed_contact(
    constraints: StateConstraints, structure: PhaseStructure
) -> tuple[PhaseStructure | None, str]:
    """Return the structure with a contact where a constraint pushes, and what was done; None if none does."""
    return _worst_added(constraints, structure, _runs_of_pushes(constraints, structure))


def crossed_contact(
    constraints: StateConstraints, structure: PhaseStructure
) -> tuple[PhaseStructure | None, str]:
    """Return the structure with a contact where a constraint is left, and what was done; None if none is."""
    return _worst_added(constraints, structure, _excesses(constraints, structure))


def _worst_added(
    constraints: StateConstraints, structure: PhaseStructure, runs: list[_Run]
) -> tuple[PhaseStructure | None, str]:
    s, labels = (
        constraints.samples,
        (*constraints.samples.leg.path_labels, *constraints.samples.leg.states.labels),
    )
    for run in sorted(runs, key=lambda r: float(np.max(r.worth)), reverse=True):
        added = run.added(structure, s)
        if added != structure:
            at = run.times[int(np.argmax(run.worth))]
            label = labels[run.row - len(structure.controls)]
            return added, f"contact of {label} added at {at:.4g} s"
    return None, ""


def _excesses(constraints: StateConstraints, structure: PhaseStructure) -> list[_Run]:
    """Samples at which constraints are left beside their arcs and between points."""
    s, first = constraints.samples, len(structure.controls)
    values = constraints.values(s.times, s.x, s.u_polynomial)
    found: list[_Run] = []
    for row in np.flatnonzero(structure.orders[first:]):
        known = structure.contact(first + int(row), s.times)
        for kind, limit in constraints.limits(int(row)):
            excess = np.where(known, 0.0, kind.sign * (values[row] - limit) / constraints.scales[row])
            found += [
                _Run(first + int(row), kind, s.times[a:b], excess[a:b]) for a, b in _runs(excess > EXCEEDED)
            ]
    return [run for run in found if run.possible(structure)]
