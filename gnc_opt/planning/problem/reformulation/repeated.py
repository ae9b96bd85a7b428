"""Path limits that repeat bounds: of a limit that is stated twice, only the sum of both multipliers is told."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TypeAlias, TypeVar

import casadi as ca
import numpy as np

from gnc_opt.planning.problem.constraints import Constraint
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.problem.interval_arithmetic import drawn, is_affine
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.statement import Statement
from gnc_opt.tolerances import ROUNDING

P = TypeVar("P", bound=Statement)

Line: TypeAlias = tuple[int, int, float, float]
"""A row that is an affine function of one state or control: the row, its place among both, slope and offset."""


def without_repeated(problem: P) -> P:
    """Return a problem whose path limits are free where bounds keep them already, and only there; itself if it is one.

    Of a problem that this was done to before, for other bounds, declared limits come back.
    """
    freed = {name: _freed(problem, leg) for name, leg in problem.phases.items()}
    if not any(freed.values()):
        return problem
    twin = problem.clone()
    for name, constraints in freed.items():
        twin.phases[name].paths |= constraints
    key = tuple(
        (name, label, np.isfinite(c.interval.lower).tobytes(), np.isfinite(c.interval.upper).tobytes())
        for name, own in freed.items()
        for label, c in own.items()
    )
    twin.builds = problem.builds.setdefault(("without repeated limits", *key), {})
    return twin


def _freed(problem: Statement, leg: Phase) -> dict[str, Constraint]:
    lines = problem.once(("lines", leg.name), lambda: _lines_of(leg))
    states, controls = leg.numbers.states, leg.numbers.controls
    least = np.concatenate([states.lower, controls.lower])
    most = np.concatenate([states.upper, controls.upper])
    changed = {}
    for name, own in lines.items():
        old = leg.paths[name]
        box = old.declared or old.interval
        lower, upper = box.lower.copy(), box.upper.copy()
        for i, place, slope, offset in own:
            if box.fixed[i]:
                continue
            low, high = sorted((offset + slope * least[place], offset + slope * most[place]))
            lower[i] = -np.inf if low >= lower[i] - ROUNDING * abs(lower[i]) else lower[i]
            upper[i] = np.inf if high <= upper[i] + ROUNDING * abs(upper[i]) else upper[i]
        if not (np.array_equal(lower, old.interval.lower) and np.array_equal(upper, old.interval.upper)):
            changed[name] = replace(old, interval=Interval(lower, upper), declared=box)
    return changed


def _lines_of(leg: Phase) -> dict[str, list[Line]]:
    model = leg.model
    symbols = ca.vertsplit(ca.vertcat(model.symbols("state"), model.symbols("control")))
    places = {symbol.element_hash(): k for k, symbol in enumerate(symbols)}
    found = {name: list(_lines(c, places)) for name, c in leg.paths.items()}
    return {name: lines for name, lines in found.items() if lines}


def _lines(constraint: Constraint, places: dict[int, int]) -> Iterator[Line]:
    for i, row in enumerate(ca.vertsplit(constraint.expression)):
        own = ca.symvar(row)
        place = places.get(own[0].element_hash()) if len(own) == 1 else None
        if place is not None and is_affine(row, own[0]):
            column = ca.vertcat(ca.jacobian(row, own[0]), ca.substitute(row, own[0], 0.0))
            slope, offset = drawn(column)[:, 0]
            yield i, place, float(slope), float(offset)
