"""Merge neighbours and lower degrees where a smaller mesh represents the same trajectory.

A trial segment interpolates rates and controls at its points, integrates them and is checked by the errors of
the solution. Dynamic programming picks the cheapest accurate segments.
"""

from __future__ import annotations

import bisect
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TypeAlias

import numpy as np

from gnc_opt.arrays import Array, Indices, Mask
from gnc_opt.planning.refinement.costate_error import costate_rates, costate_worth, unconstrained
from gnc_opt.planning.refinement.error import ErrorScales, PhaseError, SampledPieces
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.samples import sampled_places
from gnc_opt.planning.transcription.quadrature import collocation_rule, interpolation_matrix
from gnc_opt.planning.transcription.scheme import Scheme

LADDER = (2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 18, 20, 24)
"""Degrees that are tried."""

MERGED_SEGMENTS_MAX = 8
"""At most so many neighbours are merged in one pass."""

STEEPEST = 0.05
"""Largest dH/du of trials, in shares of H and of the tolerance's root (it affects cost in second order)."""

SEGMENT_COST = 1.0
"""What a segment costs beyond its points, in points: its start state."""

Span: TypeAlias = tuple[int, int]
"""The first segment of a merger, and the one after its last."""


@dataclass(frozen=True)
class Piece:
    """A segment of a mesh to be: its ends as times (s) and its degree."""

    start: float
    end: float
    degree: int


def coarsened(
    error: PhaseError, run: Sequence[Piece], tol: float, max_degree: int, departure: float
) -> list[Piece]:
    """Return the cheapest pieces on the given boundaries whose trial errors stay below ``tol``.

    All are tried together: what a trial costs is mostly the call.

    Parameters
    ----------
    error : PhaseError
    run : sequence of Piece
        Segments in which the trajectory is known accurately, in order; there may be others between them.
    tol : float
    max_degree : int
    departure : float
        How far the states of a trial may be from the known ones, relative to their magnitude.
    """
    cost = [0.0]
    chosen: list[tuple[int, int]] = []
    degrees = _smallest_degrees(error, run, tol, max_degree, departure)
    for j in range(1, len(run) + 1):
        options = [
            (cost[i] + degrees[i, j] + SEGMENT_COST, i)
            for i in range(max(0, j - MERGED_SEGMENTS_MAX), j)
            if (i, j) in degrees
        ]
        best, i = min(options)
        cost.append(best)
        chosen.append((i, degrees[i, j]))
    pieces, j = [], len(run)
    while j > 0:
        i, degree = chosen[j - 1]
        pieces.append(Piece(run[i].start, run[j - 1].end, degree))
        j = i
    return pieces[::-1]


