"""A plant that is a Python object."""

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.models import dynamics

import gnc_opt as go

DT = 0.1


def pendulum() -> go.Model:
    model, *_ = dynamics("pendulum", "q v", "a", lambda q, v, a: {q: v, v: a - ca.sin(q)})
    return model


def regulator():
    return go.design_lqr(pendulum(), [0.4, 0.0], Q=1, R=1, dt=DT, integral={"q": 0.5})


def test_a_loop_in_python_flies_as_the_compiled_one():
    law = regulator()
    run = go.ClosedLoop(pendulum(), law, dt=DT, accuracy=1e-10).simulate([1.0, 0.0], tf=6.0)
    x, z = np.array([1.0, 0.0]), None
    for k, t in enumerate(run.times[:-1]):
        assert x == pytest.approx(run.states[:, k], abs=1e-8)
        u, z = law(t, x, z)
        assert u == pytest.approx(run.commands[:, k], abs=1e-8)
        flow = scipy.integrate.solve_ivp(
            lambda s, x, a=u[0]: [x[1], a - np.sin(x[0])], (t, t + DT), x, rtol=1e-11, atol=1e-12
        )
        x = flow.y[:, -1]
