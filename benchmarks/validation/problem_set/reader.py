"""Optimal control problems from JSON: read a file, build each problem through the public API of gnc_opt.

The format: a list of documents with ``name``, ``constants``, ``parameters``, ``phases``, ``events``, ``objective``
and ``sense``; numbers may be Python expressions everywhere. In ``events`` and ``objective`` the ends of phase k
are called ``<state>_i<k>``, ``<state>_f<k>``, ``t_i<k>``, ``t_f<k>`` and ``<integral>_<k>``.

Expressions are evaluated on numbers or CasADi symbols without `eval`. Only what formulas are made of is understood:
numbers, names, ``+ - * / **``, comparisons, ``a if test else b`` and the functions of `FUNCTIONS`. Everything else is
refused, so a file of expressions cannot run code.
"""

from __future__ import annotations

import ast
import difflib
import functools
import json
import operator
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import casadi as ca

import gnc_opt as go

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


Document = Mapping[str, Any]
Names = dict[str, Any]


def read_documents(path: str | Path) -> list[dict[str, Any]]:
    """Return the problem documents of a file.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        It is not JSON, or no list of objects.
    """
    try:
        documents = json.loads(Path(path).read_text(encoding="utf-8"))
    except ValueError as error:  # JSON, or bytes that are no UTF-8
        raise ValueError(f"{path} is not JSON ({error}).") from error
    if not isinstance(documents, list) or not all(isinstance(d, dict) for d in documents):
        raise ValueError(f"{path} is not a list of problems.")
    return documents


def read_constants(document: Document) -> Names:
    """Return the constants of a document, each of which may use the earlier ones."""
    values: Names = {}
    for name, expression in document.get("constants", {}).items():
        values[name] = evaluate(expression, values, f"constant '{name}'")
    return values


def build_problem(document: Document) -> go.Problem:
    """Build a problem from its document, one model per phase.

    Raises
    ------
    ExpressionError
        An expression cannot be read or uses an unknown name.
    GncOptError
        What gnc_opt itself refuses.
    """
    problem = go.Problem(document["name"])
    constants = read_constants(document)
    names = {**constants, **_add_parameters(problem, document, constants)}
    for k, phase in enumerate(document["phases"], 1):
        names |= _PhaseBuilder(problem, document, constants, phase, k).build()
    for i, event in enumerate(document.get("events", []), 1):
        what = f"event {i}"
        expression = evaluate(event["expr"], names, what)
        limits = _limits(event, constants, what)
        if limits:
            problem.constrain(_label(event, what), expression, **limits)
    state_goal = problem.maximize if document.get("sense", "min") == "max" else problem.minimize
    state_goal(evaluate(document["objective"], names, "the objective"))
    return problem


def _add_parameters(problem: go.Problem, document: Document, constants: Names) -> Names:
    symbols: Names = {}
    for entry in document.get("parameters", []):
        lower, upper, guess = (_number(entry, key, constants) for key in ("lb", "ub", "guess"))
        symbols[entry["name"]] = problem.parameter(entry["name"], lower=lower, upper=upper, guess=guess)
    return symbols


