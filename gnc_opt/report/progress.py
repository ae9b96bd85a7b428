"""The progress meter of a solve: one line on standard error."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

from rich.console import Console
from rich.live import Live
from rich.text import Text

Show: TypeAlias = Callable[[int, float, float], None]

PERIOD = 0.1
"""Least time between two updates, s."""


@contextmanager
def solve_meter(name: str, console: Console | None = None) -> Iterator[Show]:
    """Show the iterations of a solve while it runs.

    On a terminal one line is updated in place, at most ten times a second, and stays when the solve ends.
    Elsewhere (a file, a pipe) only that last line is written.

    Parameters
    ----------
    name : str
        Of the problem.
    console : rich.console.Console, optional
        Where to write; default: standard error.

    Yields
    ------
    callable
        ``show(iteration, objective, infeasibility)``: the NLP's iterate; infeasibility is the largest scaled
        violation.
    """
    console = Console(stderr=True) if console is None else console
    meter = _Meter(name, console)
    try:
        yield meter.show
    finally:
        meter.close()


class _Meter:
    def __init__(self, name: str, console: Console) -> None:
        self._name = name
        self._console = console
        self._begin = time.monotonic()
        self._due = self._begin
        self._line: Text | None = None
        # No refresh thread: it would compete with the solver for the interpreter.
        self._live = (
            Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
        )
        if self._live:
            self._live.start()

    def show(self, iteration: int, objective: float, infeasibility: float) -> None:
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
            self._due = now + PERIOD

    def close(self) -> None:
        if self._live:
            self._live.stop()
        if self._line is not None:
            self._console.print(self._line, soft_wrap=not self._console.is_terminal)
