"""Closed loops: plant, controller, actuators, sensors and disturbances as one compiled function."""

from gnc_opt.simulation.actuators import (
    Deadband,
    Delay,
    Hold,
    Lag,
    MinimumImpulse,
    Pwm,
    Pwpf,
    Quantisation,
    RateLimit,
    Saturation,
    ScaleFactor,
    SchmittTrigger,
)
from gnc_opt.simulation.allocation import Allocation, Mixer, WheelArray
from gnc_opt.simulation.block import Block
from gnc_opt.simulation.campaign import Campaign
from gnc_opt.simulation.consistency import Consistency, InnovationTest, consistency
from gnc_opt.simulation.course import Replan
from gnc_opt.simulation.dispersion import Ball, Choice, Normal, Sphere, Turn, Uniform
from gnc_opt.simulation.disturbances import Constant, Disturbance, Expression, RandomHold, Sinusoid
from gnc_opt.simulation.ending import Ending
from gnc_opt.simulation.envelope import Envelope
from gnc_opt.simulation.event import Event, Occurrence
from gnc_opt.simulation.flight import Flight
from gnc_opt.simulation.loop import ClosedLoop
from gnc_opt.simulation.monte_carlo import monte_carlo
from gnc_opt.simulation.outcome import Outcome, RunStatus
from gnc_opt.simulation.plant import PlantFlight, fly_plant
from gnc_opt.simulation.quantity import Quantity
from gnc_opt.simulation.replanner import Replanner
from gnc_opt.simulation.run import Run
from gnc_opt.simulation.sensors import Bias, Noise, Outage, RandomWalk, Sampling, Scale, SensorDelay
from gnc_opt.simulation.thrusters import NonNegativeAllocation, ThrusterSet

__all__ = [
    "Allocation",
    "Ball",
    "Bias",
    "Block",
    "Campaign",
    "Choice",
    "ClosedLoop",
    "Consistency",
    "Constant",
    "Deadband",
    "Delay",
    "Disturbance",
    "Ending",
    "Envelope",
    "Event",
    "Expression",
    "Flight",
    "Hold",
    "InnovationTest",
    "Lag",
    "MinimumImpulse",
    "Mixer",
    "Noise",
    "NonNegativeAllocation",
    "Normal",
    "Occurrence",
    "Outage",
    "Outcome",
    "PlantFlight",
    "Pwm",
    "Pwpf",
    "Quantisation",
    "Quantity",
    "RandomHold",
    "RandomWalk",
    "RateLimit",
    "Replan",
    "Replanner",
    "Run",
    "RunStatus",
    "Sampling",
    "Saturation",
    "Scale",
    "ScaleFactor",
    "SchmittTrigger",
    "SensorDelay",
    "Sinusoid",
    "Sphere",
    "ThrusterSet",
    "Turn",
    "Uniform",
    "WheelArray",
    "consistency",
    "fly_plant",
    "monte_carlo",
]
