"""Warm start of a modified bang-bang problem from the switching times of a known solution."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import EQUAL, INNER_TOLERANCE_SHARE
from gnc_opt.planning.optimality.bang_bang_sensitivity import FLOW_INITIAL_STEPS
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.arcs.control_structure import PhaseStructure
from gnc_opt.planning.refinement.arcs.structure_detection import detect_phase_structure
from gnc_opt.planning.refinement.switching.bang_bang_extremal import (
    SwitchedFlow,
    satisfies_inequality_limits,
)
from gnc_opt.planning.refinement.switching.newton_iteration import find_optimal_switching_times
from gnc_opt.planning.refinement.switching.newton_step import SwitchStep
from gnc_opt.planning.solution.phase_solution import truncate_phase_before
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.verification.recomputed_solution import recompute_stored_values


@dataclass(frozen=True, eq=False)
class KnownSwitches:
    """Known one-phase solution for modifications of its problem; ``step`` is the Newton step at its optimum."""

    solution: Solution
    structure: PhaseStructure
    state_scale: Array
    step: SwitchStep | None = None

    @classmethod
    def from_solution(cls, solution: Solution) -> KnownSwitches | None:
        """Return the data of a refined solution; None unless all its arcs are those of controls at bounds."""
        channels = {label for leg in solution.phases.values() for label in leg.controls.labels}
        bounded = all(arc.kind.is_at_limit and arc.channel in channels for arc in solution.structure)
        if not solution.structure or len(solution.phases) != 1 or not bounded:
            return None
        (s,) = solution.samples().values()
        structure = detect_phase_structure(s).with_listed_arcs(solution.structure, s.leg)
        return cls(replace(solution, structure=()), structure, s.state_scale)

    def with_newton_step(self) -> KnownSwitches | None:
        """Return the same data with the Newton step; None if Newton's method does not apply."""
        found = _find_accurate_switching_times(self.solution, self.structure, EQUAL)
        if found is None:
            return None
        half = replace(found[1].step, steps=FLOW_INITIAL_STEPS // 2)  # of the converged structure
        finer = _find_accurate_switching_times(self.solution, found[0], INNER_TOLERANCE_SHARE * EQUAL, half)
        structure, flight = finer or found
        return replace(self, structure=structure, step=flight.step)

    def solve_with_known_switches(self, problem: Problem) -> Solution | None:
        """Return the solution of a modified problem with its own switching times; None if that fails."""
        start = truncate_to_start_time(self.solution, problem)
        (leg,) = start.phases.values()
        left = self.structure.truncate_before(leg.initial_time)
        step = self.step if left.n_pieces == self.structure.n_pieces else None
        begun = _shift_to_initial_states(recompute_stored_values(replace(start, problem=problem.frozen())))
        found = None if begun is None else _find_accurate_switching_times(begun, left, EQUAL, step)
        if begun is None or found is None:
            return None
        structure, flight = found
        flown = flight.build_solution(begun)
        if not satisfies_inequality_limits(flown, self.state_scale):
            return None
        labels = (*leg.controls.labels, *leg.path_labels, *leg.states.labels)
        return replace(flown, structure=structure.list_arcs(leg.name, labels))


def _find_accurate_switching_times(
    solution: Solution, structure: PhaseStructure, accuracy: float, known: SwitchStep | None = None
) -> tuple[PhaseStructure, SwitchedFlow] | None:
    found = find_optimal_switching_times(solution, structure, accuracy, known)
    return found if found is not None and found[1].is_accurate(accuracy) else None


def truncate_to_start_time(known: Solution, problem: Problem) -> Solution:
    """Return the part of a known solution after the start of a modified problem, without arcs."""
    if len(known.phases) != 1:
        return known
    ((name, leg),) = known.phases.items()
    begins = problem.phases[name].numbers.initial_time
    if begins is None or not begins.is_fixed[0] or not leg.initial_time < begins.lower[0] < leg.final_time:
        return known
    rest = truncate_phase_before(leg, float(begins.lower[0]))
    return replace(known, phases={name: rest}, structure=())


def _shift_to_initial_states(known: Solution) -> Solution | None:
    """Return the trajectory shifted to the initial states of its problem; None if the problem fixes other times."""
    (leg,) = known.phases.values()
    for bounds, t in ((leg.initial_time_bounds, leg.initial_time), (leg.final_time_bounds, leg.final_time)):
        if bounds.is_fixed[0] and bounds.lower[0] != t:
            return None
    moved = np.where(leg.initial_bounds.is_fixed, leg.initial_bounds.lower - leg.x(leg.breaks[0]), 0.0)
    x = PiecewisePolynomial(leg.x.breaks, leg.x.nodes, tuple(v + moved[:, None] for v in leg.x.values))
    return replace(known, phases={leg.name: replace(leg, x=x)})
