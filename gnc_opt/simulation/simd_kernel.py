"""Lanes: a step of scalar operations in C that takes two flights at once, one in each half of a vector register.

A run and the flight beside it go through the same operations with the same of what is known: one pass through the code
does for both. In each half every operation is the interpreter's, so the results have the same bits. What the
interpreter does to the same numbers more than once is done once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import casadi as ca

_OF_VECTORS = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "PAIR(1., 1.) / {0}",
    ca.OP_FABS: "BITS({0}, & ~SIGN)",
    ca.OP_COPYSIGN: "BITS({0}, & ~SIGN | (bits){1} & SIGN)",
    ca.OP_LT: "WHERE({0} < {1})",
    ca.OP_LE: "WHERE({0} <= {1})",
    ca.OP_EQ: "WHERE({0} == {1})",
    ca.OP_NE: "WHERE({0} != {1})",
    ca.OP_NOT: "WHERE({0} == ZERO)",
    ca.OP_AND: "WHERE(({0} != ZERO) & ({1} != ZERO))",
    ca.OP_OR: "WHERE(({0} != ZERO) | ({1} != ZERO))",
    ca.OP_IF_ELSE_ZERO: "BITS({1}, & ({0} != ZERO))",
}
_OF_EACH = {
    ca.OP_SQRT: "sqrt", ca.OP_EXP: "exp", ca.OP_LOG: "log", ca.OP_EXPM1: "expm1", ca.OP_LOG1P: "log1p",
    ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_TAN: "tan", ca.OP_ASIN: "asin", ca.OP_ACOS: "acos", ca.OP_ATAN: "atan",
    ca.OP_SINH: "sinh", ca.OP_COSH: "cosh", ca.OP_TANH: "tanh", ca.OP_ASINH: "asinh", ca.OP_ACOSH: "acosh",
    ca.OP_ATANH: "atanh", ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil", ca.OP_ATAN2: "atan2", ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow", ca.OP_FMIN: "fmin", ca.OP_FMAX: "fmax", ca.OP_HYPOT: "hypot", ca.OP_FMOD: "fmod",
    ca.OP_SIGN: "sign",
}  # fmt: skip
"""Functions of one half."""
_KNOWN = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, *_OF_VECTORS, *_OF_EACH}

LONG, PART = 10_000, 500
"""Distinct operations beyond which a step is written as several functions of so many, which hand on in memory what the
next ones need. Compilers take for one function more than in proportion: for 8400 operations 2 s, for 19 400 10 s,
in parts 7; for 126 000 over nine minutes. What it makes of them is an eighth faster than the parts."""

_ARGUMENTS = (
    "pair *a, const double *x, const double *x_other, const double *w, const double *c, "
    "double *y, double *y_other"
)

_APART = "static __attribute__((noinline)) void"

_HEAD = """
#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef double pair __attribute__((vector_size(16)));
typedef long long bits __attribute__((vector_size(16)));
static double sign(double a) { return a < 0 ? -1 : a > 0 ? 1 : a; }
#define PAIR(a, b) ((pair){a, b})
#define ZERO PAIR(0., 0.)
#define SIGN ((bits)PAIR(-0., -0.))
#define BITS(a, b) ((pair)((bits)(a) b))
#define WHERE(a) ((pair)((bits)(a) & (bits)PAIR(1., 1.)))
"""

_LEG = """
long long leg(const double *X, const double *rows, const double *C, double *final, long long n, long long flights) {
  const long long size = flights * STATES, other = size - STATES;
  double now[2 * STATES];
  pair *a = malloc((HANDED + 1) * sizeof *a);
  if (!a) return -1;
  memcpy(final, X, size * sizeof *X);
  for (long long k = 0; k < n; k++) {
    const double *x = now, *x_other = now + other, *w = rows + k * KNOWN, *c = C;
    double *y = final, *y_other = final + other;
    memcpy(now, final, size * sizeof *X);
TOGETHER
  }
  free(a);
  return n;
}
"""
"""A flight alone is in both halves."""


def in_lanes(step: Any) -> str:
    """Return the C of a leg of steps ``(X, w, C) -> X``; "" where it takes more than known operations on scalars."""
    if not step.is_a("SXFunction") or step.n_out() != 1:
        return ""
    if not _KNOWN.issuperset(step.instruction_id(k) for k in range(step.n_instructions())):
        return ""
    operations = _distinct(step)
    length = LONG if len(operations) <= LONG else PART
    parts = [range(k, min(k + length, len(operations))) for k in range(0, len(operations), length)]
    homes = _homes(operations, parts)
    bodies, calls = [], []
    for k, part in enumerate(parts):
        bodies += [f"{_APART} part{k}({_ARGUMENTS}) {{", *_statements(operations, part, homes), "}"]
        calls.append(f"    part{k}(a, x, x_other, w, c, y, y_other);")
    leg = _LEG.replace("STATES", str(step.nnz_in(0))).replace("KNOWN", str(step.nnz_in(1)))
    handed = str(1 + max(homes.values(), default=0))
    leg = leg.replace("HANDED", handed).replace("TOGETHER", "\n".join(calls))
    return "\n".join([_HEAD, *bodies, leg])


class _Operation(NamedTuple):
    """An operation on what the operations of these numbers make, and what else it is told: which entry of which input
    or output, or the number of a constant."""

    code: int
    reads: tuple[int, ...]
    place: tuple[int, ...] = ()
    value: str = ""


def _distinct(step: Any) -> list[_Operation]:
    """Return the operations of a step, in its order, without those that do the same to the same once more."""
    numbers: dict[_Operation, int] = {}
    found: dict[int, int] = {}  # by place of the interpreter: the operation whose result is there now
    for k in range(step.n_instructions()):
        code, read, made = step.instruction_id(k), step.instruction_input(k), step.instruction_output(k)
        if code == ca.OP_INPUT:
            operation = _Operation(code, (), tuple(read))
        elif code == ca.OP_CONST:
            operation = _Operation(code, (), value=_number(step.instruction_constant(k)))
        else:
            place = tuple(made) if code == ca.OP_OUTPUT else ()
            operation = _Operation(code, tuple(found[i] for i in read), place)
        number = numbers.setdefault(operation, len(numbers))
        if code != ca.OP_OUTPUT:
            found[made[0]] = number
    return list(numbers)


def _homes(operations: Sequence[_Operation], parts: Sequence[range]) -> dict[int, int]:
    """Return the places in memory of the results that parts after their own read; they share them one after another."""
    last = {number: k for k, part in enumerate(parts) for n in part for number in operations[n].reads}
    homes: dict[int, int] = {}
    leaving: list[list[int]] = [[] for _ in parts]
    free: list[int] = []
    taken = 0
    for k, part in enumerate(parts):
        free += leaving[k]
        for n in part:
            if last.get(n, k) > k:
                if not free:
                    free, taken = [taken], taken + 1
                homes[n] = free.pop()
                leaving[last[n]].append(homes[n])
    return homes


def _statements(operations: Sequence[_Operation], part: range, homes: dict[int, int]) -> Iterator[str]:
    """Yield the statements of a part. Each result is a variable of its own; those of parts before are read from memory
    once, and those for parts after go there at the end, where what was there has been read."""
    known: set[int] = set()
    for n in part:
        operation = operations[n]
        for number in operation.reads:
            if number < part.start and number not in known:
                known.add(number)
                yield f"  const pair v{number} = a[{homes[number]}];"
        if operation.code == ca.OP_OUTPUT:
            name, i = f"v{operation.reads[0]}", operation.place[1]
            yield f"  y[{i}] = {name}[0], y_other[{i}] = {name}[1];"
        else:
            yield f"  const pair v{n} = {_result(operation)};"
    for n in part:
        if n in homes:
            yield f"  a[{homes[n]}] = v{n};"


def _result(operation: _Operation) -> str:
    """Return the expression of what an operation makes."""
    code, names = operation.code, [f"v{number}" for number in operation.reads]
    if code == ca.OP_CONST:
        return f"PAIR({operation.value}, {operation.value})"
    if code == ca.OP_INPUT:
        which, i = operation.place
        one, other = (("x", "x_other"), ("w", "w"), ("c", "c"))[which]
        return f"PAIR({one}[{i}], {other}[{i}])"
    if code in _OF_VECTORS:
        return _OF_VECTORS[code].format(*names)
    each = [f"{_OF_EACH[code]}({', '.join(f'{name}[{i}]' for name in names)})" for i in (0, 1)]
    return f"PAIR({', '.join(each)})"


def _number(value: float) -> str:
    if math.isnan(value):
        return "NAN"
    return value.hex() if math.isfinite(value) else f"{'-' if value < 0 else ''}INFINITY"
