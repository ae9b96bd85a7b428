"""Resolver: solving a problem again and again with other numbers, near a solution that is known."""

from __future__ import annotations

from gnc_opt.arguments import expect, read_positive
from gnc_opt.errors import ProblemError
from gnc_opt.nlp import Status
from gnc_opt.problem.check import check_numbers
from gnc_opt.problem.norms import restated
from gnc_opt.problem.problem import Problem
from gnc_opt.refine.following import WARM_ITERATIONS, KnownArcs
from gnc_opt.refine.structure.variation import KnownFlight, on_the_way
from gnc_opt.solution.solution import Solution
from gnc_opt.solution.solve_mesh import SolveLimits, solve_mesh
from gnc_opt.solve import Way, reached, said, solve
from gnc_opt.threads import one_thread


class Resolver:
    """Solve variations of a problem (`Problem.with_initial`, `with_parameters`, ...) from one solution of it.

    The ways, tried in this order:

    ============  ============================================================  ========================================
    way           where                                                         how
    ============  ============================================================  ========================================
    SWITCH_TIMES  one phase, every control on a bound, all that is asked of     Newton's method on switch times, arcs
                  the ends an equality                                          dropped and added as signs ask
    WARM          all else                                                      its arcs or mesh, and multipliers, by
                                                                                IPOPT; refined if it was refined
    COLD          where the others give up                                      `solve` as if nothing were known
    ============  ============================================================  ========================================

    SWITCH_TIMES gives the flight itself, integrated with its switches, and not a collocated solution: its cost is
    right to 1e-9 by an estimate from two grids, switch times to the root of that in shares of the phase, and no
    limit is exceeded, or it gives up.
    WARM, from a refined solution, is within ``tol``; if the arcs are others or the mesh had to be refined, it also
    passes the verdict, which it carries then, or it gives up. All else is judged by `verify` only.
    Both find a local minimum, as a rule that next to the known one; COLD may find another. What was compiled,
    transcribed and differentiated serves all solves. One object must not be used by two threads at once.

    Parameters
    ----------
    solution : Solution
        A solved one, with its problem.
    tol : float, optional
        For solutions from the start; default: that which the solution was refined to; None if it was not.
    cold : bool
        Whether to solve from the start where the other ways fail, which takes its time.

    Raises
    ------
    GncOptError
        The solution has no problem.
    ProblemError
        It is not solved.

    Examples
    --------
    >>> resolver = go.Resolver(solution)
    >>> print(f"{resolver.solve(problem.with_initial(q=1.21)).objective:.6f}")
    2.200000
    """

    def __init__(self, solution: Solution, *, tol: float | None = None, cold: bool = True) -> None:
        expect(solution, Solution, "what Resolver() got", "write Resolver(solve(problem))")
        self._problem = solution.need_problem("solve")
        if not solution.status.solved:
            raise ProblemError(
                f"the solution of '{solution.problem_name}' ended as {solution.status.value}: "
                "solve again from one that is solved."
            )
        asked = solution.history.tolerance if tol is None and solution.history is not None else tol
        self.tol = None if asked is None else read_positive(asked, "the tolerance of Resolver()")
        self.solution, self.cold = solution, cold
        flight = KnownFlight.of(solution)
        self._flight = None if flight is None else flight.differentiated()
        self._arcs = KnownArcs.of(solution) if solution.structure or self.tol is not None else None

    @one_thread()
    def solve(self, problem: Problem, *, near: Solution | None = None) -> Solution:
        """Return the solution of a variation; ``solution.provenance["way"]`` names the `Way` it was found.

        A variation may begin on the way of the known one, ``problem.with_time(initial=t).with_initial(...)``: what of
        it lies after that time is the start.

        Parameters
        ----------
        problem : Problem
        near : Solution, optional
            Of a variation, to start from; default the one that the resolver was made of.

        Raises
        ------
        ProblemError
            The problem, or what it is to start near, is no variation of the one that the resolver knows; or it is not
            well stated.
        SolveError
            No way has led to a solution.
        KeyboardInterrupt
            Ctrl-C before anything was solved; while it is solved from the start see `solve`.
        """
        expect(problem, Problem, "what Resolver.solve() got", "give problem.with_initial(...), say")
        stated, problem = problem, restated(problem)
        if not stated.leads_to(self._problem):
            raise ProblemError(
                f"problem '{problem.name}' is no variation of the one that the resolver knows: make it by "
                "with_initial(), with_parameters() or their like, or make a Resolver of its own solution."
            )
        if near is not None:
            expect(near, Solution, "the start of Resolver.solve()", "give near=resolver.solve(...), say")
            if _variables(near) != _variables(self.solution):
                raise ProblemError(
                    f"the solution of '{near.problem_name}' has other phases, states or controls than what the "
                    "resolver knows: give near= a solution of a variation."
                )
        check_numbers(stated)  # the guess of a variation is used by the last way only, which looks at it
        found = self._nearby(stated, problem, near) if problem.builds is self._problem.builds else None
        if found is not None:
            return found
        if not self.cold:
            raise ProblemError(
                f"problem '{problem.name}' was not solved next to the known solution, and the resolver is not to begin "
                "from the start: vary it less, or leave out cold=False."
            )
        return said(solve(problem, tol=self.tol), Way.COLD)

    def _nearby(self, stated: Problem, problem: Problem, near: Solution | None) -> Solution | None:
        """Return the solution of a variation in the form that the known one has, if a fast way leads to it."""
        if self._flight is not None:
            flight = self._flight if near is None else KnownFlight.of(near)
            flown = None if flight is None else flight.vary(problem)
            if flown is not None:
                return said(flown, Way.SWITCH_TIMES)
        stated.check()
        if self._arcs is not None:
            arcs = self._arcs if near is None else KnownArcs.of(near)
            found = arcs.vary(problem, reached(self.solution) if self.tol is None else self.tol, "changed")
            return None if found is None else said(found, Way.WARM)
        start = self.solution if near is None else near
        meshes = {name: leg.mesh for name, leg in self.solution.phases.items()}
        guess, scheme, limits = on_the_way(start, problem), self.solution.scheme, SolveLimits(WARM_ITERATIONS)
        found = solve_mesh(problem, meshes, scheme=scheme, guess=guess, limits=limits)
        if found.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        return said(found, Way.WARM) if found.status.solved else None


def _variables(solution: Solution) -> dict[str, tuple[tuple[str, ...], ...]]:
    """Names of states and controls by phase."""
    return {
        name: (tuple(leg.states.labels), tuple(leg.controls.labels)) for name, leg in solution.phases.items()
    }
