"""Motion in three dimensions in reports: the numbers that the page carries, and what a browser makes of them."""

import base64
import gzip
import json
import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.browser import BROWSER, DESKTOP, PHONE, browser
from testing.internals import (
    build_campaign_conclusion,
    build_html_document,
    plot_run_controls,
    plot_run_envelopes,
    read_figure_captions,
    render_3d_scene_html,
)
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.analysis import loop_response
from gnc_opt.plot import View
from gnc_opt.plot.campaign_figures import CONFIDENCE, rank_dispersion_effects
from gnc_opt.problem_files_and_examples import find_example, list_examples
from gnc_opt.report import write_campaign_report, write_report
from gnc_opt.simulation import Lag, Noise, Normal, Quantity, Saturation, Uniform
from gnc_opt.spacecraft import mrp_difference, mrp_rate, mrp_retraction
from gnc_opt.text_html_and_json_formatting import simplify_time_integral_unit

pytest.importorskip("plotly", reason="motion in three dimensions comes with the extra report")

LARGEST = 5_000_000
"""Bytes of a page."""
RATE = 0.5
"""Of the turn about z, rad/s."""
VIEW = View("r", "sigma", "F", keep_out={"rock": ((1.0, 2.0, 0.0), (0.5, 0.4, 0.3))}, down=True)


def carried(page):
    """The numbers that a page carries for the scene."""
    packed = re.search(r'<script type="text/plain" id="motions">(.*?)</script>', page)[1]
    return json.loads(gzip.decompress(base64.b64decode(packed)))


def turning(force):
    """A body that turns about z while its own thrust carries it along."""
    model = go.Model("turning body")
    r, v, sigma = model.state("r", 3, unit="m"), model.state("v", 3, unit="m/s"), model.state("sigma", 3)
    F = model.control("F", 3, unit="N")
    c, s = ca.cos(RATE * model.time), ca.sin(RATE * model.time)
    force_L = ca.vertcat(c * F[0] - s * F[1], s * F[0] + c * F[1], F[2])
    model.ode({r: v, v: force_L, sigma: mrp_rate(sigma, ca.vertcat(0, 0, RATE))})
    problem, leg = one_phase("a turn", model, initial=0.0, final=2.0, name="turn")
    leg.initial(r=0.0, v=0.0, sigma=0.0)
    leg.bounds(F=(force, force))
    problem.minimize(leg.final_time)
    return problem


@pytest.fixture(scope="module")
def solution():
    return go.solve(turning([2, -1, 0]), mesh="6x4", tol=None)


@pytest.fixture(scope="module")
def campaign():
    model = go.Model("glider")
    r = model.state("r", 3, unit="m")
    u = model.control("u", 3, unit="m/s")
    model.ode({r: u})
    loop = go.ClosedLoop(model, go.design_lqr(model, [0, 0, 0], Q=1, R=1, dt=0.1), dt=0.1)
    return go.monte_carlo(
        loop,
        n=40,
        seed=3,
        x0={"r": [5, 0, 0]},
        tf=2.0,
        dispersions={"initial.r": Normal([0.2, 0.4, 0.1])},
        limits={"r": 0.69},
        executor="serial",
    )


def test_page_carries_the_motion(solution):
    data = carried(render_3d_scene_html({"a turn": solution}, VIEW))
    t = np.array(data["times"])
    motion = data["motions"]["a turn"]
    assert t[0] == 0 and t[-1] == 2
    c, s = np.cos(RATE * t), np.sin(RATE * t)
    # r'' = 2 (c, s) - (-s, c), from rest
    expected = 2 * np.stack([1 - c, RATE * t - s]) - np.stack([s - RATE * t, 1 - c])
    size = np.ptp(expected, axis=1).max() / RATE**2
    assert np.allclose(motion["position"][:2], expected / RATE**2, atol=2e-4 * size)
    assert np.allclose(motion["axes"], [[c, s, 0 * t], [-s, c, 0 * t]], atol=1e-4)
    assert np.allclose(np.transpose(motion["force"]), np.array([2.0, -1.0, 0.0]) / np.sqrt(5), atol=1e-4)
    assert data["unit"] == "m" and data["down"]
    rock = np.array(data["volumes"]["rock"])
    assert rock.shape == (3, 13, 25) and np.allclose([rock[2, 0], rock[2, -1]], [[-0.3], [0.3]], atol=1e-2)
    assert np.allclose((((rock.T - [1, 2, 0]) / [0.5, 0.4, 0.3]) ** 2).sum(axis=-1), 1, atol=1e-2)
    assert np.all(np.array(data["low"]) < rock.min(axis=(1, 2))) and np.all(
        np.array(data["high"]) > rock.max(axis=(1, 2))
    )


