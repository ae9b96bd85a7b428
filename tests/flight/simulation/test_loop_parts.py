"""What a closed loop is made of: its moments, times, parameters, steps of integration, and its book-keeping."""

from __future__ import annotations

import inspect
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from testing.loops import controller, double_integrator, feedback, memory_of_impulse, scheduled

from gnc_opt.errors import ArgumentError, UnknownNameError
from gnc_opt.guidance import Replanner
from gnc_opt.model import Layout, Model, Variable
from gnc_opt.simulation import (
    Bias,
    Block,
    ClosedLoop,
    ConstantDisturbance,
    Disturbance,
    Lag,
    Mixer,
    PiecewiseConstantNoise,
    RandomWalk,
    RunStatus,
    Sampling,
    Saturation,
    ScaleFactor,
)
from gnc_opt.simulation.block import Step
from gnc_opt.simulation.signals import Places

DT = 0.1
TWO = Layout("command", (Variable("a", 1, "N"), Variable("b", 2, "N m")))


@pytest.mark.parametrize(
    ("kind", "free"),
    [
        (ClosedLoop, ["plant", "controller", "actuators", "sensors", "disturbances"]),
        (Replanner, ["resolver", "every"]),
    ],
)
def test_what_goes_by_its_place_and_what_by_its_name_only(kind, free):
    places = inspect.signature(kind).parameters.values()
    assert [p.name for p in places if p.kind is p.POSITIONAL_OR_KEYWORD] == free
    assert {p.kind for p in places if p.name not in free} == {inspect.Parameter.KEYWORD_ONLY}


def idle(plant):
    return feedback(plant, np.zeros((plant.controls.size, plant.states.size)))


# --- the moment that blocks see -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Watching(Block):
    """Adds what it sees of the moment, in digits of their own: 1000 t + 100 h + 10 index + q."""

    def step(self, tick, signal, state, p, noise):
        return Step(signal + 1000 * tick.t + 100 * tick.h + 10 * tick.index + tick.x["q"], state)


def test_actuators_see_every_minor_step_and_sensors_the_control_step():
    plant = memory_of_impulse()
    law = scheduled(plant, lambda t: 0 * t)
    run = ClosedLoop(plant, law, [Watching("w")], dt=0.4, minor_steps=4).simulate([3.0], tf=0.4)
    seen, q = [], 3.0
    for i in range(4):
        seen.append(1000 * 0.1 * i + 100 * 0.1 + 10 * i + q)
        q += 0.1 * seen[-1]
    assert run.applied[0, 0] == pytest.approx(np.mean(seen)) and run.states[0, -1] == pytest.approx(q)
    sensed = ClosedLoop(plant, law, sensors=[Watching("w")], dt=0.4, minor_steps=4).simulate([3.0], tf=0.8)
    assert sensed.measured[0] == pytest.approx([3 + 40 + 3, 3 + 400 + 40 + 3])


@dataclass(frozen=True)
class Ticking(Disturbance):
    """Acts with what its memory saw of the moment: 1000 t + 100 h + q."""

    def start(self, signal, p, tick):
        return ca.SX(1, 1)

    def update(self, tick, state, p, noise):
        return 1000 * tick.t + 100 * tick.h + tick.x["q"]

    def value(self, t, x, state, p):
        return state


def test_disturbances_are_renewed_at_control_steps():
    plant = memory_of_impulse()
    loop = ClosedLoop(plant, idle(plant), disturbances=[Ticking("d", on="q")], dt=0.5, minor_steps=5)
    run = loop.simulate([2.0], t0=1.0, tf=2.0)
    assert run.states[0] == pytest.approx([2.0, 2 + 0.5 * 1052, 528 + 0.5 * (1550 + 528)])


# --- how a loop is described --------------------------------------------------------------------------------


def test_numbers_of_a_loop_are_given_by_keyword():
    found = {n: (p.kind, p.default) for n, p in inspect.signature(ClosedLoop).parameters.items()}
    by_keyword = {
        n: default for n, (kind, default) in found.items() if kind is inspect.Parameter.KEYWORD_ONLY
    }
    assert by_keyword == {
        "dt": None, "minor_steps": 1, "accuracy": 1e-9, "substeps": None, "divergence_limits": 1e15, "events": (),
        "replanner": None, "quantities": (),
    }  # fmt: skip
    assert [found[n][1] for n in ("actuators", "sensors", "disturbances")] == [(), (), ()]
    loop = ClosedLoop(double_integrator(), idle(double_integrator()), dt=DT)
    assert (loop.dt, loop.minor_steps, loop.accuracy, loop.substeps) == (DT, 1, 1e-9, None)


