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

_ARGUMENTS = (
    "const double *x, const double *x_other, const double *w, const double *c, double *y, double *y_other"
)

_HEAD = """
#include <math.h>
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
  memcpy(final, X, size * sizeof *X);
  for (long long k = 0; k < n; k++) {
    memcpy(now, final, size * sizeof *X);
    together(now, now + other, rows + k * KNOWN, C, final, final + other);
  }
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
    work = ", ".join(f"a{i}" for i in range(step.sz_w()))
    lines = [f"  pair {work};", *(_line(step, k) for k in range(step.n_instructions()))]
    leg = _LEG.replace("STATES", str(step.nnz_in(0))).replace("KNOWN", str(step.nnz_in(1)))
    return "\n".join([_HEAD, f"static void together({_ARGUMENTS}) {{", *lines, "}", leg])


def _line(step: Any, k: int) -> str:
    """Return the statement of an operation."""
    operation, sources, targets = (
        step.instruction_id(k),
        step.instruction_input(k),
        step.instruction_output(k),
    )
    if operation == ca.OP_OUTPUT:
        return f"  y[{targets[1]}] = a{sources[0]}[0], y_other[{targets[1]}] = a{sources[0]}[1];"
    if operation == ca.OP_CONST:
        value = _number(step.instruction_constant(k))
        return f"  a{targets[0]} = PAIR({value}, {value});"
    if operation == ca.OP_INPUT:
        one, other = (("x", "x_other"), ("w", "w"), ("c", "c"))[sources[0]]
        return f"  a{targets[0]} = PAIR({one}[{sources[1]}], {other}[{sources[1]}]);"
    names = [f"a{i}" for i in sources]
    if operation in _OF_VECTORS:
        return f"  a{targets[0]} = {_OF_VECTORS[operation].format(*names)};"
    each = [f"{_OF_EACH[operation]}({', '.join(f'{name}[{i}]' for name in names)})" for i in (0, 1)]
    return f"  a{targets[0]} = PAIR({', '.join(each)});"


def _number(value: float) -> str:
    if math.isnan(value):
        return "NAN"
    return value.hex() if math.isfinite(value) else f"{'-' if value < 0 else ''}INFINITY"
