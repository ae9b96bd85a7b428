"""Python expressions in text, evaluated on numbers or CasADi symbols without `eval`.

Only what formulas are made of is understood: numbers, names, ``+ - * / **``, comparisons, ``a if test else b``
and the functions below. Everything else is refused, so a file of expressions cannot run code.
"""

from __future__ import annotations

import ast
import difflib
import functools
import operator
from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": ca.sin, "cos": ca.cos, "tan": ca.tan, "exp": ca.exp, "log": ca.log, "sqrt": ca.sqrt,
    "asin": ca.asin, "acos": ca.acos, "atan": ca.atan, "atan2": ca.atan2,
    "sinh": ca.sinh, "cosh": ca.cosh, "tanh": ca.tanh, "abs": ca.fabs,
    "min": lambda *values: functools.reduce(ca.fmin, values),
    "max": lambda *values: functools.reduce(ca.fmax, values),
}  # fmt: skip

PI = 3.141592653589793

_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {ast.USub: operator.neg, ast.UAdd: operator.pos}
_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}


class ExpressionError(ValueError):
    """An expression that cannot be read or evaluated; the message names it and the culprit."""


def evaluate(expression: str | float, names: Mapping[str, Any], what: str) -> Any:
    """Evaluate an expression.

    Parameters
    ----------
    expression : str or float
        A number stands for itself.
    names : mapping
        Values of the names: floats or CasADi SX scalars. ``pi`` is always known.
    what : str
        Names the expression in error messages.

    Returns
    -------
    float or casadi.SX

    Raises
    ------
    ExpressionError
        Syntax error, unknown name or function, anything that is not a formula, or a number that overflows.
    """
    where = f"{what}, '{expression}',"
    if isinstance(expression, (int, float)):
        return float(expression)
    if not isinstance(expression, str):
        raise ExpressionError(f"{where} is neither a number nor an expression.")
    try:
        tree = ast.parse(expression.strip(), mode="eval")
    except SyntaxError as error:
        raise ExpressionError(f"{where} is not a Python expression: {error.msg}.") from error
    try:
        return _value(tree.body, {"pi": PI, **names}, where)
    except (ArithmeticError, RecursionError) as error:
        raise ExpressionError(f"{where} cannot be evaluated: {error}.") from error


def _value(node: ast.expr, names: Mapping[str, Any], where: str) -> Any:
    def value(inner: ast.expr) -> Any:
        return _value(inner, names, where)

    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        return float(node.value)
    if isinstance(node, ast.Name):
        return names[node.id] if node.id in names else _unknown("name", node.id, names, where)
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        result = _BINARY[type(node.op)](value(node.left), value(node.right))
        return float("nan") if isinstance(result, complex) else result
    if isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
        return _UNARY[type(node.op)](value(node.operand))
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in _COMPARISONS:
        return _COMPARISONS[type(node.ops[0])](value(node.left), value(node.comparators[0]))
    if isinstance(node, ast.IfExp):
        test = value(node.test)
        if isinstance(test, bool):
            return value(node.body if test else node.orelse)
        return ca.if_else(test, value(node.body), value(node.orelse))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        if node.func.id not in FUNCTIONS:
            return _unknown("function", node.func.id, FUNCTIONS, where)
        return _call(node.func.id, [value(argument) for argument in node.args], where)
    raise ExpressionError(f"{where} contains '{ast.unparse(node)}', which is not part of a formula.")


def _call(name: str, arguments: list[Any], where: str) -> Any:
    try:
        return FUNCTIONS[name](*arguments)
    except (TypeError, NotImplementedError) as error:
        raise ExpressionError(f"{where} calls {name}() with {len(arguments)} arguments.") from error


def _unknown(kind: str, name: str, known: Mapping[str, Any], where: str) -> Any:
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}."
    raise ExpressionError(f"{where} uses the {kind} '{name}', which is not defined; {hint}")