def loop_of_all(**options):
    plant = double_integrator(2)
    return ClosedLoop(
        plant,
        idle(plant),
        [Lag("lag", 0.2, on="a"), Saturation("cut", -1.0, [2.0, 3.0])],
        Bias("gyro", [0.1, 0.2], on="v"),
        PiecewiseConstantNoise("gust", 0.5, on="a"),
        **({"dt": 0.4, "minor_steps": 4} | options),
    )


def test_what_can_be_dispersed_in_order_with_units_defaults_and_ranges():
    loop = loop_of_all()
    assert [(v.name, v.size, v.unit) for v in loop.layout.variables] == [
        ("plant.m", 1, "kg"), ("initial.q", 2, "m"), ("initial.v", 2, "m/s"), ("lag.tau", 2, "s"),
        ("cut.lower", 2, "N"), ("cut.upper", 2, "N"), ("gyro.bias", 2, "m/s"), ("gust.sigma", 2, "N"),
    ]  # fmt: skip
    assert loop.defaults[5:].tolist() == [0.2, 0.2, -1, -1, 2, 3, 0.1, 0.2, 0.5, 0.5]
    assert loop.defaults[0] == 1.0 and np.isnan(loop.defaults[1:5]).all()
    lower, upper = loop.ranges
    assert lower.tolist() == [-np.inf] * 5 + [0, 0] + [-np.inf] * 6 + [0, 0]
    assert upper.tolist() == [np.inf] * 15
    assert [(link.block.name, step) for link, step in loop.wiring.steps_of_links] == [
        ("lag", pytest.approx(0.1)), ("cut", pytest.approx(0.1)), ("gyro", 0.4), ("gust", 0.4)
    ]  # fmt: skip


def test_a_push_on_a_state_has_the_unit_of_its_rate():
    plant = double_integrator()
    loop = ClosedLoop(
        plant,
        idle(plant),
        disturbances=[ConstantDisturbance("c", 1.0, on="v"), ConstantDisturbance("d", 1.0, on="a")],
        dt=DT,
    )
    assert [v.unit for v in loop.layout.variables[-2:]] == ["m/s/s", "N"]


def test_values_of_a_run_by_name_or_all_at_once():
    loop = loop_of_all()
    column = loop.parameters([1.0, 2.0, 3.0, 4.0], {"plant.m": 9.0, "initial.v": 5.0, "lag.tau": [0.3, 0.4]})
    assert column[:7].tolist() == [9, 1, 2, 5, 5, 0.3, 0.4]
    assert loop.parameters({"v": [3.0, 4.0], "q": 1.0})[1:5].tolist() == [1, 1, 3, 4]
    assert loop.parameters({"v": 3.0, "q": 1.0}, {"initial.q": 7.0})[1:5].tolist() == [7, 7, 3, 3]
    assert np.isnan(loop.defaults[1])
    for x0, changes, message in (
        ([1.0, 2.0], None, "initial state of a run"),
        (None, None, r"'initial\.q\[0\]' of a run is not a number"),
        ([1.0] * 4, {"plant.m": np.nan}, r"'plant\.m' of a run is not a number"),
        ([1.0] * 4, {"lag.tau": [1.0] * 3}, r"parameter 'lag\.tau' of a run"),
        ({"z": 1.0}, None, r"no parameter 'initial\.z'"),
    ):
        with pytest.raises((ArgumentError, UnknownNameError), match=message):
            loop.parameters(x0, changes)


@pytest.mark.parametrize(
    ("t0", "tf", "steps"),
    [(0, 1, 10), (0, 0.95, 10), (0, 0.9 + 1e-8, 9), (0, 0.9 + 1e-6, 10), (2, 2.01, 1), (-1, 0, 10)]
)  # fmt: skip
def test_a_run_has_as_many_steps_as_begin_in_its_time(t0, tf, steps):
    plant = memory_of_impulse()
    run = ClosedLoop(plant, idle(plant), dt=DT).simulate([0.0], t0=t0, tf=tf)
    assert run.times == pytest.approx(t0 + DT * np.arange(steps + 1))


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


