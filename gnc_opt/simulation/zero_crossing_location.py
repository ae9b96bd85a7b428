r"""Location of events within a minor step, and integration through them.

A row (see `Events`) is *armed* if it has been >= 0 since the last occurrence of its event. An armed row is a candidate
in an integration step (`EventDetector`) if it ends below zero, or if the cubic through its values and slopes, or
tangents at both ends, become negative. The minor step is then repeated up to the crossing, which Newton's method
locates inside a bracket (`build_event_location_function`); the resets are applied, and the integration continues.

Events within `SAME_TIME` of the minor step are simultaneous: all conditions are evaluated before the resets, which are
applied in the order of declaration until one ends the run. The run also ends if a row rises after its reset but crosses
zero again within that time (Zeno), or if a reset leaves its row at zero and the plant drives it through zero.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import casadi as ca

from gnc_opt.numerical_tolerances import ROUNDING, SAME_TIME
from gnc_opt.simulation.block_signal_chain import ColumnLayout
from gnc_opt.simulation.dormand_prince import IntegrationStep
from gnc_opt.simulation.recorded_extremes_and_integrals import merge_extremes_and_integrals
from gnc_opt.simulation.zero_crossing_events import EVENTS_PER_STEP_MAX, Events

RATE_SHARE_OF_STEP = 1e-4
"""Interval of rate differences, as a share of the minor step."""


class EventDetector:
    """Search for zero crossings of the event rows during the integration; SX."""

    def __init__(self, events: Events, armed: Any, parameters: Any, begin: Any, moment: float) -> None:
        self.events, self.armed, self.parameters = events, armed, parameters
        self.found, self.first, self.last = ca.SX(0), ca.SX(begin), ca.SX(begin)
        self.y = self.slope = ca.SX.zeros(armed.shape[0])
        self.lost = self.lost_inside = ca.SX.zeros(len(events))
        self._now, self._heeded = ca.SX(begin), begin + moment

    def __call__(self, taken: IntegrationStep, _: Any = None) -> None:
        """Update the crossing flags after an integration step."""
        length, time, x = taken.length, taken.time + taken.length, taken.after
        y0, d0 = self.events.rows(taken.time, taken.x, taken.stages[0], self.parameters)
        y1, d1 = self.events.rows(time, x, taken.stages[-1], self.parameters)
        a, b = length * d0, length * d1
        rise = y1 - y0
        c, d = 3 * rise - 2 * a - b, a + b - 2 * rise
        lowest = -a / (c + ca.sqrt(ca.fmax(c**2 - 3 * d * a, 0)))
        near = y0 + lowest * (a + lowest * (c + lowest * d)) <= 0.05 * ca.fmax(y0, y1)
        # fast rows are not cubic; a convex row stays above both tangents
        corner = ca.fmin(ca.fmax((rise - b) / (a - b), 0), 1)
        sinks = ca.logic_and(ca.logic_and(a < 0, b > 0), ca.logic_or(near, y0 + a * corner <= 0))
        later = self._now + length > self._heeded
        crosses = ca.logic_and(ca.logic_and(self.armed, later), y1 < 0)
        dips = ca.logic_and(ca.logic_and(self.armed, y1 >= 0), sinks)
        share = ca.mmin(ca.if_else(crosses, 1.0, ca.if_else(dips, lowest, 2.0)))
        fresh = ca.logic_and(self.found < 0.5, share < 1.5)
        self.first = ca.if_else(fresh, self._now, self.first)
        self.last = ca.if_else(fresh, self._now + share * length, self.last)
        self.found = ca.if_else(fresh, 1.0, self.found)
        self._now = self._now + length
        rises = ca.logic_and(y1 > 0, later)
        self.armed = ca.if_else(ca.logic_or(self.armed, rises), 1.0, 0.0)
        self.y, self.slope = y1, d1
        self.lost_inside = ca.if_else(length > 0, self.lost, self.lost_inside)
        self.lost = ca.fmax(self.lost, self.events.detect_undefined_events(time, x, self.parameters, y1))


def build_event_log_layout(n_states: int) -> tuple[tuple[str, int], ...]:
    """Return the layout of a control step's event notes: count, codes, times, and states before and after."""
    return (
        ("number", 1),
        ("codes", EVENTS_PER_STEP_MAX),
        ("times", EVENTS_PER_STEP_MAX),
        ("before", EVENTS_PER_STEP_MAX * n_states),
        ("after", EVENTS_PER_STEP_MAX * n_states),
    )


