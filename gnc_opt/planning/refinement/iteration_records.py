"""Iterations of a refinement: records, progress output, limits and stagnation."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace

from gnc_opt.planning.direct.fixed_mesh_solve import SolveLimits
from gnc_opt.planning.refinement.error_estimation import PhaseError, find_largest_error
from gnc_opt.planning.solution.refinement_history import (
    Actions,
    RefinementIteration,
    count_affordable_iterations,
)
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh

CONVERGENCE_WINDOW = 6
"""Number of last passes that determine the convergence rate."""

MAX_FURTHER_ITERATIONS = 10
"""Largest number of further passes, predicted from the convergence rate, with which refinement continues."""


@dataclass(frozen=True)
class IterationLimits:
    """Limits at which the passes of a refinement end.

    Attributes
    ----------
    passes : int
        Largest number of solves.
    points : int
        Largest number of collocation points per phase.
    work : float
        Limit on the work of all passes, iterations at one collocation point; see `RefinementIteration.work`.
    deadline : float
        Wall time limit, `time.perf_counter`. Ctrl-C also ends the passes.
    cpu_deadline : float
        CPU time limit, `time.thread_time`.
    worst : float
        Largest error of a first pass; with a larger one, the structure is rejected.
    sufficient : float
        Local error and relative error of the objective at which switching times are final.
    """

    passes: int = 40
    points: int = 1000
    work: float = math.inf
    deadline: float = math.inf
    cpu_deadline: float = math.inf
    worst: float = math.inf
    sufficient: float = 0.0

    def are_exhausted(self, spent: float) -> bool:
        """Return whether no further pass is allowed after the work ``spent``."""
        return spent >= self.work or time.thread_time() > self.cpu_deadline

    def limit_solve(self, meshes: Iterable[Mesh], spent: float = 0.0) -> SolveLimits:
        """Return the limits of a solve on the given meshes after the work ``spent``."""
        within = SolveLimits(deadline=self.deadline, cpu_deadline=self.cpu_deadline)
        if math.isinf(self.work):
            return within
        points = sum(mesh.size for mesh in meshes)
        return replace(within, iterations=max(1, count_affordable_iterations(self.work - spent, points)))


def record_iteration(
    solution: Solution, errors: Mapping[str, PhaseError], begin: float, actions: Actions | str
) -> RefinementIteration:
    """Return the record of a pass from ``begin`` (s, `time.perf_counter`) to its solution."""
    error, where = find_largest_error(errors)
    return RefinementIteration(
        meshes={name: leg.mesh for name, leg in solution.phases.items()},
        times={name: tuple(float(t) for t in leg.breaks) for name, leg in solution.phases.items()},
        error=error,
        where=where,
        objective=solution.objective,
        solved=solution.status.solved,
        iterations=solution.statistics.iterations,
        seconds=time.perf_counter() - begin,
        actions=actions,
    )


def print_iterations(
    name: str, tol: float, shown: bool
) -> AbstractContextManager[Callable[[RefinementIteration], None]]:
    """Return a context manager whose value prints a pass, or does nothing; see `gnc_opt.progress_display`."""
    if not shown:
        return nullcontext(lambda _: None)
    from gnc_opt.progress_display import show_refinement_progress

    return show_refinement_progress(name, tol)


def is_stagnating(errors: Sequence[float], tol: float) -> bool:
    """Return whether the errors of all passes decrease too slowly to reach the tolerance.

    With fewer than `CONVERGENCE_WINDOW` passes after the first, the result is False.
    """
    if len(errors) <= CONVERGENCE_WINDOW:
        return False
    before, now = min(errors[:-CONVERGENCE_WINDOW]), min(errors[-CONVERGENCE_WINDOW:])
    if now <= tol:
        return False
    return now >= before or CONVERGENCE_WINDOW * math.log(now / tol) > MAX_FURTHER_ITERATIONS * math.log(
        before / now
    )
