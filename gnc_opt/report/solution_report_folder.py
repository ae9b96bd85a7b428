"""Report folder of a solution: page, summary, solution and figures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from gnc_opt.planning.solution.optimality_verdict import Verdict
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.report.html_report_document import build_html_document, create_report_folder, save_figures_as_svg
from gnc_opt.report.json_summaries import write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gnc_opt.plot.vehicle_motion_sampling import View


def write_report(
    solution: Solution,
    verdict: Verdict | None,
    directory: str | Path,
    *,
    view: View | None = None,
    description: str = "",
    command: str | None = None,
    author: str = "",
) -> list[Path]:
    """Write a design review page, the solution, its JSON summary and the figures to a folder.

    The page contains the trajectory, the controls and the optimality check, followed by the complete problem statement.

    Parameters
    ----------
    solution : Solution
        Without its problem, the figure of the Hamiltonian is omitted.
    verdict : Verdict or None
        None: no optimality check in the report.
    directory : str or Path
        Output folder; created if missing. Files of an earlier report are replaced.
    view : gnc_opt.plot.View, optional
        View for a figure of the trajectory and a 3-D scene (plotly of the extra ``report``).
    description : str
        Text about the model with its frames and assumptions, such as the docstring of the problem file.
    command : str, optional
        Command that reproduces the report, printed on the page.
    author : str
        Printed below the title, which is the name of the problem.

    Returns
    -------
    list of Path
        ``report.html``, ``summary.json``, ``solution.npz`` and the figures (SVG). The page is self-contained.

    Raises
    ------
    GncOptError
        ``directory`` is a file.

    Examples
    --------
    >>> from gnc_opt.report import write_report
    >>> paths = write_report(solution, go.verify(solution), "report")
    >>> print([path.name for path in paths[:3]])
    ['report.html', 'summary.json', 'solution.npz']
    """
    from gnc_opt.plot.animated_3d_scene import render_3d_scene_html
    from gnc_opt.report.solution_html_page import build_solution_page

    folder = create_report_folder(directory)
    motion = "" if view is None else render_3d_scene_html({solution.problem_name: solution}, view)
    files = save_figures_as_svg(folder, _draw_solution_figures(solution, view))
    headline, sections = build_solution_page(solution, verdict, files, motion, description, command)
    page = folder / "report.html"
    fingerprint = str(solution.provenance.get("fingerprint", ""))
    text = build_html_document(solution.problem_name, headline, sections, author, fingerprint)
    page.write_text(text, encoding="utf-8")
    summary = write_json(folder / "summary.json", solution, verdict)
    return [page, summary, solution.save(folder / "solution.npz"), *files.values()]


def _draw_solution_figures(solution: Solution, view: View | None) -> Iterator[tuple[str, Figure]]:
    """Yield file stem and figure of each plot of a solution with all phases."""
    from gnc_opt.plot import trajectory_figures
    from gnc_opt.plot.control_figures import plot_controls
    from gnc_opt.plot.trajectory_figure_3d import plot_motion

    if view is not None and view.position is not None:
        yield "trajectory", plot_motion(solution, view)
    yield "states", trajectory_figures.plot_states(solution)
    if any(phase.controls.size for phase in solution.phases.values()):
        yield "controls", plot_controls(solution)
    constraints = trajectory_figures.plot_path_constraints(solution)
    if constraints is not None:
        yield "constraints", constraints
    yield "costates", trajectory_figures.plot_costates(solution)
    if solution.problem is not None:
        yield "hamiltonian", trajectory_figures.plot_hamiltonian(solution)
