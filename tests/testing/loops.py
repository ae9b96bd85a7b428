"""Small plants and controllers for the tests of the closed loop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import scipy

import gnc_opt as go
from gnc_opt.control import Controller, DesignReport, initial_state_function, law_function
from gnc_opt.model import Layout, Model, Variable

NONE = Layout("entry")


def double_integrator(size: int = 1) -> Model:
    """Return dq/dt = v, dv/dt = a / m."""
    cart = Model("cart")
    q = cart.state("q", size, unit="m")
    v = cart.state("v", size, unit="m/s")
    a = cart.control("a", size, unit="N")
    m = cart.parameter("m", 1.0, unit="kg")
    cart.ode({q: v, v: a / m})
    return cart


def memory_of_impulse(size: int = 1) -> Model:
    """Return dq/dt = a: the state is the impulse of what is applied."""
    plant = Model("impulse")
    q = plant.state("q", size, unit="N s")
    a = plant.control("a", size, unit="N")
    plant.ode({q: a})
    return plant


def controller(
    plant: Model,
    expression: Callable[[Any, Any, Any, Any], tuple[Any, Any]],
    *,
    memory: Layout = NONE,
    first: Callable[[Any, Any, Any], Any] | None = None,
    signals: Layout = NONE,
    schedule: Callable[[Any, float], Any] | None = None,
    commands: Layout | None = None,
    alarms: tuple[str, ...] = (),
    symbols: Any = ca.SX,
) -> Controller:
    """Return the controller with (u, z_next) = expression(t, x, r, z)."""
    t, x = symbols.sym("t"), symbols.sym("x", plant.states.size)
    r, z = symbols.sym("r", signals.size), symbols.sym("z", memory.size)
    u, z_next = expression(t, x, r, z)
    return Controller(
        name="by hand",
        step=law_function(t, x, r, z, u, z_next),
        start=initial_state_function(
            t, x, r, symbols.zeros(memory.size) if first is None else first(t, x, r)
        ),
        states=plant.states,
        commands=plant.controls if commands is None else commands,
        signals=signals,
        memory=memory,
        schedule=schedule or (lambda times, dt: np.zeros((signals.size, times.size))),
        explanation=DesignReport("by hand"),
        alarms=alarms,
    )


def scheduled(plant: Model, function: Callable[[Any], Any], *, commands: Layout | None = None) -> Controller:
    """Return the controller whose commands are function(t) at the beginnings of the steps, (n, n_times)."""
    size = (plant.controls if commands is None else commands).size
    return controller(
        plant,
        lambda t, x, r, z: (r, z),
        signals=Layout("signal", (Variable("u", size),)),
        schedule=lambda times, dt: np.atleast_2d(np.asarray(function(times), dtype=float)),
        commands=commands,
    )


def feedback(plant: Model, gain: Any) -> Controller:
    """Return u = -gain x."""
    matrix = np.atleast_2d(np.asarray(gain, dtype=float))
    return controller(plant, lambda t, x, r, z: (-(matrix @ x), z))


def agrees(found: go.LinearCovariance, campaign: go.Campaign) -> bool:
    """Whether the variances of the runs are those predicted, within the bands of chi-square with 99 % for all.

    Degrees of freedom are by the kurtosis of the runs.
    """
    errors, predicted = campaign.errors, np.diagonal(found.parts["error"][:, -1].sum(axis=0))
    kurtosis = scipy.stats.kurtosis(errors, axis=1, fisher=False)
    freedom = 2 * (errors.shape[1] - 1) / (kurtosis - 1)
    tail = 0.005 / len(errors)
    low, high = (scipy.stats.chi2.ppf(p, freedom) / freedom for p in (tail, 1 - tail))
    ratio = errors.var(axis=1, ddof=1) / predicted
    return bool(np.all((low <= ratio) & (ratio <= high)))
