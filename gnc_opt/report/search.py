"""The progress of a search from many starts: one bar on standard error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

ShowEnding: TypeAlias = Callable[["float | None"], None]


@contextmanager
def search_meter(
    name: str, total: int, visible: bool, sense: float = 1.0, console: Console | None = None
) -> Iterator[ShowEnding]:
    """Show how many of ``total`` tasks have ended and the best objective among them.

    Parameters
    ----------
    name : str
        What is counted.
    total : int
    visible : bool
        Whether to show anything.
    sense : float
        Negative where a larger objective is better.
    console : rich.console.Console, optional
        Where to write; default: standard error.

    Yields
    ------
    callable
        ``show(objective)``; None for a task without one.
    """
    if not visible:
        yield lambda objective: None
        return
    columns = (
        TextColumn("{task.description}", style="bold"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[best]}"),
        TimeElapsedColumn(),
    )
    console = Console(stderr=True) if console is None else console
    with Progress(*columns, console=console, auto_refresh=False) as progress:
        bar = progress.add_task(name, total=total, best="")
        best: float | None = None

        def show(objective: float | None) -> None:
            nonlocal best
            if objective is not None and (best is None or sense * objective < sense * best):
                best = objective
            progress.update(
                bar, advance=1, best="" if best is None else f"best {best:.8g}", refresh=console.is_terminal
            )

        yield show
