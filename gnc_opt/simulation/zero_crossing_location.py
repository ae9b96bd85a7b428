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

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import casadi as ca

from gnc_opt.numerical_tolerances import ROUNDING, SAME_TIME
from gnc_opt.simulation.block_signal_chain import ColumnLayout
from gnc_opt.simulation.dormand_prince import IntegrationStep
from gnc_opt.simulation.recorded_extremes_and_integrals import merge_extremes_and_integrals
from gnc_opt.simulation.zero_crossing_events import EVENTS_PER_STEP_MAX, Events

RATE_SHARE_OF_STEP = 1e-4
"""Interval of rate differences, as a share of the minor step."""

MAX_NARROWINGS = 12
"""Most searches before a candidate for an earlier crossing."""

MAX_ROOT_STEPS = 60
"""Most steps of the root search: bisection alone reaches rounding."""


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


def build_event_location_function(events: Events, propagation: Any, h: float) -> tuple[Any, ColumnLayout]:
    """Return the function ``(q, t, p, *context) -> q`` of a minor step with events, and the layout of q.

    ``propagation`` maps ``(x, armed, begin, end, *context)`` to the values of `_Interval`.
    """
    location = _EventLocation(events, propagation, h)
    return location.build_minor_step_with_events(), location.layout


class _Interval(NamedTuple):
    """Results of the propagation over an interval of a minor step; MX.

    State and armed rows at the end; values and slopes of the rows there; whether a candidate was found, and its
    interval; undefined events up to the end and before it; extremes and integrals.
    """

    x: Any
    armed: Any
    y: Any
    slope: Any
    found: Any
    first: Any
    last: Any
    lost: Any
    lost_inside: Any
    quantities: Any


