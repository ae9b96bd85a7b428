"""Quantities of a run: extremes, integrals and samples of expressions, accumulated during the integration.

Every integration step is evaluated at equidistant nodes of its dense output. Peaks between nodes are interpolated by a
parabola through three nodes if the curvature is nearly constant; otherwise, for example near kinks, the largest node is
used. The integral is evaluated by Boole's rule.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.argument_checks import read_display_name, require_distinct_names
from gnc_opt.array_types import Array
from gnc_opt.model.model_variables import Layout, Variable
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.simulation.dormand_prince import IntegrationStep
from gnc_opt.simulation.zero_crossing_events import read_plant_expression

MAX_SAMPLES = 101
"""Largest number of sampling times over a run, evenly spaced control steps including both ends."""

KEPT = ("max", "min", "integral")
"""Scalar results of a quantity per run, as named by the measures."""

BOOLE_WEIGHTS = tuple(w / 90 for w in (7, 32, 12, 32, 7))
"""Weights of Boole's rule for five equidistant nodes, relative to the interval."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """Expression that is monitored over a run, such as a distance, a tilt or the fuel mass.

    Campaigns have the measures ``max(name)``, ``min(name)``, ``integral(name)`` and `Campaign.envelope`.
    Peaks shorter than a third of an integration step may be missed; raise ``minor_steps`` to resolve them.

    Parameters
    ----------
    name : str
    expression : casadi.SX
        Function of the plant's symbols of time, states, parameters and (applied) controls, (1, 1).
    unit : str

    Examples
    --------
    >>> energy = Quantity("energy", 0.5 * v**2, "J/kg")
    """

    name: str
    expression: Any
    unit: str = ""

    def __post_init__(self) -> None:
        read_display_name(self.name, "quantity")


@dataclass(frozen=True, eq=False)
class Quantities:
    """Quantities of a loop, as a CasADi function."""

    layout: Layout
    rows: Any

    def __len__(self) -> int:
        return self.layout.size

    @classmethod
    def read_quantity_declarations(cls, plant: Model, declared: Sequence[Quantity]) -> Quantities:
        """Return the declared quantities of a plant; raise `ArgumentError` for invalid ones."""
        require_distinct_names([quantity.name for quantity in declared], "quantities of the closed loop")
        rows = [
            read_plant_expression(
                q.expression, f"the expression of quantity '{q.name}'", plant, controls=True
            )
            for q in declared
        ]
        layout = Layout("quantity", tuple(Variable(q.name, 1, q.unit) for q in declared), "the closed loop")
        y = ca.densify(ca.vertcat(ca.SX(0, 1), *rows))
        return cls(layout, ca.Function("quantities", plant.symbolic_arguments(), [y]))


def create_empty_extremes_and_integrals(count: int) -> Any:
    """Return the empty record (5 count,) of ``count`` quantities: see `merge_extremes_and_integrals`."""
    values = (-ca.inf, ca.inf, 0.0, ca.inf, ca.inf)
    return ca.DM(np.repeat([float(v) for v in values], count))


def merge_extremes_and_integrals(one: Any, other: Any) -> Any:
    """Return the record of two consecutive intervals: maximum, minimum, integral, first and last values; SX or MX."""
    a, b = _split_extremes_and_integrals(one), _split_extremes_and_integrals(other)
    first = ca.if_else(ca.fabs(a[3]) < ca.inf, a[3], b[3])
    last = ca.if_else(ca.fabs(b[4]) < ca.inf, b[4], a[4])
    return ca.vertcat(ca.fmax(a[0], b[0]), ca.fmin(a[1], b[1]), a[2] + b[2], first, last)


def _split_extremes_and_integrals(record: Any) -> tuple[Any, ...]:
    n = record.shape[0] // 5
    return tuple(record[i * n : (i + 1) * n] for i in range(5))


class Extremes:
    """``record`` (5 n_quantities,), SX, of quantities during integration; see `merge_extremes_and_integrals`."""

    def __init__(self, quantities: Quantities, parameters: Any, panels: int) -> None:
        self.quantities, self.parameters, self.panels = quantities, parameters, panels
        self.record = ca.SX(create_empty_extremes_and_integrals(len(quantities)))

    def __call__(self, taken: IntegrationStep, applied: Callable[[float], Any]) -> None:
        """Add an integration step to the record."""
        if not len(self.quantities):
            return
        nodes = np.linspace(0, 1, 4 * self.panels + 1).tolist()
        y = [self._evaluate_quantities_within_step(taken, nu, ca.densify(applied(nu))) for nu in nodes]
        panels = [y[4 * k : 4 * k + 5] for k in range(self.panels)]
        terms = [w * each for panel in panels for w, each in zip(BOOLE_WEIGHTS, panel, strict=True)]
        total = taken.length / self.panels * sum(terms)
        highest = _build_interpolated_maximum_function(len(y), y[0].shape[0])
        step = ca.vertcat(highest(*y), -highest(*(-each for each in y)), total, y[0], y[-1])
        active = ca.repmat(taken.length > 0, step.shape[0], 1)
        self.record = merge_extremes_and_integrals(
            self.record,
            ca.if_else(active, step, ca.SX(create_empty_extremes_and_integrals(len(self.quantities)))),
        )

    def _evaluate_quantities_within_step(self, taken: IntegrationStep, nu: float, u: Any) -> Any:
        x = taken.x if nu == 0 else taken.after if nu == 1 else taken.interpolate_state(nu)[0]
        return self.quantities.rows(taken.time + nu * taken.length, x, u, self.parameters)


@cache
def _build_interpolated_maximum_function(count: int, n: int) -> Any:
    """Return the function of the interpolated maximum of ``count`` equally spaced values (n,); CasADi inlines it."""
    y = [ca.SX.sym(f"y{i}", n) for i in range(count)]
    highest = y[0]
    for each in y[1:]:
        highest = ca.fmax(highest, each)
    curvatures = [2 * y[i] - y[i - 1] - y[i + 1] for i in range(1, len(y) - 1)]
    for k, curvature in enumerate(curvatures):
        rise = y[k + 2] - y[k]
        vertex = y[k + 1] + rise**2 / (8 * curvature)
        smooth = ca.logic_and(curvature > 0, ca.fabs(rise) <= 2 * curvature)
        for other in curvatures[max(k - 1, 0) : k + 2]:
            smooth = ca.logic_and(smooth, ca.fabs(other - curvature) <= 0.5 * curvature)
        highest = ca.if_else(smooth, ca.fmax(highest, vertex), highest)
    return ca.Function("maximum", y, [highest])


def select_quantity_sample_steps(n_steps: int) -> Array:
    """Return the control steps at whose start quantities are sampled, and the end, (n_samples,)."""
    return np.round(np.linspace(0, n_steps, min(MAX_SAMPLES, n_steps + 1))).astype(int)
