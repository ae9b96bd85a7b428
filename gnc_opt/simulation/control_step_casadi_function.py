r"""Kernel: CasADi function of one control step of the closed loop.

The sensors sample the plant and the controller computes the command (zero-order hold). In each of m minor steps the
actuators are updated and the plant is integrated. Column X (`ColumnLayout`) is the state, P the parameters of the run
(`ClosedLoop.layout`), w the known or drawn inputs: time, schedule, random numbers. A control step in which an event may
occur is repeated with event location (`gnc_opt.simulation.zero_crossing_location`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca

from gnc_opt.simulation.block_signal_chain import ColumnLayout, stack_named_signals
from gnc_opt.simulation.closed_loop_block_connections import LoopWiring
from gnc_opt.simulation.control_step_expressions import ControlStep
from gnc_opt.simulation.intersample_actuator_output import ActuatorWaveform
from gnc_opt.simulation.recorded_extremes_and_integrals import (
    create_empty_extremes_and_integrals,
    merge_extremes_and_integrals,
)
from gnc_opt.simulation.sensor_and_actuator_block import StepContext
from gnc_opt.simulation.zero_crossing_location import build_event_location_function, build_event_log_layout


def build_step_with_event_location(step: ControlStep, act: Any) -> Any:
    """Return ``(X, w, C, y, u, z_next) -> (X_next, log)``: the minor steps with event location."""
    return _ControlStepWithEvents(step).build_event_step_function(act)


def freeze_state_after_end_event(control_step: ControlStep, step: Any, log: Any) -> Any:
    """Return the step, inactive after an event has ended the run, with ``log`` as second output."""
    x, w, c = (ca.MX.sym(step.name_in(i), step.size1_in(i)) for i in range(3))
    frozen = ca.Function("rest", [x, w, c], [x, log])
    either = ca.Function.if_else("either", frozen, step)
    after = either(control_step.state.split_vector_by_name(x)["stop"] > 0.5, x, w, c)
    return ca.Function(step.name(), [x, w, c], after, step.name_in(), step.name_out())


class _ControlStepWithEvents:
    """Minor steps with event location; L is the event log of the control step, a column next to the state X."""

    def __init__(self, step: ControlStep) -> None:
        self.base, self.wiring, self.h, self.P = step, step.wiring, step.h, step.P
        self.state, self.known = step.state, step.known
        sums = (("applied", step.wiring.plant.controls.size), ("elapsed", 1))
        self.event_log = ColumnLayout((*sums, *build_event_log_layout(step.wiring.plant.states.size)))

    def build_event_step_function(self, act: Any) -> Any:
        """Return ``act``, repeated with event location if it contains an event."""
        inputs = [ca.MX.sym(f"i{i}", act.size1_in(i)) for i in range(act.n_in())]
        after, log, event_found = act(*inputs)
        results = [ca.MX.sym("after", self.state.size), ca.MX.sym("log", self.base.log.size)]
        without_event = ca.Function("without_event", [*inputs, *results], results)
        with_event = ca.Function("with_event", [*inputs, *results], self._propagate_control_step(*inputs))
        either = ca.Function.if_else("either", with_event, without_event)
        return ca.Function("act", inputs, either(event_found, *inputs, after, log))

    def _propagate_control_step(self, X: Any, w: Any, C: Any, y: Any, u: Any, z: Any) -> list[Any]:
        """Return the state after a control step with events, and its log; MX."""
        P, log = C[: self.P.shape[0]], ca.MX.zeros(self.event_log.size)
        state = self._build_disturbance_update_function()(X, w, P)
        for i in range(self.wiring.minor_steps):
            minor_step, ended = self._build_minor_step_functions(i)
            either = ca.Function.if_else("minor", ended, minor_step)
            state, log = either(self.state.split_vector_by_name(state)["stop"] > 0.5, state, log, w, P, u)
        return list(self._build_control_step_log_function()(X, state, log, w, y, u, z))

    def _build_disturbance_update_function(self) -> Any:
        """Return ``(X, w, P) -> X`` with the memories of the disturbances for this control step."""
        X, w = ca.SX.sym("X", self.state.size), ca.SX.sym("w", self.known.size)
        state, known = self.state.split_vector_by_name(X), self.known.split_vector_by_name(w)
        updated = self.state.stack_vector_by_name(self.base.update_disturbance_memories(state, known))
        return ca.Function("begin", [X, w, self.P], [updated])

    def _build_minor_step_functions(self, i: int) -> tuple[Any, Any]:
        """Return ``(X, L, w, P, u) -> (X, L)`` of a minor step with events, and its version after the end of a run."""
        X, w = ca.SX.sym("X", self.state.size), ca.SX.sym("w", self.known.size)
        context = [X, w, self.P, ca.SX.sym("u", self.wiring.controller.commands.size)]
        state, known = self.state.split_vector_by_name(X), self.known.split_vector_by_name(w)
        new, tick = dict(state), self.base.build_minor_step_time_and_state(i, known, state)
        waves, saturated = self.base.evaluate_actuator_blocks(tick, context[-1], new, known, i)
        propagation = self._build_propagation_function(tick.t, waves, new, context)
        locate, layout = build_event_location_function(self.wiring.events, propagation, self.h)
        record = self._build_record_function(layout, waves, saturated, new, context)

        X, L, w, P, u = inputs = [
            ca.MX.sym(f"i{k}", e.shape[0])
            for k, e in enumerate([X, ca.SX(self.event_log.size, 1), *context[1:]])
        ]
        state, log = self.state.split_vector_by_name(X), self.event_log.split_vector_by_name(L)
        first = {k: (state | log)[k] for k, _ in layout.parts if k in state | log}
        first |= {"x": state["plant"], "s": ca.MX(0)}
        t = self.known.split_vector_by_name(w)["t"] + i * self.h
        p = [P[self.wiring.layout.slice(f"plant.{name}")] for name in self.wiring.plant.parameters.names]
        last = locate(layout.stack_vector_by_name(first), t, ca.vertcat(*p), X, w, P, u)
        minor_step = ca.Function("minor", inputs, list(record(last, L, X, w, P, u)))
        return minor_step, ca.Function("ended", inputs, [X, L])

    def _build_propagation_function(
        self, t: Any, waves: list[ActuatorWaveform], state: dict[str, Any], context: list[Any]
    ) -> Any:
        """Return ``(x, armed, begin, end, *context)`` -> plant state at the end, and what the detector has found."""
        x, armed = ca.SX.sym("x", self.wiring.plant.states.size), ca.SX.sym("armed", state["armed"].shape[0])
        begin, end = ca.SX.sym("begin"), ca.SX.sym("end")
        detector = self.base.create_event_detector({"armed": armed}, begin)
        extremes = self.base.create_quantity_extreme_tracker(waves)
        final = self.base.integrate_plant(t, x, waves, state, (begin, end), (detector, extremes))
        detected = [detector.armed, detector.y, detector.slope, detector.found, detector.first, detector.last]
        detected += [detector.lost, detector.lost_inside, extremes.record]
        return ca.Function("propagation", [x, armed, begin, end, *context], [final, *detected])

    def _build_record_function(
        self,
        layout: ColumnLayout,
        waves: list[ActuatorWaveform],
        saturated: Any,
        state: dict[str, Any],
        context: list[Any],
    ) -> Any:
        """Return ``(q, L, *context) -> (X, L)``: the values q at the end of a minor step, of a layout, in X and L."""
        q, L = ca.SX.sym("q", layout.size), ca.SX.sym("L", self.event_log.size)
        last, log = layout.split_vector_by_name(q), self.event_log.split_vector_by_name(L)
        state = state | {"plant": last["x"]} | {name: last[name] for name, _ in layout.parts if name in state}
        applied = ca.vertcat(*[wave.mean for wave in waves])
        self.base.accumulate_control_effort(state, applied, saturated, last["s"])
        log |= {"applied": log["applied"] + last["s"] * applied, "elapsed": log["elapsed"] + last["s"]}
        log |= {name: last[name] for name in log if name in last}
        stacked = [self.state.stack_vector_by_name(state), self.event_log.stack_vector_by_name(log)]
        return ca.Function("record", [q, L, *context], stacked)

    def _build_control_step_log_function(self) -> Any:
        """Return ``(X before, X, L, w, y, u, z) -> (X_next, log)``, evaluated after the last minor step."""
        controller = self.wiring.controller
        sizes = {
            "before": self.state.size,
            "X": self.state.size,
            "L": self.event_log.size,
            "w": self.known.size,
        }
        sizes |= {"y": self.base.measured.size, "u": controller.commands.size, "z": controller.memory.size}
        before, X, L, w, y, u, z = inputs = [ca.SX.sym(name, size) for name, size in sizes.items()]
        state, events = self.state.split_vector_by_name(X), self.event_log.split_vector_by_name(L)
        applied = ca.if_else(events["elapsed"] > 0, events["applied"] / events["elapsed"], 0.0)
        logged = {**events, "measured": y, "commands": u, "applied": applied}
        first, t = self.state.split_vector_by_name(before), self.known.split_vector_by_name(w)["t"]
        log = self.base.complete_control_step(state, first, t, logged, z)
        return ca.Function("closing", inputs, [self.state.stack_vector_by_name(state), log])


@dataclass(frozen=True)
class LoopKernel:
    """Functions of a loop, and the layouts of its columns X, w and log.

    Attributes
    ----------
    constants : casadi.Function
        ``P -> C``: parameters and the values derived from them.
    start, step, measure : casadi.Function
        ``(w, P) -> X``; ``(X, w, C) -> (X_next, log)``; ``(X, w, C) -> y``, the controller's input.
    unconstrained_step : casadi.Function or None
        ``(X, w, C) -> (X_next, valid)`` with the unconstrained law of a controller; ``step`` is needed where valid is
        not 1.
    """

    constants: Any
    start: Any
    step: Any
    unconstrained_step: Any
    measure: Any
    state: ColumnLayout
    known: ColumnLayout
    log: ColumnLayout

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in vars(self).items() if k != "step_sequence_functions"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)

    @cached_property
    def step_sequence_functions(self) -> dict[Any, Any]:
        """Functions of many steps, shared by all compiled loops; with log they take 0.2 s to build."""
        return {}


def build_closed_loop_step_functions(wiring: LoopWiring, substeps: int) -> LoopKernel:
    """Return the kernel with ``substeps`` integration steps per minor step."""
    return _KernelBuilder(wiring, substeps).assemble_closed_loop_step_functions()


class _KernelBuilder(ControlStep):
    def assemble_closed_loop_step_functions(self) -> LoopKernel:
        constants, act = self._build_actuator_and_plant_step_functions()
        step, unconstrained_step = (
            self._build_closed_loop_step_function(constants, act),
            self._build_unconstrained_loop_step(constants, act),
        )
        measure = self._build_measurement_function(constants)
        return LoopKernel(
            constants,
            self._build_initial_state_function(),
            step,
            unconstrained_step,
            measure,
            self.state,
            self.known,
            self.log,
        )

    def _build_initial_state_function(self) -> Any:
        wiring = self.wiring
        column = ca.SX.sym("w", self.known.size)
        w = self.known.split_vector_by_name(column)
        x = stack_named_signals(self.p, [f"initial.{n}" for n in wiring.plant.states.names])
        y, sensors = self.evaluate_sensor_blocks(x, w["t"], None, w)
        tick = StepContext(w["t"], self.h, wiring.dt, self.split_plant_state(x))
        parts: dict[str, Any] = {name: ca.SX.zeros(n) for name, n in self.state.parts}
        parts |= {
            "plant": x,
            **sensors,
            "quantities": create_empty_extremes_and_integrals(len(wiring.quantities)),
        }
        parts |= self.build_initial_actuator_memories(tick, w["r"])
        if wiring.events:
            parts |= self.build_initial_event_record(w["t"], x)
        for i, link in enumerate(wiring.disturbances):
            parts[f"push {i}"] = link.block.initial_memory(
                ca.SX.zeros(link.size), self.select_parameters_of_block(link), tick
            )
        before = ca.Function("before", [column, self.P], [y, self.state.stack_vector_by_name(parts)])
        kind = _get_casadi_symbol_type(wiring.controller.start)
        w_, p_ = kind.sym("w", self.known.size), kind.sym("P", self.P.shape[0])
        y_, state = before(w_, p_)
        values = self.state.split_vector_by_name(state)
        known = self.known.split_vector_by_name(w_)
        values["memory"] = wiring.controller.start(known["t"], y_, known["r"])
        return ca.Function("start", [w_, p_], [self.state.stack_vector_by_name(values)], ["w", "P"], ["X"])

    def _build_closed_loop_step_function(self, constants: Any, act: Any) -> Any:
        inputs, after, log, _ = self._build_closed_loop_step_expressions(
            self.wiring.controller.step, constants, act
        )
        step = ca.Function("step", inputs, [after, log], ["X", "w", "C"], ["X_next", "log"])
        return (
            freeze_state_after_end_event(self, step, ca.MX.zeros(self.log.size))
            if self.wiring.events
            else step
        )

    def _build_unconstrained_loop_step(self, constants: Any, act: Any) -> Any:
        law = self.wiring.controller.unconstrained_law
        if law is None:
            return None
        inputs, after, _, (valid,) = self._build_closed_loop_step_expressions(law, constants, act)
        step = ca.Function("unconstrained_step", inputs, [after, valid], ["X", "w", "C"], ["X_next", "valid"])
        return freeze_state_after_end_event(self, step, ca.MX(1)) if self.wiring.events else step

    def _build_closed_loop_step_expressions(
        self, law: Any, constants: Any, act: Any
    ) -> tuple[list[Any], Any, Any, list[Any]]:
        """Return the symbols X, w, C, and X_next, log and the validity of the unconstrained law for one step."""
        kind = ca.MX if self.wiring.events else _get_casadi_symbol_type(law)
        sizes = (("X", self.state.size), ("w", self.known.size), ("C", constants.size1_out(0)))
        x, w, c = inputs = [kind.sym(name, size) for name, size in sizes]
        y, sensed = self._build_sensor_sampling_function()(x, w, c[: self.P.shape[0]])
        known = self.known.split_vector_by_name(w)
        u, memory, *valid = law(known["t"], y, known["r"], self.state.split_vector_by_name(x)["memory"])
        return inputs, *act(sensed, w, c, y, u, memory), valid

    def _build_measurement_function(self, constants: Any) -> Any:
        x, w = ca.MX.sym("X", self.state.size), ca.MX.sym("w", self.known.size)
        c = ca.MX.sym("C", constants.size1_out(0))
        y, _ = self._build_sensor_sampling_function()(x, w, c[: self.P.shape[0]])
        return ca.Function("measure", [x, w, c], [y], ["X", "w", "C"], ["y"])

    def _build_sensor_sampling_function(self) -> Any:
        x, column = ca.SX.sym("X", self.state.size), ca.SX.sym("w", self.known.size)
        state, w = self.state.split_vector_by_name(x), self.known.split_vector_by_name(column)
        y, sensors = self.evaluate_sensor_blocks(state["plant"], w["t"], state, w)
        return ca.Function(
            "sense", [x, column, self.P], [y, self.state.stack_vector_by_name(state | sensors)]
        )

    def _build_actuator_and_plant_step_functions(self) -> tuple[Any, Any]:
        """Return the constants, and the minor steps with totals: ``(X, w, C, y, u, z_next) -> (X_next, log)``."""
        wiring = self.wiring
        column_x, column = ca.SX.sym("X", self.state.size), ca.SX.sym("w", self.known.size)
        y, u = ca.SX.sym("y", self.measured.size), ca.SX.sym("u", wiring.controller.commands.size)
        z = ca.SX.sym("z", wiring.controller.memory.size)
        state, w = self.state.split_vector_by_name(column_x), self.known.split_vector_by_name(column)
        new = self.update_disturbance_memories(state, w)
        mean, event_found = ca.SX.zeros(wiring.plant.controls.size), ca.SX(0)
        for i in range(wiring.minor_steps):
            tick = self.build_minor_step_time_and_state(i, w, new)
            waves, saturated = self.evaluate_actuator_blocks(tick, u, new, w, i)
            applied = ca.vertcat(*[wave.mean for wave in waves])
            watch, extremes = (
                self.create_event_detector(new, ca.SX(0)) if wiring.events else None,
                self.create_quantity_extreme_tracker(waves),
            )
            watches = (extremes,) if watch is None else (watch, extremes)
            new["plant"] = self.integrate_plant(tick.t, new["plant"], waves, new, watches=watches)
            new["quantities"] = merge_extremes_and_integrals(new["quantities"], extremes.record)
            if watch is not None:
                new["armed"], event_found = watch.armed, ca.fmax(event_found, watch.found)
                new["lost"] = ca.fmax(new["lost"], watch.lost)
            mean += applied / wiring.minor_steps
            self.accumulate_control_effort(new, applied, saturated, self.h)
        log = self.complete_control_step(
            new, state, w["t"], {"measured": y, "commands": u, "applied": mean}, z
        )
        # values derived from P only are computed once per run
        results = [self.state.stack_vector_by_name(new), log, event_found]
        outputs, symbols, values = ca.extract_parametric(results, self.P)
        constants, names = ca.vertcat(self.P, *values), ca.vertcat(self.P, *symbols)
        act = ca.Function("act", [column_x, column, names, y, u, z], outputs)
        return (
            ca.Function("constants", [self.P], [constants], ["P"], ["C"]),
            build_step_with_event_location(self, act)
            if wiring.events
            else act.slice("act", list(range(6)), [0, 1]),
        )


def _get_casadi_symbol_type(function: Any) -> Any:
    return ca.SX if function.is_a("SXFunction") else ca.MX
