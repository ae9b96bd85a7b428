"""The flexible spacecraft of Taei and Moradi 2023: plant facts, energy, momentum and an open-loop manoeuvre."""

import casadi as ca
import numpy as np
import pytest
from testing.flows import flow

from gnc_opt.errors import ModelError
from gnc_opt.model.casadi_function_evaluation import build_single_point_evaluator
from gnc_opt.spacecraft import FlexibleBody, quaternion_rate

COUPLING = [
    [6.45637, -1.25619, 1.11687, 1.23637],
    [1.27814, 0.91756, 2.48901, -2.6581],
    [2.15629, -1.67264, -0.83674, -1.12503],
]
ROUNDED = FlexibleBody([100, 75, 50], COUPLING, [0.7, 1.0, 1.8, 2.5], [0.0056, 0.0086, 0.0128, 0.0252])
FULL = FlexibleBody([100, 75, 50], COUPLING, [0.7681, 1.1038, 1.8733, 2.5496], [0.0056, 0.0086, 0.013, 0.025])
START = np.concatenate([[0.02, -0.03, 0.04], [0.05, -0.02, 0.01, 0.02], [0.01, 0.02, -0.03, 0.01]])


def split(y):
    return y[:3], y[3:7], y[7:11]


def rate(body, torque=(0.0, 0.0, 0.0)):
    y = ca.SX.sym("y", 15)
    turning, bending = body.accelerations(y[:3], y[3:7], y[7:11], ca.DM(torque))
    f = ca.Function("f", [y], [ca.vertcat(turning, y[7:11], bending, quaternion_rate(y[11:], y[:3]))])
    evaluate = build_single_point_evaluator(f)
    return lambda _, value: evaluate(value)


def test_plant_facts():
    np.testing.assert_allclose(
        np.linalg.eigvalsh(ROUNDED.rigid_inertia), [31.0148, 56.8671, 65.93], atol=1e-3
    )
    masses = np.linalg.eigvalsh(ROUNDED.mass_matrix)
    assert (masses[0], masses[-1]) == pytest.approx((0.41711, 100.4634), abs=1e-3)
    effect = np.diag(np.linalg.inv(ROUNDED.rigid_inertia)) * np.array([100, 75, 50])
    np.testing.assert_allclose(effect, [2.065, 1.292, 1.356], atol=1e-3)


@pytest.mark.parametrize(
    ("body", "frequencies", "damping"),
    [
        (ROUNDED, (0.93716, 1.1624, 1.92258, 2.70095), (0.007743, 0.009684, 0.01374, 0.027148)),
        (FULL, (1.03067, 1.27956, 2.00133, 2.75516), (0.007734, 0.009693, 0.013958, 0.026928)),
    ],
)
def test_frequencies_and_damping_of_the_free_body(body, frequencies, damping):
    np.testing.assert_allclose(body.free_frequencies(), frequencies, rtol=1e-4)
    np.testing.assert_allclose(body.free_damping(), damping, rtol=1e-4)


def test_undamped_body_keeps_energy_and_momentum():
    body = FlexibleBody([100, 75, 50], COUPLING, ROUNDED.frequencies, np.zeros(4))
    y = flow(rate(body), np.concatenate([START, [1, 0, 0, 0]]), np.linspace(0, 20, 21))
    energy = body.energy(*split(y))
    assert energy[0] == pytest.approx(0.099272491, abs=1e-9)
    assert np.max(np.abs(energy / energy[0] - 1)) < 1e-10
    momentum = np.linalg.norm(body.momentum(y[:3], y[7:11]), axis=0)
    assert momentum[0] == pytest.approx(3.669376982, abs=1e-9)
    assert np.max(np.abs(momentum / momentum[0] - 1)) < 1e-11


@pytest.mark.slow
def test_damped_body_loses_energy_at_the_rate_of_its_dampers():
    y = flow(rate(ROUNDED), np.concatenate([START, [1, 0, 0, 0]]), np.linspace(0, 20, 201))
    energy = ROUNDED.energy(*split(y))
    assert np.all(np.diff(energy) < 1e-12)
    momentum = np.linalg.norm(ROUNDED.momentum(y[:3], y[7:11]), axis=0)
    assert np.max(np.abs(momentum / momentum[0] - 1)) < 1e-11


def test_open_loop_manoeuvre():
    """Constant torque from rest; states of the sheet to 2e-6."""
    start = np.concatenate([np.zeros(11), [1, 0, 0, 0]])
    y = flow(rate(ROUNDED, (0.3, -0.2, 0.1)), start, [0.0, 10.0, 20.0])
    expected = {
        1: (
            [0.993636, 0.075654, -0.067745, 0.048721],
            [0.028010, -0.028103, 0.017091],
            [-0.039270, -0.010578, 0.001870, -0.001770],
            [0.021198, -0.017603, -0.000278, -0.001630],
        ),
        2: (
            [0.902021, 0.286881, -0.278066, 0.163516],
            [0.055001, -0.062073, 0.026866],
            [-0.016165, 0.021304, 0.001458, -0.002285],
            [0.024448, -0.016337, -0.000824, 0.000444],
        ),
    }
    for k, (q, omega, eta, eta_rate) in expected.items():
        np.testing.assert_allclose(y[11:, k], q, atol=2e-6)
        np.testing.assert_allclose(y[:3, k], omega, atol=2e-6)
        np.testing.assert_allclose(y[3:7, k], eta, atol=2e-6)
        np.testing.assert_allclose(y[7:11, k], eta_rate, atol=2e-6)


def test_symbols_and_arrays_agree():
    w, eta, eta_rate = START[:3], START[3:7], START[7:]
    symbols = [ca.SX.sym("w", 3), ca.SX.sym("e", 4), ca.SX.sym("d", 4), ca.SX.sym("T", 3)]
    f = ca.Function("f", symbols, list(FULL.accelerations(*symbols)))
    torque = np.array([0.3, -0.2, 0.1])
    for one, other in zip(
        f(w, eta, eta_rate, torque), FULL.accelerations(w, eta, eta_rate, torque), strict=True
    ):
        np.testing.assert_allclose(one.full()[:, 0], other, rtol=1e-12)


def test_impossible_bodies_are_refused():
    with pytest.raises(ModelError, match=r"more inertia than the whole"):
        FlexibleBody([10, 7, 5], COUPLING, ROUNDED.frequencies, ROUNDED.damping)
    with pytest.raises(ModelError, match=r"coupling \(3, 2\)"):
        FlexibleBody([100, 75, 50], COUPLING, [1.0, 2.0], [0.1, 0.1])
    with pytest.raises(ModelError, match="frequencies"):
        FlexibleBody([100, 75, 50], COUPLING, [1, 2, -3, 4], ROUNDED.damping)
