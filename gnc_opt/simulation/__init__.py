"""Closed-loop simulation: plant, controller, actuators, sensors, disturbances and events; Monte Carlo campaigns."""

from functools import partial

from gnc_opt.renamed_public_names import raise_missing_name_error
from gnc_opt.simulation.actuators import (
    Deadband,
    Delay,
    Lag,
    Pwm,
    Pwpf,
    Quantisation,
    RateLimit,
    Saturation,
    ScaleFactor,
    SchmittTrigger,
    ZeroOrderHold,
)
from gnc_opt.simulation.campaign_performance_measures import Envelope
from gnc_opt.simulation.campaign_results import Campaign
from gnc_opt.simulation.closed_loop import ClosedLoop
from gnc_opt.simulation.compiled_closed_loop import CompiledLoop
from gnc_opt.simulation.control_allocation import Allocation, Mixer, WheelArray, thruster_effects
from gnc_opt.simulation.dispersions import (
    Choice,
    Normal,
    RandomDirection,
    RandomRotation,
    Uniform,
    UniformInBall,
)
from gnc_opt.simulation.disturbances import (
    ConstantDisturbance,
    Disturbance,
    ExpressionDisturbance,
    PiecewiseConstantNoise,
    SinusoidalDisturbance,
)
from gnc_opt.simulation.final_states_and_integration_error import FinalValues
from gnc_opt.simulation.monte_carlo import monte_carlo
from gnc_opt.simulation.recorded_extremes_and_integrals import Quantity
from gnc_opt.simulation.replanned_reference import Replan
from gnc_opt.simulation.sensor_and_actuator_block import Block
from gnc_opt.simulation.sensors import Bias, Noise, RandomWalk, SensorOutage
from gnc_opt.simulation.simulation_run_outcome import Outcome, RunStatus
from gnc_opt.simulation.simulation_run_results import Run
from gnc_opt.simulation.zero_crossing_events import Event, EventOccurrence

__all__ = [
    "Allocation",
    "Bias",
    "Block",
    "Campaign",
    "Choice",
    "ClosedLoop",
    "CompiledLoop",
    "ConstantDisturbance",
    "Deadband",
    "Delay",
    "Disturbance",
    "Envelope",
    "Event",
    "EventOccurrence",
    "ExpressionDisturbance",
    "FinalValues",
    "Lag",
    "Mixer",
    "Noise",
    "Normal",
    "Outcome",
    "PiecewiseConstantNoise",
    "Pwm",
    "Pwpf",
    "Quantisation",
    "Quantity",
    "RandomDirection",
    "RandomRotation",
    "RandomWalk",
    "RateLimit",
    "Replan",
    "Run",
    "RunStatus",
    "Saturation",
    "ScaleFactor",
    "SchmittTrigger",
    "SensorOutage",
    "SinusoidalDisturbance",
    "Uniform",
    "UniformInBall",
    "WheelArray",
    "ZeroOrderHold",
    "monte_carlo",
    "thruster_effects",
]

__getattr__ = partial(raise_missing_name_error, __name__)
