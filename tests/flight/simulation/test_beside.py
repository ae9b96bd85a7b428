"""The error of the integration knows how the errors of each run grow, however the nominal run behaves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from testing.internals import ColumnLayout, estimate_integration_errors
from testing.models import dynamics

import gnc_opt as go
from gnc_opt.simulation import ClosedLoop, CompiledLoop, Event, Noise, Quantisation, RunStatus

G = 9.81


def double_pendulum(x: Any, kind: Any = np) -> list[Any]:
    """Rates of two angles and their rates, masses and lengths of 1."""
    a, b, wa, wb = x[0], x[1], x[2], x[3]
    s, c = kind.sin(a - b), kind.cos(a - b)
    down_a, down_b = G * kind.sin(a), G * kind.sin(b)
    rate_a = (-2 * down_a + c * down_b - s * (wb**2 + wa**2 * c)) / (2 - c**2)
    rate_b = (2 * s * wa**2 + 2 * c * down_a - 2 * down_b + s * c * wb**2) / (2 - c**2)
    return [wa, wb, rate_a, rate_b]


def kepler(x: Any, kind: Any = np) -> list[Any]:
    cube = (x[0] ** 2 + x[1] ** 2) ** 1.5
    return [x[2], x[3], -x[0] / cube, -x[1] / cube]


def flight(rates: Callable[..., list[Any]], nominal: list[float], tf: float, **options: Any) -> CompiledLoop:
    """Of a plant without feedback."""
    model = go.Model("plant")
    x, u = model.state("x", len(nominal)), model.control("u")
    model.ode({x: ca.vertcat(*rates(x, ca)) + 0 * u})
    law = go.feedforward(go.Reference.constant(model, nominal, [0.0]))
    return ClosedLoop(model, law, dt=0.1, **options).compile(nominal, tf=tf)


def started(flight: CompiledLoop, x: list[float], *names: str) -> Any:
    P = flight.nominal.copy()
    P[np.concatenate([np.r_[flight.layout.slice(name)] for name in names or ("initial.x",)])] = x
    return P


@pytest.mark.parametrize(
    ("rates", "nominal", "dispersed", "tf"),
    [
        (double_pendulum, [0.1, 0.0, 0.0, 0.0], ([2.5, 2.0, 0.0, 0.0], [3.0, 3.0, 0.0, 0.0]), 6.0),
        (kepler, [1.0, 0.0, 0.0, 1.0], ([1.0, 0.0, 0.0, 0.7], [1.0, 0.0, 0.0, 0.5]), 12.0),
    ],
)
def test_dispersed_runs_are_not_more_wrong_than_they_say(
    rates: Callable[..., list[Any]], nominal: list[float], dispersed: tuple[list[float], ...], tf: float
) -> None:
    """From rest to whirling, from a circle to ellipses; the nominal run alone told up to 1e5 times too little."""
    flown = flight(rates, nominal, tf, substeps=16)
    for start in (nominal, *dispersed):
        run = flown.run(started(flown, start), 0)
        truth = solve_ivp(lambda t, x: rates(x), (0, tf), start, method="DOP853", rtol=2.3e-14, atol=1e-15)
        wrong = np.max(np.abs(run.states[:, -1] - truth.y[:, -1]) / np.maximum(1.0, np.abs(truth.y[:, -1])))
        assert wrong < run.integration_error < 1000 * wrong


@pytest.mark.parametrize(("size", "end"), [(1.0, 20.0), (0.3, 20.0), (1.0, 19.97)])
def test_a_run_whose_slow_mode_is_unstable_does_not_have_the_growth_of_a_stable_one(
    size: float, end: float
) -> None:
    """x follows the square of a swing, x = q^2 exactly, and forgets errors at 1/s; dispersed, it makes them grow by
    exp(14) while those of single steps stay as they were, or are less."""
    model = go.Model("follower")
    q, v, x, u = model.state("q"), model.state("v"), model.state("x"), model.control("u")
    rate = model.parameter("rate", -1.0)
    model.ode({q: v, v: -q, x: rate * (x - q**2) + 2 * q * v + 0 * u})
    law = go.feedforward(go.Reference.constant(model, [0.0, 0.0, 0.0], [0.0]))
    events = [Event("end", model.time - end, "rising")] if end < 20.0 else []
    flown = ClosedLoop(model, law, events=events, dt=0.1, substeps=1).compile([0.0, 1.0, 0.0], tf=20.0)
    P = started(flown, [0.0, size, 0.0], "initial.q", "initial.v", "initial.x")
    P[flown.layout.slice("plant.rate")] = 0.7
    run = flown.run(P, 0)
    truth = np.array([size * np.sin(end), size * np.cos(end), (size * np.sin(end)) ** 2])
    wrong = np.max(np.abs(run.states[:, -1] - truth) / np.maximum(1.0, np.abs(truth)))
    assert wrong < run.integration_error < 1000 * wrong


def test_quanta_that_turn_are_in_the_printed_error() -> None:
    """Commands in steps: some true ways round one the other way, and the second flights with them."""
    model, *_ = dynamics("swing", "a w", "u", lambda a, w, u: {a: w, w: -40 * ca.sin(a) + u})
    law = go.design_lqr(model, [0.0, 0.0], Q=[100.0, 1.0], R=0.01, dt=0.1)
    blocks: dict[str, Any] = {"actuators": [Quantisation("steps", 1e-3)], "sensors": [Noise("gauge", 1e-3)]}
    coarse, fine = (
        ClosedLoop(model, law, **blocks, dt=0.1, substeps=n, accuracy=1e-6).compile([0.5, 0.0], tf=6.0)
        for n in (5, 36)
    )
    P, seeds = np.tile(coarse.nominal[:, None], 200), list(range(200))
    ending, truth = coarse.final_values(P, seeds), fine.final_values(P, seeds).states
    wrong = np.max(np.abs(ending.states - truth) / np.maximum(1.0, np.abs(truth)), axis=0)
    assert np.all(wrong < ending.integration_error)
    turned = wrong > 1e-6
    assert 0 < np.sum(turned) < 10
    assert ending.integration_error[turned] == pytest.approx(4 / 3 * wrong[turned], rel=0.01)
    assert [outcome.ok for outcome in ending.outcomes] == [not turn for turn in turned]


def test_distances_are_relative_and_infinite_where_the_companion_is_lost() -> None:
    """Columns are x (2,), whether an event has ended the run, when, and the rates there (2,)."""
    places = ColumnLayout((("plant", 2), ("stop", 1), ("stop time", 1), ("stop rate", 2)))
    one = np.array([[10.0, 0.1, 0, 0], [10.0, 0.1, 1, 1.0], [1.0, 1.0, 0, 0], [np.nan, 1.0, 0, 0]])
    two = np.array([[10.0, 0.3, 0, 9.0], [12.0, 0.2, 1, 1.5], [np.nan, 1.0, 0, 0], [1.0, 1.0, 0, 0]])
    rates = np.array([[0.0, 0.0], [4.0, 0.1], [0.0, 0.0], [0.0, 0.0]])
    columns = [np.hstack([values, rates]).T for values in (one, two)]
    errors, at_one_time = estimate_integration_errors(places, *columns, 4.0)
    assert 0.75 * errors == pytest.approx([0.2, 0.5, np.inf, np.nan], nan_ok=True)
    assert 0.75 * at_one_time == pytest.approx([0.2, 0.05, np.inf, np.nan], nan_ok=True)
    # an event that only one of both has met ends it so much earlier
    met = np.array([[10.0, 0.1, 1.0, 3.9, 0.0, 0.0]]).T
    assert 0.75 * estimate_integration_errors(places, met, columns[0][:, :1], 4.0)[0] == pytest.approx(
        [0.1 / 3.9]
    )


def test_what_rounding_has_grown_to_is_held_against_the_integration() -> None:
    """exp(t) from 1, unstable."""
    loop = flight(lambda x, kind=np: [x[0]], [1.0], 12.0, substeps=20, accuracy=1e-15)
    run = loop.run(loop.nominal, 0)
    wrong = abs(run.states[0, -1] / np.exp(12.0) - 1)
    assert wrong < run.integration_error and run.outcome.status is RunStatus.INTEGRATION_ERROR
