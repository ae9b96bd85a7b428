"""Events in the closed loop against closed forms, against SciPy's events, and what is refused."""

from unittest.mock import MagicMock

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from testing.internals import EventDetector, IntegrationStep
from testing.loops import feedback, scheduled

from gnc_opt.control import Reference, feedforward
from gnc_opt.errors import ArgumentError, UnknownNameError
from gnc_opt.model import Model
from gnc_opt.simulation import Campaign, ClosedLoop, Event, Lag, Normal, RunStatus, monte_carlo
from gnc_opt.spacecraft import mrp_rate

G = 9.81


def ball():
    """A mass that falls, with a push upwards as its control."""
    plant = Model("ball")
    h, v = plant.state("h", unit="m"), plant.state("v", unit="m/s")
    a = plant.control("a", unit="m/s^2")
    g = plant.parameter("g", G)
    plant.ode({h: v, v: a - g})
    return plant, h, v


def falling(plant, *events, **options):
    options = {"dt": 0.1} | options
    return ClosedLoop(plant, scheduled(plant, lambda t: 0 * t), events=events, **options)


def events_of(run):
    return [(event.name, event.time) for event in run.events]


def test_a_fall_ends_on_the_ground_at_the_right_time_with_the_right_speed():
    plant, h, _ = ball()
    run = falling(plant, Event("touchdown", h, "falling")).simulate([10.0, 1.0], tf=5.0)
    speed = np.sqrt(1 + 2 * G * 10)
    assert run.times[-1] == pytest.approx((1 + speed) / G, abs=1e-13)
    assert run.states[:, -1] == pytest.approx([0.0, -speed], abs=1e-12)
    assert (run.outcome.status, run.outcome.what) == (RunStatus.OK, "touchdown")
    assert run.outcome.time == run.times[-1] and "touchdown at 1.53341 s" in str(run)


def test_logs_end_with_the_event():
    plant, h, _ = ball()
    loop = ClosedLoop(plant, feedback(plant, [0.0, 0.5]), events=[Event("touchdown", h)], dt=0.1)
    run = loop.simulate([10.0, 1.0], tf=5.0)
    whole = ClosedLoop(plant, loop.controller, dt=0.1).simulate([10.0, 1.0], tf=5.0)
    n = run.times.size - 1
    assert run.times[-2] < run.outcome.time < run.times[-2] + 0.1
    assert run.states.shape == (2, n + 1) and run.commands.shape == run.applied.shape == (1, n)
    assert run.states[:, :-1] == pytest.approx(whole.states[:, :n], abs=1e-14)
    assert run.commands == pytest.approx(whole.commands[:, :n], abs=1e-14)
    # what was applied is summed up to the event and no further
    lengths = np.diff(run.times)
    assert run.effort[0] == pytest.approx(np.sum(np.abs(run.applied[0]) * lengths), rel=1e-13)


@pytest.mark.parametrize("minor", [1, 3])
def test_bounces_are_those_of_the_closed_form_until_they_accumulate(minor):
    plant, h, v = ball()
    bounce = Event("bounce", h, "falling", reset={v: -0.8 * v})
    run = falling(plant, bounce, minor_steps=minor).simulate([10.0, 0.0], tf=20.0)
    first = np.sqrt(20 / G)
    flights = 2 * first * 0.8 ** np.arange(1, 30)
    times = first + np.concatenate([[0.0], np.cumsum(flights)])
    assert [event.time for event in run.events[:30]] == pytest.approx(times, abs=1e-12)
    down = -G * first * 0.8 ** np.arange(30)
    assert [event.before[1] for event in run.events[:30]] == pytest.approx(down, abs=1e-12)
    assert [event.after[1] for event in run.events[:30]] == pytest.approx(-0.8 * down, abs=1e-12)
    # infinitely many bounces end at 9 first flights
    assert run.outcome.status is RunStatus.TERMINATED_BY_EVENT and "Zeno" in run.outcome.what
    assert 9 * first - 0.1 < run.outcome.time < 9 * first


