"""Data of designs, tables and pages on values chosen by hand."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from matplotlib.figure import Figure
from testing.constructed_solutions import fake

from gnc_opt.array_types import Array
from gnc_opt.control import loop_margins
from gnc_opt.control.c_export.c_code_export import CSourceFiles
from gnc_opt.control.control_limits_and_authority import report_control_authority
from gnc_opt.control.feedforward_and_reference_schedule import choose_reference_sample_times
from gnc_opt.control.mpc_horizon_qp import StepLimits
from gnc_opt.errors import DesignError
from gnc_opt.numerical_tolerances import SAME_TIME
from gnc_opt.plot import campaign_figures as campaign_plots
from gnc_opt.plot import frequency_response_figures
from gnc_opt.report import solution_html_page
from gnc_opt.simulation import campaign_tables
from gnc_opt.simulation.intersample_actuator_output import project_exponential_on_legendre
from gnc_opt.simulation.recorded_extremes_and_integrals import _build_interpolated_maximum_function


def test_references_are_sampled_on_both_sides_of_jumps() -> None:
    reference = fake(initial_time=1.0, final_time=3.0, jumps=np.array([1.5, 3.0]))
    edge = 2 * SAME_TIME
    found = choose_reference_sample_times(reference, 3)
    np.testing.assert_array_equal(found, [1.0, 1.5 - edge, 1.5, 1.5 + edge, 2.0, 3.0 - edge, 3.0])
    constant = fake(initial_time=1.0, final_time=1.0, jumps=np.zeros(0))
    np.testing.assert_array_equal(choose_reference_sample_times(constant), [1.0])


def test_scales_and_penalties_of_limited_states() -> None:
    inf = np.inf
    limits = fake(
        state_lower=np.array([-2.0, 0.5, -inf, 0.0, -inf]), state_upper=np.array([4.0, inf, -0.25, inf, inf]),
        price=np.array([9.0, inf, 4.0, 1e-9, inf]),
    )  # fmt: skip

    def read(name: str) -> Any:
        return vars(StepLimits)[name].fget(limits)

    np.testing.assert_array_equal(read("state_scale"), [3.0, 0.5, 0.25, 1.0, 1.0])
    assert (read("lower_limited_states"), read("upper_limited_states")) == ([0, 1, 3], [0, 2])
    assert read("soft_limited_states") == [0, 2, 3]
    limits.soft_limited_states, limits.state_scale = read("soft_limited_states"), read("state_scale")
    np.testing.assert_allclose(read("penalty_square_roots"), [9.0, 0.5, 1e-3])


def test_stack_of_generated_code_is_that_of_the_larger_function() -> None:
    def stack(signals: int, start: int, solver: Any = None, memory: int = 0) -> int:
        own = fake(
            form=fake(controller=fake(signals=fake(size=signals), memory=fake(size=memory)), solver=solver),
            step=fake(sz_w=lambda: 10), start=fake(sz_w=lambda: start), numbers=fake(float_size_bytes=8),
        )  # fmt: skip
        return vars(CSourceFiles)["stack_size_bytes"].fget(own)

    assert [stack(0, 5), stack(3, 5), stack(0, 20), stack(0, 5, memory=4)] == [96, 112, 168, 120]
    assert stack(0, 5, fake(max_stack_float_count=100)) == 8 * 112


def test_margins_of_the_disk_in_decibels_and_degrees() -> None:
    figure = Figure()
    response = fake(disk_margins=np.array([1.0, 3.0]), times=np.array([0.0, 2.0]))
    frequency_response_figures._draw_disk_margin_plot(figure, response, "")
    drawn = [np.asarray(axes.lines[0].get_ydata(), float) for axes in figure.axes]
    np.testing.assert_allclose(
        [values[0] for values in drawn], [1.0, 20 * np.log10(3), np.degrees(2 * np.arctan(0.5))]
    )
    np.testing.assert_allclose([drawn[0][1], drawn[2][1]], [2.0, 90.0])
    for axes, values in zip(figure.axes, drawn, strict=True):
        np.testing.assert_allclose(axes.get_ylim(), [0.0, 1.1 * np.max(values)])


def test_rows_of_a_campaign_with_and_without_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign_tables, "select_printed_performance_measures", lambda campaign: ["a", "b"])
    campaign = fake(
        percentile=lambda name, level: fake(value=100 * level), maximum=lambda name: 7.0, limits={"b": 0.5},
        pass_rate=lambda name="all": f"rate of {name}", unit=lambda name: "m",
        describe_measure=str,
    )  # fmt: skip
    rows = campaign_tables.build_campaign_table_rows(campaign)
    assert [row[0] for row in rows[1:]] == ["a", "b", "all limits"]
    assert [row[-2:] for row in rows[1:]] == [["", ""], ["0.5", "rate of b"], ["", "rate of all"]]
    assert len({len(row) for row in rows}) == 1 and rows[1][1] == "m"
    campaign.limits = {}
    assert [row[0] for row in campaign_tables.build_campaign_table_rows(campaign)[1:]] == ["a", "b"]


def test_a_far_limit_does_not_widen_the_axis() -> None:
    """The values 0, 0 and 2 have the centre 1 and the range 2: 7.1 is far, 6.9 is not."""
    for limit, kept in ((7.1, True), (6.9, False), (-5.1, True), (-4.9, False)):
        axes = Figure().subplots()
        axes.plot([0.0, 0.0, 2.0], [0.0, 0.5, 1.0])
        before = axes.get_xlim()
        campaign_plots._draw_limit_of_performance_measure(axes, limit, "m", np.array([0.0, 0.0, 2.0]))
        assert (axes.get_xlim() == before) is kept


def test_masses_that_are_consumed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mass m falls by 2 and 1 in two phases; a vector in kg and a scalar in m are no masses."""
    variables = tuple(
        fake(name=n, unit=u, size=k) for n, u, k in (("m", "kg", 1), ("parts", "kg", 3), ("q", "m", 1))
    )

    class States(tuple[str, ...]):
        variables: Any

    states = States(("m", "parts", "q"))
    states.variables = variables

    def leg(begin: float, end: float) -> Any:
        return fake(
            name="leg", states=states, breaks=np.array([0.0, 1.0, 2.0]), integral_labels=("integral_0", "fuel"),
            state=lambda name: lambda t: begin + (end - begin) * t / 2, integral=lambda name: 4.5,
        )  # fmt: skip

    monkeypatch.setattr(solution_html_page, "find_declared_controls", lambda legs: [])
    rows = list(
        solution_html_page._format_propellant_and_effort_rows(
            fake(phases={"a": leg(9.0, 7.0), "b": leg(7.0, 6.0)})
        )
    )
    alone = list(solution_html_page._format_propellant_and_effort_rows(fake(phases={"a": leg(9.0, 7.0)})))
    assert rows == [("decrease of m", "3 kg"), *[("integral fuel, phase leg", "4.5")] * 2]
    assert alone == [("decrease of m", "2 kg"), ("integral fuel", "4.5")]


