r"""Second order on the solution's mesh: curvature of the Lagrangian along what the active limits leave free.

At a local minimum of the transcribed program with multipliers :math:`\lambda` (Nocedal & Wright, Numerical
Optimization, 2006, theorems 12.5 and 12.6)

.. math:: d^T \nabla^2 \mathcal L\, d \ge 0 \quad\text{for all } d \text{ in the critical cone}:
          \quad \nabla g_C\, d = 0, \quad d_P = 0,

rows C and variables P being those on their limits; > 0 for all of them but zero is sufficient. A limit whose
multiplier vanishes (weakly active) need only be kept from one side: the cone lies between the space where it binds
and the one where it does not. All variables take part: controls, free parameters, free times, every phase, links and
integrals.

The least curvature is that of variations of size 1,

.. math:: |d|^2 = \int \Big(\frac{\delta x}{x}\Big)^2 + \Big(\frac{\delta u}{u}\Big)^2
          + \text{squares of varied ends, times and parameters}

in shares of their magnitudes, in which the second variation of a regular problem is bounded below (Maurer &
Pickenhain, J. Optim. Theory Appl. 86(3), 1995). It is found by Lanczos' method on
:math:`(\nabla^2\mathcal L + \sigma)^{-1}`, restricted to the null space by one sparse factorisation (Golub & Van
Loan, Matrix Computations, 2013, sec. 10.3).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from gnc_opt.arrays import Array, Mask
from gnc_opt.solution.program_point import ProgramPoint, quadrature_weights, saddle_matrix
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.solution.solution import Solution
from gnc_opt.tolerances import AT_LIMIT, TINY
from gnc_opt.transcription.transcription import Transcription
from gnc_opt.verify.critical_cone import CriticalCone
from gnc_opt.verify.verdict import Condition, Result

UPWARDS, DOWNWARDS = 1e-6, 1e-4
"""Curvature, in shares of the Hessian's mean row, from which it is told from none: upwards above what is left of
first-order errors, downwards below what a singular arc leaves on a mesh, whose curvature vanishes with the mesh."""

CANCELLED = 1e-6
"""Curvature that is less than this share of its own terms is what they leave when they cancel."""

SHIFT = 0.1
"""The shift, in shares of the Hessian's mean row: large beside curvatures that are as good as none."""

STEPS = 80
"""Steps of Lanczos' method; the ends of the spectrum of a compact operator settle in far fewer."""

SLACK, REFINEMENTS = 1e-12, 2
"""Of the rows, scaled to unit gradients, so that dependent ones do no harm, and the steps of iterative refinement by
which the others are kept all the same."""

FOUND = 1e-6
"""Inverse curvatures below this, beside that of the shift, are rounding: nothing is left to vary there."""

STEP = 0.1
"""Step, in shares of the magnitudes, for which the gain is told."""


@dataclass(frozen=True, eq=False)
class Curvature:
    """The least curvature of the Lagrangian on a linear space of variations.

    Attributes
    ----------
    value : float
        In shares of the mean of the Hessian's diagonal; NaN if nothing is left to vary.
    share : float
        In shares of the terms that add up to it.
    direction : array (n_variables,)
        Scaled, its largest component 1.
    gain : float
        What a step of `STEP` along it takes from the minimised cost, physical.
    """

    value: float
    share: float
    direction: Array
    gain: float

    @property
    def sign(self) -> int:
        """1 if positive, -1 if negative, 0 if too small to tell."""
        if abs(self.share) <= CANCELLED:
            return 0
        return int(self.value > UPWARDS) - int(self.value < -DOWNWARDS)


