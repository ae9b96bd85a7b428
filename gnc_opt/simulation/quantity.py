"""Quantity: a number along the way of a run, of which the extremes, the integral and some samples are kept.

It is looked at at the beginnings and the ends of the control steps, not between them, with the mean over the step of
what the actuators apply. What is kept does not grow with the run: three numbers, and samples at `SAMPLES` instants at
most.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arguments import read_label
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.model.layout import Layout, Variable
from gnc_opt.model.model import Model
from gnc_opt.simulation.outcome import Outcome, RunStatus
from gnc_opt.simulation.plant_expression import plant_expression
from gnc_opt.tolerances import SAME_TIME

SAMPLES = 101
"""Instants of a flight at which quantities are kept, evenly spaced in control steps, ends included."""

KEPT = ("max", "min", "integral")
"""Numbers of a quantity that are kept of each run, as measures are called."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """A number that is followed over a run: a distance, a tilt, an excess over a corridor, fuel, a plume.

    Campaigns then have the measures ``max(name)``, ``min(name)`` and ``integral(name)`` (over time), and
    `Campaign.envelope`. A limit on the largest value of ``1 - distance`` is a keep-out of radius 1; what passes it
    within a control step is not seen, but by an `Event` with ``failure=True``, whose instant is found between the
    steps.

    Parameters
    ----------
    name : str
    expression : casadi.SX
        Of the plant's symbols of time, states, controls and parameters, (1, 1). Controls are what the actuators apply,
        on average over a control step and without disturbances.
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
    """The quantities of a loop as a CasADi function of its plant.

    Attributes
    ----------
    layout : Layout
        Names and units.
    values : casadi.Function
        ``(t, x, u, p) -> y``, columns.
    """

    layout: Layout
    values: Any

    def __len__(self) -> int:
        return self.layout.size

    @classmethod
    def of(cls, plant: Model, declared: tuple[Quantity, ...]) -> Quantities:
        """Read quantities of a plant.

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
        layout = Layout("quantity", tuple(Variable(q.name, 1, q.unit) for q in declared), "the closed loop")
        stacked = ca.densify(ca.vertcat(ca.SX(0, 1), *rows))
        return cls(layout, ca.Function("quantities", list(plant.arguments()), [stacked]))


def sample_steps(n_steps: int) -> Array:
    """Return the control steps at whose beginnings samples are kept, and the end, (n_samples,)."""
    return np.round(np.linspace(0, n_steps, min(SAMPLES, n_steps + 1))).astype(int)


class Recorder:
    """What is kept of the quantities of n runs, and which were not-a-number.

    Parameters
    ----------
    quantities : Quantities
    times : array (n_steps + 1,)
        s.
    runs : int

    Attributes
    ----------
    sums : array (3 n_quantities, runs)
        Largest values, least values and integrals.
    samples : array (n_quantities, n_samples, runs)
        Not-a-number after the end of a run.
    lost : dict of int to Outcome
        By run, the first quantity that was not-a-number, and when.
    """

    def __init__(self, quantities: Quantities, times: Array, runs: int) -> None:
        self.quantities, self.times, n = quantities, times, len(quantities)
        self._at = sample_steps(times.size - 1)
        self.sums = np.repeat([-np.inf, np.inf, 0.0], n)[:, None] * np.ones(runs)
        self.samples = np.full((n, self._at.size, runs), np.nan)
        self.lost: dict[int, Outcome] = {}

    def add(self, run: int, first: int, parts: Mapping[str, Array], applied: Array, p: Array) -> None:
        """Take in a leg of a run.

        Parameters
        ----------
        run, first : int
            Which run, and the control step that the leg begins with.
        parts : mapping of str to array (., n + 1)
            Of the states of the loop.
        applied : array (n_controls, n)
            Means over the steps.
        p : array (n_parameters,)
            Of the plant.
        """
        states, times = parts["plant"], self.times[first : first + parts["plant"].shape[1]].copy()
        if "stop" in parts:  # an event may have ended the run
            flown = int(np.sum(parts["stop"][0, :-1] < 0.5))
            states, times, applied = states[:, : flown + 1], times[: flown + 1], applied[:, :flown]
            if parts["stop"][0, flown] > 0.5:
                times[-1] = parts["stop time"][0, flown]
        starts, ends = (
            np.asarray(self.quantities.values(times[None, here], states[:, here], applied, p).full())
            for here in (slice(None, -1), slice(1, None))
        )
        n, y = len(self.quantities), np.hstack([starts, ends[:, -1:]])
        self.sums[:n, run] = np.maximum(self.sums[:n, run], np.maximum(starts, ends).max(axis=1))
        self.sums[n : 2 * n, run] = np.minimum(
            self.sums[n : 2 * n, run], np.minimum(starts, ends).min(axis=1)
        )
        self.sums[2 * n :, run] += 0.5 * (starts + ends) @ np.diff(times)
        unknown = np.isnan(starts) | np.isnan(ends)
        if unknown.any() and run not in self.lost:
            step = int(np.argmax(unknown.any(axis=0)))
            name = self.quantities.layout.names[int(np.argmax(unknown[:, step]))]
            self.lost[run] = Outcome(RunStatus.NOT_FINITE, f"quantity '{name}'", float(times[step]))
        looked = self.times[first : first + times.size] <= times + SAME_TIME * (1 + np.abs(times))
        last = first + int(np.sum(looked))  # what an event has ended before is over
        here = (self._at >= first) & (self._at < last)
        self.samples[:, here, run] = y[:, self._at[here] - first]

    def told(self, outcomes: Sequence[Outcome]) -> tuple[Outcome, ...]:
        """Return the outcomes with quantities that were not-a-number, unless the run was not finite anyway."""
        return tuple(o if o.not_finite else self.lost.get(i, o) for i, o in enumerate(outcomes))
