"""Running the rendezvous: all cases beside the paper's table 4, their verdicts, figures and JSON."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

import gnc_opt as go
from gnc_opt.plot import View
from problems.comparison import Claim, Row, compare, printed, remark, show, write_json
from problems.fronts import Front, certified
from problems.rendezvous import search
from problems.rendezvous.model import (
    ALTITUDE,
    CASES,
    EQUATIONS,
    FINAL_POSITION,
    FINAL_SIGMA,
    INERTIA,
    MASS,
    MAX_FORCE,
    MAX_TORQUE,
    MESH,
    PAPER_MESH,
    VIEW,
    Equation,
    build,
)
from problems.rendezvous.optimal import OTHER_MINIMA, REFERENCE

_REMARK = """\
What fails is what the mesh leaves undone: no node sits on a switch, so the program smears each switch over a
node or two, and a polynomial through such nodes overshoots. With a segment boundary at every switch all
conditions pass; see switch_mesh() and switch_arcs() in problems/rendezvous/optimal.py.
"""

OTHER_MINIMUM = "the paper's is another local minimum, slower than the best"

_WIDTH = 130
"""Columns of the tables where the output is no terminal."""

_STYLES = {go.Result.PASS: "green", go.Result.FAIL: "bold red", go.Result.CANNOT_TELL: "yellow"}
_MARKS = {go.Result.PASS: "", go.Result.FAIL: " F", go.Result.CANNOT_TELL: " ?"}


@dataclass(frozen=True)
class Outcome:
    """A solved case with its verdict."""

    case: int
    equation: Equation
    mesh: go.Mesh
    solution: go.Solution
    verdict: go.Verdict


def solve_cases(
    cases: Sequence[int], equations: Sequence[Equation], mesh: go.Mesh = MESH
) -> Iterator[Outcome]:
    """Solve and verify one case after the other; each equation is transcribed once."""
    for equation in equations:
        problem = build(equation=equation)
        for case in cases:
            solution = go.solve(problem.with_initial(r_L=list(CASES[case])), mesh=mesh, tol=None)
            yield Outcome(case, equation, mesh, solution, go.verify(solution))


def time_rows(case: int, equation: Equation, t_f: float) -> list[Row]:
    """Return a minimum time (s) on the paper's mesh beside an independent solution there, and the paper's table 4."""
    known = REFERENCE[case, equation]
    own = known["20x3"]
    title = f"case {case}, {equation} equation: minimum time (s)"
    rows = [compare(title, own.value, t_f, absolute=own.tolerance)]
    for key in ("paper GPM", "paper GPOPS"):
        if key in known:
            theirs = known[key].value
            said = printed(f"{theirs:.6g}", t_f, within=known[key].tolerance)
            reason = OTHER_MINIMUM if (case, key) in OTHER_MINIMA else ""
            note = f"{100 * (theirs / known['exact'].value - 1):+.2f} % over the best known"
            rows.append(remark(f"case {case}, {key}", t_f, published=said, reason=reason, note=note))
    return rows


def data_rows() -> list[Row]:
    """Return the paper's data beside those that are used."""
    rows = [
        remark(f"data: {name}", ours, published=text)
        for name, ours, text in (
            ("moments of inertia (kg m^2)", INERTIA, "5621, 4547, 2364"),
            ("mass (kg)", MASS, "3200"),
            ("limits of torque (N m) and force (N)", (MAX_TORQUE, MAX_FORCE), "50, 320"),
            ("altitude (km)", ALTITUDE / 1e3, "580"),
            ("final sigma, y", FINAL_SIGMA[1], "0.4142"),
            ("final position (m)", FINAL_POSITION, "0, 0, -10"),
            ("segments and points of each", (PAPER_MESH.segments, PAPER_MESH.degrees[0]), "20, 3"),
        )
    ]
    rows += [
        remark(f"data: first position, case {case} (m)", place, published=", ".join(f"{c:g}" for c in place))
        for case, place in CASES.items()
    ]
    said = Claim("tan(90/2)", False)
    reason = "misprint: tan(90 deg / 4), as its number 0.4142 says"
    return [
        *rows,
        remark("data: formula of the final sigma, y", FINAL_SIGMA[1], published=said, reason=reason),
        remark(
            "the curves of figures 3 to 15",
            (),
            published=Claim("drawn", False),
            reason="not reproducible digit by digit: images without numbers; ours are in the report",
        ),
    ]


