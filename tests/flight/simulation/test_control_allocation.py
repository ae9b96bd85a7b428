"""Allocation to wheels and thrusters, and the momentum the wheels take."""

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import linprog
from testing.internals import (
    _limit_null_space_torque,
    find_null_space_vector,
    minimise_peak_along_null_vector,
    pseudo_inverse,
)
from testing.loops import memory_of_impulse, scheduled

from gnc_opt.errors import DesignError
from gnc_opt.model import Layout, Model, Variable
from gnc_opt.simulation import Allocation, ClosedLoop, Mixer, WheelArray, thruster_effects
from gnc_opt.spacecraft import total_momentum, wheel_body_acceleration

PYRAMID = np.array([[1, -1, -1, 1], [1, 1, -1, -1], [1, 1, 1, 1]]) / np.sqrt(3)
INERTIA = np.array([4.0, 4.0, 3.0])


def fly(blocks, command, *, tf=1.0, size=3, dt=0.1, **options):
    plant = memory_of_impulse(size)
    return ClosedLoop(plant, scheduled(plant, command), blocks, dt=dt, **options).simulate(
        np.zeros(size), tf=tf
    )


def wheel_plant(axes=PYRAMID):
    plant = Model("spacecraft")
    omega = plant.state("omega", 3, unit="rad/s")
    momenta = plant.state("h", 4, unit="N m s")
    torques = plant.control("T_w", 4, unit="N m")
    rate = wheel_body_acceleration(INERTIA, axes, omega, momenta, torques, ca.DM.zeros(3))
    plant.ode({omega: rate, momenta: -torques})
    return plant


def test_pyramid_pseudo_inverse_and_null_vector():
    inverse = pseudo_inverse(PYRAMID)
    printed = 3 / (4 * np.sqrt(3)) * np.array([[1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1]])
    assert inverse == pytest.approx(printed, abs=1e-15)
    assert PYRAMID @ inverse == pytest.approx(np.eye(3), abs=1e-15)
    n = find_null_space_vector(PYRAMID)
    assert n * np.sign(n[0]) == pytest.approx([1, -1, 1, -1], abs=1e-14)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_whether_actuators_span_all_axes_does_not_depend_on_units(unit):
    assert pseudo_inverse(unit * PYRAMID) == pytest.approx(pseudo_inverse(PYRAMID) / unit, rel=1e-12)
    flat = np.array([[1.0, 0, 1], [0, 1, 1], [0, 0, 0]])
    with pytest.raises(DesignError, match="span 2 of 3 directions"):
        pseudo_inverse(unit * flat)


def test_null_vector_leaves_alone_what_no_other_actuator_can_undo():
    """Two wheels along x, one 1.5 times as strong, can work against each other; those along y and z cannot."""
    axes = np.array([[1.5, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0]])
    n = find_null_space_vector(axes)
    assert n / n[3] == pytest.approx([-1 / 1.5, 0, 0, 1], abs=1e-15)
    assert np.all(n[[1, 2]] == 0) and np.max(n) == 1.0
    assert find_null_space_vector(axes, (1,)) == pytest.approx(n, abs=1e-15)
    assert find_null_space_vector(axes, (0,)) is None
    with pytest.raises(DesignError, match="2 null directions"):
        find_null_space_vector(np.hstack([axes, axes[:, :1]]))


@pytest.mark.parametrize("lost", range(4))
def test_three_wheels_left_still_span_all_axes(lost):
    inverse = pseudo_inverse(PYRAMID, (lost,))
    assert PYRAMID @ inverse == pytest.approx(np.eye(3), abs=1e-14)
    assert np.all(inverse[lost] == 0) and find_null_space_vector(PYRAMID, (lost,)) is None
    rest = np.delete(PYRAMID, lost, axis=1)
    assert abs(np.linalg.det(rest)) == pytest.approx(4 / (3 * np.sqrt(3))) and np.linalg.cond(
        rest
    ) == pytest.approx(2)


def test_two_wheels_left_are_refused_with_numbers():
    with pytest.raises(DesignError, match=r"2 actuators after the loss of 0, 1 span 2 of 3 directions"):
        WheelArray("wheels", PYRAMID, failed=(0, 1))
    with pytest.raises(DesignError, match="has no actuator 4"):
        WheelArray("wheels", PYRAMID, failed=(4,))


@pytest.mark.parametrize("n", [[1.0, -1.0, 1.0, -1.0], [1.0, 0.3, -0.7, 0.0], [0.2, 1.0, 0.9, -0.5]])
def test_min_max_shift_is_the_linear_programme(n):
    n = np.array(n)
    u = ca.SX.sym("u", 4)
    shift = ca.Function("shift", [u], [minimise_peak_along_null_vector(u, n)])
    for torque in np.random.default_rng(1).normal(size=(30, 4)):
        peak = np.max(np.abs(torque + float(shift(torque)) * n))
        rows = np.vstack([np.column_stack([n, -np.ones(4)]), np.column_stack([-n, -np.ones(4)])])
        best = linprog([0, 1], A_ub=rows, b_ub=np.concatenate([-torque, torque]), bounds=(None, None))
        assert peak == pytest.approx(best.fun, abs=1e-9)