def test_a_ball_that_comes_to_rest_by_another_event_passes_the_accumulation():
    rolling = Model("ball with a mode: at rest nothing pulls")
    h, v, air = rolling.state("h"), rolling.state("v"), rolling.state("air")
    a = rolling.control("a")
    rolling.ode({h: v, v: air * (a - G), air: 0.0})
    events = (
        Event("bounce", h, "falling", reset={v: -0.5 * v}, where=v < -0.1),
        Event("rest", h, "falling", reset={h: 0, v: 0, air: 0}, where=v >= -0.1),
    )
    run = falling(rolling, *events).simulate([1.0, 0.0, 1.0], tf=6.0)
    assert run.outcome.ok and run.events[-1].name == "rest"
    count = int(np.ceil(np.log(0.1 / np.sqrt(2 * G)) / np.log(0.5)))  # impacts faster than 0.1 m/s
    assert [event.name for event in run.events] == ["bounce"] * count + ["rest"]
    assert run.states[:, -1].tolist() == [0.0, 0.0, 0.0]


def test_a_launch_from_the_ground_is_no_touchdown_and_a_fall_from_it_is_one_at_once():
    plant, h, _ = ball()
    loop = falling(plant, Event("touchdown", h, "falling"))
    up = loop.simulate([0.0, 3.0], tf=5.0)
    assert up.outcome.time == pytest.approx(6.0 / G, abs=1e-13)
    assert up.effort[0] == 0.0
    down = loop.simulate([0.0, -3.0], tf=5.0)
    assert (down.outcome.what, down.outcome.time) == ("touchdown", pytest.approx(0.0, abs=1e-15))
    assert down.states[:, -1] == pytest.approx([0.0, -3.0], abs=1e-15) and np.isfinite(down.applied).all()
    below = loop.simulate([-1.0, 0.0], tf=0.5)  # never above the ground: it passes nothing
    assert below.outcome.what == "" and below.events == ()


@pytest.mark.parametrize("t0", [0.0, 1e5])
def test_directions(t0):
    plant, h, _ = ball()
    height, up = 4.0, 12.0
    roots = (up + np.array([-1, 1]) * np.sqrt(up**2 - 2 * G * height)) / G
    for direction, expected in (("rising", roots[:1]), ("falling", roots[1:]), ("either", roots)):
        loop = falling(plant, Event("pass", h - height, direction, reset={}))
        run = loop.simulate([0.0, up], t0=t0, tf=t0 + 3.0)
        assert [event.time - t0 for event in run.events] == pytest.approx(expected, abs=1e-13 + 1e-16 * t0)
        assert run.states[0, -1] == pytest.approx(36 - G * 4.5, abs=1e-9)  # noted, nothing else


@pytest.mark.parametrize("above", [1e-3, 1e-7])
def test_a_visit_beyond_zero_within_one_step_is_found_and_a_miss_is_none(above):
    plant, h, _ = ball()
    apex = 3.0**2 / (2 * G)
    for shift, count in ((-above, 2), (above, 0)):
        ceiling = Event("ceiling", h - apex - shift, reset={})
        run = falling(plant, ceiling, dt=1.0, substeps=1).simulate([0.0, 3.0], tf=1.0)
        assert len(run.events) == count
        half = np.sqrt(2 * above / G)
        expected = 3.0 / G + half * np.array([-1, 1])
        assert [e.time for e in run.events] == pytest.approx(expected[:count], abs=1e-15 / half + 1e-15)


def test_a_touch_of_zero_ends_nothing_or_the_run_where_it_touches():
    plant, h, _ = ball()
    run = falling(plant, Event("ceiling", h - 9.0 / (2 * G), "rising")).simulate([0.0, 3.0], tf=1.0)
    assert run.outcome.ok
    assert run.outcome.what == "" or run.outcome.time == pytest.approx(3.0 / G, abs=1e-7)


