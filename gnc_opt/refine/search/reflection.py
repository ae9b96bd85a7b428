"""Reflections: a trajectory that passes a straight line on one side may have a neighbour on the other side.

About the straight line between the ends of a trajectory, many dynamics fall into parts that are nearly independent of
each other: pitch, and roll with yaw; motion in the plane of an orbit, and across it. Where such a part does not change
if it is turned round, one minimum has a mirror twin; where ends or small couplings break that symmetry, twins are
minima of different cost. Random starts find one of them more often than the other, a reflection leads to that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gnc_opt.arrays import Array, Mask
from gnc_opt.problem.problem import Problem
from gnc_opt.refine.search.minima import SAME_TRAJECTORY, Minimum, equal
from gnc_opt.solution.phase_solution import PhaseSolution
from gnc_opt.solution.propagation import state_magnitudes
from gnc_opt.solution.solution import Solution

STRONG = 0.3
"""A variable is coupled with another that it moves, along the phase, by this share of its size, and by this share of
what the strongest one does."""

FRACTIONS = np.linspace(0.0, 1.0, 65)
"""Where trajectories are reflected."""

Labels = frozenset[str]
"""Of states and controls, components one by one, that are reflected together."""


@dataclass(frozen=True)
class Reflection:
    """What is reflected: the labels of some states and controls along a solution, without its problem."""

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
