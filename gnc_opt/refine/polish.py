"""Indirect polish: a smooth solution to ten digits and more, from its Hamiltonian boundary-value problem."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre
from scipy.sparse.linalg import splu

from gnc_opt.arguments import expect, read_positive
from gnc_opt.errors import GncOptError
from gnc_opt.model.layout import Array
from gnc_opt.problem.functions import EndGradients, end_gradients
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.problem import Problem
from gnc_opt.refine.hamiltonian import Limits, active_limits, hamiltonian_problem
from gnc_opt.solution.extract import model_parameters
from gnc_opt.solution.phase_solution import PhaseSolution, piecewise
from gnc_opt.solution.polynomial import PiecewisePolynomial
from gnc_opt.solution.solution import Solution, Statistics
from gnc_opt.transcription.mesh import Mesh
from gnc_opt.transcription.quadrature import collocation_rule, interpolation_matrix
from gnc_opt.transcription.transcription import Transcription, transcribe

LEAST_DEGREE = 8
STEP = 6
MOST_DEGREE = 32
"""Segments start with the first of these degrees, gain the second, and are halved beyond the third."""

MOST_SEGMENTS = 2000
MAX_PASSES = 12
MAX_STEPS = 40

CLEAR = 1e-6
"""A quantity nearer than this to a limit (relative to its size) is taken to be held by it."""

FLAT = 1e-8
"""Curvature of H in the controls, relative to the largest, that counts as none."""


def polish(solution: Solution, *, tol: float = 1e-10) -> Solution:
    """Solve the first-order conditions of a smooth problem as a boundary-value problem, to high accuracy.

    States, costates and controls become one differential-algebraic system (H from the model, the control from
    dH/du = 0), collocated at Legendre-Gauss points of high degree and solved by Newton's method from the given
    solution; degrees rise until the last Legendre coefficients of every segment are below the tolerance.

    Parameters
    ----------
    solution : Solution
        Solved, of any scheme, with its problem; accurate enough for Newton's method to start from.
    tol : float
        Largest share of the last Legendre coefficients in any state, costate and control, relative to its size.

    Returns
    -------
    Solution
        On its own mesh; ``provenance["polished"]`` says how. `verify` judges it like any other.

    Raises
    ------
    GncOptError
        A bound or path constraint is active along the way, a control is singular, the solution has no problem or is
        not solved, or Newton's method or the mesh does not converge.
    """
    expect(solution, Solution, "what polish() got", "write polish(solve(problem))")
    read_positive(tol, "the tolerance of polish()")
    _refuse(solution)
    begin = time.perf_counter()
    limits = active_limits(solution)
    bvp = hamiltonian_problem(solution, limits)
    meshes = {
        name: Mesh(leg.mesh.breaks, tuple(max(LEAST_DEGREE, n) for n in leg.mesh.degrees))
        for name, leg in solution.phases.items()
    }
    current: Solution | _Polished = solution
    built, iterations = time.perf_counter() - begin, 0
    for _ in range(MAX_PASSES):
        current = _solve(bvp, meshes, current, solution)
        iterations += current.iterations
        finer = {name: _finer(mesh, current, name, tol) for name, mesh in meshes.items()}
        if finer == meshes:
            break
        meshes = finer
    else:
        raise _unresolved(solution, current, tol)
    spent = time.perf_counter() - begin - built
    polished = _assemble(solution, limits, current, Statistics(iterations, built, spent, 0.0, spent), tol)
    _refuse(polished)
    return polished


# --- what cannot be polished ------------------------------------------------------------------------


def _refuse(solution: Solution) -> None:
    name = solution.problem_name
    if solution.problem is None:
        raise GncOptError(
            f"cannot polish the solution of '{name}' without its problem: load it with load(path, problem=...)."
        )
    if not solution.status.solved:
        raise GncOptError(
            f"the solution of '{name}' ended as {solution.status.value}: polish one that is solved."
        )
    for leg in solution.phases.values():
        _refuse_limits(solution, leg)
        _refuse_flat(solution, leg)


def _refuse_limits(solution: Solution, leg: PhaseSolution) -> None:
    times = leg.point_times
    x, u = leg.x(times), leg.u(times)
    paths = solution.functions(leg.name).paths(times, x, u)
    duration = np.full((1, times.size), leg.duration)
    for what, labels, values, box, remedy in (
        ("control", leg.controls.labels, u, leg.control_bounds,
         "bang-bang arcs are settled by refine(solution, structure='auto')"),
        ("state", leg.states.labels, x, leg.state_bounds, "use refine(solution)"),
        ("path constraint", leg.path_labels, paths, leg.path_bounds, "use refine(solution)"),
        ("the duration of phase", (leg.name,), duration, leg.duration_bounds, "fix it by the phase's times"),
    ):  # fmt: skip
        if what.startswith("the duration") and (
            leg.initial_time_bounds.fixed[0] or leg.final_time_bounds.fixed[0]
        ):
            continue
        margin = _margin(values, box)
        if margin.size and np.min(margin) < CLEAR:
            i, j = np.unravel_index(int(np.argmin(margin)), margin.shape)
            raise GncOptError(
                f"cannot polish the solution of '{solution.problem_name}': {what} '{labels[i]}' is at its limit at "
                f"t = {times[j]:.6g} s, phase {leg.name}, where the first-order conditions are not smooth; {remedy}."
            )


def _margin(values: Array, box: Interval) -> Array:
    """Distance to the nearer limit, relative to the size of range or values; infinite without limits."""
    if not values.size:
        return values
    span = box.upper - box.lower
    sizes = np.where(np.isfinite(span) & (span > 0), span, np.max(np.abs(values), axis=1))
    sizes = np.where(sizes > 0, sizes, 1.0)[:, None]
    return np.minimum(values - box.lower[:, None], box.upper[:, None] - values) / sizes


def _refuse_flat(solution: Solution, leg: PhaseSolution) -> None:
    if not leg.controls.size:
        return
    times = leg.point_times
    x, u, lam = leg.x(times), leg.u(times), leg.lam(times)
    mu = np.zeros((len(leg.path_labels), times.size))
    curvature = solution.functions(leg.name).control_hessian(times, x, u, lam, mu)
    sizes = np.max(np.abs(u), axis=1)
    sizes = np.where(sizes > 0, sizes, 1.0)
    values, vectors = np.linalg.eigh(np.moveaxis(curvature * (sizes[:, None] * sizes)[:, :, None], 2, 0))
    worst = int(np.argmin(values[:, 0]))
    if values[worst, 0] <= FLAT * np.max(np.abs(values)):
        label = leg.controls.labels[int(np.argmax(np.abs(vectors[worst, :, 0])))]
        raise GncOptError(
            f"cannot polish the solution of '{solution.problem_name}': the Hamiltonian has no positive curvature in "
            f"control '{label}' at t = {times[worst]:.6g} s, phase {leg.name}, so that dH/du = 0 does not determine "
            "it; a bang-bang or singular control is settled by refine(solution, structure='auto')."
        )


# --- the boundary-value problem -----------------------------------------------------------------------


@dataclass(frozen=True)
class _Polished:
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


def _solve(
    bvp: Problem, meshes: dict[str, Mesh], start: Solution | _Polished, original: Solution
) -> _Polished:
    transcription = transcribe(bvp, meshes, "LG")
    x, iterations = _newton(transcription, bvp, _start(transcription, bvp, start), original.problem_name)
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
    return _Polished(anchors, y, u, parameters, iterations)


def _start(transcription: Transcription, bvp: Problem, start: Solution | _Polished) -> Array:
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


def _newton(transcription: Transcription, bvp: Problem, x: Array, name: str) -> tuple[Array, int]:
    """Newton's method, damped by the natural monotonicity test (Deuflhard, Newton Methods, 2004, sec. 3.3)."""
    box = transcription.row_interval(bvp)
    equations = np.flatnonzero(box.fixed)
    rows, columns = transcription.constraints.jacobian_pattern
    sizes = _sizes(transcription, x)
    last = np.inf
    for iteration in range(MAX_STEPS):
        values, _, nonzeros = transcription.evaluate(bvp, x)
        matrix = sp.csr_array((nonzeros * sizes[columns], (rows, columns)), shape=(box.lower.size, x.size))[
            equations
        ]
        norms = np.asarray(np.abs(matrix).max(axis=1).todense()).ravel()
        norms = np.where(norms > 0, norms, 1.0)
        residual = (values - box.lower)[equations] / norms
        try:
            factors = splu(sp.csc_array(sp.diags_array(1 / norms) @ matrix))
            step = factors.solve(-residual)
        except (RuntimeError, ValueError):
            break
        length = float(np.max(np.abs(step)))
        if not np.isfinite(length):
            break
        if length <= 1e-14 or (length < 1e-9 and length > 0.25 * last):
            return x, iteration
        damping = 1.0
        while damping > 1e-3:
            trial = x + damping * sizes * step
            moved = (transcription.evaluate(bvp, trial)[0] - box.lower)[equations] / norms
            simplified = factors.solve(moved)
            if length < 1e-9 or np.max(np.abs(simplified)) <= (1 - damping / 4) * length:
                break
            damping *= 0.5
        else:
            break
        x, last = trial, length
    raise GncOptError(
        f"cannot polish the solution of '{name}': Newton's method on its first-order conditions does not converge "
        "from it; give a more accurate one, e.g. refine(solution, tol=1e-6)."
    )


