"""Motion in three dimensions in reports: the numbers that the page carries, and what a browser makes of them."""

import base64
import gzip
import json
import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from testing.browser import BROWSER, PHONE, browser
from testing.internals import build_document, plot_run_envelopes, render_scene
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.plot import View
from gnc_opt.problem_file import example, examples
from gnc_opt.report import write_campaign_report, write_report
from gnc_opt.report.simulation_report import _find_worst_run
from gnc_opt.simulation import Lag, Noise, Normal, Saturation, Uniform
from gnc_opt.spacecraft import mrp_rate
from gnc_opt.text_formatting import simplify_time_integral_unit

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
    data = carried(render_scene({"a turn": solution}, VIEW))
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
        "initial.r<sub>1</sub>",
        5,
        "m",
        "normal: std 0.2, 0.4, 0.1 m, added to the nominal value",
        *(f"{f(drawn):.4g}" for f in (np.mean, np.std)),
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
    data = carried(render_scene(flown, View("r"), regular={"run 1": False}))
    assert max(data["high"]) < 10 and "run 1" in data["motions"]


@pytest.mark.usefixtures("blank_figures")
def test_campaign_report_states_the_scenario_and_shows_the_worst_run(campaign, tmp_path):
    paths = write_campaign_report(campaign, tmp_path, title="forty <gliders>")
    assert [p.name for p in paths] == [
        *("report.html", "campaign.npz", "campaign.json", "distributions.svg", "dispersion_r.svg"),
        *("envelope-errors.svg", "envelope-controls.svg", "errors.svg", "controls.svg"),
    ]
    page = paths[0].read_text("utf-8")
    assert "<h1>forty &lt;gliders&gt;</h1>" in page and len(page) < LARGEST
    for shown in ("40 runs from 0 to 2 s", "<td>plant</td><td>glider</td><td>3 states, 3 controls</td>",
                  "<td>initial.r</td><td>normal: std 0.2, 0.4, 0.1 m, added to the nominal value</td>",
                  "<td>seed</td><td>3</td>", "<td>gain</td>", "<td>casadi</td>",
                  f"<h2>Worst run: {campaign.worst('r', 1)[0]}</h2>", str(campaign.pass_rate("r"))):  # fmt: skip
        assert shown in page, shown
    worst, share = campaign.worst("r", 1)[0], f"{campaign.maximum('r') / 0.0069:.3g} % of the limit"
    beyond = 40 - int(np.sum(campaign.passed()))
    counts = f"of 40 runs 0 failed and {beyond} exceeded a limit"
    assert 0 < beyond < 40
    reason = f"largest value relative to its limit: final error of r, {share}; {counts}"
    assert f"in run {worst}: {reason}.</figcaption>" in page and "<td>final error of r</td>" in page
    assert "<p>With the same confidence (one-sided), 92." in page
    outcomes = list(campaign.outcomes)
    outcomes[worst] = replace(outcomes[worst], status=go.RunStatus.DIVERGED)
    some = replace(campaign, outcomes=tuple(outcomes))
    counts = f"of 40 runs 1 failed and {beyond - 1} exceeded a limit"
    assert _find_worst_run(some) == (worst, f"run {worst}: failed; {counts}")
    free = replace(campaign, limits={})
    counts = "of 40 runs 0 failed and 0 exceeded a limit"
    assert _find_worst_run(free)[1] == f"run {worst}: largest final error of r; {counts}"
    loaded = go.Campaign.load(paths[1])
    assert loaded.scenario == campaign.scenario
    assert "states.svg" not in {p.name for p in write_campaign_report(loaded, tmp_path / "loaded")}


