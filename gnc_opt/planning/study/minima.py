"""Local minima and which of them are the same.

Reflections: a trajectory that passes a straight line on one side may have a neighbour on the other side.

About the straight line between the ends of a trajectory, many dynamics fall into parts that are nearly independent of
each other: pitch, and roll with yaw; motion in the plane of an orbit, and across it. Where such a part does not change
if it is turned round, one minimum has a mirror twin; where ends or small couplings break that symmetry, twins are
minima of different cost. Random starts find one of them more often than the other, a reflection leads to that.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gnc_opt.arrays import Array, Mask
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.propagation import state_magnitudes
from gnc_opt.planning.solution.solution import Solution

STRONG = 0.3
"""A variable is coupled with another that it moves, along the phase, by this share of its size, and by this share of
what the strongest one does."""

FRACTIONS = np.linspace(0.0, 1.0, 65)
"""Where trajectories are reflected."""

Labels = frozenset[str]
"""Of states and controls, components one by one, that are reflected together."""


@dataclass(frozen=True)
class Reflection:
    """A reflection: the labels of the reflected states and controls along a solution, without its problem."""

    solution: Solution
    labels: Labels

    def guess(self, problem: Problem) -> Problem:
        """Return the problem with the reflected trajectory as its guess."""
        for name, leg in self.solution.phases.items():
            line, middle = _line(leg), _middle(leg)
            times = leg.initial_time + FRACTIONS * leg.duration
            turned = [
                np.array([label in self.labels for label in layout.labels], dtype=bool)[:, None]
                for layout in (leg.states, leg.controls)
            ]
            states = np.where(turned[0], 2 * line - leg.x(times), leg.x(times))
            controls = np.where(turned[1], 2 * middle - leg.u(times), leg.u(times))
            values = {
                key: np.clip(rows, box.lower[:, None], box.upper[:, None])[layout.slice(key)]
                for layout, rows, box in (
                    (leg.states, states, leg.state_bounds),
                    (leg.controls, controls, leg.control_bounds),
                )
                for key in layout.names
            }
            problem = problem.with_guess(name, time=times, **values)
        free, found = self.solution.free_parameters, self.solution.parameter_values
        return problem.with_parameter_guess(**{name: found[free.slice(name)] for name in free.names})


class Reflections:
    """Which reflections of known minima are still to be tried."""

    def __init__(self) -> None:
        self._tried: list[tuple[float, Labels]] = []

    def of(self, problem: Problem, minima: Sequence[Minimum], room: int) -> list[Reflection]:
        """Return at most so many: first those of what bends most, and of these the ones of the best minima."""
        found = [
            (place, rank, labels)
            for rank, minimum in enumerate(minima)
            for place, labels in enumerate(bent(minimum.solution.with_problem(problem)))
            if not any(equal(value, minimum.objective) and labels == old for value, old in self._tried)
        ]
        chosen = sorted(found, key=lambda item: item[:2])[:room]
        self._tried += [(minima[rank].objective, labels) for _, rank, labels in chosen]
        return [Reflection(minima[rank].solution, labels) for _, rank, labels in chosen]


def bent(solution: Solution) -> list[Labels]:
    """Return the parts of a solution that are not straight between their ends; what bends most comes first."""
    bends: dict[str, float] = {}
    for leg in solution.phases.values():
        away = np.abs(leg.x(leg.initial_time + FRACTIONS * leg.duration) - _line(leg))
        shares = np.max(away, axis=1) / state_magnitudes(leg)
        for label, share in zip(leg.states.labels, shares, strict=True):
            bends[label] = max(bends.get(label, 0.0), float(share))
    worth = {part: max(bends.get(label, 0.0) for label in part) for part in parts(solution)}
    return sorted((p for p in worth if worth[p] > SAME_TRAJECTORY), key=lambda p: (-worth[p], min(p)))


def parts(solution: Solution) -> list[Labels]:
    """Return the parts that the dynamics fall into along the straight line between the ends of every phase."""
    found: list[Labels] = []
    for pair in _couplings(solution):
        touched = [part for part in found if part & pair]
        found = [part for part in found if not part & pair] + [pair.union(*touched)]
    return found


def _couplings(solution: Solution) -> Iterator[Labels]:
    """Yield every label alone, and every pair of which one moves the other."""
    for name, leg in solution.phases.items():
        labels = (*leg.states.labels, *leg.controls.labels)
        yield from (frozenset({label}) for label in labels)
        slopes = _slopes(solution, name, leg)
        for i, row in enumerate(slopes):
            others = np.delete(row, i)
            most = np.max(others[np.isfinite(others)], initial=0.0)
            strong = (row > STRONG * max(most, 1.0)) | ~np.isfinite(row)
            yield from (frozenset({labels[i], labels[j]}) for j in np.flatnonzero(strong))


def _slopes(solution: Solution, name: str, leg: PhaseSolution) -> Array:
    """How far each state and control may move each state along the phase (n_states, n_states + n_controls)."""
    functions = solution.functions(name)
    at = (leg.initial_time + FRACTIONS * leg.duration, _line(leg), np.tile(_middle(leg), FRACTIONS.size))
    jacobian = np.concatenate([functions.state_jacobian(*at), functions.input_jacobian(*at)], axis=1)
    sizes = state_magnitudes(leg)
    reach = np.concatenate([sizes, _reach(leg)])
    return np.asarray(np.max(np.abs(jacobian), axis=2) * reach * leg.duration / sizes[:, None])


def _line(leg: PhaseSolution) -> Array:
    first, last = leg.x(np.array([leg.initial_time, leg.final_time])).T
    return np.asarray(first[:, None] + (last - first)[:, None] * FRACTIONS)


def _middle(leg: PhaseSolution) -> Array:
    """The middle of a control's bounds, or its mean along the phase where it has none, (n_controls, 1)."""
    bounded = _bounded(leg)
    return np.where(bounded, np.where(bounded, leg.control_bounds.middle, 0.0), _mean(leg))[:, None]