@pytest.mark.usefixtures("blank_figures")
def test_campaign_carries_any_run(campaign, tmp_path):
    page = write_campaign_report(campaign, tmp_path, view=View("r", force="u"), runs=30)[0].read_text("utf-8")
    assert len(page) < LARGEST and "30 of 40 runs" in page
    drawn = campaign.parameters[0]
    row = (
        "initial <i>r</i><sub>1</sub>",
        5,
        "m",
        *(f"{f(drawn):.4g}" for f in (np.mean, np.std, np.min, np.max)),
        "normal: standard deviation 0.2, 0.4, 0.1 m, added to the nominal value",
    )
    assert "".join(f"<td>{cell}</td>" for cell in row) in page  # the nominal value, and what was drawn
    data = carried(page)
    passed = campaign.passed()
    assert 0 < passed.sum() < 40
    numbers = [int(re.match(r"run (\d+): ", name)[1]) for name in data["motions"]]
    assert set(np.flatnonzero(~passed)) <= set(numbers) and len(numbers) == 30  # what failed is there
    name = next(iter(data["motions"]))
    flown = campaign.rerun(numbers[0]).state("r")(data["times"])
    assert np.allclose(data["motions"][name]["position"], flown, atol=1e-3)


def test_a_run_that_is_lost_does_not_fill_the_picture(campaign):
    flown = {f"run {i}": campaign.rerun(i) for i in range(3)}
    far = flown["run 1"]
    vars(far)["states"] = far.states * 1e9
    data = carried(render_3d_scene_html(flown, View("r"), regular={"run 1": False}))
    assert max(data["high"]) < 10 and "run 1" in data["motions"]


@pytest.mark.usefixtures("blank_figures")
def test_campaign_report_states_the_scenario_and_shows_the_worst_run(campaign, tmp_path):
    paths = write_campaign_report(campaign, tmp_path, title="forty <gliders>")
    assert [p.name for p in paths] == [
        *("report.html", "campaign.npz", "campaign.json", "distributions.svg", "effects.svg"),
        *("dispersion_r.svg", "envelope-final.svg", "envelope-errors.svg", "envelope-controls.svg"),
        *("errors.svg", "controls.svg"),
    ]
    page = paths[0].read_text("utf-8")
    worst = campaign.worst("r", 1)[0]
    assert "<h1>forty &lt;gliders&gt;</h1>" in page and len(page) < LARGEST
    for shown in ("40 runs from 0 to 2 s", "<td>plant</td><td>glider</td><td>3 states, 3 controls</td>",
                  "<td>normal: standard deviation 0.2, 0.4, 0.1 m, added to the nominal value</td>",
                  "are initial <i>r</i>.", "<td>seed</td><td>3</td>", "gain margin up", "<td>final error of r</td>",
                  f"<h2>Worst run: {worst}</h2><p>This run has the largest value relative to a limit: final error of r",
                      f"and reference in run {worst}.</figcaption>",
                  "go.monte_carlo(loop, 40, seed=3, ...)", "compiled_loop=loop.compile(x0, tf=2)",
                  "<p>With the same confidence (one-sided), 92."):  # fmt: skip
        assert shown in page, shown
    loaded = go.Campaign.load(paths[1])
    assert loaded.scenario == campaign.scenario
    assert "states.svg" not in {p.name for p in write_campaign_report(loaded, tmp_path / "loaded")}


