r"""Second order on the solution's mesh: curvature of the Lagrangian along what the active limits leave free.

At a local minimum of the transcribed program with multipliers :math:`\lambda` (Nocedal & Wright, Numerical
Optimization, 2006, theorems 12.5 and 12.6)

.. math:: d^T \nabla^2 \mathcal L\, d \ge 0 \quad\text{for all } d \text{ in the critical cone}:
          \quad \nabla g_C\, d = 0, \quad d_P = 0,

rows C and variables P being those on their limits; > 0 for all of them but zero is sufficient. The cone lies
between the space where weakly active limits (multiplier zero) bind and the one where they do not.

The least curvature is that of variations of size 1,

.. math:: |d|^2 = \int \Big(\frac{\delta x}{x}\Big)^2 + \Big(\frac{\delta u}{u}\Big)^2
          + \text{squares of varied ends, times and parameters}

in shares of their magnitudes, in which the second variation of a regular problem is bounded below (Maurer &
Pickenhain, J. Optim. Theory Appl. 86(3), 1995). It is found by Lanczos' method on
:math:`(\nabla^2\mathcal L + \sigma)^{-1}`, restricted to the null space by one sparse factorisation (Golub & Van
Loan, Matrix Computations, 2013, sec. 10.3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from gnc_opt.arrays import Array, Mask
from gnc_opt.planning.optimality.active_set import add_touch_points
from gnc_opt.planning.optimality.cost_scale import compute_state_variations
from gnc_opt.planning.optimality.kkt import NullSpace, compute_curvature, run_lanczos
from gnc_opt.planning.optimality.nlp_point import ProgramPoint
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.samples import COSTATE_MIN_SHARE_OF_COST, PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.summary import time_unit
from gnc_opt.planning.solution.verdict import Condition, ConditionResult
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.scaling import choose_variable_scales
from gnc_opt.planning.transcription.transcription import Transcription
from gnc_opt.planning.verification.critical_cone import (
    CriticalCone,
    fix_constraints_at_arc_entries,
    fix_inactive_directions,
)
from gnc_opt.planning.verification.goh_transformation import (
    find_improving_final_control,
    mask_singular_samples,
    mask_singular_segments,
    mask_zero_curvature,
    refine_singular_arc_ends,
    transform_to_goh_variables,
)
from gnc_opt.tolerances import AT_LIMIT, NEGLIGIBLE, NOTABLE, ROUNDING, SMALL

PHASE_MIN_POINTS = 30
"""Collocation points that a phase has at least: the mesh of a solution that is simple has no room for variations."""

DOWNWARDS = 1e-4
"""Downward curvature, in shares of the Hessian's middle row, that counts: above the effect of first-order errors,
those of the mesh between active limits included. Where a control is singular quadrature may take one that alternates
from node to node for one that gains something: there `NOTABLE` counts."""

SHIFT = 0.1
"""The shift, in shares of the Hessian's middle row: large beside curvatures that are as good as none."""

STEEP = 1e4
"""Curvatures beyond this, in shares of the middle row, are looked for by themselves: their inverses vanish."""

LANCZOS_STEPS = 80
"""Steps of Lanczos' method; the ends of the spectrum of a compact operator settle in far fewer."""

GAIN_STEP_SHARE = 0.1
"""Step, in shares of the magnitudes, for which the gain is given."""


@dataclass(frozen=True, eq=False)
class Curvature:
    """The least curvature of the Lagrangian on a linear space of variations.

    Attributes
    ----------
    value : float
        In shares of the Hessian's middle row (the median of their sizes); NaN if nothing is left to vary.
    share : float
        In shares of the terms that add up to it.
    direction : array (n_variables,)
        Scaled, its largest component 1.
    gain : float
        What a step of `GAIN_STEP_SHARE` along it takes from the minimised cost, physical.
    least_gain : float
        What that is at least if it is no rounding, physical.
    """

    value: float
    share: float
    direction: Array
    gain: float
    least_gain: float = 0.0

    @property
    def is_positive(self) -> bool:
        return self.value > NEGLIGIBLE and self.share > AT_LIMIT

    def is_negative(self, steep: float) -> bool:
        """Whether it is shown to be negative, by more than ``steep`` and by what gains something."""
        return self.value < -steep and self.share < -AT_LIMIT and self.gain >= self.least_gain


