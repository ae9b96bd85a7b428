"""The symbol that a declaration returns: a CasADi SX vector that knows its name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from weakref import WeakValueDictionary

import casadi as ca

from gnc_opt.arguments import ErrorType
from gnc_opt.errors import ModelError, shown
from gnc_opt.model.graph import holds_nan
from gnc_opt.model.layout import Variable


class Symbol(ca.SX):  # type: ignore[misc]
    """A named CasADi SX column vector.

    Use it in CasADi expressions (``ca.sin(q)``, ``q[0]``, ``a / m``) and as a dictionary key.

    Attributes
    ----------
    variable : Variable
    table_uses : list
        Calls of tables with expressions of this symbol: the only trace of a table in an expression.

    Examples
    --------
    >>> mass = go.Model("crate").parameter("mass", 2.0, unit="kg")
    >>> print(mass, 0.5 * mass * v**2)
    mass ((0.5*mass)*sq(v))
    """

    def __init__(self, variable: Variable) -> None:
        super().__init__(ca.SX.sym(variable.name, variable.size))
        self.variable = variable
        self.table_uses: list[Any] = []
        for element in ca.vertsplit(self):
            _OWNERS[element.element_hash()] = self

    def __float__(self) -> float:
        name = self.variable.name
        raise ModelError(
            f"'{name}' is a symbol and has no number: write ca.sin({name}), with casadi imported as ca, not "
            f"math.sin({name})."
        )

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        """Answer ``np.linalg.norm(v)`` and the like as CasADi does, which knows plain SX only."""
        return function(*map(_plain, args), **{name: _plain(value) for name, value in kwargs.items()})

    # Keys are compared by identity: CasADi's == builds an expression instead of answering.
    __hash__ = object.__hash__

    def __repr__(self) -> str:
        return f"<{self.variable.name}[{self.variable.size}]>"


def _plain(value: Any) -> Any:
    """Return a value with a plain SX for every symbol in it."""
    if isinstance(value, (list, tuple)):
        return type(value)(map(_plain, value))
    return ca.SX(value) if isinstance(value, Symbol) else value


_OWNERS: WeakValueDictionary[int, Symbol] = WeakValueDictionary()
"""From scalar symbols to the declared symbol that they are part of."""


def owners_of(scalars: Iterable[Any]) -> list[Symbol]:
    """Return the declared symbols that scalar SX symbols are part of, each once."""
    found = (_OWNERS.get(scalar.element_hash()) for scalar in scalars)
    return list({id(symbol): symbol for symbol in found if symbol is not None}.values())


def as_expression(value: Any, what: str, size: int | None = None, failure: ErrorType = ModelError) -> Any:
    """Return ``value`` (SX, number, list of both) as an SX column vector.

    Parameters
    ----------
    value : casadi.SX, float, array-like or list of these
    what : str
        Names the expression in error messages.
    size : int, optional
        Required number of rows.
    failure : class of GncOptError
        What to raise for a wrong size or type.
    """
    try:
        parts = value if isinstance(value, (list, tuple)) else [value]
        expression = ca.vertcat(*[ca.SX(v) for v in parts])
    except (NotImplementedError, RuntimeError) as error:
        raise failure(
            f"{what} is {shown(value)}, which is neither a number nor a CasADi SX expression: "
            "build it from the symbols that state(), control() and parameter() return."
        ) from error
    if expression.shape[1] != 1 and expression.shape[0] == 1:
        expression = expression.T
    if expression.shape[1] != 1 or expression.shape[0] == 0:
        raise failure(f"{what} has the shape {expression.shape}: give a column vector.")
    if size is not None and expression.shape[0] != size:
        raise failure(f"{what} has {expression.shape[0]} components: give {size}.")
    if holds_nan(expression):
        raise failure(
            f"{what} contains nan: give numbers, and write ca.sin(x), with casadi imported as ca, not math.sin(x)."
        )
    return ca.densify(expression)


def foreign_symbols(expression: Any, known: list[Any]) -> list[str]:
    """Return the names of the scalar symbols in ``expression`` that are not among ``known``."""
    allowed = {element.element_hash() for symbol in known for element in ca.vertsplit(ca.vec(symbol))}
    return [s.name() for s in ca.symvar(expression) if s.element_hash() not in allowed]