def test_envelopes_show_percentiles_nominal_run_and_limit(campaign):
    runs = [campaign.rerun(i) for i in range(20)]
    nominal = campaign.flight.run(campaign.flight.nominal, 3)
    few = {name: getattr(runs[4], name)[:, :11] for name in ("states", "errors", "reference")}
    few["applied"] = runs[4].applied[:, :10]
    runs[4] = replace(runs[4], times=np.append(runs[4].times[:10], 0.97), **few)  # ended by an event
    figures = dict(plot_run_envelopes(campaign, runs, nominal))
    for i, ax in enumerate(figures["errors"].axes):
        lines = {line.get_label(): line for line in ax.lines}
        values = np.sort([run.errors[i, 5] for run in runs])
        assert (
            lines["median"].get_xdata()[5] == pytest.approx(0.5)
            and lines["median"].get_ydata()[5] == values[9]
        )
        later = [run.errors[i, 15] for k, run in enumerate(runs) if k != 4]
        band = ax.collections[0].get_paths()[0].vertices
        assert max(later) in band[np.isclose(band[:, 0], 1.5), 1]
        assert np.array_equal(lines["nominal"].get_ydata(), nominal.errors[i])
        low, high = ax.collections[-1].get_segments()[0][:, 1]  # the bar at the end
        assert (low, high) == pytest.approx((-0.69, 0.69))
    short = dict(plot_run_envelopes(campaign, runs, runs[4]))["errors"].axes[
        0
    ]  # a nominal run ended by an event
    assert short.get_xlim() == (0.0, 2.0) and np.isnan(short.lines[1].get_ydata()[11:]).all()
    control = figures["controls"].axes[1].lines[0].get_ydata()
    assert (
        control[3] == np.sort([run.applied[1, 3] for run in runs])[9] and len(figures["controls"].axes) == 3
    )


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
    nominal = campaign.flight.run(campaign.flight.nominal, 1)
    figures = dict(plot_run_envelopes(campaign, [campaign.rerun(0)], nominal))
    lines = {line.get_label(): line for line in figures["errors"].axes[0].lines}
    assert list(figures) == ["errors", "states", "controls"] and len(figures["states"].axes) == 1
    assert np.array_equal(lines["nominal"].get_ydata(), nominal.errors[0])
    ends = figures["errors"].axes[0].collections[-1].get_segments()[0][:, 1]
    assert ends == pytest.approx([-0.5, 0.5], abs=1e-6)
    paths = write_campaign_report(campaign, tmp_path)
    assert {"envelope-errors.svg", "errors.svg", "states.svg"} <= {path.name for path in paths}
    page = paths[0].read_text("utf-8")
    shares = {name: campaign.maximum(name) / limit for name, limit in campaign.limits.items()}
    assert shares["v"] > shares["q"] and "relative to its limit: final error of v, " in page
    for shown in (
        "<td>effort of a</td><td>m/s</td>",
        "sigma 0.001 m<",
        "lower -9 m/s<sup>2</sup>, upper 9 m/s<sup>2</sup>",
        "std 0.02 m, added to the nominal value",
        "control step 0.1 s",
        "the columns to the errors of q (m), v (m/s)",
        "solution of &#x27;rest to rest&#x27;, 0 s to 2 s",
        "<td>weight Q</td><td>1, 1 (diagonal; errors of q (m), v (m/s))</td>",
        "smallest eigenvalue of the Riccati solution P",
    ):
        assert shown in page, shown


def test_scene_describes_the_body_axes_and_the_plume(solution):
    text = "Body axes: bx, by, bz; plume: opposite to the resultant force"
    assert text in render_scene({"turn": solution}, VIEW) and "ody axes" not in render_scene(
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
        "noise: sigma 0.01 m/s",
        "saturation: lower -1 m/s^2, upper 1 m/s^2",
        "lag: on u, tau 0.05 s",
        "uniform: low -0.05 m/s, high 0.05 m/s, added to the nominal value",
        "normal: std 0.1, truncate 3, relative to the nominal value",
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

    monkeypatch.setattr("gnc_opt.plot.animated_3d_scene.import_optional", missing)
    told = render_scene({"a turn": solution}, VIEW)
    assert "pip install &#x27;gnc_opt[report]&#x27;" in told and "<script" not in told


@pytest.mark.parametrize("name", [each.name for each in examples() if hasattr(each.module, "VIEW")])
def test_views_of_the_problems_name_what_there_is(name):
    file = example(name).module
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
    page.write_text(build_document("turns", "", {"Motion": render_scene(shown, VIEW)}), encoding="utf-8")
    data = carried(page.read_text("utf-8"))
    with browser() as tab:
        tab.open(page, PHONE, dark=True)
        tab.wait("document.getElementById('scene').dataset.ready !== undefined")
        assert tab.ask("document.documentElement.scrollWidth <= innerWidth")
        before = tab.look()
        k = len(data["times"]) // 2
        tab.ask(f"(s => {{ s.value = {k}; s.oninput(); }})(document.querySelector('#film input'))")
        assert (
            tab.ask("document.querySelector('#film output').textContent") == f"t = {data['times'][k]:.2f} s"
        )
        assert np.abs(tab.look() - before).max() > 50  # it is seen
        check_vehicle(tab, data, "first", k)
        assert tab.ask("[...document.querySelector('#film select').options].map(o => o.value)") == list(shown)
        tab.ask("(s => { s.selectedIndex = 1; s.onchange(); })(document.querySelector('#film select'))")
        check_vehicle(tab, data, "back", k)
        click = "(b => { b.click(); return b.textContent; })(document.querySelector('#film button'))"
        assert tab.ask(f"[{click}, {click}]") == [
            "Pause",
            "Play",
        ]  # at once, lest it come to its end in between
        tab.ask(click)
        tab.wait(f"document.querySelector('#film input').value > {k}")  # it plays on from there
        assert tab.said == [] and tab.asked == [page.as_uri()]


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
