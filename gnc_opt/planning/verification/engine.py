"""verify: judge a solution by Pontryagin's minimum principle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.environment import one_thread
from gnc_opt.errors import GncOptError, ProblemError
from gnc_opt.planning.optimality.cost_scale import Magnitudes, cost_unit
from gnc_opt.planning.optimality.costate_jumps import settle_edges
from gnc_opt.planning.problem.expressions import table_uses
from gnc_opt.planning.problem.functions import EndGradients
from gnc_opt.planning.problem.kinks import kinks_of
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.quality import NOTHING
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.verdict import Condition, ConditionResult, Verdict
from gnc_opt.planning.verification import (
    bang_bang_second_order as second_order,
)
from gnc_opt.planning.verification import (
    control_conditions as controls,
)
from gnc_opt.planning.verification import (
    costate_conditions as costates,
)
from gnc_opt.planning.verification import (
    feasibility,
)
from gnc_opt.planning.verification.conjugate_points import conjugate_points
from gnc_opt.planning.verification.costate_conditions import with_end_limits
from gnc_opt.planning.verification.normality import beside_normal, normality
from gnc_opt.planning.verification.recomputed import (
    costates_kept_twice,
    ends_of,
    from_problem,
    has_costates,
    missing_number,
    stored_numbers,
)
from gnc_opt.planning.verification.reduced_hessian import (
    critical_cone,
    flown_spans,
    reduced_hessian,
    rounding_of_cost,
    visible_spans,
)
from gnc_opt.planning.verification.singular_arcs import (
    generalised_legendre_clebsch,
    of_first_order,
    singular_arcs,
)
from gnc_opt.planning.verification.smoothness import beyond_theorems, roughness, smoothness
from gnc_opt.planning.verification.sufficiency import (
    determined_by_slope,
    has_one_solution,
    is_convex,
    reaches_least_cost,
)

CONDITION_TOLERANCE = 1e-5

MOST_UNKNOWNS = 4000
"""Of a mesh, states and controls at its points, whose second order is looked at though a first condition fails already:
that is the larger part of the work on fine meshes, and says nothing of what is no extremal."""

_NO_EXTREMAL = (
    "The second order tells extremals that are minima from others, and this is no extremal: see what fails."
)
_CANNOT_VARY = "Costates or other numbers are missing, so that what variations cost cannot be told."


@one_thread()
def verify(solution: Solution, *, tol: float = CONDITION_TOLERANCE) -> Verdict:
    """Judge a solution's trajectory and costates against its problem, densely in time.

    Nothing of the solver's residuals is used, and everything but times, states, controls, free parameters, costates
    and multipliers is computed anew from the problem, so a trajectory from any source can be judged. All values are
    dimensionless, see each condition's ``meaning``.

    Parameters
    ----------
    solution : Solution
        With its problem (``load(path, problem=...)`` after loading).
    tol : float
        Tolerance of every condition.

    Returns
    -------
    Verdict
        ``ok`` if the necessary conditions of a minimum hold, ``minimum`` if sufficient ones do too; PASS, FAIL or
        INCONCLUSIVE per condition: dynamics, propagation, bounds, path constraints, boundary
        conditions, cost, stored numbers, adjoint equation, transversality, Hamiltonian, stationarity, control signs,
        minimum principle, complementarity, Legendre-Clebsch, singular arcs, generalised Legendre-Clebsch, parameters,
        normality, second order; for a solution whose switch times were optimised or that is bang-bang, strict switches;
        for the latter, induced gradient; for all others, along smooth phases, conjugate points. Where models look
        things up, tables; where operations without derivatives switch with states or controls, smoothness.
        A solution keeps its verdict: asked again, at the same tolerance, nothing is computed anew.

    Raises
    ------
    GncOptError
        The solution has no problem or one of other sizes, or is no solution.

    Examples
    --------
    >>> verdict = go.verify(solution)
    >>> print(verdict.ok, verdict.minimum, verdict["Hamiltonian"].result.value)
    True True PASS
    """
    if not isinstance(solution, Solution):
        raise GncOptError(f"verify() needs a Solution, as solve() returns it, not {type(solution).__name__}.")
    if not (np.isfinite(tol) and tol > 0):
        raise ProblemError(f"the tolerance of verify() is {tol!r}: give a positive number.")
    known = solution.verdict if tol == CONDITION_TOLERANCE and solution.problem is not None else None
    if known is None:
        known = _judge(solution, tol)
        if tol == CONDITION_TOLERANCE:  # the one field of a solution that is set after its construction
            object.__setattr__(solution, "verdict", known)
    return known if solution.bound is None else replace(known, bound=solution.bound, gap=solution.gap)


def _judge(solution: Solution, tol: float) -> Verdict:
    stored, solution = solution, from_problem(solution)
    samples = list(solution.samples().values())
    ends, amounts = ends_of(solution), Magnitudes.of(solution, samples)
    told = has_costates(samples, ends, amounts.cost)
    missing = missing_number(stored, told)
    samples = [settle_edges(s.with_cost_magnitude(amounts.cost), tol) for s in samples]
    conditions = [
        feasibility.dynamics(solution.need_problem("verify"), samples, tol),
        feasibility.propagation(samples, tol),
        feasibility.bounds(solution, samples, tol),
        feasibility.paths(samples, tol),
        feasibility.boundary(solution, samples, ends, amounts.constraints, tol),
        feasibility.cost(stored, samples, ends, told, tol),
        stored_numbers(
            stored, solution, missing.or_worse(costates_kept_twice(samples) if told else NOTHING), tol
        ),
    ]
    lasting, problem = [s for s in samples if s.has_length], solution.need_problem("verify")
    if any(table_uses(problem, leg) for leg in problem.phases.values()):
        conditions.append(feasibility.tables(solution))
    undetermined = [controls.undetermined(s, tol) for s in lasting]
    singular = [mask for mask, _ in undetermined]
    arcs = [singular_arcs(problem, s, *where, tol) for s, where in zip(lasting, undetermined, strict=True)]
    told_by_arcs = [of_first_order(s, found, tol) for s, found in zip(lasting, arcs, strict=True)]
    along = [
        costates.adjoint(lasting, tol),
        costates.transversality(lasting, ends, tol),
        costates.hamiltonian(lasting, tol),
        controls.stationarity(lasting, tol),
        controls.control_signs(lasting, tol),
        controls.minimum(lasting, tol, cost_unit(problem)),
        costates.complementarity(solution, lasting, ends, amounts.constraints, tol),
        controls.legendre_clebsch(lasting, tol, singular),
        controls.singular_arcs(lasting, tol, singular, told_by_arcs),
        generalised_legendre_clebsch([arc for found in arcs for arc in found], tol),
    ]
    switching = bool(solution.structure) or second_order.is_bang_bang(lasting)
    names = ("strict switches", "second order") if switching else ("second order",)
    if told and _is_large(lasting) and any(c.result is ConditionResult.FAIL for c in (*conditions, *along)):
        switches = [_untold(name, "not looked at, as other conditions fail", _NO_EXTREMAL) for name in names]
    elif told and not missing.value:
        switches = [second_order.strict_switches(lasting)] if switching else []
        switches += _second_order(solution, samples, ends, tol)
    else:
        switches = [_untold(name, missing.where, _CANNOT_VARY) for name in names]
    if len(lasting) < len(samples):
        vanished = next(s.leg.name for s in samples if not s.has_length)
        along, switches = ([_without_length(c, vanished) for c in part] for part in (along, switches))
    judged = [*along, costates.parameters(solution, samples, ends, amounts.parameters, tol), *switches]
    doubted = told and any(c.result is not ConditionResult.PASS for c in judged)
    if doubted and reaches_least_cost(solution, samples, ends.cost, amounts.cost, tol):
        judged = [_of_least_cost(c) for c in judged]
    if any(_leaves_open(c) for c in judged) and told and _is_only_one(problem, lasting):
        judged = [_of_one_solution(c) if _leaves_open(c) else c for c in judged]
    if any(kinks_of(problem, leg) is not None for leg in problem.phases.values()):
        rough = None if missing.value else roughness(problem, lasting, tol)
        conditions.append(smoothness(rough, any(c.result is ConditionResult.FAIL for c in judged)))
        if rough is not None:
            judged = [beyond_theorems(c, rough) for c in judged]
    if missing.value:
        judged = [_incomplete(c, missing.where) for c in judged]
    if told:
        return Verdict(solution.problem_name, (*conditions, *judged))
    return Verdict(
        solution.problem_name, (*conditions, *map(_without_costates, judged)), not_checked="no costates"
    )


def _is_large(samples: list[PhaseSamples]) -> bool:
    unknowns = sum(s.leg.mesh.size * (s.leg.states.size + s.leg.controls.size) for s in samples)
    return unknowns > MOST_UNKNOWNS


def _second_order(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, tolerance: float
) -> list[Condition]:
    """By the switch times where they alone are left to vary, else on the mesh."""
    solution, ends = with_end_limits(solution, samples, ends)
    found = _second_variation(solution, samples, ends, tolerance)
    told = all(c.result is ConditionResult.PASS for c in found)
    return found if told or not is_convex(solution.need_problem("verify")) else [_of_convex(c) for c in found]


def _second_variation(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, tolerance: float
) -> list[Condition]:
    if not second_order.obstacle(samples):
        return second_order.by_switches(solution, samples, ends, tolerance)
    rounding = rounding_of_cost(samples)
    cone = critical_cone(solution, samples, rounding, flown_spans)
    if not cone.point.is_finite:
        return [_untold("second order", "a derivative of the problem is no number", _CANNOT_VARY)]
    curvature = reduced_hessian(solution, samples, cone)
    smooth = [_agreed(c, curvature) for c in conjugate_points(solution, samples)]
    return [_normality(solution, samples, rounding), *smooth, curvature]


def _normality(solution: Solution, samples: list[PhaseSamples], rounding: float) -> Condition:
    """By the magnitudes of the program and, where those may be too large, by what the flight moves."""
    cone = critical_cone(solution, rounding=rounding)
    told = normality(cone)
    if told.result is ConditionResult.PASS:
        return beside_normal(told, cone)
    return normality(critical_cone(solution, samples, rounding, visible_spans))


def _of_convex(condition: Condition) -> Condition:
    """Where the first order suffices, what curves downwards on a mesh with movable boundaries is its own error."""
    if condition.result is ConditionResult.PASS or not condition.sufficient:
        return condition
    where = f"{condition.where}; the problem is convex, nothing curves downwards, and the minimum may be one of many"
    return replace(condition, result=ConditionResult.INCONCLUSIVE, where=where)


def _of_least_cost(condition: Condition) -> Condition:
    """Where nothing can cost less, costates are rounding and say nothing against it; whether it is strict is open.

    Constraints that leave the cost no say (normality) are told whatever it is.
    """
    if condition.result is ConditionResult.PASS or condition.name == "normality":
        return condition
    result = ConditionResult.INCONCLUSIVE if condition.sufficient else ConditionResult.PASS
    where = f"{condition.where}; the cost is the least that there can be, and the minimum may be one of many"
    return replace(condition, result=result, where=where)


def _is_only_one(problem: Problem, samples: list[PhaseSamples]) -> bool:
    every_phase_lasts = len(samples) == len(problem.phases)
    return every_phase_lasts and has_one_solution(
        problem, {s.leg.name: determined_by_slope(s) for s in samples}
    )


def _leaves_open(condition: Condition) -> bool:
    return condition.sufficient and condition.result is ConditionResult.INCONCLUSIVE


def _of_one_solution(condition: Condition) -> Condition:
    """Where the first order suffices for the only minimum there is, nothing else need be told."""
    where = f"{condition.where}; the problem is convex and has one solution only"
    return replace(condition, result=ConditionResult.PASS, where=where)


def _agreed(conjugate: Condition, curvature: Condition) -> Condition:
    """A conjugate time past which the cost curves upwards all the same cannot be told: one of the two errs."""
    if conjugate.result is ConditionResult.FAIL and curvature.result is ConditionResult.PASS:
        return replace(
            conjugate,
            result=ConditionResult.INCONCLUSIVE,
            where=f"{conjugate.where}, which 'second order' denies",
        )
    return conjugate


def _untold(name: str, where: str, meaning: str) -> Condition:
    return Condition(name, ConditionResult.INCONCLUSIVE, float("nan"), 0.0, where, meaning, sufficient=True)


def _cannot_tell(condition: Condition, where: str, meaning: str) -> Condition:
    value = float("nan")
    return replace(
        condition,
        result=ConditionResult.INCONCLUSIVE,
        value=value,
        where=where,
        meaning=meaning,
        loss=None,
        unit="",
    )


def _without_costates(condition: Condition) -> Condition:
    return _cannot_tell(
        condition,
        "everywhere",
        "The solution has no costates (none finite and non-zero), so that the minimum principle cannot be checked.",
    )


def _incomplete(condition: Condition, where: str) -> Condition:
    """A pass without all numbers is none."""
    if condition.result is not ConditionResult.PASS:
        return condition
    return _cannot_tell(condition, where, "It holds as far as can be seen, but a number is missing.")


def _without_length(condition: Condition, phase: str) -> Condition:
    if condition.result is ConditionResult.FAIL:  # in another phase
        return condition
    inconclusive = _cannot_tell(
        condition,
        f"phase {phase}, which has no length",
        "The phase has no length: its duration sits on its lower bound of zero, and there is no time along which "
        "costates and controls could be judged. Leave the phase out, or ask for a positive duration.",
    )
    return replace(inconclusive, sufficient=True)  # nothing to tell is not against the solution
