"""Whether plant, controller and blocks fit together; what does not is named."""

from __future__ import annotations

from collections.abc import Sequence

from gnc_opt.control.controller import Controller
from gnc_opt.errors import ArgumentError, did_you_mean
from gnc_opt.model.model import Model
from gnc_opt.simulation.block import Block
from gnc_opt.simulation.signals import Kinds


def check_measured(plant: Model, controller: Controller) -> None:
    """Refuse a plant without the states that the controller measures."""
    for variable in controller.states.variables:
        if variable.name not in plant.states:
            raise ArgumentError(
                f"controller '{controller.name}' measures '{variable.name}', which the plant '{plant.name}' does not "
                f"have: {did_you_mean(variable.name, plant.states.names)}"
            )
        if plant.states[variable.name].size != variable.size:
            raise ArgumentError(
                f"state '{variable.name}' has {plant.states[variable.name].size} components in the plant "
                f"'{plant.name}' and {variable.size} in controller '{controller.name}'."
            )
        _check_unit(
            f"state '{variable.name}'", plant, plant.states[variable.name].unit, variable.unit, controller
        )


def _check_unit(what: str, plant: Model, unit: str, expected: str, controller: Controller) -> None:
    """Refuse two declared units that are written differently; where one is not declared, nobody knows."""
    one, other = ("".join(c for c in text if c not in " *·") for text in (unit, expected))
    if one and other and one != other:
        raise ArgumentError(
            f"{what} is in {unit} in the plant '{plant.name}' and in {expected} in controller '{controller.name}': "
            "declare the same unit in both models."
        )


def check_applied(plant: Model, applied: Kinds, controller: Controller) -> None:
    """Refuse signals that leave the actuators and are no controls of the plant."""
    for name, (size, unit) in applied.items():
        if name not in plant.controls:
            raise ArgumentError(
                f"'{name}' arrives at the plant '{plant.name}', which has no such control: "
                f"{did_you_mean(name, plant.controls.names)}"
            )
        if plant.controls[name].size != size:
            raise ArgumentError(
                f"control '{name}' has {plant.controls[name].size} components in the plant '{plant.name}', but {size} "
                "arrive there."
            )
        _check_unit(f"control '{name}'", plant, plant.controls[name].unit, unit, controller)


def check_names(blocks: Sequence[Block]) -> None:
    """Refuse two blocks of one name: their parameters could not be told apart."""
    names = [block.name for block in blocks]
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError(f"two blocks of the closed loop are called '{name}': rename one.")