def _sizes(transcription: Transcription, x: Array) -> Array:
    """Typical magnitudes of the variables, from their values."""
    sizes = np.maximum(np.abs(x), 1e-6)
    for part in transcription.parts.values():
        collocation = part.collocation
        for places in (collocation.point_states, collocation.point_controls):
            here = np.max(np.abs(x[places]), axis=1, initial=0.0)
            here = np.where(here > 0, here, 1.0)[:, None]
            sizes[places] = here
            if places is collocation.point_states:
                sizes[collocation.boundary_states] = here
    return sizes


# --- accuracy -----------------------------------------------------------------------------------------


def _finer(mesh: Mesh, found: _Polished, phase: str, tol: float) -> Mesh:
    """Raise the degree of segments with a large tail; halve those that are at the highest degree."""
    tails = _tails(found, phase)
    if np.all(tails <= tol):
        return mesh
    breaks, degrees = [0.0], []
    for k, degree in enumerate(mesh.degrees):
        left, right = mesh.breaks[k], mesh.breaks[k + 1]
        if tails[k] <= tol:
            pieces, n = 1, degree
        elif degree + STEP <= MOST_DEGREE:
            pieces, n = 1, degree + STEP
        else:
            pieces, n = 2, MOST_DEGREE // 2
        breaks += [left + (right - left) * (i + 1) / pieces for i in range(pieces)]
        degrees += [n] * pieces
    return Mesh(tuple(breaks), tuple(degrees)) if len(degrees) <= MOST_SEGMENTS else mesh


