"""Linear covariance: closed forms, 1600 runs, the share of each source, and where a loop is not linear."""

import sys
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.internals import Dispersion, Linearization
from testing.loops import agrees
from testing.models import dynamics
from testing.sled import DT, loop_of, regulator, sled

import gnc_opt as go
from gnc_opt.estimation import Measurement
from gnc_opt.simulation import (
    Choice,
    Delay,
    Event,
    Lag,
    Noise,
    Normal,
    RandomDirection,
    RandomRotation,
    Uniform,
    UniformInBall,
)
from gnc_opt.spacecraft import mrp_difference, mrp_rate, quaternion_difference, quaternion_rate

STEPS = 60
MISSION = {"x0": [0.5, 0.0], "tf": DT * STEPS}
SPREAD = {"initial.q": Normal(0.2), "initial.v": Normal(0.1, mean=0.05)}


@pytest.fixture(scope="module")
def found() -> go.LinearCovariance:
    return go.linear_covariance(go.Scenario(loop_of(), **MISSION, dispersions=SPREAD))


@pytest.fixture(scope="module")
def campaign() -> go.Campaign:
    return go.monte_carlo(loop_of(), 1600, **MISSION, seed=11, dispersions=SPREAD, executor="serial")


def recursion() -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The same loop by hand: covariances by source and the mean error, over time."""
    K = regulator(sled()).explain()["gain"]
    A, B = np.array([[0, 1], [0, 0.0]]), np.array([[0.0], [0.5]])
    P = scipy.linalg.expm(np.block([[A, B], [np.zeros((1, 3))]]) * DT)
    A, B = P[:2, :2], P[:2, 2:]
    closed = A - B @ K
    gust = np.block([[closed, B], [np.zeros((1, 2)), np.eye(1)]])
    parts = {"initial.q": np.diag([0.04, 0]), "initial.v": np.diag([0, 0.01])}
    parts |= {"odometer": np.zeros((2, 2)), "tachometer": np.zeros((2, 2)), "gusts": np.zeros((3, 3))}
    history = {name: [] for name in parts}
    mean, means = np.array([0, 0.05]), []
    for k in range(STEPS + 1):
        for name, S in parts.items():
            history[name].append(S[:2, :2])
        means.append(mean)
        if k % 5 == 0:
            parts["gusts"][2] = parts["gusts"][:, 2] = 0
            parts["gusts"][2, 2] = 0.09
        for name in ("initial.q", "initial.v"):
            parts[name] = closed @ parts[name] @ closed.T
        for i, (name, sigma) in enumerate((("odometer", 0.05), ("tachometer", 0.02))):
            way = sigma * B @ K[:, [i]]
            parts[name] = closed @ parts[name] @ closed.T + way @ way.T
        parts["gusts"] = gust @ parts["gusts"] @ gust.T
        mean = closed @ mean
    return {name: np.array(S) for name, S in history.items()}, np.array(means)


def test_every_source_has_the_covariance_of_the_discrete_recursion(found):
    expected, means = recursion()
    assert found.sources == tuple(expected)
    parts = dict(zip(found.sources, found.parts["error"], strict=True))
    for name, S in expected.items():
        assert parts[name] == pytest.approx(S, rel=1e-9, abs=1e-13), name
    assert found.mean == pytest.approx(means.T, abs=1e-12)
    total = sum(expected.values())
    assert found.covariance("q")[:, 0, 0] == pytest.approx(total[:, 0, 0])
    assert found.std("v")[0] == pytest.approx(np.sqrt(total[:, 1, 1]))


def test_budget_shares_add_up_and_name_the_largest_first(found):
    expected, _ = recursion()
    shares = found.variance_budget("v", at=3.0)
    variances = {name: S[30, 1, 1] for name, S in expected.items()}
    assert list(shares) == sorted(variances, key=variances.get, reverse=True)
    assert shares == pytest.approx({n: x / sum(variances.values()) for n, x in variances.items()})
    assert sum(found.variance_budget("q").values()) == pytest.approx(1.0)


def test_commands_scatter_by_gain_and_noise(found):
    """At the first step u = -K (x + n)."""
    K = regulator(sled()).explain()["gain"][0]
    expected = np.hypot(*(K * np.sqrt([0.04 + 0.05**2, 0.01 + 0.02**2])))
    assert found.std("command(F)")[0, 0] == pytest.approx(expected)
    assert found.std("applied(F)")[0, 0] == pytest.approx(expected)
    assert found.std("command(F)").shape == (1, STEPS)


def test_1600_runs_agree(found, campaign):
    assert agrees(found, campaign)
    smaller = replace(found, parts={kind: 0.8 * part for kind, part in found.parts.items()})
    assert not agrees(smaller, campaign)


def test_delays_lags_and_an_estimator_are_part_of_the_loop():
    """Sensors, estimator, controller and actuators with memories, against as many runs as tell 5 %."""
    model = sled()
    ekf = go.design_ekf(
        model, [0.5, 0.0], [Measurement("q", 0.05, delay=2 * DT)],
        sigma0={"q": 0.2, "v": 0.1}, process_noise={"v": 0.05}, dt=DT,
    )  # fmt: skip
    loop = go.ClosedLoop(
        model, go.output_feedback(regulator(model), ekf), actuators=[Lag("motor", 0.15)],
        sensors=[Noise("odometer", 0.05, on="q"), Delay("late", 2 * DT, on="q")], minor_steps=2,
    )  # fmt: skip
    spread = {"initial.q": Normal(0.2), "initial.v": Normal(0.1), "motor.tau": Uniform(-0.02, 0.02)}
    predicted = go.linear_covariance(go.Scenario(loop, **MISSION, dispersions=spread), every=7)
    assert predicted.times[[0, 1, -1]] == pytest.approx([0.0, 0.7, 6.0])
    runs = go.monte_carlo(loop, 1000, **MISSION, seed=5, dispersions=spread, executor="serial")
    assert agrees(predicted, runs)
    assert predicted.variance_budget("q")["odometer"] > 0.5


def test_a_filter_in_error_on_the_nominal_run_weighs_by_a_covariance_that_scatters(monkeypatch):
    """Against differences of two runs; with the filter's covariance held the answer would be another."""
    model = sled()
    model.output("distance", ca.sqrt(model.symbol("q") ** 2 + 0.09), unit="m")
    ekf = go.design_ekf(
        model, [1.5, 0.0], [Measurement("distance", 0.05)],
        sigma0={"q": 0.2, "v": 0.1}, process_noise={"v": 0.05}, dt=DT,
    )  # fmt: skip
    loop = go.ClosedLoop(model, go.output_feedback(regulator(model), ekf))
    experiment = go.Scenario(loop, **MISSION, dispersions={"initial.q": Normal(0.1)})
    q, step = [], 1e-4
    for shift in (step, -step):
        q.append(loop.simulate([0.5 + shift, 0.0], tf=MISSION["tf"]).states[0])
    expected = 0.1 * np.abs(q[0] - q[1]) / (2 * step)
    told = go.linear_covariance(experiment).std("q")[0]
    assert told == pytest.approx(expected, abs=1e-7)
    monkeypatch.setattr(sys.modules[go.LinearCovariance.__module__], "FROZEN_GAINS_MAX_NIS", np.inf)
    held = go.linear_covariance(experiment).std("q")[0]
    assert np.abs(held - expected).max() > 1e-3