class _PhaseBuilder:
    """One phase of a document: declares its model, states the phase, knows the names of its ends."""

    def __init__(
        self, problem: go.Problem, document: Document, constants: Names, phase: Document, number: int
    ) -> None:
        self.problem, self.phase, self.number = problem, phase, number
        self.document, self.constants = document, constants
        self.states, self.controls = phase["states"], phase.get("controls", [])

    def build(self) -> Names:
        """Add the phase; return what its ends and integrals are called."""
        model, names = self._model()
        leg = self.problem.phase(f"phase_{self.number}", model)
        leg.time(initial=self._range(self.phase["t0"], "t0"), final=self._range(self.phase["tf"], "tf"))
        leg.initial(**self._ranges(self.states, "x0"))
        leg.final(**self._ranges(self.states, "xf"))
        entries = [*self.states, *self.controls]
        leg.bounds(
            **{
                e["name"]: self._range([e.get("lb"), e.get("ub")], f"bounds of '{e['name']}'")
                for e in entries
            }
        )
        leg.scale(
            **{e["name"]: self._value(e["scale"], "scale") for e in entries if e.get("scale") is not None}
        )
        self._guess(leg, entries)
        for i, path in enumerate(self.phase.get("path", []), 1):
            limits = _limits(path, self.constants, f"path {i}")
            if limits:
                leg.path(
                    _label(path, f"path {i}"),
                    evaluate(path["expr"], names, self._where(f"path {i}")),
                    **limits,
                )
        return self._end_names(leg, names)

    def _model(self) -> tuple[go.Model, Names]:
        """Return the phase's model and everything its expressions may use."""
        model = go.Model(f"{self.document['name']}, phase {self.number}")
        names: Names = {**self.constants, "t": model.time}
        for entry in self.document.get("parameters", []):
            # The value is only a placeholder: the problem's parameter of this name takes its place.
            names[entry["name"]] = model.parameter(entry["name"], 1.0)
        names |= {e["name"]: model.state(e["name"]) for e in self.states}
        names |= {e["name"]: model.control(e["name"]) for e in self.controls}
        for name, expression in self.phase.get("aux", {}).items():
            names[name] = evaluate(expression, names, self._where(f"aux '{name}'"))
        model.ode(
            {
                state: evaluate(expression, names, self._where(f"the derivative of '{state}'"))
                for state, expression in self.phase["ode"].items()
            }
        )
        return model, names

    def _guess(self, leg: go.Phase, entries: list[Document]) -> None:
        guesses: dict[str, Any] = {}
        for entry in entries:
            guess = entry.get("guess")
            if isinstance(guess, list):
                guesses[entry["name"]] = tuple(
                    self._value(end, f"guess of '{entry['name']}'") for end in guess
                )
            elif guess is not None:
                guesses[entry["name"]] = self._value(guess, f"guess of '{entry['name']}'")
        times = self.phase.get("tguess")
        leg.guess(None if times is None else [self._value(end, "tguess") for end in times], **guesses)

    def _end_names(self, leg: go.Phase, names: Names) -> Names:
        k = self.number
        ends: Names = {f"t_i{k}": leg.initial_time, f"t_f{k}": leg.final_time}
        for entry in self.states:
            ends[f"{entry['name']}_i{k}"] = leg.initial_state(entry["name"])
            ends[f"{entry['name']}_f{k}"] = leg.final_state(entry["name"])
        for name, integrand in self.phase.get("integrals", {}).items():
            value = evaluate(integrand, names, self._where(f"integral '{name}'"))
            ends[f"{name}_{k}"] = leg.integral(value, name)
        return ends

    def _ranges(self, entries: list[Document], key: str) -> dict[str, Any]:
        return {
            e["name"]: self._range(e[key], f"{key} of '{e['name']}'")
            for e in entries
            if e.get(key) is not None
        }

    def _range(self, value: Any, what: str) -> Any:
        """A number stays one, ``[lo, hi]`` becomes a tuple with ``None`` for no limit."""
        if isinstance(value, list):
            if len(value) != 2:
                raise ExpressionError(f"{self._where(what)} has {len(value)} entries: give [lower, upper].")
            return tuple(None if end is None else self._value(end, what) for end in value)
        return None if value is None else self._value(value, what)

    def _value(self, value: str | float, what: str) -> float:
        return float(evaluate(value, self.constants, self._where(what)))

    def _where(self, what: str) -> str:
        return f"{what} in phase {self.number}"


def _limits(entry: Document, constants: Names, what: str) -> dict[str, float]:
    """Keyword arguments of `path` and `constrain` for ``lb <= expr <= ub``; none if there is no limit."""
    lower, upper = (_number(entry, key, constants, what) for key in ("lb", "ub"))
    if lower is not None and lower == upper:
        return {"equals": lower}
    return {key: value for key, value in (("lower", lower), ("upper", upper)) if value is not None}


def _label(entry: Document, what: str) -> str:
    """A constraint is called by its own expression where that fits, else by its place."""
    expression = str(entry["expr"])
    return f"{what}: {expression}" if len(expression) <= 40 and "[" not in expression else what


def _number(entry: Document, key: str, constants: Names, what: str = "") -> float | None:
    value = entry.get(key)
    where = f"{key} of {what or repr(entry.get('name'))}"
    return None if value is None else float(evaluate(value, constants, where))
