"""Switch-time optimisation: the structure loop.

Controls are held on their bounds piece by piece, the times of the switches are variables, and each piece is
collocated with a high degree. The costates of the optimum then judge the structure: a piece whose length goes to
zero is dropped (or two switches change places), a switching function of the wrong sign asks for an arc that is
missing. The loop ends when signs and structure agree everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.model.layout import Array
from gnc_opt.nlp import SolverOptions
from gnc_opt.problem.problem import Problem
from gnc_opt.refine.detect import _root, affine_channels, detect, switching
from gnc_opt.refine.structure import PhaseStructure, Signs
from gnc_opt.solution.arc import Arc
from gnc_opt.solution.solution import Solution
from gnc_opt.transcription.mesh import Mesh
from gnc_opt.verify.samples import PhaseSamples

DEGREE = 6
"""Collocation points of a piece to begin with."""

MAX_DEGREE = 14
VANISHED = 1e-6
"""A piece shorter than this share of its phase has vanished."""

WRONG_SIGN = 1e-7
"""First-order gain in H, in shares of H, beyond which a wrong sign asks for another arc."""


@dataclass(frozen=True)
class SwitchingStep:
    """One pass of the loop, for the history.

    Attributes
    ----------
    pieces : int
    objective : float
    action : str
        What the pass found and did.
    """

    pieces: int
    objective: float
    action: str


def optimise_switches(
    solution: Solution, *, tol: float = 1e-9, max_passes: int = 40, options: SolverOptions | None = None
) -> tuple[Solution, tuple[Arc, ...], tuple[SwitchingStep, ...]]:
    """Return the solution with exact switch times, its arcs, and the history of the structure loop."""
    problem = solution.problem
    assert problem is not None, "refine() refuses solutions without a problem"
    structures = {name: detect(s) for name, s in _samples(solution).items()}
    degrees: dict[str, list[int]] = {name: _first_degrees(s) for name, s in structures.items()}
    swapped: set[tuple[str, PhaseStructure]] = set()
    history: list[SwitchingStep] = []
    for _ in range(max_passes):
        solution = _solve(problem, structures, degrees, solution, options)
        structures = {name: s.at(tuple(_anchor_times(solution, name))) for name, s in structures.items()}
        samples = _samples(solution)
        action = ""
        for name, s in samples.items():
            changed, action = _collapse(s, structures[name], swapped)
            if changed is not None:
                structures[name], degrees[name] = changed, _first_degrees(changed)
                break
            grown = _grow(s, structures[name], degrees[name], tol)
            if grown is not None:
                degrees[name], action = grown, "degrees raised"
                break
            changed, action = _complete(s, structures[name])
            if changed is not None:
                structures[name], degrees[name] = changed, _first_degrees(changed)
                break
        history.append(
            SwitchingStep(sum(s.pieces for s in structures.values()), solution.objective, action or "done")
        )
        if not action:
            break
    arcs: list[Arc] = []
    for name, s in _samples(solution).items():
        arcs += structures[name].arcs(name, s.leg.controls.labels, affine_channels(s))
    return solution, tuple(arcs), tuple(history)


def _samples(solution: Solution) -> dict[str, PhaseSamples]:
    return {name: PhaseSamples.of(leg, solution.functions(name)) for name, leg in solution.phases.items()}


def _first_degrees(structure: PhaseStructure) -> list[int]:
    return [DEGREE] * structure.pieces


def _solve(
    problem: Problem,
    structures: Mapping[str, PhaseStructure],
    degrees: Mapping[str, list[int]],
    guess: Solution,
    options: SolverOptions | None,
) -> Solution:
    from gnc_opt.solve import solve

    meshes, held = {}, problem
    for name, structure in structures.items():
        meshes[name] = Mesh.at_times(structure.times, degrees[name], movable=True)
        held = held.with_arcs(name, arcs=structure.matrix())
    chosen = options or SolverOptions(tolerance=1e-11, max_iterations=200)
    found = solve(held, mesh=meshes, guess=guess, options=chosen, throw=False)
    return replace(found, problem=problem)


def _anchor_times(solution: Solution, name: str) -> Array:
    leg = solution.phases[name]
    return leg.breaks[list(leg.mesh.anchors)]


def _collapse(
    samples: PhaseSamples, structure: PhaseStructure, swapped: set[tuple[str, PhaseStructure]]
) -> tuple[PhaseStructure | None, str]:
    """Return the structure after a piece has vanished and what was done, or None if none has."""
    lengths = structure.lengths
    span = lengths.sum()
    shortest = int(np.argmin(lengths))
    if structure.pieces > 1 and lengths[shortest] < VANISHED * span:
        other = structure.swapped(shortest)
        key = (samples.leg.name, structure.at(()))
        if other is not None and key not in swapped:
            swapped.add(key)
            swapped.add((samples.leg.name, other.at(())))
            return _spread(other, shortest), f"switches {shortest} and {shortest + 1} swapped"
        return structure.without(shortest), f"piece {shortest + 1} dropped"
    return None, ""


def _complete(samples: PhaseSamples, structure: PhaseStructure) -> tuple[PhaseStructure | None, str]:
    """Return the structure with the arc that a wrong sign asks for and what was done, or None if all agree."""
    missing = _missing_arc(samples, structure)
    if missing is not None:
        channel, start, end, sign = missing
        label = samples.leg.controls.labels[channel]
        return structure.with_arc(channel, start, end, sign), f"arc of {label} added at {start:.4g} s"
    return None, ""


def _spread(structure: PhaseStructure, piece: int) -> PhaseStructure:
    """Give a swapped piece some length to start from."""
    times = np.asarray(structure.times)
    room = 1e-3 * (times[-1] - times[0])
    middle = 0.5 * (times[piece] + times[piece + 1])
    left = max(middle - 0.5 * room, 0.5 * (times[piece - 1] + middle))
    right = min(middle + 0.5 * room, 0.5 * (times[piece + 2] + middle))
    times[piece], times[piece + 1] = left, right
    return structure.at(tuple(float(t) for t in times))


def _missing_arc(samples: PhaseSamples, structure: PhaseStructure) -> tuple[int, float, float, int] | None:
    """Return (channel, start, end, sign) where a control on a bound has the worst wrong sign."""
    affine = affine_channels(samples)
    gradient = samples.control_gradient * samples.control_scale[:, None] / samples.hamiltonian_scale
    pieces = np.clip(
        np.searchsorted(structure.times, samples.times, side="right") - 1, 0, structure.pieces - 1
    )
    pieces[samples.at_end] = samples.leg.mesh.segment_arcs[samples.segments[samples.at_end]]
    signs = structure.matrix()[:, pieces]
    offence = np.where(affine[:, None] & (signs != 0), signs * gradient, 0.0)
    for i in range(offence.shape[0]):
        _forgive_own_switches(offence[i], signs[i])
    i, j = (int(v) for v in np.unravel_index(int(np.argmax(offence)), offence.shape))
    if offence[i, j] < WRONG_SIGN:
        return None
    wrong = offence[i] > 0
    first, last = j, j
    while first > 0 and wrong[first - 1] and signs[i, first - 1] == signs[i, j]:
        first -= 1
    while last < wrong.size - 1 and wrong[last + 1] and signs[i, last + 1] == signs[i, j]:
        last += 1
    value = switching(samples, i)
    times = samples.times
    start = times[0] if first == 0 else _root(value, times[first - 1], times[first])
    end = times[-1] if last == times.size - 1 else _root(value, times[last], times[last + 1])
    return i, float(start), float(end), -int(signs[i, j])


def _forgive_own_switches(offence: Array, signs: Signs) -> None:
    """Zero the offences that reach up to one of the channel's own switches.

    There the switching function vanishes at the optimum, and what is left of it is rounding and mesh error.
    """
    for j in np.flatnonzero(signs[1:] != signs[:-1]):
        k = int(j)
        while k >= 0 and offence[k] > 0:
            offence[k] = 0.0
            k -= 1
        k = int(j) + 1
        while k < offence.size and offence[k] > 0:
            offence[k] = 0.0
            k += 1


def _grow(
    samples: PhaseSamples, structure: PhaseStructure, degrees: list[int], tol: float
) -> list[int] | None:
    """Return higher degrees where the dynamics or the costates are not met between the nodes."""
    rates = samples.functions.rates(samples.times, samples.x, samples.u_polynomial)
    errors = samples.per_segment(samples.x_rate - rates) / samples.state_scale[:, None]
    gradient = samples.functions.state_gradient(samples.times, samples.x, samples.u, samples.lam, samples.mu)
    residual = samples.per_segment(samples.lam_rate + gradient + samples.state_multiplier)
    worth = samples.state_scale[:, None] / samples.cost_scale
    worst = np.maximum(np.max(errors, axis=0), np.max(residual * worth, axis=0))
    wanted = [min(d + 3, MAX_DEGREE) if e > tol else d for d, e in zip(degrees, worst, strict=True)]
    return wanted if wanted != degrees else None