def test_events_of_one_instant_act_in_order_on_what_the_others_left():
    plant, h, v = ball()
    first = Event("a", h, "falling", reset={v: v + 1})
    second = Event("b", 2 * h, "falling", reset={v: -2 * v})
    for events, factor in (
        ((first, second), lambda v: -2 * (v + 1)),
        ((second, first), lambda v: -2 * v + 1),
    ):
        run = falling(plant, *events).simulate([1.0, 0.0], tf=0.6)
        impact = -np.sqrt(2 * G)
        assert [event.name for event in run.events] == [event.name for event in events]
        assert run.events[0].time == run.events[1].time == pytest.approx(np.sqrt(2 / G), abs=1e-13)
        assert run.events[1].before[1] == run.events[0].after[1]
        assert run.events[1].after[1] == pytest.approx(factor(impact), abs=1e-12)


@pytest.mark.parametrize("minor", [1, 2])
def test_events_of_one_step_happen_each_at_its_own_instant(minor):
    """Falling from 1 m through 0.9, 0.8 and 0.8 - 1e-6 m, in any order of declaration; energy is kept."""
    plant, h, _ = ball()
    levels = [0.8, 0.9, 0.8 - 1e-6]
    events = [Event(f"level {i}", h - level, "falling", reset={}) for i, level in enumerate(levels)]
    run = falling(plant, *events, dt=0.4, minor_steps=minor).simulate([1.0, 0.0], tf=0.4)
    assert [event.name for event in run.events] == ["level 1", "level 0", "level 2"]
    expected = [np.sqrt(2 * (1 - level) / G) for level in (0.9, 0.8, 0.8 - 1e-6)]
    assert [event.time for event in run.events] == pytest.approx(expected, abs=1e-13)
    assert [event.before[0] for event in run.events] == pytest.approx([0.9, 0.8, 0.8 - 1e-6], abs=1e-12)


def test_conditions_are_checked_before_the_resets_of_the_same_instant():
    plant, h, v = ball()
    slow = Event("slow", h, "falling", reset={v: 0 * v}, where=v > -5)
    fast = Event("fast", h, "falling", reset={v: -v / 8}, where=v <= -5)
    run = falling(plant, fast, slow).simulate([2.0, 0.0], tf=1.0)
    assert [event.name for event in run.events[:2]] == ["fast", "slow"]
    assert run.events[1].time - run.events[0].time == pytest.approx(2 * np.sqrt(4 * G) / 8 / G, abs=1e-13)


def test_an_end_among_simultaneous_events_leaves_out_those_after_it():
    plant, h, v = ball()
    events = [Event("one", h, reset={v: 0 * v}), Event("end", h), Event("two", h, reset={v: 7 + 0 * v})]
    run = falling(plant, *events).simulate([1.0, 0.0], tf=2.0)
    assert [event.name for event in run.events] == ["one", "end"] and run.states[1, -1] == 0.0


def test_an_event_at_the_very_end_is_as_exact_as_any():
    """Whether it is still met is a matter of rounding; when the run ends is not (an error of 1 was printed)."""
    plant, h, _ = ball()
    loop = falling(plant, Event("touchdown", h, "falling"))
    for share in (1.0, 1 - 1e-15, 1 + 1e-15, 1 - 1e-14, 1 + 1e-14):
        run = loop.simulate([0.5 * G * share, 0.0], tf=1.0)
        assert run.outcome.ok and run.integration_error < 1e-8
        assert run.times[-1] == pytest.approx(1.0, abs=1e-12)


def test_a_reset_beyond_zero_of_another_event_makes_that_happen_at_the_same_time():
    plant, h, _ = ball()
    trap = Event("trap", h - 5, "falling", reset={h: -1 + 0 * h})
    run = falling(plant, trap, Event("ground", h, "falling")).simulate([6.0, 0.0], tf=5.0)
    assert [event.name for event in run.events] == ["trap", "ground"]
    assert run.events[1].time == pytest.approx(np.sqrt(2 / G), abs=1e-9)


