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
    rest = ca.Function("rest", [x, w, c], [x, log])
    either = ca.Function.if_else("either", rest, step)
    after = either(control_step.state.split_vector_by_name(x)["stop"] > 0.5, x, w, c)
    return ca.Function(step.name(), [x, w, c], after, step.name_in(), step.name_out())


class _ControlStepWithEvents:
    def __init__(self, step: ControlStep) -> None:
        self.base, self.wiring, self.h, self.P = step, step.wiring, step.h, step.P
        self.state, self.known = step.state, step.known

    def build_event_step_function(self, act: Any) -> Any:
        """Return ``act``, repeated with event location if it contains an event."""
        sizes = [act.size1_in(i) for i in range(act.n_in())]
        x, w, c, y, u, z = inputs = [ca.MX.sym(f"i{i}", size) for i, size in enumerate(sizes)]
        after, log, found = act(*inputs)
        more = [ca.MX.sym("after", self.state.size), ca.MX.sym("log", self.base.log.size)]
        keep = ca.Function("keep", [*inputs, *more], more)
        careful = ca.Function(
            "careful", [*inputs, *more], self._propagate_step_with_events(x, w, c[: self.P.shape[0]], y, u, z)
        )
        either = ca.Function.if_else("either", careful, keep)
        return ca.Function("act", inputs, either(found, *inputs, after, log))

    def _propagate_step_with_events(self, x: Any, w: Any, P: Any, y: Any, u: Any, z: Any) -> list[Any]:
        """Return the state after a control step with events, and its log; MX."""
        wiring, column, known = self.wiring, ca.SX.sym("X", self.state.size), ca.SX.sym("w", self.known.size)
        state = self.state.split_vector_by_name(column)
        begin = ca.Function("begin", [column, known, self.P], [
            self.state.stack_vector_by_name(
                self.base.update_disturbance_memories(state, self.known.split_vector_by_name(known))
            )
        ])  # fmt: skip
        now, notes = begin(x, w, P), ca.MX.zeros(self.event_log_layout.size)
        for i in range(wiring.minor_steps):
            minor, skip = self._build_minor_step_functions(i)
            either = ca.Function.if_else("minor", skip, minor)
            now, notes = either(self.state.split_vector_by_name(now)["stop"] > 0.5, now, notes, w, P, u)
        return list(self._build_control_step_log_function()(x, now, notes, w, y, u, z))

    @property
    def event_log_layout(self) -> ColumnLayout:
        """Layout of the event notes of a control step, stored next to the state."""
        sums = (("applied", self.wiring.plant.controls.size), ("elapsed", 1))
        return ColumnLayout((*sums, *build_event_log_layout(self.wiring.plant.states.size)))

    def _build_minor_step_functions(self, i: int) -> tuple[Any, Any]:
        """Return ``(X, notes, w, P, u) -> (X, notes)`` of a minor step with events, and its inactive version."""
        wiring, h = self.wiring, self.h
        column, known = ca.SX.sym("X", self.state.size), ca.SX.sym("w", self.known.size)
        u = ca.SX.sym("u", wiring.controller.commands.size)
        state, w = self.state.split_vector_by_name(column), self.known.split_vector_by_name(known)
        new, tick = dict(state), self.base.build_minor_step_time_and_state(i, w, state)
        waves, saturated = self.base.evaluate_actuator_blocks(tick, u, new, w, i)
        x, armed = ca.SX.sym("x", wiring.plant.states.size), ca.SX.sym("armed", len(wiring.events.owners))
        begin, end = ca.SX.sym("begin"), ca.SX.sym("end")
        watch, extremes = (
            self.base.create_event_detector({"armed": armed}, begin),
            self.base.create_quantity_extreme_tracker(waves),
        )
        propagated = self.base.integrate_plant(tick.t, x, waves, new, (begin, end), (watch, extremes))
        seen = [watch.armed, watch.y, watch.slope, watch.found, watch.first, watch.last]
        seen += [watch.lost, watch.lost_inside, extremes.record]
        context = [column, known, self.P, u]
        propagation = ca.Function("propagation", [x, armed, begin, end, *context], [propagated, *seen])
        way, places = build_event_location_function(wiring.events, propagation, h)
        q, noted = ca.SX.sym("q", places.size), ca.SX.sym("notes", self.event_log_layout.size)
        v, n = places.split_vector_by_name(q), self.event_log_layout.split_vector_by_name(noted)
        new |= {"plant": v["x"]} | {name: v[name] for name, _ in places.parts if name in new}
        applied = ca.vertcat(*[wave.mean for wave in waves])
        self.base.accumulate_control_effort(new, applied, saturated, v["s"])
        n |= {"applied": n["applied"] + v["s"] * applied, "elapsed": n["elapsed"] + v["s"]}
        n |= {k: v[k] for k, _ in build_event_log_layout(x.shape[0])}
        book = ca.Function(
            "book",
            [q, noted, *context],
            [self.state.stack_vector_by_name(new), self.event_log_layout.stack_vector_by_name(n)],
        )
        inputs = [ca.MX.sym(f"i{i}", e.shape[0]) for i, e in enumerate([column, noted, known, self.P, u])]
        column_, notes_, w_, P_, u_ = inputs
        a, b = self.state.split_vector_by_name(column_), self.event_log_layout.split_vector_by_name(notes_)
        first = {
            **{k: a[k] for k, _ in places.parts if k in a},
            **{k: b[k] for k, _ in places.parts if k in b},
        }
        first |= {"x": a["plant"], "s": ca.MX(0)}
        p = ca.vertcat(*[P_[wiring.layout.slice(f"plant.{name}")] for name in wiring.plant.parameters.names])
        rest = (column_, w_, P_, u_)
        after = way(
            places.stack_vector_by_name(first), self.known.split_vector_by_name(w_)["t"] + i * h, p, *rest
        )
        minor = ca.Function("minor", inputs, list(book(after, notes_, *rest)))
        return minor, ca.Function("skip", inputs, [column_, notes_])

    def _build_control_step_log_function(self) -> Any:
        """Return ``(X before, X, notes, w, y, u, z) -> (X_next, log)``, evaluated after the last minor step."""
        before, column, known = (
            ca.SX.sym(name, size)
            for name, size in (("before", self.state.size), ("X", self.state.size), ("w", self.known.size))
        )
        noted, y = ca.SX.sym("notes", self.event_log_layout.size), ca.SX.sym("y", self.base.measured.size)
        u = ca.SX.sym("u", self.wiring.controller.commands.size)
        z = ca.SX.sym("z", self.wiring.controller.memory.size)
        new, n = self.state.split_vector_by_name(column), self.event_log_layout.split_vector_by_name(noted)
        logged = {
            "measured": y,
            "commands": u,
            "applied": ca.if_else(n["elapsed"] > 0, n["applied"] / n["elapsed"], 0.0),
        }
        logged |= {name: n[name] for name, _ in build_event_log_layout(self.wiring.plant.states.size)}
        state, t = self.state.split_vector_by_name(before), self.known.split_vector_by_name(known)["t"]
        log = self.base.complete_control_step(new, state, t, logged, z)
        return ca.Function(
            "closing", [before, column, noted, known, y, u, z], [self.state.stack_vector_by_name(new), log]
        )