def listed_runs(campaign, folder):
    """Return heading, text and rows of the section of failed or critical runs; lines of a cell are separated by |."""
    page = write_campaign_report(campaign, folder)[0].read_text("utf-8").replace("<br>", "|")
    found = re.search(r"<h2>(Failed runs|Runs closest to limits)</h2>(.*?)</section>", page, re.DOTALL)
    if found is None:
        return None
    rows = re.findall(r"<tr><td>(.*?)</td></tr>", found[2])
    return found[1], found[2].partition("<div")[0], [row.split("</td><td>") for row in rows]


@pytest.mark.usefixtures("blank_figures")
def test_intervals_of_results_and_percentiles_that_few_runs_do_not_bound(campaign, tmp_path):
    page = write_campaign_report(campaign, tmp_path)[0].read_text("utf-8")
    rate = campaign.pass_rate("r")
    median = campaign.percentile("r", 0.5)
    most = campaign.percentile("r", 0.99)
    share, interval = str(rate).rstrip(")").split(" (")
    assert f"<td>m</td><td>0.69</td><td>{share}<br><small>{interval}</small></td>" in page
    assert f"<td>{median.value:.3g}<br><small>{median.low:.3g} to {median.high:.3g}</small></td>" in page
    assert f"<td>{most.value:.3g}<br><small>above {most.low:.3g}</small></td>" in page and most.high == np.inf
    assert "<h2>Controller</h2>" in page
    bare = replace(campaign, scenario=tuple(row for row in campaign.scenario if row[0] != "design"))
    assert "<h2>Controller</h2>" not in write_campaign_report(bare, tmp_path / "bare")[0].read_text("utf-8")
    note = "With 40 runs these percentiles have no upper confidence limit: 95 % (needs 72 runs), 99 % (needs 368 runs)."
    assert note in page and note in str(campaign)


@pytest.mark.usefixtures("blank_figures")
def test_failed_runs_are_listed_with_cause_excess_and_deviations(campaign, tmp_path):
    heading, text, rows = listed_runs(campaign, tmp_path)
    failed = np.flatnonzero(~campaign.passed())
    assert heading == "Failed runs" and f"{failed.size} runs failed: {failed.size} exceed a limit" in text
    assert "campaign.rerun(" + rows[0][0] + ")" in text and "SeedSequence([3, i])" in text
    assert [int(row[0]) for row in rows] == campaign.worst("r", failed.size) and set(failed) == {
        int(row[0]) for row in rows
    }
    k, errors = int(rows[0][0]), campaign.measure("r")
    z = (campaign.parameters[:, k] - campaign.parameters.mean(axis=1)) / campaign.parameters.std(axis=1)
    first, second = np.argsort(-np.abs(z))[:2]
    names = [f"initial <i>r</i><sub>{i + 1}</sub> {z[i]:+.1f}" for i in (first, second)]
    share = f"{100 * errors[k] / 0.69:.3g} %"
    assert rows[0][1:] == ["final error of r", f"{errors[k]:.4g} m", "0.69 m", share, "2", ", ".join(names)]
    assert f"Runs beyond a limit: final error of r in {failed.size}." in text
    outcomes = list(campaign.outcomes)
    outcomes[5] = replace(outcomes[5], status=go.RunStatus.DIVERGED, what="state 'r' beyond 9", time=1.5)
    lost = replace(campaign, outcomes=tuple(outcomes), limits={"r": 9.0})
    heading, text, rows = listed_runs(lost, tmp_path)
    assert "1 runs failed: 0 exceed a limit, 1 end with another outcome" in text and rows[0][:2] == [
        "5",
        "diverged: state &#x27;r&#x27; beyond 9 at 1.5 s",
    ]
    heading, _, rows = listed_runs(replace(campaign, limits={"r": 9.0}), tmp_path)
    assert heading == "Runs closest to limits" and [int(row[0]) for row in rows] == campaign.worst("r", 5)
    assert listed_runs(replace(campaign, limits={}), tmp_path) is None


@pytest.mark.usefixtures("blank_figures")
def test_correlations_above_the_noise_level_have_together_the_stated_probability(campaign):
    """Two signs of two coefficients, of the value and of its distance from the median, per dispersion."""
    for effects, noise in rank_dispersion_effects(campaign).values():
        assert 0 < noise < 1
        chance = 4 * len(effects) * scipy.stats.norm.sf(noise * np.sqrt(len(campaign)))
        assert chance == pytest.approx(1 - CONFIDENCE)


