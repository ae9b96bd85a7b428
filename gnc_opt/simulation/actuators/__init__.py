"""Actuators: what becomes of a command on its way to the plant.

A command is held over a minor step. `Delay`, `RateLimit` and `Lag`, in this order, are followed within it, blocks
without memory act at every time, and all others work once per minor step with the mean of what they get.
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
