"""Bounds of angles that leave out no direction: they limit nothing, but stop a solver on its way across them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.model.evaluation import evaluate
from gnc_opt.model.graph import operations_in
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.statement import Statement
from gnc_opt.problem.tables import along
from gnc_opt.problem.turns import ELSEWHERE, PERIODS, Turns, turned_back

P = TypeVar("P", bound=Statement)

SHORT = 1e-6
"""Share of a turn that bounds may lack: pi is often written with six digits."""

_DRAWS = 24

_TURNING = {ca.OP_SIN, ca.OP_COS, ca.OP_TAN, ca.OP_FMOD, ca.OP_REMAINDER}


def without_full_turns(problem: P) -> P:
    """Return a problem whose angles are free where their bounds leave out no direction; itself if it has none."""
    found = {
        name: turns for name, leg in problem.phases.items() if np.any((turns := _turns(problem, leg)).free)
    }
    if not found:
        return problem
    twin = problem.clone()
    for name, turns in found.items():
        leg = twin.phases[name]
        old, free = leg.numbers.controls, turns.free
        box = Interval(np.where(free, -np.inf, old.lower), np.where(free, np.inf, old.upper))
        leg.numbers = replace(leg.numbers, controls=box, turns=turns)
    return twin


def _turns(problem: Statement, leg: Phase) -> Turns:
    box = leg.numbers.controls
    room, none = box.upper - box.lower, np.zeros(box.lower.size)
    turns = Turns(none - np.inf, none + np.inf, none)
    bounded = np.isfinite(room) & (room > 0)
    if not np.any(bounded) or leg.numbers.arcs is not None:
        return turns
    if not _TURNING & problem.once(("operations", leg.name), lambda: operations_in(along(leg))):
        return turns
    drawn = _Drawn.of(problem, leg)
    for i in np.flatnonzero(bounded | np.isinf(room)):
        turns.periods[i] = drawn.period(int(i), float(room[i]))
    reach = 0.5 * turns.periods
    whole = bounded & (reach > 0) & (room >= 2.0 * (1.0 - SHORT) * reach)
    azimuths = np.flatnonzero(whole | (np.isinf(room) & (turns.periods > 0))).tolist()
    pairs: list[tuple[int, int]] = []
    for j in np.flatnonzero(bounded & ~whole & (turns.periods > 0)).tolist():
        mirrored = (i for i in azimuths if drawn.mirrored((i, j), turns.periods, box.upper[j]))
        azimuth = next(mirrored, None) if abs(room[j] - reach[j]) <= SHORT * reach[j] else None
        pairs += [] if azimuth is None else [(azimuth, j)]
    for i in [*np.flatnonzero(whole), *(j for _, j in pairs)]:
        half = max(reach[i], 0.5 * room[i]) if whole[i] else 0.5 * reach[i]
        middle = 0.5 * (box.lower[i] + box.upper[i])
        turns.lower[i], turns.upper[i] = middle - half, middle + half
    return replace(turns, pairs=tuple(pairs))


@dataclass(frozen=True)
class _Drawn:
    """All that varies along a phase, at random times, states, controls and free parameters."""

    function: Any
    at: tuple[Array, ...]

    @classmethod
    def of(cls, problem: Statement, leg: Phase) -> _Drawn:
        t, x, u, p = leg.model.arguments()
        q = problem.parameter_symbols()

        def build() -> Any:
            return ca.Function("along", [t, x, u, p, q], [ca.densify(problem.bind(leg, along(leg)))])

        rng = np.random.default_rng(20)
        at = [rng.uniform(-1.5, 1.5, (s.numel(), _DRAWS)) for s in (t, x, u, q)]
        function = problem.once(("along", leg.name), build)
        return cls(function, (at[0][0], at[1], at[2], leg.model.parameter_values, at[3]))

    def values(self, u: Array) -> Array:
        t, x, _, p, q = self.at
        return evaluate(self.function, t, x, u, p, q)

    def shifted(self, i: int, by: float) -> Array:
        u = self.at[2].copy()
        u[i] += by
        return u

    def period(self, i: int, room: float) -> float:
        """Return the period in a control: the room of its bounds, or one of `PERIODS`; 0 without."""
        here = self.values(self.at[2])
        if not np.all(np.any(np.isfinite(here), axis=1)):
            return 0.0
        for period in (*PERIODS, *([room] if np.isfinite(room) else [])):
            turned, elsewhere = (self.values(self.shifted(i, by)) for by in (period, ELSEWHERE * period))
            if turned_back(here, turned, elsewhere):
                return period
        return 0.0

    def mirrored(self, pair: tuple[int, int], periods: Array, upper: float) -> bool:
        """Whether the second angle on the other side of an end, and half a turn of the first, are the same."""
        i, j = pair
        away = self.shifted(i, 0.5 * periods[i])
        other = away.copy()
        other[j] = 2.0 * upper - other[j]
        return turned_back(self.values(self.at[2]), self.values(other), self.values(away))
