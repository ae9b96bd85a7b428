"""Expressions of a plant's time, states and parameters, as events and quantities are made of."""

from __future__ import annotations

from typing import Any

from gnc_opt.errors import ArgumentError, did_you_mean
from gnc_opt.model.model import Model
from gnc_opt.model.symbol import as_expression, foreign_symbols


def plant_expression(value: Any, what: str, plant: Model, size: int = 1, *, controls: bool = False) -> Any:
    """Return an SX expression (size, 1) of time, states and parameters of the plant, and of controls if they may be.

    Raises
    ------
    ArgumentError
        ``what`` has another size, or symbols of a control that may not be there or of another model.
    """
    expression = as_expression(value, what, size, ArgumentError)
    t, x, u, p = plant.arguments()
    foreign = foreign_symbols(expression, [t, x, u, p] if controls else [t, x, p])
    if foreign:
        kinds = [plant.states, *([plant.controls] if controls else []), plant.parameters]
        wanted = "state, control or parameter" if controls else "state or parameter"
        raise ArgumentError(
            f"{what} uses '{foreign[0]}', which is no {wanted} of the plant '{plant.name}': "
            f"{did_you_mean(foreign[0], [name for kind in kinds for name in kind.names])}"
        )
    return expression
