"""Redundant bounds: of components of constant-length vectors, of angles over full turns, and of monotone states.

At the unit quaternion (1, 0, 0, 0) the bound 1 and the length have the same gradient. The bound of a monotone state at
one end of a phase implies the bound in between, whose multiplier is then not unique.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Indices, Mask
from gnc_opt.model.casadi_expression_graph import collect_casadi_operation_codes
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_function
from gnc_opt.numerical_tolerances import AT_LIMIT, NOTABLE, ROUNDING, set_nonfinite_to_zero
from gnc_opt.planning.problem.angle_valued_controls import PERIODS, AngleProbe, UnboundedAngles
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.interval_arithmetic import bound_function_values
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.phase_bounds_and_guess import PhaseBoundsAndGuess
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.symbolic_expressions import build_function_along_phase, stack_phase_expressions

RELAXATION_SHARE = 0.1
"""Share of a state's bounds and initial value by which redundant bounds are relaxed."""


def relax_state_bounds(phase: Phase) -> Interval:
    """Return slightly relaxed bounds of the states of a phase."""
    bounds, ends = phase.numbers.states, (phase.numbers.initial, phase.numbers.final)
    magnitudes = np.abs([limit for box in (bounds, *ends) for limit in (box.lower, box.upper)])
    slack = RELAXATION_SHARE * np.max(set_nonfinite_to_zero(magnitudes), axis=0)
    return Interval(bounds.lower - slack, bounds.upper + slack)


def find_monotone_states(problem: ProblemData, phase: Phase, *, undriven: bool = False) -> tuple[Mask, Mask]:
    """Return which bounded states never decrease and which never increase, for all controls and states within bounds.

    States that no control drives count if ``undriven``, or if they are constant. Their bounds keep the first iterates
    of a solve near the guess; with prescribed arcs, they would leave multipliers undetermined. Bounds of monotone
    states are relaxed to `relax_state_bounds`; those of the other states hold.
    """
    numbers = phase.numbers
    bounded = np.isfinite(numbers.states.lower) | np.isfinite(numbers.states.upper)
    if not np.any(bounded):
        return bounded, bounded
    derivative, is_counted = phase.model.state_derivative(), np.full_like(bounded, undriven)
    is_counted[ca.jacobian_sparsity(derivative, phase.model.symbols("control")).row()] = True
    rates = problem.memoize(
        ("rates", phase.name), lambda: build_function_along_phase(problem, phase, "rates", derivative)
    )
    values, (starts, ends) = phase.model.parameter_values, phase.time_ranges()
    others = numbers.controls, Interval(values, values), problem.get_parameter_bounds()
    wider, time = relax_state_bounds(phase), Interval(starts.lower, ends.upper)
    boxes = (time, numbers.states, wider, *others)
    arguments = tuple(end.tobytes() for box in boxes for end in (box.lower, box.upper))
    key = ("one way", phase.name, undriven)
    cached: tuple[Any, Mask, Mask] | None = problem.builds.get(key)
    if cached is None or cached[0] != arguments:
        relaxed, rising, falling = np.zeros_like(bounded), bounded.copy(), bounded.copy()
        while True:  # fewer states are relaxed in every pass
            box = Interval(
                *np.where(relaxed, (wider.lower, wider.upper), (numbers.states.lower, numbers.states.upper))
            )
            rate = bound_function_values(rates, [time, box, *others])
            rising &= (rate.lower == 0) & (is_counted | (rate.upper == 0))
            falling &= (rate.upper == 0) & (is_counted | (rate.lower == 0))
            if np.array_equal(relaxed, rising | falling):
                break
            relaxed = rising | falling
        problem.builds[key] = cached = (arguments, rising, falling)
    return cached[1:]


