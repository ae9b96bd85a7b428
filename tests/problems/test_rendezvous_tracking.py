"""The rendezvous followed: pass rates, repeatability, price of the reserve."""

import json

import numpy as np
import pytest
from flexible import cross
from scipy.integrate import solve_ivp

import gnc_opt as go
from benchmarks.performance.closed_loop import plain_inputs, plain_run
from gnc_opt.analysis import consistency
from gnc_opt.array_types import Array
from gnc_opt.simulation import Run
from gnc_opt.spacecraft import MU_EARTH, RADIUS_EARTH
from problems.rendezvous import ALTITUDE, MAX_FORCE, MAX_TORQUE
from problems.rendezvous.model import MASS
from problems.rendezvous_tracking import (
    DT,
    FORCE_STEP,
    LIMITS,
    RESERVE,
    SETTLING,
    TORQUE_STEP,
    Tracking,
    plan,
)
from problems.rendezvous_tracking.__main__ import main
from problems.rendezvous_tracking.guidance import KEEP_OUT, Filtered, Guided, Measured, settled
from problems.rendezvous_tracking.replanning import PLANNED, Replanned, resolver

RUNS, SEED = {"TVLQR": 20, "integral sliding mode": 4}, 1


@pytest.fixture(scope="module")
def tracking() -> Tracking:
    return Tracking(plan())


@pytest.fixture(scope="module")
def guided():
    return Guided(plan(reserve=1.0))


@pytest.fixture(scope="module")
def corrected(guided):
    return guided.simulate_campaign("neighbouring-optimal", 1, SEED, executor="serial")


@pytest.mark.slow
def test_guidance_arrives_earlier_than_a_plan_with_reserve(guided, corrected, tracking):
    """Between the least time there is and that of the reserve, and at the target, not only by its own last plan."""
    campaign, least = corrected, guided.solution.objective
    arrivals = guided.arrivals(campaign)
    assert campaign.pass_rate().rate == 1.0 and not campaign.failures
    assert np.mean(arrivals) == pytest.approx(26.43, abs=0.05)
    assert np.min(arrivals) > least + 0.1 and np.max(arrivals) < 26.8 < tracking.reference.final_time - 1.0
    run, target = campaign.rerun(0), guided.reference.x(guided.reference.final_time)
    error = run.states - target[:, None]
    last = np.searchsorted(run.times, settled(run, target))
    inside = np.linalg.norm(error[9:12], axis=0) < LIMITS["r_L"]
    assert np.all(inside[last:]) and arrivals[0] - 2.0 < run.times[last] < arrivals[0] + 2.5


@pytest.fixture(scope="module")
def measured(guided):
    """With the guidance that `guided` has designed."""
    found = Measured(guided.solution)
    vars(found)["guidance"] = guided.guidance
    return found


@pytest.fixture(scope="module")
def filtered(measured):
    return measured.simulate_campaign("filtered", 1, SEED, executor="serial")


@pytest.fixture(scope="module")
def measured_runs(filtered):
    return [filtered.rerun(i) for i in range(1)]


@pytest.mark.slow
def test_a_filter_guides_by_range_and_bearing(measured, filtered, measured_runs):
    """Within limits and as early as with all states measured; estimates within what the filter says of them."""
    campaign = filtered
    assert campaign.passed().all() and campaign.event_totals == {"too close": 0}
    assert np.mean(measured.arrivals(campaign)) == pytest.approx(26.43, abs=0.15)
    run, told = measured_runs[0], measured.filter
    memory = run.memory[: told.memory.size, 50:-1]
    error = told.estimate(memory) - run.states[:, 50:-1]
    sigma = np.sqrt(np.array([np.diag(P) for P in told.covariance(memory)]))
    share = np.sqrt(np.mean((error[6:].T / sigma[:, 6:]) ** 2))  # velocity and position
    assert 0.5 < share < 2.0  # lag and wrong mass are more than noise while switches follow each other
    assert np.min(np.linalg.norm(run.states[9:], axis=0)) > KEEP_OUT


