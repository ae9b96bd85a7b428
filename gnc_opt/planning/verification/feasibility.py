"""Conditions on the trajectory alone: dynamics, propagation, bounds, paths, boundary values, cost.

Whether rates of a restated phase are those that were stated: parts of controls are used one after the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import scipy

from gnc_opt.arrays import Array
from gnc_opt.planning.optimality.cost_scale import parameter_scale
from gnc_opt.planning.problem.functions import EndGradients
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.quality import (
    NOTHING,
    Worst,
    shares,
    worst_bound_violation,
    worst_defect,
    worst_index,
    worst_path_violation,
    worst_terminal_error,
)
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.solution.scales import RESOLUTION
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.verdict import Condition, ConditionResult
from gnc_opt.tolerances import ROUNDING, TINY


def worst_of_parts(problem: Problem, s: PhaseSamples) -> Worst:
    """Return by what share of its size a state is moved by parts that push at once, over a phase."""
    restatement = problem.phases[s.leg.name].restatement
    relied = () if restatement is None else restatement.filled_in_order
    worst, layout = NOTHING, s.leg.controls
    for control in s.leg.composed_controls:
        if control.name not in relied:
            continue
        parts = [s.u[layout.slice(part)] for part in control.parts]
        filled = s.u.copy()
        for part, own in zip(control.parts, control.decompose(control.compose(*parts)), strict=True):
            filled[layout.slice(part)] = np.where(np.isnan(own), filled[layout.slice(part)], own)
        rates = s.functions.rates(s.times, s.x, s.u) - s.functions.rates(s.times, s.x, filled)
        moved = np.sum(np.abs(rates) * s.weights, axis=1) / s.state_scale
        i, j = int(np.argmax(moved)), int(np.argmax(np.max(np.abs(rates), axis=0)))
        where = f"{s.place(j)}: parts of {control.name} push at once, which moves {s.leg.states.labels[i]}"
        worst = worst.or_worse(Worst(float(moved[i]), where))
    return worst


UNSTABLE = 1e6
"""Growth of integration errors beyond which propagating a whole phase in one go says nothing."""

PROPAGATION_MAX_GROWTH = 1e12
"""Growth beyond which no propagation in one go arrives: it is not tried."""

PROPAGATION_RESTART_GROWTH = 1e3
"""Growth of errors after which a propagation in parts starts anew: samples are interpolated to 1e-9 or so."""

SCANNED, SCANNED_PATHS = 4096, 32768
"""Times at which the dynamics and integrands of a phase, and its path constraints, are looked at beside the samples:
what is narrow in time or place, as a gust or a small keep-out whose constraint is flat elsewhere, leaves no hint there.
"""

_DRAWN = 1e-8
"""A phase without length is drawn a little longer than it lasts (s)."""


def judge(name: str, worst: Worst, tolerance: float, meaning: str) -> Condition:
    """Return PASS if the value is within tolerance, FAIL if not (NaN fails)."""
    result = ConditionResult.PASS if worst.value <= tolerance else ConditionResult.FAIL
    return Condition(name, result, worst.value, tolerance, worst.where, meaning)


def dynamics(problem: Problem, samples: list[PhaseSamples], tolerance: float) -> Condition:
    """The trajectory satisfies the differential equation between the nodes."""
    worst = NOTHING
    for s in samples:
        worst = worst.or_worse(worst_defect(s)).or_worse(worst_defect(s, s.finer(SCANNED)))
        worst = worst.or_worse(worst_of_parts(problem, s))
    return judge(
        "dynamics",
        worst,
        tolerance,
        "The state polynomials must satisfy dx/dt = f between the nodes too (integral of the residual over a "
        "segment, relative to the state); where they do not, refine the mesh.",
    )


def propagation(samples: list[PhaseSamples], tolerance: float) -> Condition:
    """Flying the bounded control from the initial state arrives at the final state."""
    gaps = [_missing_number(s) for s in samples]
    told = [s for s, gap in zip(samples, gaps, strict=True) if not gap]
    worst, hopeless = NOTHING, any(_may_grow(s) and _growth(s) >= PROPAGATION_MAX_GROWTH for s in told)
    for s, gap in zip(samples, gaps, strict=True) if not hopeless else ():
        worst = worst.or_worse(gap or worst_terminal_error(s))
    condition = judge(
        "propagation",
        worst,
        tolerance,
        "The control as it can be flown (within bounds), integrated from the initial state by an independent "
        "integrator, must reach the final state; where it does not, the control is wrong between its nodes.",
    )
    if condition.result is not ConditionResult.FAIL and not hopeless:
        return condition
    growth = max(map(_growth, told), default=1.0)
    if growth <= UNSTABLE:
        return condition
    parts = NOTHING
    for s, gap in zip(samples, gaps, strict=True):
        parts = parts.or_worse(gap or worst_terminal_error(s, _restarts(s)))
    return replace(
        condition,
        result=ConditionResult.PASS if parts.value <= tolerance else ConditionResult.INCONCLUSIVE,
        value=parts.value,
        where=f"{parts.where}, in parts",
        meaning=f"The dynamics amplify errors about {growth:.0e} times over the phase, so that a propagation in one go "
        f"says nothing about the solution: it starts anew wherever they have grown "
        f"{PROPAGATION_RESTART_GROWTH:.0e} times. Where such a part misses, "
        "the condition 'dynamics' judges segment by segment.",
        sufficient=True,  # a second opinion: what is necessary is told by 'dynamics'
    )


def _missing_number(s: PhaseSamples) -> Worst | None:
    """The first sample at which a number is missing: an integrator would never come back from there."""
    if not np.all(np.isfinite(s.functions.q)):
        return Worst(np.inf, "a free parameter is not finite")
    gaps = ~np.all(np.isfinite(np.vstack([s.times[None, :], s.x, s.u])), axis=0)
    return Worst(np.inf, f"{s.place(int(np.argmax(gaps)))}: not finite") if np.any(gaps) else None


def _growth(samples: PhaseSamples) -> float:
    """Return how much the linearised dynamics amplify an error over the phase at most."""
    transition, largest = np.eye(samples.state_scale.size), 1.0
    for step in _transitions(samples):
        transition = step @ transition
        largest = max(largest, float(np.linalg.norm(transition, 2)))
        if not largest < PROPAGATION_MAX_GROWTH:
            break
    return largest


def _may_grow(samples: PhaseSamples) -> bool:
    """Whether errors may grow `PROPAGATION_MAX_GROWTH` times, by the logarithmic norm of the dynamics,
    which bounds their growth."""
    jacobians, widths = _jacobians(samples)
    if not np.all(np.isfinite(jacobians)):
        return False
    steepest = np.linalg.eigvalsh(0.5 * (jacobians + jacobians.transpose(0, 2, 1)))[:, -1]
    return bool(np.sum(np.maximum(steepest * widths, 0.0)) >= np.log(PROPAGATION_MAX_GROWTH))


def _jacobians(samples: PhaseSamples) -> tuple[Array, Array]:
    """df/dx amid every segment in scaled states (K, n, n), and how long segments last (K,)."""
    leg, scale = samples.leg, samples.state_scale
    middles = 0.5 * (leg.breaks[:-1] + leg.breaks[1:])
    jacobians = samples.functions.state_jacobian(middles, leg.x(middles), leg.flown(middles))
    return (jacobians * scale[None, :, None] / scale[:, None, None]).transpose(2, 0, 1), np.diff(leg.breaks)


def _transitions(samples: PhaseSamples) -> Iterator[Array]:
    """Transition matrices exp(A h) of the segments, A = df/dx in scaled states; none where that is no number."""
    jacobians, widths = _jacobians(samples)
    if not np.all(np.isfinite(jacobians)):  # an iterate beyond a singularity of the dynamics
        return
    for jacobian, width in zip(jacobians, widths, strict=True):
        yield scipy.linalg.expm(np.clip(jacobian * width, -50.0, 50.0))


def _restarts(samples: PhaseSamples) -> list[float]:
    """Times before which errors have grown by `PROPAGATION_RESTART_GROWTH` since the start, or since the
    last of these times."""
    transition, times = np.eye(samples.state_scale.size), []
    for time, step in zip(samples.leg.breaks, _transitions(samples), strict=False):
        transition = step @ transition
        if np.linalg.norm(transition, 2) > PROPAGATION_RESTART_GROWTH:
            times.append(float(time))
            transition = step
    return [time for time in times if time > samples.leg.breaks[0]]


def bounds(solution: Solution, samples: list[PhaseSamples], tolerance: float) -> Condition:
    """States and controls stay within their bounds between the nodes, free parameters within theirs."""
    labels = [f"parameter {label}" for label in solution.free_parameters.labels]
    box = solution.need_problem("verify").parameter_interval()
    worst = _worst_miss(
        solution.parameter_values, box, parameter_scale(solution), labels, solution.free_parameters.units
    )
    for s in samples:
        worst = worst.or_worse(worst_bound_violation(s))
    return judge(
        "bounds",
        worst,
        tolerance,
        "State and control polynomials must stay within bounds between the nodes (overshoot as a share of their size). "
        "Polynomials through a switch overshoot: apply saturated_control(), with segment boundaries on the switches.",
    )


def paths(samples: list[PhaseSamples], tolerance: float) -> Condition:
    """Path constraints hold between the nodes."""
    worst = NOTHING
    for s in samples:
        worst = worst.or_worse(worst_path_violation(s))
        if s.leg.path_labels:
            worst = worst.or_worse(worst_path_violation(s, s.finer(SCANNED_PATHS)))
    return judge(
        "path constraints",
        worst,
        tolerance,
        "Path constraints, enforced at the nodes, must hold between them too (distance to what they allow, as a share "
        "of the flight's size or of the limit's width); where they do not, refine there.",
    )


def tables(solution: Solution) -> Condition:
    """The flight stays within the tables of its models."""
    worst, refused = NOTHING, False
    for out in solution.outside_tables():
        grid = out.table.grids[out.axis]
        beyond = max(grid[0] - out.value, out.value - grid[-1]) / (grid[-1] - grid[0])
        worst, refused = worst.or_worse(Worst(beyond, str(out))), refused or out.table.outside == "error"
    result = (
        ConditionResult.FAIL
        if refused
        else ConditionResult.INCONCLUSIVE
        if worst.value
        else ConditionResult.PASS
    )
    meaning = (
        "Models must be flown where their tables have data (value: how far outside, in shares of the axis): beyond, a "
        "table goes on as it was told to, and that is what is judged. FAIL if it refuses what is outside."
    )
    return Condition("tables", result, worst.value, 0.0, worst.where, meaning, sufficient=True)


def boundary(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, amounts: Array, tolerance: float
) -> Condition:
    """Initial and final values, times and boundary constraints hold.

    Parameters
    ----------
    amounts : array (n_constraints,)
        By how much the flight can change each boundary constraint (module `magnitude`).
    """
    worst = NOTHING
    for s in samples:
        leg, name = s.leg, s.leg.name
        for end, values, interval in (
            ("start", leg.x(leg.breaks[0]), leg.initial_bounds),
            ("end", leg.x(leg.breaks[-1], "left"), leg.final_bounds),
        ):
            labels = [f"phase {name}, {end}, {label}" for label in leg.states.labels]
            worst = worst.or_worse(_worst_miss(values, interval, s.end_scale, labels, leg.states.units))
        times = np.array([leg.initial_time, leg.final_time, leg.duration])
        limits = (leg.initial_time_bounds, leg.final_time_bounds, leg.duration_bounds)
        interval = Interval(
            np.concatenate([b.lower for b in limits]), np.concatenate([b.upper for b in limits])
        )
        lasts = np.full(3, s.span if s.has_length else 1.0)
        labels = [f"phase {name}, {what}" for what in ("initial time", "final time", "duration")]
        worst = worst.or_worse(_worst_miss(times, interval, lasts, labels, ("s",) * 3))
        # The times that the cost and the constraints see must be those at which the trajectory starts and ends.
        slack = _DRAWN + ROUNDING * max(abs(leg.initial_time), abs(leg.final_time))
        gaps = np.maximum(np.abs(leg.breaks[[0, -1]] - times[:2]) - slack, 0.0)
        labels = [f"phase {name}, {end} of the trajectory" for end in ("start", "end")]
        worst = worst.or_worse(
            _worst_miss(gaps, Interval(np.zeros(2), np.zeros(2)), lasts[:2], labels, ("s",) * 2)
        )
    box = solution.need_problem("verify").constraint_interval()
    labels = [f"constraint {label}" for label in solution.constraint_labels]
    worst = worst.or_worse(_worst_miss(ends.constraints, box, amounts, labels, ("",) * len(labels)))
    return judge(
        "boundary conditions",
        worst,
        tolerance,
        "Initial and final values, times, linkages and boundary constraints must hold, recomputed from the model "
        "(misses in shares of what the flight, or if less its controls, move the quantity; at least 1e-7 of its size).",
    )


def cost(
    stored: Solution, judged: list[PhaseSamples], ends: EndGradients, told: bool, tolerance: float
) -> Condition:
    """The reported cost, its integrals and their weights are those of the trajectory between its nodes."""
    amount = max((s.cost_magnitude for s in judged), default=0.0)
    yardstick = max(amount, RESOLUTION * abs(stored.objective), TINY)
    place = f"objective = {stored.objective:.10g}, not {ends.cost:.10g}"
    worst = Worst(abs(ends.cost - stored.objective) / yardstick, place)
    for s in judged:
        leg, kept = s.leg, stored.phases[s.leg.name]
        if not leg.integral_labels:
            continue
        reach = np.abs(s.functions.integrands(s.times, s.x, s.u)) @ s.weights
        finer = s.finer(SCANNED)
        again = s.functions.integrands(finer.times, finer.x, finer.u) @ finer.weights
        rows = [
            ("integral", leg.integral_weights * (kept.integrals - leg.integrals)),
            ("narrow part of integral", leg.integral_weights * (again - leg.integrals)),
        ]
        if told:
            rows.append(("weight of integral", reach * (kept.integral_weights - leg.integral_weights)))
        for what, off in rows:
            errors = np.abs(off)[None, :] / yardstick
            _, i = worst_index(errors)
            place = f"phase {leg.name}, {what} {leg.integral_labels[i]}"
            worst = worst.or_worse(Worst(float(errors[0, i]), place))
    return judge(
        "cost",
        worst,
        tolerance,
        "The objective, its integrals and their weights, recomputed from the end points and a finer quadrature along "
        "the flown control, must agree with those reported (in shares of what the flight can change the cost).",
    )


def _worst_miss(
    values: Array, interval: Interval, scale: Array, labels: Sequence[str], units: Sequence[str]
) -> Worst:
    """Return the worst excess beyond limits, in shares of a scale (n,) or of the limits' own width."""
    if not len(labels):
        return NOTHING
    excess = np.maximum(interval.lower - values, values - interval.upper)
    scale = np.maximum(scale, RESOLUTION * np.abs(values))
    offence = shares(np.maximum(excess, 0.0) / scale, interval, scale)
    offence = np.where(np.isnan(values), np.inf, offence)
    i = int(np.argmax(offence))
    if not offence[i] > 0:
        return NOTHING
    unit = f" {units[i]}" if units[i] else ""
    return Worst(float(offence[i]), f"{labels[i]} off by {excess[i]:.3g}{unit}")
