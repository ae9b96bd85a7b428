"""Within: what rows of the plant are inside the control steps of a run, flown again from what was logged.

The plant is integrated over a control step, or a part of it between two events, as it was in the run: with its random
numbers, its command and what the actuators make of it. Every integration step is looked at where it begins, where it
ends, and at evenly spaced nodes between.

Recorder: what is kept of the quantities of runs, leg by leg as they are flown.

Peaks: the largest values of rows between nodes with slopes, by looking closely where it pays.

Branch and bound: an interval in which no row can be larger than what has been found is left alone; of the others those
that promise most are cut into parts. What an interval promises is where the tangents of its ends meet, which a concave
row does not exceed, or the peak of the cubic through its ends.

Quantity: a number along the way of a run, of which the extremes, the integral and some samples are kept.

It is looked at within the control steps, with what the actuators apply at each instant, and closely where it may be
largest or least. What is kept does not grow with the run: three numbers, and samples at `SAMPLES` instants at most.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arguments import read_label
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.model.model import Model
from gnc_opt.model.variables import Layout, Variable
from gnc_opt.simulation.control_step import ControlStep
from gnc_opt.simulation.dormand_prince import Taken
from gnc_opt.simulation.events import EVENTS_PER_STEP_MAX, plant_expression
from gnc_opt.simulation.loop_kernel import Kernel
from gnc_opt.simulation.outcome import Outcome, RunStatus
from gnc_opt.tolerances import SAME_TIME

AT_A_TIME = 100
"""Control steps that are looked at in one call."""


class QuantityRecorder:
    """What is kept of the quantities of n runs, and which were not-a-number.

    Parameters
    ----------
    quantities : Quantities
    kernel : Kernel
    times : array (n_steps + 1,)
        s.
    runs : int

    Attributes
    ----------
    sums : array (3 n_quantities, runs)
        Largest values, least values and integrals.
    samples : array (n_quantities, n_samples, runs)
        Not-a-number after the end of a run.
    lost : dict of int to Outcome
        By run, the first quantity that was not-a-number, and when.
    """

    def __init__(self, quantities: Quantities, kernel: Kernel, times: Array, runs: int) -> None:
        self.quantities, self.kernel, self.times, n = quantities, kernel, times, len(quantities)
        self._at = sample_steps(times.size - 1)
        self.sums = np.repeat([-np.inf, np.inf, 0.0], n)[:, None] * np.ones(runs)
        self.samples = np.full((n, self._at.size, runs), np.nan)
        self.lost: dict[int, Outcome] = {}
        self._looks = Columns(quantities.along, AT_A_TIME), Columns(quantities.near, AT_ONCE)

    def add(self, run: int, first: int, columns: Array, logs: Array, known: tuple[Array, Array]) -> None:
        """Take in a leg of a run.

        Parameters
        ----------
        run, first : int
            Which run, and the control step that the leg begins with.
        columns : array (n_state, n + 1)
            States of the kernel.
        logs : array (n_log, n)
        known : tuple of array (n, n_known) and array (n_parameters,)
            What was known and drawn for the steps, and the parameters of the run.
        """
        leg = self._leg(first, columns, logs, known)
        n, nodes = len(self.quantities), leg.nodes()
        signs, y = np.repeat([1.0, -1.0], n), nodes.z[:n]
        best, totals = climb(signs * self.sums[: 2 * n, run], nodes, leg.closer)
        self.sums[: 2 * n, run] = signs * best
        self.sums[2 * n :, run] += totals[:n]
        self._note_lost(run, first + leg.step, y)
        last = first + leg.step[-1] + 1  # what an event has ended before is over
        whole = float(leg.spans[-1, 1]) >= self._dt * (1 - SAME_TIME)
        here = np.flatnonzero((self._at >= first) & (self._at < last))
        begun = np.unique(leg.step, return_index=True)[1]
        self.samples[:, here, run] = y[:, 0, begun[self._at[here] - first]]
        if whole:
            self.samples[:, np.flatnonzero(self._at == last), run] = y[:, -1, -1:]

    @property
    def _dt(self) -> float:
        return float((self.times[-1] - self.times[0]) / (self.times.size - 1))

    def _note_lost(self, run: int, steps: Array, y: Array) -> None:
        """Note the first quantity that is not-a-number at a node, and when its control step began."""
        unknown: Any = np.isnan(y).any(axis=1)
        if unknown.any() and run not in self.lost:
            piece = int(np.argmax(unknown.any(axis=0)))
            name = self.quantities.layout.names[int(np.argmax(unknown[:, piece]))]
            time = float(self.times[steps[piece]])
            self.lost[run] = Outcome(RunStatus.NOT_FINITE, f"quantity '{name}'", time)

    def _leg(self, first: int, columns: Array, logs: Array, known: tuple[Array, Array]) -> _Leg:
        """Return the pieces of a leg: its control steps, cut where events have happened."""
        parts, told = self.kernel.state.split(columns), self.kernel.log.split(logs)
        flown, end = logs.shape[1], self._dt
        if "stop" in parts:
            flown = int(np.sum(parts["stop"][0, :-1] < 0.5))
            if parts["stop"][0, flown] > 0.5:
                end = float(parts["stop time"][0, flown] - self.times[first + flown - 1])
        steps, xs = np.arange(flown), parts["plant"][:, :flown].T
        spans = np.zeros((flown, 2))
        spans[:, 1], spans[-1, 1] = self._dt, end
        if "number" in told and told["number"][0, :flown].any():
            pieces = [
                (k, *piece)
                for k in range(flown)
                for piece in _pieces(told, k, xs[k], spans[k, 1], self.times[first + k])
            ]
            steps = np.array([piece[0] for piece in pieces])
            xs, spans = np.stack([piece[1] for piece in pieces]), np.array([piece[2:] for piece in pieces])
        given = columns.T[steps], known[0][steps], known[1][None], told["commands"].T[steps], xs
        return _Leg(self._looks, len(self.quantities), given, steps, spans)

    def told(self, outcomes: Sequence[Outcome]) -> tuple[Outcome, ...]:
        """Return the outcomes with quantities that were not-a-number, unless the run was not finite anyway."""
        return tuple(o if o.not_finite else self.lost.get(i, o) for i, o in enumerate(outcomes))


@dataclass(frozen=True, eq=False)
class _Leg:
    """Pieces of control steps that are flown again; ``given`` are the first inputs of `Quantities.along`, by rows."""

    looks: tuple[Columns, Columns]
    count: int
    given: tuple[Array, ...]
    step: Any
    spans: Array

    def nodes(self) -> Nodes:
        """Return the quantities and their opposites at some times."""
        return self._told(self.looks[0](*self.given, self.spans[:, :1], self.spans[:, 1:]))

    def closer(self, intervals: Intervals) -> Nodes:
        """Return the same inside intervals."""
        given = (array if len(array) == 1 else array[intervals.piece] for array in self.given)
        begin = self.spans[intervals.piece, :1]
        return self._told(self.looks[1](*given, begin, intervals.first[:, None], intervals.last[:, None]))

    def _told(self, made: Sequence[Array]) -> Nodes:
        s, n = made[0].T, self.count
        y, slope = (rows.reshape(s.shape[1], s.shape[0], -1).transpose(2, 1, 0) for rows in made[1:])
        z, slopes = (np.concatenate([array[:n], -array[:n]]) for array in (y, slope))
        return Nodes(s, z, slopes, y[n:], slope[n:])


def _pieces(
    told: Mapping[str, Array], step: int, x: Array, end: float, t: float
) -> Iterator[tuple[Array, float, float]]:
    """Yield state, beginning and end (s) of the pieces of a control step that begins at t, between its events."""
    begin = 0.0
    for k in range(int(min(told["number"][0, step], EVENTS_PER_STEP_MAX))):
        instant = float(np.clip(told["times"][k, step] - t, begin, end))
        yield x, begin, instant
        x, begin = told["after"][:, step].reshape(EVENTS_PER_STEP_MAX, x.size)[k], instant
    yield x, begin, end


PEAK_TOLERANCE = 1e-9
"""How far a peak may be above what is found, relative to max(1, |y|)."""

AT_ONCE = 8
"""Intervals that are looked at together."""

_MAX_SUBDIVISIONS = 2000
"""For what has no end, as slopes that are infinite."""

_MIN_INTERVAL_SHARE = 1e-7
"""Of a control step: what a switch hides in less is not looked for."""


@dataclass(frozen=True)
class Nodes:
    """Rows at times of n pieces of a way.

    Attributes
    ----------
    s : array (n_nodes, n)
        Times.
    z, slope : array (n_rows, n_nodes, n)
    switch, switch_slope : array (n_switches, n_nodes, n)
        What the rows bend or jump at zero of.
    """

    s: Array
    z: Array
    slope: Array
    switch: Array
    switch_slope: Array

    def some(self, count: int) -> Nodes:
        """Return those of the first pieces."""
        return Nodes(*(array[..., :count] for array in vars(self).values()))

    def promise(self) -> Array:
        """Return what the rows do not exceed between neighbouring nodes, (n_rows, n_nodes - 1, n).

        If they are concave there or cubics: minus infinity where these say that the ends are the largest. Where one
        switch is of another sign at the other end, what their slopes could lead to; where several are, or one may be
        meanwhile, infinity.
        """
        length = np.diff(self.s, axis=0)
        z, slope, switch, tilt = (
            (array[:, :-1], array[:, 1:]) for array in (self.z, self.slope, self.switch, self.switch_slope)
        )
        found = _highest(length, z[0], slope[0], z[1], slope[1])
        if len(self.switch):
            turns = np.sum(np.sign(switch[0]) != np.sign(switch[1]), axis=0)
            with np.errstate(invalid="ignore"):  # slopes may be none where rows are numbers
                leads = np.maximum(*(a + length * np.abs(b) for a, b in zip(z, slope, strict=True)))
            found = np.where(turns > 0, np.fmax(found, leads), found)
            hidden = turns > 1
            for sign in (1.0, -1.0):
                side = [sign * array for array in (switch[0], tilt[0], switch[1], tilt[1])]
                below = (side[0] < 0) & (side[2] < 0)
                hidden |= np.any(below & (_highest(length, *side) > 0), axis=0)
            found = np.where(hidden & (length > _MIN_INTERVAL_SHARE * self.s.max()), np.inf, found)
        return np.where(length > 0, found, -np.inf)

    def integrals(self) -> Array:
        """Return the integrals over time of the cubics between the nodes, (n_rows, n_nodes - 1, n)."""
        length = np.diff(self.s, axis=0)
        with np.errstate(invalid="ignore"):
            bend = self.slope[:, :-1] - self.slope[:, 1:]
        bend = np.where(np.isfinite(bend), bend, 0.0)  # slopes may be none where rows are numbers
        return np.asarray(0.5 * length * (self.z[:, :-1] + self.z[:, 1:]) + length**2 / 12 * bend)


def _highest(length: Array, z0: Array, slope0: Array, z1: Array, slope1: Array) -> Array:
    """Return the height at which the tangents of both ends meet, or of the cubic's peak; minus infinity if neither is
    between."""
    with np.errstate(all="ignore"):
        a, b, rise = length * slope0, length * slope1, z1 - z0
        meet = np.where((a > 0) & (b < 0), z0 + a * np.clip((rise - b) / (a - b), 0.0, 1.0), -np.inf)
        # z0 + a nu + c nu^2 + d nu^3; its peak by the root of the derivative without cancellation
        c, d = 3 * rise - 2 * a - b, a + b - 2 * rise
        nu = a / (np.sqrt(c**2 - 3 * d * a) - c)
        peak = np.where((nu > 0) & (nu < 1), z0 + nu * (a + nu * (c + nu * d)), -np.inf)
        return np.asarray(np.fmax(meet, peak))


@dataclass(frozen=True)
class Intervals:
    """Intervals of pieces of a way.

    Attributes
    ----------
    piece : int array (n,)
    first, last : array (n,)
        s.
    promise, integral : array (n_rows, n)
        What the rows do not exceed there, and their integrals over time.
    """

    piece: Any
    first: Array
    last: Array
    promise: Array
    integral: Array

    @classmethod
    def of(cls, piece: Any, nodes: Nodes) -> Intervals:
        """Return those between the nodes of pieces of such numbers (n,)."""
        first, last, count = nodes.s[:-1], nodes.s[1:], len(nodes.z)
        place = np.broadcast_to(piece, first.shape)
        rows = (array.reshape(count, -1) for array in (nodes.promise(), nodes.integrals()))
        return cls(place.ravel(), first.ravel(), last.ravel(), *rows)

    def some(self, which: Any) -> Intervals:
        """Return some of them."""
        return Intervals(*(array[..., which] for array in vars(self).values()))

    def and_(self, others: Intervals) -> Intervals:
        """Return them with others."""
        both = zip(vars(self).values(), vars(others).values(), strict=True)
        return Intervals(*(np.concatenate(pair, axis=-1) for pair in both))


def climb(best: Array, nodes: Nodes, look: Callable[[Intervals], Nodes]) -> tuple[Array, Array]:
    """Return the largest values of rows and their integrals over time, (n_rows,).

    Parameters
    ----------
    best : array (n_rows,)
        The largest found elsewhere.
    nodes : Nodes
    look : callable
        Returns the nodes in `AT_ONCE` intervals.
    """
    intervals = Intervals.of(np.arange(nodes.s.shape[1]), nodes)
    best, total = np.maximum(best, nodes.z.max(axis=(1, 2))), intervals.integral.sum(axis=1)
    for _ in range(_MAX_SUBDIVISIONS):
        size = np.maximum(1.0, np.abs(best))[:, None]
        more = np.max((intervals.promise - best[:, None]) / size, axis=0, initial=-np.inf)
        intervals, more = intervals.some(more > PEAK_TOLERANCE), more[more > PEAK_TOLERANCE]
        if not more.size:
            break
        order = np.argsort(-more, kind="stable")
        closer = intervals.some(order[:AT_ONCE])
        found = look(intervals.some(np.resize(order[:AT_ONCE], AT_ONCE))).some(closer.piece.size)
        parts = Intervals.of(closer.piece, found)
        best = np.fmax(best, found.z.max(axis=(1, 2)))
        total += parts.integral.sum(axis=1) - closer.integral.sum(axis=1)
        intervals = intervals.some(order[AT_ONCE:]).and_(parts)
    return best, total


SAMPLES = 101
"""Instants of a flight at which quantities are kept, evenly spaced in control steps, ends included."""

KEPT = ("max", "min", "integral")
"""Numbers of a quantity that are kept of each run, as measures are called."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """A number that is followed over a run: a distance, a tilt, an excess over a corridor, fuel, a plume.

    Campaigns then have the measures ``max(name)``, ``min(name)`` and ``integral(name)`` (over time), and
    `Campaign.envelope`. A limit on the largest value of ``1 - distance`` is a keep-out of radius 1. Extremes are found
    to 1e-9, relative to max(1, \\|y\\|), where values and slopes at eight instants of a control
    step tell of them, of what the expression bends or jumps at (the arguments of abs, of max, of a comparison), too: a
    sphere that is crossed within a thousandth of a step is. Integrals are of cubics between these instants.

    Parameters
    ----------
    name : str
    expression : casadi.SX
        Of the plant's symbols of time, states, controls and parameters, (1, 1). Controls are what the actuators apply
        at that instant, without disturbances.
    unit : str

    Examples
    --------
    >>> from gnc_opt.simulation import Quantity
    >>> energy = Quantity("energy", 0.5 * v**2, "J/kg")
    """

    name: str
    expression: Any
    unit: str = ""

    def __post_init__(self) -> None:
        read_label(self.name, "quantity")


@dataclass(frozen=True, eq=False)
class Quantities:
    """The quantities of a loop as CasADi functions of its control steps.

    Attributes
    ----------
    layout : Layout
        Names and units.
    along, near : casadi.Function
        See `gnc_opt.simulation.quantities`.
    """

    layout: Layout
    along: Any
    near: Any

    def __len__(self) -> int:
        return self.layout.size

    @classmethod
    def of(cls, step: ControlStep, declared: tuple[Quantity, ...]) -> Quantities:
        """Return quantities of the plant of a loop, in its control steps."""
        rows = read_quantities(step.wiring.plant, declared)
        layout = Layout("quantity", tuple(Variable(q.name, 1, q.unit) for q in declared), "the closed loop")
        rows = ca.vertcat(rows, switches(rows))
        return cls(layout, along(step, rows), near(step, rows))


def read_quantities(plant: Model, declared: tuple[Quantity, ...]) -> Any:
    """Return the expressions of quantities of a plant, SX column.

    Raises
    ------
    ArgumentError
        Two of one name, symbols of another model, or wrong sizes.
    """
    names = [quantity.name for quantity in declared]
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError(f"two quantities of the closed loop are called '{name}': rename one.")
    rows = [
        plant_expression(q.expression, f"the expression of quantity '{q.name}'", plant, controls=True)
        for q in declared
    ]
    return ca.densify(ca.vertcat(ca.SX(0, 1), *rows))


def sample_steps(n_steps: int) -> Array:
    """Return the control steps at whose beginnings samples are kept, and the end, (n_samples,)."""
    return np.round(np.linspace(0, n_steps, min(SAMPLES, n_steps + 1))).astype(int)


_MIN_INTERVALS_PER_STEP = 8
"""Intervals of a control step that are looked at, at least; of an integration step one at least."""

_OF_ONE = {ca.OP_FABS, ca.OP_SIGN}
_OF_TWO = {ca.OP_FMIN, ca.OP_FMAX, ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE}

_ZOOMED = 8
"""Intervals of a part of an integration step that is looked at closely."""


def along(step: ControlStep, rows: Any) -> Any:
    """Return the function that looks at control steps.

    Parameters
    ----------
    step : ControlStep
        rows : casadi SX column
        Of the plant's symbols of time, states, controls and parameters.

    Returns
    -------
    casadi.Function
        ``(X, w, P, u, x, begin, end) -> (s, y, dy_ds)``: the plant flown from x between two times (s since the control
        step began), u the commands; times of the nodes (n_nodes, 1), and the rows there, (n_rows, n_nodes) by columns.
        Consecutive nodes of one time are of different integration steps, or of one that was not flown.
    """
    count = -(-_MIN_INTERVALS_PER_STEP // (step.wiring.minor_steps * step.substeps))
    column, known, u, x = _symbols(step)
    begin, end = ca.SX.sym("begin"), ca.SX.sym("end")
    look = _Look(step, rows, count)
    _fly(step, step, look, (column, known, u, x), (begin, begin, end))
    return ca.Function("along", [column, known, step.P, u, x, begin, end], look.told())


def near(step: ControlStep, rows: Any) -> Any:
    """Return the function ``(X, w, P, u, x, begin, first, last) -> (s, y, dy_ds)`` that flies from ``begin`` to
    ``first`` and looks from there to ``last``, as `along`, but closely."""
    column, known, u, x = _symbols(step)
    span = begin, first, last = [ca.SX.sym(name) for name in ("begin", "first", "last")]
    look, short = _Look(step, rows, _ZOOMED), copy.copy(step)
    short.substeps = 1  # what is looked at is shorter than an integration step
    _fly(step, short, look, (column, known, u, x), (begin, first, last))
    return ca.Function("near", [column, known, step.P, u, x, *span], look.told())


def _symbols(step: ControlStep) -> tuple[Any, ...]:
    sizes = (
        ("X", step.state.size),
        ("w", step.known.size),
        ("u", step.wiring.controller.commands.size),
        ("x", step.wiring.plant.states.size),
    )
    return tuple(ca.SX.sym(name, size) for name, size in sizes)


def _fly(
    step: ControlStep, looking: ControlStep, look: _Look, given: tuple[Any, ...], span: tuple[Any, Any, Any]
) -> None:
    """Fly from the first to the second of three times, and look from there to the third."""
    column, known, u, x = given
    w, state = step.known.split(known), step.state.split(column)
    new, before = step.pushed(state, w), state["plant"]
    for i in range(step.wiring.minor_steps):
        tick = step.tick_of(i, w, {"plant": before})
        waves, _ = step.actuate(tick, u, new, w, i)
        begin, first, last = (ca.fmin(ca.fmax(s - i * step.h, 0), step.h) for s in span)
        if span[0] is not span[1]:
            flown = step.fly(tick.t, x, waves, new, (begin, first))
            x = ca.if_else(first > begin, flown, x)
        if looking is step and any(wave.tau is not None for wave in waves):
            # a decay is projected on parabolas in each integration step, and right at its ends
            looking, look.count = copy.copy(step), 2
            looking.substeps = max(step.substeps, -(-_MIN_INTERVALS_PER_STEP // step.wiring.minor_steps))
        look.now = ca.fmin(
            ca.fmax(i * step.h, span[1]), span[2]
        )  # no time passes in minor steps that are not flown
        flown = looking.fly(tick.t, x, waves, new, (first, last), look)
        before = x = ca.if_else(last > first, flown, x)


class _Look:
    """Collects the nodes while the plant is integrated.

    Attributes
    ----------
    now : SX
        s since the control step began.
    """

    def __init__(self, step: ControlStep, rows: Any, count: int) -> None:
        self.rows, self.p, self.count = _rows(step.wiring.plant, rows), step.plant_p, count
        self.now = ca.SX(0)
        self._nodes: list[tuple[Any, Any, Any]] = []

    def __call__(self, taken: Taken, u: Callable[[Any], Any]) -> None:
        share = ca.SX.sym("nu")
        applied = ca.densify(u(share))
        bend = ca.if_else(taken.length > 0, ca.densify(ca.jacobian(applied, share)) / taken.length, 0)
        course = ca.horzcat(applied, bend)
        for j in range(self.count + 1):
            nu = j / self.count
            x, rate = taken.at(nu)
            t, at = taken.time + nu * taken.length, taken.after if j == self.count else x
            now = ca.substitute(course, share, nu)
            y, slope = self.rows(t, at, now[:, 0], rate, now[:, 1], self.p)
            self._nodes.append((self.now + nu * taken.length, y, slope))
        self.now = self.now + taken.length

    def told(self) -> list[Any]:
        return [ca.vertcat(*column) for column in zip(*self._nodes, strict=True)]


def _rows(plant: Model, rows: Any) -> Any:
    """Return ``(t, x, u, dx_ds, du_ds, p) -> (y, dy_ds)``."""
    t, x, u, p = plant.arguments()
    dx, du = ca.SX.sym("dx", x.shape[0]), ca.SX.sym("du", u.shape[0])
    slope = ca.jtimes(rows, ca.vertcat(t, x, u), ca.vertcat(1, dx, du))
    return ca.Function("rows", [t, x, u, dx, du, p], [ca.densify(rows), ca.densify(slope)])


def switches(rows: Any) -> Any:
    """Return what SX rows bend or jump at zero of, column: ``a`` of \\|a\\|, ``a - b`` of max(a, b) and of a < b."""
    found: dict[int, Any] = {}
    waiting, seen = ca.vertsplit(rows), set()
    while waiting:
        node = waiting.pop()
        if node.element_hash() in seen or node.n_dep() == 0:
            continue
        seen.add(node.element_hash())
        parts = [node.dep(i) for i in range(node.n_dep())]
        waiting += parts
        if node.op() in _OF_ONE:
            found[parts[0].element_hash()] = parts[0]
        elif node.op() in _OF_TWO:
            difference = parts[0] - parts[1]
            found[difference.element_hash()] = difference
    return ca.vertcat(ca.SX(0, 1), *found.values())


class Columns:
    """A CasADi function of many columns, so many at a time, without conversions."""

    def __init__(self, function: Any, count: int) -> None:
        mapped = function.map(count)
        self._buffer, self._evaluate = mapped.buffer()
        self._given = [np.zeros((count, function.size1_in(i))) for i in range(function.n_in())]
        self._made = [np.zeros((count, function.size1_out(i))) for i in range(function.n_out())]
        self._count = count
        for k, array in enumerate(self._given):
            self._buffer.set_arg(k, memoryview(array.data))
        for k, array in enumerate(self._made):
            self._buffer.set_res(k, memoryview(array.data))

    def __call__(self, *given: Array) -> list[Array]:
        """Return what the function makes of arrays (n, n_entries), (n, n_made); n may be 1 where it is for all."""
        total = max(len(array) for array in given)
        results = [np.empty((total, array.shape[1])) for array in self._made]
        for first in range(0, total, self._count):
            here = slice(first, min(first + self._count, total))
            size = here.stop - first
            for place, array in zip(self._given, given, strict=True):
                place[:size] = array if len(array) == 1 else array[here]
            self._evaluate()
            for result, made in zip(results, self._made, strict=True):
                result[here] = made[:size]
        return results
