"""Symbols and expressions of one control step of a closed loop; for module `control_step_casadi_function`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca

from gnc_opt.model.model_variables import Layout
from gnc_opt.numerical_tolerances import SAME_TIME
from gnc_opt.simulation.block_signal_chain import (
    BlockLink,
    ColumnLayout,
    replace_signals_by_block_outputs,
    replace_waveforms_by_block_output,
    stack_named_signals,
)
from gnc_opt.simulation.closed_loop_block_connections import LoopWiring
from gnc_opt.simulation.dormand_prince import IntegrationStep, integrate_dormand_prince
from gnc_opt.simulation.intersample_actuator_output import ActuatorWaveform, stack_actuator_waveforms
from gnc_opt.simulation.recorded_extremes_and_integrals import Extremes
from gnc_opt.simulation.sensor_and_actuator_block import Step, StepContext
from gnc_opt.simulation.zero_crossing_location import (
    EventDetector,
    build_event_log_layout,
    build_event_record_layout,
)


class ControlStep:
    """Symbols and expressions of a control step; ``substeps`` are integration steps per minor step."""

    def __init__(self, wiring: LoopWiring, substeps: int) -> None:
        self.wiring, self.substeps = wiring, substeps
        self.h = wiring.minor_step_length
        self.P = ca.SX.sym("P", wiring.layout.size)
        self.p = {name: self.P[wiring.layout.slice(name)] for name in wiring.layout.names}
        self.plant_p = stack_named_signals(self.p, [f"plant.{n}" for n in wiring.plant.parameters.names])
        self.measured = Layout("state", wiring.controller.states.variables)
        groups = (("sensor", wiring.sensors), ("actuator", wiring.actuators), ("push", wiring.disturbances))
        zero = {k: self._list_block_state_sizes(links, k) for k, links in groups}
        m = wiring.minor_steps
        noises = {
            k: [link.block.noise_size(link.size) * (m if k == "actuator" else 1) for link in links]
            for k, links in groups
        }
        controls, commands = wiring.plant.controls.size, wiring.controller.commands.size
        self.state = ColumnLayout(
            (
                ("plant", wiring.plant.states.size),
                *((f"{k} {i}", n) for k, sizes in zero.items() for i, n in enumerate(sizes)),
                ("memory", wiring.controller.memory.size),
                ("command", commands),
                ("effort", controls),
                ("energy", controls),
                ("saturation", commands),
                ("variation", commands),
                ("steps", 1),
                ("fault", 1),
                ("fault time", 1),
                ("divergence", 1),
                ("divergence time", 1),
                ("alarm", 1),
                ("alarm time", 1),
                ("quantities", 5 * len(wiring.quantities)),
                *self._list_event_record_fields(
                    ("armed", len(wiring.events.owners)),
                    *build_event_record_layout(wiring.events, wiring.plant.states.size),
                ),
            )
        )
        self.known = ColumnLayout(
            (
                ("t", 1),
                ("r", wiring.controller.signals.size),
                *((f"{k} {i}", n) for k, sizes in noises.items() for i, n in enumerate(sizes)),
            )
        )
        self.log = ColumnLayout(
            (
                ("measured", self.measured.size),
                ("commands", commands),
                ("applied", controls),
                *self._list_event_record_fields(*build_event_log_layout(wiring.plant.states.size)),
            )
        )

    def _list_event_record_fields(self, *parts: tuple[str, int]) -> tuple[tuple[str, int], ...]:
        return parts if self.wiring.events else ()

    def _list_block_state_sizes(self, links: Sequence[BlockLink], kind: str) -> list[int]:
        x = ca.SX.zeros(self.wiring.plant.states.size)
        length = self.h if kind == "actuator" else self.wiring.dt
        tick = StepContext(0.0, length, self.wiring.dt, self.split_plant_state(x))
        return [
            link.block.initial_memory(
                ca.SX.zeros(link.size), self.select_parameters_of_block(link), tick
            ).shape[0]
            for link in links
        ]

    def select_parameters_of_block(self, link: BlockLink) -> dict[str, Any]:
        prefix = f"{link.block.name}."
        return {n[len(prefix) :]: s for n, s in self.p.items() if n.startswith(prefix)}

    def split_plant_state(self, x: Any) -> dict[str, Any]:
        states = self.wiring.plant.states
        return {n: x[states.slice(n)] for n in states.names}

    def evaluate_sensor_blocks(
        self, x: Any, t: Any, memory: dict[str, Any] | None, w: dict[str, Any]
    ) -> tuple[Any, dict[str, Any]]:
        """Return the measured state and the sensors' memories; without given memories the initial ones."""
        by_name = self.split_plant_state(x)
        signals = {
            n: by_name[n] if n in by_name else self._build_plant_output_expression(n, t, x)
            for n in self.measured.names
        }
        tick = StepContext(t, self.wiring.dt, self.wiring.dt, by_name)
        after = {}
        for i, link in enumerate(self.wiring.sensors):
            key, p, signal = (
                f"sensor {i}",
                self.select_parameters_of_block(link),
                stack_named_signals(signals, link.on),
            )
            before = link.block.initial_memory(signal, p, tick) if memory is None else memory[key]
            step = link.block.step(tick, signal, before, p, w[key])
            signals = replace_signals_by_block_outputs(signals, link, step.signal)
            after[key] = before if memory is None else step.state
        return stack_named_signals(signals, self.measured.names), after

    def _build_plant_output_expression(self, name: str, t: Any, x: Any) -> Any:
        plant = self.wiring.plant
        time, xs, _, ps = plant.symbolic_arguments()
        expression = plant.output_expression(name)
        return ca.substitute(expression, ca.vertcat(time, xs, ps), ca.vertcat(t, x, self.plant_p))

    def evaluate_actuator_blocks(
        self, tick: StepContext, u: Any, memory: dict[str, Any], w: dict[str, Any], minor: int
    ) -> tuple[list[ActuatorWaveform], Any]:
        """Return the applied controls and the saturation flags of the commands; updates ``memory``."""
        commands, controls = self.wiring.controller.commands, self.wiring.plant.controls
        waves = {n: ActuatorWaveform(u[commands.slice(n)]) for n in commands.names}
        origin = {n: {n} for n in commands.names}
        saturated = {n: ca.SX.zeros(commands[n].size) for n in commands.names}
        for i, link in enumerate(self.wiring.actuators):
            key, count = f"actuator {i}", link.block.noise_size(link.size)
            noise = w[key][minor * count : (minor + 1) * count]
            wave = stack_actuator_waveforms([waves[n] for n in link.on])
            wave, step = link.block.propagate_wave(
                tick, wave, memory[key], self.select_parameters_of_block(link), noise
            )
            memory[key] = step.state
            _mark_saturated_components(saturated, step, link, origin)
            waves = replace_waveforms_by_block_output(waves, link, wave)
            sources = set().union(*(origin[n] for n in link.on))
            origin.update({n: origin[n] if n in link.on else sources for n in link.outputs})
        zeros = {n: ActuatorWaveform(ca.SX.zeros(controls[n].size)) for n in controls.names}
        return [waves.get(n, zeros[n]) for n in controls.names], stack_named_signals(
            saturated, commands.names
        )

    def build_initial_actuator_memories(self, tick: StepContext, r: Any) -> dict[str, Any]:
        """Return the initial memories of the actuators; the feedforward passes through them if one starts at trim."""
        wiring, memory = self.wiring, {}
        signals = wiring.feedforward(r) if wiring.starts_at_trim else {}
        for i, link in enumerate(wiring.actuators):
            block, p = link.block, self.select_parameters_of_block(link)
            signal = (
                stack_named_signals(signals, link.on) if wiring.starts_at_trim else ca.SX.zeros(link.size)
            )
            begin = signal if block.starts_at_trim else ca.SX.zeros(link.size)
            memory[f"actuator {i}"] = first = block.initial_memory(begin, p, tick)
            if wiring.starts_at_trim:
                no_noise = ca.SX.zeros(block.noise_size(link.size))
                signals = replace_signals_by_block_outputs(
                    signals,
                    link,
                    block.propagate_wave(tick, ActuatorWaveform(signal), first, p, no_noise)[1].signal,
                )
        return memory

    def build_initial_event_record(self, t: Any, x: Any) -> dict[str, Any]:
        """Return the initial record of events; rows that are not negative are armed."""
        y = self.wiring.events.rows(t, x, ca.SX.zeros(x.shape[0]), self.plant_p)[0]
        return {"armed": y >= 0, "first": ca.SX.nan(len(self.wiring.events))}

    def _build_plant_rate_function(self, memories: dict[str, Any]) -> Any:
        """Return f(t, x, u) of the plant with applied controls and disturbances."""
        plant, links = self.wiring.plant, self.wiring.disturbances

        def evaluate_plant_rate(t: Any, x: Any, u: Any) -> Any:
            if not links:
                return plant.function(t, x, u, self.plant_p)
            by_name = self.split_plant_state(x)
            extra_u, extra_x = ca.SX.zeros(plant.controls.size), ca.SX.zeros(plant.states.size)
            for i, link in enumerate(links):
                memory, p = memories[f"push {i}"], self.select_parameters_of_block(link)
                value = link.block.value(t, by_name, memory, p)  # type: ignore[attr-defined]
                if link.on[0] in plant.controls:
                    extra_u[plant.controls.slice(link.on[0])] += value
                else:
                    extra_x[plant.states.slice(link.on[0])] += value
            return plant.function(t, x, u + extra_u, self.plant_p) + extra_x

        return evaluate_plant_rate

    def integrate_plant(
        self,
        t: Any,
        x: Any,
        waves: list[ActuatorWaveform],
        state: dict[str, Any],
        span: tuple[Any, Any] | None = None,
        watches: Sequence[Callable[[IntegrationStep, Callable[[Any], Any]], None]] = (),
    ) -> Any:
        """Return the state after a minor step that starts at t, or after a ``span`` (s) within it."""
        f, n, wave = self._build_plant_rate_function(state), self.substeps, stack_actuator_waveforms(waves)
        begin, end = span or (ca.SX(0), ca.SX(self.h))
        length = end - begin

        def evaluate_applied_control(late: Any) -> Any:
            return wave.evaluate_actuator_waveform(lambda tau: ca.exp(-(begin + late) / tau))

        def record_integration_step(taken: IntegrationStep) -> None:
            for watch in watches:
                watch(taken, lambda nu: evaluate_applied_control((taken.number + nu) * taken.length))

        if wave.at is None:
            return integrate_dormand_prince(
                lambda t, x, _: f(t, x, wave.mean), t + begin, x, length, n, None, record_integration_step
            )
        return integrate_dormand_prince(
            f,
            t + begin,
            x,
            length,
            n,
            wave.sample_runge_kutta_stage_inputs(begin, length / n),
            record_integration_step,
        )

    def build_minor_step_time_and_state(
        self, i: int, w: dict[str, Any], state: dict[str, Any]
    ) -> StepContext:
        return StepContext(
            w["t"] + i * self.h, self.h, self.wiring.dt, self.split_plant_state(state["plant"])
        )

    def update_disturbance_memories(self, state: dict[str, Any], w: dict[str, Any]) -> dict[str, Any]:
        """Return the state with the disturbances' memories for this control step."""
        new = dict(state)
        for i, link in enumerate(self.wiring.disturbances):
            key = f"push {i}"
            tick = StepContext(w["t"], self.wiring.dt, self.wiring.dt, self.split_plant_state(state["plant"]))
            new[key] = link.block.update(tick, state[key], self.select_parameters_of_block(link), w[key])  # type: ignore[attr-defined]
        return new

    def accumulate_control_effort(self, new: dict[str, Any], applied: Any, saturated: Any, time: Any) -> None:
        """Add effort, energy and saturation of the applied controls over a time (s)."""
        new["effort"] += time * ca.fabs(applied)
        new["energy"] += time * applied**2
        new["saturation"] += time * saturated

    def complete_control_step(
        self, new: dict[str, Any], state: dict[str, Any], t: Any, logged: dict[str, Any], z: Any
    ) -> Any:
        """Return the completed state after a control step, and its log."""
        y, u, mean = logged["measured"], logged["commands"], logged["applied"]
        new |= {"memory": z, "command": u, "steps": state["steps"] + 1}
        new["variation"] += ca.if_else(state["steps"] > 0.5, ca.fabs(u - state["command"]), 0.0)
        monitored = [*select_monitored_measurements(self.wiring, y), u, mean, new["plant"]]
        if self.wiring.events:
            monitored.append(ca.if_else(new["lost"], ca.inf, 0))
        n = len(self.wiring.quantities)
        monitored.append(new["quantities"][2 * n : 3 * n])  # integrals, which stay infinite or NaN
        self._record_first_nan_divergence_alarm(new, state, t, ca.vertcat(*monitored), z)
        zeros = {name: ca.SX.zeros(size) for name, size in self.log.parts}
        return self.log.stack_vector_by_name({**zeros, **logged})

    def create_quantity_extreme_tracker(self, waves: Sequence[ActuatorWaveform]) -> Extremes:
        panels = 1 if all(wave.at is None for wave in waves) else 2
        return Extremes(self.wiring.quantities, self.plant_p, panels)

    def create_event_detector(self, state: dict[str, Any], begin: Any) -> EventDetector:
        return EventDetector(self.wiring.events, state["armed"], self.plant_p, begin, SAME_TIME * self.h)

    def _record_first_nan_divergence_alarm(
        self, new: dict[str, Any], state: dict[str, Any], t: Any, monitored: Any, z: Any
    ) -> None:
        """Record the first non-finite quantity, the first diverged state and the first alarm, with their times."""
        wiring = self.wiring
        fault = ca.SX(0)
        for i in reversed(range(monitored.shape[0])):
            fault = ca.if_else(ca.fabs(monitored[i]) < ca.inf, fault, i + 1.0)
        alarm_slices = [wiring.controller.memory.slice(name) for name in wiring.controller.alarms]
        flags = [z[k] for rows in alarm_slices for k in range(rows.start, rows.stop)]
        alarm = ca.SX(0)
        for i, flag in reversed(list(enumerate(flags))):
            # not "!= 0": that is false for NaN in some virtual machines
            alarm = ca.if_else(ca.fabs(flag) <= 0, alarm, i + 1.0)
        divergence = ca.SX(0)
        for i, largest in reversed(list(enumerate(wiring.divergence_limits))):
            divergence = ca.if_else(ca.fabs(new["plant"][i]) > largest, i + 1.0, divergence)
        for name, code in (("fault", fault), ("divergence", divergence), ("alarm", alarm)):
            is_first = ca.logic_and(state[name] < 0.5, code > 0.5)
            new[name] = ca.if_else(is_first, code, state[name])
            new[f"{name} time"] = ca.if_else(is_first, t, state[f"{name} time"])