def _smallest_degrees(
    error: PhaseError, run: Sequence[Piece], tol: float, max_degree: int, departure: float
) -> dict[Span, int]:
    """Return the smallest sufficient degree of each merger (first, last + 1) that saves points."""
    found = {(i, i + 1): piece.degree for i, piece in enumerate(run)}
    left: dict[Span, tuple[int, int]] = {}  # places in the ladder where the smallest degree can be
    for i, j in _mergeable(error, run, tol, max_degree, departure):
        now = sum(p.degree for p in run[i:j]) + (j - i - 1)
        most = now - 1 if j == i + 1 else min(now, max_degree)
        left[i, j] = (0, bisect.bisect_right(LADDER, most))
    first = True
    while left := {span: ends for span, ends in left.items() if ends[0] < ends[1]}:
        tried = {span: high - 1 if first else (low + high) // 2 for span, (low, high) in left.items()}
        trials = [Piece(run[i].start, run[j - 1].end, LADDER[place]) for (i, j), place in tried.items()]
        good = _acceptable(error, trials, tol, departure)
        for (span, place), trial, fine in zip(tried.items(), trials, good, strict=True):
            low, high = left[span]
            left[span] = (low, place) if fine else (place + 1, high)
            if fine:
                found[span] = trial.degree
        first = False
    return found


def _mergeable(
    error: PhaseError, run: Sequence[Piece], tol: float, max_degree: int, departure: float
) -> list[Span]:
    """Return the spans whose states one segment of the highest degree can represent."""
    spans = [(i, i + 1) for i in range(len(run))]
    shorter = set(spans)
    beside = [a.end == b.start for a, b in itertools.pairwise(run)]
    for length in range(2, MERGED_SEGMENTS_MAX + 1):
        ends = [(i, i + length) for i in range(len(run) - length + 1)]
        hopeful = [(i, j) for i, j in ends if beside[i] and {(i, j - 1), (i + 1, j)} <= shorter]
        probes = [Piece(run[i].start, run[j - 1].end, max_degree) for i, j in hopeful]
        shorter = set(itertools.compress(hopeful, _acceptable(error, probes, tol, departure)))
        spans += sorted(shorter)
    return spans


def _acceptable(error: PhaseError, trials: Sequence[Piece], tol: float, departure: float) -> Mask:
    """Return which trials are as good as the known trajectory, (n_trials,)."""
    if not trials:
        return np.zeros(0, dtype=bool)
    errors, departures, slopes = trial_errors(error, trials)
    return np.asarray((errors <= tol) & (departures <= departure) & (slopes <= STEEPEST * np.sqrt(tol)))


def trial_errors(error: PhaseError, trials: Sequence[Piece]) -> tuple[Array, Array, Array]:
    """Return error, departure of the states and dH/du of each trial, (n_trials,) each."""
    yardstick, places = error.yardstick, _Places.of(error.samples.leg, trials)
    known = _Known.of(error.samples.leg, places)
    pieces = _trial_pieces(yardstick, places, known)
    points = places.points.size
    departures = np.abs(pieces.x - known.x[:, points:]) / yardstick.state[:, None]
    slopes = pieces.largest(yardstick.stationarity(pieces, known.lam[:, points:]))
    against = (
        yardstick.evaluate(pieces, _adjoint(error, places, known)).worst,
        np.max(pieces.largest(departures), axis=0),
        np.max(slopes, axis=0, initial=0.0),
    )
    first, second, third = (values[places.ranks] for values in against)
    return first, second, third


@dataclass(frozen=True, eq=False)
class _Places:
    """Collocation points and samples of trials, grouped by degree; ``ranks`` gives the original order."""

    alike: tuple[tuple[_Tables, Array], ...]
    starts: Array
    points: Array
    times: Array
    ranks: Indices

    @classmethod
    def of(cls, leg: PhaseSolution, trials: Sequence[Piece]) -> _Places:
        degrees = np.array([t.degree for t in trials])
        order = np.argsort(degrees, kind="stable")
        starts, ends = (
            np.array(values)[order] for values in zip(*((t.start, t.end) for t in trials), strict=True)
        )
        found, counts = np.unique(degrees, return_counts=True)
        alike, points, times, offset = [], [], [], 0
        for degree, count in zip(found, counts, strict=True):
            here = slice(offset, offset + int(count))
            table, offset = _tables(leg.scheme, int(degree)), here.stop
            first, half = starts[here, None], 0.5 * (ends[here, None] - starts[here, None])
            alike.append((table, half[:, 0]))
            points.append((first + half * (1 + table.points)).ravel())
            times.append((first + half * (1 + table.tau)).ravel())
        return cls(tuple(alike), starts, np.concatenate(points), np.concatenate(times), np.argsort(order))

    def groups(self, values: Array) -> Iterator[tuple[_Tables, Array, Array]]:
        """Yield table, halves of the widths and values (n, n_alike, degree) at the points of each degree."""
        offset = 0
        for table, halves in self.alike:
            shape = halves.size, table.points.size
            here = values[:, offset : offset + shape[0] * shape[1]]
            yield table, halves, here.reshape(len(values), *shape)
            offset += here.shape[1]

    def interpolated(self, values: Array) -> Array:
        """Carry values at the points (n, n_points) to the samples, (n, n_times)."""
        return np.hstack([_flat(here @ table.interpolate) for table, _, here in self.groups(values)])


@dataclass(frozen=True, eq=False)
class _Known:
    """The trajectory at the trials' points and, after these, at their samples: states, controls, costates."""

    times: Array
    x: Array
    u: Array
    lam: Array

    @classmethod
    def of(cls, leg: PhaseSolution, places: _Places) -> _Known:
        times = np.concatenate([places.points, places.times])
        return cls(times, leg.x(times), leg.u(times), leg.lam(times))


def _adjoint(error: PhaseError, places: _Places, known: _Known) -> Array:
    """Return the residual of the costates' equation at the trials' samples, (n_states, n_samples)."""
    samples, leg, points = error.samples, error.samples.leg, places.points.size
    flown = np.clip(known.u, leg.control_bounds.lower[:, None], leg.control_bounds.upper[:, None])
    rates = costate_rates(samples, known.times, known.x, flown, known.lam)
    segments = np.clip(np.searchsorted(leg.breaks, places.times, "right") - 1, 0, leg.mesh.segments - 1)
    counts = unconstrained(samples, error.yardstick.pure_paths)[segments]
    gaps = places.interpolated(rates[:, :points]) - rates[:, points:]
    return np.where(counts, np.abs(gaps) * costate_worth(samples)[:, None], 0.0)


def _trial_pieces(yardstick: ErrorScales, places: _Places, known: _Known) -> SampledPieces:
    """Return what collocation would make of the known trajectory on each trial segment."""
    leg, functions, count = yardstick.leg, yardstick.functions, places.points.size
    at = places.points, known.x[:, :count], known.u[:, :count]
    rates, integrands = functions.rates(*at), functions.integrands(*at)
    moved = [_flat(halves[:, None] * (here @ t.integrate)) for t, halves, here in places.groups(rates)]
    integrals = [halves * (here @ t.collocate) for t, halves, here in places.groups(integrands)]
    sizes = np.concatenate([np.full(halves.size, t.tau.size) for t, halves in places.alike])
    return SampledPieces(
        places.times,
        np.concatenate([np.outer(halves, t.weights).ravel() for t, halves in places.alike]),
        np.concatenate([[0], np.cumsum(sizes[:-1])]).astype(np.int64),
        np.repeat(leg.x(places.starts), sizes, axis=1) + np.hstack(moved),
        places.interpolated(rates),
        places.interpolated(at[2]),
        np.hstack(integrals),
    )


def _flat(values: Array) -> Array:
    """Samples (n, n_trials, n_each) behind each other."""
    return values.reshape(values.shape[0], values.shape[1] * values.shape[2])


@dataclass(frozen=True, eq=False)
class _Tables:
    """A trial of one degree on [-1, 1]: its points and their weights, where it is sampled, and how values get there."""

    points: Array
    collocate: Array
    tau: Array
    weights: Array
    interpolate: Array
    integrate: Array


@cache
def _tables(scheme: Scheme, degree: int) -> _Tables:
    rule, (tau, weights) = collocation_rule(scheme, degree), sampled_places(degree)
    interpolate, integrate = interpolation_matrix(rule.points, tau).T, rule.integrate_to(tau).T
    return _Tables(rule.points, rule.weights, tau, weights, interpolate, integrate)
