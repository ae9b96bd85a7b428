"""Iterations of a refinement: records, progress output, limits and stagnation."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext

from gnc_opt.planning.refinement.collocation_error_estimate import (
    PhaseError,
    estimate_segment_errors,
    find_largest_error,
)
from gnc_opt.planning.solution.refinement_history import (
    Actions,
    RefinementIteration,
)
from gnc_opt.planning.solution.solution import Solution

CONVERGENCE_WINDOW = 6
"""Number of last passes that determine the convergence rate."""

MAX_FURTHER_ITERATIONS = 10
"""Largest number of further passes, predicted from the convergence rate, with which refinement continues."""


def record_iteration(
    solution: Solution, begin: float, actions: Actions | str, errors: Mapping[str, PhaseError] | None = None
) -> RefinementIteration:
    """Return the record of a pass from ``begin`` (s, `time.perf_counter`) to its solution; ``errors`` if known."""
    error, where = find_largest_error(errors or estimate_segment_errors(solution))
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


def is_refinement_stagnating(errors: Sequence[float], tol: float) -> bool:
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