def select_monitored_measurements(wiring: LoopWiring, measured: Any) -> tuple[Any, ...]:
    """Return the measurement, or nothing if the controller or its estimator handles lost samples."""
    controller = wiring.controller
    return (measured,) if controller.without_dropout_handling is None and controller.estimated is None else ()


def list_nonfinite_quantity_labels(wiring: LoopWiring) -> list[str]:
    """Return the labels of the codes of non-finite quantities, starting at code 1."""
    groups = (
        *select_monitored_measurements(wiring, ("measured", wiring.controller.states)),
        ("command", wiring.controller.commands),
        ("applied", wiring.plant.controls),
        ("state", wiring.plant.states),
        ("event", wiring.events.layout),
        ("quantity", wiring.quantities.layout),
    )
    return [f"{kind} '{label}'" for kind, layout in groups for label in layout.labels]


def list_controller_alarm_labels(wiring: LoopWiring) -> list[str]:
    """Return the labels of the alarm codes, starting at code 1."""
    memory = wiring.controller.memory
    return [label for name in wiring.controller.alarms for label in memory[name].labels]


def _mark_saturated_components(
    saturated: dict[str, Any], step: Step, link: BlockLink, origin: Mapping[str, set[str]]
) -> None:
    """Mark saturated components: the same component, or all input components of the block."""
    if step.saturated is None:
        return
    first = 0
    sizes = {n: saturated[n].shape[0] for n in saturated}
    straight = link.size == step.saturated.shape[0] and all(n in sizes for n in link.on)
    if straight:
        for name in link.on:
            part = step.saturated[first : first + sizes[name]]
            saturated[name] = ca.fmax(saturated[name], part)
            first += sizes[name]
        return
    any_at_all = ca.mmax(step.saturated)
    for name in set().union(*(origin[n] for n in link.on)):
        saturated[name] = ca.fmax(saturated[name], any_at_all)