def test_time_of_the_largest_value_of_a_quantity_in_a_failed_run(tmp_path):
    model = go.Model("cart")
    q, u = model.state("q", unit="m"), model.control("u", unit="m/s")
    model.ode({q: u})
    tracker = go.design_lqr(model, [0.0], Q=1, R=1, dt=0.1)
    loop = go.ClosedLoop(model, tracker, quantities=[Quantity("distance", q, unit="m")])
    mission = {"x0": [1.0], "tf": 2.0, "seed": 1, "dispersions": {"initial.q": Uniform(0.0, 0.1)}}
    found = go.monte_carlo(loop, 3, **mission, limits={"q": 1e-3, "max(distance)": 0.9}, executor="serial")
    _, _, rows = listed_runs(found, tmp_path)
    assert len(rows) == 3 and all(row[1] == "final error of q and 1 more" for row in rows)
    assert [noise for _, noise in rank_dispersion_effects(found).values()] == [
        1.0,
        1.0,
    ]  # three runs show none
    assert [row[5] for row in rows] == ["2"] * 3 and rows[0][4].endswith(" ×")
    _, _, rows = listed_runs(replace(found, limits={"max(distance)": 0.9}), tmp_path / "way")
    assert [row[5] for row in rows] == ["0"] * 3  # the error at the end, the largest distance at the start
    mission["dispersions"] = {}
    same = go.monte_carlo(loop, 2, **mission, limits={"q": 0.0}, executor="serial")
    _, _, rows = listed_runs(same, tmp_path / "same")
    assert [row[4:] for row in rows] == [["", "2", ""]] * 2  # no share of a limit of zero, and no deviations
    assert not (tmp_path / "same" / "effects.svg").exists()


def test_envelopes_show_percentiles_nominal_run_and_limit(campaign):
    runs = [campaign.rerun(i) for i in range(20)]
    nominal = campaign.compiled_loop.run(campaign.compiled_loop.nominal, 3)
    few = {name: getattr(runs[4], name)[:, :11] for name in ("states", "errors", "reference")}
    few["applied"] = runs[4].applied[:, :10]
    runs[4] = replace(runs[4], times=np.append(runs[4].times[:10], 0.97), **few)  # ended by an event
    figures = dict(plot_run_envelopes(campaign, runs, nominal))
    for i, ax in enumerate(figures["errors"].axes):
        lines = {line.get_label(): line for line in ax.lines}
        values = np.sort([run.errors[i, 5] for run in runs])
        assert lines["median"].get_xdata()[5] == pytest.approx(0.5)
        assert lines["median"].get_ydata()[5] == values[9]
        later = [run.errors[i, 15] for k, run in enumerate(runs) if k != 4]
        band = ax.collections[0].get_paths()[0].vertices
        assert max(later) in band[np.isclose(band[:, 0], 1.5), 1]
        assert np.array_equal(lines["nominal"].get_ydata(), nominal.errors[i])
        whole = ax.collections[1].get_paths()[0].vertices  # the range of all runs
        assert min(run.errors[i, 15] for k, run in enumerate(runs) if k != 4) in whole[:, 1]
    (final,) = figures["final"].axes
    lines = {line.get_label(): line for line in final.lines}
    assert set(lines["limit"].get_ydata()) == {0.69} and final.get_xlim() == pytest.approx((-0.4, 0.0))
    assert lines["nominal"].get_ydata()[-1] == pytest.approx(np.linalg.norm(nominal.errors[:, -1]))
    assert 0.69 < final.get_ylim()[1] <= 3.6 * 0.69  # the limit is visible although a run ended far off
    assert final.get_ylim()[0] < np.nanmin(final.collections[0].get_paths()[0].vertices[:, 1])
    ended = dict(plot_run_envelopes(campaign, runs, runs[4]))  # the nominal run is ended by an event
    short = ended["errors"].axes[0]
    assert short.get_xlim() == (0.0, 2.0) and np.isnan(short.lines[1].get_ydata()[11:]).all()
    control = figures["controls"].axes[1].lines[0].get_ydata()
    assert control[3] == np.sort([run.applied[1, 3] for run in runs])[9]
    lasting = [run for run in runs if run is not runs[4]]
    assert control[-1] == np.sort([run.applied[1, -1] for run in lasting])[9]  # the last command ends there
    assert len(figures["controls"].axes) == 3


