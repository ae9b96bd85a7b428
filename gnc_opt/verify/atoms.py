r"""Atoms of a trajectory's path constraints: pushes of no duration, which a program's rows do not have.

Where a constraint :math:`c(t, x) \le 0` without controls is touched, reached or left, its multiplier is a measure with
an atom :math:`\eta \ge 0`: the costate jumps by :math:`-\eta\,\partial c/\partial x` (Hartl, Sethi & Vickson, SIAM
Review 37(2), 1995, theorem 4.1). A program has rows for path constraints at its collocation points only, so that the
terms :math:`\eta\,c(t_k, x_k)` at the boundaries of its segments are added to its Lagrangian: at the ends of arcs of
order two or more (of order one an arc is entered and left without), at touches, and at the ends of the phase.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from gnc_opt.arrays import Array, Indices, Mask
from gnc_opt.problem.constraint_order import constraint_order
from gnc_opt.problem.functions import PhaseFunctions, phase_functions
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.extract import model_parameters
from gnc_opt.transcription.mesh import Mesh
from gnc_opt.transcription.numbering import PhasePart
from gnc_opt.transcription.transcription import Transcription
from gnc_opt.verify.pushes import path_gradients
from gnc_opt.verify.trajectory_fit import FittedPhase


@dataclass(frozen=True)
class Trajectory:
    """A trajectory without multipliers.

    Attributes
    ----------
    problem : Problem
    phases : mapping of FittedPhase
    q : array (n_parameters,)
        Free parameters.
    scales : array (n_variables,)
        What the variables of its program vary by.
    near : float
        Distance from a limit, in shares of its scale, within which it may push.
    """

    problem: Problem
    phases: Mapping[str, FittedPhase]
    q: Array
    scales: Array
    near: float


@dataclass(frozen=True)
class Atoms:
    """Where path constraints without controls may push at a boundary of segments.

    Attributes
    ----------
    gradients : sparse array (n_variables, n_atoms)
        Of the constraints, by the program's variables.
    sizes : array (n_atoms,)
        What a constraint varies by.
    at_lower, at_upper : bool array (n_atoms,)
    """

    gradients: Any
    sizes: Array
    at_lower: Mask
    at_upper: Mask

    @classmethod
    def of(cls, transcription: Transcription, trajectory: Trajectory) -> Atoms:
        """Find them along a trajectory."""
        found = [cls._none(transcription.n_variables)]
        problem = trajectory.problem
        for name, part in transcription.parts.items():
            leg = problem.phases[name]
            orders = [constraint_order(problem, leg, i).order for i in range(len(leg.path_labels))]
            pure = np.flatnonzero([order != 0 for order in orders])
            if pure.size:
                touched_only = np.array([orders[i] == 1 for i in pure])
                found.append(_of_phase(transcription, part, trajectory, pure, touched_only))
        return cls(
            scipy.sparse.hstack([atoms.gradients for atoms in found], format="csc"),
            *(
                np.concatenate([getattr(a, name) for a in found])
                for name in ("sizes", "at_lower", "at_upper")
            ),
        )

    @classmethod
    def _none(cls, n_variables: int) -> Atoms:
        nowhere = np.zeros(0, dtype=bool)
        return cls(scipy.sparse.csc_array((n_variables, 0)), np.zeros(0), nowhere, nowhere)


def path_gradients_at_boundaries(
    transcription: Transcription, part: PhasePart, functions: PhaseFunctions, at: tuple[Array, Array, Array]
) -> tuple[Indices, Array]:
    """Gradients of path constraints at the boundaries of a phase's segments, by the program's variables.

    Parameters
    ----------
    at : (K + 1,), (n_states, K + 1), (n_controls, K + 1)
        Times, states and controls at the boundaries.

    Returns
    -------
    places : int array (k, K + 1)
        Variables of the program: states, free times, free parameters.
    gradients : array (k, n_paths, K + 1)
    """
    collocation, n = part.collocation, at[0].size
    by_state, by_time, by_parameter = path_gradients(functions, collocation.n_paths, *at)
    free = part.times < transcription.n_variables
    others = np.concatenate([part.times[free], transcription.parameter_places])
    moved = _boundary_times(collocation.mesh)[free]
    return (
        np.vstack([collocation.boundary_states, np.repeat(others[:, None], n, axis=1)]),
        np.concatenate([by_state, moved[:, None] * by_time, by_parameter]),
    )


def _of_phase(
    transcription: Transcription, part: PhasePart, trajectory: Trajectory, pure: Indices, touched_only: Mask
) -> Atoms:
    problem, fitted, q, scales = trajectory.problem, trajectory.phases, trajectory.q, trajectory.scales
    leg, polynomials = problem.phases[part.name], fitted[part.name]
    times = polynomials.x.breaks
    # A shared value belongs to the segment that begins with it, but for the last one.
    x, u = (np.hstack([p(times[:-1]), p(times[-1:], "left")]) for p in (polynomials.x, polynomials.u))
    none = np.zeros(len(leg.integrands))
    functions = phase_functions(problem, part.name, model_parameters(problem, leg, q), q, none)
    places, gradients = path_gradients_at_boundaries(transcription, part, functions, (times, x, u))
    gradients = gradients[:, pure]
    sizes = np.sum(np.abs(gradients) * scales[places][:, None], axis=0)
    at_lower, at_upper = _at_limits(leg, functions.paths(times, x, u)[pure], pure, trajectory.near * sizes)
    chosen = _may_push(at_lower | at_upper, touched_only)
    which, k = np.nonzero(chosen)
    columns = np.tile(np.arange(which.size), places.shape[0])
    return Atoms(
        scipy.sparse.csc_array(
            (gradients[:, which, k].ravel(), (places[:, k].ravel(), columns)), shape=(scales.size, which.size)
        ),
        sizes[chosen],
        at_lower[chosen],
        at_upper[chosen],
    )


def _at_limits(leg: Phase, values: Array, pure: Indices, slack: Array) -> tuple[Mask, Mask]:
    limits: Interval = leg.path_interval()
    return values <= limits.lower[pure, None] + slack, values >= limits.upper[pure, None] - slack


def _may_push(active: Mask, touched_only: Mask) -> Mask:
    """Where active constraints (n, K + 1) may have an atom: not within arcs, nor at the ends of some constraints'."""
    before, after = np.zeros_like(active), np.zeros_like(active)
    before[:, 1:], after[:, :-1] = active[:, :-1], active[:, 1:]
    beside = np.where(touched_only[:, None], before | after, before & after)
    beside[:, [0, -1]] = False
    return np.asarray(active & ~beside)


def _boundary_times(mesh: Mesh) -> Array:
    """By how much each boundary moves with each anchor in time (n_anchors, K + 1)."""
    fractions = np.asarray(mesh.breaks)
    anchors = fractions[list(mesh.anchors)]
    return np.array([np.interp(fractions, anchors, one) for one in np.eye(anchors.size)])
