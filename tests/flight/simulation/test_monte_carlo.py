"""Campaigns: the same bits however they are flown, right statistics, and no run lost."""

import json
import multiprocessing
import os
import zlib
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import cont2discrete
from scipy.stats import chi2
from testing.internals import Dispersion, estimate_pass_rate, estimate_percentile, share_below_maximum
from testing.loops import controller, double_integrator, feedback, scheduled

from gnc_opt.errors import ArgumentError, GncOptError, UnknownNameError
from gnc_opt.model import Layout, Model, Variable
from gnc_opt.plot import plot_dispersion, plot_distributions
from gnc_opt.simulation import (
    Campaign,
    Choice,
    ClosedLoop,
    ConstantDisturbance,
    Lag,
    Noise,
    Normal,
    PiecewiseConstantNoise,
    RandomDirection,
    RandomRotation,
    RunStatus,
    Saturation,
    SensorOutage,
    Uniform,
    monte_carlo,
)
from gnc_opt.workers import worker_pool
from problems.rendezvous import chaser_model

BITS = (
    "parameters", "states", "errors", "effort", "energy", "saturation_time", "variation", "integration_error",
)  # fmt: skip


def loop_of_a_cart(**options):
    cart = double_integrator(3)
    gain = np.hstack([np.eye(3), 1.6 * np.eye(3)])
    return ClosedLoop(
        cart, feedback(cart, gain), [Saturation("limits", -1.0, 1.0), Lag("motor", 0.05)],
        [Noise("radar", 0.01, on="q")],
        [PiecewiseConstantNoise("wind", 0.02, on="a"), ConstantDisturbance("slope", 0.0, on="a")], dt=0.1,
        **options,
    )  # fmt: skip


DISPERSIONS = {
    "initial.q": RandomDirection(0.5),
    "plant.m": Normal(0.05, relative=True, truncate=3),
    "motor.tau": Uniform(-0.3, 0.3, relative=True),
    "slope.level": Choice([0.0, 0.01, -0.01]),
}
CASE = {
    "x0": {"q": [2.0, 1.0, 0.0], "v": 0.0},
    "tf": 8.0,
    "seed": 11,
    "dispersions": DISPERSIONS,
    "target": {"q": 0.0, "v": 0.0},
    "limits": {"q": 0.03, "v": 0.05, "effort(a)": 10.0},
}


def fly(loop=None, n=40, executor="serial", **changes):
    return monte_carlo(loop or loop_of_a_cart(), n, executor=executor, **(CASE | changes))


@pytest.fixture(scope="module")
def serial():
    return fly()


def assert_same(campaign, other):
    assert all(np.array_equal(getattr(campaign, b), getattr(other, b)) for b in BITS)
    assert list(campaign.indices) == list(other.indices)
    assert [str(o) for o in campaign.outcomes] == [str(o) for o in other.outcomes]
    assert str(campaign) == str(other) and campaign.to_json() == other.to_json()


def test_processes_of_its_own(serial):
    assert_same(fly(executor=None), serial)


@pytest.mark.parametrize("kind", [ProcessPoolExecutor, ThreadPoolExecutor])
def test_any_executor(serial, kind):
    with kind(2) as executor:
        assert_same(fly(executor=executor), serial)


@pytest.mark.slow
def test_local_cluster_and_one_without_workers(serial, monkeypatch):
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
        assert_same(fly(executor=client.get_executor()), serial)
        monkeypatch.setattr(worker_pool, "NO_WORKERS_MAX_WAIT_S", 0.3)
        client.retire_workers()
        cluster.scale(0)
        with pytest.raises(GncOptError, match="no workers left"):
            fly(executor=client.get_executor(), seed=12)


@pytest.mark.parametrize("index", [0, 17, 39])
def test_rerun_ends_with_the_same_bits(serial, index):
    run = serial.rerun(index)
    assert np.array_equal(run.states[:, -1], serial.states[:, index])
    assert np.array_equal(run.effort, serial.effort[:, index])
    assert np.array_equal(run.variation, serial.variation[:, index])
    assert np.array_equal(run.parameters, serial.parameters[:, index])
    assert run.integration_error == serial.integration_error[index]


