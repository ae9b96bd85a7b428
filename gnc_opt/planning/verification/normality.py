r"""Normality: whether the cost has a say in the first-order conditions.

With a multiplier :math:`y_0` of the cost the conditions (Fritz John) read :math:`y_0 \nabla f + g'^T y = 0`; with
:math:`y_0 = 0` they say nothing of the cost, and the constraints alone single out the point: an abnormal extremal
(Clarke, Functional Analysis, Calculus of Variations and Optimal Control, 2013, sec. 22.2). That is so where the
gradients of what is active depend on each other, :math:`g'^T y = 0`, and the constraints do not: where
:math:`y^T g` curves along directions that the gradients leave free. Constraints that say the same thing twice depend on
each other as well, but do not curve there, and take nothing away.

With :math:`a = |g'^T y|` and b the largest curvature of :math:`y^T g`, for variations in shares of the magnitudes,
the linearised constraints hold for variations up to about a / b; beyond them their second order takes over.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from gnc_opt.arrays import Array
from gnc_opt.planning.optimality.kkt import NullSpace, lanczos, quadratic
from gnc_opt.planning.optimality.switching_problem import NOT_FLOWN, InducedProblem
from gnc_opt.planning.solution.verdict import Condition, ConditionResult
from gnc_opt.planning.verification.critical_cone import CriticalCone
from gnc_opt.tolerances import RANK, ROUNDING, TINY

DEGENERACY_MAX_RATIO = 1e4
"""Second order of the constraints beside the first from which they are degenerate: the linearised ones hold for
variations of less than 1e-4 of the magnitudes."""

CURVED = 1e-3
"""Curvature of constraints, in shares of its own terms, from which it is no rounding."""

OUTWARDS = 1e-6
"""A multiplier of this share of the largest, against the limit's sign, excludes an abnormal extremal."""

DEPENDENT = 1e-4
"""Gradients of conditions whose combination changes by less than this, in shares of their sizes, may depend on each
other."""

_NORMALITY_ITERATIONS, _NORMALITY_STEPS = 6, 30

_MEANING = (
    "The constraints must leave the cost a say (value: what their second order amounts to beside the first, for "
    "variations of the size of the magnitudes). Where their gradients vanish or depend on each other, but they do not, "
    "they determine the trajectory by themselves, multipliers are huge or not unique (an abnormal extremal), and the "
    "minimum principle tells nothing: state the constraints otherwise."
)


def normality(cone: CriticalCone) -> Condition:
    """The gradients of what is active leave no multipliers without the cost."""
    where, value = "nowhere", 0.0
    space = NullSpace.of(cone.point, cone.strong)
    if space.rows.size and space.size:
        combined, slope = _least_dependent(space)
        multipliers = np.zeros(cone.point.lam.size)
        multipliers[space.rows] = combined
        curvature = _curvature(cone, space, multipliers)
        if _may_push(cone, multipliers) or _may_push(cone, -multipliers):
            value = curvature / max(slope, TINY)
            where = cone.point.rows.labels[int(np.argmax(np.abs(multipliers)))]
        for row in np.intersect1d(space.rows, cone.point.transcription.constraint_rows):
            alone = _bend(cone, space, row)
            if alone > value:
                value, where = alone, cone.point.rows.labels[row]
    return Condition(
        "normality",
        ConditionResult.FAIL if value > DEGENERACY_MAX_RATIO else ConditionResult.PASS,
        value,
        DEGENERACY_MAX_RATIO,
        where,
        _MEANING,
    )


def beside_normal(told: Condition, cone: CriticalCone) -> Condition:
    """A normality that holds, unless end conditions that hardly push leave multipliers without the cost as well.

    Those of the conditions are not unique then: any multiple of the abnormal ones may be added.
    """
    point = cone.point
    ends = np.zeros(cone.weak.size, dtype=bool)
    for part in point.transcription.parts.values():
        ends[part.collocation.boundary_states[:, [0, -1]]] = True
    ends[point.x.size + point.transcription.constraint_rows] = True
    hardly = cone.weak & ends
    if not np.any(hardly):
        return told
    found = normality(replace(cone, strong=cone.strong | hardly, weak=cone.weak & ~hardly))
    if found.result is ConditionResult.PASS:
        return told
    where = (
        f"{found.where}: abnormal multipliers beside any normal ones, by an end condition that hardly pushes"
    )
    return replace(found, result=ConditionResult.INCONCLUSIVE, where=where, sufficient=True)


