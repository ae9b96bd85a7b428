"""Assembly of a closed loop: connections of plant, controller and blocks, with consistency checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.argument_checks import require_distinct_names
from gnc_opt.array_types import Array
from gnc_opt.control.discrete_time_controller import Controller
from gnc_opt.errors import ArgumentError, suggest_similar_name
from gnc_opt.model.model_variables import Layout, Variable
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.simulation.block_signal_chain import (
    BlockLink,
    Kinds,
    connect_block_chain,
    get_signal_sizes_and_units,
)
from gnc_opt.simulation.disturbances import Disturbance
from gnc_opt.simulation.recorded_extremes_and_integrals import Quantities, Quantity
from gnc_opt.simulation.sensor_and_actuator_block import Block, StepContext
from gnc_opt.simulation.zero_crossing_events import Event, Events


def check_measured_signals(plant: Model, controller: Controller) -> None:
    """Raise an error if the plant lacks a state or output that the controller measures or follows."""
    for variable in controller.states.variables:
        _check_plant_provides_signal(variable, plant, controller, "measures")
        if variable.name in plant.outputs and any(
            ca.which_depends(plant.output_expression(variable.name), plant.symbols("control"))
        ):
            raise ArgumentError(
                f"controller '{controller.name}' measures the output '{variable.name}' of '{plant.name}', which "
                "depends on a control: measure one of states alone."
            )
    for variable in controller.reference_layout.variables if controller.estimated is not None else ():
        if variable.name in plant.states:  # estimated states need not exist in the plant
            _check_plant_provides_signal(variable, plant, controller, "estimates")


def _check_plant_provides_signal(variable: Variable, plant: Model, controller: Controller, verb: str) -> None:
    kind = "output" if variable.name in plant.outputs else "state"
    layout = plant.outputs if kind == "output" else plant.states
    if variable.name not in layout:
        names = [*plant.states.names, *plant.outputs.names]
        raise ArgumentError(
            f"controller '{controller.name}' {verb} '{variable.name}', which the plant '{plant.name}' does not "
            f"have: {suggest_similar_name(variable.name, names)}"
        )
    if layout[variable.name].size != variable.size:
        raise ArgumentError(
            f"{kind} '{variable.name}' has {layout[variable.name].size} components in the plant "
            f"'{plant.name}' and {variable.size} in controller '{controller.name}'."
        )
    _check_equal_units(
        f"{kind} '{variable.name}'", plant, layout[variable.name].unit, variable.unit, controller
    )


def _check_equal_units(what: str, plant: Model, unit: str, expected: str, controller: Controller) -> None:
    """Raise an error for two different declared units; an undeclared unit is accepted."""
    one, other = ("".join(c for c in text if c not in " *·") for text in (unit, expected))
    if one and other and one != other:
        raise ArgumentError(
            f"{what} is in {unit} in the plant '{plant.name}' and in {expected} in controller '{controller.name}': "
            "declare the same unit in both models."
        )


def check_actuator_outputs(plant: Model, applied: Kinds, controller: Controller) -> None:
    """Raise an error for actuator outputs that are not controls of the plant."""
    for name, (size, unit) in applied.items():
        if name not in plant.controls:
            raise ArgumentError(
                f"'{name}' arrives at the plant '{plant.name}', which has no such control: "
                f"{suggest_similar_name(name, plant.controls.names)}"
            )
        if plant.controls[name].size != size:
            raise ArgumentError(
                f"control '{name}' has {plant.controls[name].size} components in the plant '{plant.name}', but {size} "
                "arrive there."
            )
        _check_equal_units(f"control '{name}'", plant, plant.controls[name].unit, unit, controller)


@dataclass(frozen=True, eq=False)
class LoopWiring:
    """Components of a closed loop and their connections; see `ClosedLoop`.

    Attributes
    ----------
    dt : float
        Control step, s.
    minor_steps : int
        Number of minor steps per control step.
    divergence_limits : array (n_states,)
        Magnitudes of the plant's states above which a run has diverged.
    """

    plant: Model
    controller: Controller
    actuators: tuple[BlockLink, ...]
    sensors: tuple[BlockLink, ...]
    disturbances: tuple[BlockLink, ...]
    dt: float
    minor_steps: int
    divergence_limits: Array
    events: Events
    quantities: Quantities

    @property
    def minor_step_length(self) -> float:
        """Minor step, s."""
        return self.dt / self.minor_steps

    @property
    def blocks_and_step_lengths(self) -> list[tuple[BlockLink, float]]:
        """All links with the lengths (s) of their steps."""
        slow = (*self.sensors, *self.disturbances)
        return [
            *((link, self.minor_step_length) for link in self.actuators),
            *((link, self.dt) for link in slow),
        ]

    @property
    def starts_at_trim(self) -> bool:
        """Whether the initial output of an actuator is the feedforward."""
        return any(link.block.starts_at_trim for link in self.actuators)

    def feedforward(self, r: Any) -> dict[str, Any]:
        """Return the feedforward (SX) of every command by name, from a schedule row r."""
        signals = self.controller.signals
        return {n: r[signals.slice(f"{n}_ff")] for n in self.controller.commands.names}

    # --- what can be dispersed ----------------------------------------------------------------------------

    @cached_property
    def layout(self) -> Layout:
        """Names, sizes and units of all parameters that can differ between runs."""
        return Layout(
            "parameter",
            tuple(variable for variable, _ in self._dispersible_parameter_defaults),
            "the closed loop",
        )

    @cached_property
    def default_parameters(self) -> Array:
        """Default values of `layout`, shape (n,); NaN for initial states."""
        return np.concatenate([value for _, value in self._dispersible_parameter_defaults])

    @cached_property
    def parameter_ranges(self) -> tuple[Array, Array]:
        """Smallest and largest permitted values of `layout`, each of shape (n,)."""
        lower, upper = (np.full(self.layout.size, -np.inf), np.full(self.layout.size, np.inf))
        for link, step in self.blocks_and_step_lengths:
            for name, (smallest, largest) in link.block.parameter_limits(step, self.dt).items():
                place = self.layout.slice(f"{link.block.name}.{name}")
                lower[place], upper[place] = smallest, largest
        return lower, upper

    @cached_property
    def _dispersible_parameter_defaults(self) -> list[tuple[Variable, Array]]:
        parameters, states = self.plant.parameters, self.plant.states
        numbers = self.plant.parameter_values
        entries = [
            (Variable(f"plant.{v.name}", v.size, v.unit), numbers[parameters.slice(v.name)])
            for v in parameters.variables
        ]
        entries += [
            (Variable(f"initial.{v.name}", v.size, v.unit), np.full(v.size, np.nan)) for v in states.variables
        ]
        for link, _ in self.blocks_and_step_lengths:
            for name, (value, unit) in link.block.parameters(link.size, link.unit).items():
                entries.append((Variable(f"{link.block.name}.{name}", value.size, unit), value))
        return entries


@dataclass(frozen=True)
class LoopBlocks:
    """Blocks of a loop in the order of the signal flow, with events and quantities."""

    actuators: tuple[Block, ...]
    sensors: tuple[Block, ...]
    disturbances: tuple[Disturbance, ...]
    events: tuple[Event, ...] = ()
    quantities: tuple[Quantity, ...] = ()


def connect_closed_loop(
    plant: Model,
    controller: Controller,
    blocks: LoopBlocks,
    dt: float,
    minor_steps: int,
    divergence_limits: Array,
) -> LoopWiring:
    """Return the connected loop; raise `ArgumentError` or `UnknownNameError` for inconsistent parts."""
    check_measured_signals(plant, controller)
    for block in (*blocks.actuators, *blocks.sensors):
        if isinstance(block, Disturbance):
            raise ArgumentError(
                f"'{block.name}' is a disturbance, not an actuator or a sensor: give it among the disturbances."
            )
    all_blocks = (*blocks.actuators, *blocks.sensors, *blocks.disturbances)
    require_distinct_names([block.name for block in all_blocks], "blocks of the closed loop")
    actuators, applied = connect_block_chain(
        blocks.actuators, get_signal_sizes_and_units(controller.commands), "command"
    )
    check_actuator_outputs(plant, applied, controller)
    sensors = _connect_sensor_blocks(controller, blocks.sensors)
    targets = get_signal_sizes_and_units(plant.controls) | {
        n: (size, f"{unit}/s".replace("/s/s", "/s^2"))
        for n, (size, unit) in get_signal_sizes_and_units(plant.states).items()
    }
    disturbances = [connect_block_chain([d], targets, "state or control")[0][0] for d in blocks.disturbances]
    events, quantities = (
        Events.read_event_declarations(plant, blocks.events),
        Quantities.read_quantity_declarations(plant, blocks.quantities),
    )
    wiring = LoopWiring(
        plant,
        controller,
        tuple(actuators),
        sensors,
        tuple(disturbances),
        dt,
        minor_steps,
        divergence_limits,
        events,
        quantities,
    )
    for link, step in wiring.blocks_and_step_lengths:
        link.block.check_sizes(link.size, step, dt)
    _check_sensor_functions(wiring)
    _require_feedforward_at_trim(wiring)
    return wiring


def _check_sensor_functions(wiring: LoopWiring) -> None:
    """Evaluate every sensor once, so that invalid user functions raise an error here."""
    states, dt = wiring.plant.states, wiring.dt
    tick = StepContext(ca.SX.sym("t"), dt, dt, {v.name: ca.SX.sym(v.name, v.size) for v in states.variables})
    for link in wiring.sensors:
        block, signal = link.block, ca.SX.sym("y", link.size)
        p = {
            name: ca.SX.sym(name, value.size)
            for name, (value, _) in block.parameters(link.size, link.unit).items()
        }
        noise = ca.SX.sym("noise", block.noise_size(link.size))
        block.step(tick, signal, block.initial_memory(signal, p, tick), p, noise)


def _require_feedforward_at_trim(wiring: LoopWiring) -> None:
    at_trim = [link.block.name for link in wiring.actuators if link.block.starts_at_trim]
    for name in wiring.controller.commands.names if at_trim else ():
        if f"{name}_ff" not in wiring.controller.signals:
            raise ArgumentError(
                f"'{at_trim[0]}' is to start at trim, but '{wiring.controller.name}' has no feedforward of '{name}': "
                "give initial= as a number."
            )


def _connect_sensor_blocks(controller: Controller, blocks: Sequence[Block]) -> tuple[BlockLink, ...]:
    states = get_signal_sizes_and_units(controller.states)
    links, measured = connect_block_chain(blocks, states, "measured state")
    if measured != states:
        raise ArgumentError("the sensors of a closed loop change names or sizes of the states: keep them.")
    return tuple(links)
