r"""Conjugate points: the second order of smooth arcs in continuous time, without collocation.

Where :math:`H_{uu} > 0` in the controls that are off their bounds, variations of an extremal satisfy the linear
Hamiltonian system

.. math:: \dot X = (f_x - f_u H_{uu}^{-1} H_{ux}) X - f_u H_{uu}^{-1} f_u^T \Lambda, \qquad
          \dot \Lambda = -(H_{xx} - H_{xu} H_{uu}^{-1} H_{ux}) X - (f_x - f_u H_{uu}^{-1} H_{ux})^T \Lambda.

From X = 0 at the start of a phase, a time at which X is singular is conjugate to it: a variation that vanishes before
and after costs nothing to second order, and past it less than nothing (Jacobi's condition; Bryson & Ho, Applied Optimal
Control, 1975, sec. 6.3; Zeidan & Zezza, SIAM J. Control Optim. 26(3), 1988). The condition is necessary, whatever
the ends, times and parameters are; with fixed ends and times it is what suffices too.

The frame (X, Lambda) is carried orthonormal, so that it passes escape times of the Riccati equation
:math:`S = \Lambda X^{-1}` unharmed. Then :math:`M = X + i\Lambda` is unitary, :math:`M M^T` depends on the Lagrangian
plane alone, and its eigenvalues pass -1, all in one direction, exactly where X is singular: what has passed is
counted by the argument of the determinant (Arnold, Funct. Anal. Appl. 1(1), 1967).
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.arrays import Array, Mask
from gnc_opt.model.evaluation import evaluate
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.propagation import state_magnitudes
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.tolerances import AT_LIMIT
from gnc_opt.verify.verdict import Condition, Result

STEPS, LEAST = 300, 4
"""Steps over a phase, and at least so many in every segment."""

CONVEX = 1e-6
"""Curvature of H in free controls, in shares of H, from which it is strictly convex."""

REACHED = 1e-10
"""Angle from which a direction counts as reached by the controls."""

AGREED = 1e-2
"""Share of a phase within which conjugate times by different steps agree."""

EARLY = 0.2
"""Share of a phase within which the controls must reach all directions."""


def conjugate_points(problem: Problem, samples: list[PhaseSamples]) -> list[Condition]:
    """No time of a smooth phase is conjugate to its start; nothing where no phase can be judged so."""
    judged = [(s, _first_conjugate(problem, s)) for s in samples if _is_smooth(problem, s)]
    found = [(s, time) for s, time in judged if time is not None]
    if not found:
        return []
    early = [(s, time) for s, time in found if np.isfinite(time)]
    where = f"none along {', '.join(f'phase {s.leg.name}' for s, _ in found)}"
    value = 0.0
    if early:
        s, time = early[0]
        where = f"phase {s.leg.name}, t = {time:.6g} s is conjugate to its start"
        value = (s.leg.final_time - time) / s.leg.duration
    return [
        Condition(
            "conjugate points",
            Result.FAIL if early else Result.PASS,
            value,
            0.0,
            where,
            "No time may be conjugate to the start of a smooth phase (value: share of the phase that lies beyond the "
            "first one): past it, a variation that leaves both ends alone lowers the cost (Jacobi's condition).",
            sufficient=True,
        )
    ]


def _is_smooth(problem: Problem, s: PhaseSamples) -> bool:
    """Whether no state or path constraint is active, H is strictly convex in free controls, and integrals only add."""
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
    curvature = _on_free(scaled.transpose(2, 0, 1) / s.hamiltonian_scale, _free(s, s.u))
    return bool(np.all(np.linalg.eigvalsh(curvature) > CONVEX))


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


def _on_free(hessians: Array, free: Mask) -> Array:
    """Hessians (n_times, m, m) on the free controls, the identity on the others."""
    both = free[:, :, None] & free[:, None, :]
    return np.where(both, hessians, np.eye(free.shape[1]))


def _first_conjugate(problem: Problem, s: PhaseSamples) -> float | None:
    """The first time conjugate to the start, infinite if there is none, None if that cannot be told."""
    found = _first_crossing(problem, s, STEPS)
    if found is None or np.isinf(found):
        return found
    again = _first_crossing(problem, s, 2 * STEPS)
    return again if again is not None and abs(again - found) <= AGREED * s.leg.duration else None


def _first_crossing(problem: Problem, s: PhaseSamples, steps: int) -> float | None:
    """The same by so many steps; None if the controls do not reach all directions early enough."""
    times = _times(s, steps)
    with np.errstate(all="ignore"):
        try:
            angles = _angles(s, times, _system(problem, s, times))
        except np.linalg.LinAlgError:  # H_uu is singular between the samples, or a number is not finite
            return None
    reached = np.flatnonzero(np.min(np.minimum(angles, 2 * np.pi - angles), axis=1) > REACHED)
    if not reached.size or times[reached[0]] > s.leg.initial_time + EARLY * s.leg.duration:
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


def _times(s: PhaseSamples, steps: int) -> Array:
    pieces = []
    for left, right in zip(s.leg.breaks[:-1], s.leg.breaks[1:], strict=True):
        count = LEAST + int(steps * (right - left) / s.leg.duration)
        pieces.append(np.linspace(left, right, count + 1)[:-1])
    return np.append(np.concatenate(pieces), s.leg.breaks[-1])


def _angles(s: PhaseSamples, times: Array, flows: Array) -> Array:
    """Angles of the eigenvalues of M M^T from -1, in [0, 2 pi), after each step (n_times, n)."""
    n = s.leg.states.size
    frame = np.vstack([np.zeros((n, n)), np.eye(n)])
    angles = np.zeros((times.size, n))
    for k, flow in enumerate(flows):
        frame = np.linalg.qr(flow @ frame)[0]
        unitary = frame[:n] + 1j * frame[n:]
        angles[k + 1] = np.angle(-np.linalg.eigvals(unitary @ unitary.T)) % (2 * np.pi)
    return angles


def _system(problem: Problem, s: PhaseSamples, times: Array) -> Array:
    """The flow of the linear Hamiltonian system over each step, states in shares of their magnitudes (k, 2n, 2n).

    By Magnus' expansion of fourth order, which keeps it symplectic (Iserles et al., Acta Numerica 9, 2000).
    """
    width, middle = np.diff(times), 0.5 * (times[:-1] + times[1:])
    first, second = (_matrices(problem, s, middle + sign * width / np.sqrt(12)) for sign in (-1.0, 1.0))
    h = width[:, None, None]
    exponent = 0.5 * h * (first + second) + np.sqrt(3) / 12 * h**2 * (second @ first - first @ second)
    return np.asarray(scipy.linalg.expm(exponent))


def _matrices(problem: Problem, s: PhaseSamples, times: Array) -> Array:
    leg, n = s.leg, s.leg.states.size
    x, u, lam = leg.x(times), leg.flown(times), leg.lam(times)
    function = problem.once(("variations", leg.name), lambda: _variations(s))
    hessian, jacobian = function
    numbers = (s.functions.weights, s.functions.p, s.functions.q)
    # Coordinates, not yardsticks: a state that rests may be varied as any other.
    states = state_magnitudes(s.leg)
    size = np.concatenate([states, s.control_scale])
    second = evaluate(hessian, times, x, u, lam, *numbers).reshape(size.size, size.size, -1)
    slope = evaluate(jacobian, times, x, u, lam, *numbers).reshape(n, size.size, -1)
    second = (second * size[:, None, None] * size[None, :, None] / _worth(s)).transpose(2, 0, 1)
    slope = (slope / states[:, None, None] * size[None, :, None]).transpose(2, 0, 1)
    free = _free(s, u)
    by_u = np.where(free[:, None, :], slope[:, :, n:], 0.0)
    mixed = np.where(free[:, :, None], second[:, n:, :n], 0.0)
    solved = np.linalg.solve(
        _on_free(second[:, n:, n:], free), np.concatenate([mixed, by_u.transpose(0, 2, 1)], axis=2)
    )
    own = slope[:, :, :n] - by_u @ solved[:, :, :n]
    upper = np.concatenate([own, -by_u @ solved[:, :, n:]], axis=2)
    feedback = second[:, :n, :n] - mixed.transpose(0, 2, 1) @ solved[:, :, :n]
    return np.concatenate([upper, np.concatenate([-feedback, -own.transpose(0, 2, 1)], axis=2)], axis=1)


def _worth(s: PhaseSamples) -> float:
    """What costates are measured by: with H_uu of this over the duration, X and Lambda are of one size."""
    scaled = s.control_hessian * s.control_scale[:, None, None] * s.control_scale[None, :, None]
    return float(np.median(np.linalg.norm(scaled, axis=(0, 1)))) * s.span


def _variations(s: PhaseSamples) -> tuple[Any, Any]:
    """Hessian of H and Jacobian of the dynamics by states and controls, of (t, x, u, lam, weights, p, q)."""
    functions = s.functions.functions
    t, x, u, lam, mu, weights, p, q = (ca.SX.sym("v", functions["hamiltonian"].size1_in(i)) for i in range(8))
    none = ca.SX.zeros(mu.shape[0])
    varied = ca.vertcat(x, u)
    hessian = ca.hessian(functions["hamiltonian"](t, x, u, lam, none, weights, p, q), varied)[0]
    jacobian = ca.jacobian(functions["rates"](t, x, u, lam, none, weights, p, q), varied)
    inputs = [t, x, u, lam, weights, p, q]
    by_time = [ca.Function("variations", inputs, [ca.densify(ca.vec(e.T))]) for e in (hessian, jacobian)]
    return by_time[0], by_time[1]