def test_a_covariance_that_moves_little_is_held():
    """Late samples: a filter of 14 errors has 105 covariances, and 30 columns are carried."""
    model = sled()
    ekf = go.design_ekf(
        model, [0.5, 0.0], [Measurement("q", 0.05, delay=12 * DT)],
        sigma0={"q": 0.2, "v": 0.1}, process_noise={"v": 0.05}, dt=DT,
    )  # fmt: skip
    sensors = [Noise("odometer", 0.05, on="q"), Delay("late", 12 * DT, on="q")]
    loop = go.ClosedLoop(model, go.output_feedback(regulator(model), ekf), sensors=sensors)
    flight = go.Scenario(loop, **MISSION, dispersions=SPREAD).compiled_loop
    whole, part = (Linearization(flight, loop.wiring, [], hold) for hold in (False, True))
    assert len(part.filter_covariance_indices) == 105
    assert len(part.linearised_state_indices) == len(whole.linearised_state_indices) - 105
    a, b = (
        next(found.linearize_control_steps(found.differentiate_initial_loop_state()[0])).a
        for found in (whole, part)
    )
    kept = np.isin(whole.linearised_state_indices, part.linearised_state_indices)
    assert np.array_equal(a[np.ix_(kept, kept)], b)


def test_without_a_source_nothing_scatters():
    model = sled()
    quiet = go.linear_covariance(go.Scenario(go.ClosedLoop(model, regulator(model)), **MISSION))
    assert quiet.sources == () and np.all(quiet.std("q") == 0)
    assert quiet.variance_budget("q") == {} and "sigma" in str(quiet)


@pytest.mark.parametrize("kind", ["quaternion", "mrp"])
def test_attitudes_scatter_as_turns_whatever_their_parameters(kind):
    """A body that coasts: sigma of each axis grows from the rates, (angle / sqrt 3, t sigma_rate)."""
    body = go.Model("body")
    if kind == "quaternion":
        a = body.state("a", 4)
        body.difference(a, quaternion_difference)
        rate, first = quaternion_rate, [1.0, 0, 0, 0]
    else:
        a = body.state("a", 3)
        body.difference(a, mrp_difference)
        rate, first = mrp_rate, [0.1, -0.2, 0.15]
    omega, T = body.state("omega", 3), body.control("T", 3)
    body.ode({a: rate(a, omega), omega: T})
    rest = go.Reference.constant(body, [*first, 0, 0, 0], [0, 0, 0])
    loop = go.ClosedLoop(body, go.feedforward(rest), dt=0.5)
    spread = {"initial.a": RandomRotation(0.01), "initial.omega": Normal(1e-3)}
    found = go.linear_covariance(go.Scenario(loop, x0=[*first, 0, 0, 0], tf=10.0, dispersions=spread))
    e = found.std("a")
    assert e[:, 0] == pytest.approx(np.full(3, e[0, 0]), rel=1e-6)
    unit = e[0, 0] / (0.01 / np.sqrt(3))  # what a unit of the difference is worth in rad
    assert e[:, -1] / unit == pytest.approx(np.full(3, np.hypot(0.01 / np.sqrt(3), 0.01)), rel=1e-6)


