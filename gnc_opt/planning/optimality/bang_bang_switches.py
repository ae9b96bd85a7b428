"""Switches of a bang-bang control as unknowns, and the possible orders of simultaneous ones."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gnc_opt.array_types import Array, Indices
from gnc_opt.numerical_tolerances import AT_LIMIT, GONE, NEGLIGIBLE
from gnc_opt.planning.optimality.bang_bang_sensitivity import PiecewiseControl
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples


@dataclass(frozen=True)
class Switches:
    """Switches of a phase, including possible switches at its ends.

    If a switching function is zero at a phase end, a switch there is an unknown, with an arc of zero length. ``times``
    (n,) ascend, simultaneous ones are equal (s); ``channels`` (n,) are their controls. ``first`` (n_controls,) are the
    controls before the first switch, ``toggled`` (n_controls,) the sums of both bounds: minus the control they are the
    control after a switch. ``ends`` (2,) are those of the phase (s).
    """

    times: Array
    channels: Indices
    first: Array
    ends: Array
    toggled: Array
    labels: tuple[str, ...]

    @classmethod
    def from_samples(cls, s: PhaseSamples) -> Switches:
        """Return the switches of a phase whose controls are at bounds everywhere."""
        leg = s.leg
        times, channels = find_bound_to_bound_switches(s)
        ends = leg.breaks[[0, -1]]
        at_start, at_end = _find_controls_at_switching_zeros(s, 0), _find_controls_at_switching_zeros(s, -1)
        times = np.concatenate([np.full(at_start.size, ends[0]), times, np.full(at_end.size, ends[1])])
        channels = np.concatenate([at_start, channels, at_end])
        order = np.argsort(times, kind="stable")
        times = _equalise_nearby_switch_times(times[order], GONE * (ends[1] - ends[0]), ends)
        channels = channels[order]
        bounds, after_start = leg.control_bounds, leg.applied(leg.breaks[0])
        at_upper = after_start - bounds.lower > bounds.upper - after_start
        first = np.where(at_upper, bounds.upper, bounds.lower)
        toggled = bounds.lower + bounds.upper
        first[at_start] = toggled[at_start] - first[at_start]
        labels = tuple(
            f"switch of {leg.controls.labels[i]} at {s.describe_times(t)}"
            for i, t in zip(channels, times, strict=True)
        )
        return cls(times, channels, first, ends, toggled, labels)

    @property
    def simultaneous_switch_groups(self) -> list[list[int]]:
        groups = itertools.groupby(range(self.times.size), key=lambda k: self.times[k])
        return [list(group) for _, group in groups]

    @property
    def time_sorted_order(self) -> tuple[int, ...]:
        return tuple(int(k) for k in np.argsort(self.times, kind="stable"))

    @property
    def n_switch_orders(self) -> int:
        """Number of possible orders of the switches."""
        return math.prod(math.factorial(len(group)) for group in self.simultaneous_switch_groups)

    def list_switch_orders(self) -> Iterator[tuple[int, ...]]:
        """Yield all possible orders of the switches."""
        for choice in itertools.product(
            *(itertools.permutations(group) for group in self.simultaneous_switch_groups)
        ):
            yield tuple(itertools.chain.from_iterable(choice))

    def build_piecewise_control(self, order: tuple[int, ...]) -> PiecewiseControl:
        """Return the piecewise constant control for a given order of the switches.

        Unknowns are the start (0), the switches (1 to n) and the end (n + 1).
        """
        controls = [self.first]
        for k in order:
            controls.append(controls[-1].copy())
            controls[-1][self.channels[k]] = self.toggled[self.channels[k]] - controls[-1][self.channels[k]]
        places = [0, *(1 + k for k in order), self.times.size + 1]
        times = np.concatenate([self.ends[:1], self.times[list(order)], self.ends[1:]])
        return PiecewiseControl(times, np.stack(controls, axis=1), np.asarray(places))

    def build_order_constraints(self, order: tuple[int, ...]) -> Array:
        """Return the combinations of unknowns that must be >= 0 for the order to hold, (n_conditions, n + 2)."""
        pieces = self.build_piecewise_control(order)
        rows = []
        for k in np.flatnonzero(np.diff(pieces.times) == 0):
            row = np.zeros(self.times.size + 2)
            row[pieces.unknowns[[k, k + 1]]] = -1.0, 1.0
            rows.append(row)
        return np.array(rows).reshape(-1, self.times.size + 2)


def find_bound_to_bound_switches(s: PhaseSamples) -> tuple[Array, Indices]:
    """Return times (s) and controls of the bound-to-bound jumps at segment boundaries."""
    leg = s.leg
    breaks = leg.breaks[1:-1]
    jumps = np.abs(leg.applied(breaks) - leg.applied(breaks, "left"))
    span = leg.control_bounds.upper - leg.control_bounds.lower
    with np.errstate(invalid="ignore"):
        switched = jumps > (1 - AT_LIMIT) * span[:, None]
    switched &= (np.isfinite(span) & (span > 0))[:, None]
    k, i = np.nonzero(switched.T)
    return breaks[k], i


def _find_controls_at_switching_zeros(s: PhaseSamples, sample: int) -> Indices:
    bounds = s.leg.control_bounds
    worth = np.abs(s.control_gradient[:, sample]) * s.control_scale / s.hamiltonian_scale
    return np.flatnonzero((worth < NEGLIGIBLE) & (bounds.upper > bounds.lower))


def _equalise_nearby_switch_times(times: Array, near: float, ends: Array) -> Array:
    """Return sorted times with nearly equal ones made equal, including the ends."""
    times = times.copy()
    for k in range(1, times.size):
        if times[k] - times[k - 1] < near:
            times[k] = times[k - 1]
    times[times - ends[0] < near] = ends[0]
    times[ends[1] - times < near] = ends[1]
    return times
