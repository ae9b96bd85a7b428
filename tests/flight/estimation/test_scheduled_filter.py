"""The filter with gains made beforehand: against the one that makes them in flight, and Riccati's equation."""

import shutil
import subprocess

import casadi as ca
import numpy as np
import pytest
import scipy

import gnc_opt as go
from gnc_opt.analysis import consistency
from gnc_opt.control import Reference
from gnc_opt.estimation import FilterOptions, Measurement, UnscentedOptions, design_scheduled_ekf
from gnc_opt.simulation import Noise, Normal, RandomHold
from gnc_opt.spacecraft import quaternion_difference, quaternion_rate, quaternion_retraction

DT = 0.1
ABOUT = {"sigma0": {"q": 1.0, "v": 2.0}, "process_noise": {"v": 0.3}, "dt": DT}
COMPILER = shutil.which("cc")


def cart() -> go.Model:
    model = go.Model("cart")
    q, v, a = model.state("q", unit="m"), model.state("v", unit="m/s"), model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    model.output("distance", ca.sqrt(1 + q**2), unit="m")
    return model


def moving(model) -> Reference:
    """A reference with x = 0.5 t^2 until 4 s."""
    return Reference.from_functions(model, lambda t: [0.5 * t**2, t], lambda t: [1.0], 0.0, 4.0, tail="hold")


@pytest.mark.parametrize(
    "sensors",
    [
        [Measurement("q", 0.1)],
        [Measurement("q", 0.1, period=3 * DT, delay=2 * DT), Measurement("v", 0.5, gate=1 - 1e-12)],
        [Measurement("q", 0.1, bias=0.3, bias_walk=0.2), Measurement("v", 0.5, period=2 * DT)],
    ],
    ids=["plain", "slow and late", "biased"],
)
def test_linear_systems_have_one_filter(sensors):
    """Gains do not depend on the samples: estimates, covariances and, sensor by sensor, innovations are the same."""
    model = cart()
    light = design_scheduled_ekf(model, moving(model), sensors, **ABOUT)
    full = go.design_ekf(model, [0.0, 0.0], sensors, **ABOUT)
    rng, z, z_full = np.random.default_rng(3), None, None
    for k in range(40):
        y, u = rng.normal(size=len(sensors)), rng.normal(size=1)
        x, z = light(k * DT, y, u, z)
        told, z_full = full(k * DT, y, u, z_full)
        assert x == pytest.approx(told, rel=1e-9, abs=1e-11)
        assert light.covariance(z) == pytest.approx(full.covariance(z_full), rel=1e-9)
    for name in ("v_taken", "q_taken", "v_refused") if len(sensors) == 2 else ("q_taken", "q_nis"):
        if name in light.memory:
            assert z[light.memory.slice(name)] == pytest.approx(z_full[full.memory.slice(name)], rel=1e-9)


def test_held_gains_are_those_of_the_riccati_equation():
    model = cart()
    light = design_scheduled_ekf(model, [0.0, 0.0], [Measurement("q", 0.1)], **ABOUT)
    F, H, R = np.array([[1, DT], [0, 1.0]]), np.array([[1.0, 0]]), np.array([[0.01]])
    Q = 0.09 * np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
    P = scipy.linalg.solve_discrete_are(F.T, H.T, Q, R)
    K = P @ H.T / (H @ P @ H.T + R)
    row = light.schedule(np.array([1e4]), DT)[:, 0]
    assert row[light.signals.slice("kalman_gain")] == pytest.approx(K[:, 0], rel=1e-4)
    assert row[light.signals.slice("q_whitening")] == pytest.approx((P[0, 0] + 0.01) ** -0.5, rel=1e-4)
    assert light.schedule(np.array([light.span[1], 1e4]), DT).std(axis=1).max() == 0
    first = light.schedule(np.array([-5.0, 0.0]), DT)[light.signals.slice("kalman_gain")]
    assert first == pytest.approx(np.array([[1 / 1.01] * 2, [0.0] * 2]), abs=1e-12)
    assert "steady to 1e-05" in str(light.explain())
    walking = design_scheduled_ekf(
        model, [0.0, 0.0], [Measurement("q", 0.1)], **ABOUT | {"process_noise": {}}
    )
    assert "not steady" in str(walking.explain())  # the gain falls for ever, as that of a mean


def test_what_is_missing_or_refused_moves_nothing_and_is_counted():
    model, hold = cart(), FilterOptions(hold=1)
    sensors = [Measurement("q", 0.1, gate=0.99), Measurement("v", 0.5)]
    light = design_scheduled_ekf(model, [0.0, 0.0], sensors, options=hold, **ABOUT)
    both, _ = light(0.0, [0.1, 0.2], [0.0])
    one, z = light(0.0, [np.nan, 0.2], [0.0])
    other, _ = light(0.0, [0.1, np.inf], [0.0])
    assert (
        both == pytest.approx(one + other, rel=1e-12) and one[1] != 0 != other[0]
    )  # the columns of a linear law
    assert z[light.memory.slice("q_taken")] == 0 and z[light.memory.slice("v_taken")] == 1
    bound = np.sqrt(scipy.stats.chi2.ppf(0.99, 1) * 1.01)
    for sample, refused in ((bound * (1 - 1e-9), 0), (-bound * (1 + 1e-9), 1)):
        _, z = light(0.0, [sample, 0.2], [0.0])
        assert z[light.memory.slice("q_refused")] == refused == 1 - z[light.memory.slice("q_taken")]
    told, z = [], None
    for k in range(4):
        x, z = light(k * DT, [np.nan, np.nan] if k < 3 else [0.0, 0.0], [0.0], z)
        told.append(bool(np.isfinite(x).all()))
    assert told == [True, False, False, True]  # one step is bridged


