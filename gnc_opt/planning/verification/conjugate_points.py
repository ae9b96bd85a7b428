r"""Conjugate points: the second order of smooth arcs in continuous time, without collocation.

Where :math:`H_{uu} > 0` in the controls that are off their bounds, variations of an extremal satisfy a linear
Hamiltonian system in (X, :math:`\Lambda`), the accessory equations (`gnc_opt.planning.optimality.accessory`).

From X = 0 at the start of a phase, a time at which X is singular is conjugate to it: a variation that vanishes at both
costs nothing to second order, and past it less than nothing (Jacobi's condition; Bryson & Ho, Applied Optimal
Control, 1975, sec. 6.3; Zeidan & Zezza, SIAM J. Control Optim. 26(3), 1988). The condition is necessary, whatever
the ends, times and parameters are; with fixed ends and times it is what suffices too.

Where states are free at an end, X spans them there and Lambda follows from transversality (focal points); the system is
then followed from either end. The frame (X, Lambda) is carried orthonormal, so that it passes escape times of the
Riccati equation :math:`S = \Lambda X^{-1}` unharmed. Then :math:`M = X + i\Lambda` is unitary, :math:`M M^T` depends on
the Lagrangian plane alone, and its eigenvalues pass -1, all in one direction, exactly where X is singular: what has
passed is counted by the argument of the determinant (Arnold, Funct. Anal. Appl. 1(1), 1967).

Where no variation of the controls moves :math:`y^T X`, as in a minimum time, whose costates have
:math:`\lambda^T X = 0`, or along the norm of a quaternion, (0, y) solves the system and X is singular at all times.
That says nothing: what is judged is the plane beside all such (0, y), a Lagrangian one in :math:`y^\perp`.
"""

from __future__ import annotations

import functools
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.arrays import Array, Mask
from gnc_opt.planning.optimality.accessory import AccessoryEquations, fine_times, on_free
from gnc_opt.planning.problem.functions import end_function
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.propagation import state_magnitudes
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.verdict import Condition, ConditionResult
from gnc_opt.tolerances import AT_LIMIT, CONVEX, RANK, TINY

START, END = 0, 1

CONJUGATE_STEPS_PER_PHASE, CONJUGATE_MIN_STEPS_PER_SEGMENT = 300, 4
"""Steps over a phase, and at least so many in every segment."""

CONTROLLABILITY_MIN_ANGLE = 1e-10
"""Angle from which a direction counts as reached by the controls."""

UNREACHABLE, REACHABLE = 1e-10, 1e-8
"""Mean square of the cosine to what controls move, below and above which a direction never is, or is, moved by them."""

AGREED = 1e-2
"""Share of a phase within which conjugate times by different steps agree."""

CONJUGATE_END_TOLERANCE = 1e-6
"""Share of a phase: a conjugate time this close to the other end is told from it by rounding only."""

CONTROLLABILITY_SHARE_OF_PHASE = 0.2
"""Share of a phase within which the controls must reach all directions."""


def conjugate_points(solution: Solution, samples: list[PhaseSamples]) -> list[Condition]:
    """No time of a smooth phase is conjugate to one of its ends; nothing where no phase can be judged so."""
    problem = solution.need_problem("verify")
    found = [
        (s, end, time)
        for s in samples
        if _is_smooth(problem, s)
        for end, time in _conjugate_times(solution, s)
        if time is not None
    ]
    if not found:
        return []
    early = [item for item in found if np.isfinite(item[2])]
    where = f"none along {', '.join(dict.fromkeys(f'phase {s.leg.name}' for s, _, _ in found))}"
    value, result = 0.0, ConditionResult.PASS
    if early:
        s, end, time = max(early, key=_beyond)
        where = (
            f"phase {s.leg.name}, t = {time:.6g} s is conjugate to its {'start' if end == START else 'end'}"
        )
        value = _beyond((s, end, time))
        result = ConditionResult.FAIL if value > CONJUGATE_END_TOLERANCE else ConditionResult.INCONCLUSIVE
    return [
        Condition(
            "conjugate points",
            result,
            value,
            0.0,
            where,
            "No time may be conjugate to an end of a smooth phase (value: share of the phase that lies beyond the "
            "first one): past it, a variation that vanishes there lowers the cost (Jacobi's condition).",
            sufficient=True,
        )
    ]