def test_campaign_with_a_reference_shows_errors_and_units(tmp_path):
    """q follows the reference; the wheel, which the controller does not know, has none and is shown as it is."""
    model = go.Model("cart")
    q, v, a = model.state("q", unit="m"), model.state("v", unit="m/s"), model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    problem, leg = one_phase("rest to rest", model, initial=0.0, final=2.0)
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    problem.minimize(leg.integral(a**2))
    plan = go.Reference(go.solve(problem, mesh="2x4", tol=None))
    tracker = go.design_tvlqr(model, plan, Q=1, R=1, dt=0.1)
    plant = go.Model("cart and wheel")
    q, v = plant.state("q", unit="m"), plant.state("v", unit="m/s")
    wheel, a = plant.state("wheel", unit="rad"), plant.control("a", unit="m/s^2")
    plant.ode({q: v, v: a, wheel: v})
    loop = go.ClosedLoop(
        plant,
        tracker,
        [Saturation("thruster", -9.0, 9.0), Saturation("valve", upper=9.0)],  # an infinite constant parameter
        [Noise("gauge", 0.001, on="q")],
        dt=0.1,
    )
    study = {"x0": [1, 0, 0], "tf": 2.0, "seed": 1, "dispersions": {"initial.q": Normal(0.02)}}
    campaign = go.monte_carlo(loop, 5, **study, limits={"q": 0.5, "v": 0.1}, executor="serial")
    nominal = campaign.compiled_loop.run(campaign.compiled_loop.nominal, 1)
    figures = dict(plot_run_envelopes(campaign, [campaign.rerun(0)], nominal))
    lines = {line.get_label(): line for line in figures["errors"].axes[0].lines}
    assert list(figures) == ["final", "errors", "states", "controls"] and len(figures["states"].axes) == 1
    assert np.array_equal(lines["nominal"].get_ydata(), nominal.errors[0])
    assert [set(ax.lines[-1].get_ydata()) for ax in figures["final"].axes] == [{0.5}, {0.1}]
    paths = write_campaign_report(campaign, tmp_path)
    assert {"envelope-errors.svg", "errors.svg", "states.svg"} <= {path.name for path in paths}
    page = paths[0].read_text("utf-8")
    for shown in (
        "<td>effort of a</td><td>m/s</td>",
        "noise on q: standard deviation 0.001 m<",
        "lower −9 m/s<sup>2</sup>, upper 9 m/s<sup>2</sup>",
        "standard deviation 0.02 m, added to the nominal value",
        "control step 0.1 s",
        "<th></th><th>q<br><small>m</small></th><th>v<br><small>m/s</small></th>",
        "solution of &#x27;rest to rest&#x27;, 0 s to 2 s",
        "<td>weight Q</td><td>1, 1 (diagonal; errors of q (m), v (m/s))</td>",
        "smallest eigenvalue of the Riccati solution P",
    ):
        assert shown in page, shown


