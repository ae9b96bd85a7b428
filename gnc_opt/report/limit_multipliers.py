"""Multipliers of active state limits and path constraints: intervals and marginal values."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.planning.optimality.costate_jumps import explain_costate_jumps
from gnc_opt.planning.solution.phase_samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.tolerances import GONE, SMALL


class ActiveLimit(NamedTuple):
    """Limit that is active over an interval; path constraints have no unit.

    ``multiplier`` is the improvement of the objective per unit by which the limit is relaxed over the interval: the
    integral of the multiplier density, and its impulses.
    """

    phase: str
    label: str
    unit: str
    limit: float
    upper: bool
    start: float
    end: float
    multiplier: float


def find_active_limits(solution: Solution) -> Iterator[ActiveLimit]:
    """Yield the active limits of states and path constraints by phase; needs the problem.

    Limits whose relaxation by the variation of their quantity changes the cost by less than `SMALL` are omitted.
    """
    for s in solution.samples().values():
        times, values, impulses = _multiplier_impulses(s)
        units = (*s.leg.states.units, *("" for _ in s.leg.path_labels))
        scales = np.concatenate([s.state_scale, s.path_scale])
        bounds = s.leg.state_bounds, s.leg.path_bounds
        lower, upper = (np.concatenate([getattr(b, side) for b in bounds]) for side in ("lower", "upper"))
        for i, label in enumerate((*s.leg.states.labels, *s.leg.path_labels)):
            for limit, sign in ((lower[i], -1), (upper[i], 1)):
                if lower[i] == upper[i] or not np.isfinite(limit):
                    continue
                effects = np.maximum(sign * impulses[i], 0.0) * scales[i] / s.cost_scale
                active = effects > np.abs(values[i] - limit) / scales[i]
                for start, end in _active_intervals(solution, s, label, sign, times[active]):
                    near = GONE * s.leg.duration
                    effect = np.sum(effects[(times >= start - near) & (times <= end + near)])
                    if effect >= SMALL:
                        multiplier = float(effect * s.cost_scale / scales[i])
                        place = float(limit), sign > 0, start, end
                        yield ActiveLimit(s.leg.name, label, units[i], *place, multiplier)


def _multiplier_impulses(s: PhaseSamples) -> tuple[Array, Array, Array]:
    """Return times, values and impulses (at points density times weight) of states and path constraints."""
    leg, inner = s.leg, s.leg.breaks[1:-1]
    pairs = zip(np.diff(leg.breaks), leg.collocation_rules, strict=True)
    weights = np.concatenate([0.5 * width * rule.weights for width, rule in pairs])
    times = np.concatenate([leg.point_times, inner])
    values = np.vstack([leg.x(times), s.functions.paths(times, leg.x(times), leg.applied(times))])
    points = np.vstack([leg.state_multipliers, leg.path_multipliers]) * weights
    jumps = np.vstack([leg.state_impulses[:, 1:-1], explain_costate_jumps(s)[1]])
    return times, values, np.hstack([points, jumps])


def _active_intervals(
    solution: Solution, s: PhaseSamples, label: str, sign: int, active: Array
) -> list[tuple[float, float]]:
    """Return the arcs at a limit, or without known arcs the segments with active times, adjacent ones joined."""
    if solution.structure:
        arcs = (
            a for a in solution.structure if (a.phase, a.channel, a.kind.sign) == (s.leg.name, label, sign)
        )
        return [(arc.start, arc.end) for arc in arcs]
    breaks = s.leg.breaks
    marked = (active >= breaks[:-1, None]) & (active <= breaks[1:, None])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.any(marked, axis=1), [0]])))
    return [(float(breaks[first]), float(breaks[last])) for first, last in edges.reshape(-1, 2)]
