"""bound_below: how far a solution is from the best there is, as far as a relaxation tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.arguments import expect, read_positive
from gnc_opt.problem.problem import Problem
from gnc_opt.problem.relaxation import Relaxation, relaxations
from gnc_opt.solution.lower_bound import LowerBound
from gnc_opt.solution.solution import Solution
from gnc_opt.solve import solve
from gnc_opt.threads import one_thread
from gnc_opt.verify.global_minimum import theorem_of
from gnc_opt.verify.kept import keep_verdict
from gnc_opt.verify.verify import TOLERANCE, verify

_TIMES = 201
"""At which a relaxation is told the flight, its first guess."""


@one_thread()
def bound_below(solution: Solution, *, tol: float = 1e-6) -> Solution:
    """Return the solution with a lower bound of its problem's cost, if one is found: `Solution.bound`, `Solution.gap`.

    A problem that is convex, or linear and time-optimal with a target at which it can rest, bounds itself: what meets
    the first-order conditions is a global minimum. Else states are dropped that others do not need (the position of a
    spacecraft whose attitude does not depend on it), with all that limits them; what remains is solved from the flight
    as a guess, refined and judged, once for every such part that has all states of the cost. The highest bound counts,
    of those that a theorem certifies if there are any. A part to which none applies gives the value of a local minimum,
    which is a bound only if no other is lower: ``bound.certified`` says which.

    Parameters
    ----------
    solution : Solution
        With its problem, solved.
    tol : float
        Of the refinement of each part, as for `solve`.

    Returns
    -------
    Solution
        The same numbers. ``bound`` is None if nothing can be dropped, or no part was solved to an ok verdict.

    Raises
    ------
    GncOptError
        The solution has no problem.
    ProblemError
        ``tol`` is not positive.

    Examples
    --------
    >>> bounded = go.bound_below(solution)
    >>> print(bounded.bound.certified, f"{abs(bounded.gap):.0e}")
    True 0e+00
    """
    expect(solution, Solution, "what bound_below() got", "give a solution as solve() returns it")
    read_positive(tol, "the tolerance of bound_below()")
    problem = solution.need_problem("bound")
    verdict = replace(verify(solution), bound=None, gap=None)
    theorem = theorem_of(solution, verdict)
    if theorem:
        best: LowerBound | None = LowerBound(solution.objective, _labels(problem), theorem)
    else:
        found = (_bound(relaxation, solution, tol) for relaxation in relaxations(problem))
        known = [bound for bound in found if bound is not None]
        best = max(known, key=lambda b: (b.certified, problem.sense * b.value), default=None)
    bounded = replace(solution, bound=best)
    keep_verdict(bounded, verdict, TOLERANCE)
    return bounded


def _bound(relaxation: Relaxation, solution: Solution, tol: float) -> LowerBound | None:
    """Return what a relaxation bounds the cost by; None if it is not solved or known to be no bound."""
    problem = _guessed(relaxation, solution)
    relaxed = solve(problem, tol=tol, throw=False)
    if not relaxed.converged:
        return None
    theorem = theorem_of(relaxed, verify(relaxed))
    beyond = problem.sense * (relaxed.objective - solution.objective)
    if not theorem and beyond > tol * abs(solution.objective):
        return None  # the solution's own flight costs less: a minimum of the relaxation, but not its least
    kept = solution.need_problem("bound").phases
    labels = [
        label
        for name, mask in relaxation.states.items()
        for label, left in zip(kept[name].model.states.labels, mask, strict=True)
        if left
    ]
    return LowerBound(relaxed.objective, tuple(dict.fromkeys(labels)), theorem)


def _guessed(relaxation: Relaxation, solution: Solution) -> Problem:
    """Return a relaxation with the solution's flight as its guess."""
    problem = relaxation.problem
    for name, leg in problem.phases.items():
        flown = solution.phase(name)
        times = np.linspace(flown.initial_time, flown.final_time, _TIMES)
        states = flown.x(times, "right")[relaxation.states[name]]
        controls = flown.flown(times, "right")[relaxation.controls[name]]
        values = {n: states[leg.model.states.slice(n)] for n in leg.model.states.names}
        values |= {n: controls[leg.model.controls.slice(n)] for n in leg.model.controls.names}
        leg.guess(times, **values)
    return problem.with_parameter_guess(**{n: solution.parameter(n) for n in problem.parameters.names})


def _labels(problem: Problem) -> tuple[str, ...]:
    return tuple(dict.fromkeys(label for leg in problem.phases.values() for label in leg.model.states.labels))