def test_along_a_turn_the_gains_are_those_of_the_full_filter_to_first_order():
    """A spinning body seen by a star tracker: what is left between the filters falls with the square of the errors."""
    model = go.Model("spinner")
    q, w = model.state("q", 4), model.state("w", 3, unit="rad/s")
    model.ode({q: quaternion_rate(q, w), w: ca.vertcat(0.3 * w[1] * w[2], -0.2 * w[0] * w[2], 0)})
    model.difference(q, quaternion_difference, quaternion_retraction)
    rest, spin = np.array([1.0, 0, 0, 0]), np.array([0.3, 0.1, -0.2])
    steps = 20
    path = [np.r_[rest, spin]]
    for _ in range(steps):
        path.append(
            scipy.integrate.solve_ivp(lambda t, x: model.f(t, x, []), (0, DT), path[-1], rtol=1e-11).y[:, -1]
        )
    table = scipy.interpolate.CubicSpline(DT * np.arange(steps + 1), path)
    reference = Reference.from_functions(model, table, lambda t: [], 0.0, steps * DT, tail="hold")
    about = {"sigma0": {"q": 0.1, "w": 0.1}, "process_noise": {"w": 1e-3}, "dt": DT}
    sensor = [Measurement("q", 1e-2)]
    light = design_scheduled_ekf(model, reference, sensor, **about)
    full = go.design_ekf(model, path[0], sensor, **about)
    assert light.update.n_instructions() < 0.6 * full.update.n_instructions()
    assert light.predict.n_instructions() < 0.25 * full.predict.n_instructions()
    apart, moved = [], []
    for size in (0.04, 0.02):
        rng, z, z_full = np.random.default_rng(5), None, None
        for k in range(steps):
            y = quaternion_retraction(path[k][:4], size * rng.normal(size=3))
            x, z = light(k * DT, y, [], z)
            told, z_full = full(k * DT, y, [], z_full)
        apart.append(np.max(np.abs(x - told)))
        moved.append(np.max(np.abs(x - path[steps - 1])))
    assert apart[0] / apart[1] == pytest.approx(4, rel=0.3) and apart[0] < 0.05 * moved[0]


def _loop():
    model = cart()
    light = design_scheduled_ekf(
        model, [1.0, 0.0], [Measurement("q", 0.1)],
        sigma0={"q": 0.5, "v": 0.3}, process_noise={"v": 0.1}, dt=DT,
    )  # fmt: skip
    regulator = go.design_lqr(model, [0.0, 0.0], Q={"q": 1}, R={"a": 1}, dt=DT)
    return light, go.ClosedLoop(
        model,
        go.output_feedback(regulator, light),
        sensors=[Noise("radar", 0.1, on="q")],
        disturbances=[RandomHold("gusts", 0.1 / np.sqrt(DT), on="v")],
    )


def test_it_knows_how_wrong_it_is():
    light, loop = _loop()
    spread = {"initial.q": Normal(0.5), "initial.v": Normal(0.3)}
    campaign = go.monte_carlo(loop, 150, x0=[1.0, 0.0], tf=6.0, seed=8, dispersions=spread, executor="serial")
    found = consistency(campaign, light)
    assert found.ok and found.innovations["q"].taken == 150 * 60 and 0.88 < found.within < 1
    run = campaign.rerun(2)
    assert consistency(run, light).nees.shape == (61,)
    assert run.remembered("predicted_for").values[0] == pytest.approx(run.times)


@pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc) on this machine")
def test_flight_code_holds_the_gains(tmp_path):
    law = _loop()[1].controller
    code = go.export_c(law, tmp_path)
    assert "kalman_gain" in code.header.read_text()
    program = tmp_path / "driver"
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]
    subprocess.run([COMPILER, *flags, "-o", program, code.source, code.driver, "-lm"], check=True)
    rng, z, expected, samples = np.random.default_rng(6), None, [], []
    for k in range(60):
        y = np.nan if k in (7, 8) else rng.normal()
        u, z = law(k * DT, [y], z)
        samples.append(f"{k * DT!r} {y!r}")
        expected.append(u[0])
    found = subprocess.run([program], input="\n".join(samples), check=True, capture_output=True, text=True)
    assert np.ptp(expected) > 0.1
    assert np.array(found.stdout.split(), dtype=float) == pytest.approx(expected, rel=1e-12, abs=1e-13)


def test_what_cannot_be_meant_is_refused():
    model, other = cart(), go.Model("lift")
    h = other.state("h", unit="m")
    other.ode({h: other.control("w", unit="m/s")})
    sensor = [Measurement("q", 0.1)]
    with pytest.raises(go.ArgumentError, match=r"reference of 'scheduled EKF' has the states \['h'\]"):
        design_scheduled_ekf(model, Reference.constant(other, [0.0]), sensor, **ABOUT)
    with pytest.raises(go.ArgumentError, match=r"t0 of 'scheduled EKF' is 3 s, its reference begins at 0 s"):
        design_scheduled_ekf(model, [0.0, 0.0], sensor, options=FilterOptions(t0=3.0), **ABOUT)
    with pytest.raises(go.ArgumentError, match="no points to spread"):
        design_scheduled_ekf(model, [0.0, 0.0], sensor, options=UnscentedOptions(), **ABOUT)
    named = go.Model("named")
    q = named.state("q")
    named.ode({q: named.control("a")})
    named.output("kalman_gain", q**2)
    tracker = go.design_lqr(named, [0.0], Q=1, R=1, dt=DT)
    light = design_scheduled_ekf(named, [0.0], [Measurement("q", 0.1)], sigma0={"q": 1.0}, dt=DT)
    twice = go.output_feedback(tracker, light)
    with pytest.raises(go.ArgumentError, match="is fed by an estimator already"):
        go.output_feedback(twice, light)