@pytest.mark.slow
def test_planned_again_it_arrives_within_all_limits():
    """A run makes four plans, none fails, and the last ends after the least time and before the reserved plan."""
    again = Replanned(resolver(1).solution)
    campaign = again.simulate_campaign("re-planned", 1, SEED, executor="serial")
    assert campaign.passed().all() and campaign.event_totals == {"too close": 0}
    assert np.all(campaign.measure("replans") == 4) and np.all(campaign.measure("failed replans") == 0)
    arrivals = again.arrivals(campaign)
    least, first = again.solution.objective * np.sqrt(PLANNED), again.solution.objective
    assert np.all((least < arrivals) & (arrivals < 26.9)) and np.all(np.abs(arrivals - first) > 1e-3)
    run = campaign.rerun(0)
    assert run.replans[-1].final_time == arrivals[0] and [r.time for r in run.replans] == [4, 8, 12, 16]
    u, plan = run.commands[:, 44:46], run.replans[0]
    assert plan.effective == pytest.approx(4.5) and not np.allclose(u[:, 0], u[:, 1])


@pytest.mark.slow
def test_the_tvlqr_behind_the_filter_passes_and_the_filter_is_consistent(tracking):
    filtered = Filtered(tracking.solution)
    vars(filtered)["tvlqr"] = tracking.tvlqr
    campaign = filtered.simulate_campaign("TVLQR", 6, SEED, executor="serial")
    assert campaign.passed().all()
    found = consistency(campaign, filtered.filter).innovations["range"]
    assert found.average == pytest.approx(1, abs=0.25)


@pytest.fixture(scope="module")
def followed(tracking):
    return {name: tracking.simulate_campaign(name, n, SEED, executor="serial") for name, n in RUNS.items()}


def test_plan_keeps_its_reserve(tracking):
    """A rest-to-rest translation takes 1 / sqrt(share) as long; here the turn and the orbit change that by < 0.5 %."""
    flown = tracking.solution.phase().applied(np.linspace(0.0, tracking.reference.final_time, 500))
    largest = np.repeat([50.0, 320.0], 3) * RESERVE
    assert np.all(np.abs(flown) <= largest[:, None] * (1 + 1e-9))
    fastest = plan(reserve=1.0).objective
    assert tracking.solution.objective == pytest.approx(fastest / np.sqrt(RESERVE), rel=5e-3)
    with pytest.raises(go.ProblemError, match="authority"):
        plan(reserve=1.2)


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_feedback_passes_in_every_run(tracking, followed, name):
    campaign = followed[name]
    rate = campaign.pass_rate()
    assert rate.runs == RUNS[name] and not campaign.failures
    assert rate.rate == 1.0
    assert campaign.span[1] >= tracking.reference.final_time + SETTLING - 1e-9
    assert dict(campaign.limits) == LIMITS


@pytest.mark.slow
def test_scipy_goes_the_same_way(measured_runs):
    """Chaser, thrusters and force of a run written down again, flown with its commands to its arrival."""
    runs, steps = measured_runs, 265
    again = np.stack([run.states[:, steps] for run in runs], axis=1)
    assert flown_again(runs, steps) == pytest.approx(again, abs=1e-7)
    assert np.all(np.linalg.norm(again[6:9], axis=0) < 0.1)  # moving all the way, and nearly at rest again


