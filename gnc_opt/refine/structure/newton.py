r"""Newton's method on switch times.

With every control on a bound, the problem has finitely many unknowns: the switch times, the ends of the phase and the
multipliers of the end conditions. Flow, Jacobian and Hessian come from explicit integration (`bang_bang_flow`), so one
iteration costs as much as a few propagations, where a solve of the collocated problem takes a factorisation of all
its points. The result is a structure to start from: pieces that vanish are dropped, arcs that the switching functions
ask for are added, and the collocated problem, whose solution is what counts, is then solved near its optimum.

A step minimises the quadratic model of the Lagrangian on the linearised end conditions, with multipliers of least
squares; where the model is not convex, its negative curvatures are reversed (Nocedal & Wright, Numerical
Optimization, 2006, ch. 3.4, 18.3).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.arrays import Array, Indices
from gnc_opt.problem.arc import ArcKind
from gnc_opt.problem.functions import end_function
from gnc_opt.problem.problem import Problem
from gnc_opt.refine.structure.phase_structure import PhaseStructure, choose
from gnc_opt.solution.polynomial import PiecewisePolynomial
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.solution.solution import Solution
from gnc_opt.tolerances import AT_LIMIT, RANK, TINY
from gnc_opt.transcription.mesh import Mesh
from gnc_opt.verify.bang_bang_flow import BangBangFlow, bang_bang_flow
from gnc_opt.verify.induced import end_derivatives
from gnc_opt.verify.switches import Switches

MOST_STEPS = 40
"""Newton steps of all structures together."""

SETTLED = 1e-7
"""Step, in shares of the phase, below which switch times have settled; the collocated problem does the rest."""

REFINEMENTS = (2, 4, 8)
"""Of the grid, where the flow itself is the answer."""

MOST_POLISHING = 4
"""Steps on each of these grids."""

SPENT = 0.1
"""Share of the accuracy that a last step on a grid may be worth."""

FOURTH_ORDER = 15
"""How many times its own error a grid of half the steps is off by against it."""

NEAR = 1e-4
"""Step, in shares of the phase, from which on finer grids are worth their price."""

SHRUNK = 0.8
"""Share of its length that an arc may lose in one step."""

LONGEST = 0.04
"""Share of the phase that a switch may move in one step."""

LEAST_SHARE = 0.2
"""Of a step that must be left after `SHRUNK`; if less is, the arc that stands in the way has vanished."""

WRONG_SIGN = 1e-6
"""Switching function of the wrong sign, in shares of the largest, that asks for another arc."""

INSET = 0.25
"""Share of an interval of the wrong sign that a new arc leaves at each side, to keep away from other switches."""


def settle(solution: Solution, structure: PhaseStructure) -> tuple[PhaseStructure, Solution] | None:
    """Find optimal switch times; drop and add arcs as needed.

    Parameters
    ----------
    solution : Solution
        Of one phase.
    structure : PhaseStructure
        To start from.

    Returns
    -------
    (PhaseStructure, Solution) or None
        The structure, and the flown trajectory with its costates as a guess for the collocated problem; None where
        the method does not fit, or does not settle.
    """
    problem, s = solution.need_problem("refine"), next(iter(solution.samples().values()))
    if not _fits(problem, s, structure):
        return None
    found = _optimum(problem, s, _switches(s, structure), SETTLED)
    if found is None:
        return None
    switches, step = found
    return _structure(structure, s, switches), _guess(solution, s, switches, step)


def settle_flow(
    solution: Solution, structure: PhaseStructure, accuracy: float
) -> tuple[PhaseStructure, Solution] | None:
    """Find the least cost to some accuracy, without any collocated problem.

    The flow is integrated on finer grids until its own error, told from two grids (Richardson; fourth order), is
    below the accuracy. Near an optimum the cost depends on the switch times in second order, so these are told to the
    root of it.

    Parameters
    ----------
    solution : Solution
        Of one phase.
    structure : PhaseStructure
        To start from.
    accuracy : float
        Of the cost, relative to its size; its root is that of the switch times, in shares of the phase.

    Returns
    -------
    (PhaseStructure, Solution) or None
        The structure; the flown trajectory with its costates and multipliers, on the grid of its integration; its
        objective is that of the given solution, and limits between the ends are not looked at. None where the method
        does not fit, or does not settle.
    """
    problem, s = solution.need_problem("solve"), next(iter(solution.samples().values()))
    found = _optimum(problem, s, _switches(s, structure), NEAR) if _fits(problem, s, structure) else None
    if found is None:
        return None
    switches, step = found
    for refinement in REFINEMENTS:
        off = None
        for _ in range(MOST_POLISHING):
            switches = _moved(switches, step.change)
            # Near the optimum curvatures change little, and from grid to grid by the grid's error.
            following = _newton_step(problem, s, switches, refinement, step.hessian)
            if following is None or np.any(np.diff(switches.pieces(_order(switches)).times) < 0):
                return None
            step = following
            away = max(step.gain / accuracy, step.share(switches) / math.sqrt(accuracy))
            off = away if off is None else off
            if away < SPENT:
                break
        else:
            return None
        if off < FOURTH_ORDER:
            if _completed(s, switches, step) is not None:
                return None
            return _structure(structure, s, switches), _guess(solution, s, switches, step)
    return None


def _optimum(
    problem: Problem, s: PhaseSamples, switches: Switches, settled: float
) -> tuple[Switches, _Step] | None:
    """Return switches that have settled with signs that agree, and the step that is left there."""
    for _ in range(MOST_STEPS):
        step = _newton_step(problem, s, switches)
        if step is None:
            return None
        share, emptied = _allowed(switches, step)
        if emptied and share < LEAST_SHARE:
            switches = _without(switches, emptied)
            continue
        if step.share(switches) < settled:
            completed = _completed(s, switches, step)
            if completed is None:
                return switches, step
            switches = completed
        else:
            switches = _moved(switches, share * step.change)
    return None


def _fits(problem: Problem, s: PhaseSamples, structure: PhaseStructure) -> bool:
    """Whether everything is decided by switch times and end times, and all conditions are equalities."""
    leg = s.leg
    times = np.array([[leg.initial_time], [leg.final_time], [leg.duration]])
    loose = ~leg.final_bounds.fixed & (
        np.isfinite(leg.final_bounds.lower) | np.isfinite(leg.final_bounds.upper)
    )
    at_end = leg.final_bounds.near(s.x[:, -1], AT_LIMIT * s.state_scale) if np.any(loose) else (loose, loose)
    boxes = (leg.initial_time_bounds, leg.final_time_bounds, leg.duration_bounds)
    sided = [np.logical_or(*at_end) & loose]
    sided += [
        np.logical_or(*b.near(t, AT_LIMIT * s.span)) & ~b.fixed for b, t in zip(boxes, times, strict=True)
    ]
    return (
        len(problem.phases) == 1
        and s.functions.q.size == 0
        and all(kind.at_limit for row in structure.controls for kind in row)
        and not any(kind.at_limit for row in (*structure.paths, *structure.states) for kind in row)
        and not any(structure.touches)
        and bool(np.all(leg.initial_bounds.fixed))
        and bool(np.all(problem.constraint_interval().fixed))
        and not any(np.any(side) for side in sided)
    )


# --- one step -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Step:
    """A Newton step in (start, switches, end), and the flow and multipliers that it comes from.

    Its gain is by how much it changes the cost, to first order and relative to the cost's size. The Hessian is the
    Lagrangian's in the free unknowns.
    """

    change: Array
    hessian: Array
    flow: BangBangFlow
    adjoint: Array
    multipliers: Array
    gain: float

    def share(self, switches: Switches) -> float:
        """Its largest entry, as a share of the phase."""
        return float(np.max(np.abs(self.change)) / (switches.ends[1] - switches.ends[0]))


def _newton_step(
    problem: Problem, s: PhaseSamples, switches: Switches, refinement: int = 1, hessian: Array | None = None
) -> _Step | None:
    """Return the step, or None where the flow is no number or conditions depend on each other.

    Parameters
    ----------
    problem, s, switches
    refinement : int
        Of the grid.
    hessian : array, optional
        That of an earlier step to use again.
    """
    leg, size = s.leg, s.leg.states.size + s.leg.integrals.size + 1
    flow = bang_bang_flow(problem, s, switches.pieces(_order(switches)), np.zeros(0, dtype=int), refinement)
    if not np.isfinite(flow.final_sensitivity).all():
        return None
    changes = np.vstack([flow.initial_sensitivity[:size], flow.final_sensitivity[:size]])
    numbers = (flow.initial[:size], flow.final[:size], s.functions.p, s.functions.q)
    derivatives = problem.once("end derivatives", lambda: end_derivatives(problem))
    limits, wanted = problem.constraint_interval(), np.flatnonzero(leg.final_bounds.fixed)
    slope, jacobian, _ = (v.full() for v in derivatives(*numbers, np.zeros(limits.lower.size)))
    free = np.concatenate(
        [~leg.initial_time_bounds.fixed, np.ones(switches.times.size, bool), ~leg.final_time_bounds.fixed]
    )
    rows = np.vstack([flow.final_sensitivity[wanted], jacobian @ changes])[:, free]
    cost, constraints = _end_values(s, problem, flow)
    misses = np.concatenate([flow.final[wanted] - leg.final_bounds.lower[wanted], constraints - limits.lower])
    if not _independent(rows):
        return None  # Their multipliers would run away in the collocated problem.
    gradient = (slope[:, 0] @ changes)[free]
    multipliers = np.linalg.lstsq(rows.T, -gradient, rcond=RANK)[0]
    on_states, nu = np.split(multipliers, [wanted.size])
    slope, _, curvature = (v.full() for v in derivatives(*numbers, nu))
    adjoint = np.zeros(flow.final.size)
    adjoint[:size] = slope[size:, 0]
    adjoint[wanted] += on_states
    if hessian is None:
        hessian = (flow.curvature(adjoint) + changes.T @ curvature @ changes)[np.ix_(free, free)]
    change = np.zeros(free.size)
    change[free] = _model_minimum(hessian, gradient, rows, misses)
    gain = abs(float(gradient @ change[free])) / max(abs(cost), TINY)
    return _Step(change, hessian, flow, adjoint, nu, gain)


def _independent(rows: Array) -> bool:
    """Whether gradients of conditions are linearly independent, in whatever units the conditions are."""
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    return bool(np.all(sizes > 0) and np.linalg.matrix_rank(rows / sizes, RANK) == rows.shape[0])


def _model_minimum(hessian: Array, gradient: Array, rows: Array, misses: Array) -> Array:
    """Return the step to the minimum of a quadratic model on linear conditions, its negative curvatures reversed."""
    back = np.linalg.lstsq(rows, -misses, rcond=RANK)[0]
    null = np.linalg.qr(rows.T, mode="complete")[0][:, rows.shape[0] :]
    if not null.shape[1]:
        return np.asarray(back)
    curvatures, directions = np.linalg.eigh(null.T @ hessian @ null)
    least = RANK * np.max(np.abs(curvatures))
    slopes = directions.T @ (null.T @ (gradient + hessian @ back))
    return np.asarray(back - null @ (directions @ (slopes / np.maximum(np.abs(curvatures), least))))


def _end_values(s: PhaseSamples, problem: Problem, flow: BangBangFlow) -> tuple[float, Array]:
    """Cost and boundary constraints at the ends of the flow."""
    n, n_integrals = s.leg.states.size, s.leg.integrals.size
    start, final, clock = flow.initial[:n], flow.final[:n], n + n_integrals
    nothing = np.zeros(problem.constraint_interval().lower.size)
    times = (flow.initial[clock], flow.final[clock])
    integrals = flow.final[n:clock]
    found = end_function(problem)(start, final, *times, integrals, s.functions.p, s.functions.q, nothing)
    return float(found[0]), np.asarray(found[1].full()[:, 0])


# --- switches -------------------------------------------------------------------------------------------


def _switches(s: PhaseSamples, structure: PhaseStructure) -> Switches:
    """One switch for every control that changes between two pieces."""
    bounds = s.leg.control_bounds
    found = [(t, i) for k, t in enumerate(structure.times[1:-1], 1) for i in structure.changes(k)]
    first = np.where(structure.controls[:, 0] == ArcKind.UPPER, bounds.upper, bounds.lower)
    times, channels = (np.array([f[k] for f in found], dtype=kind) for k, kind in ((0, float), (1, int)))
    ends = np.array([structure.times[0], structure.times[-1]])
    return Switches(times, channels, first, ends, bounds.lower + bounds.upper, ())


def _structure(old: PhaseStructure, s: PhaseSamples, switches: Switches) -> PhaseStructure:
    """The switches as pieces."""
    pieces = switches.pieces(_order(switches))
    at_upper = pieces.controls == s.leg.control_bounds.upper[:, None]
    kinds = choose(at_upper, ArcKind.UPPER, ArcKind.LOWER)
    others = np.full((len(old.regular) - kinds.shape[0], kinds.shape[1]), ArcKind.INTERIOR)
    columns = np.vstack([kinds, others]).T
    times, kept = [], []
    for t, column, length in zip(pieces.times, columns, np.diff(pieces.times), strict=False):
        if length > 0:
            times.append(float(t))
            kept.append(tuple(column))
    return replace(old, times=(*times, float(pieces.times[-1])), kinds=tuple(kept), touches=()).merged()


def _order(switches: Switches) -> tuple[int, ...]:
    return tuple(int(k) for k in np.argsort(switches.times, kind="stable"))


def _arcs(switches: Switches) -> list[tuple[int, int]]:
    """Unknowns (0 start, 1 to n switches, n + 1 end) at both ends of every arc of every control."""
    found: list[tuple[int, int]] = []
    for i in range(switches.first.size):
        own = np.flatnonzero(switches.channels == i)
        own = own[np.argsort(switches.times[own], kind="stable")]
        places = [0, *(int(k) + 1 for k in own), switches.times.size + 1]
        found += itertools.pairwise(places)
    return found


def _allowed(switches: Switches, step: _Step) -> tuple[float, tuple[int, int] | None]:
    """The share of a step that leaves every arc some length, and the arc that limits it."""
    times = np.concatenate([switches.ends[:1], switches.times, switches.ends[1:]])
    longest = LONGEST * (switches.ends[1] - switches.ends[0])
    share, limiting = min(1.0, longest / max(float(np.max(np.abs(step.change))), TINY)), None
    for begin, end in _arcs(switches):
        shrinks = step.change[begin] - step.change[end]
        room = SHRUNK * (times[end] - times[begin])
        if shrinks > 0 and room < share * shrinks:
            share, limiting = room / shrinks, (begin, end)
    return share, limiting


def _moved(switches: Switches, change: Array) -> Switches:
    times = switches.times + change[1:-1]
    return replace(switches, times=times, ends=switches.ends + change[[0, -1]])


def _without(switches: Switches, arc: tuple[int, int]) -> Switches:
    """Drop the switches at the ends of an arc that has vanished."""
    begin, end = arc
    first = switches.first.copy()
    gone = [k - 1 for k in (begin, end) if 0 < k <= switches.times.size]
    if begin == 0 and gone:
        i = switches.channels[gone[0]]
        first[i] = switches.toggled[i] - first[i]
    times, channels = np.delete(switches.times, gone), np.delete(switches.channels, gone)
    return replace(switches, times=times, channels=channels, first=first)


# --- as a guess -----------------------------------------------------------------------------------------


def _guess(solution: Solution, s: PhaseSamples, switches: Switches, step: _Step) -> Solution:
    """The flow as a solution on the grid of its integration: cubics through states, costates and their rates."""
    leg, n = s.leg, s.leg.states.size
    times, controls, x, lam = _along(s, switches, step)
    kept = np.flatnonzero(np.diff(times) > 0)
    breaks, controls = np.append(times[kept], times[-1]), controls[:, kept]
    mesh = Mesh(tuple((breaks - breaks[0]) / (breaks[-1] - breaks[0])), (1,) * kept.size)
    sides = []
    for at in (kept, kept + 1):
        nothing = np.zeros((len(leg.path_labels), kept.size))
        rates = s.functions.rates(times[at], x[:, at], controls)
        forces = -s.functions.state_gradient(times[at], x[:, at], controls, lam[:, at], nothing)
        sides.append((x[:, at], rates, lam[:, at], forces))
    (x0, v0, lam0, f0), (x1, v1, lam1, f1) = sides
    middle = (np.zeros(1),) * kept.size
    grown = replace(
        leg,
        mesh=mesh,
        initial_time=float(breaks[0]),
        final_time=float(breaks[-1]),
        x=_cubics(breaks, x0, v0, x1, v1),
        u=PiecewisePolynomial(breaks, middle, tuple(controls.T[:, :, None])),
        lam=_cubics(breaks, lam0, f0, lam1, f1),
        lam_start=lam0,
        lam_end=lam1,
        point_costates=0.5 * (lam0 + lam1),
        path_multipliers=np.zeros((len(leg.path_labels), kept.size)),
        state_multipliers=np.zeros((n, kept.size)),
        control_multipliers=np.zeros(controls.shape),
        state_impulses=np.zeros((n, kept.size + 1)),
        integrals=step.flow.final[n : n + leg.integrals.size],
    )
    return replace(solution, phases={leg.name: grown}, constraint_multipliers=step.multipliers)


def _cubics(
    breaks: Array, left: Array, left_rate: Array, right: Array, right_rate: Array
) -> PiecewisePolynomial:
    """Cubic polynomials by values (n, K) and rates at both ends of every segment."""
    nodes = np.array([-1.0, -1 / 3, 1 / 3, 1.0])
    share = 0.5 * (1 + nodes)
    width = np.diff(breaks)
    ends = (1 + 2 * share) * (1 - share) ** 2, share**2 * (3 - 2 * share)
    slopes = share * (1 - share) ** 2, -(share**2) * (1 - share)
    values = np.multiply.outer(left, ends[0]) + np.multiply.outer(right, ends[1])
    values += np.multiply.outer(left_rate * width, slopes[0]) + np.multiply.outer(
        right_rate * width, slopes[1]
    )
    return PiecewisePolynomial(breaks, (nodes,) * width.size, tuple(values.transpose(1, 0, 2)))


# --- arcs that are missing ------------------------------------------------------------------------------


def _completed(s: PhaseSamples, switches: Switches, step: _Step) -> Switches | None:
    """Switches with the arc that the worst sign of a switching function asks for, or None if all agree."""
    times, controls, x, lam = _along(s, switches, step)
    controls = np.column_stack([controls, controls[:, -1]])
    values = s.functions.switching(times, x, controls, lam)
    bounds = s.leg.control_bounds
    wrong = np.where(controls == bounds.upper[:, None], values, -values)
    wrong /= np.max(np.abs(values), axis=1, keepdims=True)
    for i in range(wrong.shape[0]):
        own = np.concatenate([[False], np.diff(controls[i]) != 0])
        _forgive(wrong[i], np.flatnonzero(own))
    i, j = (int(k) for k in np.unravel_index(int(np.argmax(wrong)), wrong.shape))
    if wrong[i, j] < WRONG_SIGN:
        return None
    return _with_arc(switches, i, *_interval(times, wrong[i], j))


def _along(s: PhaseSamples, switches: Switches, step: _Step) -> tuple[Array, Array, Array, Array]:
    """Times (n_steps + 1,), controls of every step, states and costates of a flow."""
    flow, n = step.flow, s.leg.states.size
    times, pieces = flow.states[n + s.leg.integrals.size], switches.pieces(_order(switches))
    middles = 0.5 * (times[1:] + times[:-1])
    places = np.clip(np.searchsorted(pieces.times, middles) - 1, 0, pieces.controls.shape[1] - 1)
    return times, pieces.controls[:, places], flow.states[:n], flow.adjoints(step.adjoint)[:n]


def _forgive(wrong: Array, switches: Indices) -> None:
    """Zero the offences that reach up to the control's own switches: it switches there, a little too late or early."""
    for k in switches:
        for side in (range(int(k), wrong.size), range(int(k) - 1, -1, -1)):
            for j in side:
                if wrong[j] <= 0:
                    break
                wrong[j] = 0.0


def _interval(times: Array, wrong: Array, j: int) -> tuple[float, float]:
    """Where the sign is wrong around a sample, by straight lines between the samples."""
    fine = np.flatnonzero(wrong <= 0)
    before, after = fine[fine < j], fine[fine > j]
    start, end = times[0], times[-1]
    if before.size:
        k = before[-1]
        start = times[k] - wrong[k] * (times[k + 1] - times[k]) / (wrong[k + 1] - wrong[k])
    if after.size:
        k = after[0]
        end = times[k] - wrong[k] * (times[k] - times[k - 1]) / (wrong[k] - wrong[k - 1])
    inset = INSET * (end - start)
    return float(start + inset * (before.size > 0)), float(end - inset * (after.size > 0))


def _with_arc(switches: Switches, i: int, start: float, end: float) -> Switches:
    first, added = switches.first.copy(), [t for t in (start, end) if switches.ends[0] < t < switches.ends[1]]
    if start <= switches.ends[0]:
        first[i] = switches.toggled[i] - first[i]
    times = np.concatenate([switches.times, added])
    channels = np.concatenate([switches.channels, np.full(len(added), i)])
    return replace(switches, times=times, channels=channels, first=first)
