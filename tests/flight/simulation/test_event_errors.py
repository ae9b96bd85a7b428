"""The error of the integration knows what the instants of events make of it."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.simulation import ClosedLoop, Event, Flight
from gnc_opt.simulation.event_error import instant_error
from gnc_opt.simulation.events import Events

G, DRAG, BACK = 1.6, 0.5, 0.5
"""Gravity (m/s^2), drag (1/s) and what is left of the speed after a bounce."""
UP = 5.0
"""Speed of the throw, m/s."""


def ball(drag: float) -> go.Model:
    model = go.Model("ball")
    h, w, a = model.state("h"), model.state("w"), model.control("a")
    model.ode({h: w, w: a - G - drag * w})
    return model


def height(t: float, h: float, w: float) -> float:
    return float(h - G / DRAG * t - (w + G / DRAG) / DRAG * np.expm1(-DRAG * t))


def speed(t: float, w: float) -> float:
    return float((w + G / DRAG) * np.exp(-DRAG * t) - G / DRAG)


APEX = float(np.log((UP + G / DRAG) / (G / DRAG)) / DRAG)


def instant(ceiling: float) -> float:
    """When a ball thrown up from the ground meets the ceiling: bisection of the closed form."""
    low, high = 0.0, APEX
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if height(middle, 0.0, UP) < ceiling else (low, middle)
    return low


@pytest.fixture(scope="module")
def flights() -> dict[bool, Flight]:
    """Of a fast nominal passage, by whether it ends the run; the ceiling is a parameter."""
    found = {}
    for ends in (True, False):
        model = ball(DRAG)
        ceiling = model.parameter("ceiling", 3.0)
        h, w = model.symbol("h"), model.symbol("w")
        event = Event("ceiling", h - ceiling, "rising", reset=None if ends else {w: -BACK * w})
        law = go.feedforward(go.Reference.constant(model, [0.0, UP], [0.0]))
        loop = ClosedLoop(model, law, events=[event], dt=0.25, substeps=1, accuracy=1e-2)
        found[ends] = loop.flight([0.0, UP], tf=2.25)
    return found


@pytest.mark.parametrize("ends", [True, False])
@pytest.mark.parametrize("gap", [1e-1, 1e-2, 1e-4, 1e-6])
def test_slow_passages_are_not_more_wrong_than_they_say(
    flights: dict[bool, Flight], ends: bool, gap: float
) -> None:
    """A ball that only just reaches a ceiling; the nominal one, from which growth is known, flies into it."""
    flight, top = flights[ends], height(APEX, 0.0, UP)
    P = flight.nominal.copy()
    P[flight.layout.slice("plant.ceiling")] = top - gap
    run, met = flight.run(P, 0), instant(top - gap)
    # what is told of the instant alone, without a second flight that has seen it
    told = replace(flight, beside=False).run(P, 0).integration_error
    if ends:
        truth = np.array([top - gap, speed(met, UP)])
    else:
        left, w = 2.25 - met, -BACK * speed(met, UP)
        truth = np.array([height(left, top - gap, w), speed(left, w)])
    wrong = float(np.max(np.abs(run.states[:, -1] - truth) / np.maximum(1.0, np.abs(truth))))
    late = abs(run.events[0].time - met) / max(1.0, met)
    # the error of the embedded solution of fourth order is some fifty times that of the fifth, which is carried on
    assert max(wrong, late) < told <= run.integration_error < 200 * max(wrong, late)


def test_an_instant_is_off_by_the_root_of_an_error_at_most(flights: dict[bool, Flight]) -> None:
    """The nearer the ceiling is to the apex, the slower the passage, without limit; what its instant is off by has one,
    sqrt(2 e / G) of an error e. Without it, it would be sqrt(1000) = 32 times as much."""
    flight, told = replace(flights[True], beside=False), []
    for gap in (1e-4, 1e-7):
        P = flight.nominal.copy()
        P[flight.layout.slice("plant.ceiling")] = height(APEX, 0.0, UP) - gap
        run = flight.run(P, 0)
        assert len(run.events) == 1
        told.append(run.integration_error)
    assert told[1] < 15 * told[0]


def test_what_another_event_met_does_not_make_a_row_forget_what_its_way_was_off_by() -> None:
    """A mark that changes nothing, passed just before a ceiling that is only just reached, leaves what is told."""
    model = ball(DRAG)
    h, w = model.symbol("h"), model.symbol("w")
    top = height(APEX, 0.0, UP) - 1e-4
    law = go.feedforward(go.Reference.constant(model, [0.0, UP], [0.0]))
    ceiling, mark = Event("ceiling", h - top, "rising"), Event("mark", h - top + 1e-3, "rising", reset={w: w})
    told = []
    for events in ([ceiling], [mark, ceiling]):
        loop = ClosedLoop(model, law, events=events, dt=0.25, substeps=1, accuracy=1e-2)
        run = replace(loop.flight([0.0, UP], tf=2.25), beside=False).run(loop.parameters([0.0, UP]), 0)
        told.append(run.integration_error)
    assert told[1] == pytest.approx(told[0], rel=0.2)


def test_exact_bounces_that_accumulate_stay_exact() -> None:
    """Of a row that is met again and again only what is new since the last time moves its instant."""
    model = ball(0.0)
    h, w = model.symbol("h"), model.symbol("w")
    law = go.feedforward(go.Reference.constant(model, [0.0, UP], [0.0]))
    loop = ClosedLoop(model, law, events=[Event("bounce", h, "falling", reset={w: -BACK * w})], dt=0.0559)
    run = loop.simulate([1.0, 0.0], tf=3.354)  # the first bounces of infinitely many until 3.3541 s
    first = np.sqrt(2 / G)
    times = first * (1 + 2 * np.cumsum([0.0, *(BACK ** np.arange(1, len(run.events)))]))
    assert len(run.events) > 10
    apart = np.max(np.abs([event.time for event in run.events] - times))
    assert apart < run.integration_error < 1e-12


def by_hand(level: float = 0.0, **change: object) -> float:
    """Of a ball that meets the ground at -0.1 m/s, by `instant_error`."""
    model = ball(0.0)
    events = Events.of(model, (Event("ground", model.symbol("h") - level, "falling", reset={}),))
    given = {
        "errors": 1e-6,
        "t": 0.5,
        "x": [0.0, -0.1],
        "x_after": [0.0, 0.05],
        "fired": 1,
        "rates": ca.DM([[-0.1, 0.05], [-G, -G]]),
        "bend": -G,
        "reset": ca.diag([1.0, -BACK]),
        "ended": 0,
        "p": [],
    } | change
    return float(sum(instant_error(events, 2)(*given.values())))


def test_states_after_a_bounce_move_by_the_saltation_matrix() -> None:
    bounced = 1e-6 * (G * (1 + BACK) / 0.1 + BACK * 1.0)  # errors of h and w of 1e-6
    assert by_hand() == pytest.approx(
        bounced - 1e-6, rel=1e-3
    )  # the speed has changed by 1e-6 G / 0.1 meanwhile
    ended = 1e-6 * (G / 0.1 + 1.0)
    assert by_hand(ended=1) == pytest.approx(ended - 1e-6, rel=1e-3)


def test_the_row_of_an_end_is_met_whatever_the_way_is_off_by() -> None:
    """Even motion through the ground: its height there has no error, and its speed no more than before."""
    even = {"x": [0.0, -10.0], "rates": ca.DM([[-10.0, 0.0], [0.0, 0.0]]), "bend": 0.0, "ended": 1}
    assert by_hand(**even, x_after=[0.0, -10.0], reset=ca.DM.eye(2)) == pytest.approx(0.0, abs=1e-12)


def test_even_motion_that_turns_back_moves_by_twice_the_error_less() -> None:
    """Perfectly elastic, h is mirrored: what was too high by an error is too low by it, and no more."""
    mirrored = {"x": [0.0, -10.0], "x_after": [0.0, 10.0], "bend": 0.0, "reset": ca.diag([1.0, -1.0])}
    assert by_hand(**mirrored, rates=ca.DM([[-10.0, 10.0], [0.0, 0.0]])) == pytest.approx(0.0, abs=1e-12)


def test_states_after_a_reset_are_weighed_by_their_own_size() -> None:
    """A thousand times as fast afterwards, the same change of rates is a thousandth of it."""
    kicked = {"x_after": [0.0, 1000.0], "rates": ca.DM([[-0.1, -0.1], [0.0, 1e6]]), "bend": 0.0}
    given = {**kicked, "reset": ca.diag([1.0, 0.0])}  # the speed is set, and grows by 1e6 m/s^2
    assert by_hand(**given) == pytest.approx(1e-6 * 1e6 / 0.1 / 1000.0 - 1e-6, rel=1e-6)


def test_a_row_is_off_by_what_its_states_are_off_by() -> None:
    """1e-6 of 5 km is 5 mm, which at 0.1 m/s is 50 ms; of the ground's height it is 10 us."""
    same = {"rates": ca.DM([[-0.1, -0.1], [0.0, 0.0]]), "bend": 0.0, "reset": ca.DM.eye(2)}
    high = {"x": [5000.0, -0.1], "x_after": [5000.0, -0.1]}
    assert by_hand(5000.0, **same, **high) == pytest.approx(5e-3 / 0.1 - 1e-6, rel=1e-6)


