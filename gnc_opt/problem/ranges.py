"""Interval arithmetic: between which values expressions lie while their arguments lie in theirs.

After Moore, Kearfott & Cloud, Introduction to Interval Analysis, SIAM 2009, chapters 2 and 5, without rounding
outwards. What occurs more than once counts as often: a range may be wider than need be.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from gnc_opt.problem.interval import Interval

Range: TypeAlias = "tuple[float, float]"

ANY: Range = (-math.inf, math.inf)


def ranges_of(function: Any, arguments: Sequence[Interval]) -> Interval:
    """Return the range of every entry of a function's first output.

    Parameters
    ----------
    function : casadi.Function
        Of class SXFunction, with dense columns for arguments.
    arguments : sequence of Interval
        One per argument, a limit for each of its rows.

    Returns
    -------
    Interval
        Without limits where an operation is none of those known here.
    """
    size = function.size1_out(0)
    found, rows = [(0.0, 0.0)] * size, function.sparsity_out(0).row()
    work = [ANY] * function.sz_w()
    for k in range(function.n_instructions()):
        operation, source = function.instruction_id(k), function.instruction_input(k)
        target = function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            found[rows[target[1]]] = work[source[0]]
        elif operation == ca.OP_INPUT:
            box = arguments[source[0]]
            work[target[0]] = float(box.lower[source[1]]), float(box.upper[source[1]])
        elif operation == ca.OP_CONST:
            value = function.instruction_constant(k)
            work[target[0]] = (value, value)
        else:
            known = _OPERATIONS.get(operation)
            result = known(*(work[i] for i in source)) if known else ANY
            for i in target:
                work[i] = ANY if any(map(math.isnan, result)) else result
    return Interval(np.array([a for a, _ in found]), np.array([b for _, b in found]))


def _add(a: Range, b: Range) -> Range:
    return a[0] + b[0], a[1] + b[1]


def _negative(a: Range) -> Range:
    return -a[1], -a[0]


def _times(a: Range, b: Range) -> Range:
    # Zero times infinity is zero: infinity stands for what has no limit, not for a value.
    products = [x * y if x and y else 0.0 for x in a for y in b]
    return min(products), max(products)


def _inverse(a: Range) -> Range:
    if a[0] < 0 < a[1] or a[0] == a[1] == 0:
        return ANY
    ends = sorted(math.copysign(math.inf, a[0] + a[1]) if x == 0 else 1 / x for x in a)
    return ends[0], ends[1]


def _square(a: Range) -> Range:
    low, high = sorted(map(abs, a))
    return 0.0 if a[0] <= 0 <= a[1] else low * low, high * high


def _magnitude(a: Range) -> Range:
    low, high = sorted(map(abs, a))
    return 0.0 if a[0] <= 0 <= a[1] else low, high


def _root(a: Range) -> Range:
    return math.sqrt(max(a[0], 0.0)), math.sqrt(max(a[1], 0.0))


def _exponential(a: Range) -> Range:
    def exp(x: float) -> float:
        return math.inf if x > 700 else math.exp(x)

    return exp(a[0]), exp(a[1])


def _power(a: Range, b: Range) -> Range:
    """Of a base that is not negative, with a constant exponent."""
    if a[0] < 0 or b[0] != b[1]:
        return ANY
    with np.errstate(all="ignore"):
        ends = np.float_power(a, b[0])
    return float(np.min(ends)), float(np.max(ends))


_OPERATIONS: dict[int, Callable[..., Range]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: _add,
    ca.OP_SUB: lambda a, b: _add(a, _negative(b)),
    ca.OP_NEG: _negative,
    ca.OP_MUL: _times,
    ca.OP_TWICE: lambda a: _add(a, a),
    ca.OP_DIV: lambda a, b: _times(a, _inverse(b)),
    ca.OP_INV: _inverse,
    ca.OP_SQ: _square,
    ca.OP_SQRT: _root,
    ca.OP_FABS: _magnitude,
    ca.OP_EXP: _exponential,
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_FMIN: lambda a, b: (min(a[0], b[0]), min(a[1], b[1])),
    ca.OP_FMAX: lambda a, b: (max(a[0], b[0]), max(a[1], b[1])),
    ca.OP_SIN: lambda _: (-1.0, 1.0),
    ca.OP_COS: lambda _: (-1.0, 1.0),
    ca.OP_TANH: lambda a: (math.tanh(a[0]), math.tanh(a[1])),
}
"""What is known of the operations of CasADi."""