def test_projection_of_an_exponential_onto_legendre_polynomials() -> None:
    """(2 j + 1) times the integral of P_j(2 s - 1) exp(-2 xi s) over s from 0 to 1, by Gauss' rule."""
    xi = np.array([1e-9, 0.01, 0.3, 0.4999, 0.5001, 2.0, 8.0])
    nodes, weights = np.polynomial.legendre.leggauss(40)
    expected = [
        (2 * j + 1)
        * (
            np.exp(-np.outer(xi, 1 + nodes))
            @ (0.5 * weights * np.polynomial.legendre.Legendre.basis(j)(nodes))
        )
        for j in range(3)
    ]
    found = ca.Function("f", [s := ca.SX.sym("xi", xi.size)], project_exponential_on_legendre(s))(xi)
    np.testing.assert_allclose([v.full().ravel() for v in found], expected, rtol=1e-9, atol=1e-12)


def test_maxima_of_parabolas_through_samples() -> None:
    """5 - (k - 1.75)^2 at k = 0 to 4 has the maximum 5; where curvatures differ the largest sample counts."""
    y = 5 - (np.arange(5.0) - 1.75) ** 2
    function = _build_interpolated_maximum_function(5, 1)

    def maximum(values: Array) -> float:
        return float(function(*values))

    assert maximum(y) == pytest.approx(5.0)
    for bent, expected in (
        ([0.0, 1.0, 4.0, 1.0, 0.0], 4.0),
        ([0.0, 3.0, 4.0, 3.0, 0.0], 4.0),
        ([4.0, 3.0, 2.0, 1.0, 0.0], 4.0),
    ):
        assert maximum(np.array(bent)) == pytest.approx(expected)
    assert maximum(-y) == np.max(-y)


