r"""Lower bounds of the cost, and problems whose first-order conditions are sufficient for a global minimum.

**Convex problems**: see `gnc_opt.planning.verification.sufficient_conditions`.

**Linear time-optimal control**: :math:`\dot x = A x + b(u)`, :math:`u \in U`, from fixed or free initial states to a
fixed :math:`x_f` in minimum time, with states in a convex set. If :math:`A x_f + b(u_f) = 0` for some
:math:`u_f \in U`, every normal extremal is a global minimum.
(For a target at the origin and a polyhedron U: L. S. Pontryagin et al., The Mathematical Theory of Optimal Processes,
1962, ch. III.) Proof: suppose that another trajectory x' with u' arrives earlier and stays until T. Between 0 and T,
with the costate of the extremal and :math:`d = x' - x`,

.. math:: 0 \ge [\lambda^T d] = \int \lambda^T (b(u') - b(u))\, dt - \int d^T d\mu \ge 0,

because u minimises H and the multipliers :math:`d\mu` of state limits point out of a convex set. So u' minimises H too,
and while x' stays, :math:`\min_u \lambda^T (A x_f + b(u)) = 0`, although it tends to -1 at T, where H = 0.

`lower_bound` bounds the distance of a solution from the global optimum by a relaxation.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.argument_checks import read_positive_number, require_type
from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import AT_LIMIT, EQUAL, ROUNDING, max_norm
from gnc_opt.planning.optimal_control_solver import solve
from gnc_opt.planning.problem.kink_detection import has_kinks
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.optimality_verdict import LowerBound, Verdict
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.study.state_subset_relaxation import Relaxation, list_problem_relaxations
from gnc_opt.planning.verification.optimality_check import verify
from gnc_opt.planning.verification.sufficient_conditions import is_convex
from gnc_opt.threads_and_package_versions import limit_to_one_thread


@limit_to_one_thread()
def lower_bound(solution: Solution, *, tol: float = 1e-6) -> Solution:
    """Return the solution with a lower bound of its problem's cost, if one is found: `Solution.bound`, `Solution.gap`.

    If the problem is convex, or linear and time-optimal with an equilibrium as target, its own cost is the bound.
    Otherwise states that do not affect the others are removed with their limits. Each remaining part with all states of
    the cost is solved from the trajectory as a guess, refined and checked. The highest certified bound is returned, or
    else the highest value of a local minimum; see ``bound.certified``.

    Parameters
    ----------
    solution : Solution
        Solved solution with its problem.
    tol : float
        Tolerance of the refinement of each part, as in `solve`.

    Returns
    -------
    Solution
        The same solution. ``bound`` is None if no state can be removed, or no part has an ok verdict.

    Raises
    ------
    GncOptError
        The solution has no problem.

    Examples
    --------
    >>> bounded = go.lower_bound(solution)
    >>> print(bounded.bound.certified, f"{abs(bounded.gap):.0e}")
    True 0e+00
    """
    require_type(solution, Solution, "the argument of lower_bound()", "give a result of solve()")
    read_positive_number(tol, "the tolerance of lower_bound()")
    problem = solution.need_problem("bound")
    verdict = replace(verify(solution), bound=None, gap=None)
    theorem = find_sufficiency_theorem(solution, verdict)
    if theorem:
        best: LowerBound | None = LowerBound(solution.objective, _list_state_labels(problem), theorem)
    else:
        found = (
            _solve_relaxation(relaxation, solution, tol) for relaxation in list_problem_relaxations(problem)
        )
        known = [bound for bound in found if bound is not None]
        best = max(known, key=lambda b: (b.certified, problem.sense * b.value), default=None)
    return replace(solution, bound=best).with_verdict(verdict)


def _solve_relaxation(relaxation: Relaxation, solution: Solution, tol: float) -> LowerBound | None:
    problem = _replace_guess_by_solution(relaxation, solution)
    relaxed = solve(problem, tol=tol, throw=False)
    if not relaxed.converged:
        return None
    theorem = find_sufficiency_theorem(relaxed, verify(relaxed))
    beyond = problem.sense * (relaxed.objective - solution.objective)
    if not theorem and beyond > tol * abs(solution.objective):
        return None  # the solution costs less, so that this minimum of the relaxation is not global
    kept = solution.need_problem("bound").phases
    labels = [
        label
        for name, mask in relaxation.states.items()
        for label, left in zip(kept[name].model.states.labels, mask, strict=True)
        if left
    ]
    return LowerBound(relaxed.objective, tuple(dict.fromkeys(labels)), theorem)


def _replace_guess_by_solution(relaxation: Relaxation, solution: Solution) -> Problem:
    problem = relaxation.problem
    for name, phase in problem.phases.items():
        solved = solution.phase(name)
        times = np.linspace(solved.initial_time, solved.final_time, 201)
        states = solved.x(times, "right")[relaxation.states[name]]
        controls = solved.applied(times, "right")[relaxation.controls[name]]
        values = {n: states[phase.model.states.slice(n)] for n in phase.model.states.names}
        values |= {n: controls[phase.model.controls.slice(n)] for n in phase.model.controls.names}
        phase.guess(times, **values)
    return problem.with_parameter_guess(**{n: solution.parameter(n) for n in problem.parameters.names})


def _list_state_labels(problem: Problem) -> tuple[str, ...]:
    return tuple(
        dict.fromkeys(label for phase in problem.phases.values() for label in phase.model.states.labels)
    )


CONVEX = "convex"
LINEAR_TIME_OPTIMAL = "linear and time-optimal"


def find_sufficiency_theorem(solution: Solution, verdict: Verdict) -> str:
    """Return the theorem by which an extremal is a global minimum; "" if none applies or the verdict is not ok."""
    problem = solution.need_problem("certify")
    if not verdict.ok:
        return ""
    if is_convex(problem):
        return CONVEX
    return LINEAR_TIME_OPTIMAL if _is_linear_time_optimal_problem(problem, solution) else ""


def _is_linear_time_optimal_problem(problem: Problem, solution: Solution) -> bool:
    if len(problem.phases) != 1 or problem.constraints or problem.parameters.size:
        return False
    phase = next(iter(problem.phases.values()))
    return (
        _is_time_optimal(problem, phase, solution.phase().final_time)
        and bool(np.all(phase.numbers.final.is_fixed))
        and _has_linear_dynamics(phase)
        and _is_final_state_equilibrium(phase, solution)
    )


def _is_time_optimal(problem: Problem, phase: Phase, found: float) -> bool:
    """Return whether the cost is the final time, and not at its lower limit in the solution."""
    initial, final = phase.time_ranges()
    slope = ca.jacobian(problem.sense * problem.cost, phase.final_time)
    others = [s for s in ca.symvar(problem.cost) if s.element_hash() != phase.final_time.element_hash()]
    time_alone = all(s.element_hash() == phase.initial_time.element_hash() for s in others)
    grows = slope.is_constant() and float(ca.DM(slope)) > 0
    span = found - initial.lower[0]
    return bool(initial.is_fixed[0] and time_alone and grows and found > final.lower[0] + AT_LIMIT * span)


def _has_linear_dynamics(phase: Phase) -> bool:
    """Return whether dx/dt = A x + b(u), with path constraints on controls only or convex ones on states."""
    t, x, u, _ = phase.model.symbolic_arguments()
    rates, rows = phase.model.state_derivative(), phase.path_expression()
    curved = has_kinks(rates) or _depends_on_symbols(ca.jacobian(rates, x), ca.vertcat(x, u))
    if curved or ca.depends_on(ca.vertcat(rates, rows), t):
        return False
    box = phase.get_path_bounds()
    for i in range(rows.numel()):
        row = rows[i]
        if not ca.depends_on(row, x):
            continue
        if ca.depends_on(row, u) or not _is_convex_constraint(phase, row, x, box.lower[i], box.upper[i]):
            return False
    return True


def _is_convex_constraint(phase: Phase, row: Any, x: Any, lower: float, upper: float) -> bool:
    hessian = ca.hessian(row, x)[0]
    p = phase.model.symbols("parameter")
    if _depends_on_symbols(hessian, x) or has_kinks(row):
        return False
    values = np.linalg.eigvalsh(ca.Function("hessian", [p], [hessian])(phase.model.parameter_values).full())
    slack = ROUNDING * max_norm(values)
    return bool(
        (np.all(values >= -slack) or upper == np.inf) and (np.all(values <= slack) or lower == -np.inf)
    )


def _depends_on_symbols(expression: Any, symbols: Any) -> bool:
    return bool(ca.depends_on(expression, symbols))


def _is_final_state_equilibrium(phase: Phase, solution: Solution) -> bool:
    """Return whether an admissible control makes the final state an equilibrium, by least squares."""
    solved = solution.phase()
    t, target = solved.final_time, phase.numbers.final.lower
    box, limits = phase.numbers.controls, phase.get_path_bounds()
    _, x, u, p = phase.model.symbolic_arguments()
    along = ca.Function("along", [x, u, p], [phase.model.state_derivative(), phase.path_expression()])
    span = max(t - solved.initial_time, ROUNDING)
    rates = np.maximum(np.ptp(solved.x(solved.sample_times(4), "right"), axis=1) / span, ROUNDING)

    def compute_equilibrium_rate_residuals(control: Array) -> Array:
        rate, rows = (
            np.ravel(value.full()) for value in along(target, control, phase.model.parameter_values)
        )
        return np.concatenate([rate / rates, limits.compute_bound_violation(rows)])

    if not box.lower.size:
        return bool(np.all(np.abs(compute_equilibrium_rate_residuals(np.zeros(0))) <= EQUAL))
    inner = np.where(box.is_fixed, np.inf, box.upper), np.where(box.is_fixed, -np.inf, box.lower)
    starts = (np.clip(np.zeros(box.lower.size), box.lower, box.upper), solved.applied(t, "left"))
    for start in starts:
        free = ~box.is_fixed
        held = np.where(box.is_fixed, box.lower, start)

        def compute_equilibrium_residuals(values: Array, held: Array = held, free: Any = free) -> Array:
            control = held.copy()
            control[free] = values
            return compute_equilibrium_rate_residuals(control)

        begin = np.clip(held[free], inner[1][free], inner[0][free])
        found = scipy.optimize.least_squares(
            compute_equilibrium_residuals, begin, bounds=(box.lower[free], box.upper[free]), xtol=1e-15
        )
        if np.all(np.abs(found.fun) <= EQUAL):
            return True
    return False
