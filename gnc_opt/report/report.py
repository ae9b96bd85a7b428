"""The folder of a report on one solution: page, summary, solution and figures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.verdict import Verdict
from gnc_opt.report.document import report_folder, save_figures, write_page
from gnc_opt.report.json_output import write_json

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
    """Write a page for a design review, the solution, its summary as JSON, and the figures into a folder.

    The page begins with the trajectory, the controls and the optimality check, then states the problem in
    full.

    Parameters
    ----------
    solution : Solution
        Without its problem, there is no figure of the Hamiltonian.
    verdict : Verdict or None
        None writes no optimality check.
    directory : str or Path
        Made if it does not exist. Files of an earlier report are replaced.
    figures : callable, optional
        ``figures(solution, directory)`` writes a problem's own figures and returns their path(s), or returns
        matplotlib figures: one, a list, or a dict by name.
    view : gnc_opt.plot.View, optional
        Vehicles and motion: a figure of the trajectory and a scene (plotly of the extra ``report``).
    command : str, optional
        Command that writes this report, for the page.

    Returns
    -------
    list of Path
        ``report.html``, ``summary.json``, ``solution.npz`` and the figures (SVG). The page needs no other
        file.

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
    files = save_figures(folder, _figures(solution, verdict, view))
    own = [] if figures is None else _own_figures(folder, figures(solution, folder))
    text = page(solution, verdict, files, own, motion=motion, command=command)
    summary = write_json(folder / "summary.json", solution, verdict)
    return [
        write_page(folder, text),
        summary,
        solution.save(folder / "solution.npz"),
        *files.values(),
        *own,
    ]


def _motion(solution: Solution, view: View) -> str:
    from gnc_opt.plot.scene import scene_html

    return scene_html({solution.problem_name: solution}, view)


def _figures(solution: Solution, verdict: Verdict | None, view: View | None) -> Iterator[tuple[str, Figure]]:
    """Yield file stem and figure of what every solution has, all phases one after the other."""
    from gnc_opt.plot import trajectory
    from gnc_opt.plot.controls import plot_controls
    from gnc_opt.plot.path import plot_motion
    from gnc_opt.plot.refinement import plot_refinement, plot_verdict
    from gnc_opt.plot.style import per_unit

    unit = "" if solution.problem is None else solution.problem.cost_unit
    rate = "" if unit in ("", "s") else per_unit(unit, "s")
    if view is not None and view.position is not None:
        yield "trajectory", plot_motion(solution, view)
    yield "states", trajectory.plot_states(solution)
    if any(leg.controls.size for leg in solution.phases.values()):
        yield "controls", plot_controls(solution, hamiltonian_unit=rate)
    yield "costates", trajectory.plot_costates(solution, cost_unit=unit)
    if solution.problem is not None:
        yield "hamiltonian", trajectory.plot_hamiltonian(solution, unit=rate)
    if solution.history is not None:
        yield "refinement", plot_refinement(solution.history)
    if verdict is not None:
        yield "verdict", plot_verdict(verdict)


def _own_figures(folder: Path, result: Any) -> list[Path]:
    """Save or list what a problem's own ``figures`` function returned."""
    if result is None:
        return []
    if isinstance(result, dict):
        return list(save_figures(folder, result.items()).values())
    items = list(result) if isinstance(result, Iterable) and not isinstance(result, (str, Path)) else [result]
    paths = [Path(item) for item in items if isinstance(item, (str, Path))]
    drawn = [item for item in items if not isinstance(item, (str, Path))]
    saved = save_figures(folder, ((f"figure_{i}", item) for i, item in enumerate(drawn, 1)))
    return [*paths, *saved.values()]
