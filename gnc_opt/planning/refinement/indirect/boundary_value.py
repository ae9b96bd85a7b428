"""Newton's method on a collocated boundary-value problem, and the mesh that resolves its solution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.polynomial import legendre

from gnc_opt.arrays import Array
from gnc_opt.errors import GncOptError
from gnc_opt.planning.problem.magnitudes import phase_magnitudes
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.phase_solution import PhaseSolution, piecewise
from gnc_opt.planning.solution.polynomial import PiecewisePolynomial
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.quadrature import gauss_rule, interpolation_matrix
from gnc_opt.planning.transcription.scheme import GAUSS
from gnc_opt.planning.transcription.transcription import Transcription, transcribe
from gnc_opt.tolerances import BRANCH_ENDED

BOUNDARY_VALUE_MIN_DEGREE = 8
BOUNDARY_VALUE_DEGREE_STEP = 6
MOST_DEGREE = 32
"""Segments start with the first of these degrees, gain the second, and are halved beyond the third."""

MOST_SEGMENTS = 2000
MAX_STEPS = 40

DONE, NEWTON_STEP_TOLERANCE = 1e-14, 1e-9
"""Relative Newton step lengths at which the iteration ends, and from which steps are full."""

LEAST_DAMPING = 1e-3
"""Newton's method that would have to be damped further has failed."""

VARIABLE_MIN_SHARE_OF_SIZE = 1e-3
"""A state, costate or control counts at least this share of its typical magnitude (a costate, of the largest's)."""


@dataclass(frozen=True)
class Sizes:
    """Typical magnitudes in one phase, by which errors are measured: of (x, lambda), (2 n,), and u, (m,)."""

    y: Array
    u: Array

    @classmethod
    def of(cls, leg: PhaseSolution, stated: Phase) -> Sizes:
        """Take them from a solution; what is zero all along must not be measured by its rounding."""
        states, controls = phase_magnitudes(stated)
        x, lam, u = (np.max(np.abs(np.hstack(s.values)), axis=1) for s in (leg.x, leg.lam, leg.u))
        x, u = (
            np.maximum(x, VARIABLE_MIN_SHARE_OF_SIZE * states),
            np.maximum(u, VARIABLE_MIN_SHARE_OF_SIZE * controls),
        )
        worth = float(np.max(lam * x))
        lam = np.maximum(lam, VARIABLE_MIN_SHARE_OF_SIZE * worth / x) if worth > 0 else np.ones_like(x)
        return cls(np.concatenate([x, lam]), u)


@dataclass(frozen=True)
class BoundaryValueSolution:
    """A solution of the boundary-value problem on one mesh.

    Attributes
    ----------
    anchors : dict of array (2,)
        Initial and final time of each phase.
    y : dict of PiecewisePolynomial
        States and costates, by phase.
    u : dict of PiecewisePolynomial
    parameters : dict of array
        The parameters of the boundary-value problem.
    """

    anchors: dict[str, Array]
    y: dict[str, PiecewisePolynomial]
    u: dict[str, PiecewisePolynomial]
    parameters: dict[str, Array]
    iterations: int


def solve_boundary_values(
    bvp: Problem,
    meshes: dict[str, Mesh],
    start: Solution | BoundaryValueSolution,
    sizes: Mapping[str, Sizes],
    label: str,
) -> BoundaryValueSolution:
    """Solve on given meshes by Newton's method.

    Parameters
    ----------
    bvp : Problem
        From `gnc_opt.planning.refinement.indirect.hamiltonian.hamiltonian_problem`.
    meshes, sizes : mapping by phase
    start : Solution or BoundaryValueSolution
        Where to start, on any mesh.
    label : str
        Name of the original problem, for messages.

    Raises
    ------
    GncOptError
        Newton's method does not converge.
    """
    transcription = transcribe(bvp, meshes, GAUSS)
    x, iterations = _newton(transcription, bvp, _start(transcription, bvp, start), sizes, label)
    extended = np.concatenate([x, transcription.fixed_times(bvp)])
    anchors, y, u = {}, {}, {}
    for name, part in transcription.parts.items():
        collocation = part.collocation
        anchors[name] = extended[part.times]
        first, last = anchors[name]
        breaks = first + np.asarray(collocation.mesh.breaks) * (last - first)
        nodes = tuple(rule.state_nodes for rule in collocation.rules)
        values = tuple(x[collocation.segment_nodes(k)][:, :-1] for k in range(collocation.mesh.segments))
        y[name] = PiecewisePolynomial(breaks, nodes, values)
        u[name] = piecewise(breaks, collocation.rules, x[collocation.point_controls])
    q = x[transcription.parameter_places]
    parameters = {name: q[bvp.parameters.slice(name)] for name in bvp.parameters.names}
    return BoundaryValueSolution(anchors, y, u, parameters, iterations)