def test_a_simulation_with_the_seed_of_a_run_is_that_run(serial):
    loop = loop_of_a_cart(substeps=serial.compiled_loop.substeps)
    names = serial.layouts["parameter"].names
    changes = {name: serial.parameter(name)[:, 5] for name in names if not name.startswith("initial.")}
    x0 = {name: serial.parameter(f"initial.{name}")[:, 5] for name in ("q", "v")}
    run = loop.simulate(x0, tf=8.0, seed=[11, 5], parameters=changes)
    assert np.array_equal(run.states[:, -1], serial.states[:, 5])


def test_a_turned_attitude_of_the_rendezvous_model():
    chaser = chaser_model()
    loop = ClosedLoop(chaser, scheduled(chaser, lambda t: np.zeros((6, t.size))), dt=0.5)
    sigma = np.array([0.0, np.tan(np.pi / 8), 0.0])
    x0 = {"omega": 0.0, "sigma": sigma, "v_L": 0.0, "r_L": 0.0}
    turn = {"initial.sigma": RandomRotation(np.radians(2))}
    campaign = monte_carlo(
        loop, 20, x0=x0, tf=0.5, dispersions=turn, target={"sigma": sigma}, executor="serial"
    )
    # nothing turns in half a second but the frame: 5.4e-4 rad
    assert campaign.measure("angle(sigma)") == pytest.approx(np.radians(2), abs=1e-3)
    assert campaign.unit("angle(sigma)") == "rad"


def test_covariance_of_a_noisy_linear_loop_is_that_of_lyapunovs_equation():
    plant = Model("oscillator")
    x = plant.state("x", 2)
    u = plant.control("u")
    a, b = np.array([[0.0, 1.0], [-3.0, -0.2]]), np.array([[0.1], [1.0]])
    plant.ode({x: ca.DM(a) @ x + ca.DM(b) * u})
    gain, push, blur, dt, n = np.array([[1.2, 0.8]]), 0.7, 0.3, 0.1, 600
    noise = [Noise("sensor", blur, on="x")]
    loop = ClosedLoop(
        plant,
        feedback(plant, gain),
        sensors=noise,
        disturbances=[PiecewiseConstantNoise("w", push, on="u")],
        dt=dt,
    )
    campaign = monte_carlo(loop, n, x0=[0.0, 0.0], tf=25.0, seed=3, executor="serial")
    ad, bd, *_ = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), dt)
    # the control is -K (x + sensor noise) + push, all held over a step
    driven = bd @ (push**2 * np.eye(1) + blur**2 * gain @ gain.T) @ bd.T
    covariance = solve_discrete_lyapunov(ad - bd @ gain, driven)
    white = np.linalg.solve(np.linalg.cholesky(covariance), campaign.states)
    # n times the mean of squares of standard normal numbers is chi-squared
    for row in white:
        assert chi2.ppf(0.0005, n) < row @ row < chi2.ppf(0.9995, n)
    assert abs(white[0] @ white[1]) / n < 3.5 / np.sqrt(n)
    assert np.all(np.abs(white.mean(axis=1)) < 3.5 / np.sqrt(n))


def test_intervals_cover_the_truth_as_often_as_they_promise():
    generator = np.random.default_rng(4)
    trials, n = 400, 60
    for share in (0.5, 0.9):
        passed, times = np.unique(generator.binomial(n, share, trials), return_counts=True)
        rates = [
            rate for k, m in zip(passed, times, strict=True) for rate in [estimate_pass_rate(int(k), n)] * m
        ]
        covered = np.mean([r.low <= share <= r.high for r in rates])
        assert covered > 0.95 - 3 * np.sqrt(0.05 * 0.95 / trials)
        found = [estimate_percentile(generator.exponential(size=n), share) for _ in range(trials)]
        truth = -np.log(1 - share)
        covered = np.mean([f.low <= truth <= f.high for f in found])
        assert covered > 0.95 - 3 * np.sqrt(0.05 * 0.95 / trials)
        assert covered < 0.995  # not by being needlessly wide