@pytest.mark.parametrize("speed", [0.0, -1.0, 1.0])
def test_a_reset_onto_zero_of_another_event_makes_that_happen_if_it_moves_on_through(speed):
    """Thrown from 1 m it falls through that at once, thrown up after 2 v / g."""
    plant, h, v = ball()
    again = Event("again", h, "falling", reset={h: 1.0, v: speed})
    run = falling(plant, again, Event("one", h - 1.0, "falling", reset={})).simulate([0.5, 0.0], tf=0.6)
    first = np.sqrt(2 * 0.5 / G)
    assert events_of(run) == [
        ("again", pytest.approx(first, rel=1e-9)),
        ("one", pytest.approx(first + 2 * max(speed, 0.0) / G, abs=1e-8)),  # at rest it only touches
    ]
    assert run.outcome.ok


@pytest.mark.parametrize("restitution", [1.0, 0.5])
def test_a_bouncing_ball_at_rest_on_the_ground_stays_there(restitution):
    """It bounces at once and for ever; it fell through the ground after the first of these."""
    plant, h, v = ball()
    run = falling(plant, Event("bounce", h, "falling", reset={v: -restitution * v})).simulate([0, 0], tf=0.5)
    assert run.outcome.status is RunStatus.TERMINATED_BY_EVENT and "Zeno" in str(run.outcome)
    assert np.abs(run.states).max() < 1e-9


@pytest.mark.parametrize(
    ("start", "direction"),
    [([10.0, 0.0], "either"), ([10.0, 0.0], "falling"), ([0.0, 0.0], "falling"), ([0.0, 2.0], "falling")],
)
def test_what_a_reset_puts_to_rest_does_not_fall_through_the_ground(start, direction):
    """Nothing bears it there: the run was ok, and ended metres below."""
    plant, h, v = ball()
    apex, ground = Event("apex", v, "falling", reset={}), Event("ground", h, direction, reset={v: 0})
    run = falling(plant, apex, ground).simulate(start, tf=3.0)
    assert run.outcome.status is RunStatus.TERMINATED_BY_EVENT
    assert "'ground'" in run.outcome.what and "mode" in run.outcome.what
    fall = (start[1] + np.sqrt(start[1] ** 2 + 2 * G * start[0])) / G
    assert run.outcome.time == pytest.approx(fall, abs=1e-7)
    assert run.states[:, -1] == pytest.approx([0, 0], abs=1e-12)


@pytest.mark.parametrize("kind", ["put higher", "pushed back", "slowed down", "held by a mode", "condition"])
def test_resets_from_which_the_plant_goes_on_are_no_rest_on_the_ground(kind):
    plant = Model("ball")
    h, v, mode, a = plant.state("h"), plant.state("v"), plant.state("mode"), plant.control("a")
    below = G if kind == "pushed back" else 0.0 if kind == "held by a mode" else -G
    plant.ode({h: v, v: a + ca.if_else(mode > 0.5, below, -G), mode: 0.0})
    resets = {"put higher": {h: 50.0, v: 0.0}, "slowed down": {v: 0.5 * v}, "condition": {v: 0.0}}
    reset = resets.get(kind, {v: 0.0, mode: 1.0})
    where = v > -1 if kind == "condition" else None
    run = falling(plant, Event("met", h, "falling", reset=reset, where=where)).simulate(
        [1.0, -1.0, 0.0], tf=1.5
    )
    assert run.outcome.ok and len(run.events) == (kind != "condition")


