r"""Kernel: one control step of the closed loop as a CasADi function, the stuff of runs and campaigns.

At a control step that begins at :math:`t_k`: the sensors sample the plant, the controller computes the command, which
is held; then m minor steps follow, in each of which the actuators advance and the plant is integrated with what they
apply on average. Everything that changes is in one column X (`Places`), everything that can be dispersed in one
column P (`ClosedLoop.layout`), everything known or drawn beforehand in one column w: time, schedule, random numbers.

Where the loop has events, the plant is watched meanwhile; a control step in which one may happen is taken again, minor
step by minor step, through it (`gnc_opt.simulation.crossing`).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from gnc_opt.control.steps import in_order
from gnc_opt.model.layout import Layout
from gnc_opt.simulation.block import Step, Tick
from gnc_opt.simulation.crossing import Watch, notes_of, passage, record_of
from gnc_opt.simulation.integrate import Seen, dormand_prince
from gnc_opt.simulation.places import Places
from gnc_opt.simulation.signals import Link, put, put_wave, take, take_wave
from gnc_opt.simulation.wave import Input, Wave
from gnc_opt.simulation.wiring import Wiring

_LARGE = 1e300
"""What is not below this in size counts as not finite."""

_SHORTEST = 1e-300
"""Share of a minor step in which nothing was applied: a run that an event ends at once."""


@dataclass(frozen=True)
class Kernel:
    """The functions of a loop and the layout of their columns.

    Attributes
    ----------
    constants : casadi.Function
        ``P -> C``: P, and below it whatever a step needs that follows from P alone.
    start : casadi.Function
        ``(w, P) -> X`` at the first control step.
    step : casadi.Function
        ``(X, w, C) -> (X_next, log)``.
    state, known, log : Places
        Of X, w and log.
    """

    constants: Any
    start: Any
    step: Any
    state: Places
    known: Places
    log: Places


def build_kernel(wiring: Wiring, substeps: int) -> Kernel:
    """Return the kernel with the plant integrated in ``substeps`` per minor step."""
    return _Builder(wiring, substeps).kernel()


class _Builder:
    """Makes the symbols, then the pieces of a step in order."""

    def __init__(self, wiring: Wiring, substeps: int) -> None:
        self.wiring, self.substeps = wiring, substeps
        self.h = wiring.h
        self.P = ca.SX.sym("P", wiring.layout.size)
        self.p = {name: self.P[wiring.layout.slice(name)] for name in wiring.layout.names}
        self.plant_p = take(self.p, [f"plant.{n}" for n in wiring.plant.parameters.names])
        self.measured = Layout("state", wiring.controller.states.variables)
        groups = (
            ("sensor", wiring.sensors),
            ("actuator", wiring.actuators),
            ("push", wiring.disturbances),
        )
        zero = {k: self._memory_sizes(links, k) for k, links in groups}
        m = wiring.minor_steps
        noises = {
            k: [link.block.noise(link.size) * (m if k == "actuator" else 1) for link in links]
            for k, links in groups
        }
        controls, commands = wiring.plant.controls.size, wiring.controller.commands.size
        self.state = Places(
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
                ("error", 1),
                ("blur", 1),
                ("fault", 1),
                ("fault time", 1),
                ("divergence", 1),
                ("divergence time", 1),
                ("alarm", 1),
                ("alarm time", 1),
                *self._if_events(("armed", len(wiring.events.owners)), *record_of(len(wiring.events))),
            )
        )
        self.known = Places(
            (
                ("t", 1),
                ("r", wiring.controller.signals.size),
                *((f"{k} {i}", n) for k, sizes in noises.items() for i, n in enumerate(sizes)),
            )
        )
        self.log = Places(
            (
                ("measured", self.measured.size),
                ("commands", commands),
                ("applied", controls),
                ("error", 1),
                *self._if_events(*notes_of(wiring.plant.states.size)),
            )
        )

    # --- pieces -------------------------------------------------------------------------------------------

    def _if_events(self, *parts: tuple[str, int]) -> tuple[tuple[str, int], ...]:
        return parts if self.wiring.events else ()

    def _memory_sizes(self, links: Sequence[Link], kind: str) -> list[int]:
        x = ca.SX.zeros(self.wiring.plant.states.size)
        length = self.h if kind == "actuator" else self.wiring.dt
        tick = Tick(0.0, length, self.wiring.dt, 0, self._by_state(x))
        return [
            link.block.start(ca.SX.zeros(link.size), self._parameters(link), tick).shape[0] for link in links
        ]

    def _parameters(self, link: Link) -> dict[str, Any]:
        prefix = f"{link.block.name}."
        return {n[len(prefix) :]: s for n, s in self.p.items() if n.startswith(prefix)}

    def _by_state(self, x: Any) -> dict[str, Any]:
        states = self.wiring.plant.states
        return {n: x[states.slice(n)] for n in states.names}

    def _sense(
        self, x: Any, t: Any, memory: dict[str, Any] | None, w: dict[str, Any]
    ) -> tuple[Any, dict[str, Any]]:
        """Return the measured state and the sensors' memories; without memories they begin."""
        by_name = self._by_state(x)
        signals = {n: by_name[n] if n in by_name else self._output(n, t, x) for n in self.measured.names}
        tick = Tick(t, self.wiring.dt, self.wiring.dt, 0, by_name)
        after = {}
        for i, link in enumerate(self.wiring.sensors):
            key, p, signal = f"sensor {i}", self._parameters(link), take(signals, link.on)
            before = link.block.start(signal, p, tick) if memory is None else memory[key]
            step = link.block.step(tick, signal, before, p, w[key])
            signals = put(signals, link, step.signal)
            after[key] = before if memory is None else step.state
        return take(signals, self.measured.names), after

    def _output(self, name: str, t: Any, x: Any) -> Any:
        """Return an output of the plant; it depends on no control."""
        plant = self.wiring.plant
        time, xs, _, ps = plant.arguments()
        expression = plant.output_expression(name)
        return ca.substitute(expression, ca.vertcat(time, xs, ps), ca.vertcat(t, x, self.plant_p))

    def _actuate(
        self, tick: Tick, u: Any, memory: dict[str, Any], w: dict[str, Any], minor: int
    ) -> tuple[list[Wave], Any]:
        """Return what is applied to the plant's controls and which commands are saturated; updates ``memory``."""
        commands, controls = self.wiring.controller.commands, self.wiring.plant.controls
        waves = {n: Wave(u[commands.slice(n)]) for n in commands.names}
        origin = {n: {n} for n in commands.names}
        saturated = {n: ca.SX.zeros(commands[n].size) for n in commands.names}
        for i, link in enumerate(self.wiring.actuators):
            key, count = f"actuator {i}", link.block.noise(link.size)
            noise = w[key][minor * count : (minor + 1) * count]
            wave = take_wave(waves, link.on, tick.h)
            wave, step = link.block.flow(tick, wave, memory[key], self._parameters(link), noise)
            memory[key] = step.state
            _mark(saturated, step, link, origin)
            waves = put_wave(waves, link, wave)
            sources = set().union(*(origin[n] for n in link.on))
            origin.update({n: origin[n] if n in link.on else sources for n in link.outputs})
        nothing = {n: Wave(ca.SX.zeros(controls[n].size)) for n in controls.names}
        return [waves.get(n, nothing[n]) for n in controls.names], take(saturated, commands.names)

    def _first_outputs(self, tick: Tick, r: Any) -> dict[str, Any]:
        """Return the memories with which the actuators begin; the feedforward passes them where one begins in trim."""
        wiring, memory = self.wiring, {}
        signals = wiring.feedforward(r) if wiring.in_trim else {}
        for i, link in enumerate(wiring.actuators):
            block, p = link.block, self._parameters(link)
            signal = take(signals, link.on) if wiring.in_trim else ca.SX.zeros(link.size)
            memory[f"actuator {i}"] = first = block.start(signal, p, tick)
            if wiring.in_trim:
                quiet = ca.SX.zeros(block.noise(link.size))
                signals = put(signals, link, block.flow(tick, Wave(signal), first, p, quiet)[1].signal)
        return memory

    def _first_record(self, t: Any, x: Any) -> dict[str, Any]:
        """Return what is kept of events as a run begins: rows that are not below zero can cross it."""
        y = self.wiring.events.rows(t, x, ca.SX.zeros(x.shape[0]), self.plant_p)[0]
        return {"armed": y >= 0, "first": ca.SX.nan(len(self.wiring.events))}

    def _rate(self, pushes: dict[str, Any]) -> Any:
        """Return f(t, x, u) of the plant under applied controls and disturbances."""
        plant, links = self.wiring.plant, self.wiring.disturbances

        def f(t: Any, x: Any, u: Any) -> Any:
            by_name = self._by_state(x)
            extra_u, extra_x = ca.SX.zeros(plant.controls.size), ca.SX.zeros(plant.states.size)
            for i, link in enumerate(links):
                value = link.block.value(t, by_name, pushes[f"push {i}"], self._parameters(link))  # type: ignore[attr-defined]
                if link.on[0] in plant.controls:
                    extra_u[plant.controls.slice(link.on[0])] += value
                else:
                    extra_x[plant.states.slice(link.on[0])] += value
            return plant.function(t, x, u + extra_u, self.plant_p) + extra_x

        return f

    def _fly(
        self,
        t: Any,
        x: Any,
        waves: list[Wave],
        pushes: dict[str, Any],
        span: tuple[Any, Any] | None = None,
        seen: Seen | None = None,
    ) -> tuple[Any, Any, Any]:
        """Integrate the plant over a minor step that begins at t, anew wherever an actuator bends or jumps.

        ``span`` is the part of it that is flown, two times (s) since it began. Returns the state, the error of the
        integration, and what waves that were taken at their mean may add to it.
        """
        f, error, held = self._rate(pushes), ca.SX(0), all(wave.held for wave in waves)
        first, last = span or (ca.SX(0), ca.SX(self.h))
        breaks = in_order(_distinct([b for wave in waves for b in wave.breaks]))
        if span is not None:
            breaks = [ca.fmin(ca.fmax(b, first), last) for b in breaks]
        mean, before = ca.vertcat(*[wave.mean for wave in waves]), x
        for begin, end in itertools.pairwise([first, *breaks, last]):
            if held:
                x, estimate = dormand_prince(
                    lambda t, x, _: f(t, x, mean), t + begin, x, end - begin, self.substeps, seen=seen
                )
            else:
                inputs = [wave.input(begin, end, self.substeps) for wave in waves]

                def u(k: int, node: float, inputs: list[Input] = inputs) -> Any:
                    return ca.vertcat(*[value(k, node) for value in inputs])

                x, estimate = dormand_prince(f, t + begin, x, end - begin, self.substeps, u, seen)
            error += estimate
        if all(wave.blur is None for wave in waves):
            return x, error, 0.0
        far = ca.vertcat(*[ca.SX.zeros(w.mean.shape[0]) if w.blur is None else w.blur for w in waves])
        change = (last - first) * ca.fabs(f(t, before, mean + far) - f(t, before, mean))
        return x, error, ca.mmax(change / ca.fmax(1.0, ca.fabs(x)))

    # --- functions ----------------------------------------------------------------------------------------

    def kernel(self) -> Kernel:
        """Return the finished functions."""
        constants, step = self._step()
        return Kernel(constants, self._start(), step, self.state, self.known, self.log)

    def _start(self) -> Any:
        wiring = self.wiring
        column = ca.SX.sym("w", self.known.size)
        w = self.known.split(column)
        x = take(self.p, [f"initial.{n}" for n in wiring.plant.states.names])
        y, sensors = self._sense(x, w["t"], None, w)
        tick = Tick(w["t"], self.h, wiring.dt, 0, self._by_state(x))
        parts: dict[str, Any] = {name: ca.SX.zeros(n) for name, n in self.state.parts}
        parts |= {"plant": x, **sensors}
        parts |= self._first_outputs(tick, w["r"])
        if wiring.events:
            parts |= self._first_record(w["t"], x)
        for i, link in enumerate(wiring.disturbances):
            parts[f"push {i}"] = link.block.start(ca.SX.zeros(link.size), self._parameters(link), tick)
        before = ca.Function("before", [column, self.P], [y, self.state.join(parts)])
        kind = _symbol_kind(wiring.controller.start)
        w_, p_ = kind.sym("w", self.known.size), kind.sym("P", self.P.shape[0])
        y_, state = before(w_, p_)
        values = self.state.split(state)
        known = self.known.split(w_)
        values["memory"] = wiring.controller.start(known["t"], y_, known["r"])
        return ca.Function("start", [w_, p_], [self.state.join(values)], ["w", "P"], ["X"])

    def _step(self) -> tuple[Any, Any]:
        wiring = self.wiring
        sense, (constants, act) = self._sense_function(), self._act_functions()
        kind = ca.MX if wiring.events else _symbol_kind(wiring.controller.step)
        x_, w_, c_ = (
            kind.sym(n, s)
            for n, s in (("X", self.state.size), ("w", self.known.size), ("C", constants.size1_out(0)))
        )
        y, sensed = sense(x_, w_, c_[: self.P.shape[0]])
        known = self.known.split(w_)
        u, memory = wiring.controller.step(known["t"], y, known["r"], self.state.split(x_)["memory"])
        after, log = act(sensed, w_, c_, y, u, memory)
        step = ca.Function("step", [x_, w_, c_], [after, log], ["X", "w", "C"], ["X_next", "log"])
        return constants, self._until_the_end(step) if wiring.events else step

    def _until_the_end(self, step: Any) -> Any:
        """Return the step that does nothing once an event has ended the run."""
        x, w, c = (ca.MX.sym(step.name_in(i), step.size1_in(i)) for i in range(3))
        rest = ca.Function("rest", [x, w, c], [x, ca.MX.zeros(self.log.size)])
        either = ca.Function.if_else("either", rest, step)
        after = either(self.state.split(x)["stop"] > 0.5, x, w, c)
        return ca.Function("step", [x, w, c], after, ["X", "w", "C"], ["X_next", "log"])

    def _sense_function(self) -> Any:
        x, column = ca.SX.sym("X", self.state.size), ca.SX.sym("w", self.known.size)
        state, w = self.state.split(x), self.known.split(column)
        y, sensors = self._sense(state["plant"], w["t"], state, w)
        return ca.Function("sense", [x, column, self.P], [y, self.state.join(state | sensors)])

    def _act_functions(self) -> tuple[Any, Any]:
        """The constants, and the minor steps with the book-keeping: ``(X, w, C, y, u, z_next) -> (X_next, log)``."""
        wiring = self.wiring
        column_x, column = ca.SX.sym("X", self.state.size), ca.SX.sym("w", self.known.size)
        y, u = ca.SX.sym("y", self.measured.size), ca.SX.sym("u", wiring.controller.commands.size)
        z = ca.SX.sym("z", wiring.controller.memory.size)
        state, w = self.state.split(column_x), self.known.split(column)
        new = self._pushed(state, w)
        mean, error, blur, found = ca.SX.zeros(wiring.plant.controls.size), ca.SX(0), ca.SX(0), ca.SX(0)
        for i in range(wiring.minor_steps):
            tick = self._tick(i, w, new)
            waves, saturated = self._actuate(tick, u, new, w, i)
            applied = ca.vertcat(*[wave.mean for wave in waves])
            watch = self._watch_rows(new, ca.SX(0)) if wiring.events else None
            new["plant"], estimate, blurred = self._fly(tick.t, new["plant"], waves, new, seen=watch)
            if watch is not None:
                new["armed"], found = watch.armed, ca.fmax(found, watch.found)
            error += estimate
            blur += blurred
            mean += applied / wiring.minor_steps
            self._tally(new, applied, saturated, self.h)
        log = self._close(new, state, w["t"], {"measured": y, "commands": u, "applied": mean}, error, blur, z)
        # what follows from P alone is computed once per run
        results = [self.state.join(new), log, found]
        outputs, symbols, values = ca.extract_parametric(results, self.P)
        constants, names = ca.vertcat(self.P, *values), ca.vertcat(self.P, *symbols)
        act = ca.Function("act", [column_x, column, names, y, u, z], outputs)
        return (
            ca.Function("constants", [self.P], [constants], ["P"], ["C"]),
            self._with_events(act) if wiring.events else act.slice("act", list(range(6)), [0, 1]),
        )

    def _tick(self, i: int, w: dict[str, Any], state: dict[str, Any]) -> Tick:
        return Tick(w["t"] + i * self.h, self.h, self.wiring.dt, i, self._by_state(state["plant"]))

    def _pushed(self, state: dict[str, Any], w: dict[str, Any]) -> dict[str, Any]:
        """Return the state with the memories of the disturbances during this control step."""
        new = dict(state)
        for i, link in enumerate(self.wiring.disturbances):
            key = f"push {i}"
            tick = Tick(w["t"], self.wiring.dt, self.wiring.dt, 0, self._by_state(state["plant"]))
            new[key] = link.block.update(tick, state[key], self._parameters(link), w[key])  # type: ignore[attr-defined]
        return new

    def _tally(self, new: dict[str, Any], applied: Any, saturated: Any, time: Any) -> None:
        """Sum up what was applied for a time (s)."""
        new["effort"] += time * ca.fabs(applied)
        new["energy"] += time * applied**2
        new["saturation"] += time * saturated

    def _close(
        self,
        new: dict[str, Any],
        state: dict[str, Any],
        t: Any,
        told: dict[str, Any],
        error: Any,
        blur: Any,
        z: Any,
    ) -> Any:
        """Complete the state after a control step, and return its log."""
        y, u, mean = told["measured"], told["commands"], told["applied"]
        new |= {
            "memory": z,
            "command": u,
            "steps": state["steps"] + 1,
            "error": state["error"] + error,
            "blur": state["blur"] + blur,
        }
        new["variation"] += ca.if_else(state["steps"] > 0.5, ca.fabs(u - state["command"]), 0.0)
        self._watch(new, state, t, ca.vertcat(*watched(self.wiring, y), u, mean, new["plant"]), z)
        nothing = {name: ca.SX.zeros(size) for name, size in self.log.parts}
        return self.log.join({**nothing, **told, "error": error + blur})

    # --- through events -----------------------------------------------------------------------------------

    def _watch_rows(self, state: dict[str, Any], begin: Any) -> Watch:
        return Watch(self.wiring.events, state["armed"], self.plant_p, begin)

    def _with_events(self, act: Any) -> Any:
        """Return the step that is taken again with care where a row of an event may have crossed zero."""
        sizes = [act.size1_in(i) for i in range(act.n_in())]
        x, w, c, y, u, z = inputs = [ca.MX.sym(f"i{i}", size) for i, size in enumerate(sizes)]
        after, log, found = act(*inputs)
        more = [ca.MX.sym("after", self.state.size), ca.MX.sym("log", self.log.size)]
        keep = ca.Function("keep", [*inputs, *more], more)
        careful = ca.Function("careful", [*inputs, *more], self._careful(x, w, c[: self.P.shape[0]], y, u, z))
        either = ca.Function.if_else("either", careful, keep)
        return ca.Function("act", inputs, either(found, *inputs, after, log))

    def _careful(self, x: Any, w: Any, P: Any, y: Any, u: Any, z: Any) -> list[Any]:
        """Return the state after a control step with events, and its log; MX."""
        wiring, column, known = self.wiring, ca.SX.sym("X", self.state.size), ca.SX.sym("w", self.known.size)
        state = self.state.split(column)
        begin = ca.Function("begin", [column, known, self.P], [
            self.state.join(self._pushed(state, self.known.split(known)))
        ])  # fmt: skip
        now, notes = begin(x, w, P), ca.MX.zeros(self.notes.size)
        for i in range(wiring.minor_steps):
            minor, skip = self._minor(i)
            either = ca.Function.if_else("minor", skip, minor)
            now, notes = either(self.state.split(now)["stop"] > 0.5, now, notes, w, P, u)
        return list(self._closing()(x, now, notes, w, y, u, z))

    @property
    def notes(self) -> Places:
        """What a control step with events adds up beside the state."""
        sums = (("applied", self.wiring.plant.controls.size), ("flown", 1), ("error", 1), ("blur", 1))
        return Places((*sums, *notes_of(self.wiring.plant.states.size)))

    def _minor(self, i: int) -> tuple[Any, Any]:
        """``(X, notes, w, P, u) -> (X, notes)`` of a minor step with events, and the one that does nothing."""
        wiring, h = self.wiring, self.h
        column, known = ca.SX.sym("X", self.state.size), ca.SX.sym("w", self.known.size)
        u = ca.SX.sym("u", wiring.controller.commands.size)
        state, w = self.state.split(column), self.known.split(known)
        new, tick = dict(state), self._tick(i, w, state)
        waves, saturated = self._actuate(tick, u, new, w, i)
        x, armed = ca.SX.sym("x", wiring.plant.states.size), ca.SX.sym("armed", len(wiring.events.owners))
        begin, end = ca.SX.sym("begin"), ca.SX.sym("end")
        watch = self._watch_rows({"armed": armed}, begin)
        flown, error, blur = self._fly(tick.t, x, waves, new, (begin, end), watch)
        seen = [watch.armed, watch.y, watch.slope, watch.found, watch.first, watch.last]
        context = [column, known, self.P, u]
        leg = ca.Function("leg", [x, armed, begin, end, *context], [flown, error, blur, *seen])
        way, places = passage(wiring.events, leg, h)
        # the book-keeping
        q, noted = ca.SX.sym("q", places.size), ca.SX.sym("notes", self.notes.size)
        v, n = places.split(q), self.notes.split(noted)
        new |= {"plant": v["x"]} | {name: v[name] for name, _ in places.parts if name in new}
        applied = ca.vertcat(*[wave.mean for wave in waves])
        self._tally(new, applied, saturated, v["s"])
        new |= {"error": state["error"], "blur": state["blur"]}
        n |= {"error": n["error"] + v["error"], "blur": n["blur"] + v["blur"], "flown": n["flown"] + v["s"]}
        n |= {"applied": n["applied"] + v["s"] * applied} | {k: v[k] for k, _ in notes_of(x.shape[0])}
        book = ca.Function("book", [q, noted, *context], [self.state.join(new), self.notes.join(n)])
        # all together
        inputs = [ca.MX.sym(f"i{i}", e.shape[0]) for i, e in enumerate([column, noted, known, self.P, u])]
        column_, notes_, w_, P_, u_ = inputs
        a, b = self.state.split(column_), self.notes.split(notes_)
        first = {
            **{k: a[k] for k, _ in places.parts if k in a},
            **{k: b[k] for k, _ in places.parts if k in b},
        }
        first |= {"x": a["plant"], "s": ca.MX(0), "error": ca.MX(0), "blur": ca.MX(0)}
        p = ca.vertcat(*[P_[wiring.layout.slice(f"plant.{name}")] for name in wiring.plant.parameters.names])
        rest = (column_, w_, P_, u_)
        after = way(places.join(first), self.known.split(w_)["t"] + i * h, p, *rest)
        minor = ca.Function("minor", inputs, list(book(after, notes_, *rest)))
        return minor, ca.Function("skip", inputs, [column_, notes_])

    def _closing(self) -> Any:
        """``(X before, X, notes, w, y, u, z) -> (X_next, log)`` after the last minor step."""
        before, column, known = (
            ca.SX.sym(name, size)
            for name, size in (("before", self.state.size), ("X", self.state.size), ("w", self.known.size))
        )
        noted, y = ca.SX.sym("notes", self.notes.size), ca.SX.sym("y", self.measured.size)
        u = ca.SX.sym("u", self.wiring.controller.commands.size)
        z = ca.SX.sym("z", self.wiring.controller.memory.size)
        new, n = self.state.split(column), self.notes.split(noted)
        told = {
            "measured": y,
            "commands": u,
            "applied": n["applied"] / ca.fmax(n["flown"], _SHORTEST * self.h),
        }
        told |= {name: n[name] for name, _ in notes_of(self.wiring.plant.states.size)}
        state, t = self.state.split(before), self.known.split(known)["t"]
        log = self._close(new, state, t, told, n["error"], n["blur"], z)
        return ca.Function("closing", [before, column, noted, known, y, u, z], [self.state.join(new), log])

    def _watch(self, new: dict[str, Any], state: dict[str, Any], t: Any, seen: Any, z: Any) -> None:
        """Keep the first thing that is not finite, the first state too large, the first alarm, and their times."""
        wiring = self.wiring
        fault = ca.SX(0)
        for i in reversed(range(seen.shape[0])):
            fault = ca.if_else(ca.fabs(seen[i]) < _LARGE, fault, i + 1.0)
        places = [wiring.controller.memory.slice(name) for name in wiring.controller.alarms]
        flags = [z[k] for place in places for k in range(place.start, place.stop)]
        alarm = ca.SX(0)
        for i, flag in reversed(list(enumerate(flags))):
            alarm = ca.if_else(
                ca.fabs(flag) <= 0, alarm, i + 1.0
            )  # not "!= 0": that is false for NaN in some VMs
        divergence = ca.SX(0)
        for i, largest in reversed(list(enumerate(wiring.plausible))):
            divergence = ca.if_else(ca.fabs(new["plant"][i]) > largest, i + 1.0, divergence)
        for name, code in (("fault", fault), ("divergence", divergence), ("alarm", alarm)):
            fresh = ca.logic_and(state[name] < 0.5, code > 0.5)
            new[name] = ca.if_else(fresh, code, state[name])
            new[f"{name} time"] = ca.if_else(fresh, t, state[f"{name} time"])