def test_known_intervals():
    # n zero failures: the lower Clopper-Pearson bound is (alpha / 2)^(1/n)
    assert estimate_pass_rate(100, 100).low == pytest.approx(0.025 ** (1 / 100))
    assert estimate_pass_rate(100, 100).high == 1
    assert estimate_pass_rate(0, 50).high == pytest.approx(1 - 0.025 ** (1 / 50))
    # the classical 95 % interval of a median of 20: the 6th and the 15th value
    found = estimate_percentile(np.arange(1.0, 21.0), 0.5)
    assert (found.low, found.value, found.high) == (6, 10, 15)
    # 59 runs: with 95 % confidence their largest value bounds 95 % (Wilks)
    assert share_below_maximum(58) < 0.95 < share_below_maximum(59)
    # a sample of ten says nothing of the upper end of the 99th percentile
    assert estimate_percentile(np.arange(10.0), 0.99).high == np.inf


def test_percentiles_count_failures_as_worst():
    found = estimate_percentile([1.0, np.nan, 3.0, 2.0], 0.75)
    assert found.value == 3 and estimate_percentile([1.0, np.nan], 0.99).value == np.inf


def test_measures_limits_and_pass_rates(serial):
    q, v = np.linalg.norm(serial.state("q"), axis=0), np.linalg.norm(serial.state("v"), axis=0)
    assert serial.measure("q") == pytest.approx(q, rel=1e-15)
    assert np.array_equal(serial.measure("effort(a)"), serial.effort.sum(axis=0))
    assert np.array_equal(serial.passed("q"), q <= 0.03)
    everything = (q <= 0.03) & (v <= 0.05) & (serial.effort.sum(axis=0) <= 10)
    assert np.array_equal(serial.passed(), everything)
    assert 0 < np.sum(everything) < 40  # the limits tell runs apart
    assert serial.pass_rate().passed == np.sum(everything)
    assert serial.maximum("q") == q.max() and serial.worst("q", 3) == list(np.argsort(-q)[:3])
    assert [serial.unit(n) for n in ("q", "effort(a)", "energy(a)", "variation(a)")] == [
        "m",
        "N s",
        "N^2 s",
        "N",
    ]


def test_own_measures():
    campaign = fly(
        measures={"impulse": lambda c: c.measure("effort(a)") / c.parameter("plant.m")[0]},
        limits={"impulse": 5.0},
    )
    expected = campaign.effort.sum(axis=0) / campaign.parameter("plant.m")[0]
    assert np.array_equal(campaign.measure("impulse"), expected)
    assert campaign.pass_rate().passed == np.sum(expected <= 5)
    with pytest.raises(ArgumentError, match="one number per run"):
        fly(n=3, measures={"one": lambda c: 1.0})


def explosive():
    """dx/dt = k x^3: not finite after 1 / (2 k x0^2) seconds; its law gives an alarm above x = 1.5."""
    plant = Model("explosive")
    x = plant.state("x")
    u, k = plant.control("u"), plant.parameter("k", 0.1)
    plant.ode({x: k * x**3 + u})
    law = controller(
        plant,
        lambda t, x, r, z: (0 * x, ca.if_else(x > 1.5, 1.0, z)),
        memory=Layout("memory", (Variable("large"),)),
        alarms=("large",),
    )
    return ClosedLoop(plant, law, [Lag("lag", 0.1)], dt=0.05, substeps=4, accuracy=1e-4)


