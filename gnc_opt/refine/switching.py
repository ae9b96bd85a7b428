"""Switch-time optimisation: the structure loop.

Controls are held on their bounds piece by piece, the times of the switches are variables, and each piece is
collocated with a high degree; controls between bounds (interior and singular arcs) stay free inside their pieces. The
costates of the optimum then judge the structure: a piece whose length goes to zero is dropped (or the two switches
at its ends change places), a switching function of the wrong sign asks for an arc that is missing. The loop ends
when signs and structure agree everywhere and the error between the nodes is small.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.model.layout import Array
from gnc_opt.nlp import SolverOptions
from gnc_opt.problem.problem import Problem
from gnc_opt.refine.detect import affine_channels, detect, root, switching
from gnc_opt.refine.error import estimate_errors, largest_error
from gnc_opt.refine.history import History, Pass, RefinementStatus
from gnc_opt.refine.structure import PhaseStructure, Signs
from gnc_opt.solution.arc import Arc
from gnc_opt.solution.solution import Solution
from gnc_opt.transcription.mesh import Mesh
from gnc_opt.verify.samples import PhaseSamples

FIRST_DEGREE, MAX_DEGREE = 6, 12
"""Collocation points of a piece to begin with, and of one segment at most; a piece that needs more is split."""

SINGULAR_DEGREE = 4
"""Collocation points of the segments of a singular piece; high-degree controls chatter where H does not fix them."""

MAX_SEGMENTS = 32
"""Segments of a piece at most."""

VANISHED = 1e-6
"""A piece shorter than this share of its phase has vanished."""

WRONG_SIGN = 1e-7
"""First-order gain in H, in shares of H, beyond which a wrong sign asks for another arc."""


@dataclass(frozen=True)
class Resolution:
    """Equal segments of a piece and their degree."""

    segments: int = 1
    degree: int = FIRST_DEGREE
    singular: bool = False

    def finer(self) -> Resolution:
        """Return the next finer resolution; the finest one is itself."""
        if self.singular:
            return replace(self, segments=min(2 * self.segments, MAX_SEGMENTS))
        if self.degree < MAX_DEGREE:
            return Resolution(self.segments, min(self.degree + 3, MAX_DEGREE))
        return Resolution(min(2 * self.segments, MAX_SEGMENTS), self.degree)


@dataclass(frozen=True)
class Plan:
    """Structure and resolution of one phase."""

    structure: PhaseStructure
    resolutions: tuple[Resolution, ...]

    @classmethod
    def of(cls, structure: PhaseStructure) -> Plan:
        """Return a plan that starts with the coarsest resolution."""
        singular = Resolution(2, SINGULAR_DEGREE, singular=True)
        return cls(structure, tuple(singular if 2 in signs else Resolution() for signs in structure.signs))

    def mesh(self) -> Mesh:
        """Return the mesh whose boundaries between pieces are movable."""
        times, movable = [self.structure.times[0]], []
        degrees: list[int] = []
        for k, r in enumerate(self.resolutions):
            left, right = self.structure.times[k], self.structure.times[k + 1]
            times += [left + (right - left) * (i + 1) / r.segments for i in range(r.segments)]
            degrees += [r.degree] * r.segments
            movable.append(len(degrees))
        fractions = (np.asarray(times) - times[0]) / (times[-1] - times[0])
        return Mesh(tuple(fractions), tuple(degrees), tuple(movable[:-1]))

    def arcs(self) -> Signs:
        """Return the signs of all controls in every segment (n_controls, K)."""
        return np.repeat(self.structure.matrix(), [r.segments for r in self.resolutions], axis=1)


def optimise_switches(
    solution: Solution,
    *,
    tol: float = 1e-9,
    max_passes: int = 40,
    options: SolverOptions | None = None,
) -> tuple[Solution, History]:
    """Return the solution with exact switch times and its `structure`, and the history of the loop.

    Parameters
    ----------
    solution : Solution
        A solved collocation solution, with its problem.
    tol : float
        On the error between the nodes; see `gnc_opt.refine.error`.
    max_passes : int
        At most so many solves.
    options : SolverOptions, optional
    """
    problem = solution.problem
    assert problem is not None, "refine() refuses solutions without a problem"
    chosen = options or SolverOptions(tolerance=1e-11, max_iterations=200)
    plans = {name: Plan.of(detect(s)) for name, s in _samples(solution).items()}
    swapped: set[tuple[str, PhaseStructure]] = set()
    records: list[Pass] = []
    status = RefinementStatus.PASS_LIMIT
    for _ in range(max_passes):
        begin = time.perf_counter()
        found = _solve(problem, plans, solution, chosen)
        if not found.status.solved:
            records.append(_record(found, begin, f"not solved ({found.status.value})"))
            interrupted = found.status.value == "interrupted"
            status = RefinementStatus.INTERRUPTED if interrupted else RefinementStatus.FAILED
            break
        solution = found
        plans = {name: _at_solution(plan, solution, name) for name, plan in plans.items()}
        plans, action = _improve(solution, plans, swapped, tol)
        records.append(_record(solution, begin, action or "structure stands"))
        if not action:
            status = RefinementStatus.CONVERGED
            break
    history = History(status, tol, tuple(records), len(records) - 1, f"{status.value}: {records[-1].actions}")
    return replace(solution, structure=_arcs(solution, plans)), history


def _improve(
    solution: Solution, plans: dict[str, Plan], swapped: set[tuple[str, PhaseStructure]], tol: float
) -> tuple[dict[str, Plan], str]:
    """Mend one phase; return the plans and what was done, or nothing."""
    for name, s in _samples(solution).items():
        plan = plans[name]
        structure, action = _collapse(s, plan.structure, swapped)
        if structure is None:
            finer = _finer(s, plan, tol)
            if finer is not None:
                return {**plans, name: finer}, "resolution raised"
            structure, action = _complete(s, plan.structure)
        if structure is not None:
            return {**plans, name: Plan.of(structure)}, action
    return plans, ""


def _samples(solution: Solution) -> dict[str, PhaseSamples]:
    return {name: PhaseSamples.of(leg, solution.functions(name)) for name, leg in solution.phases.items()}


def _solve(problem: Problem, plans: Mapping[str, Plan], guess: Solution, options: SolverOptions) -> Solution:
    from gnc_opt.solve import solve

    held = problem
    for name, plan in plans.items():
        held = held.with_arcs(name, arcs=plan.arcs())
    meshes = {name: plan.mesh() for name, plan in plans.items()}
    found = solve(held, mesh=meshes, guess=guess, options=options, throw=False)
    return replace(found, problem=problem)


def _at_solution(plan: Plan, solution: Solution, name: str) -> Plan:
    """Return the plan with the switch times of the solution."""
    leg = solution.phases[name]
    times = tuple(float(t) for t in leg.breaks[list(leg.mesh.anchors)])
    return replace(plan, structure=plan.structure.at(times))


def _record(solution: Solution, begin: float, action: str) -> Pass:
    error, where = largest_error(estimate_errors(solution))
    return Pass(
        meshes={name: leg.mesh for name, leg in solution.phases.items()},
        times={name: tuple(float(t) for t in leg.breaks) for name, leg in solution.phases.items()},
        error=error,
        where=where,
        objective=solution.objective,
        solved=solution.status.solved,
        iterations=solution.statistics.iterations,
        seconds=time.perf_counter() - begin,
        actions=action,
    )


def _arcs(solution: Solution, plans: Mapping[str, Plan]) -> tuple[Arc, ...]:
    arcs: list[Arc] = []
    for name, s in _samples(solution).items():
        arcs += plans[name].structure.arcs(name, s.leg.controls.labels)
    return tuple(arcs)


# --- arcs that vanish -----------------------------------------------------------------------------------


def _collapse(
    samples: PhaseSamples, structure: PhaseStructure, swapped: set[tuple[str, PhaseStructure]]
) -> tuple[PhaseStructure | None, str]:
    """Return the structure after a piece has vanished and what was done, or None if none has."""
    lengths = structure.lengths
    shortest = int(np.argmin(lengths))
    if structure.pieces == 1 or lengths[shortest] >= VANISHED * lengths.sum():
        return None, ""
    other = structure.swapped(shortest)
    key = (samples.leg.name, structure.at(()))
    if other is not None and key not in swapped:
        swapped |= {key, (samples.leg.name, other.at(()))}
        return _spread(other, shortest), f"switches {shortest} and {shortest + 1} swapped"
    return structure.without(shortest), f"piece {shortest + 1} dropped"


def _spread(structure: PhaseStructure, piece: int) -> PhaseStructure:
    """Give a swapped piece some length to start from."""
    times = np.asarray(structure.times)
    room = 1e-3 * (times[-1] - times[0])
    middle = 0.5 * (times[piece] + times[piece + 1])
    left = max(middle - 0.5 * room, 0.5 * (times[piece - 1] + middle))
    right = min(middle + 0.5 * room, 0.5 * (times[piece + 2] + middle))
    times[piece], times[piece + 1] = left, right
    return structure.at(tuple(float(t) for t in times))


# --- arcs that are missing --------------------------------------------------------------------------------


def _complete(samples: PhaseSamples, structure: PhaseStructure) -> tuple[PhaseStructure | None, str]:
    """Return the structure with the arc that a wrong sign asks for and what was done, or None if all agree."""
    affine = affine_channels(samples)
    gradient = samples.control_gradient * samples.control_scale[:, None] / samples.hamiltonian_scale
    signs = structure.matrix()[:, samples.leg.mesh.segment_arcs[samples.segments]]
    offence = np.where(affine[:, None] & (np.abs(signs) == 1), signs * gradient, 0.0)
    for i in range(offence.shape[0]):
        _forgive_own_switches(offence[i], signs[i])
    if not offence.size or offence.max() < WRONG_SIGN:
        return None, ""
    i, j = (int(v) for v in np.unravel_index(int(np.argmax(offence)), offence.shape))
    start, end = _wrong_interval(samples, offence[i], i, j)
    label = samples.leg.controls.labels[i]
    return structure.with_arc(i, start, end, -int(signs[i, j])), f"arc of {label} added at {start:.4g} s"


def _forgive_own_switches(offence: Array, signs: Signs) -> None:
    """Zero the offences that reach up to one of the channel's own switches.

    There the switching function vanishes at the optimum, and what is left of it is rounding and mesh error.
    """
    for j in np.flatnonzero(signs[1:] != signs[:-1]):
        for k in range(int(j), -1, -1):
            if offence[k] <= 0:
                break
            offence[k] = 0.0
        for k in range(int(j) + 1, offence.size):
            if offence[k] <= 0:
                break
            offence[k] = 0.0


def _wrong_interval(samples: PhaseSamples, offence: Array, channel: int, j: int) -> tuple[float, float]:
    """Return where the switching function has the wrong sign around sample j."""
    right_signs = np.flatnonzero(offence <= 0)
    before, after = right_signs[right_signs < j], right_signs[right_signs > j]
    times, value = samples.times, switching(samples, channel)
    start = root(value, times[before[-1]], times[before[-1] + 1]) if before.size else times[0]
    end = root(value, times[after[0] - 1], times[after[0]]) if after.size else times[-1]
    return float(start), float(end)


# --- resolution ---------------------------------------------------------------------------------------------


def _finer(samples: PhaseSamples, plan: Plan, tol: float) -> Plan | None:
    """Return higher resolutions where dynamics or costates are not met between the nodes, or None."""
    rates = samples.functions.rates(samples.times, samples.x, samples.u_polynomial)
    errors = samples.per_segment(samples.x_rate - rates) / samples.state_scale[:, None]
    gradient = samples.functions.state_gradient(samples.times, samples.x, samples.u, samples.lam, samples.mu)
    residual = samples.per_segment(samples.lam_rate + gradient + samples.state_multiplier)
    worth = samples.state_scale[:, None] / samples.cost_scale
    per_segment = np.maximum(np.max(errors, axis=0), np.max(residual * worth, axis=0))
    worst = np.zeros(plan.structure.pieces)
    np.maximum.at(worst, samples.leg.mesh.segment_arcs, per_segment)
    wanted = tuple(r.finer() if e > tol else r for r, e in zip(plan.resolutions, worst, strict=True))
    return replace(plan, resolutions=wanted) if wanted != plan.resolutions else None
