"""Quantity: a number along the way of a run, of which the extremes, the integral and some samples are kept.

It is looked at within the control steps, with what the actuators apply at each instant, and closely where it may be
largest or least. What is kept does not grow with the run: three numbers, and samples at `SAMPLES` instants at most.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arguments import read_label
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.model.layout import Layout, Variable
from gnc_opt.model.model import Model
from gnc_opt.simulation.control_step import ControlStep
from gnc_opt.simulation.plant_expression import plant_expression
from gnc_opt.simulation.within import along, near, switches

SAMPLES = 101
"""Instants of a flight at which quantities are kept, evenly spaced in control steps, ends included."""

KEPT = ("max", "min", "integral")
"""Numbers of a quantity that are kept of each run, as measures are called."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """A number that is followed over a run: a distance, a tilt, an excess over a corridor, fuel, a plume.

    Campaigns then have the measures ``max(name)``, ``min(name)`` and ``integral(name)`` (over time), and
    `Campaign.envelope`. A limit on the largest value of ``1 - distance`` is a keep-out of radius 1. Extremes are found
    to 1e-9, relative to max(1, \\|y\\|), where values and slopes at eight instants of a control
    step tell of them, of what the expression bends or jumps at (the arguments of abs, of max, of a comparison), too: a
    sphere that is crossed within a thousandth of a step is. Integrals are of cubics between these instants.

    Parameters
    ----------
    name : str
    expression : casadi.SX
        Of the plant's symbols of time, states, controls and parameters, (1, 1). Controls are what the actuators apply
        at that instant, without disturbances.
    unit : str

    Examples
    --------
    >>> from gnc_opt.simulation import Quantity
    >>> energy = Quantity("energy", 0.5 * v**2, "J/kg")
    """

    name: str
    expression: Any
    unit: str = ""

    def __post_init__(self) -> None:
        read_label(self.name, "quantity")


@dataclass(frozen=True, eq=False)
class Quantities:
    """The quantities of a loop as CasADi functions of its control steps.

    Attributes
    ----------
    layout : Layout
        Names and units.
    along, near : casadi.Function
        See `gnc_opt.simulation.within`.
    """

    layout: Layout
    along: Any
    near: Any

    def __len__(self) -> int:
        return self.layout.size

    @classmethod
    def of(cls, step: ControlStep, declared: tuple[Quantity, ...]) -> Quantities:
        """Return quantities of the plant of a loop, in its control steps."""
        rows = read_quantities(step.wiring.plant, declared)
        layout = Layout("quantity", tuple(Variable(q.name, 1, q.unit) for q in declared), "the closed loop")
        rows = ca.vertcat(rows, switches(rows))
        return cls(layout, along(step, rows), near(step, rows))


def read_quantities(plant: Model, declared: tuple[Quantity, ...]) -> Any:
    """Return the expressions of quantities of a plant, SX column.

    Raises
    ------
    ArgumentError
        Two of one name, symbols of another model, or wrong sizes.
    """
    names = [quantity.name for quantity in declared]
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError(f"two quantities of the closed loop are called '{name}': rename one.")
    rows = [
        plant_expression(q.expression, f"the expression of quantity '{q.name}'", plant, controls=True)
        for q in declared
    ]
    return ca.densify(ca.vertcat(ca.SX(0, 1), *rows))


def sample_steps(n_steps: int) -> Array:
    """Return the control steps at whose beginnings samples are kept, and the end, (n_samples,)."""
    return np.round(np.linspace(0, n_steps, min(SAMPLES, n_steps + 1))).astype(int)