def test_two_stages_with_drag_and_a_lag_equal_scipy():
    """Fuel runs out, a stage is dropped, the rest coasts to its apex: a graph of three modes."""
    rocket = Model("rocket")
    h, v, m, stage = rocket.state("h"), rocket.state("v"), rocket.state("m"), rocket.state("stage")
    thrust = rocket.control("thrust")
    drag = 0.02 * v * ca.fabs(v)
    burns = ca.if_else(stage < 2.5, thrust, 0.0)
    rocket.ode({h: v, v: (burns - drag) / m - G, m: -burns / 2000.0, stage: 0.0})
    events = (
        Event("separation", m - 70.0, "falling", reset={m: m - 20.0, stage: 2.0}, where=stage < 1.5),
        Event("cut-off", m - 35.0, "falling", reset={stage: 3.0}, where=ca.fabs(stage - 2) < 0.5),
        Event("apex", v, "falling", where=stage > 2.5),
    )
    loop = ClosedLoop(
        rocket, scheduled(rocket, lambda t: 2500.0 + 0 * t), [Lag("engine", 0.3)], events=events, dt=0.2,
        minor_steps=2, accuracy=1e-11,
    )  # fmt: skip
    run = loop.simulate([0.0, 0.0, 100.0, 1.0], tf=120.0)

    def rate(t, x, on):
        thrust = on * 2500.0 * (1 - np.exp(-t / 0.3))
        return [x[1], (thrust - 0.02 * x[1] * abs(x[1])) / x[2] - G, -thrust / 2000.0]

    def until(t, x, on, event):
        event.terminal, event.direction = True, -1
        found = solve_ivp(
            rate, (t, 200.0), x, "DOP853", args=(on,), events=lambda_of(event), rtol=1e-13, atol=1e-13
        )
        return found.t_events[0][0], found.y_events[0][0]

    def lambda_of(event):
        def g(t, x, on):
            return event(x)

        g.terminal, g.direction = True, -1
        return g

    t, x = until(0.0, [0.0, 0.0, 100.0], 1.0, _Of(2, 70.0))
    times = [t]
    t, x = until(t, x - [0, 0, 20.0], 1.0, _Of(2, 35.0))
    times.append(t)
    t, x = until(t, x, 0.0, _Of(1, 0.0))
    times.append(t)
    assert [event.name for event in run.events] == ["separation", "cut-off", "apex"]
    assert [event.time for event in run.events] == pytest.approx(times, abs=1e-9)
    assert run.states[:3, -1] == pytest.approx(x, rel=1e-9, abs=1e-8)
    assert run.events[0].after[2] == pytest.approx(50.0, abs=1e-12)
    assert run.outcome.what == "apex" and run.outcome.ok


class _Of:
    """A component of the state over a level."""

    def __init__(self, component, level):
        self.component, self.level = component, level

    def __call__(self, x):
        return x[self.component] - self.level


def test_the_mrp_shadow_set_keeps_the_attitude_and_bounds_its_parameters():
    body = Model("spinning body")
    sigma = body.state("sigma", 3)
    omega = body.control("omega", 3)
    body.ode({sigma: mrp_rate(sigma, omega)})
    shadow = Event("shadow", ca.sumsqr(sigma) - 1, "rising", reset={sigma: -sigma / ca.sumsqr(sigma)})
    spin = scheduled(body, lambda t: np.array([[0.0], [0.0], [1.0]]) + 0 * t)
    run = ClosedLoop(body, spin, events=[shadow], dt=0.5, accuracy=1e-11).simulate([0.0, 0.0, 0.0], tf=20.0)
    # the angle is t: half a turn at pi, and every turn after it
    assert [event.time for event in run.events] == pytest.approx(np.pi * np.array([1, 3, 5]), abs=1e-9)
    angle = np.angle(np.exp(1j * run.times))
    assert run.states[2] == pytest.approx(np.tan(angle / 4), abs=1e-9)
    assert np.max(np.abs(run.states)) <= 1 + 1e-12