def find_implied_bounds(problem: ProblemData, phase: Phase) -> tuple[Mask, Mask]:
    """Return which lower and upper bounds of states (n_states,) are implied by the constant length of a vector."""
    is_implied = np.zeros((2, phase.model.states.size), dtype=bool)
    bounds = phase.numbers.states
    for rows in _group_state_vector_components(phase):
        length = _compute_vector_norm_at_fixed_end(phase, rows)
        shortest, longest = length * (1.0 - ROUNDING), length * (1.0 + NOTABLE)
        limits = -bounds.lower[rows], bounds.upper[rows]
        lower, upper = ((shortest <= limit) & (limit <= longest) for limit in limits)
        if length > 0 and np.any(lower | upper) and _is_vector_norm_constant(problem, phase, rows, length):
            is_implied[0, rows], is_implied[1, rows] = lower, upper
    return is_implied[0], is_implied[1]


def _group_state_vector_components(phase: Phase) -> list[Indices]:
    """Return the indices of state vectors; scalar states with equal symmetric bounds form a vector."""
    states, bounds = phase.model.states, phase.numbers.states
    vectors, rows_by_bound = [], dict[float, list[int]]()
    for variable in states.variables:
        rows = np.arange(states.size)[states.slice(variable.name)]
        if rows.size > 1:
            vectors.append(rows)
        elif np.isfinite(bounds.upper[rows[0]]) and bounds.lower[rows[0]] == -bounds.upper[rows[0]]:
            rows_by_bound.setdefault(float(bounds.upper[rows[0]]), []).append(int(rows[0]))
    return vectors + [np.array(rows) for rows in rows_by_bound.values() if len(rows) > 1]


def _compute_vector_norm_at_fixed_end(phase: Phase, rows: Indices) -> float:
    """Return the length of a vector at a fixed end of the phase; NaN if neither end is fixed."""
    for value in (phase.numbers.initial, phase.numbers.final):
        if np.all(value.is_fixed[rows]):
            return float(np.linalg.norm(value.lower[rows]))
    return np.nan


def _is_vector_norm_constant(problem: ProblemData, phase: Phase, rows: Indices, length: float) -> bool:
    """Return whether the length of a vector is constant for all values of the other variables."""

    def build_vector_norm_rate_function() -> Any:
        indices = rows.tolist()
        products = phase.model.symbols("state")[indices] * phase.model.state_derivative()[indices]
        return build_function_along_phase(problem, phase, "along_itself", products)

    norm_rate_terms = problem.memoize(
        ("rate along itself", phase.name, rows.tobytes()), build_vector_norm_rate_function
    )
    random = np.random.default_rng(5)
    n_parameters = problem.get_parameter_bounds().lower.size
    for _ in range(8):
        x = random.uniform(0.5, 1.5, phase.model.states.size)
        x[rows] = random.standard_normal(rows.size)
        x[rows] *= length / np.linalg.norm(x[rows])
        u = random.uniform(0.5, 1.5, phase.model.controls.size)
        t, q = random.uniform(0.5, 1.5), random.uniform(0.5, 1.5, n_parameters)
        values = np.asarray(norm_rate_terms(t, x, u, phase.model.parameter_values, q)).ravel()
        if not abs(values.sum()) <= ROUNDING * np.abs(values).sum():
            return False
    return True


def find_bounds_not_implied_by_norm(problem: ProblemData, phase: Phase) -> Interval:
    """Return the bounds of controls without those that a constant length, of states too, implies.

    If a component equals the length, both limits have the same gradient, and the multipliers are not unique.
    """
    lower, upper = phase.numbers.controls.lower.copy(), phase.numbers.controls.upper.copy()
    for name, constraint in phase.paths.items():
        if not all(constraint.interval.is_fixed) or constraint.interval.upper.size > 1:
            continue
        squared = partial(find_sum_of_squares_variables, phase, constraint.expression)
        key = ("vector of length", phase.name, name, *phase.model.controls.names)
        variable_rows, constant = problem.memoize(key, squared)
        length, rows = (
            compute_vector_length_from_equality(constraint.interval, constant),
            np.array(variable_rows, dtype=int),
        )
        controls = rows[rows >= phase.model.states.size] - phase.model.states.size
        lower[controls] = np.where(lower[controls] <= -length, -np.inf, lower[controls])
        upper[controls] = np.where(upper[controls] >= length, np.inf, upper[controls])
    return Interval(lower, upper)


