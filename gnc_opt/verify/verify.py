"""verify: judge a solution by Pontryagin's minimum principle."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gnc_opt.errors import GncOptError, ProblemError
from gnc_opt.problem.functions import EndGradients, end_gradients
from gnc_opt.solution.solution import Solution
from gnc_opt.verify import controls, costates, feasibility, second_order
from gnc_opt.verify.magnitude import cost_magnitude
from gnc_opt.verify.pushes import settle_edges
from gnc_opt.verify.verdict import Condition, Result, Verdict

TOLERANCE = 1e-5


def verify(solution: Solution, *, tol: float = TOLERANCE) -> Verdict:
    """Judge a solution from its model, trajectory and costates, densely in time.

    Nothing of the solver's residuals is used, so a trajectory from any source can be judged. All values
    are dimensionless, see each condition's ``meaning``.

    Parameters
    ----------
    solution : Solution
        With its problem (``load(path, problem=...)`` after loading).
    tol : float
        Tolerance of every condition.

    Returns
    -------
    Verdict
        PASS, FAIL or CANNOT TELL per condition: dynamics, propagation, bounds, path constraints, boundary
        conditions, cost, adjoint equation, transversality, Hamiltonian, stationarity, control signs, minimum
        principle, complementarity, Legendre-Clebsch, singular arcs, parameters; and, for a solution whose switch
        times were optimised, strict switches and second order.

    Raises
    ------
    GncOptError
        The solution has no problem, or is no solution.
    """
    if not isinstance(solution, Solution):
        raise GncOptError(f"verify() needs a Solution, as solve() returns it, not {type(solution).__name__}.")
    if not (np.isfinite(tol) and tol > 0):
        raise ProblemError(f"the tolerance of verify() is {tol!r}: give a positive number.")
    samples = list(solution.samples().values())
    ends, amount = _ends(solution), cost_magnitude(solution, samples)
    samples = [settle_edges(replace(s, cost_magnitude=amount), tol) for s in samples]
    conditions = [
        feasibility.dynamics(samples, tol),
        feasibility.propagation(samples, tol),
        feasibility.bounds(solution, samples, tol),
        feasibility.paths(samples, tol),
        feasibility.boundary(solution, ends, tol),
        feasibility.cost(solution, samples, ends, tol),
    ]
    lasting = [s for s in samples if s.has_length]
    along = [
        costates.adjoint(lasting, tol),
        costates.transversality(lasting, ends, tol),
        costates.hamiltonian(lasting, tol),
        controls.stationarity(lasting, tol),
        controls.control_signs(lasting, tol),
        controls.minimum(lasting, tol),
        costates.complementarity(solution, lasting, ends, tol),
        controls.legendre_clebsch(lasting, tol),
        controls.singular_arcs(lasting, tol),
    ]
    switches = []
    if solution.structure:
        switches = [second_order.strict_switches(lasting), second_order.second_order(solution, samples, ends)]
    if len(lasting) < len(samples):
        vanished = next(s.leg.name for s in samples if not s.has_length)
        along, switches = ([_without_length(c, vanished) for c in part] for part in (along, switches))
    judged = [*along, costates.parameters(solution, samples, ends, tol), *switches]
    if not _has_costates(solution):
        judged = [_untold(c) for c in judged]
    return Verdict(solution.problem_name, (*conditions, *judged))


def _ends(solution: Solution) -> EndGradients:
    """End-point gradients recomputed at the trajectory's own ends."""
    problem = solution.problem
    assert problem is not None, "functions() has refused solutions without a problem"
    ends: dict[str, list[Any]] = {}
    for name, leg in solution.phases.items():
        first, last = leg.x(leg.breaks[0]), leg.x(leg.breaks[-1], "left")
        ends[name] = [first, last, leg.initial_time, leg.final_time, leg.integrals, leg.parameters]
    return end_gradients(problem, ends, solution.parameter_values, solution.constraint_multipliers)


def _has_costates(solution: Solution) -> bool:
    legs = solution.phases.values()
    finite = all(np.all(np.isfinite(v)) for leg in legs for v in leg.lam.values)
    # Costates may vanish where an integral is minimised, but not in a pure end-point problem.
    some = any(np.any(v != 0) for leg in legs for v in leg.lam.values)
    return finite and (some or any(np.any(leg.integral_weights != 0) for leg in legs))


def _untold(condition: Condition) -> Condition:
    return Condition(
        condition.name,
        Result.CANNOT_TELL,
        float("nan"),
        condition.tolerance,
        "everywhere",
        "The solution has no costates (none finite and non-zero), so that the minimum principle cannot be checked.",
    )


def _without_length(condition: Condition, phase: str) -> Condition:
    if condition.result is Result.FAIL:  # in another phase
        return condition
    return Condition(
        condition.name,
        Result.CANNOT_TELL,
        float("nan"),
        condition.tolerance,
        f"phase {phase}",
        "The phase has no length: its duration sits on its lower bound of zero, and there is no time along which "
        "costates and controls could be judged. Leave the phase out, or ask for a positive duration.",
    )
