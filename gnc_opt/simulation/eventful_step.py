"""Eventful step: a control step that is taken again with care where a row of an event may have crossed zero.

Minor step by minor step, each through its events (`gnc_opt.simulation.crossing`), with the book-keeping of any other.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from gnc_opt.simulation.control_step import ControlStep
from gnc_opt.simulation.crossing import notes_of, passage
from gnc_opt.simulation.places import Places

_SHORTEST = 1e-300
"""Share of a minor step in which nothing was applied: a run that an event ends at once."""


def with_events(step: ControlStep, act: Any) -> Any:
    """Return the function of the minor steps, ``act`` without regard to events, that flies through them.

    Parameters
    ----------
    step : ControlStep
    act : casadi.Function
        ``(X, w, C, y, u, z_next) -> (X_next, log, found)``, found: whether a row may have crossed zero.

    Returns
    -------
    casadi.Function
        ``(X, w, C, y, u, z_next) -> (X_next, log)``.
    """
    return _EventfulStep(step).function(act)


def until_the_end(control_step: ControlStep, step: Any, told: Any) -> Any:
    """Return the step that does nothing once an event has ended the run; its second output then is ``told``."""
    x, w, c = (ca.MX.sym(step.name_in(i), step.size1_in(i)) for i in range(3))
    rest = ca.Function("rest", [x, w, c], [x, told])
    either = ca.Function.if_else("either", rest, step)
    after = either(control_step.state.split(x)["stop"] > 0.5, x, w, c)
    return ca.Function(step.name(), [x, w, c], after, step.name_in(), step.name_out())


class _EventfulStep:
    def __init__(self, step: ControlStep) -> None:
        self.base, self.wiring, self.h, self.P = step, step.wiring, step.h, step.P
        self.state, self.known = step.state, step.known

    def function(self, act: Any) -> Any:
        """Return ``act``, then with care if it has found anything."""
        sizes = [act.size1_in(i) for i in range(act.n_in())]
        x, w, c, y, u, z = inputs = [ca.MX.sym(f"i{i}", size) for i, size in enumerate(sizes)]
        after, log, found = act(*inputs)
        more = [ca.MX.sym("after", self.state.size), ca.MX.sym("log", self.base.log.size)]
        keep = ca.Function("keep", [*inputs, *more], more)
        careful = ca.Function("careful", [*inputs, *more], self._careful(x, w, c[: self.P.shape[0]], y, u, z))
        either = ca.Function.if_else("either", careful, keep)
        return ca.Function("act", inputs, either(found, *inputs, after, log))

    def _careful(self, x: Any, w: Any, P: Any, y: Any, u: Any, z: Any) -> list[Any]:
        """Return the state after a control step with events, and its log; MX."""
        wiring, column, known = self.wiring, ca.SX.sym("X", self.state.size), ca.SX.sym("w", self.known.size)
        state = self.state.split(column)
        begin = ca.Function("begin", [column, known, self.P], [
            self.state.join(self.base.pushed(state, self.known.split(known)))
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
        new, tick = dict(state), self.base.tick_of(i, w, state)
        waves, saturated = self.base.actuate(tick, u, new, w, i)
        x, armed = ca.SX.sym("x", wiring.plant.states.size), ca.SX.sym("armed", len(wiring.events.owners))
        begin, end = ca.SX.sym("begin"), ca.SX.sym("end")
        watch = self.base.watch_rows({"armed": armed}, begin)
        flown, error, blur = self.base.fly(tick.t, x, waves, new, (begin, end), watch)
        seen = [watch.armed, watch.y, watch.slope, watch.found, watch.first, watch.last]
        seen += [watch.lost, watch.lost_inside]
        context = [column, known, self.P, u]
        leg = ca.Function("leg", [x, armed, begin, end, *context], [flown, error, blur, *seen])
        way, places = passage(wiring.events, leg, h)
        # the book-keeping
        q, noted = ca.SX.sym("q", places.size), ca.SX.sym("notes", self.notes.size)
        v, n = places.split(q), self.notes.split(noted)
        new |= {"plant": v["x"]} | {name: v[name] for name, _ in places.parts if name in new}
        applied = ca.vertcat(*[wave.mean for wave in waves])
        self.base.tally(new, applied, saturated, v["s"])
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
        first["error before"] = a["error"] + b["error"]
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
        noted, y = ca.SX.sym("notes", self.notes.size), ca.SX.sym("y", self.base.measured.size)
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
        log = self.base.close(new, state, t, told, n["error"], n["blur"], z)
        return ca.Function("closing", [before, column, noted, known, y, u, z], [self.state.join(new), log])
