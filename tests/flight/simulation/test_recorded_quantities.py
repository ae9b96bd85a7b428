"""Quantities along the way: extremes, integrals and envelopes against whole histories, events, files, refusals."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.internals import MAX_SAMPLES, compute_percentile_envelope, select_quantity_sample_steps
from testing.loops import double_integrator, feedback
from testing.models import dynamics

import gnc_opt as go
from gnc_opt.plot import plot_envelope
from gnc_opt.simulation import (
    Campaign,
    Delay,
    Event,
    Lag,
    Noise,
    Normal,
    Quantity,
    RateLimit,
    RunStatus,
    Uniform,
)

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
        cart,
        feedback(cart, [[0.5, 0.4]]),
        sensors=[Noise("rangefinder", 0.02, on="q")],
        quantities=quantities,
        dt=0.1,
        **more,
    )


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return go.monte_carlo(loop_of(), 60, **MISSION, seed=3, dispersions=SPREAD, executor="serial")


def test_they_are_those_of_the_motion(campaign):
    """Under a held force the speed is linear and the place a parabola in each control step."""
    for i in (0, 17, 59):
        run = campaign.rerun(i)
        m, (q, v) = run.parameter("plant.m")[0], run.states
        a = run.applied[0] / m
        energy = 0.5 * m * v**2
        assert campaign.measure("max(kinetic energy)")[i] == pytest.approx(energy.max(), rel=1e-12)
        assert np.any(v[1:] * v[:-1] < 0)  # and at rest between
        assert campaign.measure("min(kinetic energy)")[i] == pytest.approx(0.0, abs=1e-9)
        whole = m / 6 * 0.1 * np.sum(v[1:] ** 2 + v[1:] * v[:-1] + v[:-1] ** 2)
        assert campaign.measure("integral(kinetic energy)")[i] == pytest.approx(whole, rel=1e-12)
        with np.errstate(all="ignore"):
            s = np.clip(np.nan_to_num(np.append(0.1 + 0 * v[:-1], -v[:-1] / a)), 0.0, 0.1)
        most = np.max(np.tile(q[:-1], 2) + s * (np.tile(v[:-1], 2) + 0.5 * s * np.tile(a, 2)))
        nearest = np.sqrt(max(1.5 - max(q[0], most), 0.0) ** 2 + 0.01)
        assert campaign.measure("max(intrusion)")[i] == pytest.approx(0.3 - nearest, abs=2e-9)
        assert campaign.samples[0, :, i] == pytest.approx(energy[select_quantity_sample_steps(300)])
    assert campaign.measure("max(clock)") == pytest.approx(30.0)
    assert campaign.measure("integral(clock)") == pytest.approx(450.0)
    assert campaign.unit("max(kinetic energy)") == "J" and campaign.unit("integral(kinetic energy)") == "J s"


def coasting(speed: float, **more) -> go.ClosedLoop:
    """Return what flies past the origin in control steps of 1 s, nothing acting on it."""
    probe = go.Model("probe")
    r, v, a = probe.state("r", 2, unit="m"), probe.state("v", 2, unit="m/s"), probe.control("a", 2)
    probe.ode({r: v, v: a})
    law = go.feedforward(go.Reference.constant(probe, np.zeros(4), np.zeros(2)))
    d = ca.norm_2(r)
    quantities = [
        Quantity("distance", d, "m"), Quantity("excess", ca.fmax(0, 1 - d), "m"),
        Quantity("inside", (d < 1) * (2 * speed + r[0])),
    ]  # fmt: skip
    return go.ClosedLoop(probe, law, quantities=quantities, dt=1.0, **more)


def test_what_passes_between_two_control_steps_is_seen_as_closely_as_minor_steps_look():
    """A straight line at 0.01 m from the origin; four nodes in each of twenty minor steps are 0.0375 m apart."""
    apart = 3.0 / 80
    start = -10.41
    loop = coasting(3.0, minor_steps=20)
    runs = go.monte_carlo(loop, 1, x0=[start, 0.01, 3.0, 0.0], tf=7.0, executor="serial")
    found = {name: runs.measure(name)[0] for name in runs.measures if "(" in name}
    assert 0.01 <= found["min(distance)"] <= np.hypot(0.01, apart / 2) + 1e-12
    assert found["max(distance)"] == pytest.approx(np.hypot(start + 21.0, 0.01))
    assert 0.99 >= found["max(excess)"] >= 1 - np.hypot(0.01, apart / 2) - 1e-12
    assert found["max(inside)"] == pytest.approx(6.0 + np.sqrt(1 - 1e-4), abs=apart)
    assert found["integral(distance)"] == pytest.approx(
        0.5 * (start**2 + (start + 21.0) ** 2) / 3.0, rel=1e-4
    )


@pytest.mark.parametrize("span", [None, 0.05])
def test_peaks_of_a_swing_and_a_fall_have_closed_forms(span):
    """A spring of 4 rad/s in control steps of 0.1 s, and a throw; behind a lag, whose output is followed, too."""
    swing = go.Model("swing")
    q, v, h, w = (swing.state(name) for name in "qvhw")
    u = swing.control("u")
    swing.ode({q: v, v: -16.0 * q, h: w, w: u})
    law = go.feedforward(go.Reference.constant(swing, np.zeros(4), [-9.81]))
    named = {"q": q, "v": v, "h": h, "u": u, "power": u * w}
    quantities = [Quantity(name, y) for name, y in named.items()]
    lag = [] if span is None else [Lag("valve", span)]
    loop = go.ClosedLoop(swing, law, actuators=lag, quantities=quantities, dt=0.1)
    runs = go.monte_carlo(loop, 1, x0=[0.003, -1.0, 2.0, 7.3], tf=1.3, executor="serial")
    size = np.hypot(0.003, 1 / 4)
    assert runs.measure("max(q)") == pytest.approx(size, abs=2e-9)
    assert runs.measure("min(v)") == pytest.approx(-4 * size, abs=1e-8)
    if span is None:
        assert runs.measure("max(h)") == pytest.approx(2.0 + 7.3**2 / 2 / 9.81, abs=2e-9)
        assert runs.measure("max(u)") == pytest.approx(-9.81) and runs.measure("min(u)") == pytest.approx(
            -9.81
        )
        return
    run = runs.rerun(0)
    begun = -9.81 + (run.applied[0, 0] + 9.81) * 0.1 / (0.05 * (1 - np.exp(-2.0)))

    def way(s):
        gone, force = 0.05 * (1 - np.exp(-s / 0.05)), -9.81 + (begun + 9.81) * np.exp(-s / 0.05)
        speed = 7.3 - 9.81 * s + (begun + 9.81) * gone
        height = 2.0 + 7.3 * s - 9.81 * s**2 / 2 + (begun + 9.81) * 0.05 * (s - gone)
        return height, force * speed, force

    s = np.linspace(0, 1.3, 260_001)
    height, power, force = way(s)
    assert runs.measure("max(h)") == pytest.approx(height.max(), abs=1e-8)
    assert runs.measure("min(power)") == pytest.approx(power.min(), rel=1e-6)
    assert runs.measure("max(u)") == pytest.approx(force.max(), abs=1e-9)
    assert runs.measure("min(u)") == pytest.approx(force.min(), abs=1e-9)
    assert runs.measure("integral(u)") == pytest.approx(-9.81 * 1.3 + (begun + 9.81) * 0.05, abs=1e-6)


def test_what_is_kept_does_not_grow_with_the_run(campaign):
    assert campaign.samples.shape == (3, MAX_SAMPLES, 60)
    assert campaign.sample_times[[0, -1]] == pytest.approx([0.0, 30.0])
    assert select_quantity_sample_steps(7).tolist() == list(range(8))
    assert select_quantity_sample_steps(864_000).size == MAX_SAMPLES


def test_quantities_change_no_bit_of_a_run(campaign):
    plain = go.monte_carlo(
        replace(loop_of(), quantities=()), 60, **MISSION, seed=3, dispersions=SPREAD, executor="serial"
    )
    assert np.array_equal(plain.states, campaign.states) and plain.sums.shape == (0, 0)


def test_limits_know_them():
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
    limited = replace(campaign, limits={"max(kinetic energy)": 0.7})
    (ax,) = plot_envelope(limited, "kinetic energy").axes
    assert (ax.lines[3].get_label(), *ax.lines[3].get_ydata()) == ("limit", 0.7, 0.7)
    assert ax.get_xlim() == (campaign.sample_times[0], campaign.sample_times[-1])


def test_the_true_percentile_is_within_the_band_as_often_as_it_says():
    generator, inside = np.random.default_rng(5), []
    for _ in range(200):
        found = compute_percentile_envelope(
            "y", "", np.arange(1.0), generator.standard_normal((1, 25)), (0.5, 0.9), 0.8
        )
        truth = scipy.stats.norm.ppf([0.5, 0.9])
        inside.append((found.low[:, 0] <= truth) & (truth <= found.high[:, 0]))
    assert np.all(np.mean(inside, axis=0) > 0.8 - 3 * np.sqrt(0.16 / 200))
    assert np.mean(inside) < 0.97


def test_a_run_that_an_event_ends_is_followed_until_then():
    cart = double_integrator()
    q, v, t = cart.symbol("q"), cart.symbol("v"), cart.time
    loop = go.ClosedLoop(
        cart,
        feedback(cart, [[0.0, 0.0]]),
        events=[Event("wall", q - 2.05, "rising")],
        quantities=[Quantity("v", v), Quantity("t", t), Quantity("q", q)],
        dt=0.1,
    )
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


@pytest.mark.parametrize(
    ("actuators", "parts", "bounce"),
    [
        ([Lag("valve", 0.07)], 2, False),
        ([Delay("line", 0.05), RateLimit("servo", 3.0), Lag("valve", 0.2)], 3, True),
    ],
)
def test_balances_hold_behind_all_actuators_and_through_events(actuators, parts, bounce):
    """Force over time is momentum, speed over time the way, power over time energy, but for what bounces take."""
    cart = double_integrator()
    q, v, a = (cart.symbol(name) for name in "qva")
    named = {"force": a, "speed": v, "power": a * v, "place": q}
    loop = go.ClosedLoop(
        cart,
        feedback(cart, [[0.9, 0.8]]),
        actuators=actuators,
        minor_steps=parts,
        dt=0.3,
        events=[Event("wall", q + 0.02, "falling", reset={v: -0.6 * v})] if bounce else [],
        quantities=[Quantity(name, y) for name, y in named.items()],
    )
    runs = go.monte_carlo(loop, 1, x0=[0.5, 0.4], tf=6.0, executor="serial")
    run, found = runs.rerun(0), {name: runs.measure(f"integral({name})")[0] for name in named}
    assert run.outcome.ok and bool(run.events) == bounce
    taken = sum((e.after - e.before for e in run.events), np.zeros(2))
    lost = sum((e.after[1] ** 2 - e.before[1] ** 2 for e in run.events), 0.0) / 2
    (q0, v0), (q1, v1) = run.states[:, 0], run.states[:, -1]
    assert found["force"] == pytest.approx(v1 - v0 - taken[1], abs=1e-6)
    assert found["speed"] == pytest.approx(q1 - q0, abs=1e-8)
    assert found["power"] == pytest.approx((v1**2 - v0**2) / 2 - lost, abs=5e-5)
    assert runs.measure("max(place)")[0] >= run.states[0].max()


@pytest.mark.parametrize("leg", [1000, 4])
def test_one_that_is_not_a_number_is_reported(leg, monkeypatch):
    """sqrt(q) of what falls from 1 to -1 at 1 unit/s is none from 1.1 s on; runs that end before are ok."""
    monkeypatch.setattr("gnc_opt.simulation.compiled_closed_loop.MAX_STEPS_PER_CALL", leg)
    plant, q, _u = dynamics("even motion", "q", "u", lambda q, u: {q: u})
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
