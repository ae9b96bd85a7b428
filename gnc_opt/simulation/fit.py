"""Whether plant, controller and blocks fit together; what does not is named."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from gnc_opt.control.controller import Controller
from gnc_opt.errors import ArgumentError, did_you_mean
from gnc_opt.model.layout import Variable
from gnc_opt.model.model import Model
from gnc_opt.simulation.block import Block
from gnc_opt.simulation.signals import Kinds


def check_measured(plant: Model, controller: Controller) -> None:
    """Refuse a plant without the states and outputs that the controller measures, and without those it follows."""
    for variable in controller.states.variables:
        _check_there(variable, plant, controller, "measures")
        if variable.name in plant.outputs and any(
            ca.which_depends(plant.output_expression(variable.name), plant.symbols("control"), 1, True)
        ):
            raise ArgumentError(
                f"controller '{controller.name}' measures the output '{variable.name}' of '{plant.name}', which "
                "depends on a control: measure one of states alone."
            )
    for variable in controller.followed.variables if controller.estimated is not None else ():
        if variable.name in plant.states:  # the plant may know nothing of what is estimated
            _check_there(variable, plant, controller, "estimates")


def _check_there(variable: Variable, plant: Model, controller: Controller, verb: str) -> None:
    kind = "output" if variable.name in plant.outputs else "state"
    layout = plant.outputs if kind == "output" else plant.states
    if variable.name not in layout:
        known = [*plant.states.names, *plant.outputs.names]
        raise ArgumentError(
            f"controller '{controller.name}' {verb} '{variable.name}', which the plant '{plant.name}' does not "
            f"have: {did_you_mean(variable.name, known)}"
        )
    if layout[variable.name].size != variable.size:
        raise ArgumentError(
            f"{kind} '{variable.name}' has {layout[variable.name].size} components in the plant "
            f"'{plant.name}' and {variable.size} in controller '{controller.name}'."
        )
    _check_unit(f"{kind} '{variable.name}'", plant, layout[variable.name].unit, variable.unit, controller)


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
