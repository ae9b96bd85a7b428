"""A folder that holds all there is to know about one solution."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeAlias

from matplotlib.figure import Figure

from gnc_opt.errors import GncOptError
from gnc_opt.report.summary import summary
from gnc_opt.report.summary_json import write_json
from gnc_opt.solution.solution import Solution
from gnc_opt.verify.verdict import Verdict

Figures: TypeAlias = "Callable[[Solution, Path], Any]"


def write_report(
    solution: Solution, verdict: Verdict | None, directory: str | Path, *, figures: Figures | None = None
) -> list[Path]:
    """Write summary, verdict, the solution itself and figures into a folder.

    Parameters
    ----------
    solution : Solution
        Joined to its problem; one without it gets no figure of the Hamiltonian.
    verdict : Verdict or None
        None writes no verdict.
    directory : str or Path
        Made if it does not exist. Files of an earlier report are replaced.
    figures : callable, optional
        ``figures(solution, directory)`` draws a problem's own figures. It either writes them and returns
        their path(s), or returns matplotlib figures: one, a list, or a dict by name.

    Returns
    -------
    list of Path
        ``summary.txt``, ``verdict.txt``, ``summary.json``, ``solution.npz`` and the figures (PNG).

    Raises
    ------
    GncOptError
        ``directory`` is a file.
    OSError
        A file cannot be written.
    """
    folder = Path(directory)
    if folder.exists() and not folder.is_dir():
        raise GncOptError(f"cannot write the report to '{folder}', which is a file: name a folder.")
    folder.mkdir(parents=True, exist_ok=True)
    written = [_write(folder / "summary.txt", summary(solution) + "\n")]
    if verdict is not None:
        written.append(_write(folder / "verdict.txt", _verdict_text(verdict)))
    written.append(write_json(folder / "summary.json", solution, verdict))
    written.append(solution.save(folder / "solution.npz"))
    written += _save_figures(folder, _generic_figures(solution))
    if verdict is not None:
        written += _save_figures(folder, [("verdict", _verdict_figure(verdict))])
    if figures is not None:
        written += _own_figures(folder, figures(solution, folder))
    return written


def _write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def _verdict_text(verdict: Verdict) -> str:
    from gnc_opt.report.verdict_table import verdict_text

    return f"{verdict_text(verdict)}\n{verdict.explain()}\n"


def _verdict_figure(verdict: Verdict) -> Figure:
    from gnc_opt.plot.verdict import plot_verdict

    return plot_verdict(verdict)


def _generic_figures(solution: Solution) -> Iterator[tuple[str, Figure]]:
    """Yield file stem and figure of what every solution has, all phases one after the other."""
    from gnc_opt.plot import trajectory

    yield "states", trajectory.plot_states(solution)
    if any(leg.controls.size for leg in solution.phases.values()):
        yield "controls", trajectory.plot_controls(solution)
    yield "costates", trajectory.plot_costates(solution)
    if solution.problem is not None:
        yield "hamiltonian", trajectory.plot_hamiltonian(solution)
    if solution.history is not None:
        from gnc_opt.plot.refinement import plot_refinement

        yield "refinement", plot_refinement(solution.history)


def _own_figures(folder: Path, result: Any) -> list[Path]:
    """Save or list what a problem's own ``figures`` function returned."""
    if result is None:
        return []
    if isinstance(result, dict):
        return _save_figures(folder, result.items())
    items = list(result) if isinstance(result, Iterable) and not isinstance(result, (str, Path)) else [result]
    paths = [Path(item) for item in items if isinstance(item, (str, Path))]
    drawn = [item for item in items if not isinstance(item, (str, Path))]
    return paths + _save_figures(folder, ((f"figure_{i}", item) for i, item in enumerate(drawn, 1)))


def _save_figures(folder: Path, figures: Iterable[tuple[str, Any]]) -> list[Path]:
    from gnc_opt.plot.style import save_figure

    return [save_figure(figure, folder / f"{stem}.png") for stem, figure in figures]
