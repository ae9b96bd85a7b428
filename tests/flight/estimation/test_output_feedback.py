"""Sensors, estimator and controller in a loop: consistency, lost samples, files, flight code."""

import shutil
import subprocess
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from testing.models import dynamics

import gnc_opt as go
from gnc_opt.analysis import consistency
from gnc_opt.control import with_dropout_handling
from gnc_opt.estimation import FilterOptions, Measurement, design_ekf, output_feedback
from gnc_opt.simulation import (
    Campaign,
    Noise,
    Normal,
    PiecewiseConstantNoise,
    Run,
    RunStatus,
    SensorOutage,
    ZeroOrderHold,
)

DT = 0.1
COMPILER = shutil.which("cc")


def cart() -> go.Model:
    model = go.Model("cart")
    q, v, a = model.state("q", unit="m"), model.state("v", unit="m/s"), model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    model.output("distance", ca.sqrt(1 + q**2), unit="m")
    model.output("felt", a - q, unit="m/s^2")
    return model


def regulator(model, **options) -> go.Controller:
    return go.design_lqr(model, [0.0, 0.0], Q={"q": 1}, R={"a": 1}, dt=DT, **options)


def filter_(model, sensors=None, sigma0=(0.5, 0.3), **options):
    sensors = [Measurement("q", 0.1, gate=0.9999)] if sensors is None else sensors
    given = {"process_noise": {"v": 0.1}, "dt": DT} | options
    return design_ekf(model, [1.0, 0.0], sensors, sigma0=dict(zip("qv", sigma0, strict=True)), **given)


def loop_of(estimator, *more, sigma=0.1, **options):
    model = cart()
    gusts = [PiecewiseConstantNoise("gusts", 0.1 / np.sqrt(DT), on="v")]
    sensors = [Noise("radar", sigma, on="q"), *more]
    return go.ClosedLoop(
        model, output_feedback(regulator(model), estimator), sensors=sensors, disturbances=gusts, **options
    )


MISSION = {"x0": [1.0, 0.0], "tf": 6.0}
SPREAD = {"initial.q": Normal(0.5), "initial.v": Normal(0.3)}


def flown(estimator, **options) -> Campaign:
    loop = loop_of(estimator, **options)
    return go.monte_carlo(loop, 150, **MISSION, seed=8, dispersions=SPREAD, executor="serial")


@pytest.fixture(scope="module")
def right():
    return filter_(cart())


@pytest.fixture(scope="module")
def campaign(right) -> Campaign:
    return flown(right)


def test_a_right_filter_is_consistent(right, campaign):
    found = consistency(campaign, right)
    assert found.ok and found.independent and found.components == 2
    assert found.innovations["q"].taken + found.innovations["q"].refused == 150 * 60
    assert found.nees.shape == (150,) and found.band[0] < 2 < found.band[1]
    assert 0.88 < found.share_within < 1.0
    estimate = right.estimate(campaign.memory)
    e = campaign.states[:, 3] - estimate[:, 3]
    P = right.covariance(campaign.memory)[3]
    assert found.nees[3] == pytest.approx(e @ np.linalg.solve(P, e), rel=1e-9)
    assert "NIS of q" in str(found) and "mean over the runs" in str(found)


@pytest.mark.parametrize("wrong", ["noise", "guess", "gusts"])
def test_a_filter_that_is_too_sure_is_found_out(wrong):
    changed = {
        "noise": {"sensors": [Measurement("q", 0.09)]},
        "guess": {"sigma0": (0.05, 0.03)},
        "gusts": {"process_noise": {"v": 0.03}},
    }[wrong]
    estimator = filter_(cart(), **changed)
    found = consistency(flown(estimator), estimator)
    assert not found.ok and found.innovations["q"].average > found.innovations["q"].band[1]


