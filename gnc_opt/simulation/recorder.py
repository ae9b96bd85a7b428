"""Recorder: what is kept of the quantities of runs, leg by leg as they are flown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.simulation.event import MOST
from gnc_opt.simulation.kernel import Kernel
from gnc_opt.simulation.outcome import Outcome, RunStatus
from gnc_opt.simulation.peaks import AT_ONCE, Intervals, Nodes, climb
from gnc_opt.simulation.quantity import Quantities, sample_steps
from gnc_opt.simulation.within import Columns
from gnc_opt.tolerances import SAME_TIME

AT_A_TIME = 100
"""Control steps that are looked at in one call."""


class Recorder:
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
    for k in range(int(min(told["number"][0, step], MOST))):
        instant = float(np.clip(told["times"][k, step] - t, begin, end))
        yield x, begin, instant
        x, begin = told["after"][:, step].reshape(MOST, x.size)[k], instant
    yield x, begin, end