@pytest.mark.parametrize("method", ["pseudo-inverse", "min-max"])
def test_allocation_and_mixer_give_the_command(method):
    command = np.random.default_rng(0).normal(size=(3, 10))
    blocks = [Allocation("wheels", PYRAMID, "T_w", method), Mixer("body", PYRAMID, "a", on="T_w")]
    run = fly(blocks, lambda t: command[:, np.round(t / 0.1).astype(int) % 10])
    assert run.applied == pytest.approx(command, abs=1e-14)


def test_min_max_lowers_the_peak_as_the_closed_form_says():
    plant = memory_of_impulse(4)
    commands = Layout("command", (Variable("T_B", 3),))
    torque = np.array([[0.3], [0.2], [-0.1]])
    loops = [
        ClosedLoop(
            plant,
            scheduled(plant, lambda t: np.tile(torque, t.size), commands=commands),
            [Allocation("wheels", PYRAMID, "a", method)],
            dt=0.1,
        )
        for method in ("pseudo-inverse", "min-max")
    ]
    least, flat = (loop.simulate(np.zeros(4), tf=0.1).applied[:, 0] for loop in loops)
    n = np.array([1, -1, 1, -1])
    assert flat == pytest.approx(least - (np.max(n * least) + np.min(n * least)) / 2 * n, abs=1e-14)
    assert np.max(np.abs(flat)) < np.max(np.abs(least))


def test_wheel_torque_limit_and_an_unknown_loss():
    wheels = WheelArray("wheels", PYRAMID, max_torque=0.1)
    run = fly([wheels], lambda t: np.tile([[1.0], [0.0], [0.0]], t.size))
    clipped = np.clip(pseudo_inverse(PYRAMID) @ [1.0, 0, 0], -0.1, 0.1)
    assert run.applied[:, 0] == pytest.approx(PYRAMID @ clipped)
    assert run.saturation_time("a") == pytest.approx(1.0)
    plant = memory_of_impulse(3)
    loop = ClosedLoop(plant, scheduled(plant, lambda t: np.tile([[0.1], [0], [0]], t.size)), [wheels], dt=0.1)
    lame = loop.simulate(np.zeros(3), tf=0.1, parameters={"wheels.health": [0, 1, 1, 1]})
    assert lame.applied[:, 0] == pytest.approx(PYRAMID[:, 1:] @ (pseudo_inverse(PYRAMID) @ [0.1, 0, 0])[1:])


def test_wheel_momentum_limit_stops_exactly_there():
    wheels = WheelArray("wheels", PYRAMID, max_momentum=0.25)
    run = fly([wheels], lambda t: np.tile([[0.4], [0.0], [0.0]], t.size), tf=3.0, minor_steps=2)
    # the body gets what the wheels can store: four wheels with 0.25 each along +-x
    assert run.states[0, -1] == pytest.approx(4 * 0.25 / np.sqrt(3), abs=1e-14)
    assert np.max(run.states[0]) <= 1 / np.sqrt(3) + 1e-14 and np.all(run.applied[0] >= -1e-14)


def test_balancing_keeps_momenta_flat_without_effect_on_the_body():
    def command(t):
        return np.vstack([0.3 * np.sin(t), 0.2 * np.cos(2 * t), 0.1 + 0 * t])

    commands = Layout("command", (Variable("T_B", 3),))
    runs = {}
    for balance in ("none", "torque", "momentum"):
        plant = wheel_plant()
        wheels = WheelArray("wheels", PYRAMID, balance=balance, momenta="h", to="T_w")
        law = scheduled(plant, command, commands=commands)
        runs[balance] = ClosedLoop(plant, law, [wheels], dt=0.1, accuracy=1e-8).simulate(np.zeros(7), tf=10.0)
    for run in runs.values():
        assert PYRAMID @ run.applied == pytest.approx(command(run.times[:-1]), abs=1e-12)
        assert run.state("omega").values == pytest.approx(runs["none"].state("omega").values, abs=1e-12)
    n = np.array([1, -1, 1, -1])
    assert n @ runs["none"].state("h").values == pytest.approx(0.0, abs=1e-12)
    spread = n[:, None] * runs["momentum"].state("h").values
    assert np.max(spread, axis=0) == pytest.approx(-np.min(spread, axis=0), abs=1e-12)
    peak = {k: np.max(np.abs(r.state("h").values)) for k, r in runs.items()}
    assert peak["momentum"] < peak["none"]
    assert np.max(np.abs(runs["torque"].applied)) < np.max(np.abs(runs["none"].applied))


