"""How far states are from a reference, and the way back, where neither is a subtraction or a sum."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from gnc_opt.errors import ModelError
from gnc_opt.model.layout import Layout, Variable
from gnc_opt.model.symbol import as_expression


class Differences:
    """Differences and retractions that a model's states were declared with, by name; see `Model.difference`."""

    def __init__(self, owner: str) -> None:
        self._owner = owner
        self._functions: dict[str, Callable[[Any, Any], Any]] = {}
        self._retractions: dict[str, Callable[[Any, Any], Any]] = {}

    def declare(
        self,
        name: str,
        function: Callable[[Any, Any], Any],
        retraction: Callable[[Any, Any], Any] | None,
    ) -> None:
        """Take those of a state in place of others."""
        self._functions[name] = function
        self._retractions.pop(name, None)
        if retraction is not None:
            self._retractions[name] = retraction

    def errors(self, states: Layout, x: Any, x_ref: Any) -> Iterator[Any]:
        """Yield the errors of states x relative to x_ref, both SX (n_states, 1), one SX column for each state."""
        for name in states.names:
            rows = states.slice(name)
            if name in self._functions:
                what = f"the difference of state '{name}' in {self._owner}"
                yield as_expression(self._functions[name](x[rows], x_ref[rows]), what)
            else:
                yield x[rows] - x_ref[rows]

    def layout(self, states: Layout, x: Any, x_ref: Any) -> Layout:
        """Return names, sizes and units of the errors."""
        parts = zip(states.variables, self.errors(states, x, x_ref), strict=True)
        return Layout("error", tuple(Variable(v.name, e.shape[0], v.unit) for v, e in parts), self._owner)

    def moved(self, name: str, own: Any, error: Any) -> Any:
        """Return a state, SX like ``own``, that is an error, an SX column, away from its own value."""
        if name not in self._functions:
            return own + error
        what = f"the retraction of state '{name}' in {self._owner}"
        if name not in self._retractions:
            raise ModelError(
                f"{what} is missing: give difference('{name}', ..., retraction=...) the way back."
            )
        value = as_expression(self._retractions[name](own, error), what)
        if value.shape != own.shape:
            raise ModelError(
                f"{what} has the shape {value.shape} where {own.shape} is needed: return a state."
            )
        return value
