"""Actuators: what becomes of a command on its way to the plant.

A command is held over a minor step. `Delay`, `RateLimit` and `Lag` are followed within it in this order,
blocks without memory act at every time, all others once per minor step with the mean.
"""

from gnc_opt.simulation.actuators.dynamic import Delay, Lag, RateLimit, ZeroOrderHold
from gnc_opt.simulation.actuators.on_off import Pwm, Pwpf, SchmittTrigger
from gnc_opt.simulation.actuators.static import (
    Deadband,
    MinimumImpulse,
    Quantisation,
    Saturation,
    ScaleFactor,
)

__all__ = [
    "Deadband",
    "Delay",
    "Lag",
    "MinimumImpulse",
    "Pwm",
    "Pwpf",
    "Quantisation",
    "RateLimit",
    "Saturation",
    "ScaleFactor",
    "SchmittTrigger",
    "ZeroOrderHold",
]
