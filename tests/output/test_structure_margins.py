"""Smallest margins of the sequence of arcs, against closed forms and a search on a fine grid."""

import dataclasses
import importlib.machinery
import re
import sys
import types

import numpy as np
import pytest
from scipy.signal import argrelmin
from testing.internals import (
    create_figure_with_axes_rows,
    embed_svg_figure,
    get_running_command_line,
    iterate_control_structure_margins,
    list_margins_of_control_arcs,
    select_largest_risks,
)
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.plot import save_figure
from gnc_opt.problem_files_and_examples import load_problem_file
from gnc_opt.report import write_report


def solve_oscillators(start, stiffness):
    """Oscillators x'' = u - stiffness x to rest in least time; the first is at rest at its start."""
    model, size = go.Model("oscillators"), len(start)
    x, v, u = model.state("x", size, unit="m"), model.state("v", size, unit="m/s"), model.control("u")
    model.ode({x: v, v: u - np.array(stiffness) * x})
    problem, leg = one_phase("to rest", model, initial=0.0, final=(1.0, 20.0))
    leg.initial(x=start, v=0.0)
    leg.final(x=0.0, v=0.0)
    leg.bounds(u=(-1.0, 1.0), x=([-9.0] * size, [9.0] * size))
    problem.minimize(leg.final_time)
    return go.solve(problem)


def test_margins_of_an_oscillator_are_those_of_a_sine(tmp_path):
    """S = lambda_v is a sine of time, and H = -1 at the start at rest."""
    solution = solve_oscillators([3.2], [1.0])
    first, *_, last = solution.structure
    amplitude, t_f = 1 / (4.2 * np.sin(first.end)), solution.phase().final_time
    arc, switch, extremum = select_largest_risks(iterate_control_structure_margins(solution))
    arcs = [dataclasses.replace(first, end=first.start), last]  # a touch and an arc
    assert len([*list_margins_of_control_arcs(solution, solution.phase(), "x", arcs)]) == 1
    lengths = [a.end - a.start for a in solution.structure]
    assert len(lengths) == 3 and lengths[1] == pytest.approx(np.pi, abs=1e-6)
    assert arc.value == pytest.approx(min(lengths)) and arc.risk == pytest.approx(t_f / min(lengths))
    assert switch.value == pytest.approx(amplitude, rel=1e-6) and switch.risk == pytest.approx(1.0, rel=1e-6)
    ends = {0.0: np.sin(first.end), t_f: np.sin(last.end - last.start)}
    time = min(ends, key=ends.get)
    assert extremum.time == pytest.approx(time) and extremum.risk == pytest.approx(1 / ends[time], rel=1e-6)
    page = write_report(solution, None, tmp_path)[0].read_text("utf-8")
    for text in (
        f"<td>{100 * ends[time]:.3g} % of the largest |S|</td>",
        f"<td>{min(lengths):.5g} s</td><td>{100 * min(lengths) / t_f:.3g} % of the phase</td>",
        f"S changes by {t_f:.3g} % of the largest |S|",
        f"gnc_opt {go.__version__}, fingerprint {solution.provenance['fingerprint']}</p>",
    ):
        assert text in page, text
    assert "nearly singular" not in page and "effort of" not in page  # of a control without a unit


