"""Whether the passes of a refinement are shown."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

from gnc_opt.refine.history import Pass


def pass_meter(name: str, tol: float, shown: bool) -> AbstractContextManager[Callable[[Pass], None]]:
    """Return a context whose value shows a pass, or does nothing; see `gnc_opt.report.refinement`."""
    if not shown:
        return nullcontext(lambda _: None)
    from gnc_opt.report.refinement import refinement_meter

    return refinement_meter(name, tol)
