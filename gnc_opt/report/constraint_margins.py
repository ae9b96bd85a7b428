"""Limits of a solution: attained values with margins, and intervals and multipliers of active limits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from gnc_opt.array_types import Array, find_true_value_intervals
from gnc_opt.model.model_variables import Variable
from gnc_opt.numerical_tolerances import EQUAL, GONE, SMALL
from gnc_opt.planning.optimality.active_state_constraints import explain_costate_jumps
from gnc_opt.planning.problem.bounds import Interval, stack_intervals
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.plot.time_plot_axes import sample_piecewise_function

LIMIT_SAMPLES = 10_000
"""Samples of a phase at which extreme values are searched."""


class ActiveArc(NamedTuple):
    """Interval on which a limit of a component is active.

    ``multiplier`` is the improvement of the objective per unit by which the limit is relaxed over the interval: the
    integral of the multiplier density, and its impulses.
    """

    label: str
    start: float
    end: float
    multiplier: float


class LimitMargin(NamedTuple):
    """Limit of a quantity, the value of it that comes closest, and its time; a negative margin is a violation."""

    phase: str
    quantity: Variable
    upper: bool
    limit: float
    label: str
    attained: float
    time: float
    margin: float
    active: Sequence[ActiveArc] = ()


def list_limit_margins(solution: Solution) -> Iterator[LimitMargin]:
    """Yield all limits by phase, with the values that the applied control attains; needs the problem.

    Equal limits of the components of a variable are one. The lengths of directions are omitted.
    """
    problem, nowhere = solution.need_problem("list the limits of"), np.full(1, np.nan)
    for name, s in solution.samples().items():
        phase, numbers = s.phase, problem.phases[name].numbers
        (t, x), (_, u) = (sample_phase_signal(phase, signal) for signal in (phase.x, phase.applied))
        paths = [Variable(label, unit=problem.path_units()[label]) for label in phase.path_labels]
        states, arcs = phase.states.variables, _list_active_constraint_arcs(solution, s)
        lengths = {c.direction_norm_constraint_name for c in phase.vector_controls}
        initial, final = (
            [replace(v, name=f"{end} {v.name}") for v in states] for end in ("initial", "final")
        )
        times = [Variable(f"{end} time", unit=problem.time_unit) for end in ("initial", "final")]
        for quantities in (
            (states, x, t, phase.state_bounds),
            (phase.controls.variables, u, t, phase.control_bounds),
            (paths, s.functions.path_constraints(t, x, u), t, phase.path_bounds),
            (initial, x[:, :1], t[:1], numbers.initial),
            (final, x[:, -1:], t[-1:], numbers.final),
            (times, t[[0, -1], None], nowhere, stack_intervals(problem.phases[name].time_ranges())),
        ):
            for found in _list_component_limit_margins(name, *quantities):
                side = found.upper, found.limit
                mine = [arc for key, arc in arcs if key == side and arc.label in found.quantity.labels]
                if found.label not in lengths:
                    yield found._replace(active=mine)
    rows, free = [Variable(label) for label in solution.constraint_labels], solution.free_parameters
    for variables, values, box in (
        (rows, solution.constraint_values, problem.get_boundary_constraint_bounds()),
        (free.variables, solution.parameter_values, problem.get_parameter_bounds()),
    ):
        yield from _list_component_limit_margins("", variables, values[:, None], nowhere, box)


def sample_phase_signal(phase: PhaseSolution, signal: Callable[..., Any]) -> tuple[Array, Array]:
    """Return times and values (n, n_times) of a signal for extreme values, with both limits at each breakpoint."""
    jumps = phase.applied.jump_times
    return sample_piecewise_function(signal, jumps, max(24, LIMIT_SAMPLES // jumps.size))


def _list_component_limit_margins(
    phase: str, variables: Sequence[Variable], values: Array, times: Array, box: Interval
) -> Iterator[LimitMargin]:
    """Yield the limits of stacked variables; the components with the same limit are one."""
    start = 0
    for v in variables:
        at, start = slice(start, start + v.size), start + v.size
        tie = EQUAL * float(np.max(np.abs(values[at])))
        for bounds, sign in ((box.lower[at], -1), (box.upper[at], 1)):
            for limit in np.unique(bounds[np.isfinite(bounds) & (box.lower[at] < box.upper[at])]):
                gaps = np.where((bounds == limit)[:, None], sign * (limit - values[at]), np.inf)
                close = max(tie, EQUAL * abs(limit))
                i, k = np.unravel_index(np.argmax(gaps <= np.min(gaps) + close), gaps.shape)
                margin = gaps[i, k] if abs(gaps[i, k]) > close else 0.0
                value = values[at][i, k] if abs(values[at][i, k]) > tie else 0.0
                numbers = float(value), float(times[k]), float(margin)
                yield LimitMargin(phase, v, sign > 0, float(limit), v.labels[i], *numbers)


def _list_active_constraint_arcs(
    solution: Solution, s: PhaseSamples
) -> list[tuple[tuple[bool, float], ActiveArc]]:
    """Return side and limit, and the active arc, of states, path constraints and controls.

    Limits whose relaxation by the variation of their quantity changes the cost by less than `SMALL` are omitted.
    """
    found, (times, values, impulses) = [], _compute_multiplier_impulses(s)
    scales = np.concatenate([s.state_scale, s.path_scale, s.control_scale])
    box = stack_intervals([s.phase.state_bounds, s.phase.path_bounds, s.phase.control_bounds])
    near = GONE * s.phase.duration
    for i, label in enumerate((*s.phase.states.labels, *s.phase.path_labels, *s.phase.controls.labels)):
        for limit, sign in ((box.lower[i], -1), (box.upper[i], 1)):
            if box.is_fixed[i] or not np.isfinite(limit):
                continue
            effects = np.maximum(sign * impulses[i], 0.0) * scales[i] / s.cost_scale
            active = effects > np.abs(values[i] - limit) / scales[i]
            for start, end in _find_active_constraint_intervals(solution, s, label, sign, times[active]):
                effect = np.sum(effects[(times >= start - near) & (times <= end + near)])
                if effect >= SMALL:
                    multiplier = float(effect * s.cost_scale / scales[i])
                    found.append(((sign > 0, float(limit)), ActiveArc(label, start, end, multiplier)))
    return found


def _compute_multiplier_impulses(s: PhaseSamples) -> tuple[Array, Array, Array]:
    """Return times, values and impulses (at points density times weight) in the order of the arcs."""
    phase, inner = s.phase, s.phase.breaks[1:-1]
    times = np.concatenate([phase.point_times, inner])
    x, u = phase.x(times), phase.applied(times)
    values = np.vstack([x, s.functions.path_constraints(times, x, u), u])
    points = np.vstack([phase.state_multipliers, phase.path_multipliers, phase.control_multipliers])
    of_controls = np.zeros((phase.controls.size, inner.size))
    jumps = np.vstack([phase.state_impulses[:, 1:-1], explain_costate_jumps(s)[1], of_controls])
    return times, values, np.hstack([points * phase.point_weights, jumps])


def _find_active_constraint_intervals(
    solution: Solution, s: PhaseSamples, label: str, sign: int, active: Array
) -> list[tuple[float, float]]:
    """Return the arcs at a limit, or without known arcs the segments with active times, adjacent ones joined."""
    if solution.structure:
        arcs = (
            a for a in solution.structure if (a.phase, a.channel, a.kind.sign) == (s.phase.name, label, sign)
        )
        return [(arc.start, arc.end) for arc in arcs]
    breaks = s.phase.breaks
    marked = (active >= breaks[:-1, None]) & (active <= breaks[1:, None])
    runs = find_true_value_intervals(np.any(marked, axis=1))
    return [(float(breaks[first]), float(breaks[last])) for first, last in runs]