def test_campaigns_count_events_and_judge_their_times(tmp_path):
    plant, h, v = ball()
    events = [
        Event("too fast", h, "falling", where=v < -14.1, failure=True),
        Event("touchdown", h, "falling", where=v >= -14.1),
    ]
    loop = falling(plant, *events)
    campaign = monte_carlo(
        loop, 60, x0=[10.0, 0.0], tf=1.5, seed=1, dispersions={"initial.h": Normal(1.0)}, target={"h": 0.0},
        limits={"time(touchdown)": 1.45}, executor="serial",
    )  # fmt: skip
    height = campaign.parameter("initial.h")[0]
    time, speed = np.sqrt(2 * height / G), np.sqrt(2 * G * height)
    ends = time < 1.5
    assert 5 < np.sum(ends) < 60 and np.sum(speed > 14.1) > 5
    assert np.array_equal(campaign.event_occurred("too fast"), ends & (speed > 14.1))
    soft = ends & (speed <= 14.1)
    assert np.array_equal(campaign.event_occurred("touchdown"), soft)
    assert campaign.measure("time(touchdown)")[soft] == pytest.approx(time[soft], abs=1e-12)
    assert np.all(np.isnan(campaign.measure("time(touchdown)")[~soft]))
    assert np.array_equal(campaign.passed(), soft & (time <= 1.45))
    assert campaign.status_counts.get(RunStatus.TERMINATED_BY_EVENT, 0) == np.sum(ends & (speed > 14.1))
    assert f"touchdown in {np.sum(soft)} runs" in str(campaign)
    again = Campaign.load(campaign.save(tmp_path / "campaign.npz"))
    assert np.array_equal(again.event_times, campaign.event_times, equal_nan=True)
    run = campaign.rerun(3)
    assert np.array_equal(run.states[:, -1], campaign.states[:, 3])


def test_events_that_are_none_are_refused():
    plant, h, v = ball()
    a, foreign = plant.symbol("a"), ball()[1]
    for event, words in (
        (lambda: Event("x", h, "down"), "the direction of event 'x' is 'down': give one of"),
        (lambda: Event("", h), "cannot be the name of an event"),
        (lambda: Event("x", h, reset=[v]), "the reset of event 'x' must be of type Mapping, not list"),
        (lambda: Event("x", h, reset={v: -v}, failure=True), "is a failure and does not end the run"),
        (
            lambda: falling(plant, Event("x", h), Event("x", v)),
            "two events of the closed loop are called 'x'",
        ),
        (lambda: falling(plant, Event("x", a)), "the expression of event 'x' uses 'a', which is no state"),
        (lambda: falling(plant, Event("x", foreign)), "uses 'h', which is no state or parameter"),
        (lambda: falling(plant, Event("x", ca.vertcat(h, v))), "has 2 components: give 1"),
        (lambda: falling(plant, Event("x", h, where=a > 0)), "the condition of event 'x' uses 'a'"),
        (lambda: falling(plant, Event("x", h, reset={a: 1})), "event 'x' resets 'a', which is no state"),
        (
            lambda: falling(plant, Event("x", h, reset={foreign: 1})),
            "event 'x' resets 'h', which is no state",
        ),
        (
            lambda: falling(plant, Event("x", h, reset={v: [1, 2]})),
            "the new 'v' of event 'x' has 2 components",
        ),
        (lambda: falling(plant, "touchdown"), "events of a closed loop must be of type Event, not str"),
        (lambda: falling(plant, Event("x", "h")), "neither a number nor a CasADi SX expression"),
    ):
        with pytest.raises(ArgumentError) as refusal:
            event()
        assert words in str(refusal.value) and str(refusal.value).count(". ") == 0
    campaign = monte_carlo(
        falling(plant, Event("x", h)), 1, x0=[1.0, 0.0], tf=1.0, target={"h": 0.0}, executor="serial"
    )
    with pytest.raises(UnknownNameError, match="known: x"):
        campaign.event_occurred("y")
    with pytest.raises(UnknownNameError):
        campaign.measure("time(y)")


BLIND = {
    "the expression": lambda h, v: {"expression": ca.sqrt(h)},
    "at last": lambda h, v: {"expression": ca.sqrt(h + 0.3) + 1.0},
    "for a moment": lambda h, v: {"expression": ca.sqrt((h - 1.0) ** 2 - 0.01) + 1.0},
    "the condition": lambda h, v: {"expression": h + 9.0, "where": ca.sqrt(h)},
}