@pytest.mark.usefixtures("blank_figures")
def test_conclusion_names_the_interval_of_the_highest_bounded_percentile(campaign, tmp_path):
    """Of 40 runs the 90 % percentile is the 36th value, with an interval from the 32nd to the 40th."""
    wide = replace(campaign, limits={"r": 3.0})
    page = write_campaign_report(wide, tmp_path)[0].read_text("utf-8")
    errors = 100 * np.sort(campaign.measure("r")) / 3.0
    share, low, high = (f"{errors[i]:.3g} %" for i in (35, 31, 39))
    text = f"final error of r: its 90th percentile is {share} of the limit (95 % confidence interval {low} to {high})."
    rate = wide.pass_rate()
    interval = f"between {100 * rate.low:.4g} % and 100 %.</li><li>No pass probability is required."
    assert "<strong>40 of 40 runs meet all limits.</strong>" in page and interval in page
    assert f"The {text.replace(':', ' is closest to its limit:')}" in page
    least = f"{100 * campaign.percentile('r', 0.99).low / 3.0:.3g} %"
    assert f"<small>above {least}</small>" in page  # in the column of the 99 % percentile
    strict = replace(campaign, limits={"r": np.min(campaign.measure("r")) / 20})
    captions = read_figure_captions("campaign")
    text = build_campaign_conclusion(strict, captions)
    assert "0 of 40 runs meet all limits." in text and " times the limit (95 %" in text
    assert "probability of 50 % is not met" in build_campaign_conclusion(strict, captions, 0.5)
    # With failures, no number of runs is stated: more runs can also show that the probability is not met.
    undecided = build_campaign_conclusion(strict, captions, 0.05)
    assert "not demonstrated" in undecided and "at least" not in undecided
    found = [build_campaign_conclusion(wide, captions, p) for p in (0.9, 0.99)]
    assert "is demonstrated" in found[0] and "takes at least 368 runs" in found[1]  # 0.975, two-sided


@pytest.mark.usefixtures("blank_figures")
def test_saturation_is_the_share_of_time_beyond_a_limit(tmp_path):
    """dq/dt = u with |u| <= 1 and a commanded -2 q: beyond the limit from q = 2 to 0.5, for 1.5 s of 4 s."""
    model = go.Model("puck")
    q, u = model.state("q", unit="m"), model.control("u", unit="m/s")
    model.ode({q: u})
    loop = go.ClosedLoop(
        model, go.design_lqr(model, [0.0], Q=4, R=1, dt=0.01), [Saturation("valve", -1.0, 1.0)], dt=0.01
    )
    mission = {"x0": [2.0], "tf": 4.0, "seed": 1, "dispersions": {"initial.q": Uniform(-0.2, 0.2)}}
    runs = go.monte_carlo(loop, 9, **mission, limits={"q": 0.1}, executor="serial")
    response = loop_response(loop, x0=[2.0], tf=4.0, at=[0.0, 3.0])  # at its limit, within its limits
    page = write_campaign_report(runs, tmp_path, response=response, required=0.99)[0].read_text("utf-8")
    assert f"{runs.pass_rate().passed} of 9 passed, 99 % not demonstrated" in page
    assert "<td>0</td><td>all</td><td>open: all commands at limits</td>" in page
    phase = f"<td>{np.degrees(response.margins(1).phase[0]):.3g}</td>"
    assert re.search(rf"<td>3</td><td>u</td><td>0 to [\d.]+</td>{phase}", page)
    cells = re.search(
        r"<tr><td><i>u</i></td>((?:<td>[^<]*</td>)+)</tr></tbody></table></div></section>", page
    )[1]
    median, most, largest, run = re.findall("<td>(.*?)</td>", cells)
    start = runs.parameter("initial.q")[0]
    found = [float(text.removesuffix(" %")) for text in (median, most, largest)]
    assert found == pytest.approx(100 * (np.quantile(start, [0.5, 0.95, 1.0]) - 0.5) / 4.0, abs=0.5)
    assert int(run) == int(np.argmax(start))
    flown, nominal = runs.rerun(0), runs.compiled_loop.run(runs.compiled_loop.nominal, 1)
    (ax,) = plot_run_controls(runs, flown, nominal, "run 0").axes
    lines = {line.get_label(): line.get_ydata() for line in ax.lines}
    for label, values in (
        ("run 0", flown.applied),
        ("nominal", nominal.applied),
        ("command", flown.commands),
    ):
        assert np.array_equal(lines[label], values[0])


def test_errors_and_noise_of_attitudes_are_in_rad():
    model = go.Model("body")
    sigma, w = model.state("sigma", 3), model.control("w", 3, unit="rad/s")
    model.ode({sigma: mrp_rate(sigma, w)})
    model.difference(sigma, mrp_difference, mrp_retraction)
    sensor = Noise("star tracker", [1e-4] * 3, retraction=mrp_retraction)
    loop = go.ClosedLoop(model, go.design_lqr(model, [0, 0, 0], Q=1, R=1, dt=0.1), sensors=[sensor])
    runs = go.monte_carlo(loop, 2, x0=[0.1, 0, 0], tf=1.0, seed=1, executor="serial")
    assert runs.layouts["error"]["sigma"].unit == runs.unit("sigma") == "rad"
    assert ("sensor", "star tracker", "noise: standard deviation 0.0001 rad") in runs.scenario


