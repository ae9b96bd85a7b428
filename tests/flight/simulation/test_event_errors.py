"""The error of the integration knows what the instants of events make of it."""

from __future__ import annotations

import numpy as np
import pytest
from testing.models import dynamics

import gnc_opt as go
from gnc_opt.simulation import ClosedLoop, CompiledLoop, Event

G, DRAG, BACK = 1.6, 0.5, 0.5
"""Gravity (m/s^2), drag (1/s) and what is left of the speed after a bounce."""
UP = 5.0
"""Speed of the throw, m/s."""


def ball(drag: float) -> go.Model:
    model, *_ = dynamics("ball", "h w", "a", lambda h, w, a: {h: w, w: a - G - drag * w})
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
def flights() -> dict[bool, CompiledLoop]:
    """Of a fast nominal passage, by whether it ends the run; the ceiling is a parameter."""
    found = {}
    for ends in (True, False):
        model = ball(DRAG)
        ceiling = model.parameter("ceiling", 3.0)
        h, w = model.symbol("h"), model.symbol("w")
        event = Event("ceiling", h - ceiling, "rising", reset=None if ends else {w: -BACK * w})
        law = go.feedforward(go.Reference.constant(model, [0.0, UP], [0.0]))
        loop = ClosedLoop(model, law, events=[event], dt=0.25, substeps=1, accuracy=1e-2)
        found[ends] = loop.compile([0.0, UP], tf=2.25)
    return found


@pytest.mark.parametrize("ends", [True, False])
@pytest.mark.parametrize("gap", [1e-1, 1e-2, 1e-4, 1e-6])
def test_slow_passages_are_not_more_wrong_than_they_say(
    flights: dict[bool, CompiledLoop], ends: bool, gap: float
) -> None:
    """A ball that only just reaches a ceiling; the nominal one, from which growth is known, flies into it."""
    flight, top = flights[ends], height(APEX, 0.0, UP)
    P = flight.nominal.copy()
    P[flight.layout.slice("plant.ceiling")] = top - gap
    run, met = flight.run(P, 0), instant(top - gap)
    if ends:
        truth = np.array([top - gap, speed(met, UP)])
    else:
        left, w = 2.25 - met, -BACK * speed(met, UP)
        truth = np.array([height(left, top - gap, w), speed(left, w)])
    wrong = float(np.max(np.abs(run.states[:, -1] - truth) / np.maximum(1.0, np.abs(truth))))
    late = abs(run.events[0].time - met) / max(1.0, met)
    assert max(wrong, late) < run.integration_error < 3 * max(wrong, late)


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


def test_accuracy_is_not_asked_of_the_instant_of_a_soft_touchdown() -> None:
    """Braked at 1 m/s^2 to 0.6 um/s at the ground: the error of the instant is told, and no steps are spent on it."""
    model = ball(0.0)
    law = go.feedforward(go.Reference.constant(model, [1.0, 0.0], [G + 1.0]))
    event = Event("touchdown", model.symbol("h"), "falling")
    loop = ClosedLoop(model, law, events=[event], dt=0.1)
    start = [1.0, -np.sqrt(2.0) * (1 + 1e-13)]
    flight = loop.compile(start, tf=2.0)
    ending = flight.final_values(flight.nominal[:, None], [0])
    assert flight.substeps == 1 and ending.outcomes[0].ok and ending.outcomes[0].what == "touchdown"
    late = abs(ending.outcomes[0].time - (np.sqrt(2) * (1 + 1e-13) - np.sqrt(4e-13)))
    assert max(late, 1e-9) < ending.integration_error[0] < 1e-6
    assert ending.state_error[0] < 1e-11


def test_coming_to_rest_is_checked_by_the_states_that_go_on() -> None:
    """At rest on the ground an instant is as uncertain as that of any touch; what rests is not."""
    model = go.Model("ball with a mode")
    h, w, air, mass = (model.state(name) for name in ("h", "w", "air", "mass"))
    model.ode({h: w, w: air * (model.control("a") - G), air: 0.0, mass: 0.0})
    law = go.feedforward(go.Reference.constant(model, [0.0, 0.0, 1.0, 1000.0], [0.0]))
    rest = Event("rest", h, "falling", reset={h: 0.0, w: 0.0, air: 0.0})
    flight = ClosedLoop(model, law, events=[rest], dt=0.1).compile([0.0, 0.0, 1.0, 1000.0], tf=0.5)
    ending = flight.final_values(flight.nominal[:, None], [0])
    assert flight.substeps == 1 and ending.outcomes[0].ok and ending.states[:3, 0].tolist() == [0.0, 0.0, 0.0]
    assert ending.state_error[0] < 1e-13
