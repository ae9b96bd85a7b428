"""Interval arithmetic: ranges and signs of the expressions of a problem.

Source: Moore, Kearfott & Cloud, Introduction to Interval Analysis, SIAM 2009, chapters 2 and 5; without outward
rounding. Repeated terms are treated as independent, so that ranges may be overestimated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.model.casadi_expression_graph import (
    JUMPS,
    collect_casadi_operation_codes,
    iterate_subexpressions,
    replace_subexpressions_by_hash,
)
from gnc_opt.planning.problem.bounds import Interval, intersect_bounds, unbounded_interval
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem_definition import ProblemData

Range: TypeAlias = "tuple[float, float]"

ANY: Range = (-math.inf, math.inf)


def bound_function_values(function: Any, arguments: Sequence[Interval]) -> Interval:
    """Return the range of every entry of an SXFunction's first output for ranges of its dense arguments."""
    size = function.size1_out(0)
    ranges, rows = [(0.0, 0.0)] * size, function.sparsity_out(0).row()
    work = [ANY] * function.sz_w()
    for k in range(function.n_instructions()):
        operation, source = function.instruction_id(k), function.instruction_input(k)
        target = function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            ranges[rows[target[1]]] = work[source[0]]
        elif operation == ca.OP_INPUT:
            box = arguments[source[0]]
            work[target[0]] = float(box.lower[source[1]]), float(box.upper[source[1]])
        elif operation == ca.OP_CONST:
            value = function.instruction_constant(k)
            work[target[0]] = (value, value)
        else:
            rule = _OPERATIONS.get(operation)
            result = rule(*(work[i] for i in source)) if rule else ANY
            for i in target:
                work[i] = ANY if any(map(math.isnan, result)) else result
    return Interval(np.array([a for a, _ in ranges]), np.array([b for _, b in ranges]))


def _add_intervals(a: Range, b: Range) -> Range:
    return a[0] + b[0], a[1] + b[1]


def _negate_interval(a: Range) -> Range:
    return -a[1], -a[0]


def _multiply_intervals(a: Range, b: Range) -> Range:
    # Zero times infinity is zero: infinity means "no limit" here.
    products = [x * y if x and y else 0.0 for x in a for y in b]
    return min(products), max(products)


def _invert_interval(a: Range) -> Range:
    if a[0] < 0 < a[1] or a[0] == a[1] == 0:
        return ANY
    ends = sorted(math.copysign(math.inf, a[0] + a[1]) if x == 0 else 1 / x for x in a)
    return ends[0], ends[1]


def _square_interval(a: Range) -> Range:
    low, high = sorted(map(abs, a))
    return 0.0 if a[0] <= 0 <= a[1] else low * low, high * high


def _bound_absolute_value(a: Range) -> Range:
    low, high = sorted(map(abs, a))
    return 0.0 if a[0] <= 0 <= a[1] else low, high


def _bound_square_root(a: Range) -> Range:
    return math.sqrt(max(a[0], 0.0)), math.sqrt(max(a[1], 0.0))


def _bound_exponential(a: Range) -> Range:
    def exponentiate_without_overflow(x: float) -> float:
        return math.inf if x > 700 else math.exp(x)

    return exponentiate_without_overflow(a[0]), exponentiate_without_overflow(a[1])


def _bound_power(a: Range, b: Range) -> Range:
    if a[0] < 0 or b[0] != b[1]:
        return ANY
    with np.errstate(all="ignore"):
        ends = np.float_power(a, b[0])
    return float(np.min(ends)), float(np.max(ends))


def _bound_sine(a: Range) -> Range:
    turn = 2.0 * math.pi
    if not a[1] - a[0] < turn:
        return -1.0, 1.0
    low, high = sorted(map(math.sin, a))
    peak, trough = (t + turn * math.ceil((a[0] - t) / turn) for t in (0.25 * turn, -0.25 * turn))
    return -1.0 if trough <= a[1] else low, 1.0 if peak <= a[1] else high


_OPERATIONS: dict[int, Callable[..., Range]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: _add_intervals,
    ca.OP_SUB: lambda a, b: _add_intervals(a, _negate_interval(b)),
    ca.OP_NEG: _negate_interval,
    ca.OP_MUL: _multiply_intervals,
    ca.OP_TWICE: lambda a: _add_intervals(a, a),
    ca.OP_DIV: lambda a, b: _multiply_intervals(a, _invert_interval(b)),
    ca.OP_INV: _invert_interval,
    ca.OP_SQ: _square_interval,
    ca.OP_SQRT: _bound_square_root,
    ca.OP_FABS: _bound_absolute_value,
    ca.OP_EXP: _bound_exponential,
    ca.OP_POW: _bound_power,
    ca.OP_CONSTPOW: _bound_power,
    ca.OP_FMIN: lambda a, b: (min(a[0], b[0]), min(a[1], b[1])),
    ca.OP_FMAX: lambda a, b: (max(a[0], b[0]), max(a[1], b[1])),
    ca.OP_SIN: _bound_sine,
    ca.OP_COS: lambda a: _bound_sine((a[0] + 0.5 * math.pi, a[1] + 0.5 * math.pi)),
    ca.OP_TANH: lambda a: (math.tanh(a[0]), math.tanh(a[1])),
}
"""Range functions of the CasADi operations."""

