"""Collocation degree of pieces with a known trajectory, from the tails of its Legendre series."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.polynomial import legendre

from gnc_opt.array_types import Array
from gnc_opt.planning.refinement.arcs.arc_mesh import ARC_MAX_DEGREE, ARC_MAX_SEGMENTS, ArcMesh, PieceMesh
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.quadrature import build_gauss_rule
from gnc_opt.tolerances import INNER_TOLERANCE_SHARE

PIECE_MIN_POINTS = 4
"""Least number of collocation points of a segment."""

N_TERMS = ARC_MAX_DEGREE + 4
"""Number of terms of the series."""

HALVING_GAIN_RATIO = 0.1
"""Largest ratio of remainders after and before a useful halving of a segment."""


def choose_arc_mesh_degrees(plan: ArcMesh, s: PhaseSamples, flown: Solution, tol: float) -> ArcMesh:
    """Return the plan with the numbers of collocation points that an integrated trajectory requires.

    Parameters
    ----------
    plan : ArcMesh
        Plan in which every control is on a bound at all times.
    s : PhaseSamples
        Samples of a nearby solution, whose magnitudes of states and costates are the references.
    flown : Solution
        Integrated trajectory of one phase.
    tol : float
        On the defects between the nodes, relative to those magnitudes.
    """
    left = _build_legendre_remainder_function(s, flown)
    times = np.asarray(plan.structure.times)
    at_once = left(times)
    found = [
        _choose_segments_and_degree(left, row, times[k], times[k + 1], INNER_TOLERANCE_SHARE * tol)
        for k, row in enumerate(at_once)
    ]
    return replace(plan, resolutions=tuple(found))


def _choose_segments_and_degree(
    left: Callable[[Array], Array], whole: Array, start: float, end: float, most: float
) -> PieceMesh:
    """Return the fewest sufficiently fine segments with at most `ARC_MAX_DEGREE` points, and their degree."""
    found = _bisect_interval_by_remainder(left, whole, (start, end), most, ARC_MAX_SEGMENTS)
    fine = np.flatnonzero(np.max([row for _, row in found], axis=0)[PIECE_MIN_POINTS:ARC_MAX_DEGREE] <= most)
    degree = PIECE_MIN_POINTS + int(fine[0]) if fine.size else ARC_MAX_DEGREE
    edges = tuple((t - start) / (end - start) for t, _ in found[:-1])
    return PieceMesh(len(found), degree, edges=edges)


def _bisect_interval_by_remainder(
    left: Callable[[Array], Array], row: Array, ends: tuple[float, float], most: float, room: int
) -> list[tuple[float, Array]]:
    """Return segment ends and remainders of an interval; segments with large remainders are halved."""
    start, end = ends
    if row[ARC_MAX_DEGREE] <= most or room == 1:
        return [(end, row)]
    middle = 0.5 * (start + end)
    halves = left(np.array([start, middle, end]))
    if (
        not np.max(halves[:, ARC_MAX_DEGREE]) < HALVING_GAIN_RATIO * row[ARC_MAX_DEGREE]
    ):  # the rest is the integration error
        return [(end, row)]
    first = _bisect_interval_by_remainder(left, halves[0], (start, middle), most, room // 2)
    return first + _bisect_interval_by_remainder(left, halves[1], (middle, end), most, room // 2)


def _build_legendre_remainder_function(s: PhaseSamples, flown: Solution) -> Callable[[Array], Array]:
    """Return a function for the remainders of slopes in segments with n = 0, 1, ... points (n_segments, N_TERMS)."""
    (leg,) = flown.phases.values()
    rule = build_gauss_rule(N_TERMS)
    series = np.linalg.inv(legendre.legvander(rule.points, N_TERMS - 1))

    def compute_legendre_remainders(breaks: Array) -> Array:
        lengths = np.diff(breaks)
        t = (breaks[:-1, None] + 0.5 * lengths[:, None] * (1 + rule.points)).ravel()
        x, u, lam = leg.x(t), leg.u(t), leg.lam(t)
        free = np.zeros((len(leg.path_labels), t.size))
        slopes = np.vstack(
            [
                s.functions.rates(t, x, u) / s.state_scale[:, None],
                s.functions.state_gradient(t, x, u, lam, free) * (s.state_scale / s.cost_scale)[:, None],
            ]
        )
        terms = np.abs(slopes.reshape(slopes.shape[0], lengths.size, N_TERMS) @ series.T)
        amounts = np.max(terms, axis=0) * lengths[:, None]
        return np.asarray(np.cumsum(amounts[:, ::-1], axis=1)[:, ::-1])

    return compute_legendre_remainders
