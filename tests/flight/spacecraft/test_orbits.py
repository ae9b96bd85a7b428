"""Gravity, relative motion and the inertial truth: potentials, conservation, frames against each other."""

import casadi as ca
import numpy as np
import pytest
from testing.flows import flow

from gnc_opt.spacecraft import (
    J2_EARTH,
    differential_j2,
    gravity_gradient_torque,
    hill_acceleration,
    inertial_from_relative,
    j2_gravity,
    point_mass_gravity,
    radial_frame,
    radial_frame_rate,
    relative_acceleration,
    relative_from_inertial,
)

MU, RADIUS, LEADER = 398600e9, 6378.137e3, 7171e3
N = np.sqrt(MU / LEADER**3)


def gravity(r, j2=J2_EARTH):
    return point_mass_gravity(r, MU) + j2_gravity(r, MU, j2, RADIUS)


def potential(r):
    """Vallado, chapter 8: U of point mass and oblateness."""
    square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    return -MU / square**0.5 * (1 - 0.5 * J2_EARTH * RADIUS**2 / square * (3 * r[2] * r[2] / square - 1))


def test_gravity_is_the_gradient_of_its_potential():
    r = ca.SX.sym("r", 3)
    acceleration = ca.Function("a", [r], [-ca.gradient(potential(r), r)])
    for place in ([7e6, 0, 0], [3e6, -5e6, 4e6], [0, 1e5, 7.2e6]):
        expected = acceleration(place).full()[:, 0]
        np.testing.assert_allclose(gravity(np.array(place, dtype=float)), expected, rtol=1e-13, atol=1e-14)


def test_oblate_orbit_keeps_energy_and_polar_momentum():
    start = np.array([7e6, 0, 0, 0, 5.3e3, 5.3e3])
    y = flow(
        lambda _, s: np.concatenate([s[3:], gravity(s[:3])]), start, np.linspace(0, 12000, 41), tol=3e-14
    )
    energy = 0.5 * np.sum(y[3:] ** 2, axis=0) + potential(y[:3])
    polar = y[0] * y[4] - y[1] * y[3]
    assert np.max(np.abs(energy / energy[0] - 1)) < 1e-11
    assert np.max(np.abs(polar / polar[0] - 1)) < 1e-11


def test_gravity_gradient_of_a_dumbbell():
    """Two point masses on a rod, exact pulls against the first-order torque."""
    m, half, r_B = 10.0, 1.0, np.array([4e6, 5e6, 1e6])
    inertia = np.diag([0.0, 2 * m * half**2, 2 * m * half**2])  # rod along x
    exact = sum(
        np.cross([s * half, 0, 0], m * point_mass_gravity(r_B + np.array([s * half, 0.0, 0.0]), MU))
        for s in (-1.0, 1.0)
    )
    np.testing.assert_allclose(gravity_gradient_torque(inertia, r_B, MU), exact, rtol=2e-4)


def test_relative_motion_becomes_hills_to_first_order():
    """The frame of the rendezvous has other axes: (x, y, z)_L = (y, -z, -x)_R."""
    rho, rate = np.array([30.0, -20.0, 50.0]), np.array([0.1, -0.3, 0.2])

    def to_L(v):
        return np.array([v[1], -v[2], -v[0]])

    errors = []
    for size in (1.0, 0.5):
        exact = to_L(relative_acceleration(size * rho, size * rate, LEADER, N, MU))
        errors.append(np.linalg.norm(exact - hill_acceleration(size * to_L(rho), size * to_L(rate), N)))
    assert errors[0] < 1e-9
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


def inertial_pair(j2):
    """Return the rates of (leader, follower) as two free orbits."""

    def rate(_, y):
        return np.concatenate([y[3:6], gravity(y[:3], j2), y[9:12], gravity(y[6:9], j2)])

    return rate


def test_frames_and_signs_against_the_inertial_truth():
    """Without oblateness the relative equations are exact: one orbit apart they still agree."""
    rho, rho_rate = np.array([300.0, -200.0, 500.0]), np.array([0.05, -0.2, 0.1])
    r, v = np.array([LEADER, 0, 0]), np.array([0, N * LEADER, 0.0])
    position, velocity = inertial_from_relative(r, v, rho, rho_rate, point_mass_gravity(r, MU))
    time = 2 * np.pi / N
    truth = flow(inertial_pair(0.0), np.concatenate([r, v, position, velocity]), [0.0, time])[:, -1]
    found = relative_from_inertial(
        truth[:3], truth[3:6], truth[6:9], truth[9:], point_mass_gravity(truth[:3], MU)
    )
    end = flow(
        lambda _, y: np.concatenate([y[3:], relative_acceleration(y[:3], y[3:], LEADER, N, MU)]),
        np.concatenate([rho, rho_rate]),
        [0.0, time],
    )[:, -1]
    np.testing.assert_allclose(end[:3], found[0], atol=1e-4)  # 1e-11 of the orbit
    np.testing.assert_allclose(end[3:], found[1], atol=1e-7)


def test_relative_and_inertial_are_inverse_in_an_inclined_oblate_orbit():
    r, v = np.array([5e6, 3e6, 4e6]), np.array([-3e3, 6e3, 2e3])
    rho, rate = np.array([1e3, -2e3, 500.0]), np.array([1.0, 2.0, -3.0])
    acceleration = gravity(r)
    back = relative_from_inertial(r, v, *inertial_from_relative(r, v, rho, rate, acceleration), acceleration)
    np.testing.assert_allclose(back[0], rho, atol=1e-7)
    np.testing.assert_allclose(back[1], rate, atol=1e-10)


def test_radial_frame_turns_at_its_rate():
    """dC/dt = -[w x] C along a free oblate orbit, by central differences."""
    r, v = np.array([5e6, 3e6, 4e6]), np.array([-3e3, 6e3, 2e3])
    h = 0.05
    y = flow(lambda t, s: np.concatenate([s[3:], gravity(s[:3])]), np.concatenate([r, v]), [0.0, h, 2 * h])
    before, here, after = (radial_frame(y[:3, k], y[3:, k]) for k in range(3))
    w = radial_frame_rate(y[:3, 1], y[3:, 1], gravity(y[:3, 1]))
    skew = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    np.testing.assert_allclose((after - before) / (2 * h), -skew @ here, atol=1e-11)
    assert abs(w[0]) > 1e-8  # the oblateness does push the leader out of its plane


def test_differential_oblateness():
    """First order in the distance, zero at the leader; size as in the formation sheet (3.6e-6 m/s^2 at 1 km)."""
    rho = np.array([500.0, 0.0, 866.0])
    full = differential_j2(rho, LEADER, np.eye(3), MU)
    assert 1e-6 < np.max(np.abs(full)) < 5e-6
    np.testing.assert_allclose(differential_j2(np.zeros(3), LEADER, np.eye(3), MU), 0, atol=1e-15)
    turn = np.array([[np.cos(1), np.sin(1), 0], [-np.sin(1), np.cos(1), 0], [0, 0, 1]])
    np.testing.assert_allclose(
        differential_j2(rho, LEADER, turn, MU), full, rtol=1e-7, atol=1e-16
    )  # axisymmetric
