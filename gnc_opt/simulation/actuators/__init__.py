"""Actuator models between the command and the control of the plant.

The command is constant over a minor step. The output of a `Lag` is continuous within it, also after memoryless blocks.
All other blocks act once per minor step, on the mean of their input.
"""

from gnc_opt.simulation.actuators.actuator_dynamics import Delay, Lag, RateLimit, ZeroOrderHold
from gnc_opt.simulation.actuators.memoryless_nonlinearities import (
    Deadband,
    Quantisation,
    Saturation,
    ScaleFactor,
)
from gnc_opt.simulation.actuators.pulse_modulation import Pwm, Pwpf, SchmittTrigger

__all__ = [
    "Deadband",
    "Delay",
    "Lag",
    "Pwm",
    "Pwpf",
    "Quantisation",
    "RateLimit",
    "Saturation",
    "ScaleFactor",
    "SchmittTrigger",
    "ZeroOrderHold",
]
