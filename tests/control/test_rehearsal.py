"""A start and limits are judged together: against an own loop by SciPy, from both sides."""

import casadi as ca
import numpy as np
import pytest
import scipy

import gnc_opt as go
from gnc_opt.control import ConstantRate, SaturationLayer, design_feedback_linearization, design_sliding_mode
from gnc_opt.errors import DesignError

GRAVITY = 9.81


def pendulum() -> go.Model:
    model = go.Model("pendulum")
    th, w, T = model.state("th", unit="rad"), model.state("w", unit="rad/s"), model.control("T", unit="N m")
    model.ode({th: w, w: GRAVITY * ca.sin(th) + T})
    return model


def slider(**options):
    return design_sliding_mode(
        pendulum(),
        [0, 0],
        outputs="th",
        slopes=2.0,
        reaching=ConstantRate(1.0),
        boundary=SaturationLayer(0.05),
        bound=0.2,
        dt=0.01,
        **options,
    )


def linearised(**options):
    return design_feedback_linearization(pendulum(), [0, 0], outputs="th", poles=[-2, -2], dt=0.01, **options)


def fly(controller, start, limit, tf=8.0):
    """Return commands and states (2, n + 1) of the pendulum under the cut command, by an integrator of SciPy."""
    x, z, commands, states = np.array(start, dtype=float), None, [], [np.array(start)]
    for k in range(round(tf / 0.01)):
        u, z = controller(0.01 * k, x, z)
        cut = float(np.clip(u[0], -limit, limit))
        rate = lambda t, y, cut=cut: [y[1], GRAVITY * np.sin(y[0]) + cut]  # noqa: E731
        x = scipy.integrate.solve_ivp(rate, (0, 0.01), x, rtol=1e-9, atol=1e-11).y[:, -1]
        commands.append(u[0])
        states.append(x)
    return np.array(commands), np.array(states).T


@pytest.mark.parametrize("design", [slider, linearised])
def test_a_start_that_the_limits_cannot_hold_is_refused(design):
    """The torque of 5 N m holds the pendulum up to asin(5 / 9.81) = 0.535 rad."""
    _, states = fly(design(limits=(-5, 5)), [1.2, 0.0], 5.0)
    assert np.max(np.abs(states[0])) > 3  # so it is: it falls
    with pytest.raises(
        DesignError, match=r"limits keep th from coming down: .*'T' for -1\d.* limits are -5 and 5"
    ):
        design(limits=(-5, 5), start=[1.2, 0.0])


@pytest.mark.parametrize("design", [slider, linearised])
def test_a_start_that_the_limits_hold_passes_and_the_time_at_the_limits_is_told(design):
    controller = design(limits=(-5, 5), start=[0.5, 0.0])
    commands, states = fly(controller, [0.5, 0.0], 5.0)
    assert abs(states[0, -1]) < 0.01
    at_limits = 0.01 * np.sum(np.abs(commands) > 5)
    assert at_limits > 0
    assert controller.explain()["limits act for"] == pytest.approx(at_limits, abs=0.011)


def test_reaching_time_is_that_of_the_limited_command():
    free = slider(start=[0.5, 0.0]).explain()["reaching time"][0]
    assert free == pytest.approx(1.0 / 0.8)
    told = slider(limits=(-5, 5), start=[0.5, 0.0]).explain()["reaching time"][0]
    _, states = fly(slider(limits=(-5, 5)), [0.5, 0.0], 5.0)
    s = states[1] + 2 * states[0]
    assert told == pytest.approx(0.01 * np.argmax(np.abs(s) <= 0.05), abs=0.021)


def test_zero_dynamics_that_blow_up_from_a_start_are_refused():
    """eta' = eta^3 + x1 is critical at rest and escapes in finite time from x1 = 0.5."""
    model = go.Model("cubic")
    x1, eta, u = model.state("x1"), model.state("eta"), model.control("u")
    model.ode({x1: u, eta: eta**3 + x1})
    settings = {"outputs": "x1", "dt": 0.01}
    with pytest.raises(DesignError, match=r"runs away: 'eta' leaves all bounds at t = \d"):
        design_feedback_linearization(model, [0, 0], poles=[-1.0], start=[0.5, 0.0], **settings)
    reaching = {"reaching": ConstantRate(1.0), "boundary": SaturationLayer(0.1)}
    with pytest.raises(DesignError, match="runs away: 'eta'"):
        design_sliding_mode(model, [0, 0], start=[1.5, 0.0], **reaching, **settings)


def test_a_long_way_at_the_limits_is_no_failure():
    """1000 m at 0.01 m/s^2 take 2 sqrt(1000 / 0.01) = 632 s, where the poles say 20 s."""
    model = go.Model("cart")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    law = design_feedback_linearization(
        model, [0, 0], outputs="q", poles=[-0.1, -0.1], start=[1000.0, 0.0], limits=(-0.5, 0.5), dt=0.1
    )
    assert law.explain()["limits act for"] > 50
