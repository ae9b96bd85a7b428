"""How good a trajectory is between its nodes: three numbers that do not come from the solver."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.solution.defined import defined
from gnc_opt.solution.distance import bound_offences, path_offences
from gnc_opt.solution.limits import Limits, violations
from gnc_opt.solution.propagation import propagate
from gnc_opt.solution.samples import PhaseSamples


@dataclass(frozen=True)
class Quality:
    """Independent figures of a trajectory.

    Attributes
    ----------
    max_defect : float
        Largest integral over a segment of |dx/dt - f(t, x, u)|, jump to the next segment included, in shares of what
        the state moves.
    max_bound_violation : float
        Farthest that states and controls are beyond a bound or path constraint, at nodes and between, as a share of
        the flight's size or of the limit's own width (docs/theory/scales.md, "How far beyond a limit").
    terminal_error : float
        Largest miss at the end of a phase when the flown control is integrated from its initial state, in shares of
        what the controls move the state.
    defect_where, bound_where, terminal_where : str
        Places of the three.

    Examples
    --------
    >>> print(solution.quality.max_defect < 1e-9, solution.quality.terminal_error < 1e-9)
    True True
    """

    max_defect: float
    defect_where: str
    max_bound_violation: float
    bound_where: str
    terminal_error: float
    terminal_where: str


@dataclass(frozen=True)
class Worst:
    """A number and where it occurs."""

    value: float
    where: str

    def or_worse(self, other: Worst) -> Worst:
        """Return the larger one; NaN counts as larger."""
        return self if np.isnan(self.value) or other.value <= self.value else other


NOTHING = Worst(0.0, "nowhere")


def measure_quality(samples: Iterable[PhaseSamples]) -> Quality:
    """Measure all phases of a solution."""
    defect = bound = terminal = NOTHING
    for s in samples:
        defect = defect.or_worse(worst_defect(s))
        bound = bound.or_worse(worst_bound_violation(s)).or_worse(worst_path_violation(s))
        terminal = terminal.or_worse(worst_terminal_error(s))
    return Quality(defect.value, defect.where, bound.value, bound.where, terminal.value, terminal.where)


def worst_defect(samples: PhaseSamples, at: PhaseSamples | None = None) -> Worst:
    """Return the worst defect between nodes, along the control polynomial, or jump between segments.

    It is looked for at ``samples``, or ``at`` others of the same phase.
    """
    at = samples if at is None else at
    rates = defined(at.functions.rates, at.times, at.x, at.u_polynomial, at.leg.control_bounds)
    errors = at.per_segment(at.x_rate - rates) / samples.state_scale[:, None]
    leg, inner = samples.leg, samples.leg.breaks[1:-1]
    if inner.size:
        errors[:, :-1] += np.abs(leg.x(inner, "right") - leg.x(inner, "left")) / samples.state_scale[:, None]
    i, k = worst_index(errors)
    return Worst(float(errors[i, k]), samples.segment_place(k, leg.states.labels[i]))


def worst_bound_violation(samples: PhaseSamples) -> Worst:
    """Return the worst overshoot of state and control bounds by their polynomials, between samples too."""
    leg, worst = samples.leg, NOTHING
    for signals, bounds, labels in (
        (_states, leg.state_bounds, leg.states.labels),
        (_controls, leg.control_bounds, leg.controls.labels),
    ):
        found = violations(samples, Limits.of(signals, bounds))
        if found.times.size:
            scale = samples.state_scale if signals is _states else samples.control_scale
            offences = bound_offences(found, bounds, scale)
            i = int(np.argmax(offences))
            place = samples.place_at(found.times[i], labels[found.limits.rows[i]])
            worst = worst.or_worse(Worst(float(offences[i]), place))
    return worst


def worst_path_violation(samples: PhaseSamples, at: PhaseSamples | None = None) -> Worst:
    """Return the worst violation of a path constraint along the control polynomial, between samples too.

    It is looked for from ``samples``, or from others of the same phase (``at``).
    """
    leg = samples.leg
    if not leg.path_labels:
        return NOTHING
    found = violations(samples if at is None else at, Limits.of(samples.functions.paths, leg.path_bounds))
    if not found.times.size:
        return NOTHING
    offences = path_offences(found, samples)
    i = int(np.argmax(offences))
    what = f"{leg.path_labels[found.limits.rows[i]]} = {found.value(i)}"
    return Worst(float(offences[i]), samples.place_at(found.times[i], what))


def worst_terminal_error(samples: PhaseSamples, anew: Sequence[float] = ()) -> Worst:
    """Return the worst final miss of the flown control, or of the parts between times at which it starts anew."""
    leg = samples.leg
    run = propagate(leg, samples.functions, anew=anew)
    misses = np.abs(run.error) / samples.end_scale
    i = int(np.argmax(misses))
    unit = leg.states.units[i]
    miss = f"{leg.states.labels[i]} misses by {abs(run.error[i]):.3g}{f' {unit}' if unit else ''}"
    where = f"phase {leg.name}, {run.ended or miss}"
    return Worst(float(misses[i]), where)


def worst_index(values: Array) -> tuple[int, int]:
    """Return row and column of the largest entry; NaN counts as largest."""
    flat = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
    row, column = np.unravel_index(flat, values.shape)
    return int(row), int(column)


def _states(_: Array, x: Array, __: Array) -> Array:
    return x


def _controls(_: Array, __: Array, u: Array) -> Array:
    return u