def _tails(found: _Polished, phase: str) -> Array:
    """Largest of the last two Legendre coefficients of each segment (K,), relative to each quantity's size."""
    tails = np.zeros(len(found.y[phase].values))
    for signal in (found.y[phase], found.u[phase]):
        sizes = np.max(np.abs(np.hstack(signal.values)), axis=1, initial=0.0)
        sizes = np.where(sizes > 0, sizes, 1.0)
        for k, (nodes, values) in enumerate(zip(signal.nodes, signal.values, strict=True)):
            n = nodes.size
            gauss = collocation_rule("LG", n)
            at = values @ interpolation_matrix(nodes, gauss.points).T
            basis = legendre.legvander(gauss.points, n - 1)[:, -2:]
            coefficients = at @ (gauss.weights[:, None] * basis) * (np.array([n - 2, n - 1]) + 0.5)
            tails[k] = max(tails[k], float(np.max(np.abs(coefficients) / sizes[:, None], initial=0.0)))
    return tails


def _unresolved(solution: Solution, found: Solution | _Polished, tol: float) -> GncOptError:
    assert isinstance(found, _Polished), "there was at least one pass"
    tails = {name: _tails(found, name) for name in found.y}
    phase = max(tails, key=lambda name: float(np.max(tails[name])))
    k = int(np.argmax(tails[phase]))
    breaks = found.y[phase].breaks
    return GncOptError(
        f"cannot polish the solution of '{solution.problem_name}' to {tol:g}: phase {phase} between t = "
        f"{breaks[k]:.6g} s and {breaks[k + 1]:.6g} s stays at {tails[phase][k]:.1e}, as if its functions were not "
        "smooth there; ask for less, or cut the phase at the kink."
    )


