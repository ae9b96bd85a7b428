"""Variables of a model, their symbols, and their layout in a stacked vector."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from weakref import WeakValueDictionary

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import ErrorType, read_float_array, read_integer, require_type
from gnc_opt.array_types import Array
from gnc_opt.errors import (
    ArgumentError,
    ModelError,
    ProblemError,
    format_exception,
    quote_value,
    unknown_name_error,
)
from gnc_opt.model.casadi_expression_graph import contains_nan_constant


@dataclass(frozen=True)
class Variable:
    """A named, possibly vector-valued quantity.

    Attributes
    ----------
    name : str
    size : int
        Number of components.
    unit : str
        Unit, for printing and plotting.
    nominal : tuple of float or None
        Typical magnitude of each component, used for scaling; ``None``: automatic.

    Examples
    --------
    >>> print(cart.states["q"], cart.states["q"].labels)
    q (m) ('q',)
    """

    name: str
    size: int = 1
    unit: str = ""
    nominal: tuple[float, ...] | None = None

    @property
    def labels(self) -> tuple[str, ...]:
        """Component names: ``("q",)`` for a scalar, ``("r[0]", "r[1]", ...)`` for a vector."""
        return (self.name,) if self.size == 1 else tuple(f"{self.name}[{i}]" for i in range(self.size))

    def __str__(self) -> str:
        size = f"[{self.size}]" if self.size > 1 else ""
        unit = f" ({self.unit})" if self.unit else ""
        return f"{self.name}{size}{unit}"


def format_names_with_units(variables: Iterable[Variable]) -> str:
    """Return "q (m), v (m/s)"."""
    return ", ".join(f"{v.name} ({v.unit})" if v.unit else v.name for v in variables)


@dataclass(frozen=True)
class Layout:
    """Ordered variables of one kind ("state", "control", ...) stacked into one vector.

    Examples
    --------
    >>> print(cart.states.names, cart.states.units, cart.states.slice("v"))
    ('q', 'v') ('m', 'm/s') slice(1, 2, None)
    """

    kind: str
    variables: tuple[Variable, ...] = ()
    owner: str = ""

    @cached_property
    def size(self) -> int:
        """Length of the stacked vector."""
        return sum(v.size for v in self.variables)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Variable names in order."""
        return tuple(v.name for v in self.variables)

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Component names in order, one per entry of the stacked vector."""
        return tuple(label for v in self.variables for label in v.labels)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units, one per entry of the stacked vector."""
        return tuple(v.unit for v in self.variables for _ in range(v.size))

    @cached_property
    def _variable_slices(self) -> dict[str, slice]:
        ends = np.cumsum([v.size for v in self.variables])
        return {
            v.name: slice(int(end) - v.size, int(end)) for v, end in zip(self.variables, ends, strict=True)
        }

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name in self._variable_slices

    def __getitem__(self, name: str) -> Variable:
        self.slice(name)
        return next(v for v in self.variables if v.name == name)

    def slice(self, name: str) -> slice:
        """Return the slice of a variable in the stacked vector; raise `UnknownNameError` for others."""
        if name not in self:
            raise unknown_name_error(self.kind, name, self.owner or "it", self.names)
        return self._variable_slices[name]

    def indices(self, name: str) -> range:
        """Return the indices of a variable's components in the stacked vector."""
        return range(self.size)[self.slice(name)]

    def stack(self, values: Mapping[str, ArrayLike], default: float = np.nan) -> Array:
        """Stack values by name into one vector of shape (size,); missing names get ``default``."""
        out = np.full(self.size, default)
        for name, value in values.items():
            out[self.slice(name)] = read_vector(value, self[name].size, f"{self.kind} '{name}'")
        return out


def read_vector(value: ArrayLike, size: int, what: str, error: ErrorType = ProblemError) -> Array:
    """Return ``value`` as a float vector of ``size`` entries; scalars are repeated.

    Raises
    ------
    ProblemError
        A subclass may be given: the value is not numeric or has another number of entries.
    """
    array = read_float_array(value, what, error).ravel()
    if array.size == 1:
        return np.full(size, array[0])
    if array.size != size:
        needed = "one value" if size == 1 else f"{size} values, or one for all"
        raise error(f"{what} is given {array.size} values: give {needed}.")
    return array


def read_state_vector(value: ArrayLike, size: int, what: str, error: ErrorType = ProblemError) -> Array:
    """Return `read_vector` of a state or measurement; a list of one number is not accepted for several components."""
    if size != 1 and np.shape(read_float_array(value, what, error)) == (1,):
        raise error(f"{what} is given 1 value in a list: give {size} values.")
    return read_vector(value, size, what, error)


