"""Differences and retractions of states such as quaternions: errors relative to a reference, and their inverse."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from gnc_opt.errors import ModelError
from gnc_opt.model.model_variables import Layout, Variable, convert_to_sx_column


class StateDifferences:
    """Declared differences and retractions of a model's states, by name; see `Model.difference`."""

    def __init__(self, owner: str) -> None:
        self._owner = owner
        self._functions: dict[str, Callable[[Any, Any], Any]] = {}
        self._retractions: dict[str, Callable[[Any, Any], Any]] = {}

    def set_state_error_function(
        self, name: str, function: Callable[[Any, Any], Any], retraction: Callable[[Any, Any], Any] | None
    ) -> None:
        """Store difference and retraction of a state, replacing earlier ones."""
        self._functions[name] = function
        self._retractions.pop(name, None)
        if retraction is not None:
            self._retractions[name] = retraction

    def iterate_state_error_expressions(self, states: Layout, x: Any, x_ref: Any) -> Iterator[Any]:
        """Yield the errors of states x relative to x_ref, both SX (n_states, 1), one SX column per state."""
        for name in states.names:
            rows = states.slice(name)
            if name in self._functions:
                what = f"the difference of state '{name}' in {self._owner}"
                yield convert_to_sx_column(self._functions[name](x[rows], x_ref[rows]), what)
            else:
                yield x[rows] - x_ref[rows]

    def build_state_error_layout(self, states: Layout, x: Any, x_ref: Any) -> Layout:
        """Return names, sizes and units of the errors."""
        parts = [
            Variable(v.name, e.shape[0], getattr(self._functions.get(v.name), "error_unit", v.unit))
            for v, e in zip(
                states.variables, self.iterate_state_error_expressions(states, x, x_ref), strict=True
            )
        ]
        return Layout("error", tuple(parts), self._owner)

    def retract_state(self, name: str, own: Any, error: Any) -> Any:
        """Return the state with a given error relative to ``own``, all SX columns."""
        if name not in self._functions:
            return own + error
        what = f"the retraction of state '{name}' in {self._owner}"
        if name not in self._retractions:
            raise ModelError(
                f"{what} is missing: give difference('{name}', ..., retraction=...) as its inverse."
            )
        value = convert_to_sx_column(self._retractions[name](own, error), what)
        if value.shape != own.shape:
            raise ModelError(
                f"{what} has the shape {value.shape} where {own.shape} is needed: return a state."
            )
        return value