def _beyond(found: tuple[PhaseSamples, int, float]) -> float:
    """The share of the phase that lies beyond a conjugate time."""
    s, end, time = found
    return abs((s.leg.initial_time if end == END else s.leg.final_time) - time) / s.leg.duration


def _end_frame(solution: Solution, s: PhaseSamples, end: int) -> Array:
    """Variations of states and costates that an end admits, (2n, n), the costates' sign as time runs away from it.

    States vary where neither their limits nor a boundary constraint hold them, everything else at the ends staying as
    it is; their costates follow from transversality.
    """
    problem, leg = solution.need_problem("verify"), s.leg
    arguments = [
        value
        for other in solution.phases.values()
        for value in (
            *(other.x(other.breaks[0]), other.x(other.breaks[-1], "left")),
            *(other.initial_time, other.final_time, other.integrals, other.parameters),
        )
    ]
    derivatives = problem.once(("end", leg.name, end), lambda: _end_derivatives(problem, leg.name, end))
    rows, curvature = (
        v.full() for v in derivatives(*arguments, solution.parameter_values, solution.constraint_multipliers)
    )
    values = s.x[:, 0 if end == START else -1]
    held = np.zeros(values.size, dtype=bool)
    for box in (leg.initial_bounds if end == START else leg.final_bounds, leg.state_bounds):
        held |= np.any(box.near(values, AT_LIMIT * s.state_scale), axis=0)
    size = state_magnitudes(leg)
    kept = np.vstack([np.eye(values.size)[held], rows * size])
    free = scipy.linalg.null_space(kept, rcond=RANK) if kept.size else np.eye(values.size)
    scaled = curvature * size[:, None] * size / _worth(s)
    return np.block(
        [
            [free, np.zeros((values.size, values.size - free.shape[1]))],
            [-scaled @ free, scipy.linalg.null_space(free.T) if free.shape[1] else np.eye(values.size)],
        ]
    )


def _end_derivatives(problem: Problem, phase: str, end: int) -> Any:
    """Jacobian of the boundary constraints and Hessian of their Lagrangian by the states at an end of a phase."""
    function, k = end_function(problem), list(problem.phases).index(phase)
    inputs = [ca.SX.sym("v", function.size1_in(i)) for i in range(function.n_in())]
    _, constraints, *gradients = function(*inputs)
    states = inputs[6 * k + end]
    by_states = [ca.jacobian(e, states) for e in (constraints, gradients[5 * k + end])]
    return ca.Function("end", inputs, [ca.densify(e) for e in by_states])


def _is_smooth(problem: Problem, s: PhaseSamples) -> bool:
    """Whether controls are free, H is strictly convex in them, no other limit is active, and integrals only add."""
    leg = s.leg
    if not leg.controls.size or not s.has_length or not _only_adds(problem, leg.name):
        return False
    paths = s.functions.paths(s.times, s.x, s.u)
    inner = slice(1, -1)
    for values, box, scale in (
        (s.x, leg.state_bounds, s.state_scale),
        (paths, leg.path_bounds, s.path_scale),
    ):
        at_lower, at_upper = box.near(values, AT_LIMIT * scale)
        if np.any(at_lower[:, inner] | at_upper[:, inner]):
            return False
    scaled = s.control_hessian * s.control_scale[:, None, None] * s.control_scale[None, :, None]
    free = _free(s, s.u)
    curvature = on_free(scaled.transpose(2, 0, 1) / s.hamiltonian_scale, free)
    return bool(np.any(free) and np.all(np.linalg.eigvalsh(curvature) > CONVEX))