def comparison() -> list[Row]:
    """Return the rows of all cases and both equations on the paper's mesh."""
    outcomes = list(solve_cases(list(CASES), EQUATIONS, PAPER_MESH))
    times = [row for o in outcomes for row in time_rows(o.case, o.equation, o.solution.objective)]
    return data_rows() + size_rows(outcomes[0].solution) + times


SHARES = (1.0, 0.95, 0.9, 0.85, 0.8, 0.7, 0.6)
"""Of the authority, on the front."""


def front() -> Front:
    """Return what less time costs: the share of the torques and forces with which case 1 takes so long."""

    def solve(share: float) -> go.Solution:
        torque, force = share * MAX_TORQUE, share * MAX_FORCE
        return go.solve(build(1).with_bounds(T_B=(-torque, torque), F_B=(-force, force)), tol=1e-8)

    def measure(solution: go.Solution) -> tuple[float, float]:
        most = float(np.max(np.abs(solution.phase().flown(np.linspace(0.0, solution.objective, 500))[:3])))
        return solution.objective, 100 * most / MAX_TORQUE

    points = certified(SHARES, solve, measure)
    published = (REFERENCE[1, "printed"]["paper GPM"].value, 100.0)
    return Front("authority", "%", points, published, "the paper's GPM")


def moving() -> tuple[go.Solution, View]:
    """Return what a film shows: the optimum of case 1."""
    return go.solve(build(1), tol=1e-8), VIEW


def size_rows(solution: go.Solution) -> list[Row]:
    """Return the size of the programme beside the paper's: counted from what is unknown and what has to hold."""
    leg = solution.phase()
    states, controls = leg.states.size, leg.controls.size
    points, segments = leg.mesh.size, leg.mesh.segments
    variables = (points + segments + 1) * states + points * controls + 1
    # collocation at every point, the end of every segment by quadrature; the ends themselves are fixed by bounds
    constraints = (points + segments) * states
    return [
        remark("variables of the programme", variables, published="1333"),
        remark("constraints of the programme", constraints, published="960"),
        remark(
            "nonzeros of its Jacobian",
            (),
            published=Claim("11460", False),
            reason="not comparable: it depends on how the dynamics are written and what is condensed",
        ),
    ]


def times_table(outcomes: Sequence[Outcome]) -> Table:
    """Return these solutions beside the best known minimum times, and what they cost."""
    table = _table(f"Minimum times (s), mesh {outcomes[0].mesh}")
    for heading in ("case", "r_L(0) (m)", "equation"):
        table.add_column(heading, no_wrap=True)
    for words in (
        ("this", "solution"),
        ("best", "known"),
        ("slower", "by"),
        ("itera-", "tions"),
        ("solve", "(s)"),
    ):
        table.add_column("\n".join(words), justify="right", no_wrap=True)
    for outcome in outcomes:
        table.add_row(*_cells(outcome))
    return table


def _cells(outcome: Outcome) -> tuple[str, ...]:
    best = REFERENCE[outcome.case, outcome.equation]["exact"].value
    spent, t_f = outcome.solution.statistics, outcome.solution.objective
    return (
        str(outcome.case),
        ", ".join(f"{component:g}" for component in CASES[outcome.case]),
        outcome.equation,
        f"{t_f:.6f}",
        f"{best:.8f}",
        f"{t_f - best:+.1e}",
        str(spent.iterations),
        f"{spent.solve_s:.2f}",
    )


def verdict_table(outcomes: Sequence[Outcome]) -> Table:
    """Return the verdicts of one equation side by side: a row per condition, a column per case."""
    table = _table(f"Verdicts, {outcomes[0].equation} equation (F fails, ? open)")
    table.add_column("condition", no_wrap=True)
    table.add_column("tolerance", justify="right", no_wrap=True)
    for outcome in outcomes:
        table.add_column(f"case {outcome.case}", justify="right", no_wrap=True)
    for condition in outcomes[0].verdict.conditions:
        cells = [_condition_cell(outcome.verdict[condition.name]) for outcome in outcomes]
        table.add_row(condition.name, f"{condition.tolerance:.0e}", *cells)
    table.add_row("verdict", "", *["ok" if outcome.verdict.ok else "NOT ok" for outcome in outcomes])
    return table