class _EventLocation:
    """Functions of a minor step with events; column q contains the state at the time s after the start of the step."""

    def __init__(self, events: Events, propagation: Any, h: float) -> None:
        self.events, self.propagation, self.h = events, propagation, h
        n, self.n_rows = propagation.size1_in(0), propagation.size1_in(1)
        self.layout = ColumnLayout(
            (
                ("x", n),
                ("armed", self.n_rows),
                ("s", 1),
                ("quantities", propagation.size1_out(9)),
                *build_event_record_layout(events, n),
                *build_event_log_layout(n),
            )
        )
        self.context = tuple((f"c{i}", propagation.size1_in(i)) for i in range(4, propagation.n_in()))
        self.lowest = self._build_zero_crossing_function()
        self.newton = self._compute_newton_or_bisection_step()
        self.effect = self._build_event_reset_function()

    def _create_symbols(self, *more: tuple[str, int]) -> list[Any]:
        """Return q, then further symbols of given names and sizes, then t, p and the context."""
        plant = ("t", 1), ("p", self.events.effects.size1_in(2))
        return [ca.MX.sym(*sizes) for sizes in (("q", self.layout.size), *more, *plant, *self.context)]

    def _propagate(self, v: dict[str, Any], end: Any, context: Sequence[Any]) -> _Interval:
        return _Interval(*self.propagation(v["x"], v["armed"], v["s"], end, *context))

    def _complete_interval(
        self, v: dict[str, Any], end: Any, interval: _Interval, lost: Any
    ) -> dict[str, Any]:
        """Return the values after an interval up to ``end``, in which the events ``lost`` were undefined."""
        quantities = merge_extremes_and_integrals(v["quantities"], interval.quantities)
        lost = ca.fmax(v["lost"], lost)
        return v | {
            "x": interval.x,
            "armed": interval.armed,
            "s": end,
            "lost": lost,
            "quantities": quantities,
        }

    def build_minor_step_with_events(self) -> Any:
        """Return ``(q, t, p, *context) -> q``; a minor step with too many events ends the run."""
        q, t, *others = self._create_symbols()
        proceed = self._build_propagation_to_next_event()
        after = q
        for _ in range(2 * EVENTS_PER_STEP_MAX):
            after = proceed(after, t, *others)
        v = self.layout.split_vector_by_name(after)
        is_full = ca.logic_or(v["s"] < self.h, v["number"] >= EVENTS_PER_STEP_MAX)
        self._end_run_if(v, is_full, len(self.events) + 1, t + v["s"])
        return ca.Function("minor_step", [q, t, *others], [self.layout.stack_vector_by_name(v)])

    @staticmethod
    def _end_run_if(v: dict[str, Any], condition: Any, code: int, time: Any) -> None:
        """Record the end of the run, with its code and time, if it has not ended before."""
        ends = ca.logic_and(condition, v["stop"] < 0.5)
        v["stop"] = ca.if_else(ends, code, v["stop"])
        v["stop time"] = ca.if_else(ends, time, v["stop time"])

    def _build_propagation_to_next_event(self) -> Any:
        """Return the propagation function to the next event or to the end; inactive when the step is complete."""
        q, *others = inputs = self._create_symbols()
        v = self.layout.split_vector_by_name(q)
        rest = self._propagate(v, self.h, others[2:])
        whole = self.layout.stack_vector_by_name(self._complete_interval(v, self.h, rest, rest.lost))
        given = self._create_symbols(("whole", self.layout.size), ("first", 1), ("last", 1))
        without_event = ca.Function("without_event", given, [given[1]])
        either = ca.Function.if_else("either", self._build_propagation_through_event(), without_event)
        proceed = ca.Function(
            "proceed", inputs, [either(rest.found, q, whole, rest.first, rest.last, *others)]
        )
        complete = ca.Function("complete", inputs, [q])
        active = ca.logic_and(v["stop"] < 0.5, v["s"] < self.h)
        choice = ca.Function.if_else("choice", proceed, complete)
        return ca.Function("to_next_event", inputs, [choice(active, *inputs)])

    def _build_propagation_through_event(self) -> Any:
        """Propagate to a candidate crossing, and through its event if the row crosses zero."""
        inputs = self._create_symbols(("whole", self.layout.size), ("first", 1), ("last", 1))
        q, _, first, last, *others = inputs
        v, narrow, context = (
            self.layout.split_vector_by_name(q),
            self._build_event_bracket_narrowing(),
            others[2:],
        )
        bracket = ca.vertcat(first, last, 0)
        for _ in range(MAX_NARROWINGS):
            bracket = narrow(bracket, v["x"], v["armed"], v["s"], *context)
        first, last, _ = ca.vertsplit(bracket)
        interval = self._propagate(v, last, context)
        crossing = ca.logic_and(interval.armed, interval.y < 0)
        beyond = self.layout.stack_vector_by_name(self._complete_interval(v, last, interval, interval.lost))
        more = (("beyond", self.layout.size), ("crossing", self.n_rows), ("first", 1), ("last", 1))
        given = self._create_symbols(*more)
        without_crossing = ca.Function("without_crossing", given, [given[1]])
        either = ca.Function.if_else("either", self._build_event_location_and_effect(), without_crossing)
        after = either(ca.sum1(crossing) > 0.5, q, beyond, crossing, first, last, *others)
        return ca.Function("through_event", inputs, [after])

    def _build_event_bracket_narrowing(self) -> Any:
        """Search the interval before a candidate again, as long as no row has crossed but one may have before.

        The bracket contains both ends of the interval and whether the search is complete.
        """
        sizes = (("bracket", 3), ("x", self.propagation.size1_in(0)), ("armed", self.n_rows), ("s", 1))
        inputs = [ca.MX.sym(*size) for size in (*sizes, *self.context)]
        bracket, x, armed, s, *context = inputs
        interval = _Interval(*self.propagation(x, armed, s, bracket[1], *context))
        crossed = ca.sum1(ca.logic_and(interval.armed, interval.y < 0)) > 0.5
        narrower = ca.vertcat(interval.first, interval.last, 0)
        again = ca.logic_and(interval.found, ca.logic_not(crossed))
        step = ca.Function("step", inputs, [ca.if_else(again, narrower, ca.vertcat(bracket[:2], 1))])
        either = ca.Function.if_else("either", ca.Function("complete", inputs, [bracket]), step)
        return ca.Function("narrow", inputs, [either(bracket[2], *inputs)])

    def _build_event_location_and_effect(self) -> Any:
        """Return ``(q, beyond, crossing, first, last, t, p, *context) -> q`` at the event, after its resets."""
        more = (("beyond", self.layout.size), ("crossing", self.n_rows), ("first", 1), ("last", 1))
        q, _, crossing, first, last, t, p, *context = inputs = self._create_symbols(*more)
        v = self.layout.split_vector_by_name(q)
        s = self._locate_crossing(v, crossing, first, last, context)
        before = self._propagate(v, s, context)
        at_event = self._complete_interval(v, s, before, before.lost_inside)
        later = self._propagate(at_event, s + SAME_TIME * self.h, context)
        least = self.lowest(before.y, before.y, crossing)[0]
        fired = ca.logic_and(crossing, ca.logic_or(later.y < 0, before.y <= least))
        reset = self.effect(self.layout.stack_vector_by_name(at_event), fired, t, p)
        w = self.layout.split_vector_by_name(reset)
        after, soon = (self._propagate(w, s + late, context) for late in (0.0, SAME_TIME * self.h))
        y_after = self.events.rows(t + s, w["x"], ca.DM.zeros(w["x"].shape[0]), p)[0]
        raised = ca.logic_and(y_after >= 0, ca.fabs(y_after - before.y) > ca.fabs(later.y - before.y))
        w["armed"] = ca.logic_or(
            ca.logic_and(ca.logic_or(before.armed, raised), ca.logic_not(fired)), soon.y > 0
        )
        returns = ca.logic_and(ca.logic_and(after.slope > 0, soon.slope < 0), soon.y <= 0)
        self._end_run_if(w, ca.sum1(ca.logic_and(fired, returns)) > 0.5, len(self.events) + 1, t + s)
        # the row starts from rest at zero, and falls
        falls = ca.logic_and(soon.slope < 0, 2 * ca.fabs(after.slope) <= ca.fabs(soon.slope))
        through = ca.logic_and(ca.logic_and(fired, falls), soon.y <= ca.fabs(before.y))
        for code, ends in self._check_resets_leave_event_surface(through, w["count"] - v["count"]):
            self._end_run_if(w, ends, code, t + s)
        step = RATE_SHARE_OF_STEP * self.h
        rate = (self._propagate(at_event, s + step, context).x - before.x) / step
        w["stop rate"] = ca.if_else(w["stop"] > 0.5, rate, w["stop rate"])
        return ca.Function("event", inputs, [self.layout.stack_vector_by_name(w)])

    def _check_resets_leave_event_surface(
        self, through: Any, event_occurred: Any
    ) -> Iterator[tuple[int, Any]]:
        """Yield, for each event with a reset, its code and whether its row stays at zero and falls through."""
        for j, event in enumerate(self.events.declared):
            if event.reset:
                own = [through[row] for row, owner in enumerate(self.events.owners) if owner == j]
                yield len(self.events) + 2 + j, ca.logic_and(ca.sum1(ca.vertcat(*own)), event_occurred[j])

    def _locate_crossing(
        self, v: dict[str, Any], crossing: Any, first: Any, last: Any, context: Sequence[Any]
    ) -> Any:
        """Return the time of the first zero of the crossing rows in a bracket."""
        improve = self._build_event_root_search_step()
        search = ca.vertcat(last, first, last, 4 * self.h, 0)
        for _ in range(MAX_ROOT_STEPS):
            search = improve(search, v["x"], v["armed"], v["s"], crossing, *context)
        return search[0]

    def _build_event_root_search_step(self) -> Any:
        """Return the step of the root search: time, bracket, size of the last step, and whether it has converged."""
        n = self.propagation.size1_in(0)
        sizes = (("search", 5), ("x", n), ("armed", self.n_rows), ("s", 1), ("crossing", self.n_rows))
        inputs = [ca.MX.sym(*size) for size in (*sizes, *self.context)]
        search, x, armed, s, crossing, *context = inputs
        interval = _Interval(*self.propagation(x, armed, s, search[0], *context))
        improved = self.newton(search, *self.lowest(interval.y, interval.slope, crossing))
        step = ca.Function("step", inputs, [improved])
        either = ca.Function.if_else("either", ca.Function("converged", inputs, [search]), step)
        return ca.Function("improve", inputs, [either(search[4], *inputs)])

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
        column, fired = ca.SX.sym("q", self.layout.size), ca.SX.sym("fired", self.n_rows)
        t, p = ca.SX.sym("t"), ca.SX.sym("p", self.events.effects.size1_in(2))
        v = self.layout.split_vector_by_name(column)
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
        return ca.Function("effect", [column, fired, t, p], [self.layout.stack_vector_by_name(v)])


def _replace_vector_entry_if(column: Any, place: int, condition: Any, value: Any) -> Any:
    entries = ca.vertsplit(column)
    entries[place] = ca.if_else(condition, value, entries[place])
    return ca.vertcat(*entries)
