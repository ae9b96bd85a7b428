"""Lie derivatives, relative degrees and zero dynamics against hand calculation and linear theory."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.controller_steps import decoupling_matrix
from testing.internals import PlantPair, build_output_error_expressions

from gnc_opt.control import Reference, lie_derivative, output_errors, zero_dynamics
from gnc_opt.errors import DesignError, UnknownNameError
from gnc_opt.model import Model
from gnc_opt.spacecraft import quaternion_difference, quaternion_rate


def pendulum() -> Model:
    model = Model("pendulum")
    angle, rate = model.state("angle"), model.state("rate")
    torque, length = model.control("torque"), model.parameter("length", 2.0)
    model.ode({angle: rate, rate: -9.81 / length * ca.sin(angle) + torque / length**2})
    return model


def linear(a: np.ndarray, b: np.ndarray) -> Model:
    model = Model("linear")
    x, u = model.state("x", a.shape[0]), model.control("u", b.shape[1])
    model.ode({x: ca.DM(a) @ x + ca.DM(b) @ u})
    return model


def rest(model: Model, x) -> Reference:
    return Reference.constant(model, x, np.zeros(model.controls.size))


def test_lie_derivatives_of_a_pendulum_that_also_depend_on_time():
    model = pendulum()
    t, x, u, p = model.symbolic_arguments()
    first = lie_derivative(model, t**2 * x[0])
    second = lie_derivative(model, x[0], order=2)
    value = ca.Function("v", [t, x, u, p], [first, second])
    got = [float(v) for v in value(3.0, [0.4, -0.7], [1.5], [2.0])]
    assert got == pytest.approx([2 * 3 * 0.4 + 9 * -0.7, -9.81 / 2 * np.sin(0.4) + 1.5 / 4], rel=1e-14)


def test_relative_degree_and_decoupling_use_the_parameters_of_the_model():
    model = pendulum()
    assert output_errors(model, rest(model, [0.1, 0.2]), "angle").relative_degrees == (2,)
    assert output_errors(model, rest(model, [0.1, 0.2]), "rate").relative_degrees == (1,)
    assert decoupling_matrix(model.with_parameters(length=0.5), "angle", [0.1, 0.2]) == pytest.approx(4.0)


@pytest.mark.parametrize("r", [1, 2, 3, 4])
def test_relative_degree_of_a_chain_of_integrators(r):
    model = linear(np.eye(4, k=1), np.eye(4)[:, [3]])
    x = model.symbols("state")
    errors = output_errors(model, rest(model, np.zeros(4)), [x[4 - r]])
    assert (errors.labels, errors.relative_degrees) == (("y0",), (r,))


def test_a_control_that_only_seems_to_enter_does_not_count():
    """sin^2 + cos^2 = 1: the structure says that u enters dy/dt, the values say that it does not."""
    model = Model("circle")
    c, s, w = model.state("c"), model.state("s"), model.state("w")
    u = model.control("u")
    model.ode({c: -s * u, s: c * u, w: c})
    # d(c^2 + s^2)/dt = -2 c s u + 2 s c u = 0
    radius = c**2 + s**2
    assert output_errors(model, rest(model, [0.6, 0.8, 0.0]), {"y": w + radius}).relative_degrees == (2,)


def test_errors_move_along_plant_and_reference():
    """The chain of an error equals its numerical time derivatives while both plant and reference move."""
    model = pendulum()
    reference = Reference.from_functions(model, lambda t: [0.3, 0.1], lambda t: [0.2], 0.0, 1.0)
    errors = output_errors(model, reference, "angle")
    pair = errors.pair
    function = pair.build_function_of_plant_and_reference(
        errors.chains[0], errors.drift + errors.decoupling @ pair.u
    )
    x, xr, u, ur, h = np.array([0.5, -0.2]), np.array([0.3, 0.1]), np.array([0.7]), np.array([0.2]), 1e-5
    chain, last = (m.full()[:, 0] for m in function(0.0, x, u, xr, ur))
    ahead = function(0.0, x + h * model.f(0, x, u), u, xr + h * model.f(0, xr, ur), ur)[0].full()[:, 0]
    back = function(0.0, x - h * model.f(0, x, u), u, xr - h * model.f(0, xr, ur), ur)[0].full()[:, 0]
    assert (ahead - back) / (2 * h) == pytest.approx([chain[1], last[0]], rel=1e-8)


def test_zero_dynamics_are_the_transmission_zeros():
    """y = x1 of G(s) = (s^2 + 2 s + 5) / (s + 1)^4 in controller form: two zeros, at -1 +- 2i."""
    a = np.eye(4, k=1)
    a[3] = -np.poly([-1.0] * 4)[:0:-1]
    model = linear(a, np.eye(4)[:, [3]])
    x = model.symbols("state")
    errors = output_errors(model, rest(model, np.zeros(4)), {"y": 5 * x[0] + 2 * x[1] + x[2]})
    zeros = zero_dynamics(errors, 0.0, np.zeros(4), np.zeros(1))
    assert errors.relative_degrees == (2,)
    assert zeros.dimension == 2
    assert np.sort_complex(zeros.eigenvalues) == pytest.approx([-1 - 2j, -1 + 2j], abs=1e-12)
    assert zeros.growth_rate == pytest.approx(-1.0, abs=1e-12)


def test_quaternion_output_has_a_neutral_zero_in_r4_and_none_on_the_sphere():
    """Without a declared difference the scalar part is left over, with eigenvalue 0; with it nothing is."""
    for difference, dimension in ((False, 1), (True, 0)):
        model = Model("body")
        q, w, torque = model.state("q", 4), model.state("w", 3), model.control("torque", 3)
        model.ode({q: quaternion_rate(q, w), w: torque})
        if difference:
            model.difference(q, quaternion_difference)
        x = np.array([1.0, 0, 0, 0, 0, 0, 0])
        errors = output_errors(model, rest(model, x), {"q_v": q[1:]})
        zeros = zero_dynamics(errors, 0.0, x, np.zeros(3))
        assert zeros.dimension == dimension
        assert zeros.eigenvalues == pytest.approx(np.zeros(dimension), abs=1e-12)


def test_states_with_a_difference_are_compared_by_it():
    model = Model("body")
    q, w, torque = model.state("q", 4), model.state("w", 3), model.control("torque", 3)
    model.ode({q: quaternion_rate(q, w), w: torque})
    model.difference(q, quaternion_difference)
    assert build_output_error_expressions(PlantPair.from_affine_model(model), "q")["q"].shape == (3, 1)


def test_what_cannot_be_steered_is_refused_by_name():
    model = Model("m")
    a, b, u = model.state("a"), model.state("b"), model.control("u")
    model.ode({a: u, b: -b})
    here = rest(model, np.zeros(2))
    with pytest.raises(DesignError, match="no control of model 'm' enters output 'b'"):
        output_errors(model, here, "b")
    with pytest.raises(DesignError, match="1 control for 2 outputs"):
        output_errors(model, here, ["a", "b"])
    with pytest.raises(DesignError, match="relative degree is 0"):
        output_errors(model, here, {"y": a + u})
    with pytest.raises(UnknownNameError, match="did you mean 'a'"):
        output_errors(model, here, "A")
    bent = Model("bent")
    a, u = bent.state("a"), bent.control("u")
    bent.ode({a: ca.sin(u)})
    with pytest.raises(DesignError, match="control 'u' of model 'bent' does not enter its dynamics affinely"):
        PlantPair.from_affine_model(bent)
