"""Progress display on standard error: solves, refinements, searches and campaigns."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

Show: TypeAlias = Callable[[int, float, float], None]
ShowPass: TypeAlias = Callable[[Any], None]
ShowEnding: TypeAlias = Callable[["float | None"], None]
ShowRuns: TypeAlias = Callable[[int, int], None]


@contextmanager
def show_solve_progress(name: str, console: Console | None = None) -> Iterator[Show]:
    """Show the iterations of a solve; yields ``show(iteration, objective, infeasibility)``.

    On a terminal one line is updated in place; elsewhere (a file, a pipe) only the last line is written.
    """
    console = _create_terminal_console() if console is None else console
    meter = _SolveMeter(name, console)
    try:
        yield meter.show_iteration
    finally:
        meter.close_display()


class _SolveMeter:
    def __init__(self, name: str, console: Console) -> None:
        self._name = name
        self._console = console
        self._begin = time.monotonic()
        self._due = self._begin
        self._line: Text | None = None
        self._live = (
            Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
        )
        if self._live:
            self._live.start()

    def show_iteration(self, iteration: int, objective: float, infeasibility: float) -> None:
        now = time.monotonic()
        self._line = Text.assemble(
            (self._name, "bold"),
            f"  iteration {iteration}  objective {objective:.8g}  infeasibility {infeasibility:.1e}",
            (f"  {now - self._begin:.1f} s", "dim"),
            no_wrap=True,
            overflow="ellipsis",
        )
        if self._live and now >= self._due:
            self._live.update(self._line, refresh=True)
            self._due = now + 0.1

    def close_display(self) -> None:
        if self._live:
            self._live.stop()
        if self._line is not None:
            self._console.print(self._line, soft_wrap=not self._console.is_terminal)


@contextmanager
def show_refinement_progress(
    name: str, tolerance: float, console: Console | None = None
) -> Iterator[ShowPass]:
    """Show each completed iteration of a refinement to a tolerance; yields ``show(record)``."""
    console = _create_terminal_console() if console is None else console
    console.print(Text(f"{name}: refining to {tolerance:.1e}", style="bold"))
    count = 0
    with console.status("solving") as status:

        def show_refinement_iteration(record: Any) -> None:
            nonlocal count
            line = (
                f"  iteration {count}  {record.n_segments} segments, {record.n_points} points  "
                f"error {record.error:.1e}  objective {record.objective:.10g}  {record.iterations} NLP iterations, "
                f"{record.seconds:.1f} s"
            )
            ending = "" if record.solved else "  not solved"
            console.print(Text(line + ending), soft_wrap=True)
            count += 1
            status.update(f"solving on mesh {count} (error {record.error:.1e})")

        yield show_refinement_iteration


@contextmanager
def show_multistart_progress(
    name: str, total: int, sense: float, console: Console | None = None
) -> Iterator[ShowEnding]:
    """Show completed tasks and the best objective; yields ``show(objective)``; ``sense`` < 0: maximise."""
    with _show_progress_bar(name, total, console) as advance:
        best: float | None = None

        def show_best_objective(objective: float | None) -> None:
            nonlocal best
            if objective is not None and (best is None or sense * objective < sense * best):
                best = objective
            advance(1, "" if best is None else f"best {best:.8g}")

        yield show_best_objective


@contextmanager
def show_campaign_progress(total: int, console: Console | None = None) -> Iterator[ShowRuns]:
    """Show the numbers of completed and failed runs; yields ``show(runs, failed)`` for additional runs."""
    with _show_progress_bar("runs", total, console) as advance:
        all_failed = 0

        def show_run_counts(runs: int, failed: int) -> None:
            nonlocal all_failed
            all_failed += failed
            advance(runs, f"{all_failed} failed" if all_failed else "")

        yield show_run_counts


@contextmanager
def _show_progress_bar(
    name: str, total: int, console: Console | None
) -> Iterator[Callable[[int, str], None]]:
    """Show a progress bar; yields ``advance(count, note)``, with a note after the bar."""
    console = _create_terminal_console() if console is None else console
    columns = (
        TextColumn("{task.description}", style="bold"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, auto_refresh=False) as progress:
        bar = progress.add_task(name, total=total, note="")

        def advance_progress_bar(count: int, note: str) -> None:
            progress.update(bar, advance=count, note=note, refresh=console.is_terminal)

        yield advance_progress_bar


def _create_terminal_console() -> Console:
    """Return a console on standard error; notebooks overwrite lines as terminals do, without widgets."""
    notebook = Console().is_jupyter
    return Console(stderr=True, force_jupyter=False, force_terminal=True if notebook else None)