def test_of_two_rows_the_one_that_is_met_counts() -> None:
    """What the way has been off by since another row was met does not move this one's instant."""
    model = ball(0.0)
    h = model.symbol("h")
    events = Events.of(
        model, (Event("ground", h, "falling", reset={}), Event("roof", h - 5.0, "falling", reset={}))
    )
    rates, reset = ca.DM([[-0.1, 0.05], [-G, -G]]), ca.diag([1.0, -BACK])
    state = [0.0, -0.1], [0.0, 0.05]
    both = instant_error(events, 2)([1e-6, 1e-3], 0.5, *state, [1, 0], rates, [-G, -G], reset, 0, [])
    assert float(sum(both)) == pytest.approx(by_hand(), rel=1e-12)


def test_what_is_only_noted_moves_the_instant_alone() -> None:
    same = {"x_after": [0.0, -0.1], "rates": ca.DM([[-0.1, -0.1], [-G, -G]]), "reset": ca.DM.eye(2)}
    assert by_hand(**same) == pytest.approx(1e-6 / 0.1 - 1e-6, rel=1e-3)
    assert by_hand(**same, t=100.0) == 0.0  # relative to the time
    assert by_hand(**same, fired=0) == 0.0


def test_a_mere_touch_has_half_the_digits() -> None:
    still = {
        "x": [0.0, 0.0],
        "x_after": [0.0, 0.0],
        "rates": ca.DM([[0.0, 0.0], [-G, -G]]),
        "reset": ca.DM.eye(2),
    }
    assert by_hand(**still) == pytest.approx(np.sqrt(2e-6 / G), rel=1e-2)