def _reach(leg: PhaseSolution) -> Array:
    """How far a control goes from there (n_controls,)."""
    bounds, free = leg.control_bounds, np.concatenate(leg.u.values, axis=1) - _mean(leg)[:, None]
    with np.errstate(invalid="ignore"):
        return np.where(_bounded(leg), 0.5 * (bounds.upper - bounds.lower), np.max(np.abs(free), axis=1))


def _bounded(leg: PhaseSolution) -> Mask:
    return np.asarray(np.isfinite(leg.control_bounds.lower) & np.isfinite(leg.control_bounds.upper))


def _mean(leg: PhaseSolution) -> Array:
    """Over the collocation points: polynomials may run away between a kink and an end."""
    return np.asarray(np.concatenate(leg.u.values, axis=1).mean(axis=1))


SAME_MINIMUM_TOLERANCE = 1e-6
"""Relative difference of the objective below which two minima are one."""

SAME_TRAJECTORY = 1e-2
"""Difference of two trajectories, in shares of the states' magnitudes, beyond which they are distinct."""


@dataclass(frozen=True)
class Minimum:
    """A local minimum.

    Attributes
    ----------
    solution : Solution
        The best of those that are equal.
    objective : float
    hits : int
        How many starts ended here.
    starts : tuple of int
        Which ones; 0 is the problem's own guess.
    trajectories : int
        How many different trajectories with this objective were met, e.g. 2 for mirror twins.
    coarse_objectives : tuple of float
        The objectives on the coarse mesh that led here; one minimum may have several discretisations.
    refined : bool
        Whether the solution has been refined, or comes from the coarse mesh.
    verdict_ok : bool
        Whether it passed the verdict; False if it was not verified.

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
    def standing(self) -> Literal["ok", "NOT ok", "coarse"]:
        """Status of the objective: refined and accepted by the verdict, rejected by it, or of the coarse
        mesh.
        """
        if self.verdict_ok:
            return "ok"
        return "NOT ok" if self.refined else "coarse"


def merged(minima: Iterable[Minimum]) -> list[Minimum]:
    """Return the distinct minima, best first, whatever the order they come in."""
    groups: list[list[Minimum]] = []
    for minimum in sorted(minima, key=_rank):
        if groups and equal(groups[-1][-1].objective, minimum.objective):
            groups[-1].append(minimum)
        else:
            groups.append([minimum])
    return [_one(group) for group in groups]


def _rank(minimum: Minimum) -> tuple[float, int]:
    sense = -1.0 if minimum.solution.maximised else 1.0
    return sense * minimum.objective, minimum.starts[0]


def equal(a: float, b: float) -> bool:
    """Whether two objectives are one within `SAME_MINIMUM_TOLERANCE`."""
    return abs(a - b) <= SAME_MINIMUM_TOLERANCE * max(abs(a), abs(b), SAME_MINIMUM_TOLERANCE)


def _one(group: Sequence[Minimum]) -> Minimum:
    """Join equal minima under the most trustworthy solution; among these, that of the earliest start."""
    chief = min(group, key=lambda m: (not m.verdict_ok, not m.refined, m.starts[0]))
    starts = sorted(start for minimum in group for start in minimum.starts)
    return replace(
        chief,
        hits=len(starts),
        starts=tuple(starts),
        trajectories=_count_trajectories(group),
        coarse_objectives=_distinct(value for minimum in group for value in minimum.coarse_objectives),
    )


def _distinct(objectives: Iterable[float]) -> tuple[float, ...]:
    """Return values in increasing order, equal ones once."""
    kept: list[float] = []
    for value in sorted(objectives):
        if not (kept and equal(kept[-1], value)):
            kept.append(value)
    return tuple(kept)


def _count_trajectories(group: Sequence[Minimum]) -> int:
    """Count different trajectories among equal minima, each of which may stand for several already."""
    samples: list[Array] = []
    for minimum in group:
        sample = _sample(minimum.solution)
        if all(np.max(np.abs(sample - other)) > SAME_TRAJECTORY for other in samples):
            samples.append(sample)
    return max(len(samples), *(minimum.trajectories for minimum in group))


def _sample(solution: Solution) -> Array:
    """Return all states at 21 times of each phase, in shares of their magnitudes."""
    rows: list[Array] = []
    for leg in solution.phases.values():
        times = np.linspace(leg.initial_time, leg.final_time, 21)
        rows.append((leg.x(times) / state_magnitudes(leg)[:, None]).ravel())
    return np.concatenate(rows)
