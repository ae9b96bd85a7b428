"""Lanes: a step of scalar operations in C that takes two flights at once, one in each half of a vector register.

A run and the flight beside it go through the same operations with the same of what is known: one pass through the code
does for both. In each half every operation is the interpreter's, so the results have the same bits.
"""

from __future__ import annotations

import math
from typing import Any

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

LONG, PART = 8000, 500
"""Operations beyond which a step is written as several functions of so many, whose numbers are in memory. Compilers
take for one function more than in proportion: for 30 000 operations 54 s, in parts 7; for 126 000 over nine minutes, in
parts 16 s. Of short steps, whose numbers stay in registers, one function is up to half as fast again."""

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
    operations = range(step.n_instructions())
    alone = len(operations) <= LONG
    length = LONG if alone else PART
    parts = [operations[k : k + length] for k in range(0, len(operations), length)]
    place = "a{}" if alone else "a[{}]"
    handed = 0 if alone else step.sz_w()
    own = [f"  pair {', '.join(place.format(i) for i in range(step.sz_w()))};"] if alone else []
    bodies = [
        "\n".join([f"{_APART} part{k}({_ARGUMENTS}) {{", *own, *(_line(step, n, place) for n in part), "}"])
        for k, part in enumerate(parts)
    ]
    calls = "\n".join(f"    part{k}(a, x, x_other, w, c, y, y_other);" for k in range(len(parts)))
    leg = _LEG.replace("STATES", str(step.nnz_in(0))).replace("KNOWN", str(step.nnz_in(1)))
    leg = leg.replace("HANDED", str(handed)).replace("TOGETHER", calls)
    return "\n".join([_HEAD, *bodies, leg])


def _line(step: Any, k: int, place: str) -> str:
    """Return the statement of an operation, whose numbers are in such places."""
    operation = step.instruction_id(k)
    sources, targets = step.instruction_input(k), step.instruction_output(k)
    if operation == ca.OP_OUTPUT:
        name = place.format(sources[0])
        return f"  y[{targets[1]}] = {name}[0], y_other[{targets[1]}] = {name}[1];"
    target = place.format(targets[0])
    if operation == ca.OP_CONST:
        value = _number(step.instruction_constant(k))
        return f"  {target} = PAIR({value}, {value});"
    if operation == ca.OP_INPUT:
        one, other = (("x", "x_other"), ("w", "w"), ("c", "c"))[sources[0]]
        return f"  {target} = PAIR({one}[{sources[1]}], {other}[{sources[1]}]);"
    names = [place.format(i) for i in sources]
    if operation in _OF_VECTORS:
        return f"  {target} = {_OF_VECTORS[operation].format(*names)};"
    each = [f"{_OF_EACH[operation]}({', '.join(f'{name}[{i}]' for name in names)})" for i in (0, 1)]
    return f"  {target} = PAIR({', '.join(each)});"


def _number(value: float) -> str:
    if math.isnan(value):
        return "NAN"
    return value.hex() if math.isfinite(value) else f"{'-' if value < 0 else ''}INFINITY"