def test_accuracy_is_not_asked_of_the_instant_of_a_soft_touchdown() -> None:
    """Braked at 1 m/s^2 to 0.6 um/s at the ground: the error of the instant is told, and no steps are spent on it."""
    model = ball(0.0)
    law = go.feedforward(go.Reference.constant(model, [1.0, 0.0], [G + 1.0]))
    event = Event("touchdown", model.symbol("h"), "falling")
    loop = ClosedLoop(model, law, events=[event], dt=0.1)
    start = [1.0, -np.sqrt(2.0) * (1 + 1e-13)]
    flight = loop.flight(start, tf=2.0)
    ending = flight.final(flight.nominal[:, None], [0])
    assert flight.substeps == 1 and ending.outcomes[0].ok and ending.outcomes[0].what == "touchdown"
    late = abs(ending.outcomes[0].time - (np.sqrt(2) * (1 + 1e-13) - np.sqrt(4e-13)))
    assert max(late, 1e-9) < ending.integration_error[0] < 1e-6
    assert ending.integration_error[0] - ending.instant_error[0] < 1e-11


def test_coming_to_rest_is_judged_by_the_states_that_go_on() -> None:
    """At rest on the ground an instant is as uncertain as that of any touch; what rests is not."""
    model = go.Model("ball with a mode")
    h, w, air, mass = (model.state(name) for name in ("h", "w", "air", "mass"))
    model.ode({h: w, w: air * (model.control("a") - G), air: 0.0, mass: 0.0})
    law = go.feedforward(go.Reference.constant(model, [0.0, 0.0, 1.0, 1000.0], [0.0]))
    rest = Event("rest", h, "falling", reset={h: 0.0, w: 0.0, air: 0.0})
    flight = ClosedLoop(model, law, events=[rest], dt=0.1).flight([0.0, 0.0, 1.0, 1000.0], tf=0.5)
    ending = flight.final(flight.nominal[:, None], [0])
    assert flight.substeps == 1 and ending.outcomes[0].ok and ending.states[:3, 0].tolist() == [0.0, 0.0, 0.0]
    assert ending.integration_error[0] - ending.instant_error[0] < 1e-13