def _only_adds(problem: Problem, phase: str) -> bool:
    """Whether the integrals of a phase enter the cost linearly, and no constraint."""
    symbols = problem.phases[phase].integral_symbols()
    slope = ca.jacobian(problem.cost, symbols)
    constrained = ca.jacobian(problem.constraint_expression(), symbols).nnz() > 0
    return not constrained and not ca.depends_on(slope, _end_symbols(problem))


def _end_symbols(problem: Problem) -> Any:
    ends = [
        symbols
        for leg in problem.phases.values()
        for symbols in (
            leg.ends("initial"), leg.ends("final"), leg.initial_time, leg.final_time, leg.integral_symbols()
        )
    ]  # fmt: skip
    return ca.vertcat(*ends, problem.parameter_symbols())


def _free(s: PhaseSamples, u: Array) -> Mask:
    """Which controls are off their bounds (n_times, n_controls)."""
    lower, upper = s.leg.control_bounds.near(u, AT_LIMIT * s.control_scale)
    return np.asarray(~(lower | upper)).T


def _conjugate_times(solution: Solution, s: PhaseSamples) -> list[tuple[int, float | None]]:
    """The first time conjugate to each end: infinite if there is none, None if that cannot be told."""
    system = functools.cache(
        lambda steps: _system(s, fine_times(s.leg, steps, CONJUGATE_MIN_STEPS_PER_SEGMENT))
    )

    def first(frame: Array, end: int) -> float | None:
        found = _first_crossing(s, system(CONJUGATE_STEPS_PER_PHASE), frame, end)
        if found is None or np.isinf(found):
            return found
        again = _first_crossing(s, system(2 * CONJUGATE_STEPS_PER_PHASE), frame, end)
        return again if again is not None and abs(again - found) <= AGREED * s.leg.duration else None

    frames = [_end_frame(solution, s, end) for end in (START, END)]
    # With fixed states at the end it is the same as from the start.
    ends = [START, END] if np.any(frames[END][: s.leg.states.size]) else [START]
    return [(end, first(frames[end], end)) for end in ends]


def _first_crossing(s: PhaseSamples, system: tuple[Array, Array], frame: Array, end: int) -> float | None:
    """The first conjugate time by a system's flow; None if controls do not reach all directions early enough."""
    times, onwards = system
    with np.errstate(all="ignore"):
        try:
            mirror = np.repeat([1.0, -1.0], s.leg.states.size)
            back = (mirror[:, None] * np.linalg.inv(onwards) * mirror)[::-1]
            flows, others = (onwards, back) if end == START else (back, onwards)
            times = times if end == START else times[::-1]
            never = _never_moved(others)
            if never is None:
                return None
            angles = _angles(frame, _in_plane(never, frame), flows)
        except np.linalg.LinAlgError:  # H_uu is singular between the samples, or a number is not finite
            return None
    if not angles.shape[1]:
        return None
    reached = np.flatnonzero(
        np.min(np.minimum(angles, 2 * np.pi - angles), axis=1) > CONTROLLABILITY_MIN_ANGLE
    )
    if (
        not reached.size
        or abs(times[reached[0]] - times[0]) > CONTROLLABILITY_SHARE_OF_PHASE * s.leg.duration
    ):
        return None
    angles, times = angles[reached[0] :], times[reached[0] :]
    total = np.sum(angles, axis=1)
    passed = np.round((np.unwrap(total) - total) / (2 * np.pi))
    late = np.flatnonzero(passed > 0)
    if not late.size:
        return float("inf")
    k = int(late[0])
    before, after = 2 * np.pi - np.max(angles[k - 1]), float(np.min(angles[k]))
    return float(times[k - 1] + (times[k] - times[k - 1]) * before / (before + after))