def _distinct(breaks: list[Any]) -> list[Any]:
    """Return SX scalars without those that are the same expression."""
    found: list[Any] = []
    for b in breaks:
        if not any(ca.is_equal(b, other, 0) for other in found):
            found.append(b)
    return found


def watched(wiring: Wiring, measured: Any) -> tuple[Any, ...]:
    """Return the measurement, unless the controller or its estimator does without lost samples: then nothing."""
    controller = wiring.controller
    return (measured,) if controller.unbridged is None and controller.estimated is None else ()


def watched_labels(wiring: Wiring) -> list[str]:
    """Return what the codes of the first non-finite quantity mean, code 1 first."""
    groups = (
        *watched(wiring, ("measured", wiring.controller.states)),
        ("command", wiring.controller.commands),
        ("applied", wiring.plant.controls),
        ("state", wiring.plant.states),
    )
    return [f"{kind} '{label}'" for kind, layout in groups for label in layout.labels]


def alarm_labels(wiring: Wiring) -> list[str]:
    """Return the controller's alarms by code, code 1 first."""
    memory = wiring.controller.memory
    return [label for name in wiring.controller.alarms for label in memory[name].labels]


def _mark(saturated: dict[str, Any], step: Step, link: Link, origin: Mapping[str, set[str]]) -> None:
    """Note where a limit acts: at the same component, or at every component that led to it."""
    if step.saturated is None:
        return
    at = 0
    sizes = {n: saturated[n].shape[0] for n in saturated}
    straight = link.size == step.saturated.shape[0] and all(n in sizes for n in link.on)
    if straight:
        for name in link.on:
            part = step.saturated[at : at + sizes[name]]
            saturated[name] = ca.fmax(saturated[name], part)
            at += sizes[name]
        return
    any_at_all = ca.mmax(step.saturated)
    for name in set().union(*(origin[n] for n in link.on)):
        saturated[name] = ca.fmax(saturated[name], any_at_all)


def _symbol_kind(function: Any) -> Any:
    return ca.SX if function.is_a("SXFunction") else ca.MX