def normality_of_switches(induced: InducedProblem) -> Condition:
    """The conditions on the ends leave no multipliers without the cost, where switch times alone are varied.

    Their gradients by switch times, free times, start values and parameters may depend on each other (as they do where
    there are more of them) if nothing is left that could vary or if they do not curve there.
    """
    conditions, free = induced.conditions, induced.unknowns.free
    if not induced.finite:
        return Condition(
            "normality", ConditionResult.INCONCLUSIVE, np.nan, DEGENERACY_MAX_RATIO, NOT_FLOWN, _MEANING
        )
    at_lower, at_upper = conditions.active
    rows = conditions.jacobian / conditions.sizes[:, None]
    own, every = np.linalg.norm(rows[:, free], axis=1), np.linalg.norm(rows, axis=1)
    # What only given unknowns could change is no condition on the others.
    active = np.flatnonzero((at_lower | at_upper) & ((own > RANK * every) | (every <= RANK)))
    rows = rows[np.ix_(active, free)]
    left, sizes, across = np.linalg.svd(rows)
    slopes = np.append(sizes, np.zeros(max(0, active.size - sizes.size)))[: active.size]
    unmoved = across[int(np.sum(sizes > DEPENDENT)) :].T
    value, where = 0.0, "nowhere"
    sides = np.where(at_lower & at_upper, 0.0, np.where(at_upper, 1.0, -1.0))[active]
    nothing = np.zeros(conditions.values.size)
    for combination, slope in zip(left.T, slopes, strict=True):
        pushes = sides * combination
        inwards = np.all(pushes >= -OUTWARDS) or np.all(pushes <= OUTWARDS)
        if slope <= DEPENDENT and unmoved.shape[1] and inwards:
            multipliers = nothing.copy()
            multipliers[active] = combination / conditions.sizes[active]
            bent = (induced.hessian(multipliers)[0] - induced.hessian(nothing)[0])[np.ix_(free, free)]
            found = float(np.linalg.norm(unmoved.T @ bent @ unmoved, 2)) / max(slope, ROUNDING)
            if found > value:
                value, where = found, conditions.labels[active[int(np.argmax(np.abs(combination)))]]
    if not value and np.any(slopes <= RANK):
        where = f"nowhere; {active.size} conditions on {sizes.size} unknowns: multipliers are not unique"
    result = ConditionResult.FAIL if value > DEGENERACY_MAX_RATIO else ConditionResult.PASS
    return Condition("normality", result, value, DEGENERACY_MAX_RATIO, where, _MEANING)


def _bend(cone: CriticalCone, space: NullSpace, row: int) -> float:
    """Second order of a boundary constraint beside its first, which vanishes where its gradient does."""
    single = np.zeros(cone.point.lam.size)
    single[row] = 1.0
    curvature = space.in_shares(cone.point.hessian_of(0.0, single))
    slope = space.norms[space.rows == row][0]
    return float(scipy.sparse.linalg.norm(curvature) / slope)


def _may_push(cone: CriticalCone, multipliers: Array) -> bool:
    """Whether multipliers of rows, without a cost, push inwards at every limit that is held."""
    point, n = cone.point, cone.point.x.size
    pushes = []
    for limits, values, held, multiplier in (
        (point.variables, point.x, cone.strong[:n], -(point.jacobian.T @ multipliers)),
        (point.rows, point.values, cone.strong[n:], multipliers),
    ):
        one_sided = held & ~limits.box.fixed
        upper = limits.box.upper - values < values - limits.box.lower
        pushes.append(np.where(upper, multiplier, -multiplier)[one_sided])
    push = np.concatenate(pushes)
    return bool(np.all(push >= -OUTWARDS * np.max(np.abs(push), initial=0.0)))


def _least_dependent(space: NullSpace) -> tuple[Array, float]:
    """Multipliers of the rows whose combined gradient is smallest, by inverse iteration, and its size."""
    n, m = space.size, space.rows.size
    _, solve = space.of_identity
    y = np.random.default_rng(0).standard_normal(m)
    for _ in range(_NORMALITY_ITERATIONS):
        # Of scaled rows, not of unit gradients: one that vanishes must count for nothing.
        unit = -solve(np.concatenate([np.zeros(n), y / space.norms]))[n:]
        y = unit / space.norms
        y /= np.linalg.norm(y)
    return y, float(np.linalg.norm(space.jacobian.T @ (space.norms * y)))


def _curvature(cone: CriticalCone, space: NullSpace, multipliers: Array) -> float:
    """Largest curvature of the combined rows where they do not vary to first order, 0 if it is rounding."""
    n = space.size
    hessian = space.in_shares(cone.point.hessian_of(0.0, multipliers))
    project = space.projection
    start = project(np.random.default_rng(1).standard_normal(n))
    values, vectors = lanczos(lambda v: project(hessian @ project(v)), start, _NORMALITY_STEPS)
    if not values.size:
        return 0.0
    direction = project(vectors[:, np.argmax(np.abs(values))])
    curvature, share = quadratic(hessian, direction / max(float(np.linalg.norm(direction)), TINY))
    return abs(curvature) if abs(share) > CURVED else 0.0
