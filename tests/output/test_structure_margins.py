"""Smallest margins of the sequence of arcs, against closed forms and a search on a fine grid."""

import importlib.machinery
import re
import sys
import types

import numpy as np
import pytest
from scipy.signal import argrelmax, argrelmin
from testing.internals import (
    create_axes_rows,
    embed_figure,
    find_running_command,
    list_channel_margins,
    list_structure_margins,
)
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.plot import save_figure
from gnc_opt.problem_file import load_problem_file
from gnc_opt.report import write_report
from problems.rendezvous import build


def solve_oscillator(start, limit=1.0):
    """x'' = u - x to rest in least time: S = lambda_v is a sine of time, and H = -1 at the start at rest."""
    model = go.Model("oscillator")
    x, v, u = model.state("x", unit="m"), model.state("v", unit="m/s"), model.control("u", unit="m/s^2")
    model.ode({x: v, v: u - x})
    problem, leg = one_phase("to rest", model, initial=0.0, final=(1.0, 20.0))
    leg.initial(x=start, v=0.0)
    leg.final(x=0.0, v=0.0)
    leg.bounds(u=(-limit, limit))
    problem.minimize(leg.final_time)
    return go.solve(problem)


def test_margins_of_an_oscillator_are_those_of_a_sine(tmp_path):
    solution = solve_oscillator(3.2)
    first, *_, last = solution.structure
    amplitude = 1 / (4.2 * np.sin(first.end))
    margins = {m.kind: m for m in list_structure_margins(solution)}
    arc, switch, extremum = (
        margins[kind] for kind in ("shortest arc", "slowest switch", "smallest extremum")
    )
    lengths = [a.end - a.start for a in solution.structure]
    t_f = solution.phase().final_time
    assert len(lengths) == 3 and lengths[1] == pytest.approx(np.pi, abs=1e-6)
    assert arc.value == pytest.approx(min(lengths)) and arc.risk == pytest.approx(t_f / min(lengths))
    assert switch.value == pytest.approx(amplitude, rel=1e-6) and switch.risk == pytest.approx(1.0, rel=1e-6)
    ends = {0.0: np.sin(first.end), t_f: np.sin(last.end - last.start)}
    time = min(ends, key=lambda t: ends[t])
    assert extremum.time == pytest.approx(time) and extremum.risk == pytest.approx(1 / ends[time], rel=1e-6)
    assert extremum.value == pytest.approx(amplitude * ends[time], rel=1e-6)
    page = write_report(solution, None, tmp_path)[0].read_text("utf-8")
    for text in (
        f"extremum of {100 * ends[time]:.3g} % of its largest magnitude",
        f"<td>{min(lengths):.5g} s</td><td>{100 * min(lengths) / t_f:.3g} % of the phase</td>",
        f"<td>{amplitude:.3g} 1/(m/s<sup>2</sup>) per s</td>",
        f"S changes by {t_f:.3g} % of the largest |S|",
    ):
        assert text in page, text


def test_margins_of_the_rendezvous_agree_with_a_search_on_a_grid(tmp_path):
    solution = go.solve(build(1))
    leg, margins = solution.phase(), {m.kind: m for m in list_structure_margins(solution)}
    grid, found = np.linspace(leg.initial_time, leg.final_time, 100_001), []
    for name in ("T_B", "F_B"):
        sizes = np.abs(solution.switching_function(name, grid))
        for i, size in enumerate(sizes):
            switches = [a.end for a in solution.structure[:] if a.channel == f"{name}[{i}]"]
            for k in (*argrelmin(size)[0], *argrelmax(size)[0]):
                if np.min(np.abs(grid[k] - switches)) > 1e-3:
                    found.append((size[k] / size.max(), grid[k], f"{name}[{i}]"))
    share, time, label = min(found)
    extremum, switch = margins["smallest extremum"], margins["slowest switch"]
    assert label == extremum.label and time == pytest.approx(extremum.time, abs=1e-2)
    assert 1 / extremum.risk == pytest.approx(share, rel=1e-3)
    around = solution.switching_function("T_B", switch.time + np.array([-1e-3, 1e-3]))[int(switch.label[4])]
    assert switch.value == pytest.approx(abs(np.diff(around)[0]) / 2e-3, rel=1e-3)
    page = write_report(solution, None, tmp_path)[0].read_text("utf-8")
    row = re.search(
        r"<tr><td>\|<i>r</i><sub>L</sub>\|</td><td>20</td><td>10</td><td>([\d.]+)</td><td>20</td>", page
    )
    lengths = np.linalg.norm(solution.state("r_L")(grid), axis=0)
    assert float(row[1]) == pytest.approx(lengths.min(), rel=1e-4)
    shown = re.search(r"from ([\d.]+) m \(at ([\d.]+) s\) to 20 m \(at 0 s\)", page)
    nearest = float(grid[np.argmin(lengths)])
    assert list(map(float, shown.groups())) == pytest.approx([lengths.min(), nearest], rel=1e-3)
    largest = float(np.max(np.abs(solution.state("sigma")(grid))))  # controls attain their limits
    text = rf"σ ≤ 1: ([\d.]+) attained at ([\d.]+) s, margin {100 * (1 - largest):.3g} %"
    assert float(re.search(text, page.replace("<i>σ</i>", "σ"))[1]) == pytest.approx(largest, rel=1e-5)
    assert f"gnc_opt {go.__version__}, fingerprint {solution.provenance['fingerprint']}</p>" in page


