"""The progress of a mesh refinement: one line per pass on standard error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

from rich.console import Console
from rich.text import Text

from gnc_opt.solution.history import Pass

ShowPass: TypeAlias = Callable[[Pass], None]


@contextmanager
def refinement_meter(name: str, tolerance: float, console: Console | None = None) -> Iterator[ShowPass]:
    """Show each pass of a refinement when it is done, and on a terminal that the next one is being solved.

    Parameters
    ----------
    name : str
        Of the problem.
    tolerance : float
        What the error should come down to.
    console : rich.console.Console, optional
        Where to write; default: standard error.

    Yields
    ------
    callable
        ``show(record)``
    """
    console = Console(stderr=True) if console is None else console
    console.print(Text(f"{name}: refining to {tolerance:.1e}", style="bold"))
    count = 0
    with console.status("solving") as status:

        def show(record: Pass) -> None:
            nonlocal count
            line = (
                f"  pass {count}  {record.segments} segments, {record.points} points  error {record.error:.1e}  "
                f"objective {record.objective:.10g}  {record.iterations} iterations, {record.seconds:.1f} s"
            )
            ending = "" if record.solved else "  not solved"
            console.print(Text(line + ending), soft_wrap=True)
            count += 1
            status.update(f"solving pass {count} (error {record.error:.1e})")

        yield show
