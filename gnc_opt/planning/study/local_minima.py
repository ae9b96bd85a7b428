"""Local minima: comparison, merging and ranking."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import NEGLIGIBLE, NOTABLE
from gnc_opt.planning.solution.defects_and_violations import compute_state_magnitudes
from gnc_opt.planning.solution.solution import Solution


@dataclass(frozen=True)
class Minimum:
    """Local minimum.

    Attributes
    ----------
    solution : Solution
        Best of several equal solutions.
    objective : float
    hits : int
        Number of starts that led to it.
    starts : tuple of int
        Indices of these starts; 0 is the problem's own guess.
    trajectories : int
        Number of distinct trajectories with this objective, e.g. 2 for mirror images.
    coarse_objectives : tuple of float
        Objectives on the coarse mesh that led to it; one minimum may have several discretisations.
    refined : bool
        Whether the solution is refined, or from the coarse mesh.
    verdict_ok : bool
        Whether it passed the optimality check; False if not checked.

    Examples
    --------
    >>> (only,) = go.multistart(problem, n=2, seed=1, executor="serial", refine=False).minima
    >>> print(f"{only.objective:.1f}", only.starts, only.refined)
    2.0 (0, 1) False
    """

    solution: Solution
    objective: float
    hits: int
    starts: tuple[int, ...]
    trajectories: int
    coarse_objectives: tuple[float, ...]
    refined: bool = False
    verdict_ok: bool = False

    @property
    def check_result(self) -> Literal["ok", "NOT ok", "coarse"]:
        """Result of the optimality check of the objective, or "coarse" for the coarse mesh."""
        if self.verdict_ok:
            return "ok"
        return "NOT ok" if self.refined else "coarse"


def list_distinct_minima(minima: Iterable[Minimum]) -> list[Minimum]:
    """Return the distinct minima in ascending order, independent of the input order."""
    groups: list[list[Minimum]] = []
    for minimum in sorted(minima, key=_get_minimum_sort_key):
        if groups and are_objectives_equal(groups[-1][-1].objective, minimum.objective):
            groups[-1].append(minimum)
        else:
            groups.append([minimum])
    return [_merge_equal_minima(group) for group in groups]


def _get_minimum_sort_key(minimum: Minimum) -> tuple[float, int]:
    sense = -1.0 if minimum.solution.maximised else 1.0
    return sense * minimum.objective, minimum.starts[0]


def are_objectives_equal(a: float, b: float) -> bool:
    """Return whether two objectives are equal within `NEGLIGIBLE`."""
    return abs(a - b) <= NEGLIGIBLE * max(abs(a), abs(b), NEGLIGIBLE)


def _merge_equal_minima(group: Sequence[Minimum]) -> Minimum:
    """Return equal minima merged, with the most reliable solution; of several, that of the earliest start."""
    chief = min(group, key=lambda m: (not m.verdict_ok, not m.refined, m.starts[0]))
    starts = sorted(start for minimum in group for start in minimum.starts)
    return replace(
        chief,
        hits=len(starts),
        starts=tuple(starts),
        trajectories=_count_distinct_trajectories(group),
        coarse_objectives=_select_distinct_objectives(
            value for minimum in group for value in minimum.coarse_objectives
        ),
    )


def _select_distinct_objectives(objectives: Iterable[float]) -> tuple[float, ...]:
    kept: list[float] = []
    for value in sorted(objectives):
        if not (kept and are_objectives_equal(kept[-1], value)):
            kept.append(value)
    return tuple(kept)


def _count_distinct_trajectories(group: Sequence[Minimum]) -> int:
    """Return the number of distinct trajectories among equal minima, each of which may represent several."""
    samples: list[Array] = []
    for minimum in group:
        sample = _sample_state_trajectories(minimum.solution)
        if all(np.max(np.abs(sample - other)) > NOTABLE for other in samples):
            samples.append(sample)
    return max(len(samples), *(minimum.trajectories for minimum in group))


def _sample_state_trajectories(solution: Solution) -> Array:
    rows: list[Array] = []
    for phase in solution.phases.values():
        times = np.linspace(phase.initial_time, phase.final_time, 21)
        rows.append((phase.x(times) / compute_state_magnitudes(phase)[:, None]).ravel())
    return np.concatenate(rows)
