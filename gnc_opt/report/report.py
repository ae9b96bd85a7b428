"""A folder that holds all there is to know about one solution."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.verdict import Verdict
from gnc_opt.report.json_output import write_json
from gnc_opt.report.page import report_folder, save_figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gnc_opt.plot.view import View

Figures: TypeAlias = "Callable[[Solution, Path], Any]"


def write_report(
    solution: Solution,
    verdict: Verdict | None,
    directory: str | Path,
    *,
    figures: Figures | None = None,
    view: View | None = None,
    command: str | None = None,
) -> list[Path]:
    """Write one page that shows everything, the solution itself, its summary as JSON, and the figures into a folder.

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
    view : gnc_opt.plot.View, optional
        What of the motion is shown in three dimensions, over a slider of time, by plotly of the extra ``report``.
    command : str, optional
        How to get this report again, for the page.

    Returns
    -------
    list of Path
        ``report.html``, ``summary.json``, ``solution.npz`` and the figures (SVG). The page holds all figures
        and needs no other file.

    Raises
    ------
    GncOptError
        ``directory`` is a file.
    OSError
        A file cannot be written.

    Examples
    --------
    >>> from gnc_opt.report import write_report
    >>> paths = write_report(solution, go.verify(solution), "report")
    >>> print([path.name for path in paths[:3]])
    ['report.html', 'summary.json', 'solution.npz']
    """
    from gnc_opt.report.page import page

    folder = report_folder(directory)
    motion = "" if view is None else _motion(solution, view)
    pictures = save_figures(folder, _generic_figures(solution))
    if verdict is not None:
        pictures += save_figures(folder, [("verdict", _verdict_figure(verdict))])
    if figures is not None:
        pictures += _own_figures(folder, figures(solution, folder))
    told = folder / "report.html"
    told.write_text(page(solution, verdict, pictures, motion=motion, command=command), encoding="utf-8")
    summary = write_json(folder / "summary.json", solution, verdict)
    return [told, summary, solution.save(folder / "solution.npz"), *pictures]


def _motion(solution: Solution, view: View) -> str:
    from gnc_opt.plot.scene import scene_html

    return scene_html({solution.problem_name: solution}, view)


def _verdict_figure(verdict: Verdict) -> Figure:
    from gnc_opt.plot.refinement import plot_verdict

    return plot_verdict(verdict)


def _generic_figures(solution: Solution) -> Iterator[tuple[str, Figure]]:
    """Yield file stem and figure of what every solution has, all phases one after the other."""
    from gnc_opt.plot import trajectory
    from gnc_opt.plot.controls import plot_controls

    yield "states", trajectory.plot_states(solution)
    if any(leg.controls.size for leg in solution.phases.values()):
        yield "controls", plot_controls(solution)
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
        return save_figures(folder, result.items())
    items = list(result) if isinstance(result, Iterable) and not isinstance(result, (str, Path)) else [result]
    paths = [Path(item) for item in items if isinstance(item, (str, Path))]
    drawn = [item for item in items if not isinstance(item, (str, Path))]
    return paths + save_figures(folder, ((f"figure_{i}", item) for i, item in enumerate(drawn, 1)))