def _start(transcription: Transcription, bvp: Problem, start: Solution | BoundaryValueSolution) -> Array:
    x = np.zeros(transcription.n_variables)
    for name, part in transcription.parts.items():
        collocation = part.collocation
        breaks = np.asarray(collocation.mesh.breaks)
        if isinstance(start, Solution):
            leg = start.phases[name]
            first, last = leg.initial_time, leg.final_time
            points, ends = first + collocation.fractions * (last - first), first + breaks * (last - first)
            at_points, at_ends = (np.vstack([leg.x(t), leg.lam(t)]) for t in (points, ends))
            controls = leg.u(points)
        else:
            first, last = start.anchors[name]
            points, ends = first + collocation.fractions * (last - first), first + breaks * (last - first)
            at_points, at_ends, controls = start.y[name](points), start.y[name](ends), start.u[name](points)
        x[collocation.point_states], x[collocation.boundary_states] = at_points, at_ends
        x[collocation.point_controls] = controls
        for place, value in zip(part.times, (first, last), strict=True):
            if place < transcription.n_variables:
                x[place] = value
    guesses = bvp.parameter_guess if isinstance(start, Solution) else start.parameters
    for name in bvp.parameters.names:
        x[transcription.parameter_places[bvp.parameters.slice(name)]] = guesses[name]
    places = transcription.integral_places
    if places.size:
        x[places] -= transcription.evaluate(bvp, x)[0][-places.size :]
    return x


def _newton(
    transcription: Transcription, bvp: Problem, x: Array, magnitudes: Mapping[str, Sizes], name: str
) -> tuple[Array, int]:
    """Newton's method, damped by the natural monotonicity test (Deuflhard, Newton Methods, 2004, sec. 3.3)."""
    box = transcription.row_interval(bvp)
    equations = np.flatnonzero(box.fixed)
    rows, columns = transcription.constraints.jacobian_pattern
    sizes = _sizes(transcription, x, magnitudes)
    last = np.inf
    for iteration in range(MAX_STEPS):
        values, _, nonzeros = transcription.evaluate(bvp, x)
        matrix = scipy.sparse.csr_array(
            (nonzeros * sizes[columns], (rows, columns)), shape=(box.lower.size, x.size)
        )[equations]
        norms = np.asarray(np.abs(matrix).max(axis=1).todense()).ravel()
        norms = np.where(norms > 0, norms, 1.0)
        residual = (values - box.lower)[equations] / norms
        if not np.all(np.isfinite(nonzeros)):
            break
        try:
            factors = scipy.sparse.linalg.splu(
                scipy.sparse.csc_array(scipy.sparse.diags_array(1 / norms) @ matrix)
            )
            step = factors.solve(-residual)
        except (RuntimeError, ValueError):
            break
        length = float(np.max(np.abs(step)))
        if not np.isfinite(length):
            break
        if length <= DONE or (length < NEWTON_STEP_TOLERANCE and length > 0.25 * last):
            return x, iteration
        damping = 1.0
        while damping > LEAST_DAMPING:
            trial = x + damping * sizes * step
            moved = (transcription.evaluate(bvp, trial)[0] - box.lower)[equations] / norms
            simplified = factors.solve(moved)
            if length < NEWTON_STEP_TOLERANCE or np.max(np.abs(simplified)) <= (1 - damping / 4) * length:
                break
            damping *= 0.5
        else:
            break
        x, last = trial, length
    raise GncOptError(
        f"no indirect solution of '{name}': Newton's method on its first-order conditions does not converge "
        "from it; give a more accurate one, e.g. refine(solution, tol=1e-6)."
    )


def _sizes(transcription: Transcription, x: Array, magnitudes: Mapping[str, Sizes]) -> Array:
    """Typical magnitudes of all variables."""
    sizes = np.maximum(np.abs(x), BRANCH_ENDED)
    for name, part in transcription.parts.items():
        here, collocation = magnitudes[name], part.collocation
        sizes[collocation.point_states] = here.y[:, None]
        sizes[collocation.boundary_states] = here.y[:, None]
        sizes[collocation.point_controls] = here.u[:, None]
    return sizes


# --- accuracy -----------------------------------------------------------------------------------------


def finer(mesh: Mesh, found: BoundaryValueSolution, phase: str, sizes: Sizes, tol: float) -> Mesh:
    """Raise the degree of segments with a large tail; halve those that are at the highest degree."""
    tails = tails_of(found, phase, sizes)
    if np.all(tails <= tol):
        return mesh
    breaks, degrees = [0.0], []
    for k, degree in enumerate(mesh.degrees):
        left, right = mesh.breaks[k], mesh.breaks[k + 1]
        if tails[k] <= tol:
            pieces, n = 1, degree
        elif degree + BOUNDARY_VALUE_DEGREE_STEP <= MOST_DEGREE:
            pieces, n = 1, degree + BOUNDARY_VALUE_DEGREE_STEP
        else:
            pieces, n = 2, MOST_DEGREE // 2
        breaks += [left + (right - left) * (i + 1) / pieces for i in range(pieces)]
        degrees += [n] * pieces
    return Mesh(tuple(breaks), tuple(degrees)) if len(degrees) <= MOST_SEGMENTS else mesh


def tails_of(found: BoundaryValueSolution, phase: str, sizes: Sizes) -> Array:
    """Largest of the last two Legendre coefficients of each segment (K,), relative to each quantity's size."""
    tails = np.zeros(len(found.y[phase].values))
    for signal, size in ((found.y[phase], sizes.y), (found.u[phase], sizes.u)):
        for k, (nodes, values) in enumerate(zip(signal.nodes, signal.values, strict=True)):
            n = nodes.size
            gauss = gauss_rule(n)
            at = values @ interpolation_matrix(nodes, gauss.points).T
            basis = legendre.legvander(gauss.points, n - 1)[:, -2:]
            coefficients = at @ (gauss.weights[:, None] * basis) * (np.array([n - 2, n - 1]) + 0.5)
            tails[k] = max(tails[k], float(np.max(np.abs(coefficients) / size[:, None], initial=0.0)))
    return tails