def flown_again(runs: list[Run], steps: int) -> Array:
    """Return the states (12, n_runs) after some control steps, by SciPy from commands and parameters alone."""

    def of(name: str) -> Array:
        return np.stack([run.parameter(name) for run in runs], axis=1)

    inertia, mass, push = of("plant.inertia"), of("plant.mass"), of("differential force.level")
    tau = np.vstack([of(name) + np.zeros((3, 1)) for name in ("torque lag.tau", "force lag.tau")])
    assert np.all(np.abs(mass - MASS) > 10)
    n = np.sqrt(MU_EARTH / (RADIUS_EARTH + ALTITUDE) ** 3)

    def rate(t: float, flat: Array, told: Array, gap: Array) -> Array:
        omega, sigma, v, r = np.split(flat.reshape(12, -1), 4)
        applied = told + gap * np.exp(-t / tau)
        own = np.sum(sigma**2, axis=0)

        def turned_by(a: Array, sign: float) -> Array:
            once = cross(sigma, a)
            return a + (8 * cross(sigma, once) + sign * 4 * (1 - own) * once) / (1 + own) ** 2

        orbit = turned_by(np.array([[0.0], [-n], [0.0]]) + 0 * omega, -1)
        whole = omega + orbit
        spin = (applied[:3] - cross(whole, inertia * whole)) / inertia + cross(omega, orbit)
        turn = 0.25 * (
            (1 - own) * omega + 2 * cross(sigma, omega) + 2 * sigma * np.sum(sigma * omega, axis=0)
        )
        hill = np.stack([2 * n * v[2], -(n**2) * r[1], -2 * n * v[0] + 3 * n**2 * r[2]])
        return np.concatenate([spin, turn, turned_by(applied[3:], 1) / mass + hill + push, v]).ravel()

    y, applied = np.stack([run.states[:, 0] for run in runs], axis=1).ravel(), np.zeros((6, len(runs)))
    quanta = np.repeat([[TORQUE_STEP], [FORCE_STEP]], 3, axis=0)
    most = np.repeat([[MAX_TORQUE], [MAX_FORCE]], 3, axis=0)
    for k in range(steps):
        asked = np.stack([run.commands[:, k] for run in runs], axis=1)
        told = np.clip(quanta * np.floor(asked / quanta + 0.5), -most, most)
        gap = applied - told
        y = solve_ivp(rate, (0.0, DT), y, "DOP853", args=(told, gap), rtol=1e-8, atol=1e-9).y[:, -1]
        applied = told + gap * np.exp(-DT / tau)
    return np.asarray(y.reshape(12, -1))


@pytest.mark.usefixtures("blank_figures")
@pytest.mark.slow
def test_main_writes_statistics_and_figures(
    tracking, guided, measured, corrected, filtered, tmp_path, capsys, monkeypatch
):
    """With controllers and guided flights of the tests above; of the MPC no run is asked for, and none is flown."""
    flights = {Guided: corrected, Measured: filtered}
    report = "problems.rendezvous_tracking.__main__."
    plans = {(1,): tracking.solution, (1, 1.0): guided.solution, (1, PLANNED): resolver(1).solution}
    monkeypatch.setattr(report + "plan", lambda *asked, refined=True: plans[asked])
    for kind, designed in {"Tracking": tracking, "Guided": guided, "Measured": measured}.items():
        known = {id(designed.solution): designed}
        monkeypatch.setattr(report + kind, lambda plan, known=known: known[id(plan)])
    monkeypatch.setattr(Guided, "simulate_campaign", lambda self, *asked, **how: flights[type(self)])
    arguments = ["--runs", "1", "--costly-runs", "0", "--json", str(tmp_path / "out.json")]
    arguments += ["--checkpoint", str(tmp_path / "kept")]
    assert main([*arguments, "--report", str(tmp_path / "figures")]) == 0
    told = json.loads((tmp_path / "out.json").read_text())
    assert set(told) == {
        "open loop",
        "TVLQR",
        "integral sliding mode",
        "TVLQR, EKF",
        "guided",
        "guided, filtered",
    }
    assert len([*(tmp_path / "kept").glob("*/runs*.npz")]) >= 4
    assert told["TVLQR"]["passed"]["passed"] == 1
    assert "guided, filtered" in capsys.readouterr().out
    assert (tmp_path / "figures" / "dispersion_tvlqr.png").exists()


def test_plain_loop_of_the_benchmark_ends_where_the_campaign_does(tracking):
    campaign = tracking.simulate_campaign("TVLQR", 1, SEED, executor="serial")
    given = plain_inputs(campaign, campaign.compiled_loop, 0)
    end = plain_run(campaign.compiled_loop, *given, campaign.compiled_loop.schedule, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(end, campaign.states[:, 0], rtol=0, atol=1e-6)