@pytest.mark.parametrize("blind", BLIND)
def test_an_event_that_could_not_be_noticed_is_reported(blind):
    """sqrt(h) never falls through zero, but the ball falls through h = 0; from 2 m that is at 0.64 s. In the same
    control step as another event, or, for a moment, before it."""
    when, other = (0.4, 0.5) if blind == "for a moment" else (0.6, -0.5)
    plant, h, v = ball()
    events = [
        Event("sight", direction="falling", reset={}, **BLIND[blind](h, v)),
        Event("pass", h - other, reset={}),
    ]
    loop = falling(plant, *events, dt=0.2, substeps=4)
    run = loop.simulate([2.0, 0.0], tf=1.0)
    assert (run.outcome.status, run.outcome.what) == (RunStatus.NOT_FINITE, "event 'sight'")
    assert run.outcome.time == pytest.approx(when)
    campaign = monte_carlo(loop, 3, x0=[2.0, 0.0], tf=1.0, executor="serial")
    assert campaign.outcomes == (run.outcome,) * 3


def test_a_braking_curve_above_the_ground_is_not_lost_where_the_run_ends_on_it():
    """sqrt(h) at the touchdown, which rounding leaves below the ground as often as not; and beyond a mode."""
    plant, h, v = ball()
    curve = Event("brake", v + 100 + ca.sqrt(h), "falling", reset={})
    above = Event("above", ca.sqrt(h - 1.0) + 1.0, "falling", reset={}, where=h > 1.1)
    loop = falling(plant, Event("touchdown", h, "falling"), curve, above)
    for height in np.linspace(1.3, 3.7, 30):
        run = loop.simulate([height, 0.0], tf=3.0)
        assert run.outcome.ok and run.outcome.what == "touchdown"


@pytest.mark.parametrize("direction", ["falling", "rising"])
def test_what_passes_far_faster_than_a_step_is_met(direction):
    """A sphere of 1 m, crossed in 2/3 s to 0.3 ms of a control step of 1 s: 8 of 28 went through unseen."""
    probe = Model("probe")
    r, v, a = probe.state("r", 2), probe.state("v", 2), probe.control("a", 2)
    probe.ode({r: v, v: a})
    outside = ca.norm_2(r) - 1
    event = Event("hit", outside if direction == "falling" else -outside, direction, failure=True)
    loop = ClosedLoop(
        probe, feedforward(Reference.constant(probe, np.zeros(4), np.zeros(2))), events=[event], dt=1.0
    )
    for speed in (3.0, 100.0, 7000.0):
        for begin in (-3.5, -3.33, -2.9):
            outcome = loop.simulate([begin * speed, 0.01, speed, 0.0], tf=7.0).outcome
            assert outcome.what == "hit"
            assert outcome.time == pytest.approx(-begin - np.sqrt(1 - 1e-4) / speed, abs=1e-9)
        past = loop.simulate([-3.5 * speed, 1.01, speed, 0.0], tf=7.0)
        assert past.outcome.ok and not past.events and past.times[-1] == 7.0


@pytest.mark.parametrize("above", [1e-6, 0.5, 30.0])
def test_a_row_is_armed_once_it_has_been_above_zero(above):
    """However little; from below it does not cross, and at zero it is not above."""
    rows = MagicMock(
        rows=lambda t, y, slope, p: (ca.SX([y]), ca.SX([slope])), detect_undefined_events=lambda *_: ca.SX(0)
    )
    rows.__len__.return_value = 1
    watch = EventDetector(rows, ca.SX([0.0]), ca.SX(0, 1), 0.0, 1e-9)
    seen = []
    for y0, y1 in ((-1.0, -0.5), (-0.5, 0.0), (0.0, above), (above, -above), (-above, -1.0)):
        slope = y1 - y0
        watch(IntegrationStep(0, 1.0, 0.0, y0, y1, [slope, slope]))
        seen.append([int(float(v)) for v in (watch.armed, watch.found)])
    assert seen == [[0, 0], [0, 0], [1, 0], [1, 1], [1, 1]]
    assert (float(watch.first), float(watch.last)) == (3.0, 4.0)
