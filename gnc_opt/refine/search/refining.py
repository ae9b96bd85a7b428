"""What becomes of a coarse minimum: refined to exact switch times or on finer meshes, and judged."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.errors import ProblemError
from gnc_opt.nlp import SolverOptions, Status
from gnc_opt.problem.problem import Problem
from gnc_opt.refine.limits import RefinementLimits
from gnc_opt.refine.refine import StructureChoice
from gnc_opt.refine.refine import refine as refine_solution
from gnc_opt.refine.search.minima import Minimum, equal
from gnc_opt.solution.history import RefinementStatus
from gnc_opt.solution.solution import Solution
from gnc_opt.solution.solve_mesh import solve_mesh
from gnc_opt.transcription.mesh import Mesh
from gnc_opt.verify.verify import verify

MOST_POINTS = 1000
"""Of a phase on a refined mesh."""

MOST_PASSES = 20
"""Of one refinement. Structures that are worth anything stand after fewer."""

WORTHWHILE = 4
"""Growth of the mesh beyond which a minimum is left unrefined whose controls switch without a structure that the
verdict accepts: the mesh would grow for minutes and prove nothing."""

MISS = 0.1
"""A collocation solution is spurious if both its propagation misses the end and its defect between the nodes exceed
this share of the states' magnitudes. (Either one alone may be due to unstable dynamics or to a coarse mesh.) On the
rendezvous, 10 x 4 points, spurious solutions have 0.3 and 0.8 at least, others 0.03 and 0.4 at most."""


@dataclass(frozen=True)
class Refining:
    """Refine a minimum and judge it; it stays as it is if that fails or leads to something spurious.

    Exact switch times are tried first; where controls do not switch or the verdict rejects the outcome, the mesh is
    refined ("auto").
    """

    structure: StructureChoice
    tol: float
    options: SolverOptions

    def __call__(self, problem: Problem, minimum: Minimum) -> Minimum:
        known = set(problem.builds)
        try:
            return self._refine(problem, minimum)
        finally:
            for key in set(problem.builds) - known:  # its meshes are its own, and no other minimum needs them
                del problem.builds[key]

    def _refine(self, problem: Problem, minimum: Minimum) -> Minimum:
        coarse = minimum.solution.with_problem(problem)
        if self.structure == "none":
            return self._refined(minimum, coarse, "none")
        try:
            found = self._switched(minimum, coarse)
        except ProblemError:
            if self.structure == "bang-bang":
                raise
            return self._refined(minimum, coarse, "none")  # no control switches
        if self.structure == "bang-bang" or found.verdict_ok:
            return found
        points = max(leg.mesh.size for leg in coarse.phases.values())
        by_mesh = self._refined(minimum, coarse, "none", max_points=WORTHWHILE * points)
        return by_mesh if by_mesh.verdict_ok or _error(by_mesh) < _error(found) else found

    def _switched(self, minimum: Minimum, coarse: Solution) -> Minimum:
        """Refine to exact switch times, from up to three places.

        A coarse mesh cannot tell short arcs: its solution on a mesh of halved segments shows more of the structure.
        And it has minima of its own, from which refinement leads to trajectories that are better and not optimal:
        solved once more from there, the coarse mesh leads downhill to a true minimum.
        """
        first = self._refined(minimum, coarse, "bang-bang")
        problem = coarse.problem
        if first.verdict_ok or problem is None:
            return first
        meshes = {name: leg.mesh for name, leg in coarse.phases.items()}
        halved = {name: _halved(mesh) for name, mesh in meshes.items()}
        places = [(coarse, halved), (first.solution.with_problem(problem), meshes)]
        for guess, mesh in places if first.refined else places[:1]:
            solution = solve_mesh(problem, mesh, guess=guess, options=self.options)
            pass_on_interrupt(solution, self.options)
            if not solution.status.solved or is_spurious(solution):
                continue
            if mesh is meshes and equal(solution.objective, coarse.objective):
                continue  # back where it came from
            second = self._refined(minimum, solution, "bang-bang")
            if second.verdict_ok:
                return second
        return first

    def _refined(
        self, minimum: Minimum, coarse: Solution, structure: StructureChoice, max_points: int = MOST_POINTS
    ) -> Minimum:
        limits = RefinementLimits(max_passes=MOST_PASSES, max_points=max_points)
        solution = refine_solution(coarse, structure=structure, tol=self.tol, limits=limits)
        if solution.history is not None and solution.history.status is RefinementStatus.INTERRUPTED:
            raise KeyboardInterrupt
        if not solution.status.solved or is_spurious(solution):
            return minimum
        return replace(
            minimum,
            solution=replace(solution, problem=None),
            objective=solution.objective,
            refined=True,
            verdict_ok=verify(solution).ok,
        )


def _error(minimum: Minimum) -> float:
    """Return the error that refining left; infinite if it has not been refined."""
    history = minimum.solution.history
    return math.inf if history is None or not minimum.refined else history.final.error


def _halved(mesh: Mesh) -> Mesh:
    """Return the mesh with every segment cut in two."""
    breaks = np.asarray(mesh.breaks)
    middles = 0.5 * (breaks[:-1] + breaks[1:])
    return Mesh(tuple(np.sort(np.concatenate([breaks, middles]))), tuple(np.repeat(mesh.degrees, 2).tolist()))


def is_spurious(solution: Solution) -> bool:
    """Whether a collocation solution is none of the differential equations; see `MISS`."""
    quality = solution.quality
    return not (quality.terminal_error < MISS or quality.max_defect < MISS)


def pass_on_interrupt(solution: Solution, options: SolverOptions) -> None:
    """Raise KeyboardInterrupt if it was Ctrl-C, and not the time limit, that the solver obeyed."""
    limit = options.max_wall_time
    if solution.status is Status.INTERRUPTED and (limit is None or solution.statistics.solve_s < limit):
        raise KeyboardInterrupt