def read_nominal_magnitudes(value: ArrayLike, size: int, what: str, error: ErrorType = ProblemError) -> Array:
    """Return typical magnitudes as `read_vector`; raise an error unless they are positive and finite."""
    vector = read_vector(value, size, what, error)
    if not np.all(np.isfinite(vector) & (vector > 0)):
        raise error(f"{what} is {vector}: give positive finite numbers.")
    return vector


class Symbol(ca.SX):  # type: ignore[misc]
    """A named CasADi SX column vector.

    Use it in CasADi expressions (``ca.sin(q)``, ``q[0]``, ``a / m``) and as a dictionary key.

    Attributes
    ----------
    variable : Variable
    table_calls : list
        Table calls with expressions of this symbol.

    Examples
    --------
    >>> mass = go.Model("crate").parameter("mass", 2.0, unit="kg")
    >>> print(mass, 0.5 * mass * v**2)
    mass ((0.5*mass)*sq(v))
    """

    def __init__(self, variable: Variable) -> None:
        super().__init__(ca.SX.sym(variable.name, variable.size))
        self.variable = variable
        self.table_calls: list[Any] = []
        for element in ca.vertsplit(self):
            _OWNERS[element.element_hash()] = self

    def __float__(self) -> float:
        name = self.variable.name
        raise ModelError(
            f"'{name}' is a symbol without a numeric value: write ca.sqrt({name}) or ca.sin({name}), with casadi "
            f"imported as ca, not math.sqrt({name}) or math.sin({name})."
        )

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        """Evaluate ``np.linalg.norm(v)`` and similar calls as for a plain SX."""
        return function(
            *map(_convert_symbols_to_sx, args),
            **{name: _convert_symbols_to_sx(value) for name, value in kwargs.items()},
        )

    __hash__ = object.__hash__

    def __repr__(self) -> str:
        return f"<{self.variable.name}[{self.variable.size}]>"


