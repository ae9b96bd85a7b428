"""The passes of a refinement: how each is recorded, whether it is shown, and whether they lead anywhere."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace

from gnc_opt.planning.direct.solve_mesh import SolveLimits
from gnc_opt.planning.refinement.error_estimation import PhaseError, find_largest_error
from gnc_opt.planning.solution.history import Actions, RefinementIteration, count_affordable_iterations
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh

CONVERGENCE_WINDOW = 6
"""So many passes tell how fast the error falls."""

MAX_FURTHER_ITERATIONS = 10
"""If it falls so slowly that more passes than this would be needed, refining stops."""


@dataclass(frozen=True)
class IterationLimits:
    """Where the passes of a refinement end, wherever it has come to.

    Attributes
    ----------
    passes : int
        At most so many solves.
    points : int
        At most so many collocation points in any phase.
    work : float
        What all passes together may cost, in iterations at one collocation point; see `RefinementIteration.work`.
    deadline : float
        When to stop, as `time.perf_counter` counts. Ctrl-C stops it, too.
    cpu_deadline : float
        When no work is left, as `time.thread_time` counts.
    worst : float
        A structure whose first pass has a larger error is not that of the problem, and is given up.
    """

    passes: int = 40
    points: int = 1000
    work: float = math.inf
    deadline: float = math.inf
    cpu_deadline: float = math.inf
    worst: float = math.inf

    def are_exhausted(self, spent: float) -> bool:
        """Return whether no pass begins after passes that cost so much work."""
        return spent >= self.work or time.thread_time() > self.cpu_deadline

    def limit_solve(self, meshes: Iterable[Mesh], spent: float = 0.0) -> SolveLimits:
        """Return what a solve on some meshes may take, after passes that cost so much work."""
        within = SolveLimits(deadline=self.deadline, cpu_deadline=self.cpu_deadline)
        if math.isinf(self.work):
            return within
        points = sum(mesh.size for mesh in meshes)
        return replace(within, iterations=max(1, count_affordable_iterations(self.work - spent, points)))


def record_iteration(
    solution: Solution, errors: Mapping[str, PhaseError], begin: float, actions: Actions | str
) -> RefinementIteration:
    """Return the record of a pass that began at a time (as `time.perf_counter` counts) and ended with a solution."""
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


def show_progress(
    name: str, tol: float, shown: bool
) -> AbstractContextManager[Callable[[RefinementIteration], None]]:
    """Return a context whose value shows a pass, or does nothing; see `gnc_opt.progress`."""
    if not shown:
        return nullcontext(lambda _: None)
    from gnc_opt.progress import refinement_meter

    return refinement_meter(name, tol)


def is_stagnating(errors: Sequence[float], tol: float) -> bool:
    """Whether the error falls too slowly, as in the last passes, to reach the tolerance.

    Parameters
    ----------
    errors : sequence of float
        Of all passes so far. Fewer than `CONVERGENCE_WINDOW` after the first show nothing.
    tol : float
        What the error should come down to.
    """
    if len(errors) <= CONVERGENCE_WINDOW:
        return False
    before, now = min(errors[:-CONVERGENCE_WINDOW]), min(errors[-CONVERGENCE_WINDOW:])
    if now <= tol:
        return False
    return now >= before or CONVERGENCE_WINDOW * math.log(now / tol) > MAX_FURTHER_ITERATIONS * math.log(
        before / now
    )
