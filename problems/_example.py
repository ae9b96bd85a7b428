"""What every example has: a reference value, perhaps a closed form, and a ``main`` that solves and verifies."""

from __future__ import annotations

import argparse
import inspect
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

import gnc_opt as go
from gnc_opt.report import summary_dict, write_report

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reference:
    """The known optimal value of a problem at the default arguments of its ``build``.

    Attributes
    ----------
    value : float
        Of the objective as stated, also when it is maximised.
    source : str
        A closed form, a publication, or how an independent calculation was made.
    tolerance : float
        How closely a correct solution must agree, absolute, in the objective's unit.
    unit : str
        Of the objective; empty if it has none.
    """

    value: float
    source: str
    tolerance: float
    unit: str = ""

    def difference(self, objective: float) -> float:
        """Return how far an objective is off, with its sign."""
        return float(objective - self.value)

    def agrees(self, objective: float) -> bool:
        """Whether an objective is the reference's within the tolerance; a NaN never is."""
        return bool(abs(self.difference(objective)) <= self.tolerance)


@dataclass(frozen=True)
class Extremal:
    """States, controls and costates of the optimum at given times, by name; what is not known is left out.

    Costates have the library's signs: the Hamiltonian is minimised, ``lam(t_0)`` is the derivative of the
    minimised cost with respect to the initial state.
    """

    states: Mapping[str, Array] = field(default_factory=dict)
    controls: Mapping[str, Array] = field(default_factory=dict)
    costates: Mapping[str, Array] = field(default_factory=dict)


TOLERANCE = 1e-8
"""Of the refinement."""

_WIDTH = 120
"""Columns where the output is no terminal."""


def run(
    build: Callable[[], go.Problem],
    reference: Reference,
    arguments: Sequence[str] | None = None,
    *,
    explained: Mapping[str, str] | None = None,
    tol: float = TOLERANCE,
    closed_loop: Callable[[go.Solution], str] | None = None,
) -> int:
    """Solve a problem at default settings, refine, and say how the answer compares.

    Parameters
    ----------
    build : callable
        Of the problem file.
    reference : Reference
    arguments : sequence of str, optional
        Of the command line, without the program's name; default ``sys.argv[1:]``.
    explained : mapping, optional
        Conditions of the verdict that are known to fail, with the reason. They are shown as failed, with
        the reason beside them, but do not count in the exit code.
    tol : float
        Of the refinement.
    closed_loop : callable, optional
        Tracks the solution and returns a line about it.

    Returns
    -------
    int
        0; 1 if there is no solution, the reference is missed, or the verdict fails for no known reason.
    """
    options = _parser(build).parse_args(arguments)
    console = wide_console()
    try:
        solution = go.solve(build(), tol=tol)
    except go.SolveError as error:
        print(error, file=sys.stderr)
        return 1
    verdict = go.verify(solution)
    known = explained or {}
    _show(console, solution, verdict, known)
    _say(console, comparison(solution.objective, reference))
    if closed_loop is not None:
        _say(console, closed_loop(solution))
    if options.json is not None:
        _write_json(options.json, solution, verdict, reference)
    if options.report is not None:
        about = inspect.getdoc(inspect.getmodule(build)) or ""
        paths = write_report(solution, verdict, options.report, description=about)
        _say(console, f"report: {paths[0]}")
    unexplained = [condition for condition in verdict.failed if condition.name not in known]
    return 0 if reference.agrees(solution.objective) and not unexplained else 1


def example_main(build: Callable[[], go.Problem], reference: Reference, **options: Any) -> Callable[..., int]:
    """Return the ``main`` of a problem file: `run` of its problem; ``options`` are those of `run`."""

    def main(arguments: Sequence[str] | None = None) -> int:
        return run(build, reference, arguments, **options)

    return main


def comparison(objective: float, reference: Reference) -> str:
    """Return the line that compares an objective with its reference."""
    unit = f" {reference.unit}" if reference.unit else ""
    return (
        f"objective {objective:.12g}{unit}, reference {reference.value:.12g}{unit} ({reference.source}), "
        f"difference {reference.difference(objective):+.1e} (tolerance {reference.tolerance:.0e}): "
        f"{'pass' if reference.agrees(objective) else 'FAIL'}"
    )


def _show(console: Console, solution: go.Solution, verdict: go.Verdict, explained: Mapping[str, str]) -> None:
    _say(console, str(solution))
    _say(console, str(verdict))
    for condition in verdict.failed:
        reason = explained.get(condition.name)
        _say(console, f"{condition.name}: {f'expected. {reason}' if reason else condition.meaning}")


def _write_json(path: Path, solution: go.Solution, verdict: go.Verdict, reference: Reference) -> None:
    """Write the summary of `summary_dict` with one more key, ``reference``."""
    results: dict[str, Any] = summary_dict(solution, verdict)
    results["reference"] = {
        "value": reference.value,
        "source": reference.source,
        "tolerance": reference.tolerance,
        "unit": reference.unit,
        "difference": reference.difference(solution.objective),
        "agrees": reference.agrees(solution.objective),
    }
    path.write_text(
        json.dumps(results, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8"
    )


def _say(console: Console, text: str) -> None:
    console.print(text, markup=False, soft_wrap=True)


def wide_console(width: int = _WIDTH) -> Console:
    """Return a console of at least so many columns if the output is no terminal."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, width)
    return console


def _parser(build: Callable[[], go.Problem]) -> argparse.ArgumentParser:
    file = Path(inspect.getfile(build))
    description = (inspect.getmodule(build).__doc__ or "").partition("\n")[0]
    is_system = (file.parent / "__main__.py").exists()
    name = file.parent.name if is_system else f"{file.parent.name}.{file.stem}"
    parser = argparse.ArgumentParser(prog=f"python -m problems.{name}", description=description)
    parser.add_argument(
        "--report", type=Path, metavar="DIR", help="write summary, verdict, solution and figures to a folder"
    )
    parser.add_argument(
        "--json", type=Path, metavar="OUT", help="write the summary and the comparison to a file"
    )
    return parser