def test_extrema_include_those_between_switches_that_approach_zero():
    """Two oscillators with one control: S is a sum of sines, with extrema of |S| that are no maxima."""
    model = go.Model("oscillators")
    x, v, u = model.state("x", 2), model.state("v", 2), model.control("u")
    model.ode({x: v, v: u - np.array([1.0, 25.0]) * x})
    problem, leg = one_phase("to rest", model, initial=0.0, final=(1.0, 20.0))
    leg.initial(x=[4.0, 0.2], v=0.0)
    leg.final(x=0.0, v=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    solution = go.solve(problem)
    grid = np.linspace(0.0, solution.phase().final_time, 100_001)
    size, switches = np.abs(solution.switching_function("u", grid)), [a.end for a in solution.structure]
    dips = [k for k in argrelmin(size)[0] if np.min(np.abs(grid[k] - switches)) > 1e-2]
    margins = list_channel_margins(solution, solution.phase(), "u", solution.structure)
    extrema = [m for m in margins if m.kind == "smallest extremum"]
    assert len(dips) >= 2
    for k in dips:
        nearest = min(extrema, key=lambda m: abs(m.time - grid[k]))
        assert nearest.time == pytest.approx(grid[k], abs=1e-2)
        assert (
            nearest.value == pytest.approx(size[k], rel=1e-5)
            and nearest.risk > size.max() / nearest.value / 1.001
        )


def test_arcs_without_switches_and_controls_off_their_limits_have_no_switching_margins():
    model = go.Model("cart")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem, leg = one_phase("one arc", model, initial=0.0, final=1.0)
    leg.initial(x=0.0)
    leg.final(x=0.5)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(u**2))
    assert list_structure_margins(go.solve(problem)) == []


def test_columns_of_a_figure_end_below_their_last_axes(tmp_path):
    """Three axes in two columns: the right column, with one, has half the height of the left one."""
    files = {"states": save_figure(create_axes_rows([2, 1], 1.8)[0], tmp_path / "states.svg")}
    boxes = re.findall(
        r'<div class="(right|)"><svg viewBox="([^"]+)"', embed_figure(files, "states", "Text.")
    )
    ends = {side: sum(map(float, box.split()[1::2])) for side, box in boxes}
    assert ends["right"] < 0.6 * ends[""]


def test_command_of_a_report_is_that_of_the_program(monkeypatch):
    program = types.ModuleType("__main__")
    monkeypatch.setitem(sys.modules, "__main__", program)
    monkeypatch.setattr(sys, "argv", ["study.py", "--name", "a b"])
    assert find_running_command() is None  # interactive
    program.__file__ = "study.py"
    assert find_running_command() == "python study.py --name 'a b'"
    program.__spec__ = importlib.machinery.ModuleSpec("studies.__main__", None)
    assert find_running_command() == "python -m studies --name 'a b'"


def test_options_are_described_with_their_meaning(tmp_path):
    file = tmp_path / "cart.py"
    file.write_text(
        '"""A cart."""\nimport gnc_opt as go\n\ndef build(mass=2.0, *, limit, wind=0.0):\n'
        '    """Return the problem.\n\n    Parameters\n    ----------\n    mass : float\n'
        '        Of the cart,\n        kg.\n    limit : float\n        Of the force, N.\n    """\n',
        encoding="utf-8",
    )
    text = load_problem_file(file).describe({"limit": 3.0})
    assert text.split("\n\n") == [
        *("A cart.", "**Options of this solution**", "``mass = 2.0``: Of the cart, kg."),
        *("``limit = 3.0``: Of the force, N.", "``wind = 0.0``"),
    ]
