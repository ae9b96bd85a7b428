"""Within: what rows of the plant are inside the control steps of a run, flown again from what was logged.

The plant is integrated over a control step, or a part of it between two events, as it was in the run: with its random
numbers, its command and what the actuators make of it. Every integration step is looked at where it begins, where it
ends, and at evenly spaced nodes between.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.model.model import Model
from gnc_opt.simulation.control_step import ControlStep
from gnc_opt.simulation.integrate import Taken

_LOOKS = 8
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
        With nothing beside.
    rows : casadi SX column
        Of the plant's symbols of time, states, controls and parameters.

    Returns
    -------
    casadi.Function
        ``(X, w, P, u, x, begin, end) -> (s, y, dy_ds)``: the plant flown from x between two times (s since the control
        step began), u the commands; times of the nodes (n_nodes, 1), and the rows there, (n_rows, n_nodes) by columns.
        Consecutive nodes of one time are of different integration steps, or of one that was not flown.
    """
    count = -(-_LOOKS // (step.wiring.minor_steps * step.substeps))
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
            flown, _, _ = step.fly(tick.t, x, waves, new, (begin, first))
            x = ca.if_else(first > begin, flown, x)
        if looking is step and any(wave.tau is not None for wave in waves):
            # a decay is projected on parabolas in each integration step, and right at its ends
            looking, look.count = copy.copy(step), 2
            looking.substeps = max(step.substeps, -(-_LOOKS // step.wiring.minor_steps))
        look.now = ca.fmin(
            ca.fmax(i * step.h, span[1]), span[2]
        )  # no time passes in minor steps that are not flown
        flown, _, _ = looking.fly(tick.t, x, waves, new, (first, last), look)
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