def build_event_record_layout(events: Events, n_states: int) -> tuple[tuple[str, int], ...]:
    """Return the layout of the event record: counts, first times, end of the run, undefined events."""
    count, stop = len(events), (("stop", 1), ("stop time", 1), ("stop rate", n_states))
    return (("count", count), ("first", count), *stop, ("lost", count))


def build_event_location_function(events: Events, flow: Any, h: float) -> tuple[Any, ColumnLayout]:
    """Return the function ``(q, t, p, *context) -> q`` of a minor step with events, and the layout of q."""
    way = _ZeroCrossingPropagation(events, flow, h)
    return way.build_minor_step_with_events(), way.places


class _ZeroCrossingPropagation:
    def __init__(self, events: Events, flow: Any, h: float) -> None:
        self.events, self.flow, self.h = events, flow, h
        n = flow.size1_in(0)
        self.n_rows = flow.size1_in(1)
        self.places = ColumnLayout(
            (
                ("x", n),
                ("armed", self.n_rows),
                ("s", 1),
                ("quantities", flow.size1_out(9)),
                *build_event_record_layout(events, n),
                *build_event_log_layout(n),
            )
        )
        self.about = ("t", 1), ("p", events.effects.size1_in(2)), *self._list_remaining_flow_inputs()
        self.lowest = self._build_zero_crossing_function()
        self.newton = self._compute_newton_or_bisection_step()
        self.effect = self._build_event_reset_function()

    def _list_remaining_flow_inputs(self) -> list[tuple[str, int]]:
        return [(f"c{i}", self.flow.size1_in(i)) for i in range(4, self.flow.n_in())]

    def _create_event_step_symbols(self, *more: tuple[str, int]) -> list[Any]:
        return [ca.MX.sym(name, size) for name, size in (*more, *self.about)]

    def build_minor_step_with_events(self) -> Any:
        q, t, p, *context = self._create_event_step_symbols(("q", self.places.size))
        one = self._build_propagation_to_next_event()
        after = q
        for _ in range(2 * EVENTS_PER_STEP_MAX):
            after = one(after, t, p, *context)
        v = self.places.split_vector_by_name(after)
        lost = ca.logic_and(v["stop"] < 0.5, ca.logic_or(v["s"] < self.h, v["number"] >= EVENTS_PER_STEP_MAX))
        v["stop"] = ca.if_else(lost, len(self.events) + 1, v["stop"])
        v["stop time"] = ca.if_else(lost, t + v["s"], v["stop time"])
        return ca.Function("passage", [q, t, p, *context], [self.places.stack_vector_by_name(v)])

    def _build_propagation_to_next_event(self) -> Any:
        """Return the propagation function to the next event or to the end; inactive when the step is complete."""
        inputs = self._create_event_step_symbols(("q", self.places.size))
        idle = ca.Function("idle", inputs, [inputs[0]])
        q, t, p, *context = inputs
        v = self.places.split_vector_by_name(q)
        x, armed, _, _, found, first, last, lost, _, seen = self.flow(
            v["x"], v["armed"], v["s"], self.h, *context
        )
        whole = self.places.stack_vector_by_name(
            self._accumulate_extremes_and_integrals(v, self.h, x=x, armed=armed, lost=lost, quantities=seen)
        )
        bounds = [("whole", self.places.size), ("first", 1), ("last", 1)]
        given = self._create_event_step_symbols(("q", self.places.size), *bounds)
        quiet = ca.Function("quiet", given, [given[1]])
        propagated = ca.Function.if_else("fly", self._build_propagation_through_event(), quiet)(
            found, q, whole, first, last, t, p, *context
        )
        fly = ca.Function("fly", inputs, [propagated])
        q, t, p, *context = self._create_event_step_symbols(("q", self.places.size))
        v = self.places.split_vector_by_name(q)
        on = ca.logic_and(v["stop"] < 0.5, v["s"] < self.h)
        choice = ca.Function.if_else("one", fly, idle)
        return ca.Function("one", [q, t, p, *context], [choice(on, q, t, p, *context)])

    def _accumulate_extremes_and_integrals(self, v: dict[str, Any], s: Any, **segment: Any) -> dict[str, Any]:
        seen = merge_extremes_and_integrals(v["quantities"], segment["quantities"])
        return {**v, **segment, "s": s, "lost": ca.fmax(v["lost"], segment["lost"]), "quantities": seen}

    def _build_propagation_through_event(self) -> Any:
        """Propagate to a candidate crossing, and through its event if the row crosses zero."""
        q, _, first, last, t, p, *context = symbols = self._create_event_step_symbols(
            ("q", self.places.size), ("whole", self.places.size), ("first", 1), ("last", 1)
        )
        v, narrow = self.places.split_vector_by_name(q), self._build_event_bracket_narrowing()
        r = ca.vertcat(first, last, 0)
        for _ in range(12):
            r = narrow(r, v["x"], v["armed"], v["s"], *context)
        first, last, _ = ca.vertsplit(r)
        x, armed, y, *_, lost, _, seen = self.flow(v["x"], v["armed"], v["s"], last, *context)
        crossing = ca.logic_and(armed, y < 0)
        beyond = self.places.stack_vector_by_name(
            self._accumulate_extremes_and_integrals(v, last, x=x, armed=armed, lost=lost, quantities=seen)
        )
        more = (("q", self.places.size), ("beyond", self.places.size), ("crossing", self.n_rows))
        given = self._create_event_step_symbols(*more, ("first", 1), ("last", 1))
        go_on = ca.Function("go_on", given, [given[1]])
        choice = ca.Function.if_else("meet", self._build_event_location_and_effect(), go_on)
        met = choice(ca.sum1(crossing) > 0.5, q, beyond, crossing, first, last, t, p, *context)
        return ca.Function("meet", symbols, [met])

    def _build_event_bracket_narrowing(self) -> Any:
        """Search the interval before a candidate again, as long as no row has crossed but one may have before."""
        sizes = (
            ("r", 3),
            ("x", self.flow.size1_in(0)),
            ("armed", self.n_rows),
            ("s", 1),
            *self._list_remaining_flow_inputs(),
        )
        r, x, armed, s, *context = inputs = [ca.MX.sym(name, size) for name, size in sizes]
        keep = ca.Function("keep", inputs, [r])
        _, again, y, _, found, first, last, *_ = self.flow(x, armed, s, r[1], *context)
        on = ca.logic_and(found, ca.logic_not(ca.sum1(ca.logic_and(again, y < 0)) > 0.5))
        step = ca.Function("step", inputs, [ca.if_else(on, ca.vertcat(first, last, 0), ca.vertcat(r[:2], 1))])
        choice = ca.Function.if_else("narrow", keep, step)
        return ca.Function("narrow", inputs, [choice(r[2], *inputs)])

    def _build_event_location_and_effect(self) -> Any:
        q, _, crossing, first, last, t, p, *context = given = self._create_event_step_symbols(
            ("q", self.places.size),
            ("beyond", self.places.size),
            ("crossing", self.n_rows),
            ("first", 1),
            ("last", 1),
        )
        v = self.places.split_vector_by_name(q)
        moment = SAME_TIME * self.h
        improve = self._build_event_root_search_step()
        r = ca.vertcat(last, first, last, 4 * self.h, 0)
        for _ in range(60):
            r = improve(r, v["x"], v["armed"], v["s"], crossing, *context)
        s = r[0]
        x, armed, y, *_, inside, seen = self.flow(v["x"], v["armed"], v["s"], s, *context)
        y_later = self.flow(x, armed, s, s + moment, *context)[2]
        least = self.lowest(y, y, crossing)[0]
        fired = ca.logic_and(crossing, ca.logic_or(y_later < 0, y <= least))
        met = self._accumulate_extremes_and_integrals(v, s, x=x, armed=armed, lost=inside, quantities=seen)
        w = self.places.split_vector_by_name(self.effect(self.places.stack_vector_by_name(met), fired, t, p))
        y_after = self.events.rows(t + s, w["x"], ca.DM.zeros(w["x"].shape[0]), p)[0]
        slope_after = self.flow(w["x"], w["armed"], s, s, *context)[3]
        y_on, slope_on = self.flow(w["x"], w["armed"], s, s + moment, *context)[2:4]
        put = ca.logic_and(y_after >= 0, ca.fabs(y_after - y) > ca.fabs(y_later - y))
        kept = ca.logic_and(ca.logic_or(armed, put), ca.logic_not(fired))
        w["armed"] = ca.logic_or(kept, y_on > 0)
        back = ca.logic_and(ca.logic_and(slope_after > 0, slope_on < 0), y_on <= 0)
        endless = ca.sum1(ca.logic_and(fired, back)) > 0.5
        sinks = ca.logic_and(slope_on < 0, 2 * ca.fabs(slope_after) <= ca.fabs(slope_on))  # from rest
        through = ca.logic_and(ca.logic_and(fired, sinks), y_on <= ca.fabs(y))
        event_occurred = w["count"] - v["count"]
        for code, ends in (
            (len(self.events) + 1, endless),
            *self._check_resets_leave_event_surface(through, event_occurred),
        ):
            ends = ca.logic_and(ends, w["stop"] < 0.5)
            w["stop"] = ca.if_else(ends, code, w["stop"])
            w["stop time"] = ca.if_else(ends, t + s, w["stop time"])
        soon = RATE_SHARE_OF_STEP * self.h
        rate = (self.flow(x, armed, s, s + soon, *context)[0] - x) / soon
        w["stop rate"] = ca.if_else(w["stop"] > 0.5, rate, w["stop rate"])
        return ca.Function("happen", given, [self.places.stack_vector_by_name(w)])

    def _check_resets_leave_event_surface(
        self, through: Any, event_occurred: Any
    ) -> Iterator[tuple[int, Any]]:
        """Yield, for each event with a reset, its code and whether its row stays at zero and falls through."""
        for j, event in enumerate(self.events.declared):
            if event.reset:
                own = [through[row] for row, owner in enumerate(self.events.owners) if owner == j]
                yield len(self.events) + 2 + j, ca.logic_and(ca.sum1(ca.vertcat(*own)), event_occurred[j])

    def _build_event_root_search_step(self) -> Any:
        r, x, armed, s, crossing = symbols = [
            ca.MX.sym(name, size)
            for name, size in (
                ("r", 5), ("x", self.flow.size1_in(0)), ("armed", self.n_rows), ("s", 1), ("crossing", self.n_rows)
            )
        ]  # fmt: skip
        context = [ca.MX.sym(name, size) for name, size in self._list_remaining_flow_inputs()]
        inputs = [*symbols, *context]
        keep = ca.Function("keep", inputs, [r])
        _, _, y, slope, *_ = self.flow(x, armed, s, r[0], *context)
        step = ca.Function("step", inputs, [self.newton(r, *self.lowest(y, slope, crossing))])
        choice = ca.Function.if_else("improve", keep, step)
        return ca.Function("improve", inputs, [choice(r[4], *inputs)])

    def _build_zero_crossing_function(self) -> Any:
        y, slope, crossing = (ca.SX.sym(name, self.n_rows) for name in ("y", "slope", "crossing"))
        least, its = ca.SX(ca.inf), ca.SX(0)
        for j in range(self.n_rows):
            lower = ca.logic_and(crossing[j], y[j] < least)
            least, its = ca.if_else(lower, y[j], least), ca.if_else(lower, slope[j], its)
        return ca.Function("lowest", [y, slope, crossing], [least, its])

    def _compute_newton_or_bisection_step(self) -> Any:
        """Return Newton's step if it stays inside the bracket and halves the previous step, else bisection."""
        r, y, slope = ca.SX.sym("r", 5), ca.SX.sym("y"), ca.SX.sym("slope")
        now, low, high, before, _ = ca.vertsplit(r)
        above = y > 0
        low, high = ca.if_else(above, now, low), ca.if_else(above, high, now)
        step, close = -y / slope, ROUNDING * self.h
        there = ca.logic_or(y == 0, ca.logic_or(ca.fabs(step) <= close, high - low <= close))
        inside = ca.logic_and(
            ca.logic_and(now + step > low, now + step < high), ca.fabs(step) <= 0.5 * before
        )
        new = ca.if_else(inside, now + step, 0.5 * (low + high))
        last = ca.if_else(ca.fabs(step) <= close, ca.fmin(ca.fmax(now + step, low), high), now)
        moved = ca.if_else(there, last, new)
        return ca.Function(
            "newton", [r, y, slope], [ca.vertcat(moved, low, high, ca.fabs(moved - now), there)]
        )

    def _build_event_reset_function(self) -> Any:
        """Return ``(q, fired rows, t, p) -> q`` after conditions and resets, with the occurrences noted."""
        column, fired = ca.SX.sym("q", self.places.size), ca.SX.sym("fired", self.n_rows)
        t, p = ca.SX.sym("t"), ca.SX.sym("p", self.events.effects.size1_in(2))
        v = self.places.split_vector_by_name(column)
        now, x, n = t + v["s"], v["x"], v["x"].shape[0]
        holds, _ = self.events.effects(now, x, p)
        for j, event in enumerate(self.events.declared):
            mine = [fired[row] for row, owner in enumerate(self.events.owners) if owner == j]
            happens = ca.logic_and(
                ca.logic_and(ca.mmax(ca.vertcat(*mine)), ca.fabs(holds[j]) > 0), v["stop"] < 0.5
            )
            before, x = x, ca.if_else(happens, self.events.effects(now, x, p)[1][:, j], x)
            here = ca.logic_and(happens, ca.DM(range(EVENTS_PER_STEP_MAX)) == v["number"])
            v["codes"] = ca.if_else(here, j + 1, v["codes"])
            v["times"] = ca.if_else(here, now, v["times"])
            spread = ca.kron(here, ca.DM.ones(n, 1))
            v["before"] = ca.if_else(spread, ca.repmat(before, EVENTS_PER_STEP_MAX, 1), v["before"])
            v["after"] = ca.if_else(spread, ca.repmat(x, EVENTS_PER_STEP_MAX, 1), v["after"])
            v["number"] += happens
            v["first"] = _replace_vector_entry_if(
                v["first"], j, ca.logic_and(happens, v["count"][j] < 0.5), now
            )
            v["count"] = _replace_vector_entry_if(v["count"], j, happens, v["count"][j] + 1)
            if event.ends_run:
                v["stop"] = ca.if_else(happens, j + 1, v["stop"])
                v["stop time"] = ca.if_else(happens, now, v["stop time"])
        v["x"] = x
        return ca.Function("effect", [column, fired, t, p], [self.places.stack_vector_by_name(v)])


def _replace_vector_entry_if(column: Any, place: int, condition: Any, value: Any) -> Any:
    entries = ca.vertsplit(column)
    entries[place] = ca.if_else(condition, value, entries[place])
    return ca.vertcat(*entries)
