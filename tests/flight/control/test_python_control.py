"""Plants and laws in python-control do what they do here."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.models import dynamics

import gnc_opt as go
from gnc_opt.analysis import loop_response
from gnc_opt.control import ErrorDynamics
from gnc_opt.errors import GncOptError
from gnc_opt.simulation import ClosedLoop

STEP = 0.1


def python_control() -> Any:
    """The package; not the folder of these tests, which has its name."""
    pytest.importorskip("control.statesp", reason="needs python-control, of the extra control")
    return import_module("control")


@pytest.fixture(scope="module")
def cart() -> go.Model:
    model = go.Model("cart with drag, mark 1.2")
    r, v = model.state("r", 2, unit="m"), model.state("v", 2, unit="m/s")
    force, mass = model.control("F", 2, unit="N"), model.parameter("mass", 2.0, unit="kg")
    model.ode({r: v, v: (force - 0.4 * v) / mass})
    model.output("range", ca.sqrt(ca.sumsqr(r) + 1.0), unit="m")
    return model


@pytest.fixture(scope="module")
def regulator(cart: go.Model) -> go.Controller:
    weights: dict[str, Any] = {"Q": np.ones(4), "R": np.ones(2)}
    return go.design_lqr(cart, np.zeros(4), **weights, dt=STEP, integral={"r": 0.2}, limits=(-1.0, 1.0))


def test_without_the_package_the_remedy_is_told(cart: go.Model, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(GncOptError, match=r"control is not installed: pip install 'gnc_opt\[control\]'"):
        ErrorDynamics(cart).to_control(0.0, np.zeros(4), np.zeros(2))


def test_linear_plant(cart: go.Model) -> None:
    control = python_control()
    plant = ErrorDynamics(cart).to_control(0.0, np.zeros(4), np.zeros(2))
    assert plant.isctime() and isinstance(plant, control.StateSpace)
    assert plant.state_labels == plant.output_labels == ["r[0]", "r[1]", "v[0]", "v[1]"]
    assert plant.input_labels == ["F[0]", "F[1]"]
    for s in (1j, 2.0 + 1j):  # r(s) = F / (s (m s + 0.4))
        np.testing.assert_allclose(plant(s)[:2], np.eye(2) / (s * (2.0 * s + 0.4)), rtol=1e-12, atol=1e-15)


def test_the_law_gives_the_same_commands(cart: go.Model, regulator: go.Controller) -> None:
    control = python_control()
    system = regulator.to_control()
    assert system.dt == STEP and system.input_labels == list(cart.states.labels)
    times = STEP * np.arange(20)
    measured = np.random.default_rng(1).normal(size=(4, 20))
    start = regulator.initial_memory(0.0, measured[:, 0])[: system.nstates]
    found = control.input_output_response(system, times, measured, start)
    z, expected = None, []
    for k, t in enumerate(times):
        u, z = regulator(t, measured[:, k], z)
        expected.append(u)
    np.testing.assert_allclose(found.outputs, np.transpose(expected), rtol=1e-12, atol=1e-13)


def test_the_closed_loop_has_the_poles_of_the_design(cart: go.Model, regulator: go.Controller) -> None:
    control = python_control()
    plant = ErrorDynamics(cart).to_control(0.0, np.zeros(4), np.zeros(2), dt=STEP)
    law = regulator.to_control()
    law = law.linearize(np.zeros(law.nstates), np.zeros(4))
    poles = control.feedback(plant, law, sign=1).poles()  # u = u_ff - K e: the law brings its own minus
    designed = np.asarray(regulator.explain()["sampled poles"])
    distances = np.abs(poles[:, None] - designed)
    rows, columns = scipy.optimize.linear_sum_assignment(distances)
    assert poles.size == designed.size == 6
    assert np.max(distances[rows, columns]) < 1e-5  # of the package's differences, 1e-6


def test_a_law_without_memory(cart: go.Model) -> None:
    python_control()
    weights: dict[str, Any] = {"Q": np.ones(4), "R": np.ones(2)}
    continuous = go.design_lqr(cart, np.zeros(4), **weights)
    with pytest.raises(go.ArgumentError, match="fits any control step"):
        continuous.to_control()
    system = continuous.to_control(0.5)
    assert (system.nstates, system.dt) == (0, 0.5)
    x = np.array([1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(system.output(0.0, np.zeros(0), x), continuous(0.0, x, dt=0.5)[0], rtol=1e-14)


def test_a_plant_of_python_control_becomes_a_model() -> None:
    """Its regulator is that of python-control."""
    control = python_control()
    plant = control.ss([[0.0, 1.0], [-2.0, -0.3]], [[0.0], [0.5]], np.eye(2), 0)
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u")
    model = go.Model.from_casadi("plant", x, u, plant.A @ x + plant.B @ u)
    law = go.design_lqr(model, np.zeros(2), Q=np.ones(2), R=np.ones(1))
    gain = law.explain()["gain"]
    np.testing.assert_allclose(gain, control.lqr(plant, np.eye(2), np.eye(1))[0], rtol=1e-9)


def test_frequency_response_and_margins_are_those_of_python_control(cart: go.Model) -> None:
    """A loop with one command: open loop, sensitivity, gain, phase and disk margins."""
    control = python_control()
    single, *_ = dynamics("cart", "r v", "F", lambda r, v, force: {r: v, v: (force - 0.4 * v) / 2.0})
    regulator = go.design_lqr(single, np.zeros(2), Q=np.ones(2), R=[1.0], dt=STEP, limits=(-10.0, 10.0))
    response = loop_response(ClosedLoop(single, regulator, dt=STEP), x0=[0.1, 0.0], tf=1.0)
    plant = ErrorDynamics(single).to_control(0.0, np.zeros(2), np.zeros(1), dt=STEP)
    law = regulator.to_control()
    law = law.linearize(np.zeros(law.nstates), np.zeros(2))
    loop = -law * plant  # u = u_ff - K e: the law brings its own minus
    omega = np.geomspace(0.05, 0.99 * np.pi / STEP, 40)
    found = loop(np.exp(1j * omega * STEP))
    np.testing.assert_allclose(response.open_loop(omega)[:, 0, 0], found, rtol=1e-4)
    np.testing.assert_allclose(response.sensitivity(omega)[:, 0, 0], 1 / (1 + found), rtol=1e-4)
    ours, phase = response.margins(), control.stability_margins(loop)[1]
    # The phase is -180 degrees at half the sampling rate only, which the package's margins leave out.
    assert ours.gain_up[0] == pytest.approx(-1 / loop(-1).real, rel=1e-4)
    assert np.max(np.abs(control.feedback(ours.gain_up[0] * loop).poles())) == pytest.approx(1.0, abs=1e-5)
    assert np.degrees(ours.phase[0]) == pytest.approx(phase, rel=1e-4)
    if hasattr(control, "disk_margins"):  # since 0.10.2
        fine = np.geomspace(0.05, 0.999 * np.pi / STEP, 4000)
        assert ours.disk == pytest.approx(control.disk_margins(loop, fine)[0], rel=1e-3)