def test_scene_describes_the_body_axes_and_the_plume(solution):
    text = "Body axes: bx, by, bz; plume: opposite to the resultant force"
    assert text in render_3d_scene_html({"turn": solution}, VIEW) and "ody axes" not in render_3d_scene_html(
        {"": solution}, View("r")
    )


def test_unit_of_a_time_integral_has_no_common_factor():
    cases = {"m/s^2 s": "m/s", "kg m/s^2 s": "kg m/s", "rad/s s": "rad", "N s": "N s", "1/s s": "", "": ""}
    assert {unit: simplify_time_integral_unit(unit) for unit in cases} == cases


def test_scenario_names_every_part_with_what_differs_from_its_defaults():
    model = go.Model("puck")
    v, u = model.state("v", unit="m/s"), model.control("u", unit="m/s^2")
    model.ode({v: u})
    loop = go.ClosedLoop(
        model,
        go.design_lqr(model, [0], Q=1, R=1, dt=0.1),
        [Saturation("limit", -1.0, 1.0), Lag("thruster", 0.05, on="u")],
        [Noise("gauge", 0.01)],
    )
    spread = {"initial.v": Uniform(-0.05, 0.05), "thruster.tau": Normal(0.1, relative=True, truncate=3.0)}
    rows = go.monte_carlo(loop, 2, x0=[1.0], tf=1.0, dispersions=spread, executor="serial").scenario
    assert [row[:2] for row in rows] == [
        ("plant", "puck"),
        ("controller", loop.controller.name),
        ("sensor", "gauge"),
        ("actuator", "limit"),
        ("actuator", "thruster"),
        ("dispersion", "initial.v"),
        ("dispersion", "thruster.tau"),
        *(("design", fact.name) for fact in loop.controller.explain()),
        *(("software", name) for name in ("gnc_opt", "casadi", "numpy", "python")),
    ]
    assert rows[7:11] == (
        ("design", "reference", "constant state (0)"),
        ("design", "weight Q", "1 (diagonal; errors of v (m/s))"),
        ("design", "weight R", "1 (diagonal; u (m/s^2))"),
        ("design", "gain", "0.952 (K in u = u_ff - K e, rows: u)"),
    )
    assert [row[2] for row in rows[2:7]] == [
        "noise: standard deviation 0.01 m/s",
        "saturation: lower -1 m/s^2, upper 1 m/s^2",
        "lag on u: time constant 0.05 s",
        "uniform: low -0.05 m/s, high 0.05 m/s, added to the nominal value",
        "normal: standard deviation 0.1, truncate 3, relative to the nominal value",
    ]


def test_mistakes_are_reported(campaign, solution, tmp_path):
    with pytest.raises(go.ArgumentError, match="runs to show is 0"):
        write_campaign_report(campaign, tmp_path, runs=0)
    saved = campaign.save(tmp_path / "c.npz")
    with pytest.raises(go.GncOptError, match="has no compiled loop"):
        write_campaign_report(go.Campaign.load(saved), tmp_path / "new", view=View("r"))
    with pytest.raises(go.UnknownNameError, match="nose"):
        write_report(solution, None, tmp_path / "new", view=View("nose"))
    assert not (tmp_path / "new" / "report.html").exists()


def test_without_plotly_the_page_says_how_to_get_it(solution, monkeypatch):
    def missing(package, extra):
        raise go.GncOptError(f"{package} is not installed: pip install 'gnc_opt[{extra}]'.")

    monkeypatch.setattr("gnc_opt.plot.animated_3d_scene.import_optional_package", missing)
    told = render_3d_scene_html({"a turn": solution}, VIEW)
    assert "pip install &#x27;gnc_opt[report]&#x27;" in told and "<script" not in told


