"""Indirect polish: a smooth solution to ten digits and more, from its Hamiltonian boundary-value problem."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from gnc_opt.arguments import expect, read_positive
from gnc_opt.arrays import Array
from gnc_opt.environment import one_thread
from gnc_opt.errors import GncOptError
from gnc_opt.planning.problem.functions import EndGradients, PhaseFunctions, end_gradients, phase_functions
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.indirect.boundary_value import (
    BOUNDARY_VALUE_MIN_DEGREE,
    BoundaryValueSolution,
    Sizes,
    finer,
    solve_boundary_values,
    tails_of,
)
from gnc_opt.planning.refinement.indirect.hamiltonian import (
    HeldLimits,
    PhaseLimits,
    active_limits,
    hamiltonian_problem,
)
from gnc_opt.planning.solution.extract import model_parameters
from gnc_opt.planning.solution.history import Statistics
from gnc_opt.planning.solution.phase_solution import PhaseSolution, piecewise
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.scheme import GAUSS

MAX_PASSES = 12

CLEAR = 1e-6
"""A quantity nearer than this to a limit (relative to its size) is taken to be held by it."""

FULL_TURN_TOLERANCE = 1e-10
"""Rates that a full turn of a control changes by less than this, relative to their size, do not know of it."""

CONTROL_CURVATURE_MIN_SHARE = 1e-8
"""Curvature of H in a direction of the controls, relative to the largest of each, that counts as none."""


@one_thread()
def solve_indirect(solution: Solution, *, tol: float = 1e-10) -> Solution:
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
        On its own mesh; ``provenance["polished"]`` says how. `verify` checks it like any other.

    Raises
    ------
    GncOptError
        A bound or path constraint is active along the way, a control is singular, the solution has no problem or is
        not solved, or Newton's method or the mesh does not converge.

    Examples
    --------
    >>> hop = go.Problem("rest to rest with the least effort")
    >>> leg = hop.phase("leg", cart)
    >>> leg.time(0.0, 1.0)
    >>> leg.initial(q=0.0, v=0.0)
    >>> leg.final(q=1.0, v=0.0)
    >>> hop.minimize(leg.integral(cart.symbol("a") ** 2))
    >>> print(round(go.solve_indirect(go.solve(hop)).objective, 9))
    12.0
    """
    expect(solution, Solution, "what solve_indirect() got", "write solve_indirect(solve(problem))")
    read_positive(tol, "the tolerance of solve_indirect()")
    _refuse(solution)
    begin = time.perf_counter()
    limits = active_limits(solution)
    bvp = hamiltonian_problem(solution, limits)
    meshes = {
        name: Mesh(leg.mesh.breaks, tuple(max(BOUNDARY_VALUE_MIN_DEGREE, n) for n in leg.mesh.degrees))
        for name, leg in solution.phases.items()
    }
    unwrapped = _unwrapped(solution)
    sizes = {name: Sizes.of(leg, _problem(solution).phases[name]) for name, leg in unwrapped.phases.items()}
    current: Solution | BoundaryValueSolution = unwrapped
    built, iterations = time.perf_counter() - begin, 0
    for _ in range(MAX_PASSES):
        current = solve_boundary_values(bvp, meshes, current, sizes, solution.problem_name)
        iterations += current.iterations
        wanted = {name: finer(mesh, current, name, sizes[name], tol) for name, mesh in meshes.items()}
        if wanted == meshes:
            break
        meshes = wanted
    else:
        raise _unresolved(solution, current, sizes, tol)
    spent = time.perf_counter() - begin - built
    polished = _assemble(solution, limits, current, Statistics(iterations, built, spent, 0.0, spent), tol)
    _refuse(polished)
    return polished


def _problem(solution: Solution) -> Problem:
    assert solution.problem is not None, "solve_indirect has refused solutions without a problem"
    return solution.problem


def _unwrapped(solution: Solution) -> Solution:
    """Take whole turns out of controls that are angles: a solver does not care, interpolation does."""
    phases = dict(solution.phases)
    for name, leg in solution.phases.items():
        functions, times = solution.functions(name), leg.point_times
        x, u = leg.x(times), np.hstack(leg.u.values)
        plain = np.vstack([functions.rates(times, x, u), functions.integrands(times, x, u)])
        sizes = np.max(np.abs(plain), axis=1, keepdims=True, initial=0.0)
        for i in range(u.shape[0]):
            turned = u.copy()
            turned[i] += 2 * np.pi
            moved = np.vstack([functions.rates(times, x, turned), functions.integrands(times, x, turned)])
            if np.all(np.abs(moved - plain) <= FULL_TURN_TOLERANCE * sizes):
                u[i] = np.unwrap(u[i])
        phases[name] = replace(leg, u=piecewise(leg.breaks, leg.rules, u))
    return replace(solution, phases=phases)


# --- what cannot be polished ------------------------------------------------------------------------