_RANGE_DRAWS = 6


@dataclass(frozen=True, eq=False)
class SymbolRanges:
    """Symbols (columns) and their ranges."""

    symbols: tuple[Any, ...]
    boxes: tuple[Interval, ...]

    @classmethod
    def from_phase(cls, problem: ProblemData, phase: Phase) -> SymbolRanges:
        """Return the domain of the functions along a phase."""
        initial, final = phase.time_ranges()
        p = phase.model.parameter_values
        values = Interval(p.copy(), p.copy())
        for name, box in problem.parameter_bounds.items():
            if name in phase.model.parameters:
                place = phase.model.parameters.slice(name)
                values.lower[place], values.upper[place] = box.lower, box.upper
        time = Interval(initial.lower, final.upper)
        boxes = (time, phase.numbers.states, phase.numbers.controls, values, problem.get_parameter_bounds())
        return cls((*phase.model.symbolic_arguments(), problem.parameter_symbols()), boxes)

    @classmethod
    def collect_boundary_variable_ranges(cls, problem: ProblemData) -> SymbolRanges:
        """Return the domain of end points, times, integrals and free parameters."""
        symbols, boxes = [problem.parameter_symbols()], [problem.get_parameter_bounds()]
        constants: dict[int, tuple[Any, float]] = {}  # phases may share a model
        for phase in problem.phases.values():
            numbers = phase.numbers
            symbols += [
                phase.initial_time,
                phase.final_time,
                phase.end_states("initial"),
                phase.end_states("final"),
            ]
            boxes += [*phase.time_ranges(), intersect_bounds(numbers.initial, numbers.states)]
            symbols.append(phase.integral_symbols())
            boxes += [
                intersect_bounds(numbers.final, numbers.states),
                unbounded_interval(len(phase.integrands)),
            ]
            model_parameters = zip(
                ca.vertsplit(phase.model.symbolic_arguments()[3]), phase.model.parameter_values, strict=True
            )
            constants |= {s.element_hash(): (s, value) for s, value in model_parameters}
        values = np.array([value for _, value in constants.values()])
        symbols.append(ca.vertcat(*(s for s, _ in constants.values())) if constants else ca.SX(0, 1))
        return cls(tuple(symbols), (*boxes, Interval(values, values)))

    @property
    def cache_key(self) -> bytes:
        """Key that is equal for equal ranges."""
        return b"".join(box.lower.tobytes() + box.upper.tobytes() for box in self.boxes)

    def bound_expression_values(self, column: Any) -> Interval:
        return bound_function_values(ca.Function("ranges", self.symbols, [ca.densify(column)]), self.boxes)

    def compute_monotonicity_signs(self, expression: Any, nodes: list[Any]) -> list[int]:
        """Return 1 for nodes in which a scalar expression is nondecreasing, -1 if it is nonincreasing, else 0."""
        z = ca.SX.sym("z", len(nodes))
        place = {node.element_hash(): z[i] for i, node in enumerate(nodes)}
        of_z = replace_subexpressions_by_hash(expression, place)
        boxes = (*self.boxes, self.bound_expression_values(ca.vertcat(*nodes)))
        within = SymbolRanges((*self.symbols, z), boxes)
        slopes = within.bound_expression_values(ca.jacobian(of_z, z).T)
        return [
            1 if low >= 0 else -int(high <= 0) for low, high in zip(slopes.lower, slopes.upper, strict=True)
        ]

    def find_expression_sign(self, expression: Any) -> int:
        """Return 1 for a nonnegative scalar, -1 for a nonpositive one, else 0."""
        value_range = self.bound_expression_values(expression)
        if value_range.lower[0] >= 0 or value_range.upper[0] <= 0:
            return 1 if value_range.lower[0] >= 0 else -1
        if expression.is_symbolic():
            return 0
        for symbol in ca.symvar(expression):  # intervals overestimate repeated factors: v / 0.8 - 0.8 v
            if is_affine(expression, symbol) and not np.any(
                sample_expression_randomly(ca.substitute(expression, symbol, 0.0))
            ):
                return self.find_expression_sign(symbol) * self.find_expression_sign(
                    ca.jacobian(expression, symbol)
                )
        return 0


def is_affine(column: Any, symbol: Any) -> bool:
    """Return whether a column is affine in symbols; operations with jumps, whose derivatives are zero, are not."""
    if not column.numel():
        return True
    if any(ca.which_depends(column, symbol, 2)):
        return False
    if not collect_casadi_operation_codes(column) & {*JUMPS}:
        return True
    jumps = (node for node in iterate_subexpressions(column) if node.op() in JUMPS)
    return not any(ca.depends_on(node, symbol) for node in jumps)


def sample_expression_randomly(column: Any) -> Array:
    """Return the values of a column, (n, n_draws), for several values of its symbols."""
    symbols, column = ca.vertcat(*ca.symvar(column)), ca.densify(column)
    if not symbols.numel():
        return np.tile(ca.evalf(column).full(), _RANGE_DRAWS)
    rng = np.random.default_rng(20)
    size = (symbols.numel(), _RANGE_DRAWS)
    values = rng.uniform(0.5, 1.5, size) * np.where(rng.random(size) < 0.4, -1.0, 1.0)
    return np.asarray(ca.Function("drawn", [symbols], [column])(values).full())
