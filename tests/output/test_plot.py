"""Figures: what they draw, in which units; they write files and open no windows."""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from testing.internals import format_unit, format_unit_quotient, format_variable_name
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.plot import (
    View,
    plot_controls,
    plot_costates,
    plot_hamiltonian,
    plot_motion,
    plot_path_constraints,
    plot_states,
    save_figure,
    time_plot_axes,
)
from gnc_opt.plot.figure_style import apply_plot_style, create_figure_with_axes_rows, place_legend_above


@pytest.fixture(scope="module")
def cart() -> go.Solution:
    """A point mass in the plane, two phases: out with bounded force, then back at least effort."""
    model = go.Model("mass in the plane")
    r = model.state("r", 2, unit="m")
    v = model.state("v", 2, unit="m/s")
    a = model.control("a", 2, unit="m/s^2")
    model.ode({r: v, v: a})
    problem = go.Problem("out and back")
    out, back = problem.phase("out", model), problem.phase("back", model)
    out.time(initial=0.0, final=2.0)
    back.time(initial=2.0, final=5.0)
    out.initial(r=[0.0, 0.0], v=[0.0, 0.0])
    out.final(r=[1.0, 0.5])
    out.bounds(a=([-1.2, -1.2], [1.2, 1.2]), r=(None, [1.0, 3.0]))
    back.final(r=[0.0, 0.0], v=[0.0, 0.0])
    back.bounds(a=([-9.0, -9.0], [9.0, 9.0]))
    problem.link(out, back)
    problem.minimize(out.integral(ca.dot(a, a)) + back.integral(ca.dot(a, a)), unit="J")
    return go.solve(problem, mesh="4x3", tol=None)


def test_states_show_every_component_of_every_phase(cart: go.Solution) -> None:
    figure = plot_states(cart)
    position, velocity = figure.axes
    assert position.get_ylabel() == "$r$ (m)" and velocity.get_ylabel() == "$v$ (m/s)"
    assert velocity.get_xlabel() == "time (s)"
    assert position.get_xlim() == (0.0, 5.0)
    legend = [text.get_text() for text in position.get_legend().get_texts()]
    assert legend == [r"$r_{\mathrm{1}}$", r"$r_{\mathrm{2}}$"]
    drawn = position.get_lines()[0]
    t = np.array([0.5, 1.5])
    np.testing.assert_allclose(
        np.interp(t, drawn.get_xdata(), drawn.get_ydata()),
        np.asarray(cart.state("r", "out")(t))[0],
        atol=1e-3,  # linear between samples
    )


def test_a_bound_is_drawn_only_where_it_is_in_view(cart: go.Solution) -> None:
    levels = [line.get_ydata() for line in plot_states(cart, ["r"], phase="out").axes[0].get_lines()]
    assert any(np.all(np.asarray(y) == 1.0) for y in levels)
    assert not any(np.any(np.asarray(y) == 3.0) for y in levels)


def test_costates_have_the_unit_of_cost_per_state(cart: go.Solution) -> None:
    figure = plot_costates(cart, ["v"])
    assert figure.axes[0].get_ylabel() == "costate of $v$ (J/(m/s))"


def test_every_control_component_has_its_switching_function_underneath(cart: go.Solution) -> None:
    figure = plot_controls(cart)
    assert len(figure.axes) == 4
    assert figure.axes[0].get_ylabel() == r"$a_{\mathrm{1}}$ (m/s$^{2}$)"
    assert figure.axes[1].get_ylabel().endswith("(J s/m)")
    bottom, top = figure.axes[0].get_ylim()
    assert bottom < -1.2 and top > 1.2  # the bounds are in sight


