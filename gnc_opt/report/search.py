"""A search from many starts: its progress, one bar on standard error, and what it found as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from gnc_opt.refine.search.multistart import Multistart, ShowEnding
from gnc_opt.report.summary_json import summary_dict


@contextmanager
def search_meter(
    name: str, total: int, sense: float = 1.0, console: Console | None = None
) -> Iterator[ShowEnding]:
    """Show how many of ``total`` tasks have ended and the best objective among them.

    Parameters
    ----------
    name : str
        What is counted.
    total : int
    sense : float
        Negative where a larger objective is better.
    console : rich.console.Console, optional
        Where to write; default: standard error.

    Yields
    ------
    callable
        ``show(objective)``; None for a task without one.
    """
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


def search_dict(found: Multistart) -> dict[str, Any]:
    """Return what a search found as plain JSON values; each minimum with the summary of its solution."""
    return {
        "problem": found.problem_name,
        "starts": found.starts,
        "finished": found.finished,
        "seed": found.seed,
        "interrupted": found.interrupted,
        "failures": dict(found.failures),
        "minima": [
            {
                "objective": minimum.objective,
                "hits": minimum.hits,
                "starts": list(minimum.starts),
                "trajectories": minimum.trajectories,
                "coarse_objectives": list(minimum.coarse_objectives),
                "refined": minimum.refined,
                "verdict_ok": minimum.verdict_ok,
                "standing": minimum.standing,
                "solution": summary_dict(minimum.solution),
            }
            for minimum in found.minima
        ],
    }


def search_text(found: Multistart) -> str:
    """Return `search_dict` as indented JSON text with a trailing newline."""
    return json.dumps(search_dict(found), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def write_search(path: str | Path, found: Multistart) -> None:
    """Write `search_dict` to a file as UTF-8 JSON."""
    Path(path).write_text(search_text(found), encoding="utf-8")