def test_a_schedule_of_another_shape_is_refused():
    plant = memory_of_impulse()
    law = scheduled(plant, lambda t: np.zeros((2, t.size)))
    with pytest.raises(ArgumentError, match=r"schedule of 'by hand' has the shape \(2, 11\) where \(1, 11\)"):
        ClosedLoop(plant, law, dt=DT).simulate([0.0], tf=1.0)


@pytest.mark.parametrize(
    ("signals", "rows"),
    [
        ((Variable("x_ref", 2),), [0, 1]), ((Variable("s"), Variable("x_ref", 2)), [1, 2]),
        ((Variable("v_ref"), Variable("s"), Variable("q_ref")), [2, 0]),
        ((Variable("q_ref"),), None), ((Variable("x_ref"),), None), ((Variable("s", 2),), None),
    ],
)  # fmt: skip
def test_what_is_followed_is_found_among_the_signals(signals, rows):
    """By the names of all states, or all at once; the reference is logged at the end of the run too."""
    plant, layout = double_integrator(), Layout("signal", signals)
    law = controller(
        plant, lambda t, x, r, z: (0 * x[0], z), signals=layout,
        schedule=lambda times, dt: np.arange(layout.size)[:, None] * 100 + times,
    )  # fmt: skip
    run = ClosedLoop(plant, law, dt=DT).simulate([1.0, 2.0], tf=0.3)
    if rows is None:
        assert run.reference is None and run.errors is None
        return
    assert run.reference == pytest.approx(np.array(rows)[:, None] * 100 + run.times)
    assert run.errors == pytest.approx(run.states - run.reference)


def test_states_that_are_not_measured_have_no_error():
    plant, part = double_integrator(), Model("part")
    q = part.state("q")
    part.ode({q: part.control("a")})
    signals = Layout("signal", (Variable("x_ref"),))
    law = controller(
        part,
        lambda t, x, r, z: (0 * x[0], z),
        signals=signals,
        schedule=lambda times, dt: 0 * times[None, :] + 3,
    )
    run = ClosedLoop(plant, law, dt=DT).simulate([1.0, 0.0], tf=0.3)
    assert run.errors[0] == pytest.approx([-2.0] * 4) and np.isnan(run.errors[1]).all()
    assert run.measured.shape == (1, 3)
    flight = ClosedLoop(plant, law, dt=DT).compile([1.0, 0.0], tf=0.3)
    ending = flight.final(np.tile(flight.nominal[:, None], 2), [0, 1])
    assert ending.errors[0] == pytest.approx([-2.0, -2.0]) and np.isnan(ending.errors[1]).all()