def _refuse(solution: Solution) -> None:
    solution.need_problem("solve_indirect")
    if not solution.status.solved:
        raise GncOptError(
            f"the solution of '{solution.problem_name}' ended as {solution.status.value}: give one that is solved."
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
                f"no indirect solution of '{solution.problem_name}': {what} '{labels[i]}' is at its limit at "
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
    # Measured by its own curvature: a control that is zero all along has no magnitude to be measured by.
    own = np.max(np.abs(np.einsum("iit->it", curvature)), axis=1)
    unit = 1.0 / np.sqrt(np.where(own > 0, own, 1.0))
    values, vectors = np.linalg.eigh(np.moveaxis(curvature * (unit[:, None] * unit)[:, :, None], 2, 0))
    worst = int(np.argmin(values[:, 0]))
    if values[worst, 0] <= CONTROL_CURVATURE_MIN_SHARE:
        label = leg.controls.labels[int(np.argmax(np.abs(vectors[worst, :, 0])))]
        raise GncOptError(
            f"no indirect solution of '{solution.problem_name}': the Hamiltonian has no positive curvature in "
            f"control '{label}' at t = {times[worst]:.6g} s, phase {leg.name}, so that dH/du = 0 does not determine "
            "it; a bang-bang or singular control is settled by refine(solution, structure='auto')."
        )


def _unresolved(
    solution: Solution, found: Solution | BoundaryValueSolution, sizes: dict[str, Sizes], tol: float
) -> GncOptError:
    assert isinstance(found, BoundaryValueSolution), "there was at least one pass"
    tails = {name: tails_of(found, name, sizes[name]) for name in found.y}
    phase = max(tails, key=lambda name: float(np.max(tails[name])))
    k = int(np.argmax(tails[phase]))
    breaks = found.y[phase].breaks
    return GncOptError(
        f"no indirect solution of '{solution.problem_name}' to {tol:g}: phase {phase} between t = "
        f"{breaks[k]:.6g} s and {breaks[k + 1]:.6g} s stays at {tails[phase][k]:.1e}, as if its functions were not "
        "smooth there; ask for less, or cut the phase at the kink."
    )


# --- the solution ---------------------------------------------------------------------------------------


def _assemble(
    solution: Solution, limits: HeldLimits, found: BoundaryValueSolution, statistics: Statistics, tol: float
) -> Solution:
    problem = _problem(solution)
    q = found.parameters.get("q", np.zeros(0))
    nu = found.parameters.get("nu", np.zeros(0))
    bare = {name: _phase(problem, leg, found, q) for name, leg in solution.phases.items()}
    ends: dict[str, list[Any]] = {}
    for name, leg in bare.items():
        x = leg.x(leg.breaks[[0, -1]])
        ends[name] = [x[:, 0], x[:, 1], leg.initial_time, leg.final_time, leg.integrals, leg.parameters]
    gradients = end_gradients(problem, ends, q, nu)
    phases = {
        name: _with_multipliers(problem, leg, limits.phases[name], gradients, q) for name, leg in bare.items()
    }
    slopes = gradients.parameters.copy()
    for leg in phases.values():
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
            "scheme": GAUSS,
            "mesh": mesh,
            "polished": f"indirect: Hamiltonian boundary-value problem, tolerance {tol:g}",
        },
    )


def _phase(problem: Problem, old: PhaseSolution, found: BoundaryValueSolution, q: Array) -> PhaseSolution:
    """The phase with everything but the multipliers at its ends, which need the end-point gradients."""
    y, u = found.y[old.name], found.u[old.name]
    n, (first, last) = old.states.size, found.anchors[old.name]
    degrees = tuple(nodes.size for nodes in u.nodes)
    lam = y.rows(slice(n, 2 * n))
    bare = replace(
        old,
        scheme=GAUSS,
        mesh=Mesh(tuple((y.breaks - first) / (last - first)), degrees),
        initial_time=float(first),
        final_time=float(last),
        x=y.rows(slice(0, n)),
        u=u,
        lam=lam,
        lam_start=lam(y.breaks[:-1]),
        lam_end=lam(y.breaks[1:], "left"),
        point_costates=np.hstack([v[:, 1:] for v in lam.values]),
        path_multipliers=np.zeros((len(old.path_labels), sum(degrees))),
        state_multipliers=np.zeros((n, sum(degrees))),
        control_multipliers=np.zeros((old.controls.size, sum(degrees))),
        state_impulses=np.zeros((n, len(degrees) + 1)),
        time_multipliers=np.zeros(2),
        duration_multiplier=0.0,
        integral_weights=found.parameters.get(f"w_{old.name}", np.zeros(0)),
        parameters=model_parameters(problem, problem.phases[old.name], q),
    )
    times, weights = _quadrature(bare)
    integrands = _functions(problem, bare, q).integrands(times, bare.x(times), bare.u(times))
    return replace(bare, integrals=np.asarray(integrands @ weights))


def _with_multipliers(
    problem: Problem, leg: PhaseSolution, limits: PhaseLimits, gradients: EndGradients, q: Array
) -> PhaseSolution:
    """Multipliers of the values held at the ends: what the transversality conditions leave to them."""
    impulses = leg.state_impulses.copy()
    impulses[:, 0] = -(leg.lam_start[:, 0] + gradients.initial_state[leg.name])
    impulses[:, -1] = leg.lam_end[:, -1] - gradients.final_state[leg.name]
    impulses[np.isnan(limits.initial), 0] = 0.0
    impulses[np.isnan(limits.final), -1] = 0.0
    ends, functions = leg.breaks[[0, -1]], _functions(problem, leg, q)
    first, last = functions.hamiltonian(ends, leg.x(ends), leg.u(ends), leg.lam(ends))
    times = np.array([first - gradients.initial_time[leg.name], -last - gradients.final_time[leg.name]])
    variable = ~np.array([leg.initial_time_bounds.fixed[0], leg.final_time_bounds.fixed[0]])
    held = np.isfinite(limits.times) & variable
    return replace(leg, state_impulses=impulses, time_multipliers=np.where(held, times, 0.0))


def _functions(problem: Problem, leg: PhaseSolution, q: Array) -> PhaseFunctions:
    return phase_functions(problem, leg.name, leg.parameters, q, leg.integral_weights)


def _quadrature(leg: PhaseSolution) -> tuple[Array, Array]:
    """Times and Gauss weights (s) of the collocation points."""
    halves = 0.5 * np.diff(leg.breaks)
    weights = [half * rule.weights for half, rule in zip(halves, leg.rules, strict=True)]
    return leg.point_times, np.concatenate(weights)
