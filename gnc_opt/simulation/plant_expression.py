"""Expressions of a plant's time, states and parameters, as events and quantities are made of."""

from __future__ import annotations

from typing import Any

from gnc_opt.errors import ArgumentError, did_you_mean
from gnc_opt.model.model import Model
from gnc_opt.model.symbol import as_expression, foreign_symbols


def plant_expression(value: Any, what: str, plant: Model, size: int = 1) -> Any:
    """Return an SX expression (size, 1) of time, states and parameters of the plant.

    Raises
    ------
    ArgumentError
        ``what`` has another size, or symbols of a control or of another model.
    """
    expression = as_expression(value, what, size, ArgumentError)
    t, x, _, p = plant.arguments()
    foreign = foreign_symbols(expression, [t, x, p])
    if foreign:
        known = [*plant.states.names, *plant.parameters.names]
        raise ArgumentError(
            f"{what} uses '{foreign[0]}', which is no state or parameter of the plant '{plant.name}': "
            f"{did_you_mean(foreign[0], known)}"
        )
    return expression
