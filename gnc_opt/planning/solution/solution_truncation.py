"""Remainder of a solution after a given time, which solves the remaining problem (principle of optimality)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.tolerances import SAME_TIME


def truncate_solution_before(solution: Solution, time: float) -> Solution:
    """Return the part of a one-phase solution after a given time, with the state at that time as initial state.

    Costates and multipliers are included; integrals, cost and bounds are those of the whole solution; arcs are omitted.

    Parameters
    ----------
    time : float
        Time, s, not before the start and before the end.
    """
    ((name, leg),) = solution.phases.items()
    return replace(solution, phases={name: _truncate_phase(leg, time)}, structure=())


def _truncate_phase(leg: PhaseSolution, time: float) -> PhaseSolution:
    slack = SAME_TIME * leg.duration
    first = int(np.searchsorted(leg.breaks[1:-1], time + slack, "right"))
    breaks = np.append(time, leg.breaks[first + 1 :])
    degrees = leg.mesh.degrees[first:]
    mesh = Mesh.at_times(breaks, degrees)
    fresh = replace(
        leg,
        mesh=mesh,
        initial_time=time,
        x=_truncate_signal(leg.x, first, breaks),
        u=_truncate_signal(leg.u, first, breaks),
        lam=_truncate_signal(leg.lam, first, breaks),
    )
    lam_start, impulses = leg.lam_start[:, first:].copy(), leg.state_impulses[:, first:].copy()
    lam_start[:, 0] = leg.lam(time)
    impulses[:, 0] = -lam_start[:, 0]  # fixed initial state: L = J + multiplier (x - x0), dJ/dx0 = lam
    return replace(
        fresh,
        lam_start=lam_start,
        lam_end=leg.lam_end[:, first:],
        point_costates=fresh.sample_at_collocation_points(leg.lam),
        path_multipliers=fresh.sample_at_collocation_points(leg.path_multiplier),
        state_multipliers=fresh.sample_at_collocation_points(leg.state_multiplier),
        control_multipliers=fresh.sample_at_collocation_points(leg.control_multiplier),
        state_impulses=impulses,
    )


def _truncate_signal(signal: PiecewisePolynomial, first: int, breaks: Array) -> PiecewisePolynomial:
    """Return the segments from ``first`` on, with the first one starting at the first break: the same polynomials."""
    left, right = signal.breaks[first], signal.breaks[first + 1]
    nodes = signal.nodes[first]
    places = breaks[0] + 0.5 * (breaks[1] - breaks[0]) * (1 + nodes)
    own = PiecewisePolynomial(np.array([left, right]), (nodes,), (signal.values[first],))
    values = (own(np.clip(places, left, right)), *signal.values[first + 1 :])
    return PiecewisePolynomial(breaks, signal.nodes[first:], values)
