"""The rocket that lands in wind: the plan against its closed form, laws, runs integrated by SciPy, a small campaign."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from gnc_opt.array_types import Array
from gnc_opt.simulation import Run
from problems.landing.mars_landing import FULL, GRAVITY, MASS_RATE
from problems.rocket_landing import LATEST, START, Landing
from problems.rocket_landing import __main__ as table
from problems.rocket_landing.__main__ import main
from problems.rocket_landing.control import DT, GUST, GUST_RATE, HARD
from problems.rocket_landing.model import AIR, SETTLING

SEED = 3
UP = np.array([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def landing() -> Landing:
    return Landing()


@pytest.fixture(scope="module")
def campaigns(landing):
    runs = {"as planned": 2, "re-planned": 2, "ZEM/ZEV": 2}
    return {name: landing.simulate_campaign(name, n, SEED, executor="serial") for name, n in runs.items()}


def test_the_plan_is_that_of_the_closed_form(landing):
    """No limit holds, so the integral of a^2 is that of ZEM and ZEV: 4 (3 M^2/T^3 - 3 M V/T^2 + V^2/T), best in T."""
    leg = landing.plan.phase()
    r, v = np.array(START["r"]), np.array(START["v"])

    def cost(T: float) -> float:
        zem = -(r + T * v - 0.5 * T**2 * GRAVITY * UP)
        zev = -SETTLING * UP - (v - T * GRAVITY * UP)
        return float(4 * (3 * zem @ zem / T**3 - 3 * zem @ zev / T**2 + zev @ zev / T))

    best = scipy.optimize.minimize_scalar(cost, bounds=(20.0, 100.0), options={"xatol": 1e-9})
    assert landing.plan.objective == pytest.approx(best.fun, rel=1e-9)
    assert leg.duration == pytest.approx(best.x, abs=1e-4)
    times = np.linspace(0, leg.final_time, 100)
    throttle = np.linalg.norm(leg.saturated_control("T")(times), axis=0) / FULL
    assert np.all((throttle > 0.4) & (throttle < 0.77))


def test_after_the_plan_the_lander_settles(landing):
    reference, end = landing.reference, landing.plan.phase().final_time
    x, u = reference.x(end + 3.0), reference.u(end + 3.0)
    assert x[:6] == pytest.approx([-3.0, 0, 0, -1.0, 0, 0], abs=1e-8)
    assert u == pytest.approx(x[6] * GRAVITY * UP, rel=1e-12)


def test_every_law_lands_within_its_limits(campaigns):
    for name, campaign in campaigns.items():
        assert campaign.passed().all(), name
        assert campaign.event_totals == {"touchdown": len(campaign), "crash": 0, "empty": 0}
        assert campaign.state("r")[0] == pytest.approx(
            np.zeros(len(campaign)), abs=1e-9
        )  # on the ground, not below
    again = campaigns["re-planned"]
    assert np.all(again.replans[0] >= 13) and np.all(again.replans[1] == 0)
    assert np.all(campaigns["as planned"].replans == 0)


def test_plans_are_those_from_where_the_lander_is(landing, campaigns):
    """Each begins there to the errors of sensors and of a prediction without wind and regulator."""
    run = campaigns["re-planned"].rerun(0)
    states = run.layouts["state"]
    for replan in run.replans[1:]:  # during the first the regulator still turns the lander onto its way
        k = round(replan.effective / DT)
        apart = run.errors[:, k]
        assert np.linalg.norm(apart[states.slice("r")]) < 0.6
        assert np.linalg.norm(apart[states.slice("v")]) < 0.3
    assert np.linalg.norm(run.errors[states.slice("r"), 0]) > 5.0


@pytest.mark.parametrize("index", range(2))
def test_scipy_lands_at_the_same_place(campaigns, index):
    """Plant, lag and wind written down again, flown with the commands of the run: the touchdown agrees to 1e-6."""
    run = campaigns["as planned"].rerun(index)
    time, states = flown_again(run)
    assert time == pytest.approx(run.times[-1], abs=1e-6)
    assert states == pytest.approx(run.states[:, -1], abs=1e-5)


def test_a_crash_is_a_failure(landing):
    run = landing.loop("as planned").simulate(
        {"r": [30.0, 0, 0], "v": [-40.0, 0, 0], "mass": 1900.0}, tf=LATEST
    )
    assert not run.outcome.ok and run.outcome.what == "crash" and -run.states[3, -1] > HARD


def test_the_command_prints_its_table(campaigns, landing, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(Landing, "simulate_campaign", lambda self, name, *rest, **more: campaigns[name])
    assert main(["--runs", "1", "--json", str(tmp_path / "out.json")]) == 0
    text = capsys.readouterr().out
    assert "239.51 kg" in text and "re-planned" in text and (tmp_path / "out.json").exists()
    monkeypatch.setattr(table, "DEMANDED", 1.01)
    assert main([]) == 1 and "are demanded" in capsys.readouterr().out


def flown_again(run: Run) -> tuple[float, Array]:
    """Return when and how a run ends at the ground, by SciPy from its commands and parameters alone."""
    p = {name: run.parameter(name) for name in run.layouts["parameter"].names}

    def rate(t: float, y: Array, command: Array) -> Array:
        v, mass, T = y[3:6], y[6], y[7:]
        through = v - p["plant.wind"]
        drag = 0.5 * AIR * p["plant.drag_area"][0] * np.sqrt(through @ through + 1.0) * through
        gust = GUST * np.sin(GUST_RATE * t + p["gusts.phase"])
        pull = (T - drag) / mass - GRAVITY * UP + gust
        burn = -MASS_RATE * np.sqrt(T @ T + 1.0)
        lag = (command - T) / p["engine lag.tau"]
        return np.concatenate([v, pull, [burn], lag])

    def ground(t: float, y: Array, command: Array) -> float:
        return float(y[0])

    ground.terminal = True  # type: ignore[attr-defined]
    factor = p["engines.factor"]
    row = Landing().reference.mean_control([0.0], DT)[:, 0]
    y, t = np.concatenate([run.states[:, 0], factor * row]), run.times[0]
    for command in (factor[:, None] * run.commands).T:
        found = scipy.integrate.solve_ivp(
            rate, (t, t + DT), y, "DOP853", args=(command,), rtol=1e-9, atol=1e-8, events=ground
        )
        y, t = found.y[:, -1], found.t[-1]
        if found.t_events[0].size:
            break
    return float(t), y[:7]
