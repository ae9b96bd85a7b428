"""What cannot be meant is refused where it is written, in one sentence; what may not be meant is told."""

from __future__ import annotations

import functools
import math
from typing import Any

import casadi as ca
import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.analysis import LoopResponse, loop_response
from gnc_opt.simulation import ClosedLoop, ConstantDisturbance, Event, Noise, monte_carlo

BALL = go.Model("ball")
H, W = BALL.state("h", unit="m"), BALL.state("w", unit="m/s")
T, G = BALL.control("T"), BALL.parameter("g", 10.0)
BALL.ode({H: W, W: T - G})
START = {"h": 1.0, "w": 0.0}


@functools.lru_cache
def law() -> Any:
    return go.feedforward(go.Reference.constant(BALL, [0.0, 0.0], [10.0]))


def loop(*events: Any, **more: Any) -> ClosedLoop:
    return ClosedLoop(BALL, law(), **({"dt": 0.1, "events": events} | more))


def fly(x0: Any = None, **more: Any) -> Any:
    return loop().simulate(START if x0 is None else x0, **({"tf": 0.2} | more))


def campaign(**more: Any) -> Any:
    return monte_carlo(loop(), 2, **({"x0": START, "tf": 0.2, "executor": "serial"} | more))


@pytest.mark.parametrize(
    ("expression", "what"),
    [
        (H < 0.5, "of event 'e' is discontinuous at zero"),
        (ca.sign(H), "of event 'e' is discontinuous"),
        (ca.SX(1.0), "depends neither on a state nor on the time"),
        (G - 1.0, "depends neither on a state nor on the time"),
    ],
)
def test_an_event_that_never_passes_through_zero(expression: Any, what: str) -> None:
    with pytest.raises(go.ArgumentError, match=what):
        loop(Event("e", expression, "rising"))


@pytest.mark.parametrize(
    ("made", "what"),
    [
        (lambda: loop(events=None), "the events of a closed loop are None: give a list"),
        (lambda: loop(actuators=3), "the actuators of a closed loop are 3: give a list"),
        (lambda: loop(quantities=None), "the quantities of a closed loop are None"),
        (
            lambda: loop(sensors=[ConstantDisturbance("push", 0.1, on="w")]),
            "'push' is a disturbance, not an actuator",
        ),
        (lambda: Event("e", H, failure="yes"), "failure of event 'e' must be of type bool, not str"),  # type: ignore[arg-type]
        (lambda: fly([1.0, math.inf]), "'initial.w' of a run is not a number .it is inf"),
        (lambda: fly(tf=[0.2, 0.4]), "tf of a run is given 2 values"),
        (lambda: fly(parameters=[1.0]), "parameters must be of type Mapping, not list"),
        (lambda: fly(seed="a"), "the seed of a run is 'a': give an integer >= 0"),
        (lambda: fly(seed=1.5), "the seed of a run is 1.5"),
        (lambda: fly(seed=-1), "the seed of a run is -1"),
        (lambda: fly(seed=None), "the seed of a run is None"),
        (lambda: campaign(limits=["h"]), "the limits of runs must be of type Mapping, not list"),
        (lambda: campaign(measures={"h": lambda runs: runs.states[0]}), "has a measure 'h' already"),
        (lambda: campaign(measures={"x": lambda runs: ["a", "b"]}), "'x' returns no numbers .ValueError"),
        (lambda: campaign(target={"h": math.nan}), "the target of 'h' is .nan.: give finite numbers"),
    ],
)
def test_refused(made: Any, what: str) -> None:
    with pytest.raises(go.ArgumentError, match=what):
        made()


def test_several_numbers_are_a_seed() -> None:
    noisy = loop(sensors=[Noise("n", 0.1, on="h")])
    first, again, other = (noisy.simulate(START, tf=0.2, seed=s) for s in ([1, 2], [1, 2], np.int64(3)))
    assert np.array_equal(first.measured, again.measured) and not np.array_equal(
        first.measured, other.measured
    )


@functools.lru_cache
def response() -> LoopResponse:
    regulator = go.design_lqr(BALL, [0.0, 0.0], Q=1, R=1, dt=0.1)
    return loop_response(ClosedLoop(BALL, regulator), x0=[0.1, 0.0], tf=1.0, at=[0.0, 0.5])


@pytest.mark.parametrize(
    ("asked", "what"),
    [
        (lambda: response().margins(2), "no instant 2: the response has 2, from 0 on"),
        (lambda: response().poles(-1), "index of an instant is -1"),
        (lambda: response().sensitivity([1.0], 0.5), "index of an instant is 0.5"),
        (lambda: response().open_loop([0.0]), "has a pole at one of the frequencies"),
    ],
)
def test_responses_that_there_are_not(asked: Any, what: str) -> None:
    """The plant is a double integrator: at the frequency 0 the open loop has no bound."""
    with pytest.raises(go.ArgumentError, match=what):
        asked()