def _convert_symbols_to_sx(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return type(value)(map(_convert_symbols_to_sx, value))
    return ca.SX(value) if isinstance(value, Symbol) else value


_OWNERS: WeakValueDictionary[int, Symbol] = WeakValueDictionary()
"""Declared symbol of each scalar symbol."""


def find_declared_symbols(scalars: Iterable[Any]) -> list[Symbol]:
    """Return the declared symbols of scalar SX symbols, without duplicates."""
    found = (_OWNERS.get(scalar.element_hash()) for scalar in scalars)
    return list({id(symbol): symbol for symbol in found if symbol is not None}.values())


class VectorSymbols(tuple[Any, Any]):
    """Vector control and its magnitude; arithmetic with the pair raises an error with the remedy.

    Examples
    --------
    >>> rocket = go.Model("rocket")
    >>> T, magnitude = rocket.vector_control("T", 3, unit="N")
    """

    @property
    def unpacking_hint(self) -> str:
        """Description of the pair, with the statement that unpacks it."""
        name = self[1].variable.name.removesuffix("_magnitude")
        return (
            f"the pair that vector_control('{name}', ...) returns: unpack it, "
            f"{name}, magnitude = model.vector_control('{name}', ...)."
        )

    def _raise_pair_not_unpacked_error(self, *_: Any) -> Any:
        raise ModelError(f"an operand is {self.unpacking_hint}")

    __add__ = __radd__ = __sub__ = __rsub__ = __neg__ = __pow__ = _raise_pair_not_unpacked_error
    __mul__ = __rmul__ = __truediv__ = __rtruediv__ = __matmul__ = __rmatmul__ = (
        _raise_pair_not_unpacked_error
    )


def convert_to_sx_column(
    value: Any, what: str, size: int | None = None, failure: ErrorType = ModelError
) -> Any:
    """Return ``value`` (SX, number, list of both) as an SX column with ``size`` rows; raise ``failure`` otherwise."""
    if isinstance(value, VectorSymbols):
        raise failure(f"{what} is {value.unpacking_hint}")
    try:
        parts = value if isinstance(value, (list, tuple)) else [value]
        expression = ca.vertcat(*[ca.SX(v) for v in parts])
    except (NotImplementedError, RuntimeError) as error:
        raise failure(
            f"{what} is {quote_value(value)}, which is neither a number nor a CasADi SX expression: "
            "build it from the symbols that state(), control() and parameter() return."
        ) from error
    if expression.shape[0] == 1:
        expression = expression.T
    if expression.shape[1] != 1 or expression.shape[0] == 0:
        raise failure(f"{what} has the shape {expression.shape}: give a column vector.")
    if size is not None and expression.shape[0] != size:
        raise failure(f"{what} has {expression.shape[0]} components: give {size}.")
    if contains_nan_constant(expression):
        raise failure(
            f"{what} contains nan: give numbers, and write ca.sqrt(x) or ca.sin(x), with casadi imported as ca, not "
            "math.sqrt(x) or math.sin(x)."
        )
    return ca.densify(expression)


def evaluate_user_function_as_column(
    function: Callable[..., Any], arguments: Sequence[Any], size: int, what: str, remedy: str
) -> Any:
    """Return the SX column (size, 1) of a user function; raise `ArgumentError` otherwise."""
    try:
        found = ca.SX(function(*arguments))
    except Exception as error:  # any exception of user code
        raise ArgumentError(f"{what} cannot be evaluated: {format_exception(error)}; {remedy}.") from error
    if found.shape != (size, 1):
        raise ArgumentError(f"{what} returns the shape {found.shape} where ({size}, 1) is needed: {remedy}.")
    return found


def find_unknown_symbols(expression: Any, known: list[Any]) -> list[str]:
    """Return the names of scalar symbols in ``expression`` that are not in ``known``."""
    allowed = {element.element_hash() for symbol in known for element in ca.vertsplit(ca.vec(symbol))}
    return [s.name() for s in ca.symvar(expression) if s.element_hash() not in allowed]


KINDS = ("state", "control", "parameter")


class VariableSet:
    """Symbols by kind and name, in order of declaration."""

    def __init__(self, owner: str, symbols: dict[str, dict[str, Symbol]] | None = None) -> None:
        self._owner = owner
        self._symbols = symbols or {kind: {} for kind in KINDS}

    def replace_control_variables(self, controls: Sequence[Symbol]) -> VariableSet:
        """Return the same states and parameters with other controls."""
        return VariableSet(self._owner, {**self._symbols, "control": {c.variable.name: c for c in controls}})

    def add_states_and_controls(self, states: Sequence[Symbol], controls: Sequence[Symbol]) -> VariableSet:
        """Return variables with additional states (no longer controls) and additional controls."""
        own = {
            "state": {**self._symbols["state"], **{s.variable.name: s for s in states}},
            "control": {**self._symbols["control"], **{c.variable.name: c for c in controls}},
        }
        own["control"] = {name: c for name, c in own["control"].items() if name not in own["state"]}
        return VariableSet(self._owner, {**self._symbols, **own})

    def declare_variable(
        self, kind: str, name: str, size: int, unit: str, nominal: ArrayLike | None
    ) -> Symbol:
        """Add a variable with a new name; see `Model.state`."""
        what = f"{kind} '{name}' of {self._owner}"
        size = read_integer(size, f"the size of {what}", 1, ModelError)
        require_type(unit, str, f"the unit of {what}", 'write unit="m/s"')
        scale = None
        if nominal is not None:
            scale = tuple(
                read_nominal_magnitudes(nominal, size, f"the nominal value of {what}", ModelError).tolist()
            )
        symbol = Symbol(Variable(name, size, unit, scale))
        self._symbols[kind][name] = symbol
        return symbol

    def layout(self, kind: str) -> Layout:
        """Return the layout of a kind."""
        return Layout(kind, tuple(symbol.variable for symbol in self._symbols[kind].values()), self._owner)

    def stack_symbols(self, kind: str) -> Any:
        """Return the symbols of a kind, SX (n, 1)."""
        return ca.vertcat(*self._symbols[kind].values()) if self._symbols[kind] else ca.SX(0, 1)

    @property
    def symbols(self) -> list[Symbol]:
        """All symbols."""
        return [symbol for kind in KINDS for symbol in self._symbols[kind].values()]

    @property
    def names(self) -> list[str]:
        """All names."""
        return [name for kind in KINDS for name in self._symbols[kind]]

    def get_symbol(self, name: str) -> Symbol:
        """Return the symbol with this name; raise `UnknownNameError` if there is none."""
        for kind in KINDS:
            if isinstance(name, str) and name in self._symbols[kind]:
                return self._symbols[kind][name]
        raise unknown_name_error("variable", name, self._owner, self.names)

    def read_state_name(self, key: Symbol | str) -> str:
        """Return the name of a state given by symbol or name; raise `ModelError` otherwise."""
        name = key if isinstance(key, str) else getattr(getattr(key, "variable", None), "name", None)
        if name is None:
            raise ModelError(
                f"ode() of {self._owner} got the key {key}: use the symbol that state() returned, or its name."
            )
        own = [
            kind
            for kind in KINDS
            if name in self._symbols[kind] and (isinstance(key, str) or self._symbols[kind][name] is key)
        ]
        if own != ["state"] and (own or not isinstance(key, str)):
            what = own[0] if own else "symbol of another model"
            raise ModelError(
                f"ode() of {self._owner}: '{name}' is a {what}; give dynamics to its states only."
            )
        self.layout("state").slice(name)
        return name