def test_frequencies_cover_the_poles_by_four_decades() -> None:
    """Poles at 2 and 3 +- 4 i (size 5): from 2e-4 to 5e4 rad/s, with points beside the resonance at 4."""
    a, closed = np.array([[-2.0]]), np.array([[-3.0, 4.0], [-4.0, -3.0]])
    grid = loop_margins._build_margin_frequency_grid(a, closed, None)
    np.testing.assert_allclose(grid[[0, -1]], [2e-4, 5e4])
    assert grid.size == 2002 and np.all(np.diff(grid) > 0)
    assert np.min(np.abs(grid - 4 * (1 - 1e-6))) < 1e-12 and np.min(np.abs(grid - 4 * (1 + 1e-6))) < 1e-12
    grid = loop_margins._build_margin_frequency_grid(np.zeros((1, 1)), np.zeros((1, 1)), None)
    np.testing.assert_allclose(grid[[0, -1]], [1e-4, 1e4])
    sampled = loop_margins._build_margin_frequency_grid(np.exp([[-0.2]]), np.exp([[-0.2]]), 0.1)
    np.testing.assert_allclose(sampled[[0, -1]], [2e-4, np.pi / 0.1])
    assert sampled[-2] < np.pi / 0.1 * (1 - 1e-9)
    still = loop_margins._build_margin_frequency_grid(np.zeros((1, 1)), np.zeros((1, 1)), 0.1)
    np.testing.assert_allclose(still[[0, -1]], [np.pi / 0.1 * 1e-4, np.pi / 0.1])


def test_authority_that_remains_along_a_reference() -> None:
    """u = (t, 1) from 0 to 2 s within (-1, 4) and (0, 2), then (0.5, 1); a gain of 0.5 in the second control."""
    reference = fake(
        initial_time=0.0, final_time=2.0, duration=2.0, jumps=np.zeros(0), u=lambda t: np.stack([t, 1 + 0 * t]),
        mean_control=lambda t, dt: np.stack([t + dt, 1 + 0 * t]), control_after_final_time=np.array([0.5, 1.0]),
        controls=fake(labels=("a", "b")),
    )  # fmt: skip
    limits = np.array([-1.0, 0.0]), np.array([4.0, 2.0])
    (entry,) = report_control_authority(reference, limits)
    np.testing.assert_allclose(entry.value, [2 * 1 / 5, 1.0])
    assert "smallest for 'a' at t = 0 s" in entry.remark and "after feedforward;" in entry.remark
    (entry,) = report_control_authority(
        reference, limits, gain=lambda t: np.stack([0 * t, 0.5 + 0 * t]), dt=2.5
    )
    np.testing.assert_allclose(entry.value, [-2 * 0.5 / 5, 0.5])
    assert "smallest for 'a' at t = 2 s" in entry.remark and "feedforward and gain;" in entry.remark
    assert report_control_authority(reference, None) == []
    with pytest.raises(
        DesignError,
        match=r"the reference is .* control 'a' needs 4.5 at t = 2 s, but its limits are -1 and 4",
    ):
        report_control_authority(reference, limits, dt=2.5, required=True)
    with pytest.raises(DesignError, match=r"gain is .* control 'b' needs 1.5 besides its feedforward 1 at"):
        report_control_authority(
            reference, limits, gain=lambda t: np.stack([0 * t, 1.5 + 0 * t]), required=True
        )
    assert len(report_control_authority(reference, limits, required=True)) == 1
    reference.duration = 0.0  # one time has no steps
    np.testing.assert_allclose(report_control_authority(reference, limits, dt=2.5)[0].value, [0.4, 1.0])
