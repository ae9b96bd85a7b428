"""Import of dynamics written in CasADi: declaration of the variables, and substitution of the model's symbols."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import casadi as ca

from gnc_opt.errors import ModelError, quote_value, unknown_name_error


@dataclass(frozen=True)
class DeclaredVariable:
    """Variable to declare: name, number of components and, if any, the user's symbol."""

    name: str
    size: int
    symbol: Any = None


def read_variable_declarations(given: Any, what: str) -> list[DeclaredVariable]:
    """Return the variables from symbols, a sequence of them, or a mapping from names to symbols or sizes.

    Symbols without a mapping keep their names. ``what`` is the subject of the `ModelError`.
    """
    if isinstance(given, Mapping):
        return [_read_model_variable_declaration(name, value, what) for name, value in given.items()]
    columns = given if isinstance(given, (list, tuple)) else [given]
    return [
        entry
        for column in columns
        for entry in _list_scalar_declared_variables(_require_casadi_column(column, what))
    ]


def read_parameter_values(given: Mapping[str, Any] | None, names: Sequence[str], what: str) -> dict[str, Any]:
    """Return the values by name; raise `UnknownNameError` for a name that is not in ``names``."""
    for name in given or {}:
        if name not in names:
            raise unknown_name_error("variable", name, what, names)
    return dict(given or {})


def read_state_derivative(
    f: Any, arguments: Mapping[str, Any], symbols: Mapping[str, list[Any]], size: int, what: str
) -> Any:
    """Return dx/dt, SX (size, 1), in the model's symbols; raise `ModelError` for other inputs, sizes or symbols.

    Parameters
    ----------
    f : casadi.Function, or casadi.SX or casadi.MX (size, 1), or a list of their rows
    arguments, symbols : mapping
        Symbols (n, 1) of t, x, u and p: of the model (SX), and of ``f``.
    """
    function = f if isinstance(f, ca.Function) else _build_state_derivative_function(f, symbols, what)
    _check_dynamics_function_inputs(function, arguments, what)
    inputs = {name: arguments[name] for name in function.name_in()}
    names = function.name_out()
    if len(names) != 1 and "dx_dt" not in names:
        raise ModelError(f"{what} returns {', '.join(names)}: return only dx/dt, or name it dx_dt.")
    value = function(**inputs)["dx_dt" if "dx_dt" in names else names[0]]
    if tuple(value.shape) != (size, 1):
        raise ModelError(f"{what} has the shape {tuple(value.shape)}: the states require ({size}, 1).")
    return value


def _build_state_derivative_function(expression: Any, symbols: Mapping[str, list[Any]], what: str) -> Any:
    if any(symbol is None for stack in symbols.values() for symbol in stack):
        raise ModelError(f"{what} is an expression: give the symbols that it is written in, not their sizes.")
    names = [name for name, stack in symbols.items() if stack]
    try:
        inputs = [ca.vertcat(*symbols[name]) for name in names]
        column = ca.vertcat(*expression) if isinstance(expression, (list, tuple)) else expression
        function = ca.Function("f", inputs, [column], names, ["dx_dt"], {"allow_free": True})
    except (NotImplementedError, RuntimeError) as error:
        raise ModelError(
            f"{what} is {quote_value(expression)} or mixes SX and MX: "
            "give an expression in symbols of one kind, each once."
        ) from error
    if function.has_free():
        free = ", ".join(function.get_free())
        raise ModelError(f"{what} also uses {free}: name all its symbols, as t=, x, u or p=.")
    return function


def _check_dynamics_function_inputs(function: Any, arguments: Mapping[str, Any], what: str) -> None:
    for i, name in enumerate(function.name_in()):
        if name not in arguments:
            raise ModelError(f"{what} has the input '{name}': name its inputs among {', '.join(arguments)}.")
        wanted = (arguments[name].shape[0], 1)
        if tuple(function.size_in(i)) != wanted and (wanted[0] or function.numel_in(i)):
            raise ModelError(
                f"{what} takes {name} of shape {tuple(function.size_in(i))}: the variables require {wanted}."
            )


def _read_model_variable_declaration(name: str, value: Any, what: str) -> DeclaredVariable:
    if isinstance(value, Integral):
        return DeclaredVariable(name, int(value))
    column = _require_casadi_column(value, what)
    return DeclaredVariable(name, column.shape[0], column)


def _require_casadi_column(value: Any, what: str) -> Any:
    if not isinstance(value, (ca.SX, ca.MX)) or not value.is_valid_input() or value.shape[1] != 1:
        raise ModelError(f"{what} are given as {quote_value(value)}: give columns of SX or MX symbols.")
    return value


def _list_scalar_declared_variables(column: Any) -> Iterator[DeclaredVariable]:
    if isinstance(column, ca.MX):
        for part in column.primitives():
            yield DeclaredVariable(part.name(), part.shape[0], part)
        return
    names = [element.name() for element in ca.vertsplit(column)] if column.shape[0] else []
    first = 0
    while first < len(names):
        stem = names[first].removesuffix("_0")
        last = first + 1
        while last < len(names) and names[last] == f"{stem}_{last - first}":
            last += 1
        yield DeclaredVariable(stem if last > first + 1 else names[first], last - first, column[first:last])
        first = last