def test_runs_report_estimates_and_innovations(right, tmp_path):
    loop = loop_of(right)
    run = loop.simulate(**MISSION, seed=2)
    found = consistency(run, right)
    assert not found.independent and found.nees.shape == (61,) and found.ok
    z, sum_of_squares = None, 0.0
    for k in range(60):  # the same by hand
        assert np.allclose(run.memory[: right.memory.size, k], right.first if z is None else z, atol=1e-12)
        before = right.first if z is None else z
        S = right.covariance(before)[0, 0] + 0.01
        sum_of_squares += (run.measured[0, k] - right.estimate(before)[0]) ** 2 / S
        _, z = right(run.times[k], run.measured[:, k], run.commands[:, k], z)
    assert found.innovations["q"].average == pytest.approx(sum_of_squares / 60, rel=1e-9)
    assert run.controller_state("q_hat").values[0, -1] == pytest.approx(z[0])
    again = Run.load(run.save(tmp_path / "run.npz"))
    assert again.reference_layout.names == ("q", "v") and consistency(again, right).average == found.average


def test_campaigns_keep_what_estimators_reported(right, campaign, tmp_path):
    again = Campaign.load(campaign.save(tmp_path / "campaign.npz"))
    assert np.array_equal(again.memory, campaign.memory)
    assert consistency(again, right).average == consistency(campaign, right).average
    arguments = {**MISSION, "seed": 8, "dispersions": SPREAD, "executor": "serial"}
    folder = tmp_path / "checkpoint"
    go.monte_carlo(loop_of(right), 20, **arguments, checkpoint=folder)
    resumed = go.monte_carlo(loop_of(right), 40, **arguments, checkpoint=folder)
    assert np.array_equal(resumed.memory, campaign.memory[:, :40])


def test_outputs_are_measured_and_slow_sensors_held():
    model = cart()
    sensors = [Measurement("distance", 0.02), Measurement("v", 0.05, period=0.3)]
    estimator = design_ekf(
        model, [1.0, 0.0], sensors, sigma0={"q": 0.1, "v": 0.3}, process_noise={"v": 0.1}, dt=DT
    )
    loop = go.ClosedLoop(
        model,
        output_feedback(regulator(model), estimator),
        sensors=[
            Noise("radar", 0.02, on="distance"),
            Noise("doppler", 0.05, on="v"),
            ZeroOrderHold("slow", 0.3, on="v"),
        ],
    )
    run = loop.simulate([1.05, 0.1], tf=3.0)
    assert run.measurement("distance").values[0, 0] == pytest.approx(np.sqrt(1 + 1.05**2), abs=0.1)
    assert np.std(
        run.measurement("distance").values - np.sqrt(1 + run.states[:1, :-1] ** 2)
    ) == pytest.approx(0.02, rel=0.5)
    assert run.errors is not None and np.isfinite(run.errors).all()
    taken = run.memory[loop.controller.memory.slice("v_taken"), -1]
    assert taken == 10 and consistency(run, estimator).ok


def test_an_outage_is_bridged_then_the_controllers_provision_acts(right):
    model = cart()
    estimator = filter_(model, options=FilterOptions(hold=4))
    short, long = (loop_of(estimator, SensorOutage("gap", 1.0, end)) for end in (1.39, 3.0))
    assert short.simulate(**MISSION).outcome.ok
    failed = long.simulate(**MISSION)
    assert failed.outcome.status is RunStatus.CONTROLLER_ALARM and failed.outcome.what == "invalid"
    # samples are lost from 1.0 s on: four are predicted, three more bridged by the controller
    assert failed.outcome.time == pytest.approx(1.7)
    commands = failed.command("a")
    assert commands(1.75) == 0 and commands(1.65) == commands(1.35) != commands(1.25) and commands(3.2) != 0
    patient = go.ClosedLoop(
        model,
        output_feedback(with_dropout_handling(regulator(model), hold=30), estimator),
        sensors=[SensorOutage("gap", 1.0, 3.0)],
    )
    assert patient.simulate(**MISSION).outcome.ok


def test_a_law_of_several_expressions_is_fed_alike(right):
    """MX laws, as those with a solver inside."""
    model = cart()
    inner = regulator(model)
    t, x = ca.MX.sym("t"), ca.MX.sym("x", 2)
    r, z = ca.MX.sym("r", inner.signals.size), ca.MX.sym("z", inner.memory.size)
    wrapped = replace(
        inner,
        step=ca.Function("law", [t, x, r, z], inner.step(t, x, r, z)),
        start=ca.Function("start", [t, x, r], [inner.start(t, x, r)]),
    )
    loops = [go.ClosedLoop(model, output_feedback(c, right)) for c in (inner, wrapped)]
    ends = [loop.simulate([1.2, 0.1], tf=2.0).states for loop in loops]
    assert np.allclose(*ends, atol=1e-14)


@pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc) on this machine")
def test_flight_code_holds_estimator_and_controller(tmp_path):
    model = cart()
    sensors = [
        Measurement("distance", 0.02, gate=0.9999),
        Measurement("v", 0.05, period=0.3, delay=0.2, bias=0.1),
    ]
    estimator = design_ekf(
        model, [1.0, 0.0], sensors, sigma0={"q": 0.1, "v": 0.3}, process_noise={"v": 0.1}, dt=DT,
        options=FilterOptions(hold=1),
    )  # fmt: skip
    law = output_feedback(regulator(model), estimator)
    code = go.export_c(law, tmp_path)
    assert "distance, m" in code.header.read_text() and "covariance" in code.header.read_text()
    program = tmp_path / "driver"
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1", "-ffp-contract=off"]
    subprocess.run(
        [COMPILER, *flags, "-o", str(program), str(code.source), str(code.driver), "-lm"], check=True
    )
    rng = np.random.default_rng(6)
    times, x, late, z = DT * np.arange(60), np.array([1.05, 0.1]), [0.1, 0.1], None
    samples, expected = [], []
    for k, t in enumerate(times):
        late.append(x[1])
        y = np.array([np.hypot(1, x[0]), late[-3] + 0.05]) + [0.02, 0.05] * rng.normal(size=2)
        if k == 10 or 20 <= k < 28:  # longer than all bridge
            y[:] = np.nan
        if k == 15:
            y[0] = 50.0  # an outlier
        u, z = law(t, y, z)
        samples.append(y)
        expected.append(u[0])
        x = np.array([x[0] + DT * x[1] + 0.5 * DT**2 * u[0], x[1] + DT * u[0]])
    lines = "\n".join(" ".join(repr(float(v)) for v in (t, *y)) for t, y in zip(times, samples, strict=True))
    found = subprocess.run([str(program)], input=lines, check=True, capture_output=True, text=True)
    assert z[law.memory.slice("invalid")] == 1 and z[law.memory.slice("distance_refused")] == 1
    assert np.ptp(expected) > 0.1 and expected[27] == 0
    assert np.allclose(np.array(found.stdout.split(), dtype=float), expected, rtol=1e-12, atol=1e-13)


def test_what_does_not_fit_is_refused(right):
    model = cart()
    law = regulator(model)
    with pytest.raises(go.ArgumentError, match="the result of design_ekf"):
        output_feedback(law, law)
    with pytest.raises(go.ArgumentError, match="the result of a design function"):
        output_feedback(right, right)
    both = output_feedback(law, right)
    with pytest.raises(go.ArgumentError, match="already includes an estimator"):
        output_feedback(both, right)
    with pytest.raises(go.ArgumentError, match="apply it to the controller inside"):
        with_dropout_handling(both)
    with pytest.raises(go.ArgumentError, match=r"for control steps of 0\.1 s, not 0\.2 s"):
        output_feedback(law, filter_(model, dt=0.2))
    other, *_ = dynamics("other", "p", "b", lambda p, b: {p: b})
    stranger = design_ekf(other, [0], [Measurement("p", 1)], sigma0={"p": 1}, dt=DT)
    with pytest.raises(go.ArgumentError, match="needs the state 'q', which 'EKF' does not have"):
        output_feedback(law, stranger)
    third = go.design_lqr(other, [0.0], Q={"p": 1}, R={"b": 1}, dt=DT)
    with pytest.raises(go.ArgumentError, match="needs the state 'p'"):
        output_feedback(third, right)
    wide, _q, _v, _a = dynamics("wide", "q:2 v", "a", lambda q, v, a: {q: ca.vertcat(v, v), v: a})
    sensor = [Measurement("q", 1)]
    big = design_ekf(wide, [0, 0, 0], sensor, sigma0={"q": 1, "v": 1}, dt=DT)
    with pytest.raises(go.ArgumentError, match="state 'q' has 1 components in 'LQR' and 2 in 'EKF'"):
        output_feedback(law, big)


