"""Accuracy of an answer in the user's units: objective, limits, ends.

The applied (saturated) control is integrated from the initial state of every phase by DOP853, independently of the
collocation. Along that trajectory limits are evaluated at the samples, and a peak between them is that of the
polynomial through five of them. The error of the objective is an estimate (module `objective_error`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy

from gnc_opt.arrays import Array
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.propagation import integrate_to
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.tolerances import ROUNDING

PEAK_SEARCH_TIMES = 201
"""Times between neighbouring samples at which a peak is looked for."""


@dataclass(frozen=True)
class Accuracy:
    """How far an answer is from the optimum, from its limits and from its ends.

    Attributes
    ----------
    objective : float
    objective_error : float
        Estimated, in the unit of the objective; infinite if it has no value.
    violation : float
        Largest violation of a state limit or path constraint by the trajectory of the applied control, in the
        limit's own unit; 0 if none exceeds rounding. Of several, the largest in shares of what the quantity moves.
    violation_where : str
        Its place, quantity and unit.
    miss : float
        Largest difference at the end of a phase between that trajectory and the solution's, in the state's unit;
        infinite if there is no such trajectory. Of several, the largest in shares of what the state moves.
    miss_where : str

    Examples
    --------
    >>> accuracy = solution.accuracy
    >>> print(accuracy.objective_error < 1e-6, accuracy.miss < 1e-9, accuracy.violation)
    True True 0.0
    """

    objective: float
    objective_error: float
    violation: float
    violation_where: str
    miss: float
    miss_where: str

    @property
    def text(self) -> str:
        """Accuracy of ends and limits: "final state within 2e-12 m/s; limits satisfied"."""
        ends = (
            f"final state within {self.miss:.1g}{_unit_of(self.miss_where)}"
            if np.isfinite(self.miss)
            else "the applied control does not reach the end"
        )
        limits = f"limits exceeded by {self.violation:.1g}{_unit_of(self.violation_where)}"
        return f"{ends}; {limits if self.violation else 'limits satisfied'}"

    def __str__(self) -> str:
        return f"objective ± {self.objective_error:.1g}; {self.text}"


def measure_accuracy(samples: Iterable[PhaseSamples], objective: float, objective_error: float) -> Accuracy:
    """Measure all phases of a solution."""
    worst, missed = (0.0, 0.0, ""), (0.0, 0.0, "")
    for s in samples:
        x = integrate_to(s.leg, s.functions, s.times)
        missed = max(missed, _largest_miss(s, x), key=_accuracy_share)
        values = s.functions.paths(s.times, x, s.u)
        units = s.leg.states.units
        for rows, box, scale, labels in (
            (
                x,
                s.leg.state_bounds,
                s.state_scale,
                [f"{n} ({u})" if u else n for n, u in _named_quantity(s.leg, units)],
            ),
            (values, s.leg.path_bounds, s.path_scale, list(s.leg.path_labels)),
        ):
            worst = max(worst, _largest_violation(s, rows, box, scale, labels), key=_accuracy_share)
    return Accuracy(objective, objective_error, worst[1], worst[2], missed[1], missed[2])


def _named_quantity(leg: PhaseSolution, units: Iterable[str]) -> list[tuple[str, str]]:
    return list(zip(leg.states.labels, units, strict=True))


def _accuracy_share(found: tuple[float, float, str]) -> float:
    return found[0]


def _largest_miss(s: PhaseSamples, x: Array) -> tuple[float, float, str]:
    """Return share, size and place of the largest miss at the end of a phase."""
    error = np.abs(x[:, -1] - s.leg.x(s.leg.breaks[-1], "left"))
    if not np.all(np.isfinite(error)):
        return np.inf, np.inf, f"phase {s.leg.name}"
    i = int(np.argmax(error / s.end_scale))
    unit = s.leg.states.units[i]
    label = f"phase {s.leg.name}, {s.leg.states.labels[i]}{f' ({unit})' if unit else ''}"
    return float(error[i] / s.end_scale[i]), float(error[i]), label


def _largest_violation(
    s: PhaseSamples, values: Array, box: Interval, scale: Array, labels: list[str]
) -> tuple[float, float, str]:
    """Return share, size and place of the largest violation of limits on values (n, n_samples)."""
    if not labels:
        return 0.0, 0.0, ""
    with np.errstate(invalid="ignore"):
        excess = np.maximum(box.lower[:, None] - values, values - box.upper[:, None])
    excess = np.where(np.isfinite(values), excess, -np.inf)
    limits = np.minimum(*(np.abs(np.where(np.isfinite(b), b, 0.0)) for b in (box.lower, box.upper)))
    i, j = np.unravel_index(int(np.argmax(excess / scale[:, None])), excess.shape)
    peak = _parabola_peak(s, excess[i], int(j))
    if not peak > ROUNDING * max(float(limits[i]), float(scale[i])):
        return 0.0, 0.0, ""
    return peak / float(scale[i]), peak, s.place(int(j), labels[i])


def _parabola_peak(s: PhaseSamples, excess: Array, j: int) -> float:
    """Return the peak of the polynomial through a sample and its neighbours in the same segment, up to two a side."""
    around = np.arange(max(j - 2, 0), min(j + 3, excess.size))
    around = around[(s.segments[around] == s.segments[j]) & np.isfinite(excess[around])]
    t = s.times[around] - s.times[j]
    if around.size < 3 or np.any(np.diff(t) <= 0):
        return float(excess[j])
    fine = np.linspace(t[0], t[-1], PEAK_SEARCH_TIMES)
    shape = scipy.interpolate.BarycentricInterpolator(t / t[-1] if t[-1] else t, excess[around])
    return float(max(excess[j], np.max(shape(fine / t[-1] if t[-1] else fine))))


def _unit_of(where: str) -> str:
    """Return " m" of "phase leg, q (m)"."""
    return f" {where.rpartition('(')[2][:-1]}" if where.endswith(")") else ""