def _condition_cell(condition: go.Condition) -> str:
    style, mark = _STYLES[condition.result], _MARKS[condition.result]
    return f"[{style}]{condition.value + 0.0:.1e}{mark}[/]"


def _table(title: str) -> Table:
    return Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)


def figures(solution: go.Solution, directory: str | Path | None = None) -> Mapping[str, Any]:
    """Return the paper's figures 3 to 15 by file stem; the caller writes them, into ``directory`` or not."""
    from problems.rendezvous.plots import paper_figures

    return paper_figures(solution)


# --- command line ---------------------------------------------------------------------------------------


def main(arguments: Sequence[str] | None = None) -> int:
    """Solve, compare with the paper, verify and draw; see ``python -m problems.rendezvous --help``.

    Returns
    -------
    int
        0; 1 if a case was not solved, or not to its reference on the paper's mesh; 2 for wrong arguments.
    """
    options = _parser().parse_args(arguments)
    console = _console()
    cases = list(CASES) if options.case is None else [options.case]
    if options.search:
        return _search(console, cases, options)
    equations = EQUATIONS if options.equation is None else (options.equation,)
    try:
        outcomes = list(solve_cases(cases, equations, options.mesh))
    except go.SolveError as error:
        print(error, file=sys.stderr)
        return 1
    # nothing is known of other meshes
    rows = [
        row
        for o in outcomes
        if o.mesh == PAPER_MESH
        for row in time_rows(o.case, o.equation, o.solution.objective)
    ]
    show(console, rows, "Minimum times and the paper's table 4")
    _show(console, outcomes)
    if options.json is not None:
        write_json(options.json, rows, cases=_summaries(outcomes))
    _draw(console, outcomes[0], options.report)
    return 0 if all(row.passes for row in rows) else 1


def _search(console: Console, cases: Sequence[int], options: argparse.Namespace) -> int:
    equation: Equation = options.equation or "printed"
    written = {"json_path": options.json, "folder": options.report}
    return search.run(console, cases, equation, n=options.n, seed=options.seed, **written)


def _show(console: Console, outcomes: Sequence[Outcome]) -> None:
    console.print(times_table(outcomes))
    for equation in dict.fromkeys(outcome.equation for outcome in outcomes):
        console.print(verdict_table([o for o in outcomes if o.equation == equation]))
    if not all(outcome.verdict.ok for outcome in outcomes):
        console.print(_REMARK, markup=False)
    if len(outcomes) == 1:
        console.print(str(outcomes[0].solution), markup=False, soft_wrap=True)
        console.print(outcomes[0].verdict.explain(), markup=False, soft_wrap=True)


def _draw(console: Console, outcome: Outcome, folder: Path) -> None:
    from gnc_opt.plot.style import save_figure

    paths = [
        save_figure(figure, folder / f"{stem}.png") for stem, figure in figures(outcome.solution).items()
    ]
    console.print(f"{len(paths)} figures of case {outcome.case}, {outcome.equation} equation, in {folder}/")


def _summaries(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    from gnc_opt.report.json_output import summary_dict

    return [{"case": o.case, "equation": o.equation, **summary_dict(o.solution, o.verdict)} for o in outcomes]


def _console() -> Console:
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, _WIDTH)
    return console


def _mesh(text: str) -> go.Mesh:
    try:
        return go.Mesh.parse(text)
    except go.ProblemError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m problems.rendezvous",
        description="Time-optimal rendezvous: solutions beside the paper's table 4, verdicts, figures.",
    )
    parser.add_argument("--case", type=int, choices=list(CASES), help="initial position; default: all five")
    parser.add_argument("--equation", choices=EQUATIONS, help="rotational dynamics; default: both")
    parser.add_argument("--mesh", type=_mesh, default=MESH, metavar="KxN", help="default: the paper's, 20x3")
    parser.add_argument(
        "--report",
        type=Path,
        default=Path("report"),
        metavar="DIR",
        help="folder of the figures; of the tables with --global",
    )
    parser.add_argument(
        "--json", type=Path, metavar="OUT", help="write the table and the summaries to a file"
    )
    parser.add_argument(
        "--global",
        dest="search",
        action="store_true",
        help="search for local minima and name the published ones",
    )
    parser.add_argument("--n", type=int, default=100, help="random starts of each case, with --global")
    parser.add_argument("--seed", type=int, default=1, help="of these starts")
    return parser