def test_dotted_lines_mark_the_ends_of_known_arcs() -> None:
    """Time-optimal rest to rest over 1 m with |a| <= 1: the switch is at 1 s."""
    model, *_ = dynamics("mass", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("rest to rest", model, initial=0.0, final=(0.5, 10.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    for ax in plot_controls(go.solve(problem, mesh="4x3", tol=None)).axes:
        assert not dotted_lines(ax)  # the arcs are unknown
    for ax in plot_controls(go.solve(problem, check=False)).axes:
        assert dotted_lines(ax) == pytest.approx([1.0], abs=1e-9)


def test_dotted_lines_mark_both_ends_of_a_singular_arc() -> None:
    """Least int q^2 from q = 1 to q = 1 in 4 s with |u| <= 1 for dq/dt = u: -1 for 1 s, at rest at 0, +1 from 3 s."""
    model, *_ = dynamics("integrator", "q", "u", lambda q, u: {q: u})
    problem, leg = one_phase("out and back", model, initial=0.0, final=4.0)
    leg.initial(q=1.0)
    leg.final(q=1.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(model.symbol("q") ** 2))
    figure = plot_controls(go.solve(problem, check=False))
    for ax in figure.axes:
        assert dotted_lines(ax) == pytest.approx([1.0, 3.0], abs=1e-7)
    (shaded,) = figure.axes[1].collections  # where the switching function is negative
    box = shaded.get_paths()[0].get_extents()
    assert len(shaded.get_paths()) == 1 and (box.x0, box.x1) == pytest.approx((3.0, 4.0), abs=0.1)


def test_rounding_errors_of_an_interior_control_are_neither_marked_nor_magnified(cart: go.Solution) -> None:
    control, switching = plot_controls(cart, phase="back").axes[:2]
    assert not dotted_lines(control) and not dotted_lines(switching)
    noise = np.asarray(switching.get_lines()[0].get_ydata())
    bottom, top = switching.get_ylim()
    assert top - bottom > 10 * np.ptp(noise)


def dotted_lines(ax: Any) -> list[float]:
    return [float(line.get_xdata()[0]) for line in ax.get_lines() if line.get_linestyle() == ":"]


def test_a_solution_without_its_problem_is_drawn_without_switching_functions(
    cart: go.Solution, tmp_path: Path
) -> None:
    loaded = go.load(cart.save(tmp_path / "cart.npz"))
    assert len(plot_controls(loaded).axes) == 2
    with pytest.raises(go.GncOptError, match="without its problem"):
        plot_hamiltonian(loaded)


def test_a_constant_hamiltonian_looks_constant(cart: go.Solution) -> None:
    (ax,) = plot_hamiltonian(cart, phase="back").axes
    assert ax.get_ylabel() == "Hamiltonian (J/s)"
    points = ax.get_lines()[1]
    np.testing.assert_array_equal(points.get_ydata(), cart.hamiltonian(points.get_xdata(), "back"))
    low, high = ax.get_ylim()
    assert high - low > 1e3 * np.ptp(points.get_ydata())  # constant up to rounding, and drawn so


def test_unknown_names_are_refused(cart: go.Solution) -> None:
    with pytest.raises(go.UnknownNameError, match="speed"):
        plot_states(cart, ["speed"])
    with pytest.raises(go.UnknownNameError, match="known: a"):
        plot_controls(cart, ["b"])


def test_files_are_written_and_settings_left_alone(cart: go.Solution, tmp_path: Path) -> None:
    before = dict(matplotlib.rcParams)
    path = save_figure(plot_states(cart), tmp_path / "new" / "states.png")
    assert path.stat().st_size > 10_000
    assert dict(matplotlib.rcParams) == before
    assert "gnc_opt.plot" in sys.modules and not _pyplot_figures()


def _pyplot_figures() -> list[int]:
    pyplot = sys.modules.get("matplotlib.pyplot")
    return [] if pyplot is None else list(pyplot.get_fignums())


def test_samples_keep_both_limits_of_a_jump() -> None:
    def step(t: np.ndarray, side: str) -> np.ndarray:
        return np.where((t > 1.0) | ((t == 1.0) & (side == "right")), 5.0, -5.0)

    t, values = time_plot_axes.sample_piecewise_function(step, np.array([0.0, 1.0, 2.0]), per_piece=3)
    np.testing.assert_array_equal(t, [0, 0.5, 1, 1, 1.5, 2])
    np.testing.assert_array_equal(values, [[-5, -5, -5, 5, 5, 5]])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (format_variable_name("lam") + format_variable_name("vx"), r"$\lambda$$v_{\mathrm{x}}$"),
        (format_variable_name("v_L[2]"), r"$v_{\mathrm{L,3}}$"),
        (format_variable_name("inertia[0]"), r"$\mathrm{inertia}_{\mathrm{1}}$"),
        (format_variable_name("sigma_BL"), r"$\sigma_{\mathrm{BL}}$"),
        (format_variable_name("mass"), "mass"),
        (format_unit("kg m^2/s^-1"), "kg m$^{2}$/s$^{-1}$"),
        (format_unit_quotient("m/s/s", "m/s^2"), ""),
        (format_unit_quotient("", "N m"), "1/(N m)"),
        (format_unit_quotient("N^2 m^2 s/kg", "s^2 N"), "N m^2/(s kg)"),
    ],
)
def test_typesetting(text: str, expected: str) -> None:
    assert text == expected


def test_controls_of_a_problem_without_any_are_refused() -> None:
    model = go.Model("decay")
    x = model.state("x")
    model.ode({x: -x})
    problem, leg = one_phase("free fall", model, 0.0, 1.0)
    leg.initial(x=1.0)
    problem.minimize(leg.final_state("x"))
    with pytest.raises(go.GncOptError, match="'free fall' has no controls to draw"):
        plot_controls(go.solve(problem, mesh="1x3", tol=None))


def test_labels_of_axes_in_space_are_inside_the_picture() -> None:
    figure = plot_motion(flight(), View("r"))
    FigureCanvasAgg(figure).draw()
    width, height = figure.bbox.size
    for axis in (figure.axes[0].xaxis, figure.axes[0].yaxis, figure.axes[0].zaxis):
        box = axis.label.get_window_extent()
        assert axis.label.get_text() and 0 < box.x0 < box.x1 < width and 0 < box.y0 < box.y1 < height


@functools.cache
def flight() -> go.Solution:
    """Six axes of acceleration, of which three are bounded, and a limit on the height that is active in the middle."""
    model = go.Model("six jets")
    r, v = model.state("r", 3, unit="m"), model.state("v", 3, unit="m/s")
    a, b = model.control("a", 3, unit="m/s^2"), model.control("b", 3, unit="m/s^2")
    model.ode({r: v, v: a + b})
    problem = go.Problem("hop")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    leg.initial(r=[0.0, 0.0, 0.0], v=[0.0, 0.0, 2.0])
    leg.final(r=[5.0, 1.0, 0.0], v=[0.0, 0.0, -2.0])
    leg.bounds(a=(-3.0, 3.0))
    leg.path("height", r[2], lower=-1.3, upper=0.5)
    leg.path("plane", a[0] - b[0], lower=0.0, upper=0.0)
    problem.minimize(leg.integral(ca.dot(a, a) + ca.dot(b, b), "effort"))
    return go.solve(problem, mesh="20x4", tol=None)


def test_bounded_components_have_a_row_with_their_switching_function_and_others_share_one() -> None:
    figure = plot_controls(flight())
    columns = [ax.get_subplotspec().colspan.start for ax in figure.axes]
    assert len(figure.axes) == 7 and [columns.count(k) for k in range(2)] == [4, 3]
    assert len(figure.axes[6].get_lines()) == 3  # the control without bounds
    assert [ax.get_xlabel() == "time (s)" for ax in figure.axes] == [False] * 4 + [True] * 3
    boxes, middle = [ax.get_tightbbox() for ax in figure.axes], 0.5 * figure.bbox.width
    assert (
        max(box.x1 for box in boxes[:6:2]) < middle < min(box.x0 for box in boxes[1:6:2])
    )  # to be cut apart
    assert boxes[6].x0 < middle < boxes[6].x1


def test_path_constraints_are_shaded_while_active() -> None:
    solution = flight()
    figure = plot_path_constraints(solution)
    assert figure is not None
    (ax,) = figure.axes  # the equation has no axes
    assert ax.get_ylabel() == "height"
    t, height = (np.asarray(data, dtype=float) for data in ax.get_lines()[0].get_data())
    np.testing.assert_allclose(height, np.asarray(solution.state("r")(t))[2], atol=1e-9)
    (limit,) = ax.get_lines()[1:]  # the lower one is farther away than twice the range
    assert np.array_equal(limit.get_data(), [[t[0], t[-1]], [0.5, 0.5]])
    times = np.concatenate([path.vertices[:, 0] for path in ax.collections[0].get_paths()])
    active = t[height > 0.5 - 1e-4 * np.ptp(height)]
    assert times.min() == pytest.approx(active.min()) and times.max() == pytest.approx(active.max())
    # with the limit on the height, closed form of one axis: the limit is reached after 3 h / v = 0.75 s
    assert times.min() == pytest.approx(0.75, abs=0.05) and times.max() == pytest.approx(1.25, abs=0.05)


@pytest.mark.parametrize("least", [0.0, 1.0])
def test_a_vector_control_is_shown_by_magnitude_and_components(least: float) -> None:
    model = go.Model("puck")
    v = model.state("v", 2, unit="m/s")
    force, _ = model.vector_control("F", 2, unit="N")
    model.ode({v: force})
    problem, leg = one_phase("stop", model, initial=0.0, final=(0.1, 9.0))
    leg.initial(v=[3.0, 4.0])
    leg.final(v=[0.0, 0.0])
    leg.norm_bounds(F=(least, 1.0))
    problem.minimize(leg.final_time)
    solution = go.solve(problem, mesh="2x3", tol=None)
    magnitude, *switching, force_axes = plot_controls(solution).axes
    assert "magnitude" in magnitude.get_ylabel()
    assert ["partial" in ax.get_ylabel() for ax in switching] == [True] * (least < 1.0)  # else it is fixed
    np.testing.assert_allclose(
        [line.get_ydata()[0] for line in force_axes.get_lines()], [-0.6, -0.8], atol=1e-6
    )
    assert plot_path_constraints(solution) is None  # the length of the direction is none


def test_legends_of_long_labels_have_fewer_columns() -> None:
    columns = []
    for name in ("$v_{\\mathrm{L}}$", "a label of half the width"):
        figure, (ax,) = create_figure_with_axes_rows([1], 2.0)
        for i in range(3):
            ax.plot([0.0, 1.0], label=f"{name}[{i}]")
        place_legend_above(ax)
        FigureCanvasAgg(figure).draw()
        columns.append(ax.get_legend()._ncols)
        box = ax.get_legend().get_window_extent()
        assert box.x0 > 0.0 and box.x1 < figure.bbox.width
    assert columns == [3, 1]


def test_power_of_ten_is_beside_the_legend_and_the_last_time_in_the_figure() -> None:
    with apply_plot_style():
        figure, (ax,) = create_figure_with_axes_rows([1], 1.0)
        for name in ("applied", "at nodes", "limits"):
            ax.plot([0.0, 1e4], [0.0, 1e6], label=name)
        ax.set_xlim(0.0, 1e4)
        place_legend_above(ax)
        FigureCanvasAgg(figure).draw()
    parts = ax.yaxis.get_offset_text(), ax.get_legend(), ax.get_xticklabels()[-1]
    power, legend, last = (part.get_window_extent() for part in parts)
    assert not power.overlaps(legend) and last.x1 <= figure.bbox.width
