"""A linear loop whose ends have a normal distribution that is known."""

import gnc_opt as go
from gnc_opt.simulation import Noise, Normal, PiecewiseConstantNoise

DT = 0.1
MISSION = {"x0": [0.5, 0.0], "tf": 2.0}
SPREAD = {"initial.q": Normal(0.2), "initial.v": Normal(0.1)}


def sled() -> go.Model:
    """Return q'' = F / m."""
    model = go.Model("sled")
    q, v, F = model.state("q", unit="m"), model.state("v", unit="m/s"), model.control("F", unit="N")
    m = model.parameter("m", 2.0, unit="kg")
    model.ode({q: v, v: F / m})
    return model


def regulator(model: go.Model) -> go.Controller:
    """Return an LQR of the sled."""
    return go.design_lqr(model, [0, 0], Q=[1, 1], R=[0.5], dt=DT)


def loop_of(**more) -> go.ClosedLoop:
    """Return the sled under its regulator, with two sensors and gusts."""
    model = sled()
    sensors = [Noise("odometer", 0.05, on="q"), Noise("tachometer", 0.02, on="v")]
    gusts = [PiecewiseConstantNoise("gusts", 0.3, 5 * DT, on="F")]
    return go.ClosedLoop(model, regulator(model), **{"sensors": sensors, "disturbances": gusts} | more)