@dataclass(frozen=True)
class LoopKernel:
    """Functions of a loop, and the layouts of its columns X, w and log.

    Attributes
    ----------
    constants : casadi.Function
        ``P -> C``: parameters and the values derived from them.
    start, step, measure : casadi.Function
        ``(w, P) -> X``; ``(X, w, C) -> (X_next, log)``; ``(X, w, C) -> y``, the controller's input.
    easy : casadi.Function or None
        ``(X, w, C) -> (X_next, valid)`` with the easy law of a controller; the full law is needed if valid is not 1.
    """

    constants: Any
    start: Any
    step: Any
    easy: Any
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
        step, easy = (
            self._build_closed_loop_step_function(constants, act),
            self._build_simplified_law_loop_step(constants, act),
        )
        measure = self._build_measurement_function(constants)
        return LoopKernel(
            constants,
            self._build_initial_state_function(),
            step,
            easy,
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
                ca.SX.zeros(link.size), self.select_block_parameters(link), tick
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

    def _build_simplified_law_loop_step(self, constants: Any, act: Any) -> Any:
        easy = self.wiring.controller.easy
        if easy is None:
            return None
        inputs, after, _, (enough,) = self._build_closed_loop_step_expressions(easy, constants, act)
        step = ca.Function("easy", inputs, [after, enough], ["X", "w", "C"], ["X_next", "enough"])
        return freeze_state_after_end_event(self, step, ca.MX(1)) if self.wiring.events else step

    def _build_closed_loop_step_expressions(
        self, law: Any, constants: Any, act: Any
    ) -> tuple[list[Any], Any, Any, list[Any]]:
        """Return the symbols X, w, C, and X_next, log and the validity of an easy law for one step."""
        kind = ca.MX if self.wiring.events else _get_casadi_symbol_type(law)
        sizes = (("X", self.state.size), ("w", self.known.size), ("C", constants.size1_out(0)))
        x, w, c = inputs = [kind.sym(name, size) for name, size in sizes]
        y, sensed = self._build_sensor_sampling_function()(x, w, c[: self.P.shape[0]])
        known = self.known.split_vector_by_name(w)
        u, memory, *enough = law(known["t"], y, known["r"], self.state.split_vector_by_name(x)["memory"])
        return inputs, *act(sensed, w, c, y, u, memory), enough

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
        mean, found = ca.SX.zeros(wiring.plant.controls.size), ca.SX(0)
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
                new["armed"], found = watch.armed, ca.fmax(found, watch.found)
                new["lost"] = ca.fmax(new["lost"], watch.lost)
            mean += applied / wiring.minor_steps
            self.accumulate_control_effort(new, applied, saturated, self.h)
        log = self.complete_control_step(
            new, state, w["t"], {"measured": y, "commands": u, "applied": mean}, z
        )
        # values derived from P only are computed once per run
        results = [self.state.stack_vector_by_name(new), log, found]
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