# --- the solution ---------------------------------------------------------------------------------------


def _assemble(
    solution: Solution, limits: Limits, found: _Polished, statistics: Statistics, tol: float
) -> Solution:
    problem = solution.problem
    assert problem is not None, "polish has refused solutions without a problem"
    q = found.parameters.get("q", np.zeros(0))
    nu = found.parameters.get("nu", np.zeros(0))
    bare = {name: _phase(problem, leg, found, q) for name, leg in solution.phases.items()}
    ends: dict[str, list[Any]] = {}
    for name, leg in bare.items():
        x = leg.x(leg.breaks[[0, -1]])
        ends[name] = [x[:, 0], x[:, 1], leg.initial_time, leg.final_time, leg.integrals, leg.parameters]
    gradients = end_gradients(problem, ends, q, nu)
    phases = {name: _with_multipliers(solution, leg, gradients) for name, leg in bare.items()}
    slopes = gradients.parameters.copy()
    for name, leg in phases.items():
        times, weights = _quadrature(leg)
        functions = replace(solution.functions(name), p=leg.parameters, q=q, weights=leg.integral_weights)
        mu = np.zeros((len(leg.path_labels), times.size))
        slopes += (
            functions.parameter_gradient(times, leg.x(times), leg.u(times), leg.lam(times), mu) @ weights
        )
    mesh = ", ".join(f"{name} {leg.mesh}" for name, leg in phases.items())
    return replace(
        solution,
        objective=gradients.cost,
        phases=phases,
        parameter_values=q,
        parameter_multipliers=np.where(np.isfinite(limits.parameters), -slopes, 0.0),
        constraint_values=gradients.constraints,
        constraint_multipliers=nu,
        violations=(),
        statistics=statistics,
        structure=(),
        history=None,
        provenance={
            **solution.provenance,
            "scheme": "LG",
            "mesh": mesh,
            "polished": f"indirect: Hamiltonian boundary-value problem, tolerance {tol:g}",
        },
    )


def _phase(problem: Problem, old: PhaseSolution, found: _Polished, q: Array) -> PhaseSolution:
    """The phase without what depends on end-point gradients."""
    y, u = found.y[old.name], found.u[old.name]
    n, (first, last) = old.states.size, found.anchors[old.name]
    fractions = (y.breaks - first) / (last - first)
    degrees = tuple(nodes.size for nodes in u.nodes)
    lam = y.rows(slice(n, 2 * n))
    weights = found.parameters.get(f"w_{old.name}", np.zeros(0))
    bare = replace(
        old, scheme="LG", mesh=Mesh(tuple(fractions), degrees), initial_time=float(first), final_time=float(last),
        x=y.rows(slice(0, n)), u=u, lam=lam, lam_start=lam(y.breaks[:-1]), lam_end=lam(y.breaks[1:], "left"),
        point_costates=np.hstack([v[:, 1:] for v in lam.values]),
        path_multipliers=np.zeros((len(old.path_labels), sum(degrees))),
        state_multipliers=np.zeros((n, sum(degrees))),
        control_multipliers=np.zeros((old.controls.size, sum(degrees))),
        state_impulses=np.zeros((n, len(degrees) + 1)), time_multipliers=np.zeros(2), duration_multiplier=0.0,
        integral_weights=weights, parameters=model_parameters(problem, problem.phases[old.name], q),
    )  # fmt: skip
    return bare


def _quadrature(leg: PhaseSolution) -> tuple[Array, Array]:
    """Times and Gauss weights (s) of the collocation points."""
    widths = np.diff(leg.breaks)
    weights = np.concatenate(
        [0.5 * width * rule.weights for width, rule in zip(widths, leg.rules, strict=True)]
    )
    return leg.point_times, weights