def find_sum_of_squares_variables(phase: Phase, expression: Any) -> tuple[list[int], float]:
    """Return places among states and controls whose sum of squares and a constant an expression is; maybe none."""
    t, x, u, p = phase.model.symbolic_arguments()
    symbols = ca.vertcat(x, u)
    if ca.depends_on(expression, ca.vertcat(t, p)) or not ca.is_quadratic(expression, symbols):
        return [], 0.0
    matrix, linear, constant = ca.quadratic_coeff(expression, symbols)
    if not all(part.is_constant() for part in (matrix, linear, constant)):
        return [], 0.0
    weights = np.asarray(ca.DM(matrix))
    rows = np.flatnonzero(np.diag(weights))
    only_squares = np.array_equal(weights, 2.0 * np.diag(np.diag(weights) != 0)) and not np.any(
        np.asarray(ca.DM(linear))
    )
    return [int(i) for i in rows] if only_squares else [], float(ca.DM(constant))


def compute_vector_length_from_equality(square: Interval, constant: float) -> float:
    """Return the length of which an equality has the square and a constant, without its rounding."""
    return float(np.sqrt(max(square.upper[0] - constant, 0.0)) * (1.0 - ROUNDING))


_TURNING = {ca.OP_SIN, ca.OP_COS, ca.OP_TAN, ca.OP_FMOD, ca.OP_REMAINDER}


def remove_redundant_control_bounds(problem: ProblemData, phase: Phase) -> PhaseBoundsAndGuess:
    """Return the numbers of a phase without bounds of full turns and bounds implied by a length."""
    if phase.numbers.arcs is not None:
        return phase.numbers
    bounds, unimplied = phase.numbers.controls, find_bounds_not_implied_by_norm(problem, phase)
    angles = _find_unrestricted_angles(problem, phase, unimplied)
    free = angles.unbounded_controls
    lower, upper = np.where(free, -np.inf, unimplied.lower), np.where(free, np.inf, unimplied.upper)
    if np.array_equal(lower, bounds.lower) and np.array_equal(upper, bounds.upper):
        return phase.numbers
    return replace(phase.numbers, controls=Interval(lower, upper), turns=angles if np.any(free) else None)


def _find_unrestricted_angles(problem: ProblemData, phase: Phase, box: Interval) -> UnboundedAngles:
    """Return the controls that are angles with bounds of at least one turn."""
    width, zeros = box.upper - box.lower, np.zeros(box.lower.size)
    angles = UnboundedAngles(zeros - np.inf, zeros + np.inf, zeros)
    bounded = np.isfinite(width) & (width > 0)
    if not np.any(bounded):
        return angles
    if not _TURNING & problem.memoize(
        ("operations", phase.name), lambda: collect_casadi_operation_codes(stack_phase_expressions(phase))
    ):
        return angles
    probe = build_angle_invariance_test(problem, phase)
    if not np.all(np.any(np.isfinite(probe.function_values_without_shift), axis=1)):
        return angles
    for i in np.flatnonzero(bounded):
        period = probe.find_angle_period(int(i), [*PERIODS, width[i]])
        if period and width[i] >= (1.0 - AT_LIMIT) * period:  # pi is often written with six digits
            half, middle = 0.5 * max(period, width[i]), 0.5 * (box.lower[i] + box.upper[i])
            angles.periods[i], angles.lower[i], angles.upper[i] = period, middle - half, middle + half
    return angles


def build_angle_invariance_test(problem: ProblemData, phase: Phase, *, of_states: bool = False) -> AngleProbe:
    """Return a probe of all functions along a phase at random times, states, controls and free parameters."""
    t, x, u, _ = phase.model.symbolic_arguments()
    symbols, rng = (t, x, u, problem.parameter_symbols()), np.random.default_rng(20)
    times, states, controls, free = (rng.uniform(-1.5, 1.5, (s.numel(), 24)) for s in symbols)
    function = problem.memoize(
        ("along", phase.name),
        lambda: build_function_along_phase(problem, phase, "along", stack_phase_expressions(phase)),
    )
    values = phase.model.parameter_values
    if of_states:
        return AngleProbe(
            lambda x: evaluate_casadi_function(function, times[0], x, controls, values, free), states
        )
    return AngleProbe(
        lambda u: evaluate_casadi_function(function, times[0], states, u, values, free), controls
    )