def test_failed_runs_are_kept_and_count_as_not_passed():
    choice = {"plant.k": Choice([0.1, 0.6, 5.0]), "lag.tau": Choice([0.1, 0.1, 0.1, -1.0])}
    campaign = monte_carlo(
        explosive(),
        60,
        x0=[0.9],
        tf=1.0,
        dispersions=choice,
        target={"x": 0.0},
        limits={"x": 3.0},
        executor="serial",
    )
    assert len(campaign) == 60 and list(campaign.indices) == list(range(60))
    for i, outcome in enumerate(campaign.outcomes):
        k, tau = campaign.parameter("plant.k")[0, i], campaign.parameter("lag.tau")[0, i]
        # x = x0 / sqrt(1 - 2 k x0^2 t): 0.98, 5.4, and infinite before the end
        expected = {0.1: RunStatus.OK, 0.6: RunStatus.CONTROLLER_ALARM, 5.0: RunStatus.NOT_FINITE}[k]
        assert outcome.status is (RunStatus.INVALID_PARAMETERS if tau < 0 else expected)
    assert set(campaign.status_counts) == {
        RunStatus.OK,
        RunStatus.CONTROLLER_ALARM,
        RunStatus.NOT_FINITE,
        RunStatus.INVALID_PARAMETERS,
    }
    assert sum(campaign.status_counts.values()) == 60
    assert campaign.pass_rate().passed == campaign.status_counts[RunStatus.OK]
    assert campaign.pass_rate().runs == 60
    assert campaign.percentile("x", 0.99).value == np.inf == campaign.maximum("x")
    text = str(campaign)
    assert "failed" in text and "'lag.tau" in text and "is outside" in text and "large" in text
    assert len(json.loads(campaign.to_json())["failures"]) == 60 - campaign.status_counts[RunStatus.OK]
    blown = next(i for i, o in campaign.failures.items() if o.status is RunStatus.NOT_FINITE)
    assert campaign.rerun(blown).outcome == campaign.outcomes[blown]
    refused = next(i for i, o in campaign.failures.items() if o.status is RunStatus.INVALID_PARAMETERS)
    with pytest.raises(ArgumentError, match="lag"):
        campaign.rerun(refused)


def test_a_lost_measurement_is_flagged_in_the_runs_that_lose_it():
    cart = double_integrator()
    loop = ClosedLoop(
        cart, feedback(cart, [[1.0, 1.6]]), sensors=[SensorOutage("radar", 50.0, on="q")], dt=0.1
    )
    losing = {"radar.begin": Choice([3.0, 50.0])}
    campaign = monte_carlo(loop, 20, x0=[1.0, 0.0], tf=5.0, dispersions=losing, executor="serial")
    lost = campaign.parameter("radar.begin")[0] == 3.0
    assert np.array_equal(lost, ~campaign.ok) and 0 < lost.sum() < 20
    assert all(o.what == "measured 'q'" and o.time == pytest.approx(3.0) for o in campaign.failures.values())


@dataclass(frozen=True)
class Deadly(Dispersion):
    """Kills a process other than the main one in a share of the runs."""

    share: float

    def draw(self, generator, nominal):
        if generator.random() < self.share and multiprocessing.parent_process() is not None:
            os._exit(1)
        return nominal


def test_runs_that_kill_their_process_are_counted_and_the_others_flown(serial):
    campaign = fly(n=32, executor=None, dispersions=DISPERSIONS | {"wind.sigma": Deadly(0.04)})
    clean = fly(n=32)
    assert len(campaign) == 32
    lost = [i for i, o in campaign.failures.items() if "process died" in o.what]
    generators = [
        np.random.Philox(np.random.SeedSequence([11, i], spawn_key=(zlib.crc32(b"wind.sigma"),)))
        for i in range(32)
    ]
    drawn = np.array([np.random.Generator(g).random() for g in generators])
    assert lost == list(np.flatnonzero(drawn < 0.04)) and 0 < len(lost) < 8
    alive = campaign.ok
    assert np.array_equal(campaign.states[:, alive], clean.states[:, alive])
    assert np.array_equal(campaign.parameters, clean.parameters)


def test_a_campaign_without_a_single_run_is_an_error():
    with pytest.raises(GncOptError, match="no run could be simulated"):
        fly(n=4, executor=None, dispersions={"wind.sigma": Deadly(1.1)})


@dataclass(frozen=True)
class Raising(Dispersion):
    """Cannot draw a share of the runs."""

    share: float

    def draw(self, generator, nominal):
        if generator.random() < self.share:
            raise ValueError("out of luck")
        return nominal


