"""refine: from a first solution to one that is right to many digits, and is known to be."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias, get_args

import numpy as np

from gnc_opt.arguments import expect, read_positive
from gnc_opt.environment import one_thread
from gnc_opt.errors import GncOptError, ProblemError, did_you_mean
from gnc_opt.planning.direct.solve_mesh import LOST, SolveLimits, solve_mesh
from gnc_opt.planning.nlp import SolverOptions, Status
from gnc_opt.planning.problem.arcs import ArcKind
from gnc_opt.planning.refinement.arcs.curvature import affine_channels, convex_channels, curved_channels
from gnc_opt.planning.refinement.arcs.detection import structures_of
from gnc_opt.planning.refinement.arcs.ends import with_ends_met
from gnc_opt.planning.refinement.arcs.error_propagation import on_carrying_arcs
from gnc_opt.planning.refinement.arcs.loop import TIGHT, optimise_switches
from gnc_opt.planning.refinement.arcs.resolution import error_at_first
from gnc_opt.planning.refinement.arcs.structure import PhaseStructure
from gnc_opt.planning.refinement.attempt import CLOSE, RefinementAttempt, interrupted, result_of
from gnc_opt.planning.refinement.error import estimate_errors, largest_error
from gnc_opt.planning.refinement.iterations import PassLimits
from gnc_opt.planning.refinement.limits import RefinementLimits
from gnc_opt.planning.refinement.mesh.refinement import ROOMY, refine_mesh
from gnc_opt.planning.refinement.mesh.remesh import HOPELESS
from gnc_opt.planning.solution.history import Pass, RefinementStatus, work_of
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.warm_start import mesh_at_rest
from gnc_opt.planning.verification.engine import verify

StructureChoice: TypeAlias = Literal["auto", "bang-bang", "none"]

UNASKED, AGAIN = 0.5, 0.25
"""Shares of the work after which a control structure that nobody asked for is given up, first and later, when all that
was tried before has left so much."""

OTHERS, SLIGHT = 0.5, 0.5
"""Share of the work of a structure that other readings of the same mesh may cost, and of that what each may cost in any
case."""

BRIEF = SolverOptions(tolerance=TIGHT, max_iterations=100)
"""For solves with such a structure: those that lead anywhere begin near their end."""

EARLY, SPARE = 3, 2
"""Passes of the mesh after which it is asked for a structure again, where the first one did not lead anywhere, and how
many more it may take to be the best so far."""

LEAST_WORK = 3.5e4
"""What refining may cost in any case, in iterations at one collocation point (`Pass.work`): about a second."""

LITTLE, FELL = 5e5, 0.1
"""What is little for all attempts, in iterations of one variable at one collocation point: about two seconds. Where the
work allowed was less than that, because the first solve was quick, and has reduced the error of the mesh to this share,
refining begins once more from where it ended."""

MESHES = 0.5
"""Share of all work that is left for meshes, however much structures that nobody asked for have cost in vain, before it
is seen how fast their errors fall."""

TIGHTER, FURTHER = 0.01, 2
"""Where a mesh is within the tolerance but a condition of the verdict fails that finer meshes can meet, refining goes
on to this share of the tolerance, so many times: what a condition forgives is not the same share of every problem."""


@one_thread()
def refine(
    solution: Solution,
    *,
    tol: float = 1e-8,
    structure: StructureChoice = "auto",
    limits: RefinementLimits | None = None,
    options: SolverOptions | None = None,
    progress: bool = False,
) -> Solution:
    """Return a more accurate solution of the same problem, with its ``history``.

    Parameters
    ----------
    solution : Solution
        A solved one, with its problem. Arcs that this holds by hand (`Problem.with_arcs`) belong to its mesh: the
        refined solution is one of the problem without them.
    tol : float
        On the dimensionless error between the nodes; see `gnc_opt.planning.refinement.error`.
    structure : {"auto", "bang-bang", "none"}
        ``"none"``: hp refinement of the mesh. ``"bang-bang"``: recognise which control sits on which bound when,
        make the switch times variables, and mend the structure until the switching functions agree with it.
        The same for kinks, where controls enter and leave their bounds or mixed path constraints, and for singular
        arcs and arcs on state bounds.
        ``"auto"``: the latter where the structure has more than one piece, if the result passes the verdict; else hp,
        and the structure again after a few passes and at the end if that does not pass.
    limits : RefinementLimits, optional
        On passes, points, work and wall time. At a limit, and after Ctrl-C, the best solution so far is returned.
    options : SolverOptions, optional
        For the solves; a limit on wall time in it is that of one solve.
    progress : bool
        Show one line per pass.

    Returns
    -------
    Solution
        With ``history`` and, where switch times were optimised, ``structure``. The history ends as CONVERGED only
        if the tolerance was reached and no condition of the verdict fails; otherwise its message says what is open.
        The solution keeps that verdict: ``verify(solution)`` returns it without judging again.

    Raises
    ------
    GncOptError
        The solution has no problem or is not solved.
    ProblemError
        ``structure`` is none of the three, or it is ``"bang-bang"`` and no control can be.

    Examples
    --------
    >>> coarse = go.solve(problem, mesh="5x3", tol=None)
    >>> print(abs(coarse.objective - 2) < 1e-6, abs(go.refine(coarse).objective - 2) < 1e-8)
    False True
    """
    expect(solution, Solution, "what refine() got", "write refine(solve(problem))")
    read_positive(tol, "the tolerance of refine()")
    if structure not in get_args(StructureChoice):
        raise ProblemError(
            f"refine() knows no structure {structure!r}: {did_you_mean(str(structure), get_args(StructureChoice))}"
        )
    begin = time.perf_counter()
    limits = limits or RefinementLimits()
    expect(limits, RefinementLimits, "the limits of refine()", "write RefinementLimits(max_points=500)")
    _check(solution)
    deadline = math.inf if limits.max_wall_time is None else begin + limits.max_wall_time
    attempts: list[RefinementAttempt] = []
    try:
        solution = _released(solution, options, deadline)
        start: Solution | None = solution
        while start is not None:
            work = max(limits.max_work * _work(start), LEAST_WORK)
            task = _Task(start, tol, limits.max_passes, limits.max_points, work, options, deadline, progress)
            for attempt in task.attempts(structure):
                task.attempted.append(attempt)
                attempts.append(attempt)
                if attempt.final:
                    break
            start = _worth_another(attempts)
    except KeyboardInterrupt:
        attempts.append(interrupted(solution, tol, begin))
    return result_of(solution, attempts, tol, begin)


def _worth_another(attempts: Sequence[RefinementAttempt]) -> Solution | None:
    """Return the mesh from which to begin again, with work of its own; or None.

    Where all there was has cost little, and the error fell.
    """
    meshes = [a for a in attempts if a.begun is None]
    if attempts[-1].final or not meshes or meshes[-1].history.status is not RefinementStatus.WORK_LIMIT:
        return None
    first, last = meshes[0].history.passes[0], meshes[-1]
    size = max(leg.states.size + leg.controls.size for leg in last.solution.phases.values())
    cheap = size * sum(a.work for a in attempts) <= LITTLE
    return last.solution if cheap and last.error <= FELL * first.error else None


def _check(solution: Solution) -> None:
    solution.need_problem("refine")
    if not solution.status.solved:
        raise GncOptError(
            f"the solution of '{solution.problem_name}' ended as {solution.status.value}: refine one that is solved."
        )


def _work(solution: Solution) -> float:
    """Return what a solution cost; what was lost on the way to it is no measure of what refining may cost."""
    points = sum(leg.mesh.size for leg in solution.phases.values())
    return work_of(points, min(solution.statistics.iterations, LOST))


def _released(solution: Solution, options: SolverOptions | None, deadline: float) -> Solution:
    """Return the solution of the problem that holds no arcs: those are told segment by segment of one mesh.

    What is best with them need not be without: it is solved anew, on the mesh as it was found.
    """
    problem = solution.need_problem("refine")
    held = [name for name, leg in problem.phases.items() if leg.numbers.arcs is not None]
    if not held:
        return solution
    for name in held:
        problem = problem.with_arcs(name, arcs=None)
    given = replace(solution, problem=problem.frozen())
    found = solve_mesh(
        given.need_problem("refine"),
        {name: mesh_at_rest(leg) for name, leg in solution.phases.items()},
        scheme=next(iter(solution.phases.values())).scheme,
        guess=given,
        options=options,
        limits=SolveLimits(deadline=deadline),
    )
    if found.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return found if found.status.solved else given


# --- what is tried --------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Task:
    """What is to be refined, and within which limits."""

    solution: Solution
    tol: float
    max_passes: int
    max_points: int
    max_work: float
    options: SolverOptions | None
    deadline: float
    progress: bool
    attempted: list[RefinementAttempt] = field(default_factory=list)

    def attempts(self, structure: StructureChoice) -> Iterator[RefinementAttempt]:
        """Yield what one way after the other leads to, for as long as that is asked for."""
        if structure == "bang-bang":
            found = structures_of(self.solution)
            if not _switches(self.solution, found, at_least=0):
                raise ProblemError(
                    f"no control of '{self.solution.problem_name}' enters the Hamiltonian linearly between two finite "
                    'bounds: use structure="none".'
                )
            yield from self._by_structure(self.solution, found)
            return
        if structure == "auto":
            yield from self._unasked(self.solution, UNASKED)
        early = min(EARLY, self.max_passes) if self.attempted else self.max_passes
        spare = min(SPARE, self.max_passes - early)
        by_mesh = self._by_mesh(self._mesh_start(), self.tol, early, spare)
        yield by_mesh
        # A finer mesh shows arcs that the first one was too coarse for.
        if structure == "auto":
            yield from self._unasked(by_mesh.solution, AGAIN)
        if early < self.max_passes and by_mesh.history.status is RefinementStatus.PASS_LIMIT:
            by_mesh = self._by_mesh(by_mesh.solution, self.tol, self.max_passes - early)
            yield by_mesh
            yield from self._unasked(by_mesh.solution, AGAIN)
        for k in range(1, FURTHER + 1):
            if not by_mesh.history.converged or not by_mesh.resolvable or self._left <= 0:
                return
            by_mesh = self._by_mesh(by_mesh.solution, self.tol * TIGHTER**k, self.max_passes)
            yield by_mesh

    def _unasked(self, start: Solution, share: float) -> Iterator[RefinementAttempt]:
        """Try a structure that nobody asked for, if there is one: again only with what all that was tried has left.

        On the segments of the mesh, where errors are handed on along its arcs and others had no solution on few, or
        where few segments would lose what that mesh resolves.
        """
        found = structures_of(start) if self._in_vain else None
        if found and _carried(start, found):
            yield self._structured(start, found, self.max_work, self.options or BRIEF, on_mesh=True)
            return
        share = min(share, 1.0 - self._spent / self.max_work)
        if share <= 0:
            return
        found = found or structures_of(start)
        if _switches(start, found, at_least=1) and not self._known(found):
            if self._loses(start, found):
                work = share * self.max_work
                yield self._structured(start, found, work, self.options or BRIEF, on_mesh=True)
                return
            yield from self._by_structure(start, found, share)

    def _loses(self, start: Solution, found: Mapping[str, PhaseStructure]) -> bool:
        """Whether the few segments that a structure begins with lose what the mesh resolves: thin layers."""
        errors = estimate_errors(start)
        if largest_error(errors)[0] > self.tol:
            return False
        return any(error_at_first(error, found[name]) > HOPELESS for name, error in errors.items())

    @property
    def _in_vain(self) -> bool:
        """Whether structures have been tried, on few segments, and had no solution at all."""
        tried = [a for a in self.attempted if a.begun is not None]
        return bool(tried) and not any(a.on_mesh or p.solved for a in tried for p in a.history.passes)

    def _known(self, found: Mapping[str, PhaseStructure], solved: bool = True) -> bool:
        """Whether the same arcs in the same order have been tried, and had a solution if that is asked for.

        Or were tried from the same times.
        """
        order = {name: structure.at(()) for name, structure in found.items()}
        return any(
            a.begun == found
            or (
                (not solved or any(p.solved for p in a.history.passes))
                and order == {name: structure.at(()) for name, structure in a.begun.items()}
            )
            for a in self.attempted
            if a.begun is not None
        )

    def _mesh_start(self) -> Solution:
        """Return where refining the mesh begins: at a structure that is nearly right, its boundaries on the kinks.

        Not if the mesh as given is right. A limit that the optimum only just touches, without pushing, looks like an
        arc to a structure: it moves its ends towards each other, and how close they come the cost hardly tells.
        """
        if self.attempted and self._stands(self.solution):
            return self.solution
        for a in self.attempted:
            small = a.history.final.points <= ROOMY
            if a.error <= CLOSE * self.tol and small and a.nearly_ok:
                return replace(a.solution, structure=())
        return self.solution

    def _stands(self, solution: Solution) -> bool:
        """Whether a solution on a mesh is within the tolerance and passes the verdict."""
        return largest_error(estimate_errors(solution))[0] <= self.tol and verify(solution).ok

    def _by_structure(
        self, start: Solution, found: Mapping[str, PhaseStructure], share: float = 1.0
    ) -> Iterator[RefinementAttempt]:
        """Try the structure that a mesh shows, then that with path constraints kept at the ends of phases, too.

        Then that in which short bangs are no noise, with little work if the first has left none, and, if the first
        cannot be met at all, that of a slightly finer mesh. These share half as much work as the first may cost.
        """
        work, options = share * self.max_work, self.options or (BRIEF if share < 1.0 else None)
        first = self._structured(start, found, work, options)
        yield first
        work *= OTHERS
        least = SLIGHT * work
        met = with_ends_met(start, options=self.options, limits=self._of_solve(start, work))
        if met is not None and met.status.solved:
            work -= _work(met)
            kept = structures_of(met)
            if not self._known(kept):
                second = self._structured(met, kept, max(work, least), options)
                yield second
                work -= second.work
        sharp = structures_of(start, sharp=True)
        if not self._known(sharp, solved=False):
            third = self._structured(start, sharp, max(work, least), options)
            yield third
            work -= third.work
        failed = first.history.status is RefinementStatus.FAILED
        if failed and not any(p.solved for p in first.history.passes):
            finer = self._finer(start, max(work, least))
            if finer.status is Status.INTERRUPTED:
                raise KeyboardInterrupt
            if finer.status.solved:
                work = max(work - _work(finer), least)
                yield self._structured(finer, structures_of(finer), work, options)

    def _finer(self, start: Solution, work: float) -> Solution:
        """Return the solution with one more collocation point in every segment."""
        meshes = {
            name: replace(leg.mesh, degrees=tuple(n + 1 for n in leg.mesh.degrees))
            for name, leg in start.phases.items()
        }
        return solve_mesh(
            start.need_problem("refine"),
            meshes,
            scheme=next(iter(start.phases.values())).scheme,
            guess=start,
            options=self.options,
            limits=self._of_solve(start, work),
        )

    def _of_solve(self, start: Solution, work: float) -> SolveLimits:
        """Limits of a single solve on about the mesh of a solution."""
        return self._limits(1, work).of_solve(leg.mesh for leg in start.phases.values())

    def _structured(
        self,
        start: Solution,
        found: Mapping[str, PhaseStructure],
        work: float,
        options: SolverOptions | None,
        on_mesh: bool = False,
    ) -> RefinementAttempt:
        return RefinementAttempt(
            *optimise_switches(
                start,
                tol=self.tol,
                limits=replace(self._limits(self.max_passes, work), known=self._passes_by_structure),
                structures=found,
                options=options,
                progress=self.progress,
                segments="mesh" if on_mesh else "few",
            ),
            begun=found,
            on_mesh=on_mesh,
        )

    @property
    def _passes_by_structure(self) -> tuple[Pass, ...]:
        """Those of structures that have not convinced."""
        return tuple(p for a in self.attempted if a.begun is not None for p in a.history.passes)

    def _limits(self, passes: int, work: float) -> PassLimits:
        return PassLimits(passes, self.max_points, work, self.deadline)

    @property
    def _left(self) -> float:
        """Work that is left for meshes: of all that is allowed, or at least of their share of it.

        Where they lead on, what structures have cost in vain does not count.
        """
        meshes = [a for a in self.attempted if a.begun is None]
        share = 1.0 if meshes and meshes[-1].leads_on else MESHES
        return max(self.max_work - self._spent, share * self.max_work - sum(a.work for a in meshes))

    @property
    def _spent(self) -> float:
        """Work of all that was tried."""
        return sum(a.work for a in self.attempted)

    def _by_mesh(self, start: Solution, tol: float, max_passes: int, spare: int = 0) -> RefinementAttempt:
        return RefinementAttempt(
            *refine_mesh(
                start,
                tol=tol,
                limits=replace(self._limits(max_passes, self._left), spare=spare),
                options=self.options,
                progress=self.progress,
            )
        )


def _switches(solution: Solution, found: Mapping[str, PhaseStructure], at_least: int) -> bool:
    """Whether some control can have switches or kinks and the structure has more pieces than that."""
    for name, samples in solution.samples().items():
        if np.any(affine_channels(samples)) and found[name].pieces > at_least:
            return True
        if any(found[name].touches[0] + found[name].touches[-1]):
            return True
        if np.any(curved_channels(samples)) and found[name].pieces > max(at_least, 1):
            return True
        # Controls that H determines have nothing to settle if they stay between their bounds.
        if np.any(convex_channels(samples)) and found[name].pieces > 1:
            return True
    return False


def _carried(solution: Solution, found: Mapping[str, PhaseStructure]) -> bool:
    """Whether arcs carry errors on over several segments of the mesh, none of them singular."""
    if any(np.any(structure.controls == ArcKind.SINGULAR) for structure in found.values()):
        return False
    for name, structure in found.items():
        breaks = solution.phases[name].breaks
        for k in np.flatnonzero(on_carrying_arcs(structure)):
            if np.any((breaks > structure.times[k]) & (breaks < structure.times[k + 1])):
                return True
    return False
