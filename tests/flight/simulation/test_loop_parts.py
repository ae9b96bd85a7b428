"""What a closed loop is made of: its moments, times, parameters, steps of integration, and its book-keeping."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.loops import controller, double_integrator, feedback, memory_of_impulse, scheduled

from gnc_opt.errors import ArgumentError, UnknownNameError
from gnc_opt.model import Layout, Model, Variable
from gnc_opt.simulation import (
    Bias,
    ClosedLoop,
    Lag,
    Mixer,
    PiecewiseConstantNoise,
    RunStatus,
    Saturation,
    ScaleFactor,
)

DT = 0.1
TWO = Layout("command", (Variable("a", 1, "N"), Variable("b", 2, "N m")))


def idle(plant):
    return feedback(plant, np.zeros((plant.controls.size, plant.states.size)))


def loop_of_all(**options):
    plant = double_integrator(2)
    return ClosedLoop(
        plant, idle(plant), [Lag("lag", 0.2, on="a"), Saturation("cut", -1.0, [2.0, 3.0])],
        Bias("gyro", [0.1, 0.2], on="v"), PiecewiseConstantNoise("gust", 0.5, on="a"),
        **({"dt": 0.4, "minor_steps": 4} | options),
    )  # fmt: skip


def test_what_can_be_dispersed_in_order_with_units_defaults_and_ranges():
    loop = loop_of_all()
    assert [(v.name, v.size, v.unit) for v in loop.layout.variables] == [
        ("plant.m", 1, "kg"), ("initial.q", 2, "m"), ("initial.v", 2, "m/s"), ("lag.tau", 2, "s"),
        ("cut.lower", 2, "N"), ("cut.upper", 2, "N"), ("gyro.bias", 2, "m/s"), ("gust.sigma", 2, "N"),
    ]  # fmt: skip
    assert loop.default_parameters[5:].tolist() == [0.2, 0.2, -1, -1, 2, 3, 0.1, 0.2, 0.5, 0.5]
    assert loop.default_parameters[0] == 1.0 and np.isnan(loop.default_parameters[1:5]).all()
    lower, upper = loop.parameter_ranges
    assert lower.tolist() == [-np.inf] * 5 + [0, 0] + [-np.inf] * 6 + [0, 0]
    assert upper.tolist() == [np.inf] * 15
    assert [(link.block.name, step) for link, step in loop.wiring.blocks_and_step_lengths] == [
        ("lag", pytest.approx(0.1)), ("cut", pytest.approx(0.1)), ("gyro", 0.4), ("gust", 0.4)
    ]  # fmt: skip


def test_values_of_a_run_by_name_or_all_at_once():
    loop = loop_of_all()
    column = loop.parameters([1.0, 2.0, 3.0, 4.0], {"plant.m": 9.0, "initial.v": 5.0, "lag.tau": [0.3, 0.4]})
    assert column[:7].tolist() == [9, 1, 2, 5, 5, 0.3, 0.4]
    assert loop.parameters({"v": [3.0, 4.0], "q": 1.0})[1:5].tolist() == [1, 1, 3, 4]
    assert loop.parameters({"v": 3.0, "q": 1.0}, {"initial.q": 7.0})[1:5].tolist() == [7, 7, 3, 3]
    assert np.isnan(loop.default_parameters[1])
    for x0, changes, message in (
        ([1.0, 2.0], None, "initial state of a run"),
        (None, None, "initial state of a run lacks 'q', 'v'"),
        ([1.0] * 4, {"plant.m": np.nan}, r"'plant\.m' of a run is not a number"),
        ([1.0] * 4, {"lag.tau": [1.0] * 3}, r"parameter 'lag\.tau' of a run"),
        ({"z": 1.0}, None, r"no parameter 'initial\.z'"),
    ):
        with pytest.raises((ArgumentError, UnknownNameError), match=message):
            loop.parameters(x0, changes)


def test_times_that_are_none_are_refused():
    plant = memory_of_impulse()
    loop = ClosedLoop(plant, idle(plant), dt=DT)
    for t0, tf, message in (
        (0, 0, "tf > t0"),
        (0, np.inf, "finite"),
        (np.nan, 1, "finite"),
        (0, 3e5, "too long"),
    ):
        with pytest.raises(ArgumentError, match=message):
            loop.simulate([0.0], t0=t0, tf=tf)


@pytest.mark.parametrize(
    ("rate", "dt", "minor", "steps"),
    [(1.0, 1.0, 1, 1), (31.0, 1.0, 1, 11), (31.0, 1.0, 4, 3), (31.0, 0.25, 1, 3), (8.0, 2.0, 1, 6)],
)
def test_the_fastest_mode_is_integrated_stably(rate, dt, minor, steps):
    """Three times the inverse of the fastest rate to a step, that of the second state; hardly any accuracy is asked."""
    plant = Model("fast")
    x, y, u = plant.state("x"), plant.state("y"), plant.control("u")
    plant.ode({x: -0.1 * x + u, y: rate * y})
    flight = ClosedLoop(plant, idle(plant), dt=dt, minor_steps=minor, accuracy=1.0).compile([0.0, 0.0], tf=dt)
    assert flight.substeps == steps


def test_a_parameter_of_the_run_counts_for_its_fastest_mode():
    plant = Model("fast")
    x, u, k = plant.state("x"), plant.control("u"), plant.parameter("k", 1.0)
    plant.ode({x: -k * x + u})
    loop = ClosedLoop(plant, idle(plant), dt=1.0)
    assert loop.compile([0.0], tf=1.0, parameters={"plant.k": 31.0}).substeps == 11


@pytest.mark.parametrize("accuracy", [1e-4, 1e-7])
def test_hardly_more_steps_are_taken_than_the_accuracy_needs(accuracy):
    plant = Model("pendulum")
    q, v, u = plant.state("q"), plant.state("v"), plant.control("u")
    plant.ode({q: v, v: -4 * ca.sin(q) + u})

    def flight(substeps=None):
        loop = ClosedLoop(plant, idle(plant), dt=0.5, accuracy=accuracy, substeps=substeps)
        return loop.compile([1.0, 0.0], tf=3.0)

    def error(flight):
        return float(flight.final_values(flight.nominal[:, None], [0]).integration_error[0])

    chosen, spared = flight().substeps, accuracy / 10  # for dispersed runs
    assert error(flight(chosen)) <= spared
    assert chosen == 1 or error(flight(chosen // 2)) > spared


def two_commands(values, actuators, **options):
    """Three impulses of what is applied, commanded as a (1) and b (2)."""
    plant = Model("impulses")
    h, u, w = plant.state("h", 3), plant.control("u", 3), plant.control("w")
    plant.ode({h: u + w})
    law = scheduled(plant, lambda t: np.tile(np.array(values, dtype=float)[:, None], t.size), commands=TWO)
    return ClosedLoop(plant, law, actuators, dt=0.5, **options).simulate(np.zeros(3), tf=1.0)


def test_a_limit_is_charged_to_the_components_it_acts_on():
    """As long as signals are the commands themselves; behind a mixer, to all commands that lead to it."""
    together = Mixer("m", np.eye(3), "u")
    cut = [Saturation("s", -1.0, 1.0, on=("a", "b")), together]
    assert two_commands([2.0, 0.5, -3.0], cut).saturation.tolist() == [1, 0, 1]
    assert two_commands([0.5, 1.5, 0.0], cut).saturation.tolist() == [0, 1, 0]
    assert two_commands(
        [2.0, 2.0, 2.0], [Saturation("s", -1.0, 1.0, on="b"), together]
    ).saturation.tolist() == [0, 1, 1]
    behind = [together, Saturation("s", -1.0, 1.0)]
    assert two_commands([2.0, 0.0, 0.0], behind).saturation.tolist() == [1, 1, 1]
    assert two_commands([0.5, 0.0, 0.0], behind).saturation.tolist() == [0, 0, 0]
    apart = [
        Mixer("m", [[1.0]], "w", on="a"),
        Saturation("s", -1.0, 1.0, on="w"),
        Mixer("n", np.ones((3, 2)), "u", on="b"),
    ]
    assert two_commands([2.0, 0.5, 0.5], apart).saturation.tolist() == [1, 0, 0]


def run_of(expression, *, plant=None, tf=1.0, **options):
    plant = plant or double_integrator(2)
    law = controller(
        plant, expression, memory=options.pop("memory", Layout("entry")), alarms=options.pop("alarms", ())
    )
    return ClosedLoop(plant, law, dt=DT, **options).simulate(np.zeros(plant.states.size), tf=tf)


def test_the_first_that_is_not_finite_is_named_in_the_order_of_the_signal():
    late = ca.SX(1.0)
    run = run_of(lambda t, x, r, z: (ca.vertcat(late, ca.if_else(t > 0.45, np.inf, 0.0)), z))
    assert (run.outcome.what, run.outcome.time) == ("command 'a[1]'", pytest.approx(0.5))
    run = run_of(
        lambda t, x, r, z: (ca.vertcat(1e10, ca.if_else(t > 0.45, 1.0, 0.0)), z),
        actuators=[ScaleFactor("k", 1e301)],
    )
    assert (run.outcome.what, run.outcome.time) == ("applied 'a[0]'", 0.0)
    plant = Model("blow")
    x, u = plant.state("x", 2), plant.control("u")
    plant.ode({x: ca.vertcat(u, 1 / x[1])})
    run = run_of(lambda t, x, r, z: (0 * t, z), plant=plant)
    assert (run.outcome.status, run.outcome.what, run.outcome.time) == (
        RunStatus.NOT_FINITE,
        "state 'x[1]'",
        0.0,
    )


def test_runs_are_flown_only_within_the_ranges_of_their_parameters():
    flight = loop_of_all().compile([0.0] * 4, tf=0.4)
    P = flight.nominal.copy()
    assert flight.describe_invalid_parameters(P) == ""
    P[6] = 0.0
    assert flight.describe_invalid_parameters(P) == ""
    P[6] = -0.5
    assert flight.describe_invalid_parameters(P) == "'lag.tau[1]' is -0.5, outside [0, inf]"
    with pytest.raises(ArgumentError, match=r"cannot be simulated: 'lag\.tau\[1\]'"):
        flight.run(P, 0)
    both = flight.final_values(np.column_stack([P, flight.nominal]), [0, 1])
    assert [o.status for o in both.outcomes] == [RunStatus.INVALID_PARAMETERS, RunStatus.OK]
    assert np.isnan(both.states[:, 0]).all() and np.isfinite(both.states[:, 1]).all()
    with pytest.raises(ArgumentError, match=r"parameters of 2 runs have the shape \(15, 1\): give \(15, 2\)"):
        flight.final_values(P[:, None], [0, 1])
    assert flight.n_steps == 1 and flight.minor_steps == 4


def test_plant_and_controller_must_fit():
    plant, law = double_integrator(2), idle(double_integrator(1))
    with pytest.raises(
        ArgumentError, match="state 'q' has 2 components in the plant 'cart' and 1 in controller"
    ):
        ClosedLoop(plant, law, dt=DT)
    small = memory_of_impulse(2)
    for actuators, message in (
        ([Mixer("m", np.eye(2), "b")], "'b' arrives at the plant 'impulse', which has no such control"),
        (
            [Mixer("m", np.ones((3, 2)), "a")],
            "control 'a' has 2 components in the plant 'impulse', but 3 arrive",
        ),
        ([Lag("x", 0.1), Lag("x", 0.1)], "two blocks of the closed loop are called 'x'"),
    ):
        with pytest.raises(ArgumentError, match=message):
            ClosedLoop(small, idle(small), actuators, dt=DT)


def test_a_law_that_solves_equations_is_flown():
    """A function of matrix symbols only: [[1 + t, 1/2], [1/2, 2]] u = (q, 1), of which the first component is -a."""
    plant = memory_of_impulse()

    def expression(t, x, r, z):
        return -ca.solve(ca.blockcat([[1 + t, 0.5], [0.5, 2.0]]), ca.vertcat(x, 1.0))[0], z

    law = controller(plant, expression, symbols=ca.MX)
    run = ClosedLoop(plant, law, dt=0.25).simulate([5.0], tf=1.0)
    q = 5.0
    for k in range(4):
        a = -np.linalg.solve([[1 + 0.25 * k, 0.5], [0.5, 2.0]], [q, 1.0])[0]
        assert run.commands[0, k] == pytest.approx(a)
        q += 0.25 * a
    assert run.states[0, -1] == pytest.approx(q)