def reduced_hessian(solution: Solution, samples: list[PhaseSamples]) -> Condition:
    """No variation that keeps the active limits lowers the cost to second order."""
    name = "second order"
    meaning = (
        "Along every variation of controls, times and parameters that keeps what is active, the cost must curve "
        "upwards (value: least curvature of the Lagrangian on the solution's mesh with the sign reversed, in shares "
        "of its mean row); where it curves downwards, a cheaper trajectory is nearby."
    )

    def judged(result: Result, value: float, where: str, tolerance: float = -UPWARDS) -> Condition:
        return Condition(name, result, value, tolerance, where, meaning, sufficient=True)

    cone = CriticalCone.of(ProgramPoint.of(solution))
    free = least_curvature(cone.point, cone.strong)
    jumping = "" if solution.structure else _jumping_control(samples)
    if np.isnan(free.value) or free.sign > 0:
        told = Result.CANNOT_TELL if jumping else Result.PASS
        if np.isnan(free.value):
            return judged(
                told, 0.0, jumping or "as many conditions as unknowns, nothing is left to vary", 0.0
            )
        return judged(told, -free.value, jumping or _place(cone.point, solution, free.direction))
    # Where weakly active limits bind as well, less is left to vary; what is downwards there is so in the cone.
    bound = least_curvature(cone.point, cone.strong | cone.weak) if np.any(cone.weak) else free
    for found in (free, bound):
        admitted = (cone.admits(sign * found.direction, samples) for sign in (1.0, -1.0))
        if found.sign < 0 and any(admitted):
            gain = f": a step of {100 * STEP:.0f} % of its magnitude gains {found.gain:.3g} in the cost"
            place = _place(cone.point, solution, found.direction)
            return judged(Result.FAIL, -found.value, place + gain)
    return judged(
        Result.CANNOT_TELL, -free.value, _place(cone.point, solution, free.direction) + _doubt(free)
    )


def _doubt(curvature: Curvature) -> str:
    if curvature.sign < 0:
        return ": limits that are only just active, or the values between the nodes, may forbid to go there"
    return f": flat (what is between -{DOWNWARDS:.0e} and {UPWARDS:.0e} is not told from zero)"


def _jumping_control(samples: list[PhaseSamples]) -> str:
    """Name a control that reaches both bounds without H curving in it: its switch times vary, and the mesh is fixed."""
    for s in samples:
        lower, upper = s.leg.control_bounds.near(s.u, AT_LIMIT * s.control_scale)
        straight = np.einsum("iij->ij", s.control_hessian) * s.control_scale[:, None] ** 2 <= (
            AT_LIMIT * s.hamiltonian_scale
        )
        jumps = np.any(lower & straight, axis=1) & np.any(upper & straight, axis=1)
        if np.any(jumps):
            label = s.leg.controls.labels[int(np.argmax(jumps))]
            return f"phase {s.leg.name}, {label}: switch times that are not variables of the mesh do not vary"
    return ""


def _place(point: ProgramPoint, solution: Solution, direction: Array) -> str:
    """Return where along time a direction is largest."""
    size = np.abs(direction)
    for name, part in point.transcription.parts.items():
        leg, places = solution.phases[name], part.collocation.point_controls
        if places.size and np.max(size[places]) >= np.max(size):
            i, j = np.unravel_index(np.argmax(size[places]), places.shape)
            return f"phase {name}, t = {leg.point_times[j]:.6g} s, {leg.controls.labels[i]}"
    return point.variables.labels[int(np.argmax(size))]


def least_curvature(point: ProgramPoint, held: Mask) -> Curvature:
    """Return the least curvature of the Lagrangian where some variables and rows do not vary.

    Parameters
    ----------
    point : ProgramPoint
    held : bool array (n_variables + n_constraints,)
    """
    free, rows = np.flatnonzero(~held[: point.x.size]), np.flatnonzero(held[point.x.size :])
    root = 1 / np.sqrt(_metric(point.transcription)[free])
    unit = scipy.sparse.diags_array(root)
    hessian = scipy.sparse.csc_array(unit @ point.hessian[free][:, free] @ unit)
    jacobian = scipy.sparse.csc_array(point.jacobian[rows][:, free] @ unit)
    sizes = np.sqrt(np.asarray((hessian**2).sum(axis=1)))
    typical = float(np.mean(sizes)) if np.any(sizes > 0) else 1.0
    direction = _least_direction(hessian / typical, jacobian)
    if direction is None:
        return Curvature(float("nan"), float("nan"), np.zeros(point.x.size), 0.0)
    curvature = float(direction @ (hessian @ direction))
    terms = float(np.abs(direction) @ (abs(hessian) @ np.abs(direction)))
    whole = np.zeros(point.x.size)
    whole[free] = root * direction
    largest = float(np.max(np.abs(whole)))
    gain = -0.5 * curvature * (STEP / largest) ** 2 / point.scaling.objective
    return Curvature(curvature / typical, curvature / max(terms, TINY), whole / largest, gain)


