"""Resolver: solving a problem again and again with other numbers, near a solution that is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from gnc_opt.arguments import expect, read_positive
from gnc_opt.arrays import Array
from gnc_opt.errors import ProblemError
from gnc_opt.problem.norms import restated
from gnc_opt.problem.problem import Problem
from gnc_opt.refine.structure.detect import detect
from gnc_opt.refine.structure.newton import settle_flow
from gnc_opt.refine.structure.phase_structure import PhaseStructure
from gnc_opt.solution.phase_solution import PhaseSolution
from gnc_opt.solution.polynomial import PiecewisePolynomial
from gnc_opt.solution.quality import worst_bound_violation, worst_path_violation
from gnc_opt.solution.solution import Solution
from gnc_opt.solution.solve_mesh import solve_mesh
from gnc_opt.solve import solve
from gnc_opt.verify.judged import ends_of, from_problem

ACCURACY = 1e-9
"""Of the cost, relative to its size, where it is found by switch times."""

BEYOND = 1e-7
"""By how much a limit may be exceeded, in shares of what is limited; cubics between steps are not better."""


class Way(Enum):
    """How a problem was solved again."""

    SWITCH_TIMES = "switch times"
    WARM = "warm start"
    COLD = "from the start"


class Resolver:
    """Solve variations of a problem (`Problem.with_initial`, `with_parameters`, ...) from one solution of it.

    The ways, tried in this order:

    ============  ============================================================  ========================================
    way           where                                                         how
    ============  ============================================================  ========================================
    SWITCH_TIMES  one phase, every control on a bound, all that is asked of     Newton's method on switch times, arcs
                  the ends an equality                                          dropped and added as signs ask
    WARM          the solution before was not refined                           its mesh and multipliers, by IPOPT
    COLD          all else, and where the others give up                        `solve` as if nothing were known
    ============  ============================================================  ========================================

    SWITCH_TIMES gives the flight itself, integrated with its switches, and not a collocated solution: its cost is
    right to `ACCURACY` by an estimate from two grids, switch times to the root of that in shares of the phase, and no
    limit is exceeded, or it gives up.
    It and WARM find a local minimum, as a rule that next to the known one; COLD may find another. What was compiled,
    transcribed and differentiated serves all solves. One object must not be used by two threads at once.

    Parameters
    ----------
    solution : Solution
        A solved one, with its problem.
    tol : float, optional
        For solutions from the start; default: that which the solution was refined to; None if it was not.

    Raises
    ------
    GncOptError
        The solution has no problem.
    ProblemError
        It is not solved.
    """

    def __init__(self, solution: Solution, *, tol: float | None = None) -> None:
        expect(solution, Solution, "what Resolver() got", "write Resolver(solve(problem))")
        self._builds = solution.need_problem("solve").builds
        if not solution.status.solved:
            raise ProblemError(
                f"the solution of '{solution.problem_name}' ended as {solution.status.value}: "
                "solve again from one that is solved."
            )
        asked = solution.history.tolerance if tol is None and solution.history is not None else tol
        self.tol = None if asked is None else read_positive(asked, "the tolerance of Resolver()")
        self.solution = solution
        self._known: _Known | None = None
        if solution.structure and len(solution.phases) == 1:
            self._known = _Known.of(solution)

    def solve(self, problem: Problem) -> Solution:
        """Return the solution of a variation; ``solution.provenance["way"]`` names the `Way` it was found.

        Raises
        ------
        ProblemError
            The problem is no variation of the one that the resolver knows, or is not well stated.
        SolveError
            No way has led to a solution.
        """
        expect(problem, Problem, "what Resolver.solve() got", "give problem.with_initial(...), say")
        stated, problem = problem, restated(problem)
        if problem.builds is not self._builds:
            raise ProblemError(
                f"problem '{problem.name}' is no variation of the one that the resolver knows: make it by "
                "with_initial(), with_parameters() or their like, or make a Resolver of its own solution."
            )
        stated.check()
        if self._known is not None:
            found = _by_switch_times(self._known, problem)
            if found is not None:
                return _named(found, Way.SWITCH_TIMES)
        elif self.tol is None:
            found = solve_mesh(problem, scheme=self.solution.scheme, guess=self.solution)
            if found.status.solved:
                return _named(found, Way.WARM)
        return _named(solve(problem, tol=self.tol), Way.COLD)


def _named(solution: Solution, way: Way) -> Solution:
    return replace(solution, provenance={**solution.provenance, "way": way.value})


@dataclass(frozen=True, eq=False)
class _Known:
    """What of a known solution serves all variations.

    Attributes
    ----------
    solution : Solution
    structure : PhaseStructure
    state_scale : array (n_states,)
        How far its states move: what those of its neighbours are measured against.
    """

    solution: Solution
    structure: PhaseStructure
    state_scale: Array

    @classmethod
    def of(cls, solution: Solution) -> _Known:
        (s,) = solution.samples().values()
        return cls(solution, detect(s), s.state_scale)


def _by_switch_times(known: _Known, problem: Problem) -> Solution | None:
    """Fly a variation with its own switch times, from those of a known solution; None where that fails."""
    begun = _begun(from_problem(replace(known.solution, problem=problem.frozen(), structure=())))
    if begun is None:
        return None
    found = settle_flow(begun, known.structure, ACCURACY)
    if found is None:
        return None
    settled, flown = found
    (leg,) = flown.phases.values()
    if not _keeps_limits(flown, known.state_scale):
        return None
    labels = (*leg.controls.labels, *leg.path_labels, *leg.states.labels)
    return replace(_completed(flown), structure=settled.arcs(leg.name, labels))


def _begun(known: Solution) -> Solution | None:
    """The trajectory moved to where its problem says that it starts; None if it has other times there."""
    (leg,) = known.phases.values()
    for bounds, t in ((leg.initial_time_bounds, leg.initial_time), (leg.final_time_bounds, leg.final_time)):
        if bounds.fixed[0] and bounds.lower[0] != t:
            return None
    moved = np.where(leg.initial_bounds.fixed, leg.initial_bounds.lower - leg.x(leg.breaks[0]), 0.0)
    x = PiecewisePolynomial(leg.x.breaks, leg.x.nodes, tuple(v + moved[:, None] for v in leg.x.values))
    return replace(known, phases={leg.name: replace(leg, x=x)})


def _keeps_limits(flown: Solution, state_scale: Array) -> bool:
    """Whether states, path constraints and ends are within their limits: the flow knows none but equalities."""
    (s,) = flown.samples().values()
    leg = s.leg
    ends = (
        (leg.final_bounds, leg.x(leg.final_time, "left"), state_scale),
        (leg.initial_time_bounds, leg.initial_time, s.span),
        (leg.final_time_bounds, leg.final_time, s.span),
        (leg.duration_bounds, leg.duration, s.span),
    )
    inside = all(
        np.all((value >= box.lower - BEYOND * scale) & (value <= box.upper + BEYOND * scale))
        for box, value, scale in ends
    )
    return inside and worst_bound_violation(s).or_worse(worst_path_violation(s)).value < BEYOND


def _completed(flown: Solution) -> Solution:
    """The flight with its cost, and the multipliers of limits that follow from its costates."""
    (leg,) = flown.phases.values()
    ends, functions = ends_of(flown), flown.functions(leg.name)
    at, lam = leg.breaks[[0, -1]], np.stack([leg.lam_start[:, 0], leg.lam_end[:, -1]], axis=1)
    x = np.stack([leg.x(at[0]), leg.x(at[1], "left")], axis=1)
    u = np.stack([leg.flown(at[0]), leg.flown(at[1], "left")], axis=1)
    worth = functions.hamiltonian(at, x, u, lam) - np.array(
        [ends.initial_time[leg.name], -ends.final_time[leg.name]]
    )
    fixed = np.concatenate([leg.initial_time_bounds.fixed, leg.final_time_bounds.fixed])
    impulses = np.zeros_like(leg.state_impulses)
    impulses[:, 0] = -lam[:, 0] - ends.initial_state[leg.name]
    impulses[:, -1] = lam[:, 1] - ends.final_state[leg.name]
    times, nothing = leg.point_times, np.zeros((len(leg.path_labels), leg.point_times.size))
    gradient = functions.control_gradient(times, leg.x(times), leg.flown(times), leg.point_costates, nothing)
    told: PhaseSolution = replace(
        leg,
        time_multipliers=np.where(fixed, worth * np.array([1.0, -1.0]), 0.0),
        state_impulses=impulses,
        control_multipliers=-gradient,
    )
    return replace(
        flown,
        phases={leg.name: told},
        objective=ends.cost,
        constraint_values=ends.constraints,
        history=None,
    )