def build_critical_cone(
    solution: Solution,
    samples: Sequence[PhaseSamples] = (),
    rounding: float = 0.0,
    sizes: Callable[[PhaseSamples], tuple[Array, Array]] | None = None,
) -> CriticalCone:
    """Return what is free to vary along a solution, on a mesh with room for it.

    ``rounding`` is the cost below which differences are rounding; ``sizes`` returns variations of 1 in the states (n,)
    and controls (m,) of a phase (default: the magnitudes of the program).
    """
    meshes = {name: _refine_mesh_for_variations(leg.mesh) for name, leg in solution.phases.items()}
    meshes |= {s.leg.name: _refine_mesh_along_singular_arcs(solution, s, meshes[s.leg.name]) for s in samples}

    def scales(transcription: Transcription, problem: Problem, x: Array) -> Array:
        found = choose_variable_scales(transcription, problem, x)
        if sizes is None:
            return found
        for s in samples:
            part = transcription.parts[s.leg.name]
            states, controls = sizes(s)
            for places in (part.collocation.boundary_states, part.collocation.point_states):
                found[places] = states[:, None]
            found[part.collocation.point_controls] = controls[:, None]
            found[part.times[part.times < transcription.n_variables]] = s.span
        return found

    cone = CriticalCone.from_program_point(ProgramPoint.from_solution(solution, meshes, scales, rounding))
    if sizes is not state_and_control_spans:
        return cone
    return fix_constraints_at_arc_entries(
        transform_to_goh_variables(fix_inactive_directions(cone, samples), samples), samples
    )


def state_and_control_spans(s: PhaseSamples) -> tuple[Array, Array]:
    """Return what states and controls move along a phase."""
    return compute_state_variations(s), s.control_span


def cost_rounding_error(samples: Sequence[PhaseSamples]) -> float:
    """Return the cost below which differences are rounding: the share `COSTATE_MIN_SHARE_OF_COST` of what
    it amounts to."""
    return COSTATE_MIN_SHARE_OF_COST * max((s.cost_magnitude for s in samples), default=0.0)


def check_reduced_hessian(solution: Solution, samples: list[PhaseSamples], cone: CriticalCone) -> Condition:
    """No variation that keeps the active limits lowers the cost to second order."""
    name = "second order"
    meaning = (
        "Along every variation of controls, times and parameters that keeps the active limits, the cost must curve "
        "upwards (value: least curvature of the Lagrangian on the solution's mesh with the sign reversed, in shares "
        "of its middle row); where it curves downwards, a cheaper trajectory is nearby."
    )

    def second_order_condition(
        result: ConditionResult, value: float, where: str, tolerance: float = -NEGLIGIBLE
    ) -> Condition:
        return Condition(name, result, value, tolerance, where, meaning, sufficient=True)

    steep = NOTABLE if any(map(_has_partly_singular_segment, samples)) else DOWNWARDS
    beyond, least = min(
        (find_improving_final_control(cone, s) for s in samples), key=lambda end: end[1], default=("", np.inf)
    )
    if least < -DOWNWARDS:
        return second_order_condition(ConditionResult.FAIL, -least, beyond)
    rest = cone.unit, cone.further
    free = minimise_curvature(cone.point, cone.strong, *rest)
    if np.isnan(free.value) or free.is_positive:
        jumping = "" if solution.structure else _find_bang_bang_control(samples)
        beyond = jumping or beyond
        result = ConditionResult.INCONCLUSIVE if beyond else ConditionResult.PASS
        if np.isnan(free.value):
            return second_order_condition(
                result, 0.0, beyond or "no degree of freedom, as many conditions as unknowns", 0.0
            )
        return second_order_condition(
            result, -free.value, beyond or _locate_direction(cone.point, solution, free.direction)
        )
    # Where weakly active limits bind as well, less is left to vary; what is downwards there is so in the cone.
    bound = minimise_curvature(cone.point, cone.strong | cone.weak, *rest) if np.any(cone.weak) else free
    for found in (free, bound):
        admitted = (cone.admits_direction(sign * found.direction, samples) for sign in (1.0, -1.0))
        if found.is_negative(steep) and any(admitted):
            place = _locate_direction(cone.point, solution, found.direction)
            return second_order_condition(ConditionResult.FAIL, -found.value, place + _describe_gain(found))
    place = _locate_direction(cone.point, solution, free.direction)
    return second_order_condition(
        ConditionResult.INCONCLUSIVE, -free.value, place + _describe_zero_curvature(free, steep)
    )


