"""Checks of a problem's functions at the guess: non-finite values, kinks, jumps, coarse tables, norms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.errors import ProblemError, warn_user
from gnc_opt.model.casadi_expression_graph import collect_casadi_operation_codes, iterate_subexpressions
from gnc_opt.planning.problem.bounds import Interval, intersect_bounds
from gnc_opt.planning.problem.guess.initial_guess import SampledGuess, build_phase_guess
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.scaling_magnitudes import estimate_state_and_control_magnitudes
from gnc_opt.planning.problem.symbolic_expressions import (
    find_points_outside_tables,
    list_endpoint_arguments,
    list_endpoint_symbols,
    list_table_calls,
    stack_phase_expressions,
    substitute_parameters,
)

_IN_PHASES = "let a phase end there and link() the next one to it"
_KINKS: dict[int, tuple[str, str]] = {
    ca.OP_FABS: (
        "fabs, which has a kink",
        "use smooth_abs(), or split_control() for a control whose absolute value is part of the cost",
    ),
    ca.OP_SIGN: ("sign, which jumps", f"use tanh(x / width), or {_IN_PHASES}"),
    ca.OP_FLOOR: ("floor (or %), which jumps", _IN_PHASES),
    ca.OP_CEIL: ("ceil, which jumps", _IN_PHASES),
    ca.OP_FMOD: ("fmod, which jumps", _IN_PHASES),
    ca.OP_REMAINDER: ("remainder, which jumps", _IN_PHASES),
    ca.OP_FMIN: ("fmin, which has a kink", "use a control that path constraints keep below both"),
    ca.OP_FMAX: ("fmax, which has a kink", "use a control that path constraints keep above both"),
    **dict.fromkeys(
        (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE),
        ("a comparison (if_else), which switches", f"{_IN_PHASES}, or blend with tanh"),
    ),
}
"""Effect of each operation on a function, and its replacement."""

_EXTREMA = (ca.OP_FABS, ca.OP_FMIN, ca.OP_FMAX)
_REMEDIES = {
    "the rate of state": "use smooth_abs() for states, bounds() for a control that saturates, split_control() for a "
    f"dead zone or an absolute value of a control; or {_IN_PHASES}",
    "path constraint": "its feasible set is not convex (it has gaps, or limits on both sides): replace one "
    "side by bounds(), use smooth_abs(), or add a phase for each side",
    "integral": "it is not known to be convex in the cost: give bounds() that fix the signs of its factors, or use "
    "split_control() for a control, vector_control() for a norm, smooth_abs() for states",
}
"""Remedy for a kink that is not reformulated, by the kind of its expression."""

_CHECK_SMOOTH_FRACTIONS = np.linspace(0.0, 1.0, 11)


def warn_of_kinks(problem: ProblemData, phase: Phase) -> None:
    """Issue a `ProblemWarning` for each kind of nonsmooth operation along a phase, and for linear tables."""
    uses = list_table_calls(problem, phase)
    for table in dict.fromkeys(use.table for use in uses):
        if table.method == "linear":
            warn_user(
                f"table '{table.name}' in {phase.label} is linear and has a kink at each of its points, which "
                'slows solvers and refinement down: use method="bspline" or "pchip", or, if it is one of time, '
                "put mesh boundaries there."
            )
    if not collect_casadi_operation_codes(stack_phase_expressions(phase)) & _KINKS.keys():
        return
    table_hashes = frozenset[int]().union(*(use.subexpression_hashes for use in uses))
    for operation, (kind, label) in _find_first_kink_by_type(problem, phase, table_hashes):
        meaning, remedy = _KINKS[operation]
        if operation in _EXTREMA:
            remedy = _REMEDIES.get(kind, remedy)
        warn_user(f"{kind} '{label}' of {phase.label} contains {meaning}: {remedy}.")


def check_guess_in_tables(problem: ProblemData, phase: Phase, *, warn: bool) -> None:
    """Raise `ProblemError` if the guess leaves a table with outside="error"; optionally warn for other tables."""
    if not list_table_calls(problem, phase):
        return
    start = build_phase_guess(phase, _CHECK_SMOOTH_FRACTIONS)
    times = start.times[0] + _CHECK_SMOOTH_FRACTIONS * (start.times[1] - start.times[0])
    q = problem.get_parameter_guess()
    p = phase.model.parameter_values
    for point in find_points_outside_tables(problem, phase, times, start.states, start.controls, p, q):
        if point.table.outside == "error":
            raise ProblemError(
                f"the guess leaves a table ({point}): give another guess(), or a larger table."
            )
        if warn:
            warn_user(f"the guess leaves a table ({point}), which is extrapolated ('{point.table.outside}').")


def _find_first_kink_by_type(
    problem: ProblemData, phase: Phase, table_hashes: frozenset[int]
) -> Iterator[tuple[int, tuple[str, str]]]:
    """Yield the first operation of each kind of nonsmoothness, with kind and name of its expression."""
    t, x, u, _ = phase.model.symbolic_arguments()
    free = [phase.model.symbol(name) for name in problem.parameters.names if name in phase.model.parameters]
    changing = ca.vertcat(t, x, u, *free, problem.parameter_symbols())
    reported: set[str] = set()
    for kind, labels, column in _list_rates_paths_and_integrands(phase):
        for label, expression in zip(labels, ca.vertsplit(column) if labels else (), strict=True):
            for node in iterate_subexpressions(expression):
                operation = node.op()
                if operation not in _KINKS or node.element_hash() in table_hashes:
                    continue
                if _KINKS[operation][0] not in reported and ca.depends_on(node, changing):
                    reported.add(_KINKS[operation][0])
                    yield operation, (kind, label)


_CHECK_NORMS_FRACTIONS = np.linspace(0.2, 0.8, 4)
_REMEDY = (
    "if that is the norm of a vector, declare it with Model.vector_control() and limit it with norm_bounds()"
)


def warn_of_singular_norms(problem: ProblemData, phase: Phase) -> None:
    """Issue a `ProblemWarning` for each of `find_singular_norms`."""
    for text in find_singular_norms(problem, phase):
        warn_user(f"{text}.")


def find_singular_norms(problem: ProblemData, phase: Phase) -> list[str]:
    """Return the functions whose derivatives fail or vanish at zero controls, with replacements."""
    start = build_phase_guess(phase, _CHECK_NORMS_FRACTIONS, perturbed=False)
    times = start.times[0] + _CHECK_NORMS_FRACTIONS * (start.times[1] - start.times[0])
    q = problem.get_parameter_guess()
    box = phase.numbers.controls
    zeros = np.clip(np.zeros_like(start.controls), box.lower[:, None], box.upper[:, None])
    guessed = evaluate_functions_along_phase(problem, phase, times, start.states, start.controls, q)
    texts = []
    with_zeros = evaluate_functions_along_phase(problem, phase, times, start.states, zeros, q)
    for kind, at_zero in with_zeros.items():
        for row, defect in _find_undefined_derivatives(phase, at_zero, guessed[kind]):
            texts.append(f"{at_zero.what} '{at_zero.rows[row]}' of {phase.label} has {defect}: {_REMEDY}")
    return texts


def _find_undefined_derivatives(
    phase: Phase, at_zero: FunctionValues, guessed: FunctionValues
) -> Iterator[tuple[int, str]]:
    """Yield the rows with undefined or zero derivatives at zero controls and at the guess."""
    n = phase.model.states.size
    columns = slice(n, n + phase.model.controls.size)
    by_controls = at_zero.derivatives[:, columns]
    finite = np.all(np.isfinite(at_zero.values), axis=1)
    for row in np.flatnonzero(finite & ~np.all(np.isfinite(by_controls), axis=(1, 2))):
        yield int(row), "no derivative where controls are zero"
    if at_zero.what != "path constraint":  # the following cases concern limits
        return
    box, controls = phase.get_path_bounds(), phase.model.symbols("control")
    depends = np.array(ca.which_depends(phase.path_expression(), controls, 1, True))
    flat_at_zero = depends & np.all(by_controls == 0, axis=(1, 2))
    violated = (at_zero.values < box.lower[:, None]) | (at_zero.values > box.upper[:, None])
    at_limit = np.all((at_zero.values == box.lower[:, None]) | (at_zero.values == box.upper[:, None]), axis=1)
    for row in np.flatnonzero(flat_at_zero & at_limit):
        yield (
            int(row),
            "its limit, and no slope, where controls are zero, so that the solver's Jacobian is singular",
        )
    flat_at_guess = np.all(guessed.derivatives[:, columns] == 0, axis=(1, 2))
    for row in np.flatnonzero(flat_at_zero & np.any(violated, axis=1) & flat_at_guess):
        yield (
            int(row),
            "no slope at the guess, where controls are zero and it is violated, so that the solver cannot reduce it",
        )


_FRACTIONS = (np.arange(11) + 0.5) / 11
"""Fractions of a phase at which functions are evaluated; the ends are excluded, as by Gauss points."""

_BOUND_OFFSET = 1e-2
"""Scaled distance by which the guess is moved inside its bounds before the evaluation, as by IPOPT."""


def check_functions_finite_at_guess(problem: ProblemData) -> None:
    """Raise `ProblemError` for a function or derivative that is not finite at the guess."""
    ends: list[Any] = []
    for phase in problem.phases.values():
        ends += _check_phase_functions_finite(problem, phase)
    _check_endpoint_functions_finite(problem, ends)


@dataclass(frozen=True)
class FunctionValues:
    """Functions of one kind, their values (rows, times) and derivatives (rows, columns, times)."""

    what: str
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    values: Array
    derivatives: Array

    @classmethod
    def read_casadi_function_values(
        cls, kind: str, rows: tuple[str, ...], columns: tuple[str, ...], outputs: Any
    ) -> FunctionValues:
        values, jacobian = (np.asarray(output.full()) for output in outputs)
        shape = (len(rows), len(columns), values.shape[1])
        return cls(kind, rows, columns, values, jacobian.reshape(shape, order="F"))

    def find_nonfinite_value(self) -> tuple[str, int] | None:
        """Return the first quantity that is not finite, and the index of its time."""
        nonfinite_indices = np.argwhere(~np.isfinite(self.values))
        if nonfinite_indices.size:
            row, time = nonfinite_indices[np.argmin(nonfinite_indices[:, 1])]
            return f"{self.what} '{self.rows[row]}' is {self.values[row, time]}", int(time)
        nonfinite_indices = np.argwhere(~np.isfinite(self.derivatives))
        if nonfinite_indices.size:
            row, column, time = nonfinite_indices[np.argmin(nonfinite_indices[:, 2])]
            slope = (
                f"the derivative of {self.what} '{self.rows[row]}' with respect to '{self.columns[column]}'"
            )
            return f"{slope} is {self.derivatives[row, column, time]}", int(time)
        return None


@dataclass(frozen=True)
class NonfiniteValue:
    """Function or derivative that is not finite: name, time (s), states and controls."""

    what: str
    time: float
    point: Mapping[str, float]


def find_nonfinite_function(
    problem: ProblemData, phase: Phase, times: Array, states: Array, controls: Array, parameters: Array
) -> NonfiniteValue | None:
    """Return the first function along a trajectory (columns are times) that is not finite or has such a derivative."""
    for tried in evaluate_functions_along_phase(problem, phase, times, states, controls, parameters).values():
        bad = tried.find_nonfinite_value()
        if bad:
            labels = (*phase.model.states.labels, *phase.model.controls.labels)
            values = (*states[:, bad[1]], *controls[:, bad[1]])
            return NonfiniteValue(bad[0], float(times[bad[1]]), dict(zip(labels, values, strict=True)))
    return None


def evaluate_functions_along_phase(
    problem: ProblemData, phase: Phase, times: Array, states: Array, controls: Array, parameters: Array
) -> dict[str, FunctionValues]:
    """Return functions along a phase and their derivatives by kind; arguments as in `find_nonfinite_function`."""
    columns = (*phase.model.states.labels, *phase.model.controls.labels, *problem.parameters.labels)
    functions = {}
    for kind, rows, function in _get_phase_functions_with_jacobian(problem, phase):
        outputs = function(times[None], states, controls, phase.model.parameter_values, parameters)
        functions[kind] = FunctionValues.read_casadi_function_values(kind, rows, columns, outputs)
    return functions


def find_nonfinite_function_at_guess(problem: ProblemData, phase: Phase) -> NonfiniteValue | None:
    """Return the first function along the guess of a phase that is not finite or has such a derivative."""
    return _GuessSamples.from_phase(phase).find_nonfinite_function(problem, phase)


@dataclass(frozen=True)
class _GuessSamples:
    """Guess of a phase including its ends, its state scales, and (times, states, controls) inside the bounds."""

    start: SampledGuess
    scales: Array
    along: tuple[Array, Array, Array]

    @classmethod
    def from_phase(cls, phase: Phase) -> _GuessSamples:
        # The end points are included, since messages there name the user's functions.
        start = build_phase_guess(phase, np.array([0.0, *_FRACTIONS, 1.0]))
        scales, control_scales = estimate_state_and_control_magnitudes(phase)
        states = _move_values_inside_bounds(start.states[:, 1:-1], phase.numbers.states, scales)
        controls = _move_values_inside_bounds(start.controls[:, 1:-1], phase.numbers.controls, control_scales)
        times = start.times[0] + _FRACTIONS * (start.times[1] - start.times[0])
        return cls(start, scales, (times, states, controls))

    def find_nonfinite_function(self, problem: ProblemData, phase: Phase) -> NonfiniteValue | None:
        return find_nonfinite_function(problem, phase, *self.along, problem.get_parameter_guess())


def warn_of_singular_end_states(problem: ProblemData, phase: Phase) -> None:
    """Issue a `ProblemWarning` for functions with derivatives that are not finite at given initial or final states."""
    guessed, (*at, p), q = (
        _GuessSamples.from_phase(phase),
        phase.model.symbolic_arguments(),
        problem.parameter_symbols(),
    )
    times, inside, controls = (values[..., [0, -1]] for values in guessed.along)
    bounds, variables = (phase.numbers.initial, phase.numbers.final), ca.vertcat(*at[1:])
    given = [np.where(b.is_fixed, b.lower, x) for b, x in zip(bounds, inside.T, strict=True)]
    trajectory = np.append(guessed.start.times, times)[None], np.hstack([np.transpose(given), inside])
    values = *trajectory, np.tile(controls, 2), phase.model.parameter_values, problem.get_parameter_guess()
    for what, rows, expression in _list_rates_paths_and_integrands(phase):
        second = problem.substitute_parameters(phase, expression)
        for _ in range(2):
            second = ca.jtimes(second, variables, ca.DM.ones(variables.numel()))
        finite = np.isfinite(ca.Function("second", [*at, p, q], [second])(*values).full())
        for row, end in np.argwhere(~finite[:, :2] & finite[:, 2:])[:1]:
            warn_user(
                f"{what} '{rows[row]}' of {phase.label} has no finite derivatives at its {('initial', 'final')[end]} "
                "state: use sqrt(v**2 + eps) for a norm, smooth_abs() for |v|, or start slightly off."
            )


def _check_phase_functions_finite(problem: ProblemData, phase: Phase) -> list[Any]:
    """Evaluate the functions along a phase; return its arguments of the cost and the boundary constraints."""
    numbers, guessed = phase.numbers, _GuessSamples.from_phase(phase)
    start = guessed.start
    bad = guessed.find_nonfinite_function(problem, phase)
    if bad:
        when = f"t = {bad.time:.4g} {problem.time_unit}"
        raise _make_nonfinite_error(f"{bad.what} at the guess in {phase.label} at {when}", bad.point)
    integrals = np.zeros(0)
    if phase.integrands:
        integrands = evaluate_functions_along_phase(
            problem, phase, *guessed.along, problem.get_parameter_guess()
        )["integral"]
        integrals = integrands.values.mean(axis=1) * (start.times[1] - start.times[0])
    first = _move_values_inside_bounds(
        start.states[:, :1], intersect_bounds(numbers.initial, numbers.states), guessed.scales
    )
    last = _move_values_inside_bounds(
        start.states[:, -1:], intersect_bounds(numbers.final, numbers.states), guessed.scales
    )
    return [first, last, start.times[0], start.times[1], integrals, phase.model.parameter_values]


def _check_endpoint_functions_finite(problem: ProblemData, ends: list[Any]) -> None:
    """Evaluate the cost and the boundary constraints at the end points of the guess."""
    for what, rows, columns, function in _get_endpoint_functions_with_jacobian(problem):
        tried = FunctionValues.read_casadi_function_values(
            what, rows, columns, function(*ends, problem.get_parameter_guess())
        )
        bad = tried.find_nonfinite_value()
        if bad:
            raise _make_nonfinite_error(f"{bad[0]} at the end points of the guess", {})


def _move_values_inside_bounds(values: Array, bounds: Interval, scales: Array) -> Array:
    """Return values (n, N) moved into the bounds (n,), to the interior if the bounds differ."""
    lower, upper = bounds.lower, np.maximum(bounds.lower, bounds.upper)
    push = _BOUND_OFFSET * np.minimum(np.where(np.isfinite(upper - lower), upper - lower, np.inf), scales)
    return np.clip(values, (lower + push)[:, None], (upper - push)[:, None])


def _get_phase_functions_with_jacobian(
    problem: ProblemData, phase: Phase
) -> list[tuple[str, tuple[str, ...], Any]]:
    """Return kind, names and function (t, x, u, p, q) -> values, Jacobian of dynamics, paths and integrands."""
    t, x, u, p = phase.model.symbolic_arguments()
    q = problem.parameter_symbols()

    def build_phase_functions_with_jacobian() -> list[tuple[str, tuple[str, ...], Any]]:
        return [
            (
                what,
                rows,
                _build_function_with_jacobian(
                    problem.substitute_parameters(phase, expression), ca.vertcat(x, u, q), [t, x, u, p, q]
                ),
            )
            for what, rows, expression in _list_rates_paths_and_integrands(phase)
            if rows
        ]

    return problem.memoize(("check", phase.name), build_phase_functions_with_jacobian)


def _list_rates_paths_and_integrands(phase: Phase) -> tuple[tuple[str, tuple[str, ...], Any], ...]:
    return (
        ("the rate of state", phase.model.states.labels, phase.model.state_derivative()),
        ("path constraint", phase.path_labels, phase.path_expression()),
        ("integral", tuple(phase.integrands), phase.integrand_expression()),
    )


def _get_endpoint_functions_with_jacobian(
    problem: ProblemData,
) -> list[tuple[str, tuple[str, ...], tuple[str, ...], Any]]:
    """Return kind, names, variables and function of the cost and of the boundary constraints."""

    def build_endpoint_functions() -> list[tuple[str, tuple[str, ...], tuple[str, ...], Any]]:
        variables, columns = list[Any](), list[str]()
        for phase in problem.phases.values():
            variables += list_endpoint_symbols(phase)
            columns += [
                f"{end} {label} of {phase.name}"
                for end in ("initial", "final")
                for label in phase.model.states.labels
            ]
            columns += [f"{end} time of {phase.name}" for end in ("initial", "final")]
            columns += [f"integral {label} of {phase.name}" for label in phase.integrands]
        q = problem.parameter_symbols()
        columns += problem.parameters.labels
        kinds = (
            ("the cost of problem", (problem.name,), problem.cost),
            ("constraint", problem.constraint_labels(), problem.constraint_expression()),
        )
        built = []
        for what, rows, expression in kinds:
            if rows:
                bound = substitute_parameters(problem, expression)
                function = _build_function_with_jacobian(
                    bound, ca.vertcat(*variables, q), list_endpoint_arguments(problem)
                )
                built.append((what, rows, tuple(columns), function))
        return built

    return problem.memoize("check ends", build_endpoint_functions)


def _build_function_with_jacobian(expression: Any, variables: Any, arguments: list[Any]) -> Any:
    jacobian = ca.densify(ca.jacobian(expression, variables))
    return ca.Function("check", arguments, [ca.densify(expression), ca.vec(jacobian)])


def _make_nonfinite_error(what: str, point: Mapping[str, float]) -> ProblemError:
    shown = ", ".join(f"{name} = {value:.4g}" for name, value in point.items()) if len(point) <= 12 else ""
    return ProblemError(
        f"{what}{f' ({shown})' if shown else ''}: give another guess(), or bounds that keep away from the "
        "singularity."
    )
