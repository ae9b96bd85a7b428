"""The passes of a refinement: how each is recorded, whether it is shown, and whether they lead anywhere."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace

from gnc_opt.planning.direct.solve_mesh import SolveLimits
from gnc_opt.planning.refinement.error import PhaseError, largest_error
from gnc_opt.planning.solution.history import Actions, RefinementIteration, iterations_for
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh

CONVERGENCE_WINDOW = 6
"""So many passes tell how fast the error falls."""

MAX_FURTHER_ITERATIONS = 10
"""If it falls so slowly that more passes than this would be needed, refining stops."""


PROMISING_ERROR_RATIO, PROMISING_WORK_RATIO = 0.3, 2.0
"""A pass that leaves no more than this share of the error may be followed by others up to so many times the work."""


ITERATION_SHARE = 0.5
"""Share of all that is allowed that a pass may take where the budget permits it, ..."""

BUDGET_MIN_ITERATIONS = 25
"""... and iterations: a warm start near its end takes no more, on however fine a mesh."""


@dataclass(frozen=True)
class PassLimits:
    """Where the passes of a refinement end, wherever it has come to.

    Attributes
    ----------
    passes : int
        At most so many solves.
    points : int
        At most so many collocation points in any phase.
    work : float
        No pass begins after this much work, in iterations at one collocation point; see
        `RefinementIteration.work` and `allowed`.
        One that has begun may cost half as much more at most; see `of_solve`.
    most : float
        What all passes may cost in any case.
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
    most: float = math.inf
    deadline: float = math.inf
    cpu_deadline: float = math.inf
    worst: float = math.inf

    def allowed(self, records: Sequence[RefinementIteration], factor: float = 1.0) -> float:
        """What all passes may cost after these: more where the last one says that few others will do."""
        errors = [r.error for r in records[-2:]]
        promising = bool(errors) and errors[-1] <= PROMISING_ERROR_RATIO * errors[0]
        return min(self.work * max(factor, PROMISING_WORK_RATIO if promising else 1.0), self.most)

    def are_spent(self, records: Sequence[RefinementIteration], spent: float, factor: float = 1.0) -> bool:
        """Whether no pass begins after these, of which so much work counts."""
        over = time.thread_time() > self.cpu_deadline or spent >= self.most
        return over or spent > self.allowed(records, factor)

    def of_solve(
        self, meshes: Iterable[Mesh], records: Sequence[RefinementIteration] = (), spent: float = 0.0
    ) -> SolveLimits:
        """What a solve on some meshes may take, after passes of which so much work counts."""
        within = SolveLimits(deadline=self.deadline, cpu_deadline=self.cpu_deadline)
        if math.isinf(self.work):
            return within
        points = sum(mesh.size for mesh in meshes)
        left = max(
            self.allowed(records) - spent, ITERATION_SHARE * self.work
        )  # what it cannot finish would be lost
        iterations = max(BUDGET_MIN_ITERATIONS, iterations_for(left, points))
        if math.isfinite(self.most):
            iterations = min(iterations, max(1, iterations_for(self.most - spent, points)))
        return replace(within, iterations=iterations)


def pass_record(
    solution: Solution, errors: Mapping[str, PhaseError], begin: float, actions: Actions | str
) -> RefinementIteration:
    """Return the record of a pass that began at a time (as `time.perf_counter` counts) and ended with a solution."""
    error, where = largest_error(errors)
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


def pass_meter(
    name: str, tol: float, shown: bool
) -> AbstractContextManager[Callable[[RefinementIteration], None]]:
    """Return a context whose value shows a pass, or does nothing; see `gnc_opt.progress`."""
    if not shown:
        return nullcontext(lambda _: None)
    from gnc_opt.progress import refinement_meter

    return refinement_meter(name, tol)


def converges_too_slowly(errors: Sequence[float], tol: float) -> bool:
    """Whether the error falls too slowly, as in the last passes, to reach the tolerance.

    Parameters
    ----------
    errors : sequence of float
        Of all passes so far. Fewer than `CONVERGENCE_WINDOW` after the first tell nothing.
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
