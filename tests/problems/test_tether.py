"""The tethered pair (Jia and Meng 2022): exact energy and momentum, first order against truth, sample values."""

import casadi as ca
import numpy as np
import pytest
from testing.flows import flow

from problems.tethered_formation.tether import TetheredPair, TetherMotion

MU = 3.986004418e14
PAIR = TetheredPair(500.0, 200.0, 1.0, 100.0, MU)
R0 = 7e6
ORBITAL = np.sqrt(MU / R0**3)


def rate(accelerations, force=0.0, gamma=0.0):
    def f(_, y):
        r, _alpha, theta, r_rate, alpha_rate, theta_rate = y
        a = accelerations(TetherMotion(r, r_rate, alpha_rate, theta, theta_rate), force, gamma)
        return [r_rate, alpha_rate, theta_rate, a.r, a.alpha, a.theta]

    return f


def motion(y):
    return TetherMotion(y[0], y[3], y[4], y[2], y[5])


START = np.array([R0, 0.0, np.radians(60), 0.0, ORBITAL, 1e-3])


def test_derived_masses():
    assert PAIR.mass == 701
    assert PAIR.kappa == pytest.approx(0.28601997, abs=1e-8)
    assert PAIR.reduced_mass == pytest.approx(142.986329, abs=1e-6)


@pytest.mark.parametrize(
    ("method", "length", "drift", "theta"),
    [
        ("true_accelerations", 100.0, 1e-12, 123.4206),
        ("true_accelerations", 1000.0, 1e-12, 123.5387),
        ("accelerations", 100.0, 1e-9, 123.417),
    ],
)
def test_free_swing_keeps_energy_and_momentum(method, length, drift, theta):
    pair = TetheredPair(500.0, 200.0, 1.0, length, MU)
    y = flow(rate(getattr(pair, method)), START, np.linspace(0, 6000, 31), tol=3e-14)
    energy, momentum = pair.energy(motion(y)), pair.angular_momentum(motion(y))
    assert np.max(np.abs(energy / energy[0] - 1)) < drift
    assert np.max(np.abs(momentum / momentum[0] - 1)) < drift
    assert np.degrees(y[2, -1]) == pytest.approx(theta, abs=1e-3)


def test_first_order_gravity_is_close_to_the_truth_under_thrust():
    start = np.array([R0, 0.0, np.radians(30), 0.0, ORBITAL, 0.0])
    truth, model = (
        flow(rate(a, 100.0, 0.05), start, [0.0, 200.0])[:, -1]
        for a in (PAIR.true_accelerations, PAIR.accelerations)
    )
    assert abs(truth[0] - model[0]) < 2e-5
    assert abs(truth[2] - model[2]) < 1e-7


def test_tension_is_what_the_leader_feels():
    """Without tether mass Newton's law of the leader gives the tension, and nothing across the tether."""
    pair = TetheredPair(500.0, 200.0, 0.0, 100.0, MU)
    here = TetherMotion(R0, 3.0, ORBITAL, 0.4, 2e-3)
    force, gamma = 100.0, 0.2
    a = pair.accelerations(here, force, gamma)
    # Acceleration of the leader beyond gravity, times its mass, minus thrust = pull along u.
    radial = a.r - here.r * here.alpha_rate**2 + MU / here.r**2
    along = here.r * a.alpha + 2 * here.r_rate * here.alpha_rate
    pull = 500.0 * np.array([radial, along]) - force * np.array([np.sin(gamma), np.cos(gamma)])
    u, n = np.array([np.sin(0.4), -np.cos(0.4)]), np.array([np.cos(0.4), np.sin(0.4)])
    assert pull @ u == pytest.approx(pair.tension(here, force, gamma), rel=1e-8)
    assert abs(pull @ n) < 1e-6


def test_symbols_and_numbers_agree():
    values = [R0, 3.0, ORBITAL, 0.4, 2e-3, 100.0, 0.2]
    symbols = [ca.SX.sym(f"s{i}") for i in range(7)]
    for method in (PAIR.accelerations, PAIR.true_accelerations):
        f = ca.Function("f", symbols, list(method(TetherMotion(*symbols[:5]), *symbols[5:])))
        expected = method(TetherMotion(*values[:5]), *values[5:])
        np.testing.assert_allclose([float(v) for v in f(*values)], expected, rtol=1e-9)