@pytest.mark.parametrize(
    ("dispersion", "nominal"),
    [
        (Normal([0.1, 0.2], mean=[1.0, -1.0]), [3.0, 4.0]),
        (Normal(0.1, relative=True, truncate=1.5), [3.0, -4.0]),
        (Uniform(-0.1, [0.3, 0.5], relative=True), [2.0, -3.0]),
        (Choice([[1.0, 2.0], [3.0, -1.0], [0.0, 0.0]]), [1.0, 1.0]),
        (RandomDirection(Uniform(0.5, 1.0)), [0.0, 0.0, 1.0]),
        (RandomDirection(Normal(0.2)), [0.0, 0.0]),
        (UniformInBall(2.0), [1.0, 2.0, 3.0]),
        (RandomRotation(0.01), [0.6, 0.0, 0.8, 0.0]),
        (RandomRotation(Uniform(0.0, 0.02)), [0.3, -0.1, 0.2]),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Dispersion) else "",
)
def test_moments_are_those_of_what_is_drawn(dispersion, nominal):
    nominal, n = np.array(nominal), 4000
    generator = np.random.default_rng(1)
    drawn = np.array([dispersion.draw(generator, nominal) for _ in range(n)]) - nominal
    mean, covariance = dispersion.moments(nominal)
    sigma = np.sqrt(np.diag(covariance)) + 1e-12
    assert np.all(np.abs(drawn.mean(axis=0) - mean) < 4 * sigma / np.sqrt(n) + 1e-4)
    assert np.cov(drawn.T, bias=True) == pytest.approx(covariance, abs=0.08 * np.max(covariance))


class Odd(Dispersion):
    def draw(self, generator, nominal):
        return nominal


def test_what_cannot_be_linearized_is_refused():
    model = sled()
    law = regulator(model)
    ends = go.ClosedLoop(model, law, events=[Event("gate", model.symbol("q"))])
    with pytest.raises(go.ArgumentError, match=r"has events \('gate'\)"):
        go.linear_covariance(go.Scenario(ends, **MISSION))
    with pytest.raises(go.ArgumentError, match=r"Odd\(\) does not define its mean"):
        go.linear_covariance(go.Scenario(loop_of(), **MISSION, dispersions={"plant.m": Odd()}))
    with pytest.raises(go.ArgumentError, match="give a ClosedLoop"):
        go.Scenario(model, **MISSION)
    with pytest.raises(go.ArgumentError, match="give a Scenario"):
        go.linear_covariance(loop_of())
    with pytest.raises(go.ArgumentError, match="seed of a scenario"):
        go.Scenario(loop_of(), **MISSION, seed=-1)
    with pytest.raises(go.UnknownNameError, match=r"did you mean 'initial\.q'"):
        go.linear_covariance(go.Scenario(loop_of(), **MISSION, dispersions={"initial.Q": Normal(1.0)}))


def test_a_derivative_that_is_not_finite_is_named():
    model, *_ = dynamics("root", "q", "a", lambda q, a: {q: ca.sqrt(q) + a})
    law = go.feedforward(go.Reference.constant(model, [0.0], [0.0]))
    with pytest.raises(go.ArgumentError, match="derivative of 'q' of the closed loop is not finite at 0 s"):
        go.linear_covariance(go.Scenario(go.ClosedLoop(model, law, dt=0.1, substeps=1), x0=[0.0], tf=1.0))


def test_unknown_signals_are_refused(found):
    with pytest.raises(go.UnknownNameError, match=r"command\(F\)"):
        found.std("command(f)")


def test_modes_that_the_nominal_run_does_not_show_have_integration_steps():
    """A quiet run would take one integration step, which makes a light mode a growing one."""
    plant, *_ = dynamics("boom", "q r", "T", lambda q, r, T: {q: r, r: -400 * q - 0.2 * r + T})
    law = go.feedforward(go.Reference.constant(plant, [0, 0], [0]))
    experiment = go.Scenario(
        go.ClosedLoop(plant, law, dt=DT), x0=[0, 0], tf=10.0, dispersions={"initial.q": Normal(0.1)}
    )
    std = go.linear_covariance(experiment).std("q")[0, -1]
    truth = 0.1 * abs(scipy.linalg.expm(np.array([[0, 1], [-400, -0.2]]) * 10.0)[0, 0])
    assert std == pytest.approx(truth, rel=1e-3)
