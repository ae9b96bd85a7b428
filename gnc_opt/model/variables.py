"""The states, controls and parameters that a model declares."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
from numpy.typing import ArrayLike

from gnc_opt.arguments import expect, read_integer
from gnc_opt.errors import ModelError, unknown_name
from gnc_opt.model.layout import Layout, Variable, as_magnitudes
from gnc_opt.model.symbol import Symbol

KINDS = ("state", "control", "parameter")


class Variables:
    """Symbols by kind and name, each kind in the order of its declarations."""

    def __init__(self, owner: str, symbols: dict[str, dict[str, Symbol]] | None = None) -> None:
        self._owner = owner
        self._symbols = symbols or {kind: {} for kind in KINDS}

    def with_controls(self, controls: Sequence[Symbol]) -> Variables:
        """Return the same states and parameters with other controls."""
        return Variables(self._owner, {**self._symbols, "control": {c.variable.name: c for c in controls}})

    def declare(self, kind: str, name: str, size: int, unit: str, nominal: ArrayLike | None) -> Symbol:
        """Add a variable of a name that is not taken; see `Model.state`."""
        what = f"{kind} '{name}' of {self._owner}"
        size = read_integer(size, f"the size of {what}", 1, ModelError)
        expect(unit, str, f"the unit of {what}", 'write unit="m/s"')
        scale = None
        if nominal is not None:
            scale = tuple(as_magnitudes(nominal, size, f"the nominal value of {what}", ModelError).tolist())
        symbol = Symbol(Variable(name, size, unit, scale))
        self._symbols[kind][name] = symbol
        return symbol

    def layout(self, kind: str) -> Layout:
        """Return names, sizes and units of a kind."""
        return Layout(kind, tuple(symbol.variable for symbol in self._symbols[kind].values()), self._owner)

    def stacked(self, kind: str) -> Any:
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

    def named(self, name: str) -> Symbol:
        """Return the symbol of a name; raise `UnknownNameError` if it has none."""
        for kind in KINDS:
            if isinstance(name, str) and name in self._symbols[kind]:
                return self._symbols[kind][name]
        raise unknown_name("variable", name, self._owner, self.names)

    def state_name(self, key: Symbol | str) -> str:
        """Return the name of a state that is told by its symbol or its name; raise `ModelError` for others."""
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