def test_plants_without_what_is_measured_are_refused(right):
    model = cart()
    law = output_feedback(regulator(model), filter_(model, [Measurement("distance", 0.1)]))
    bare = go.Model("bare")
    q, v, a = bare.state("q", unit="m"), bare.state("v"), bare.control("a")
    bare.ode({q: v, v: a})
    with pytest.raises(go.ArgumentError, match="measures 'distance', which the plant 'bare' does not have"):
        go.ClosedLoop(bare, law)
    bare.output("distance", q + a, unit="m")
    with pytest.raises(go.ArgumentError, match="depends on a control"):
        go.ClosedLoop(bare, law)
    other = go.Model("other")
    q, v, a = other.state("q", unit="km"), other.state("v"), other.control("a")
    other.ode({q: v, v: a})
    other.output("distance", q, unit="m")
    with pytest.raises(go.ArgumentError, match="state 'q' is in km"):
        go.ClosedLoop(other, law)


def test_consistency_needs_the_estimator_of_the_loop(right, campaign):
    model = cart()
    bare = go.ClosedLoop(model, regulator(model)).simulate([1.0, 0.0], tf=0.3)
    with pytest.raises(go.ArgumentError, match="has no 'q_hat'"):
        consistency(bare, right)
    with pytest.raises(go.ArgumentError, match="give a number between"):
        consistency(campaign, right, confidence=1.5)
    with pytest.raises(go.ArgumentError, match="give a run or a campaign"):
        consistency(model, right)
    with pytest.raises(go.ArgumentError, match="give the estimator of the loop"):
        consistency(campaign, model)
    other = go.Model("cart with a third state")
    q, v, w, a = other.state("q"), other.state("v"), other.state("w"), other.control("a")
    other.ode({q: v, v: a, w: -w})
    given = {"sigma0": {"q": 1.0, "v": 1.0, "w": 1.0}, "dt": right.dt}
    larger = go.design_ukf(other, [0, 0, 0], [Measurement("q", 0.1)], **given)
    with pytest.raises(go.ArgumentError, match="of estimator 'UKF'"):
        consistency(campaign, larger)
    known = filter_(model, sigma0=(0.0, 0.0))
    with pytest.raises(go.ArgumentError, match="treats 'q' as exactly known"):
        consistency(loop_of(known).simulate(**MISSION), known)


def test_a_push_that_lasts_is_a_state_of_the_filters_own_model():
    """The cart's filter knows a third state that plant and regulator do not have, and finds it as well as it says."""
    plant = go.Model("pushed")
    q, v, a = plant.state("q", unit="m"), plant.state("v", unit="m/s"), plant.control("a", unit="m/s^2")
    push = plant.parameter("push", 0.0, unit="m/s^2")
    plant.ode({q: v, v: a + push})
    own, q, v, _d, a = dynamics("its own", "q v d", "a", lambda q, v, d, a: {q: v, v: a + d, d: 0.0})
    sigma0 = {"q": 0.5, "v": 0.3, "d": 0.2}
    radar = [Measurement("q", 0.1, gate=0.9999)]
    noise = {"v": 0.1}
    told = design_ekf(own, [1.0, 0.0, 0.0], radar, sigma0=sigma0, process_noise=noise, dt=DT)
    gusts = [PiecewiseConstantNoise("gusts", 0.1 / np.sqrt(DT), on="v")]
    law = output_feedback(regulator(plant), told)
    loop = go.ClosedLoop(plant, law, sensors=[Noise("radar", 0.1, on="q")], disturbances=gusts)
    mission = {"x0": [1.0, 0.0], "tf": 6.0, "seed": 5, "executor": "serial"}
    campaign = go.monte_carlo(loop, 200, **mission, dispersions=SPREAD | {"plant.push": Normal(0.2)})
    judged = consistency(campaign, told)
    assert judged.band[0] < judged.average < judged.band[1]
    assert judged.innovations["q"].average == pytest.approx(1.0, abs=0.1)
    run = campaign.rerun(0)
    sigma = np.sqrt(told.covariance(run.memory[: told.memory.size, -1])[2, 2])
    found = run.controller_state("d_hat")(6.0)
    assert found == pytest.approx(run.parameter("plant.push"), abs=4 * sigma) and sigma < 0.15