@pytest.mark.parametrize("executor", ["serial", None])
def test_runs_that_raise_are_set_apart(serial, executor):
    campaign = fly(n=100, executor=executor, dispersions=DISPERSIONS | {"wind.sigma": Raising(0.2)})
    assert len(campaign) == 100 and 8 < len(campaign.failures) < 36
    assert {o.what for o in campaign.failures.values()} == {"ValueError: out of luck"}
    alive = campaign.ok[:40]
    assert np.array_equal(campaign.states[:, :40][:, alive], serial.states[:, alive])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dispersions": {"plant.mm": Normal(1.0)}}, "did you mean 'plant.m'"),
        ({"limits": {"qq": 1.0}}, "no measure 'qq'"),
        ({"limits": {"effort(b)": 1.0}}, "no measure"),
        ({"limits": {"q": np.nan}}, "limit of 'q'"),
        ({"target": None}, "has no reference for 'q'"),
        ({"target": {"r": 1.0}}, "no state 'r'"),
        ({"limits": {"angle(plant)": 1.0}}, "no measure"),
        ({"limits": {"effrt(a)": 1.0}}, r"did you mean 'effort\(a\)'"),
        ({"limits": {"saturaton(a)": 1.0}}, r"did you mean 'saturation\(a\)'"),
        ({"seed": -1}, "seed"),
        ({"executor": "threads"}, "executor of monte_carlo"),
        ({"n": 0}, "number of runs"),
    ],
)
def test_what_does_not_fit_is_refused(changes, message):
    with pytest.raises((ArgumentError, UnknownNameError), match=message):
        fly(**changes)


def test_dispersions_that_cannot_travel_are_refused():
    @dataclass(frozen=True)
    class Local(Dispersion):
        def draw(self, generator, nominal):
            return nominal

    with pytest.raises(GncOptError, match="cannot be sent"):
        fly(executor=None, dispersions={"plant.m": Local()})


def test_figures_show_runs_limits_and_units(serial):
    figure = plot_dispersion(serial, "q")
    left, right = figure.axes
    assert sum(line.get_xdata().size for line in left.get_lines()) == 40
    assert (left.patches[0].center, left.patches[0].get_radius()) == ((0, 0), 0.03)
    assert left.get_xlim() == left.get_ylim() and "(m)" in right.get_ylabel()
    figure = plot_distributions(serial)
    assert len(figure.axes) == 3 and "(N s)" in figure.axes[2].get_xlabel()
    steps = figure.axes[0].get_lines()[0]
    assert steps.get_xdata()[-1] == serial.maximum("q") and steps.get_ydata()[-1] == 1
    # Forty runs do not bound the 95 and 99 % percentiles from above: their intervals end with an arrow.
    unbounded = [level for level in (0.5, 0.9, 0.95, 0.99) if serial.percentile("q", level).high == np.inf]
    arrows = [line for line in figure.axes[0].get_lines() if line.get_marker() == ">"]
    assert unbounded and [float(line.get_ydata()[0]) for line in arrows] == unbounded
    with pytest.raises(ArgumentError, match="one component"):
        plot_dispersion(one_component(), "q")


def one_component():
    cart = double_integrator()
    loop = ClosedLoop(cart, feedback(cart, [[1.0, 1.6]]), dt=0.1)
    return monte_carlo(loop, 2, x0=[1.0, 0.0], tf=0.5, target={"q": 0.0}, executor="serial")


def test_files_keep_every_bit(serial, tmp_path):
    path = serial.save(tmp_path / "campaign")
    loaded = Campaign.load(path, compiled_loop=loop_of_a_cart().compile(CASE["x0"], tf=CASE["tf"]))
    assert_same(loaded, serial)
    assert np.array_equal(loaded.rerun(3).states[:, -1], serial.states[:, 3])
    with pytest.raises(GncOptError, match="has no compiled loop"):
        Campaign.load(path).rerun(3)
    (tmp_path / "other.npz").write_bytes(b"nothing")
    with pytest.raises(GncOptError, match="not a campaign"):
        Campaign.load(tmp_path / "other.npz")