def test_margins_and_lengths_agree_with_a_search_on_a_grid(tmp_path):
    """With two oscillators S is a sum of sines, with extrema of |S| that are no maxima."""
    solution = solve_oscillators([4.0, 0.2], [1.0, 25.0])
    leg, grid = solution.phase(), np.linspace(0.0, solution.phase().final_time, 100_001)
    size, switches = np.abs(solution.switching_function("u", grid)), [a.end for a in solution.structure]
    margins = list(list_margins_of_control_arcs(solution, leg, "u", solution.structure))
    extrema = [m for m in margins if m.kind == "smallest extremum"]
    dips = [k for k in argrelmin(size)[0] if np.min(np.abs(grid[k] - switches)) > 1e-2]
    largest = [np.argmax(size * (grid >= a.start) * (grid <= a.end)) for a in solution.structure]
    assert len(dips) >= 2
    for k in (*dips, *largest):
        nearest = min(extrema, key=lambda m: abs(m.time - grid[k]))
        assert nearest.time == pytest.approx(grid[k], abs=1e-2)
        assert nearest.value == pytest.approx(size[k], rel=1e-4)
        assert nearest.risk == pytest.approx(size.max() / size[k], rel=1e-4)
    page = write_report(solution, None, tmp_path)[0].read_text("utf-8")
    least = min((m for m in extrema if 0.0 < m.time < leg.final_time), key=lambda m: m.value)
    assert f"of u falls to {100 / least.risk:.3g} %" in page and f"at {least.time:.5g} s without" in page
    length, largest = (
        np.max(np.linalg.norm(solution.state("v")(grid), axis=0)),
        np.max(solution.state("x")(grid)),
    )
    row = re.search(r"<td>\|v\|</td><td>0</td><td>0</td><td>0</td><td>([\d.]+)</td>", page)
    assert float(row[1]) == pytest.approx(length, rel=1e-3)
    nearest = re.search(r"x ≤ 9 m: ([\d.]+) attained at \S+ s, margin ([\d.]+) %", page)
    assert float(nearest[1]) == pytest.approx(largest) and float(nearest[2]) == pytest.approx(
        100 * (1 - largest / 9), rel=1e-2
    )


@pytest.mark.parametrize("counts, kinds", [([2, 1], ["", "right", "full"]), ([1, 2], ["full", "", "right"])])
def test_rows_of_one_axes_have_the_full_width(tmp_path, counts, kinds):
    figure, axes = create_figure_with_axes_rows(counts, 1.8)
    html = embed_svg_figure({"states": save_figure(figure, tmp_path / "states.svg")}, "states", "Text.")
    found = re.findall(r'<div class="(right|full|)"><svg viewBox="([^"]+)"', html)
    assert [kind for kind, _ in found] == kinds
    boxes = {kind: list(map(float, box.split())) for kind, box in found}
    assert boxes["full"][2] == 2 * boxes[""][2] and boxes[""][1::2] == boxes["right"][1::2]
    assert sum(box[3] for box in (boxes["full"], boxes[""])) < 72 * figure.get_figheight() + 18
    assert all(ax.xaxis.get_tick_params()["labelbottom"] for ax in axes)
    single = save_figure(create_figure_with_axes_rows([1], 1.8)[0], tmp_path / "single.svg")
    assert '<div class=""><svg' in embed_svg_figure({"single": single}, "single", "Text.")


def test_command_of_a_report_is_that_of_the_program(monkeypatch):
    program = types.ModuleType("__main__")
    monkeypatch.setitem(sys.modules, "__main__", program)
    monkeypatch.setattr(sys, "argv", ["study.py", "--name", "a b"])
    assert get_running_command_line() is None  # interactive
    program.__file__ = "study.py"
    assert get_running_command_line() == "python study.py --name 'a b'"
    program.__spec__ = importlib.machinery.ModuleSpec("studies.__main__", None)
    assert get_running_command_line() == "python -m studies --name 'a b'"


def test_options_are_described_with_their_meaning(tmp_path):
    file = tmp_path / "cart.py"
    file.write_text(
        '"""A cart."""\nimport gnc_opt as go\n\ndef build(mass=2.0, *, limit, wind=0.0):\n'
        '    """Return the problem.\n\n    Parameters\n    ----------\n    mass : float\n'
        '        Of the cart,\n        kg.\n    limit : float\n        Of the force, N.\n    """\n',
        encoding="utf-8",
    )
    text = load_problem_file(file).describe_problem_builder({"limit": 3.0})
    assert text.split("\n\n") == [
        *("A cart.", "**Options of this solution**", "``mass = 2.0``: Of the cart, kg."),
        *("``limit = 3.0``: Of the force, N.", "``wind = 0.0``"),
    ]