def _metric(transcription: Transcription) -> Array:
    """Weights of the squares of scaled variables in the size of a variation (n_variables,)."""
    weights, _ = quadrature_weights(transcription)
    for part in transcription.parts.values():
        collocation = part.collocation
        # States at inner boundaries follow from the points; together they count once.
        weights[collocation.boundary_states[:, 1:-1]] = 1.0 / collocation.mesh.segments
    return weights


def _least_direction(hessian: Any, jacobian: Any) -> Array | None:
    """Return the direction of least curvature (unit length) in the null space of the Jacobian, or None if that is 0.

    Parameters
    ----------
    hessian : sparse (n, n)
        With rows of about unit length.
    jacobian : sparse (n_rows, n)
    """
    n, rows = hessian.shape[0], jacobian.shape[0]
    if n == 0:
        return None
    norms = np.sqrt(np.asarray((jacobian**2).sum(axis=1)))
    unit = scipy.sparse.diags_array(1 / np.where(norms > 0, norms, 1.0)) @ jacobian
    matrix = saddle_matrix(hessian + SHIFT * scipy.sparse.eye_array(n), unit)
    slack = scipy.sparse.diags_array(np.where(np.arange(n + rows) < n, 0.0, SLACK))
    factors = scipy.sparse.linalg.splu(scipy.sparse.csc_array(matrix - slack))

    def inverse(vector: Array) -> Array:
        right = np.concatenate([vector, np.zeros(rows)])
        solved = factors.solve(right)
        for _ in range(REFINEMENTS):
            solved = solved + factors.solve(right - matrix @ solved)
        return np.asarray(solved[:n])

    start = inverse(np.random.default_rng(0).standard_normal(n))
    values, vectors = lanczos(inverse, start, STEPS)
    if not values.size or np.max(np.abs(values)) * SHIFT < FOUND:
        return None
    # 1 / (curvature + shift): below -shift it is negative, and above it is largest where the curvature is least.
    found = values < -FOUND * np.max(np.abs(values))
    chosen = vectors[:, np.argmin(values)] if np.any(found) else vectors[:, np.argmax(values)]
    direction = inverse(chosen)
    return np.asarray(direction / np.linalg.norm(direction))


def lanczos(operate: Callable[[Array], Array], start: Array, steps: int) -> tuple[Array, Array]:
    """Return approximate eigenvalues (k,) and eigenvectors (n, k) of a symmetric operator.

    With full reorthogonalisation; ends early where the Krylov space does.

    Parameters
    ----------
    operate : function of a vector (n,)
    start : array (n,)
    steps : int
    """
    size = float(np.linalg.norm(start))
    if not size > 0:
        return np.zeros(0), np.zeros((start.size, 0))
    basis, diagonal, beside = [start / size], [], []
    for _ in range(min(steps, start.size)):
        image = operate(basis[-1])
        diagonal.append(float(basis[-1] @ image))
        space = np.array(basis)
        for _ in range(2):
            image = image - space.T @ (space @ image)
        length = float(np.linalg.norm(image))
        if length <= FOUND * max(map(abs, diagonal)):
            break
        beside.append(length)
        basis.append(image / length)
    n = len(diagonal)
    values, vectors = scipy.linalg.eigh_tridiagonal(diagonal, beside[: n - 1])
    return values, np.array(basis[:n]).T @ vectors
