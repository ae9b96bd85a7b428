"""Predictive controllers of a cart and a pendulum."""

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.control import Reference, design_mpc
from testing.models import cart_with_units as cart
from testing.models import dynamics

DT = 0.1


A, B = np.array([[1, DT], [0, 1]]), np.array([DT**2 / 2, DT])


def pendulum() -> tuple[go.Model, Reference]:
    model, *_ = dynamics("pendulum", "q v", "a", lambda q, v, a: {q: v, v: a - ca.sin(q)})
    reference = Reference.from_functions(
        model, lambda t: [np.cos(t), -np.sin(t)], lambda t: [np.sin(np.cos(t)) - np.cos(t)], 0.0, 3.0
    )
    return model, reference


def tracker(**options):
    model = cart()
    settings = {"Q": 1, "R": 1, "horizon": 2.0, "dt": DT, "limits": (-1, 1)} | options
    return design_mpc(model, Reference.constant(model, [0, 0]), **settings)