def _describe_gain(curvature: Curvature) -> str:
    return (
        f": a step of {100 * GAIN_STEP_SHARE:.0f} % of its magnitude gains {curvature.gain:.3g} in the cost"
    )


def _describe_zero_curvature(curvature: Curvature, steep: float) -> str:
    if curvature.is_negative(steep):
        return ": limits that are only just active, or the values between the nodes, may forbid to go there"
    if curvature.value < -steep and 0.0 < curvature.gain < curvature.least_gain:
        return f"{_describe_gain(curvature)}, which is rounding"
    return f": flat (curvatures between -{steep:.0e} and {NEGLIGIBLE:.0e} count as zero)"


def _refine_mesh_for_variations(mesh: Mesh) -> Mesh:
    """Return a mesh with room for variations, where that of a solution that is simple has none."""
    least = -(-PHASE_MIN_POINTS // mesh.segments)
    return Mesh(mesh.breaks, tuple(max(n, least) for n in mesh.degrees), mesh.movable)


def _refine_mesh_along_singular_arcs(solution: Solution, s: PhaseSamples, mesh: Mesh) -> Mesh:
    """Return a mesh on which variations along singular arcs may jump, unless arcs are held segment by segment."""
    singular = np.any(mask_singular_segments(s), axis=0)
    if not np.any(singular) or add_touch_points(solution).phases[s.leg.name].numbers.arcs is not None:
        return mesh
    return refine_singular_arc_ends(mesh, singular)


def _find_bang_bang_control(samples: list[PhaseSamples]) -> str:
    """Name a control that reaches both bounds without H curving in it: its switch times vary, and the mesh is fixed."""
    for s in samples:
        lower, upper = s.at_control_bounds
        open_to_both = mask_zero_curvature(s)
        changes = (np.diff(lower, axis=1) | np.diff(upper, axis=1)) & ~np.isin(
            s.times[1:], s.leg.breaks[list(s.leg.mesh.movable)]
        )
        jumps = np.any(lower & open_to_both, axis=1) & np.any(upper & open_to_both, axis=1)
        jumps &= np.any(changes, axis=1) & ~s.leg.control_bounds.fixed
        if np.any(jumps):
            label = s.leg.controls.labels[int(np.argmax(jumps))]
            return f"phase {s.leg.name}, {label}: switch times that are not variables of the mesh do not vary"
    return ""


def _has_partly_singular_segment(s: PhaseSamples) -> bool:
    """Whether a control is singular in a segment without being so all along it: no integral stands for it there."""
    return bool(np.any(mask_singular_samples(s) & ~mask_singular_segments(s)[:, s.segments]))


def _locate_direction(point: ProgramPoint, solution: Solution, direction: Array) -> str:
    size = np.abs(direction)
    for name, part in point.transcription.parts.items():
        leg, places = solution.phases[name], part.collocation.point_controls
        if places.size and np.max(size[places]) >= np.max(size):
            i, j = np.unravel_index(np.argmax(size[places]), places.shape)
            time = leg.initial_time + part.collocation.fractions[j] * leg.duration
            return f"phase {name}, t = {time:.6g} {time_unit(solution)}, {leg.controls.labels[i]}"
    return point.variables.labels[int(np.argmax(size))]


def minimise_curvature(point: ProgramPoint, held: Mask, unit: Any = None, further: Any = None) -> Curvature:
    """Return the least curvature of the Lagrangian where ``held`` (n_variables + n_constraints,) do not vary."""
    space = NullSpace.with_fixed(point, held, unit, further)
    hessian = space.project_hessian(point.lagrangian_hessian)
    plain = (
        hessian
        if unit is None
        else NullSpace.with_fixed(point, held).project_hessian(point.lagrangian_hessian)
    )
    sizes = np.sqrt(np.asarray((plain**2).sum(axis=1)))
    # The one row of a parameter far from its origin, however large, is not what variations are worth.
    typical = float(np.median(sizes[sizes > 0])) if np.any(sizes > 0) else 1.0
    typical = max(typical, point.rounding)  # where costates vanish, no row is more than that
    # Integrals of variations have steep rows of their own, whatever the variations themselves are worth.
    steep = bool(np.max(sizes, initial=0.0) >= STEEP * typical)
    direction = _find_least_curvature(space, hessian / typical, steep)
    if direction is None:
        return Curvature(float("nan"), float("nan"), np.zeros(point.x.size), 0.0)
    curvature, share = compute_curvature(hessian, direction)
    whole = space.expand_variation(direction)
    # What is varied by its integral may have peaks of any height; they count where nothing else varies.
    single, peaks = np.diff(scipy.sparse.csr_array(space.unit).indptr) <= 1, np.abs(whole)
    largest = float(np.max(peaks[single], initial=0.0))
    if largest <= ROUNDING * np.max(peaks):
        largest = float(np.max(peaks))
    gain = -0.5 * curvature * (GAIN_STEP_SHARE / largest) ** 2 / point.scaling.objective
    # However large in shares of the middle row: that one is next to nothing where controls are idle.
    least = SMALL * point.rounding / point.scaling.objective
    return Curvature(curvature / typical, share, whole / largest, gain, least)


def _find_least_curvature(space: NullSpace, hessian: Any, steep: bool = True) -> Array | None:
    """Return the direction of least curvature (unit length) in a null space, or None if that is 0."""
    n = hessian.shape[0]
    if n == 0:
        return None
    if steep and (found := _find_steep_direction(space, hessian)) is not None:
        return found
    inverse = space.projected_hessian_inverse(hessian + SHIFT * scipy.sparse.eye_array(n))
    start = inverse(np.random.default_rng(0).standard_normal(n))
    values, vectors = run_lanczos(inverse, start, LANCZOS_STEPS)
    if not values.size or np.max(np.abs(values)) * SHIFT < NEGLIGIBLE:
        return None
    # 1 / (curvature + shift): below -shift it is negative, and above it is largest where the curvature is least.
    downwards = values < -NEGLIGIBLE * np.max(np.abs(values))
    chosen = vectors[:, np.argmin(values)] if np.any(downwards) else vectors[:, np.argmax(values)]
    direction = inverse(chosen)
    return np.asarray(direction / np.linalg.norm(direction))


def _find_steep_direction(space: NullSpace, hessian: Any) -> Array | None:
    """Return the direction of a curvature so far below the middle row that its inverse is none, None without one."""
    project = space.projection_operator
    start = project(hessian @ project(np.random.default_rng(0).standard_normal(hessian.shape[0])))
    values, vectors = run_lanczos(lambda v: project(hessian @ project(v)), start, LANCZOS_STEPS)
    if not values.size or values[0] > -max(STEEP, NEGLIGIBLE * float(np.max(np.abs(values)))):
        return None
    direction = project(vectors[:, 0])
    return np.asarray(direction / np.linalg.norm(direction))
