r"""Reduced Hessian: second-order condition on the mesh, curvature of the Lagrangian on the critical cone.

At a local minimum of the transcribed program with multipliers :math:`\lambda` (Nocedal & Wright, Numerical
Optimization, 2006, theorems 12.5 and 12.6)

.. math:: d^T \nabla^2 \mathcal L\, d \ge 0 \quad\text{for all } d \text{ in the critical cone}:
          \quad \nabla g_C\, d = 0, \quad d_P = 0,

with the rows C and variables P at their limits; > 0 for all nonzero d is sufficient. The cone contains the space in
which weakly active limits (multiplier zero) are equalities, and is contained in the space without these limits.

The smallest curvature is that of variations of size 1,

.. math:: |d|^2 = \int \Big(\frac{\delta x}{x}\Big)^2 + \Big(\frac{\delta u}{u}\Big)^2
          + \text{squares of varied ends, times and parameters}

relative to their magnitudes; for this norm the second variation of a regular problem is bounded below (Maurer &
Pickenhain, J. Optim. Theory Appl. 86(3), 1995). It is computed by Lanczos' method for
:math:`(\nabla^2\mathcal L + \sigma)^{-1}`, restricted to the null space by one sparse factorisation (Golub & Van
Loan, Matrix Computations, 2013, sec. 10.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy

from gnc_opt.array_types import Array, Mask
from gnc_opt.numerical_tolerances import AT_LIMIT, MINOR, NEGLIGIBLE, NOTABLE, ROUNDING, SMALL
from gnc_opt.planning.optimality.active_state_constraints import impose_touch_points
from gnc_opt.planning.optimality.cost_and_endpoint_scales import compute_state_ranges
from gnc_opt.planning.optimality.kkt_system import NullSpace, ProgramPoint, compute_curvature, run_lanczos
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.optimality_verdict import Condition, ConditionResult
from gnc_opt.planning.solution.phase_trajectory_samples import COSTATE_MIN_SHARE_OF_COST, PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_summary import time_unit
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.scaling import choose_variable_scales
from gnc_opt.planning.transcription.transcription import Transcription
from gnc_opt.planning.verification.critical_cone import (
    CriticalCone,
    fix_constraints_at_arc_entries,
    fix_vector_control_directions,
)
from gnc_opt.planning.verification.goh_transformation import (
    find_cost_reducing_final_pulse,
    mask_singular_samples,
    mask_singular_segments,
    mask_zero_hamiltonian_curvature,
    refine_mesh_at_singular_arc_ends,
    transform_to_goh_variables,
)

PHASE_MIN_POINTS = 30
"""Smallest number of collocation points of a phase; the mesh of a simple solution is too coarse for variations."""

FEATURE_CELLS = 4
"""Number of sampling cells near a narrow feature that form a segment of the mesh for variations."""

HESSIAN_SHIFT = 0.1
"""Shift, as a share of the median Hessian row; large compared with curvatures that count as zero."""

STEEP_MIN_RATIO = 1e4
"""Multiple of the median row; larger curvatures are computed separately, as the inverse does not resolve them."""

LANCZOS_STEPS = 80
"""Number of Lanczos steps; the extreme eigenvalues of a compact operator converge much earlier."""

GAIN_STEP_SHARE = 0.1
"""Step, relative to the magnitudes, for which the decrease of the cost is reported."""


@dataclass(frozen=True, eq=False)
class Curvature:
    """Smallest curvature of the Lagrangian on a linear space of variations.

    ``value`` is relative to the median norm of the Hessian rows, NaN without degrees of freedom; ``share`` relative to
    the sum of its terms. ``direction`` (n_variables,) is scaled, with largest component 1. ``gain``
    is the decrease of the cost by a step of `GAIN_STEP_SHARE`, ``least_gain`` the smallest decrease above rounding.
    """

    value: float
    share: float
    direction: Array
    gain: float
    least_gain: float = 0.0

    @property
    def is_positive(self) -> bool:
        return self.value > NEGLIGIBLE and self.share > AT_LIMIT

    def is_negative(self, threshold: float) -> bool:
        """Return whether the curvature is certainly negative: below -``threshold``, with a decrease above rounding."""
        return self.value < -threshold and self.share < -AT_LIMIT and self.gain >= self.least_gain


def build_critical_cone(solution: Solution, samples: Sequence[PhaseSamples], rounding: float) -> CriticalCone:
    """Return the critical cone of a solution, on a mesh that is fine enough for variations.

    Variations are scaled by the ranges of states and controls along a phase; ``rounding`` is that of the cost.
    """
    meshes = {
        name: _increase_mesh_degrees_for_variations(phase.mesh) for name, phase in solution.phases.items()
    }
    for s in samples:
        meshes[s.phase.name] = _refine_mesh_at_singular_arcs(solution, s, meshes[s.phase.name])

    def choose_variation_scales(transcription: Transcription, problem: Problem, x: Array) -> Array:
        scales = choose_variable_scales(transcription, problem, x)
        for s in samples:
            part = transcription.parts[s.phase.name]
            for states in (part.collocation.boundary_states, part.collocation.point_states):
                scales[states] = compute_state_ranges(s)[:, None]
            scales[part.collocation.point_controls] = s.control_span[:, None]
            scales[part.times[part.times < transcription.n_variables]] = s.span
        return scales

    point = ProgramPoint.from_solution(solution, meshes, choose_variation_scales, rounding)
    cone = fix_vector_control_directions(CriticalCone.from_program_point(point), samples)
    return fix_constraints_at_arc_entries(transform_to_goh_variables(cone, samples), samples)


def estimate_cost_rounding_error(samples: Sequence[PhaseSamples]) -> float:
    """Return the rounding error of the cost: the share `COSTATE_MIN_SHARE_OF_COST` of its magnitude."""
    return COSTATE_MIN_SHARE_OF_COST * max((s.cost_magnitude for s in samples), default=0.0)


def check_reduced_hessian(solution: Solution, samples: list[PhaseSamples], cone: CriticalCone) -> Condition:
    """Return the condition that no variation in the critical cone lowers the cost to second order."""
    meaning = (
        "The cost must have positive curvature along every variation of controls, times and parameters that satisfies "
        "the active limits. The margin is the smallest curvature of the Lagrangian on the solution's mesh, relative to "
        "the median row of its Hessian. If it is negative, a nearby trajectory has a lower cost."
    )
    condition = partial(Condition, "second order", tolerance=-NEGLIGIBLE, meaning=meaning, sufficient=True)
    # Less curvature may come from first-order errors, or along singular arcs from oscillation between the nodes.
    threshold = NOTABLE if any(map(_has_partly_singular_segment, samples)) else MINOR
    location, pulse_curvature = min(
        (find_cost_reducing_final_pulse(cone, s) for s in samples),
        key=lambda end: end[1],
        default=("", np.inf),
    )
    if pulse_curvature < -MINOR:
        return condition(ConditionResult.FAIL, -pulse_curvature, where=location)
    space = cone.unit, cone.extra_rows
    strong = minimise_curvature(cone.point, cone.strong, *space)
    if np.isnan(strong.value) or strong.is_positive:
        if not solution.structure:
            location = _find_bang_bang_control(samples) or location
        result = ConditionResult.INCONCLUSIVE if location else ConditionResult.PASS
        if np.isnan(strong.value):
            location = location or "no degree of freedom: the conditions determine all unknowns"
            return condition(result, 0.0, tolerance=0.0, where=location)
        direction_text = _describe_largest_variation_component(cone.point, solution, strong.direction)
        return condition(result, -strong.value, where=location or direction_text)
    # With weakly active limits as equalities the space is smaller; negative curvature there is in the cone.
    full = minimise_curvature(cone.point, cone.strong | cone.weak, *space) if np.any(cone.weak) else strong
    for curvature in (strong, full):
        is_in_cone = (cone.is_direction_in_cone(sign * curvature.direction, samples) for sign in (1.0, -1.0))
        if curvature.is_negative(threshold) and any(is_in_cone):
            direction_text = _describe_largest_variation_component(cone.point, solution, curvature.direction)
            result, reason = ConditionResult.FAIL, _describe_cost_decrease(curvature)
            if cone.is_curvature_multiplier_dependent(curvature.direction):
                result, reason = ConditionResult.INCONCLUSIVE, ": the multipliers are not unique"
            return condition(result, -curvature.value, where=direction_text + reason)
    direction_text = _describe_largest_variation_component(cone.point, solution, strong.direction)
    reason = _explain_inconclusive_curvature(strong, threshold)
    return condition(ConditionResult.INCONCLUSIVE, -strong.value, where=direction_text + reason)


def _describe_cost_decrease(curvature: Curvature) -> str:
    return f": a variation by {100 * GAIN_STEP_SHARE:.0f} % of the magnitudes lowers the cost by {curvature.gain:.3g}"


def _explain_inconclusive_curvature(curvature: Curvature, threshold: float) -> str:
    if curvature.is_negative(threshold):
        return ": the curvature is negative, but limits may exclude this variation"
    if curvature.value < -threshold and 0.0 < curvature.gain < curvature.least_gain:
        return f"{_describe_cost_decrease(curvature)}, which is within rounding"
    return (
        f": curvature cannot be distinguished from zero (least eigenvalue -{threshold:.0e} to {NEGLIGIBLE:.0e}); "
        "no direction that lowers the cost was found: refine the mesh or prescribe the arcs"
    )


def _increase_mesh_degrees_for_variations(mesh: Mesh) -> Mesh:
    min_degree = -(-PHASE_MIN_POINTS // mesh.segments)
    return Mesh(mesh.breaks, tuple(max(n, min_degree) for n in mesh.degrees), mesh.movable)


def _refine_mesh_at_singular_arcs(solution: Solution, s: PhaseSamples, mesh: Mesh) -> Mesh:
    """Return a mesh on which variations may jump along singular arcs, else one that resolves narrow features.

    Near active limits a finer mesh would have weakly active nodes; if arcs are prescribed, the mesh is unchanged.
    """
    singular, edges = np.any(mask_singular_segments(s), axis=0), s.feature_edges[::FEATURE_CELLS]
    has_limit = np.any(np.vstack([*s.is_at_control_bounds, s.mu != 0, s.state_multiplier != 0]), axis=0)
    is_near_limit = np.convolve(s.segment_maxima(has_limit), np.ones(3), "same") > 0
    edges = edges[~is_near_limit[np.searchsorted(s.phase.breaks, edges, "right") - 1]]
    is_fixed = impose_touch_points(solution).phases[s.phase.name].numbers.arcs is not None
    if is_fixed or not (np.any(singular) or edges.size):
        return mesh
    if np.any(singular):
        return refine_mesh_at_singular_arc_ends(mesh, singular)
    breaks = np.union1d(mesh.breaks, np.interp(edges, s.phase.breaks, mesh.breaks))
    degrees = np.take(mesh.degrees, np.searchsorted(mesh.breaks, breaks[:-1], "right") - 1)
    movable = np.searchsorted(breaks, np.take(mesh.breaks, mesh.movable))
    return Mesh(tuple(breaks.tolist()), tuple(degrees.tolist()), tuple(movable.tolist()))


def _find_bang_bang_control(samples: list[PhaseSamples]) -> str:
    """Return a text that names a control with jumps between its bounds at times that are not variables; else ""."""
    for s in samples:
        lower, upper = s.is_at_control_bounds
        open_to_both = mask_zero_hamiltonian_curvature(s)
        changes = (np.diff(lower, axis=1) | np.diff(upper, axis=1)) & ~np.isin(
            s.times[1:], s.phase.breaks[list(s.phase.mesh.movable)]
        )
        at_both = np.any(lower & open_to_both, axis=1) & np.any(upper & open_to_both, axis=1)
        jumps = at_both & np.any(changes, axis=1)
        if np.any(jumps):
            label = s.phase.controls.labels[int(np.argmax(jumps))]
            return f"phase {s.phase.name}, {label}: switching times are not variables of the mesh"
    return ""


def _has_partly_singular_segment(s: PhaseSamples) -> bool:
    """Return whether a control is singular on a part of a segment, which has no Goh transformation."""
    return bool(np.any(mask_singular_samples(s) & ~mask_singular_segments(s)[:, s.segments]))


def _describe_largest_variation_component(point: ProgramPoint, solution: Solution, direction: Array) -> str:
    size = np.abs(direction)
    for name, part in point.transcription.parts.items():
        phase, indices = solution.phases[name], part.collocation.point_controls
        if indices.size and np.max(size[indices]) >= np.max(size):
            i, j = np.unravel_index(np.argmax(size[indices]), indices.shape)
            time = phase.initial_time + part.collocation.normalised_point_times[j] * phase.duration
            return f"phase {name}, t = {time:.6g} {time_unit(solution)}, {phase.controls.labels[i]}"
    return point.variables.labels[int(np.argmax(size))]


def minimise_curvature(point: ProgramPoint, fixed: Mask, unit: Any = None, extra: Any = None) -> Curvature:
    """Return the smallest curvature of the Lagrangian with ``fixed`` (n_variables + n_constraints,) fixed."""
    space = NullSpace.with_fixed_variables(point, fixed, unit, extra)
    hessian = space.project_to_null_space(point.lagrangian_hessian)
    untransformed = (
        hessian
        if unit is None
        else NullSpace.with_fixed_variables(point, fixed).project_to_null_space(point.lagrangian_hessian)
    )
    row_norms = np.sqrt(np.asarray((untransformed**2).sum(axis=1)))
    # A single large row, e.g. of a parameter far from its origin, is not representative.
    typical = float(np.median(row_norms[row_norms > 0])) if np.any(row_norms > 0) else 1.0
    typical = max(typical, point.rounding)  # with vanishing costates, rows are not larger
    # Rows of the integrals of control variations (Goh) are steep.
    steep = bool(np.max(row_norms, initial=0.0) >= STEEP_MIN_RATIO * typical)
    direction = _find_direction_of_least_curvature(space, hessian / typical, steep)
    if direction is None:
        return Curvature(float("nan"), float("nan"), np.zeros(point.x.size), 0.0)
    curvature, share = compute_curvature(hessian, direction)
    variation = np.asarray(space.unit @ direction)
    # Integrals (Goh) may have high peaks, which determine the step only if no single variable varies.
    is_single, magnitudes = np.diff(scipy.sparse.csr_array(space.unit).indptr) <= 1, np.abs(variation)
    largest = float(np.max(magnitudes[is_single], initial=0.0))
    if largest <= ROUNDING * np.max(magnitudes):
        largest = float(np.max(magnitudes))
    gain = -0.5 * curvature * (GAIN_STEP_SHARE / largest) ** 2 / point.scaling.objective
    # Relative to the median row, which is small for inactive controls.
    least_gain = SMALL * point.rounding / point.scaling.objective
    return Curvature(curvature / typical, share, variation / largest, gain, least_gain)


def _find_direction_of_least_curvature(
    space: NullSpace, hessian: Any, steep: bool, shift: float = HESSIAN_SHIFT
) -> Array | None:
    """Return the direction of smallest curvature (unit length) in a null space, or None if that is 0."""
    n = hessian.shape[0]
    if n == 0:
        return None
    if steep and (steep_direction := _find_negative_curvature_direction(space, hessian)) is not None:
        return steep_direction
    inverse = space.invert_projected_hessian(hessian + shift * scipy.sparse.eye_array(n))
    start_vector = inverse(np.random.default_rng(0).standard_normal(n))
    values, vectors = run_lanczos(inverse, start_vector, LANCZOS_STEPS)
    if not values.size or np.max(np.abs(values)) * shift < NEGLIGIBLE:
        return None
    # 1 / (curvature + shift) is negative for curvatures below -shift, else largest for the smallest curvature.
    is_negative = values < -NEGLIGIBLE * np.max(np.abs(values))
    vector = vectors[:, np.argmin(values)] if np.any(is_negative) else vectors[:, np.argmax(values)]
    direction = inverse(vector)
    direction = np.asarray(direction / np.linalg.norm(direction))
    value = float(direction @ (hessian @ direction))
    if NEGLIGIBLE < value < NOTABLE * shift:  # a negative curvature far below the shift is not distinguished
        refined = _find_direction_of_least_curvature(space, hessian, False, value)
        if refined is not None and refined @ (hessian @ refined) < 0:
            return refined
    return direction


def _find_negative_curvature_direction(space: NullSpace, hessian: Any) -> Array | None:
    """Return a direction of large negative curvature, which the inverse does not resolve; None without one."""
    project = space.invert_projected_hessian()
    start = project(hessian @ project(np.random.default_rng(0).standard_normal(hessian.shape[0])))
    values, vectors = run_lanczos(lambda v: project(hessian @ project(v)), start, LANCZOS_STEPS)
    if not values.size or values[0] > -max(STEEP_MIN_RATIO, NEGLIGIBLE * float(np.max(np.abs(values)))):
        return None
    return np.asarray(project(vectors[:, 0]))
