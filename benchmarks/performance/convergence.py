"""Convergence in degree: errors of state, control and costate against closed forms, for all three schemes.

    python -m benchmarks.performance.convergence [--json OUT.json] [--figure OUT.png] [--degrees 12]

Two smooth problems on one segment, so that the degree alone refines: errors fall faster than any power of the
degree (a straight line on a logarithmic axis, or a steeper one) until rounding or the solver's tolerance
stops them. Errors are the largest over a dense grid of times, ends included, relative to the largest exact
value of the component.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from rich.console import Console
from rich.table import Table
from scipy.optimize import brentq

import gnc_opt as go
from gnc_opt.planning.transcription.scheme import Scheme
from gnc_opt.plot.style import line_look, new_figure, save_figure, style

Array = NDArray[np.float64]
Signal = Callable[[Array], Array]

SCHEMES: tuple[Scheme, ...] = ("LG", "LGR", "LGL")
QUANTITIES = ("state", "control", "costate")
TOLERANCE = 1e-11
FLOOR = 1e-16
"""Smaller errors (exact to the last bit) are drawn here."""


@dataclass(frozen=True)
class Case:
    """A problem and its exact solution.

    Attributes
    ----------
    name : str
    problem : gnc_opt.Problem
    truth : mapping from quantity to mapping from variable to function of time
    objective : float
    """

    name: str
    problem: go.Problem
    truth: Mapping[str, Mapping[str, Signal]]
    objective: float


@dataclass(frozen=True)
class Row:
    """Errors of one solve; NaN where it failed.

    Attributes
    ----------
    case, scheme : str
    degree, iterations : int
    state, control, costate : float
        Largest errors along the trajectory, relative to the largest exact value.
    initial_costate : float
        The same at the initial time alone, where the costate is the derivative of the optimal cost.
    objective : float
        Relative error.
    """

    case: str
    scheme: str
    degree: int
    iterations: int
    state: float
    control: float
    costate: float
    initial_costate: float
    objective: float


def regulator() -> Case:
    """min 1/2 int x^2 + u^2 over 2 s, x' = u, x(0) = 1: x = cosh(2 - t) / cosh 2, u = x', lam = -u."""
    T = 2.0
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("scalar regulator")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=T)
    leg.initial(x=1.0)
    problem.minimize(leg.integral((x**2 + u**2) / 2))
    truth = {
        "state": {"x": lambda t: np.cosh(T - t) / np.cosh(T)},
        "control": {"u": lambda t: -np.sinh(T - t) / np.cosh(T)},
        "costate": {"x": lambda t: np.sinh(T - t) / np.cosh(T)},
    }
    return Case("scalar regulator", problem, truth, float(np.tanh(T) / 2))


def brachistochrone() -> Case:
    """The bead from (0, 0) to (2, 2) m, y down, g = 9.8 m/s^2: a cycloid (Bryson & Ho, 1975)."""
    g, target = 9.8, 2.0
    bead = go.Model("bead")
    x, y, v, angle = bead.state("x"), bead.state("y"), bead.state("v"), bead.control("angle")
    bead.ode({x: v * ca.sin(angle), y: v * ca.cos(angle), v: g * ca.cos(angle)})
    problem = go.Problem("brachistochrone")
    leg = problem.phase("leg", bead)
    leg.time(initial=0.0, final=(0.1, 10.0))
    leg.initial(x=0.0, y=0.0, v=0.0)
    leg.final(x=target, y=target)
    leg.bounds(angle=(-1.0, np.pi))
    leg.guess(angle=(0.2, 1.2), v=(0.0, 6.0), time=[0.0, 1.0])
    problem.minimize(leg.final_time)
    end = brentq(lambda a: (a - np.sin(a)) - (1 - np.cos(a)), 1.0, 4.0, xtol=1e-15)
    radius = target / (1 - np.cos(end))
    rate, top = np.sqrt(g / radius), 2 * np.sqrt(g * radius)
    lam_y = -np.cos(end / 2) / (top * np.sin(end / 2))
    truth = {
        "state": {
            "x": lambda t: radius * (rate * t - np.sin(rate * t)),
            "y": lambda t: radius * (1 - np.cos(rate * t)),
            "v": lambda t: top * np.sin(rate * t / 2),
        },
        "control": {"angle": lambda t: rate * t / 2},
        "costate": {
            "x": lambda t: np.full_like(t, -1 / top),
            "y": lambda t: np.full_like(t, lam_y),
            "v": lambda t: -(np.cos(rate * t / 2) + lam_y * top * np.sin(rate * t / 2)) / g,
        },
    }
    return Case("brachistochrone", problem, truth, end / rate)


def measure(case: Case, scheme: Scheme, degree: int) -> Row:
    """Solve a case on one segment of the given degree and compare."""
    solution = go.solve(
        case.problem,
        mesh=go.Mesh.uniform(1, degree),
        scheme=scheme,
        options=go.SolverOptions(tolerance=TOLERANCE),
        throw=False,
        tol=None,
    )
    iterations = solution.statistics.iterations
    if not solution.status.solved:
        return Row(case.name, scheme, degree, iterations, *([float("nan")] * 5))
    leg = solution.phase()
    times = np.linspace(leg.initial_time, leg.final_time, 201)
    find = {"state": leg.state, "control": leg.control, "costate": leg.costate}
    errors = {
        quantity: max(relative_error(find[quantity](name)(times), f(times)) for name, f in signals.items())
        for quantity, signals in case.truth.items()
    }
    initial = max(
        relative_error(np.atleast_1d(leg.costate(name)(times[0])), f(times), f(times[:1]))
        for name, f in case.truth["costate"].items()
    )
    objective = abs(solution.objective / case.objective - 1)
    return Row(case.name, scheme, degree, iterations, **errors, initial_costate=initial, objective=objective)


def relative_error(found: ArrayLike, exact: Array, at: Array | None = None) -> float:
    """Largest |found - at| over the largest |exact|; ``at`` defaults to ``exact``."""
    return float(np.max(np.abs(np.asarray(found) - (exact if at is None else at))) / np.max(np.abs(exact)))


def run(degrees: Sequence[int]) -> list[Row]:
    """Measure all cases and schemes; LGL begins with 2 points."""
    return [
        measure(case, scheme, degree)
        for case in (regulator(), brachistochrone())
        for scheme in SCHEMES
        for degree in degrees
        if not (scheme == "LGL" and degree < 2)
    ]


def table(rows: list[Row], case: str) -> Table:
    """Return the errors of a case, one line per degree and a group of columns per scheme."""
    title = f"\n{case}: relative errors on one segment of degree n"
    result = Table(title=title, title_justify="left", box=None, padding=(0, 1, 0, 0))
    result.add_column("n", justify="right", no_wrap=True)
    for scheme in SCHEMES:
        for quantity in QUANTITIES:
            result.add_column(f"{scheme}\n{quantity}", justify="right", no_wrap=True)
    chosen = {(row.scheme, row.degree): row for row in rows if row.case == case}
    for degree in sorted({degree for _, degree in chosen}):
        cells = [str(degree)]
        for scheme in SCHEMES:
            row = chosen.get((scheme, degree))
            cells += ["" if row is None else number(getattr(row, quantity)) for quantity in QUANTITIES]
        result.add_row(*cells)
    return result


def number(value: float) -> str:
    """Two digits; a dash for a failed solve."""
    return "-" if np.isnan(value) else f"{value:.1e}"


def figure(rows: list[Row], path: Path) -> Path:
    """Draw the errors over the degree, a row of panels per case and a column per quantity."""
    with style():
        drawing = new_figure(5.4, width=7.5)
        cases = list(dict.fromkeys(row.case for row in rows))
        panels = drawing.subplots(len(cases), len(QUANTITIES), sharex=True, sharey=True, squeeze=False)
        for i, case in enumerate(cases):
            for j, quantity in enumerate(QUANTITIES):
                panel = panels[i, j]
                for k, scheme in enumerate(SCHEMES):
                    chosen = [row for row in rows if row.case == case and row.scheme == scheme]
                    errors = [max(getattr(row, quantity), FLOOR) for row in chosen]
                    degrees = [row.degree for row in chosen]
                    panel.semilogy(
                        degrees, errors, marker="os^"[k], markersize=4, label=scheme, **line_look(k)
                    )
                panel.set_title(f"{case}: {quantity}")
                panel.set_ylim(FLOOR / 3, 30.0)
                panel.set_yticks([1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 1.0])
            panels[i, 0].set_ylabel("largest relative error")
        for panel in panels[-1]:
            panel.set_xlabel("degree (collocation points)")
            panel.set_xticks(range(2, max(row.degree for row in rows) + 1, 2))
        panels[0, 0].legend(loc="lower left")
        return save_figure(drawing, path, dpi=200)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.performance.convergence", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--json", type=Path, metavar="OUT", help="write all errors to this file")
    parser.add_argument("--figure", type=Path, metavar="OUT", help="draw them to this file (png, pdf, svg)")
    parser.add_argument("--degrees", type=int, default=12, metavar="N", help="highest degree (default 12)")
    options = parser.parse_args(arguments)
    rows = run(range(1, options.degrees + 1))
    console = Console()
    for case in dict.fromkeys(row.case for row in rows):
        console.print(table(rows, case))
    if options.json:
        content = {
            "tolerance": TOLERANCE,
            "gnc_opt": version("gnc_opt"),
            "rows": [asdict(row) for row in rows],
        }
        options.json.write_text(json.dumps(content, indent=1).replace("NaN", "null") + "\n")
        console.print(f"written: {options.json}")
    if options.figure:
        console.print(f"written: {figure(rows, options.figure)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
