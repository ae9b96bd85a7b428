"""Weighted surfaces of more outputs than controls: the Routh conditions of a tethered pair, its swing."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.controller_steps import step_through

from gnc_opt.control import ConstantRate, Reference, SaturationLayer, design_sliding_mode
from gnc_opt.errors import DesignError
from gnc_opt.model import Model

OMEGA2, A, B = 2.000331e-3, 0.199867, 0.142653
"""Swing frequency squared (1/s^2); response of the leader to the thrust angle, direct and through its force (m/s^2)."""


def tether() -> Model:
    """Swing theta, height h of the leader and thrust angle gamma, without orbital terms, small angles."""
    model = Model("tether")
    theta, theta_rate = model.state("theta"), model.state("theta_rate")
    h, h_rate = model.state("h"), model.state("h_rate")
    gamma, rate = model.state("gamma"), model.control("rate")
    swing = -OMEGA2 * (theta + gamma)
    lift = B * gamma + (A - B) * (theta + gamma)
    model.ode({theta: theta_rate, theta_rate: swing, h: h_rate, h_rate: lift, gamma: rate})
    return model


def weigh(k1=0.35, k2=0.01, k4=-0.06, **options):
    model = tether()
    theta, theta_rate, h, h_rate = (model.symbol(n) for n in ("theta", "theta_rate", "h", "h_rate"))
    total = theta_rate + k1 * theta + k4 * (h_rate + k2 * h)
    reference = Reference.constant(model, np.zeros(5), [0.0])
    law = {"reaching": ConstantRate(0.01), "boundary": SaturationLayer(0.02)}
    return design_sliding_mode(model, reference, outputs={"S": total}, slopes=1.0, **law, **options)


def polynomial(k1, k2, k4):
    """The zero dynamics on S = 0, by hand."""
    q = -k4
    return [OMEGA2 + q * A, OMEGA2 * k1 + q * k2 * A, q * B * OMEGA2, q * k2 * B * OMEGA2]


def test_zero_dynamics_are_the_roots_of_the_hand_made_polynomial():
    facts = weigh().explain()
    assert list(facts["relative degrees"]) == [2]
    assert facts["dimension of the zero dynamics"] == 3
    found = np.sort_complex(facts["eigenvalues of the zero dynamics"])
    assert found == pytest.approx(np.sort_complex(np.roots(polynomial(0.35, 0.01, -0.06))), abs=1e-9)
    printed = [-0.03257, -0.01302 - 0.01436j, -0.01302 + 0.01436j]
    assert found == pytest.approx(np.sort_complex(np.array(printed)), abs=2e-5)


@pytest.mark.parametrize("k1", [0.005, 0.05, 0.35])
@pytest.mark.parametrize("k2", [0.002, 0.03])
@pytest.mark.parametrize("k4", [-0.06, 0.005])
def test_weights_are_refused_exactly_where_routh_says(k1, k2, k4):
    """Stable if and only if k4 < 0 and k1 > k2."""
    if k4 < 0 and k1 > k2:
        assert np.max(weigh(k1, k2, k4).explain()["eigenvalues of the zero dynamics"].real) < 0
    else:
        with pytest.raises(DesignError, match="zero dynamics of outputs S are unstable: eigenvalue"):
            weigh(k1, k2, k4)


def test_all_outputs_follow_with_the_right_weights_and_part_at_the_stated_rate_with_wrong_ones():
    start = [np.radians(5), 0, 0.5, 0, 0]
    good = step_through(weigh(dt=0.5), tether(), start, dt=0.5, tf=800.0)
    assert np.max(np.abs(good.x[:, -1])) < 1e-3
    wrong = weigh(k4=0.005, growth=1.0, dt=0.5)
    bad = step_through(wrong, tether(), start, dt=0.5, tf=800.0)
    assert abs(bad.x[2, -1]) > 100
    rate = np.log(bad.x[2, -1] / bad.x[2, -401]) / 200.0
    assert rate == pytest.approx(np.max(wrong.explain()["eigenvalues of the zero dynamics"].real), rel=0.02)


def test_a_surface_of_relative_degree_one():
    """A cart with a pendulum under gravity, balanced by the force on the cart."""
    model = Model("cart and pendulum")
    x, v, a, w = model.state("x"), model.state("v"), model.state("angle"), model.state("w")
    f = model.control("f")
    model.ode({x: v, v: f, a: w, w: 9.81 * ca.sin(a) - f * ca.cos(a)})
    reference = Reference.constant(model, np.zeros(4), [0.0])
    law = {"reaching": ConstantRate(3.0), "boundary": SaturationLayer(0.05), "limits": (-10.0, 10.0)}

    def design(weight):
        total = w + 4.0 * a + weight * (v + x)
        return design_sliding_mode(model, reference, outputs={"S": total}, **law, bound=0.5, dt=0.01)

    with pytest.raises(DesignError, match="unstable"):
        design(-0.3)
    controller = design(0.3)
    assert list(controller.explain()["relative degrees"]) == [1]
    run = step_through(controller, model, [0.0, 0.0, 0.2, 0.0], dt=0.01, tf=30.0)
    assert np.max(np.abs(run.x[:, -1])) < 1e-3