@pytest.mark.parametrize("name", [each.name for each in list_examples() if hasattr(each.module, "VIEW")])
def test_views_of_the_problems_name_what_there_is(name):
    file = find_example(name).module
    leg = next(iter(file.build().phases.values()))
    view, model = file.VIEW, leg.model
    known = {*model.states.names, *model.controls.names, *model.composed_controls}
    for part in (view.position, view.attitude, view.force):
        for each in [part] if isinstance(part, str) else part or ():
            assert each.partition("[")[0] in known


POINTS = """(name => {
  const trace = document.getElementById("stage").data.find(trace => trace.name === name);
  return [trace.x, trace.y, trace.z];
})"""


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
@pytest.mark.slow
def test_what_a_browser_shows(solution, tmp_path):
    shown = {"first": solution, "back": go.solve(turning([-2, 1, 0]), mesh="6x4", tol=None)}
    page = tmp_path / "scene.html"
    shown |= {f"run {i}": solution for i in range(9)}
    page.write_text(
        build_html_document("turns", "", {"Motion": render_3d_scene_html(shown, VIEW)}), encoding="utf-8"
    )
    data = carried(page.read_text("utf-8"))
    with browser() as tab:
        tab.open(page, PHONE, dark=True)
        tab.wait("document.getElementById('scene').dataset.ready !== undefined")
        assert tab.ask("document.documentElement.scrollWidth <= innerWidth")
        before = tab.look()
        k = len(data["times"]) // 2
        tab.ask(f"(s => {{ s.value = {k}; s.oninput(); }})(document.querySelector('#film input'))")
        clock = tab.ask("document.querySelector('#film output').textContent")
        assert clock == f"t = {data['times'][k]:.2f} s"
        assert np.abs(tab.look() - before).max() > 50  # it is seen
        check_vehicle(tab, data, "first", k)
        assert tab.ask("[...document.querySelector('#film select').options].map(o => o.value)") == list(shown)
        tab.ask("(s => { s.selectedIndex = 1; s.onchange(); })(document.querySelector('#film select'))")
        check_vehicle(tab, data, "back", k)
        click = "(b => { b.click(); return b.textContent; })(document.querySelector('#film button'))"
        assert tab.ask(f"{click} + {click}") == "PausePlay"  # at once, before it comes to its end
        tab.ask(click)
        tab.wait(f"document.querySelector('#film input').value > {k}")  # it plays on from there
        distance = "document.getElementById('stage').layout.scene.camera.eye.x"
        narrow = tab.ask(distance)
        tab.resize(DESKTOP)
        tab.wait(f"{distance} < 0.8 * {narrow}")
        assert tab.said == [] and tab.asked == [page.as_uri()]
        disabled = "<body><script>HTMLCanvasElement.prototype.getContext = () => null</script>"
        page.write_text(page.read_text("utf-8").replace("<body>", disabled), encoding="utf-8")
        tab.open(page, PHONE)
        scene = "document.getElementById('scene')"
        assert tab.ask(f"{scene}.innerText.trim()") == "The 3-D view needs JavaScript and WebGL."
        assert tab.ask(f"{scene}.clientHeight") < 100 and tab.said == []


def check_vehicle(tab, data, name, k):
    """Whether vehicle, axes and plume are where the k-th sample of a motion has them."""
    motion = data["motions"][name]
    here = np.array(motion["position"])[:, k]
    axes = np.array(motion["axes"])[:, :, k]
    axes = np.vstack([axes, np.cross(*axes)])
    assert np.allclose(tab.ask(f"{POINTS}('path')"), motion["position"])
    assert np.allclose(np.array(tab.ask(f"{POINTS}('path so far')"))[:, -1], here)
    assert np.allclose(np.mean(tab.ask(f"{POINTS}('vehicle')"), axis=1), here)
    for axis, label in zip(axes, ("bx", "by", "bz"), strict=True):
        root, tip = np.array(tab.ask(f"{POINTS}('{label}')")).T
        assert np.allclose(root, here) and np.allclose(tip - root, data["axis"] * axis)
    force = np.array(motion["force"])[:, k] @ axes
    root, tip = np.array(tab.ask(f"{POINTS}('plume')"))[:, :2].T
    assert np.allclose(root, here) and np.allclose(
        tip - root, -data["plume"] * force, atol=1e-3 * data["plume"]
    )
