"""Control structure: sequence of arcs of controls, path constraints and states with switching times."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gnc_opt.array_types import Array, Mask
from gnc_opt.numerical_tolerances import ROUNDING, SAME_TIME
from gnc_opt.planning.problem.active_constraint_arcs import Arc, ArcKind, Kinds
from gnc_opt.planning.solution.phase_solution import PhaseSolution

KindArray: TypeAlias = NDArray[np.object_]
"""Kinds of the rows in each subarc."""

Touch: TypeAlias = "tuple[int, ArcKind]"
"""Touch of a limit: row and limit."""

ControlEffect: TypeAlias = "tuple[int, int]"
"""Control, and sign of its effect on a row, or on the time derivative of the row's order; 0 if the sign changes."""

Correction: TypeAlias = "tuple[PhaseStructure | None, str]"
"""Corrected structure, None if there is nothing to correct, and the action."""


@dataclass(frozen=True)
class PhaseStructure:
    """Arcs of one phase: A subarcs between consecutive switching times (s), with a kind for every row.

    The rows are ``n_controls`` controls, ``n_paths`` path constraints and the states. Controls are LOWER or UPPER at a
    bound, INTERIOR off their bounds, or SINGULAR, if H is linear in them; the other rows are at an active limit or
    INTERIOR.

    Attributes
    ----------
    times : tuple of A + 1 floats
    kinds : tuple of A tuples of ArcKind
    regular : tuple of bool
        For each row, whether H is convex in the control, so that it enters and leaves bounds (or the mixed path
        constraint) with kinks instead of jumps.
    orders : tuple of int
        For each row, the order of the state constraint if its contacts are detected, otherwise 0.
    touches : tuple of A + 1 tuples of Touch
        Touches of state constraints at each of the times.
    effects : tuple of tuples of ControlEffect
        For each row with an order, each mixed path constraint and each one linear in one control: the controls that can
        keep it on its limit, the most effective ones first, with the signs of their effects.
    """

    times: tuple[float, ...]
    kinds: Kinds
    regular: tuple[bool, ...]
    n_controls: int
    n_paths: int = 0
    orders: tuple[int, ...] = ()
    touches: tuple[tuple[Touch, ...], ...] = ()
    effects: tuple[tuple[ControlEffect, ...], ...] = ()

    def __post_init__(self) -> None:
        rows, defaults = len(self.kinds[0]), {"regular": False, "orders": 0, "effects": (), "touches": ()}
        for name, value in defaults.items():
            if not getattr(self, name):
                size = len(self.kinds) + 1 if name == "touches" else rows
                object.__setattr__(self, name, (value,) * size)

    @cached_property
    def boundary_arc_controls(self) -> tuple[tuple[int, ...], ...]:
        """Controls that can keep each row on its limit, the most effective ones first."""
        return tuple(tuple(control for control, _ in row_effects) for row_effects in self.effects)

    @cached_property
    def active(self) -> Mask:
        """Where the rows are at a limit, (n_rows, A)."""
        return np.array([[kind.is_at_limit for kind in row] for row in self.arc_kind_matrix()])

    @property
    def control_arc_kinds(self) -> KindArray:
        """Kinds of the controls (n_controls, A)."""
        return self.arc_kind_matrix()[: self.n_controls]

    @property
    def n_subarcs(self) -> int:
        return len(self.kinds)

    @property
    def subarc_lengths(self) -> Array:
        """Length of each subarc (A,), s."""
        return np.diff(np.asarray(self.times))

    def arc_kind_matrix(self) -> KindArray:
        """The kinds as an object array (n_rows, A)."""
        return np.asarray(self.kinds, dtype=object).T

    def truncate_arcs_before(self, time: float) -> PhaseStructure:
        """Return the structure after a time (s)."""
        if time <= self.times[0]:
            return self
        first = max(k for k, begin in enumerate(self.times[:-1]) if begin <= time)
        times, touches = (time, *self.times[first + 1 :]), ((), *self.touches[first + 1 :])
        return replace(self, times=times, kinds=self.kinds[first:], touches=touches)

    def find_controls_fixed_by_limits(self, subarc: int) -> set[int]:
        """Return the controls that active state bounds and path constraints determine in a subarc.

        Of several singular controls, a limit determines its first boundary control that no other limit determines.
        Mixed path constraints determine regular controls; a limit without known boundary controls determines all
        controls.
        """
        fixed: set[int] = set()
        for i in range(self.n_controls, len(self.orders)):
            if self.kinds[subarc][i].is_at_limit:
                all_controls = [c for c in range(self.n_controls) if self.regular[c] or not self.regular[i]]
                holders = self.boundary_arc_controls[i]
                singular = [c for c in holders if self.kinds[subarc][c] is ArcKind.SINGULAR]
                unassigned = [c for c in singular if c not in fixed]
                fixed |= ({*(holders or all_controls)} - {*singular}) | {*unassigned[:1]}
        return fixed

    def find_changed_arcs(self, boundary: int) -> list[int]:
        """Return the rows with different kinds in the subarcs before and after a boundary."""
        pair = zip(self.kinds[boundary - 1], self.kinds[boundary], strict=True)
        return [i for i, (before, after) in enumerate(pair) if before is not after]

    def has_only_control_kinks(self, boundary: int) -> bool:
        """Return whether controls have kinks only, and no jumps, at the boundary before a subarc.

        This is the case if regular controls, mixed path constraints, or state constraints that determine such controls,
        become active or inactive. If one limit replaces another one, both are active, and the time is a variable.
        """
        if self.find_state_to_control_limit_change(boundary) or self.find_control_limit_replacement(boundary):
            return False
        before, after = self.kinds[boundary - 1], self.kinds[boundary]
        for i in self.find_changed_arcs(boundary):
            control_kinds = [kinds[c] for kinds in (before, after) for c in self.boundary_arc_controls[i]]
            is_kink = self.regular[i] or (bool(self.orders[i]) and ArcKind.SINGULAR not in control_kinds)
            if not (is_kink or self.has_saturated_control(i, boundary)):
                return False
            if before[i].is_at_limit and after[i].is_at_limit:
                return False
        return not self.touches[boundary]

    def has_saturated_control(self, row: int, boundary: int) -> bool:
        """Return whether a control on a state constraint reaches its bound, and others keep the constraint."""
        adjacent = (boundary - 1, boundary)
        singular = [k for k in adjacent if self.kinds[k][row] is ArcKind.SINGULAR]
        if row >= self.n_controls or len(singular) != 1:
            return False
        if row not in self.find_controls_fixed_by_limits(singular[0]):
            return False
        kinds = self.kinds[sum(adjacent) - singular[0]]
        rows = np.flatnonzero(self.orders * np.all(self.active[:, adjacent], axis=1))
        return any(not kinds[control].is_at_limit for i in rows for control in self.boundary_arc_controls[i])

    def find_control_limit_replacement(self, boundary: int) -> list[int]:
        """Return the changing rows if one limit of a control replaces another one at a boundary, or an empty list."""
        rows, adjacent_kinds = self.find_changed_arcs(boundary), self.kinds[boundary - 1 : boundary + 1]
        signs = [(kinds[i].sign, i) for kinds in adjacent_kinds for i in rows if kinds[i].is_at_limit]
        sides = [sign * self._get_sign_of_control_effect(i) for sign, i in signs]
        limited = (self.boundary_arc_controls[row] if row >= self.n_controls else (row,) for row in rows)
        controls = set(itertools.chain(*limited))
        return rows if len(controls) == 1 and len(sides) == 2 and sides[0] == sides[1] != 0 else []

    def find_state_to_control_limit_change(self, boundary: int) -> list[int]:
        """Return a state constraint and a limit of its control of which one replaces the other at a boundary, or [].

        The control reaches its limit, on the side away from the constraint, along the arc on the constraint, or is on
        the opposite limit until the constraint is active. It is continuous; the costates jump.
        """
        rows, pair = self.find_changed_arcs(boundary), self.kinds[boundary - 1 : boundary + 1]
        bounded = [i for i in rows if i >= self.n_controls + self.n_paths and self.boundary_arc_controls[i]]
        # First-order state constraints, and bounds on states that singular controls move.
        states = [i for i in rows if self.orders[i] == 1 or (i in bounded and not self.orders[i])]
        if len(rows) != 2 or len(states) != 1:
            return []
        (state,), (limit,) = states, [i for i in rows if i not in states]
        first = int(pair[0][limit].is_at_limit)  # whether the limit of the control is active first
        active = [[kinds[i].is_at_limit for i in (state, limit)] for kinds in (pair[first], pair[1 - first])]
        controls = (limit,) if limit < self.n_controls else self.boundary_arc_controls[limit]
        boundary_arc_controls = self.boundary_arc_controls[state]
        if active != [[True, False], [False, True]] or len(controls) != 1:
            return []
        other_controls = [i for i in boundary_arc_controls if i not in controls]
        if controls[0] not in boundary_arc_controls or not all(self.regular[i] for i in other_controls):
            return []
        required_sign = pair[first][state].sign * dict(self.effects[state])[controls[0]]
        actual_sign = pair[1 - first][limit].sign * self._get_sign_of_control_effect(limit)
        return [state, limit] if required_sign == (-1 if first else 1) * actual_sign != 0 else []

    def _get_sign_of_control_effect(self, row: int) -> int:
        """Return the sign of a control's effect on its own row or path constraint; 0 if it changes, or for states."""
        effect_sign = 1 if row < self.n_controls else next((sign for _, sign in self.effects[row]), 0)
        return 0 if self.orders[row] or row >= self.n_controls + self.n_paths else effect_sign

    def mask_rows_near_limit_changes(self) -> Mask:
        """Return which interior rows are next to a boundary at which one limit replaces another, (n_rows, A)."""
        near_change = np.zeros((len(self.kinds[0]), self.n_subarcs), dtype=bool)
        for k in range(1, self.n_subarcs):
            rows = [row for row in self.find_changed_arcs(k) if self.has_saturated_control(row, k)]
            rows += [*self.find_control_limit_replacement(k), *self.find_state_to_control_limit_change(k)]
            for row in rows:
                near_change[row, k - 1 : k + 1] = ~self.active[row, k - 1 : k + 1]
        return near_change

    def mask_constraints_near_contacts(self, touches: bool) -> Mask:
        """Return where inactive state constraints are next to their arcs or, with ``touches``, touched, (n_rows, A).

        Constraints that the direction of a vector of largest magnitude could satisfy are excluded.
        """
        active, near_contact = self.active, np.zeros_like(self.active)
        for k in range(1, self.n_subarcs):
            near_contact[:, k - 1] |= active[:, k]
            near_contact[:, k] |= active[:, k - 1]
        if touches:
            near_contact[[row for touched in self.touches for row, _ in touched]] = True
        for row in np.flatnonzero(self.orders):
            directions = [i for i in self.boundary_arc_controls[row] if not self.regular[i]]
            near_contact[row] &= ~np.any(self.arc_kind_matrix()[directions] == ArcKind.INTERIOR, axis=0)
        return np.asarray(near_contact & ~active & (np.array(self.orders) > 0)[:, None])

    def has_constraint_contact(self, subarc: int) -> bool:
        """Return whether a state constraint determines a control in a subarc."""
        return bool(np.any(self.orders * self.active[:, subarc]))

    def list_touch_times(self, row: int, kind: ArcKind) -> list[float]:
        return [t for t, touches in zip(self.times, self.touches, strict=True) if (row, kind) in touches]

    def is_at_limit(self, row: int, times: Array) -> Mask:
        """Return whether a row is at a limit, or touches it, at times (n,)."""
        subarcs = np.clip(np.searchsorted(self.times, times, "right") - 1, 0, self.n_subarcs - 1)
        before = np.clip(np.searchsorted(self.times, times, "left") - 1, 0, self.n_subarcs - 1)
        touch_times = [t for t, touches in zip(self.times, self.touches, strict=True) if row in dict(touches)]
        return np.asarray(self.active[row, subarcs] | self.active[row, before] | np.isin(times, touch_times))

    def with_switch_times(self, times: tuple[float, ...]) -> PhaseStructure:
        """Return the same sequence of arcs with other times."""
        return replace(self, times=times)

    def without_subarc(self, subarc: int) -> PhaseStructure:
        """Return the structure without a subarc; switches that cancel each other are removed, too."""
        time = 0.5 * (self.times[subarc] + self.times[subarc + 1])
        joined_touches = tuple(dict.fromkeys((*self.touches[subarc], *self.touches[subarc + 1])))
        if subarc == 0:  # touches at the free end belong to the removed subarc
            time, joined_touches = self.times[0], self.touches[0]
        elif subarc == self.n_subarcs - 1:
            time, joined_touches = self.times[-1], self.touches[-1]
        return replace(
            self,
            times=(*self.times[:subarc], time, *self.times[subarc + 2 :]),
            kinds=(*self.kinds[:subarc], *self.kinds[subarc + 1 :]),
            touches=(*self.touches[:subarc], joined_touches, *self.touches[subarc + 2 :]),
        ).merge_equal_adjacent_arcs()

    def replace_subarc_by_touch(self, subarc: int) -> PhaseStructure:
        """Return the structure without a subarc; arcs on limits of second order, or paths at an end, become touches."""
        structure, is_inner = self.without_subarc(subarc), 0 < subarc < self.n_subarcs - 1
        middle = 0.5 * (self.times[subarc] + self.times[subarc + 1])
        time = middle if is_inner else self.times[0] if subarc == 0 else self.times[-1]
        paths = range(self.n_controls, self.n_controls + self.n_paths)
        for i, (kind, order) in enumerate(zip(self.kinds[subarc], self.orders, strict=True)):
            adjacent_kinds = [self.kinds[k][i] for k in (subarc - 1, subarc + 1) if 0 <= k < self.n_subarcs]
            may_touch = order > 1 if is_inner else order > 0 and i in paths
            if may_touch and kind.is_at_limit and not any(k.is_at_limit for k in adjacent_kinds):
                structure = structure.with_touch_point(i, time, kind)
        return structure

    def with_inserted_arc(self, row: int, start: float, end: float, kind: ArcKind) -> PhaseStructure:
        """Return the structure with another kind of a row from ``start`` to ``end``, without its touches there."""
        start, end = self._snap_time_to_boundary(start), self._snap_time_to_boundary(end)
        times, kinds, touches = self._insert_boundaries(start, end)
        for k, t in enumerate(times):
            if start <= t <= end:
                touches[k] = tuple(touch for touch in touches[k] if touch[0] != row)
        is_inside = [start < 0.5 * (a + b) < end for a, b in itertools.pairwise(times)]
        columns = np.array(kinds, dtype=object)
        columns[is_inside, row] = kind
        changed = tuple(map(tuple, columns))
        return replace(self, times=times, kinds=changed, touches=tuple(touches)).merge_equal_adjacent_arcs()

    def with_touch_point(self, row: int, time: float, kind: ArcKind) -> PhaseStructure:
        """Return the structure with a touch of a row at a time."""
        time = self._snap_time_to_boundary(time)
        times, kinds, touches = self._insert_boundaries(time)
        touches[times.index(time)] += ((row, kind),)
        return replace(self, times=times, kinds=kinds, touches=tuple(touches)).merge_equal_adjacent_arcs()

    def _snap_time_to_boundary(self, time: float) -> float:
        """Return the boundary at a time, if its distance is a rounding error, else the time."""
        nearest = min(self.times, key=lambda t: abs(t - time))
        return nearest if abs(nearest - time) <= ROUNDING * (self.times[-1] - self.times[0]) else time

    def _insert_boundaries(self, *new: float) -> tuple[tuple[float, ...], Kinds, list[tuple[Touch, ...]]]:
        """Return times, kinds and touches with further boundaries between subarcs of the same kinds."""
        times, touches = tuple(sorted({*self.times, *new})), dict(zip(self.times, self.touches, strict=True))
        middles = 0.5 * (np.asarray(times[1:]) + np.asarray(times[:-1]))
        subarcs = np.clip(np.searchsorted(self.times, middles) - 1, 0, self.n_subarcs - 1)
        return times, tuple(self.kinds[k] for k in subarcs), [touches.get(t, ()) for t in times]

    def list_arcs(self, phase: str, labels: tuple[str, ...]) -> tuple[Arc, ...]:
        """Return the arcs of controls and active limits, with the labels of all rows; touches have zero length."""
        arcs = []
        fixed_controls = [self.find_controls_fixed_by_limits(k) for k in range(self.n_subarcs)]
        for i, label in enumerate(labels):
            row = [kinds[i] for kinds in self.kinds]
            if i < self.n_controls:
                pairs = zip(row, fixed_controls, strict=True)
                row = [ArcKind.CONSTRAINED if i in d and not k.is_at_limit else k for k, d in pairs]
            starts = [0, *[k for k in range(1, self.n_subarcs) if row[k] != row[k - 1]], self.n_subarcs]
            for first, last in itertools.pairwise(starts):
                kind = row[first]
                if i < self.n_controls or kind is not ArcKind.INTERIOR:
                    arcs.append(Arc(phase, label, kind, self.times[first], self.times[last]))
            for time, touches in zip(self.times, self.touches, strict=True):
                arcs += [Arc(phase, label, kind, time, time) for row, kind in touches if row == i]
        return tuple(arcs)

    def replace_arcs(self, arcs: Sequence[Arc], phase: PhaseSolution) -> PhaseStructure:
        """Return the structure with the listed arcs (inverse of `list_arcs`), unless their active limits are others."""
        labels = (*phase.controls.labels, *phase.path_labels, *phase.states.labels)
        indexed = [(labels.index(a.channel), a) for a in arcs if a.phase == phase.name]
        listed = {i for i, a in indexed if a.kind.is_at_limit and i >= self.n_controls}
        rows = range(self.n_controls, len(self.orders))
        active = {i for subarc in self.kinds for i in rows if subarc[i].is_at_limit}
        if not indexed or listed != active | {i for touches in self.touches for i, _ in touches}:
            return self
        first, last = self.times[0], self.times[-1]
        rounding = SAME_TIME * (last - first)
        inner = {t for _, a in indexed for t in (a.start, a.end) if first + rounding < t < last - rounding}
        times = (first, *sorted(inner), last)
        middles = [0.5 * (left + right) for left, right in itertools.pairwise(times)]
        # Controls that a limit determines are interior or singular.
        determined = [ArcKind.INTERIOR if regular else ArcKind.SINGULAR for regular in self.regular]
        by_subarc = [{i: a.kind for i, a in indexed if a.start < t < a.end} for t in middles]
        complete = [[known.get(i, ArcKind.INTERIOR) for i in range(len(determined))] for known in by_subarc]
        kinds = tuple(
            tuple(determined[i] if kind is ArcKind.CONSTRAINED else kind for i, kind in enumerate(known))
            for known in complete
        )
        touched = [(a.start, (i, a.kind)) for i, a in indexed if a.start == a.end]
        touches = tuple(tuple(touch for start, touch in touched if abs(start - t) <= rounding) for t in times)
        return replace(self, times=times, kinds=kinds, touches=touches).merge_equal_adjacent_arcs()

    def merge_equal_adjacent_arcs(self) -> PhaseStructure:
        """Return the structure with equal adjacent subarcs joined."""
        kinds, touches = self.kinds, self.touches
        first_subarcs = [k for k in range(len(kinds)) if k == 0 or kinds[k] != kinds[k - 1] or touches[k]]
        return replace(
            self,
            times=(*[self.times[k] for k in first_subarcs], self.times[-1]),
            kinds=tuple(kinds[k] for k in first_subarcs),
            touches=(*[touches[k] for k in first_subarcs], touches[-1]),
        )


def select_kind(condition: ArrayLike, kind: ArcKind | KindArray, otherwise: ArcKind | KindArray) -> KindArray:
    """Return ``kind`` where the condition holds and ``otherwise`` elsewhere, as an object array."""
    chosen = np.where(condition, cast(Any, kind), cast(Any, otherwise))
    return np.asarray(chosen, dtype=object)