def _never_moved(flows: Array) -> Array | None:
    """Directions y (n, k), where a flow ends, that controls never move (orthonormal); None if that cannot be told.

    y obeys the adjoint equation; how much of it the controls have moved, a quadratic form of y, goes along with it.
    """
    n = flows.shape[1] // 2
    basis, moved, triangle = np.eye(n), np.zeros((n, n)), np.triu(np.ones((n, n)))
    for flow, size in zip(flows, np.linalg.norm(flows[:, :n, n:], axis=(1, 2)), strict=True):
        by_control = flow[:n, n:] @ basis
        if size > 0:
            moved = moved + by_control.T @ by_control / size**2
        basis, growth = _orthonormalised(flow[n:, n:] @ basis)
        shrunk = _inverse(growth * triangle)
        moved = shrunk.T @ moved @ shrunk
        # What has been moved enough need not grow beyond rounding of the rest.
        if not moved.trace() <= len(flows):
            shares, vectors = np.linalg.eigh(moved)
            moved = (vectors * np.clip(shares, 0.0, len(flows))) @ vectors.T
    if not np.all(np.isfinite(moved)):
        return None
    shares, vectors = np.linalg.eigh(moved / len(flows))
    if np.any((shares > UNREACHABLE) & (shares < REACHABLE)):
        return None
    return np.asarray(basis @ vectors[:, shares <= UNREACHABLE])


def _in_plane(directions: Array, frame: Array) -> Array:
    """Combinations y of directions for which (0, y) belongs to the plane of an end's frame."""
    across, cosines, _ = np.linalg.svd(directions.T @ frame[: directions.shape[0]])
    return np.asarray(directions @ across[:, int(np.sum(cosines > np.sqrt(UNREACHABLE))) :])


def _angles(frame: Array, never: Array, flows: Array) -> Array:
    """Angles of the eigenvalues of M M^T from -1, in [0, 2 pi), after each step (n_times, n - k).

    Parameters
    ----------
    frame : array (2n, n)
    never : array (n, k)
        Directions y with (0, y) in the plane that controls never move: -1 is an eigenvalue for each, at all times.
    flows : array (n_times - 1, 2n, 2n)
    """
    n, k = never.shape
    frames, beside = np.empty((len(flows), 2 * n, n)), np.tile(np.eye(n)[:, k:], (len(flows), 1, 1))
    image = np.zeros((n, n))  # of its columns of zeros QR makes what is missing in an orthonormal basis
    for j, flow in enumerate(flows):
        frames[j] = frame = _orthonormalised(flow @ frame)[0]
        if k:
            image[:, :k] = flow[n:, n:] @ never
            completed = _orthonormalised(image)[0]
            beside[j], never = completed[:, k:], completed[:, :k]
    unitary = frames[:, :n] + 1j * frames[:, n:]
    product = beside.transpose(0, 2, 1) @ unitary @ unitary.transpose(0, 2, 1) @ beside
    angles = np.zeros((len(flows) + 1, n - k))
    angles[1:] = np.angle(-np.linalg.eigvals(product)) % (2 * np.pi)
    return angles


def _orthonormalised(matrix: Array) -> tuple[Array, Array]:
    """Q and R of a matrix with no more columns than rows, whose R has anything below its diagonal.

    By LAPACK itself: for small matrices, which come by the thousand, NumPy takes eight times as long around it.
    """
    factors, reflectors, _, _ = scipy.linalg.lapack.dgeqrf(matrix)
    return scipy.linalg.lapack.dorgqr(factors, reflectors)[0], factors


def _inverse(upper: Array) -> Array:
    """Inverse of an upper triangular matrix (n, n); not a number where it has none."""
    inverse, singular = scipy.linalg.lapack.dtrtri(upper)
    return np.full_like(upper, np.nan) if singular else np.asarray(inverse)


def _system(s: PhaseSamples, times: Array) -> tuple[Array, Array]:
    """Times (k + 1,), and the flow of the accessory equations over each step (k, 2n, 2n)."""
    equations = AccessoryEquations(s.leg, s.functions, s.control_scale)
    with np.errstate(all="ignore"):
        return times, equations.flows(times, _worth(s), lambda u: _free(s, u))


def _worth(s: PhaseSamples) -> float:
    """What costates are measured by: with H_uu of this over the duration, X and Lambda are of one size."""
    scaled = s.control_hessian * s.control_scale[:, None, None] * s.control_scale[None, :, None]
    return max(float(np.median(np.linalg.norm(scaled, axis=(0, 1)))) * s.span, TINY)
