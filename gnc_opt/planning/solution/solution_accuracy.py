"""Accuracy of a solution: objective, limits and final states in their units, and defects.

The applied (saturated) control is integrated from the initial state of every phase by DOP853, independently of the
collocation. Limits are evaluated along that trajectory at Chebyshev points between the jumps of the control.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import itemgetter

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import ROUNDING, zero_nonfinite
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.solution.defects_and_violations import NOTHING, find_worst_defect
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.propagation import integrate_states_to_times
from gnc_opt.planning.transcription.quadrature import build_lagrange_matrix

POINTS_PER_PIECE = 12
"""Number of points between two jumps of the control, including the ends."""

PIECE_POINTS = -np.cos(np.pi * np.arange(POINTS_PER_PIECE) / (POINTS_PER_PIECE - 1))
"""These points on [-1, 1]."""

PEAK_SEARCH_TIMES = 401
"""Number of times between two jumps at which the polynomial is evaluated to find a peak."""


@dataclass(frozen=True)
class Accuracy:
    """Error estimate of the objective, violation of limits, and error of the final states.

    Attributes
    ----------
    objective : float
    objective_error : float
        Estimate, not a bound, in the unit of the objective: at least its rounding error (1e-15 of it); infinite without
        a value.
    violation : float
        Largest violation of a state limit or path constraint along the trajectory of the applied control, in the unit
        of the limit; 0 at rounding level. The largest is selected relative to the variation of the quantity.
    violation_where : str
        Location, quantity and unit of the violation.
    miss : float
        Largest difference of the final state of that trajectory from that of the solution, or from its bounds, over all
        phases, in the unit of the state; infinite without a trajectory. Selected relative to the state's variation.
    miss_where : str
    defect : float
        Largest integral over a segment of |dx/dt - f(t, x, u)|, including the jump to the next segment, relative to the
        variation of the state along the phase.
    defect_where : str

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
    defect: float
    defect_where: str

    @property
    def summary_text(self) -> str:
        """Accuracy of final states and limits: "final state within 2e-12 m/s; limits satisfied"."""
        ends = (
            f"final state within {self.miss:.1g}{_extract_unit_from_label(self.miss_where)}"
            if np.isfinite(self.miss)
            else "the applied control does not reach the end"
        )
        limits = f"limits exceeded by {self.violation:.1g}{_extract_unit_from_label(self.violation_where)}"
        return f"{ends}; {limits if self.violation else 'limits satisfied'}"

    def __str__(self) -> str:
        return f"objective ± {self.objective_error:.1g}; {self.summary_text}"


def measure_solution_accuracy(
    samples: Iterable[PhaseSamples], objective: float, objective_error: float
) -> Accuracy:
    worst, missed, defect = (0.0, 0.0, ""), (0.0, 0.0, ""), NOTHING
    for s in samples:
        defect = defect.select_larger(find_worst_defect(s))
        leg, pieces = s.leg, _sample_control_pieces(s)
        labels = [f"{n} ({u})" if u else n for n, u in zip(leg.states.labels, leg.states.units, strict=True)]
        x = integrate_states_to_times(leg, s.functions, pieces.ravel())
        missed = max(missed, _find_largest_end_error(s, x[:, -1], labels), key=itemgetter(0))
        paths = s.functions.path_constraints(pieces.ravel(), x, _sample_applied_controls(s, pieces))
        of_states = _find_limit_violation(s, pieces, x, leg.state_bounds, s.state_scale, labels)
        of_paths = _find_limit_violation(s, pieces, paths, leg.path_bounds, s.path_scale, leg.path_labels)
        worst = max(worst, of_states, of_paths, key=itemgetter(0))
    error = max(objective_error, 5 * float(np.finfo(float).eps) * abs(objective))
    return Accuracy(objective, error, *worst[1:], *missed[1:], defect.value, defect.where)


def _find_largest_end_error(s: PhaseSamples, end: Array, labels: Sequence[str]) -> tuple[float, float, str]:
    """Return relative size, size and location of the largest error at the end of a phase."""
    leg, box = s.leg, s.leg.final_bounds
    error = np.max([np.abs(end - leg.x(leg.breaks[-1], "left")), box.lower - end, end - box.upper], axis=0)
    if not np.all(np.isfinite(error)):
        return np.inf, np.inf, f"phase {leg.name}"
    i = int(np.argmax(error / s.state_scale))
    return float(error[i] / s.state_scale[i]), float(error[i]), f"phase {leg.name}, {labels[i]}"


def _sample_control_pieces(s: PhaseSamples) -> Array:
    """Return the points of each piece between two jumps of the control (n_pieces, POINTS_PER_PIECE)."""
    edges = s.leg.applied.jump_times
    times = edges[:-1, None] + 0.5 * (1 + PIECE_POINTS) * np.diff(edges)[:, None]
    times[:, -1] = edges[1:]  # exact
    return np.asarray(times)


def _sample_applied_controls(s: PhaseSamples, pieces: Array) -> Array:
    """Return the applied control (m, n_pieces * POINTS_PER_PIECE), at the end of a piece with its left limit."""
    u = s.leg.applied(pieces.ravel())
    u[:, POINTS_PER_PIECE - 1 :: POINTS_PER_PIECE] = s.leg.applied(pieces[:, -1], "left")
    return np.asarray(u)


def _find_limit_violation(
    s: PhaseSamples, pieces: Array, values: Array, box: Interval, scale: Array, labels: Sequence[str]
) -> tuple[float, float, str]:
    """Return relative size, size and location of the largest violation by values (n, n_pieces * POINTS_PER_PIECE)."""
    if not labels:
        return 0.0, 0.0, ""
    with np.errstate(invalid="ignore"):
        excess = np.maximum(box.lower[:, None] - values, values - box.upper[:, None])
    excess = np.where(np.isfinite(values), excess, -np.inf)
    limits = np.minimum(*(np.abs(zero_nonfinite(b)) for b in (box.lower, box.upper)))
    i, j = np.unravel_index(int(np.argmax(excess / scale[:, None])), excess.shape)
    piece = values[i].reshape(pieces.shape)[j // POINTS_PER_PIECE]
    tau = np.linspace(-1.0, 1.0, PEAK_SEARCH_TIMES)
    curve = np.append(piece, build_lagrange_matrix(PIECE_POINTS, tau) @ piece)
    beyond = np.maximum(box.lower[i] - curve, curve - box.upper[i])
    peak = float(np.max(beyond, where=np.isfinite(curve), initial=-np.inf))
    if not peak > ROUNDING * max(float(limits[i]), float(scale[i])):
        return 0.0, 0.0, ""
    return peak / float(scale[i]), peak, s.describe_time(float(pieces.ravel()[j]), labels[int(i)])


def _extract_unit_from_label(where: str) -> str:
    """Return " m" from "phase leg, q (m)"."""
    return f" {where.rpartition('(')[2][:-1]}" if where.endswith(")") else ""
