"""Gains, frequency responses and margins are those of python-control."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import casadi as ca
import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.analysis import loop_response
from gnc_opt.control import ErrorDynamics
from gnc_opt.simulation import ClosedLoop

STEP = 0.1


def python_control() -> Any:
    """The package; not the folder of these tests, which has its name."""
    pytest.importorskip("control.statesp", reason="needs python-control")
    return import_module("control")


def test_a_plant_of_python_control_becomes_a_model() -> None:
    """Its regulator is that of python-control."""
    control = python_control()
    plant = control.ss([[0.0, 1.0], [-2.0, -0.3]], [[0.0], [0.5]], np.eye(2), 0)
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u")
    model = go.Model.from_casadi("plant", x, u, plant.A @ x + plant.B @ u)
    law = go.design_lqr(model, np.zeros(2), Q=np.ones(2), R=np.ones(1))
    gain = law.explain()["gain"]
    np.testing.assert_allclose(gain, control.lqr(plant, np.eye(2), np.eye(1))[0], rtol=1e-9)


def test_frequency_response_and_margins_are_those_of_python_control() -> None:
    """A loop with one command: open loop, sensitivity, gain, phase and disk margins."""
    control = python_control()
    single = go.Model("cart")
    r, v, force = single.state("r"), single.state("v"), single.control("F")
    single.ode({r: v, v: (force - 0.4 * v) / 2.0})
    regulator = go.design_lqr(single, np.zeros(2), Q=np.ones(2), R=[1.0], dt=STEP, limits=(-10.0, 10.0))
    response = loop_response(ClosedLoop(single, regulator, dt=STEP), x0=[0.1, 0.0], tf=1.0)
    a, b = ErrorDynamics(single).linearize(0.0, np.zeros(2), np.zeros(1))
    plant = control.sample_system(control.ss(a, b, np.eye(2), 0), STEP)
    loop = control.ss(plant.A, plant.B, regulator.explain()["gain"], 0, STEP)
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
