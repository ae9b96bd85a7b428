"""The closed loop of plant, controller, actuators, sensors, disturbances and events: runs and campaigns."""

from gnc_opt.simulation.active_reference import Replan
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
from gnc_opt.simulation.closed_loop import ClosedLoop
from gnc_opt.simulation.compiled_loop import Flight
from gnc_opt.simulation.dispersions import Ball, Choice, Normal, Sphere, Turn, Uniform
from gnc_opt.simulation.disturbances import Constant, Disturbance, Expression, RandomHold, Sinusoid
from gnc_opt.simulation.events import Event, Occurrence
from gnc_opt.simulation.external_plant import PlantFlight, fly_plant
from gnc_opt.simulation.final_values import Ending
from gnc_opt.simulation.measures import Envelope
from gnc_opt.simulation.monte_carlo import monte_carlo
from gnc_opt.simulation.outcome import Outcome, RunStatus
from gnc_opt.simulation.quantities import Quantity
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
    "fly_plant",
    "monte_carlo",
]