# --- steps of integration -----------------------------------------------------------------------------------


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
        return float(flight.final(flight.nominal[:, None], [0]).integration_error[0])

    chosen, spared = flight().substeps, accuracy / 10  # for dispersed runs
    assert error(flight(chosen)) <= spared
    assert chosen == 1 or error(flight(chosen // 2)) > spared


def test_steps_of_integration_that_are_given_are_taken():
    plant = double_integrator()
    loop = ClosedLoop(plant, idle(plant), dt=DT, substeps=3)
    assert loop.compile([0.0, 0.0], tf=1.0).substeps == 3
    assert loop.kernel(3) is loop.kernel(3) and loop.kernel(4) is not loop.kernel(3)
    for wrong in (0, 1.5):
        with pytest.raises(ArgumentError, match="substeps of a closed loop"):
            ClosedLoop(plant, idle(plant), dt=DT, substeps=wrong)
    with pytest.raises(ArgumentError, match="accuracy of a closed loop"):
        ClosedLoop(plant, idle(plant), dt=DT, accuracy=0.0)


# --- what a run keeps -----------------------------------------------------------------------------------------


def test_parts_of_a_column():
    places = Places((("a", 2), ("none", 0), ("b", 1)))
    assert places.size == 3
    parts = places.split(np.arange(6.0).reshape(3, 2))
    assert {n: v.tolist() for n, v in parts.items()} == {"a": [[0, 1], [2, 3]], "none": [], "b": [[4, 5]]}
    for kind in (ca.SX, ca.MX):
        column = kind.sym("x", 3)
        assert [v.shape for v in places.split(column).values()] == [(2, 1), (0, 1), (1, 1)]
        assert places.join(places.split(column)).shape == (3, 1)


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


def test_sums_are_over_minor_steps_and_all_controls():
    run = two_commands([1.0, -2.0, 3.0], [ScaleFactor("k", 2.0), Mixer("m", np.eye(3), "u")], minor_steps=2)
    assert run.effort.tolist() == [2, 4, 6, 0] and run.energy.tolist() == [4, 16, 36, 0]
    assert run.applied[:, 0].tolist() == [2, -4, 6, 0]
    assert run.states[:, -1] == pytest.approx([2, -4, 6], rel=1e-14)


def test_two_pushes_on_one_place_add_up():
    plant = double_integrator()
    pushes = [ConstantDisturbance("a1", 1.0, on="a"), ConstantDisturbance("a2", 2.0, on="a"),
    ConstantDisturbance("v1", 4.0, on="v"),
              ConstantDisturbance("v2", 8.0, on="v"), ConstantDisturbance("q1", 16.0, on="q")]  # fmt: skip
    run = ClosedLoop(plant, idle(plant), disturbances=pushes, dt=0.5).simulate([0.0, 0.0], tf=0.5)
    assert run.states[:, -1] == pytest.approx([16 * 0.5 + 0.5 * 15 * 0.25, 15 * 0.5])


def test_sensors_pass_in_order_and_only_what_they_act_on():
    plant = double_integrator()
    sensors = [Bias("b", 1.0, on="v"), ScaleFactor("k", [2.0, 3.0])]
    run = ClosedLoop(plant, idle(plant), sensors=sensors, dt=DT).simulate([5.0, 7.0], tf=0.1)
    assert run.measured[:, 0] == pytest.approx([10.0, 24.0])
    with pytest.raises(ArgumentError, match="change names or sizes"):
        ClosedLoop(plant, idle(plant), sensors=[Mixer("m", [[1.0]], "w", on="v")], dt=DT)


def test_memories_of_several_blocks_are_their_own():
    """Two drifts and two slow samples side by side: each component like that of a block alone."""
    plant = memory_of_impulse(2)
    law = scheduled(plant, lambda t: np.ones((2, t.size)))

    def measured(sensors, seed=3):
        return ClosedLoop(plant, law, sensors=sensors, dt=DT).simulate([0.0, 0.0], tf=1.0, seed=seed).measured

    both = measured([Sampling("fast", 0.2), Sampling("slow", 0.3)])
    k = np.arange(10)
    first = 2 * (k // 2) * DT
    assert both[0] == pytest.approx(first[3 * (k // 3)])
    drift = measured([RandomWalk("one", 0.5), RandomWalk("two", 0.5)]) - measured([])
    alone = measured([RandomWalk("one", 0.5)]) - measured([])
    assert np.all(drift[:, 0] == 0) and np.ptp(drift) > 0 and not np.allclose(drift, 2 * alone)


# --- what goes wrong ------------------------------------------------------------------------------------------


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
        lambda t, x, r, z: (ca.vertcat(1.0, ca.if_else(t > 0.45, 1.0, 0.0)), z),
        actuators=[ScaleFactor("k", 1e301)],
    )
    assert (run.outcome.what, run.outcome.time) == ("applied 'a[0]'", 0.0)
    plant = Model("blow")
    x, u = plant.state("x", 2), plant.control("u")
    plant.ode({x: ca.vertcat(u, 1e303)})
    run = run_of(lambda t, x, r, z: (0 * t, z), plant=plant)
    assert (run.outcome.status, run.outcome.what, run.outcome.time) == (
        RunStatus.NOT_FINITE,
        "state 'x[1]'",
        0.0,
    )


def test_alarms_are_named_by_component_and_the_first_one_stays():
    memory = Layout("memory", (Variable("other"), Variable("guard", 2), Variable("last")))
    run = run_of(
        lambda t, x, r, z: (ca.SX.zeros(2), ca.vertcat(1.0, 0.0, t > 0.35, t > 0.15)),
        memory=memory, alarms=("guard", "last"),
    )  # fmt: skip
    assert (run.outcome.what, run.outcome.time) == ("last", pytest.approx(0.2))
    run = run_of(
        lambda t, x, r, z: (ca.SX.zeros(2), ca.vertcat(1.0, 0.0, -(t > 0.15), t > 0.15)),
        memory=memory, alarms=("guard", "last"),
    )  # fmt: skip
    assert (run.outcome.what, run.outcome.time) == ("guard[1]", pytest.approx(0.2))


def test_runs_are_flown_only_within_the_ranges_of_their_parameters():
    flight = loop_of_all().compile([0.0] * 4, tf=0.4)
    P = flight.nominal.copy()
    assert flight.refusal(P) == ""
    P[6] = 0.0
    assert flight.refusal(P) == ""
    P[6] = -0.5
    assert flight.refusal(P) == "'lag.tau[1]' is -0.5, outside [0, inf]"
    with pytest.raises(ArgumentError, match=r"cannot be flown: 'lag\.tau\[1\]'"):
        flight.run(P, 0)
    both = flight.final(np.column_stack([P, flight.nominal]), [0, 1])
    assert [o.status for o in both.outcomes] == [RunStatus.INVALID_PARAMETERS, RunStatus.OK]
    assert np.isnan(both.states[:, 0]).all() and np.isfinite(both.states[:, 1]).all()
    with pytest.raises(ArgumentError, match=r"parameters of 2 runs have the shape \(15, 1\): give \(15, 2\)"):
        flight.final(P[:, None], [0, 1])
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
        (["lag"], "one of the actuators of a closed loop is a str"),
    ):
        with pytest.raises(ArgumentError, match=message):
            ClosedLoop(small, idle(small), actuators, dt=DT)
    with pytest.raises(ArgumentError, match="one of the disturbances of a closed loop is a Lag"):
        ClosedLoop(small, idle(small), disturbances=[Lag("x", 0.1)], dt=DT)


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


def test_columns_of_a_step_have_one_place_for_everything():
    """Two states, a memory of three, one command, two controls; a lag, and a walk of two random numbers a step."""
    plant = Model("two")
    q, a, b = plant.state("q", 2), plant.control("a"), plant.control("b")
    plant.ode({q: ca.vertcat(a, b)})
    signals, memory = Layout("signal", (Variable("r", 2),)), Layout("entry", (Variable("z", 3),))
    commands = Layout("command", (Variable("a"),))
    law = controller(plant, lambda t, x, r, z: (r[0], z), signals=signals, memory=memory, commands=commands)
    blocks = [Lag("lag", 0.2), PiecewiseConstantNoise("gust", 0.1, on="a")]
    loop = ClosedLoop(plant, law, blocks[:1], [RandomWalk("drift", 0.1)], blocks[1:], dt=0.4, minor_steps=2)
    kernel = loop.kernel(1)
    once = (
        "steps",
        "fault",
        "fault time",
        "divergence",
        "divergence time",
        "alarm",
        "alarm time",
    )
    sizes = dict(kernel.state.parts)
    assert {n: sizes[n] for n in once} == dict.fromkeys(once, 1)
    assert {n: s for n, s in sizes.items() if n not in once} == {
        "plant": 2, "sensor 0": 2, "actuator 0": 1, "push 0": 2, "memory": 3, "command": 1, "effort": 2, "energy": 2,
        "saturation": 1, "variation": 1,
    }  # fmt: skip
    assert dict(kernel.known.parts) == {"t": 1, "r": 2, "sensor 0": 2, "actuator 0": 0, "push 0": 1}
    assert dict(kernel.log.parts) == {"measured": 2, "commands": 1, "applied": 2}
    assert kernel.step.size_in(0) == (sum(sizes.values()), 1) == kernel.start.size_out(0)


def test_a_run_logs_every_control_step_unless_told_otherwise():
    flight = ClosedLoop(double_integrator(), idle(double_integrator()), dt=DT).compile([1.0, 0.0], tf=0.5)
    columns = flight.nominal
    assert flight.run(columns, 0).state("q").times == pytest.approx(DT * np.arange(6))
    assert flight.run(columns, 0, every=2).state("q").times == pytest.approx([0.0, 0.2, 0.4, 0.5])
