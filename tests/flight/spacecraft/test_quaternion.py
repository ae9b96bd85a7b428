"""Quaternions and the differences of attitudes against scipy's rotations."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from testing.flows import flow

from gnc_opt.spacecraft import (
    mrp_difference,
    mrp_retraction,
    mrp_to_quaternion,
    quaternion_angle,
    quaternion_conjugate,
    quaternion_difference,
    quaternion_error,
    quaternion_product,
    quaternion_rate,
    quaternion_retraction,
    quaternion_to_dcm,
)

unit = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1)


def normal(q):
    return np.asarray(q) / np.linalg.norm(q)


def rotation(q):
    return Rotation.from_quat(q, scalar_first=True)


@given(unit, unit)
def test_product_and_matrix_are_scipys(p, q):
    p, q = normal(p), normal(q)
    product = rotation(p) * rotation(q)
    np.testing.assert_allclose(quaternion_to_dcm(quaternion_product(p, q)), product.as_matrix().T, atol=1e-14)
    assert quaternion_product(p, quaternion_conjugate(p)) == pytest.approx([1, 0, 0, 0], abs=1e-14)


@given(unit, unit)
def test_error_is_the_short_way(p, q):
    p, q = normal(p), normal(q)
    error = quaternion_error(p, q)
    turn = rotation(q).inv() * rotation(p)
    assert error[0] >= 0
    np.testing.assert_allclose(quaternion_to_dcm(error), turn.as_matrix().T, atol=1e-14)
    assert quaternion_angle(p, q) == pytest.approx(turn.magnitude(), abs=1e-7)
    np.testing.assert_allclose(quaternion_angle(p, -p), 0.0, atol=1e-15)


def test_symbols_and_arrays_agree():
    rng = np.random.default_rng(1)
    p, q, w = normal(rng.normal(size=4)), normal(rng.normal(size=4)), rng.normal(size=3)
    a, b, c = ca.SX.sym("a", 4), ca.SX.sym("b", 4), ca.SX.sym("c", 3)
    outputs = [
        quaternion_error(a, b), quaternion_rate(a, c), quaternion_to_dcm(a), quaternion_difference(a, b),
    ]  # fmt: skip
    found = ca.Function("f", [a, b, c], outputs)(p, q, w)
    wanted = [
        quaternion_error(p, q), quaternion_rate(p, w), quaternion_to_dcm(p), quaternion_difference(p, q),
    ]  # fmt: skip
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_allclose(np.squeeze(one.full()), other, atol=1e-15)


def test_rate_turns_the_matrix():
    """dC/dt = -[w x] C for C = dcm_BA and the rate of B in B."""
    q, w, h = normal([0.3, -0.5, 0.7, 0.2]), np.array([0.3, -0.2, 0.5]), 1e-6
    step = h * quaternion_rate(q, w)
    difference = (quaternion_to_dcm(q + step) - quaternion_to_dcm(q - step)) / (2 * h)
    skew = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    np.testing.assert_allclose(difference, -skew @ quaternion_to_dcm(q), atol=1e-9)


def test_constant_rate_is_a_constant_turn():
    axis, rate = np.array([2.0, -1.0, 2.0]) / 3, 0.7
    end = flow(lambda _, q: quaternion_rate(q, rate * axis), [1, 0, 0, 0], [0.0, 10.0])[:, -1]
    np.testing.assert_allclose(end, [np.cos(3.5), *(np.sin(3.5) * axis)], atol=1e-12)
    assert np.linalg.norm(end) == pytest.approx(1, abs=1e-12)


@given(st.lists(st.floats(-0.9, 0.9), min_size=6, max_size=6))
def test_mrp_difference_is_the_turn_between(values):
    sigma, reference = np.array(values[:3]), np.array(values[3:])
    turn = Rotation.from_mrp(reference).inv() * Rotation.from_mrp(sigma)
    found = mrp_difference(sigma, reference)
    np.testing.assert_allclose(np.linalg.norm(found), 4 * np.tan(turn.magnitude() / 4), atol=1e-9)
    if turn.magnitude() < 3.0:  # at half a turn the two ways are equally short
        np.testing.assert_allclose(found, 4 * turn.as_mrp(), atol=1e-9)


def test_mrp_difference_knows_the_shadow_set():
    sigma, reference = np.array([0.1, -0.2, 0.3]), np.array([0.15, -0.1, 0.3])
    shadow = -sigma / (sigma @ sigma)
    expected = mrp_difference(sigma, reference)
    np.testing.assert_allclose(mrp_difference(shadow, reference), expected, atol=1e-14)
    a, b = ca.SX.sym("a", 3), ca.SX.sym("b", 3)
    symbolic = ca.Function("d", [a, b], [mrp_difference(a, b)])
    np.testing.assert_allclose(symbolic(shadow, reference).full()[:, 0], expected, atol=1e-14)


def test_mrp_do_not_differ_from_their_shadow():
    sigma = np.array([[0.0, 0.3, 0.6], [1.0, -0.2, 0.0], [1.0, 0.9, 0.8]])
    shadow = -sigma / np.sum(sigma**2, axis=0)
    np.testing.assert_allclose(mrp_difference(sigma, shadow), 0, atol=1e-15)
    a, b = ca.SX.sym("a", 3), ca.SX.sym("b", 3)
    symbolic = ca.Function("d", [a, b], [mrp_difference(a, b)])
    np.testing.assert_allclose(symbolic(sigma, shadow).full(), 0, atol=1e-15)


def test_differences_are_radians_to_first_order():
    small = 1e-6 * np.array([1.0, -2.0, 0.5])
    reference = np.array([0.2, 0.3, -0.1])
    turned = (Rotation.from_mrp(reference) * Rotation.from_rotvec(small)).as_mrp()
    np.testing.assert_allclose(mrp_difference(turned, reference), small, atol=1e-16)
    q, q_ref = mrp_to_quaternion(turned), mrp_to_quaternion(reference)
    np.testing.assert_allclose(quaternion_difference(q, q_ref), small, atol=1e-15)


@given(st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6))
def test_retractions_are_the_way_back_of_differences(values):
    error, reference = np.array(values[:3]), np.array(values[3:])
    found = mrp_retraction(reference, error)
    assert np.linalg.norm(found) <= 1 + 1e-12
    np.testing.assert_allclose(mrp_difference(found, reference), error, atol=1e-9)
    q_ref = mrp_to_quaternion(reference)
    if np.linalg.norm(error) < 1.99:
        q = quaternion_retraction(3.0 * q_ref, error)
        np.testing.assert_allclose(np.linalg.norm(q), 1, atol=1e-14)
        np.testing.assert_allclose(quaternion_difference(q, q_ref), error, atol=1e-9)


def test_retractions_of_symbols_and_of_many_times_are_those_of_numbers():
    errors = np.array([[0.1, 0.4], [-0.2, 0.1], [0.3, 2.5]])
    references = np.array([[0.2, 0.9], [0.3, 0.8], [-0.1, 0]])
    a, b, q = ca.SX.sym("a", 3), ca.SX.sym("b", 3), ca.SX.sym("q", 4)
    mrp = ca.Function("m", [a, b], [mrp_retraction(a, b)])
    quaternion = ca.Function("q", [q, b], [quaternion_retraction(q, b)])
    many, q_ref = mrp_retraction(references, errors), mrp_to_quaternion(references)
    np.testing.assert_allclose(mrp(references, errors).full(), many, atol=1e-14)
    np.testing.assert_allclose(
        quaternion(q_ref, errors).full(), quaternion_retraction(q_ref, errors), atol=1e-14
    )
    half = quaternion_retraction(q_ref[:, 1], errors[:, 1])  # longer than 2: half a turn
    assert quaternion_angle(half, q_ref[:, 1]) == pytest.approx(np.pi)
