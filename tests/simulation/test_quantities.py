"""Quantities along the way: extremes, integrals and envelopes against whole histories, events, files, refusals."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import scipy
from loops import double_integrator, feedback

import gnc_opt as go
from gnc_opt.analysis import worst_case
from gnc_opt.plot import plot_envelope
from gnc_opt.simulation import Campaign, Event, Lag, Noise, Normal, Quantity, RunStatus, Uniform
from gnc_opt.simulation.envelope import envelope
from gnc_opt.simulation.quantity import SAMPLES, sample_steps

MISSION = {"x0": [1.0, 0.0], "tf": 30.0}
SPREAD = {"initial.q": Normal(0.2), "plant.m": Uniform(-0.1, 0.1)}


def loop_of(**more) -> go.ClosedLoop:
    cart = double_integrator()
    q, v, m = (cart.symbol(name) for name in ("q", "v", "m"))
    t = cart.time
    quantities = [
        Quantity("kinetic energy", 0.5 * m * v**2, "J"),
        Quantity("intrusion", 0.3 - ca.sqrt((q - 1.5) ** 2 + 0.01), "m"),
        Quantity("clock", t, "s"),
    ]
    return go.ClosedLoop(
        cart, feedback(cart, [[0.5, 0.4]]), sensors=[Noise("rangefinder", 0.02, on="q")],
        quantities=quantities, dt=0.1, **more,
    )  # fmt: skip


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return go.monte_carlo(loop_of(), 60, **MISSION, seed=3, dispersions=SPREAD, executor="serial")


def energy(campaign, run):
    return 0.5 * run.parameter("plant.m")[0] * run.states[1] ** 2


def test_they_are_those_of_the_whole_histories(campaign):
    for i in (0, 17, 59):
        run = campaign.rerun(i)
        y = energy(campaign, run)
        assert campaign.measure("max(kinetic energy)")[i] == pytest.approx(y.max(), rel=1e-12)
        assert campaign.measure("min(kinetic energy)")[i] == pytest.approx(y.min(), rel=1e-12)
        whole = scipy.integrate.trapezoid(y, run.times)
        assert campaign.measure("integral(kinetic energy)")[i] == pytest.approx(whole, rel=1e-12)
        nearest = np.sqrt((run.states[0] - 1.5) ** 2 + 0.01).min()
        assert campaign.measure("max(intrusion)")[i] == pytest.approx(0.3 - nearest)
        assert campaign.samples[0, :, i] == pytest.approx(y[sample_steps(300)])
    assert campaign.measure("max(clock)") == pytest.approx(30.0)
    assert campaign.measure("integral(clock)") == pytest.approx(450.0)
    assert campaign.unit("max(kinetic energy)") == "J" and campaign.unit("integral(kinetic energy)") == "J s"


def test_what_is_kept_does_not_grow_with_the_run(campaign):
    assert campaign.samples.shape == (3, SAMPLES, 60)
    assert campaign.sample_times[[0, -1]] == pytest.approx([0.0, 30.0])
    assert sample_steps(7).tolist() == list(range(8)) and sample_steps(864_000).size == SAMPLES


def test_quantities_change_no_bit_of_a_run(campaign):
    plain = go.monte_carlo(
        replace(loop_of(), quantities=()), 60, **MISSION, seed=3, dispersions=SPREAD, executor="serial"
    )
    assert np.array_equal(plain.states, campaign.states) and plain.sums.shape == (0, 0)


def test_limits_and_searches_know_them():
    runs = go.monte_carlo(
        loop_of(),
        40,
        **MISSION,
        seed=1,
        dispersions=SPREAD,
        limits={"max(intrusion)": 0.0},
        executor="serial",
    )
    assert np.array_equal(runs.passed(), runs.measure("max(intrusion)") <= 0)
    assert 0 < runs.pass_rate().passed < 40
    found = worst_case(
        go.Experiment(loop_of(), **MISSION, dispersions={"initial.q": Uniform(-0.5, 0.5)}),
        "max(kinetic energy)",
        generations=3,
    )
    assert found.parameters["initial.q"][0] == pytest.approx(1.5)


def test_an_envelope_is_made_of_order_statistics(campaign):
    found = campaign.envelope("kinetic energy", levels=(0.1, 0.5), confidence=0.9)
    k = 40
    ordered = np.sort(campaign.samples[0, k])
    assert found.values[:, k] == pytest.approx(ordered[[5, 29]])
    low, high = scipy.stats.binom.ppf([0.05, 0.95], 60, 0.5).astype(int)
    assert (found.low[1, k], found.high[1, k]) == (ordered[low - 1], ordered[high])
    assert np.all(found.runs == 60) and found.unit == "J"
    (ax,) = plot_envelope(campaign, "kinetic energy").axes
    assert [line.get_label() for line in ax.lines] == ["1 %", "50 %", "99 %"]
    assert ax.lines[1].get_ydata() == pytest.approx(campaign.envelope("kinetic energy").values[1])


def test_the_true_percentile_is_within_the_band_as_often_as_it_says():
    generator, inside = np.random.default_rng(5), []
    for _ in range(200):
        found = envelope("y", "", np.arange(1.0), generator.standard_normal((1, 25)), (0.5, 0.9), 0.8)
        truth = scipy.stats.norm.ppf([0.5, 0.9])
        inside.append((found.low[:, 0] <= truth) & (truth <= found.high[:, 0]))
    assert np.all(np.mean(inside, axis=0) > 0.8 - 3 * np.sqrt(0.16 / 200))
    assert np.mean(inside) < 0.97


def test_a_run_that_an_event_ends_is_followed_until_then():
    cart = double_integrator()
    q, v, t = cart.symbol("q"), cart.symbol("v"), cart.time
    loop = go.ClosedLoop(
        cart, feedback(cart, [[0.0, 0.0]]), events=[Event("wall", q - 2.05, "rising")],
        quantities=[Quantity("v", v), Quantity("t", t), Quantity("q", q)], dt=0.1,
    )  # fmt: skip
    runs = go.monte_carlo(loop, 2, x0=[0.0, 1.0], tf=5.0, executor="serial")
    assert runs.measure("max(t)") == pytest.approx(2.05) and runs.measure("max(q)") == pytest.approx(2.05)
    assert runs.measure("integral(v)") == pytest.approx(2.05)  # the way
    assert np.isnan(runs.samples[:, runs.sample_times > 2.05]).all()
    assert np.isfinite(runs.samples[:, runs.sample_times < 2.05]).all()
    assert runs.envelope("q").runs[-1] == 0


def test_an_envelope_is_of_those_that_still_fly():
    """Runs that had landed since the sample before were in it, at the height of their landing."""
    ball = go.Model("ball")
    h, w, T = ball.state("h", unit="m"), ball.state("w", unit="m/s"), ball.control("T")
    ball.ode({h: w, w: T - 9.81})
    law = go.feedforward(go.Reference.constant(ball, [0.0, 0.0], [0.0]))
    events, quantities = [Event("ground", h, "falling")], [Quantity("height", h, "m")]
    loop = go.ClosedLoop(ball, law, events=events, quantities=quantities, dt=0.05)
    spread = {"initial.h": Normal(2.0)}
    fallen = go.monte_carlo(loop, 100, x0=[10.0, 0.0], tf=1.8, dispersions=spread, executor="serial")
    told = fallen.envelope("height", levels=(0.5,))
    heights = fallen.parameter("initial.h")[0] - 9.81 * told.times[:, None] ** 2 / 2
    assert told.runs.tolist() == np.sum(heights > 0, axis=1).tolist() and 0 < told.runs[-3] < 50
    median = [np.sort(row[row > 0])[(np.sum(row > 0) - 1) // 2] for row in heights if np.any(row > 0)]
    assert told.values[0, : len(median)] == pytest.approx(median, abs=1e-9)


@pytest.mark.parametrize("wall", [None, 0.3])
def test_fuel_and_plume_follow_what_the_actuators_apply(wall):
    # Thrust within 0.5 m of the origin blows at what stands there; steps of 0.1 s, lag, noise, an event.
    cart = double_integrator()
    q, a = cart.symbol("q"), cart.symbol("a")
    loop = go.ClosedLoop(
        cart, feedback(cart, [[0.5, 0.4]]), sensors=[Noise("rangefinder", 0.02, on="q")],
        actuators=[Lag("valve", 0.3)],
        events=[] if wall is None else [Event("wall", q - wall, "falling")],
        quantities=[
            Quantity("fuel", ca.fabs(a), "m/s^2"), Quantity("plume", ca.fmax(-a, 0) * (ca.fabs(q) < 0.5), "m/s^2"),
        ],
        dt=0.1,
    )  # fmt: skip
    runs = go.monte_carlo(loop, 5, **MISSION, seed=3, dispersions=SPREAD, executor="serial")
    for i in range(5):
        run = runs.rerun(i)
        assert (run.times[-1] == 30.0) == (wall is None)
        spent = np.abs(run.applied[0]) @ np.diff(run.times)
        assert runs.measure("integral(fuel)")[i] == pytest.approx(spent, rel=1e-12)
        near = (np.abs(run.states[0]) < 0.5).astype(float)
        blown = np.maximum(-run.applied[0], 0.0)
        assert runs.measure("max(plume)")[i] == pytest.approx(np.max(blown * np.maximum(near[:-1], near[1:])))
        mean = 0.5 * (near[:-1] + near[1:]) * np.diff(run.times)
        assert runs.measure("integral(plume)")[i] == pytest.approx(blown @ mean, rel=1e-12)
    assert np.ptp(runs.measure("max(plume)")) > 0


@pytest.mark.parametrize("leg", [1000, 4])
def test_one_that_is_not_a_number_is_told(leg, monkeypatch):
    """sqrt(q) of what falls from 1 to -1 at 1 unit/s is none from 1.1 s on; runs that end before are ok."""
    monkeypatch.setattr("gnc_opt.simulation.flight.LEG", leg)
    plant = go.Model("even motion")
    q, u = plant.state("q"), plant.control("u")
    plant.ode({q: u})
    law = go.feedforward(go.Reference.constant(plant, [0.0], [-1.0]))
    known, root = Quantity("known", q**2), Quantity("root", ca.sqrt(q + 1e-6))
    loop = go.ClosedLoop(plant, law, quantities=[known, root], dt=0.1)
    blind, fine = (go.monte_carlo(loop, 2, x0=[start], tf=1.9, executor="serial") for start in (1.0, 2.0))
    run = loop.simulate([1.0], tf=2.0)
    assert blind.outcomes == (run.outcome,) * 2 and not blind.pass_rate().rate
    assert (run.outcome.status, run.outcome.what) == (RunStatus.NOT_FINITE, "quantity 'root'")
    assert run.outcome.time == pytest.approx(1.0)
    assert all(outcome.ok for outcome in fine.outcomes)


def test_files_and_checkpoints_keep_them(campaign, tmp_path):
    again = Campaign.load(campaign.save(tmp_path / "campaign.npz"))
    assert np.array_equal(again.samples, campaign.samples) and np.array_equal(again.sums, campaign.sums)
    assert again.measure("max(intrusion)") == pytest.approx(campaign.measure("max(intrusion)"))
    arguments = {**MISSION, "seed": 3, "dispersions": SPREAD, "executor": "serial"}
    go.monte_carlo(loop_of(), 20, **arguments, checkpoint=tmp_path / "runs")
    resumed = go.monte_carlo(loop_of(), 60, **arguments, checkpoint=tmp_path / "runs")
    assert np.array_equal(resumed.sums, campaign.sums) and np.array_equal(resumed.samples, campaign.samples)


def test_many_processes_give_the_same(campaign):
    runs = go.monte_carlo(loop_of(), 60, **MISSION, seed=3, dispersions=SPREAD)
    assert np.array_equal(runs.sums, campaign.sums)


def test_mistakes_are_refused(campaign):
    cart = double_integrator()
    law, q = feedback(cart, [[1.0, 1.0]]), cart.symbol("q")
    with pytest.raises(go.ArgumentError, match="two quantities of the closed loop are called 'a'"):
        go.ClosedLoop(cart, law, quantities=[Quantity("a", q), Quantity("a", -q)], dt=0.1)
    foreign = double_integrator().symbol("a")
    with pytest.raises(
        go.ArgumentError, match="quantity 'force' uses 'a', which is no state, control or param"
    ):
        go.ClosedLoop(cart, law, quantities=[Quantity("force", foreign)], dt=0.1)
    with pytest.raises(go.ArgumentError, match="event 'full' uses 'a', which is no state or parameter"):
        go.ClosedLoop(cart, law, events=[Event("full", cart.symbol("a") - 1.0, "rising")], dt=0.1)
    with pytest.raises(go.ArgumentError, match="write Quantity"):
        go.ClosedLoop(cart, law, quantities=[q], dt=0.1)
    with pytest.raises(go.UnknownNameError, match=r"max\(intrusion\)"):
        campaign.measure("max(intrusio)")
    with pytest.raises(go.UnknownNameError):
        campaign.envelope("q")