def test_total_momentum_is_conserved():
    plant = wheel_plant()
    commands = Layout("command", (Variable("T_B", 3),))
    law = scheduled(
        plant, lambda t: np.vstack([0.3 * np.sin(t), 0.2 * np.cos(2 * t), 0.1 + 0 * t]), commands=commands
    )
    wheels = WheelArray("wheels", PYRAMID, 0.15, 1.0, balance="momentum", momenta="h", to="T_w")
    loop = ClosedLoop(plant, law, [wheels], dt=0.1, substeps=16)
    at_rest = loop.simulate(np.zeros(7), tf=60.0)
    momentum = total_momentum(INERTIA, PYRAMID, at_rest.state("omega").values, at_rest.state("h").values)
    assert np.max(np.abs(momentum)) < 1e-12
    assert np.max(at_rest.saturation_time("T_B")) > 1.0  # also while wheels are at their limits
    spinning = loop.simulate([0.02, -0.03, 0.05, 0.1, -0.2, 0.0, 0.1], tf=60.0)
    momentum = total_momentum(INERTIA, PYRAMID, spinning.state("omega").values, spinning.state("h").values)
    length = np.linalg.norm(momentum, axis=0)
    assert np.max(np.abs(length - length[0])) < 1e-12
    assert np.max(np.abs(spinning.state("h").values)) <= 1.0 + 1e-12


def test_momenta_the_plant_does_not_have_are_named():
    plant = memory_of_impulse(3)
    law = scheduled(plant, lambda t: np.zeros((3, t.size)))
    loop = ClosedLoop(plant, law, [WheelArray("wheels", PYRAMID, momenta="h_w")], dt=0.1)
    with pytest.raises(DesignError, match="'wheels' looks for its momenta in state 'h_w'"):
        loop.simulate(np.zeros(3), tf=1.0)


def twelve_thrusters():
    """Two pairs per axis, each pair beside the axis, so that forces and torques can be told apart."""
    positions, directions = [], []
    for axis in range(3):
        for sign in (1.0, -1.0):
            for side in (1.0, -1.0):
                positions.append(side * np.eye(3)[(axis + 1) % 3])
                directions.append(sign * np.eye(3)[axis])
    return thruster_effects(np.array(positions).T, np.array(directions).T)


def test_thrusters_push_only_and_give_the_command():
    effects, both = twelve_thrusters(), ("F_B", "T_B")
    command = np.random.default_rng(2).normal(size=(6, 10))
    plant = Model("body")
    force, torque = plant.control("F_B", 3, unit="N"), plant.control("T_B", 3, unit="N m")
    v, h = plant.state("p", 3), plant.state("l", 3)
    plant.ode({v: force, h: torque})
    law = scheduled(plant, lambda t: command[:, np.round(t / 0.1).astype(int) % 10])
    blocks = [
        Allocation("jets", effects, "thrusts", "non-negative", unit="N", on=both),
        Mixer("body", effects, dict.fromkeys(both, 3), on="thrusts"),
    ]
    run = ClosedLoop(plant, law, blocks, dt=0.1).simulate(np.zeros(6), tf=1.0)
    assert run.applied == pytest.approx(command, abs=1e-12)
    thrusts_plant = Model("thrusts")
    u = thrusts_plant.control("thrusts", 12, unit="N")
    thrusts_plant.ode({thrusts_plant.state("impulse", 12): u})
    commands = Layout("command", (Variable("F_B", 3), Variable("T_B", 3)))
    law = scheduled(
        thrusts_plant, lambda t: command[:, np.round(t / 0.1).astype(int) % 10], commands=commands
    )
    thrusts = ClosedLoop(thrusts_plant, law, blocks[:1], dt=0.1).simulate(np.zeros(12), tf=1.0).applied
    assert np.all(thrusts >= 0) and effects @ thrusts == pytest.approx(command, abs=1e-12)


def test_thrusters_that_cannot_push_back_are_refused():
    with pytest.raises(DesignError, match=r"'jets' cannot produce component 0 of its command with sign -"):
        effects = thruster_effects(
            np.zeros((3, 5)), np.array([[1, 0, 0, 0, 0], [0, 1, -1, 0, 0], [0, 0, 0, 1, -1]])
        )
        Allocation("jets", effects[:3], method="non-negative")


@pytest.mark.parametrize(("asked", "given"), [(3.0, 0.55), (0.5, 0.5), (-0.4, -0.4), (-3.0, -0.45)])
def test_a_shift_along_the_null_space_stops_where_the_first_torque_meets_its_limit(asked, given):
    """0.2 + s/2 and 0.1 - 2 s within 1: s from -2.4 to 1.6 for the first, from -0.45 to 0.55 for the second."""
    found = _limit_null_space_torque(ca.SX(asked), ca.SX([0.2, 0.1]), np.r_[0.5, -2.0], ca.SX([1.0, 1.0]))
    assert float(ca.DM(ca.evalf(found))) == pytest.approx(given, rel=1e-14)
