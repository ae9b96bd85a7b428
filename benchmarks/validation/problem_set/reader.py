"""Optimal control problems from JSON: read a file, build each problem through the public API of gnc_opt.

The format: a list of documents with ``name``, ``constants``, ``parameters``, ``phases``, ``events``, ``objective``
and ``sense``; numbers may be Python expressions everywhere. In ``events`` and ``objective`` the ends of phase k
are called ``<state>_i<k>``, ``<state>_f<k>``, ``t_i<k>``, ``t_f<k>`` and ``<integral>_<k>``.

Python evaluates the expressions, on numbers or CasADi symbols: the file is trusted.
"""

from __future__ import annotations

import functools
import json
import math
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


class ExpressionError(ValueError):
    """An expression that cannot be evaluated; the message names it and the cause."""


def evaluate(expression: str | float, names: Mapping[str, Any], what: str) -> Any:
    """Return the value of an expression, a float or casadi.SX.

    Parameters
    ----------
    expression : str or float
        A number stands for itself.
    names : mapping
        Values of the names: floats or CasADi SX scalars. ``pi`` is always known.
    what : str
        Names the expression in the message of `ExpressionError`.
    """
    known = {**FUNCTIONS, "pi": math.pi, **names}
    try:
        value = eval(str(expression), {"__builtins__": {}}, known)
        return value if isinstance(value, ca.SX) else float(value)
    except Exception as error:
        raise ExpressionError(f"{what}, '{expression}', cannot be evaluated: {error}.") from error


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
                samples = [self._value(sample, f"guess of '{entry['name']}'") for sample in guess]
                guesses[entry["name"]] = tuple(samples) if len(samples) == 2 else samples
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
