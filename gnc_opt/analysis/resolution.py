"""Resolution: how many integration steps a linearization needs, by the modes of the plant along its nominal run."""

from __future__ import annotations

import numpy as np

from gnc_opt.analysis.linearization import OUTPUTS, Linearization
from gnc_opt.arrays import Array
from gnc_opt.model.model import Model
from gnc_opt.simulation.flight import Flight
from gnc_opt.simulation.modes import steps_for_modes


class PlantModes:
    """What the modes of a plant ask for along its nominal run.

    Parameters
    ----------
    linearization : Linearization
    asked : float
        Error of the modes per minor step, see `steps_for_modes`.
    """

    def __init__(self, linearization: Linearization, asked: float) -> None:
        self._asked = asked
        self._flight: Flight = linearization.flight
        self._plant: Model = linearization.wiring.plant
        self._outputs = linearization.output
        layout, nominal = self._flight.layout, self._flight.nominal
        places = [layout.slice(f"plant.{name}") for name in self._plant.parameters.names]
        self._p = np.concatenate([np.empty(0), *[nominal[place] for place in places]])

    def needed(self, t: float, X: Array, y: Array) -> int:
        """Return the integration steps per minor step at a time (s), from the loop's column and its `OUTPUTS`."""
        x, applied = self._flight.kernel.state.split(X)["plant"], self._outputs.split(y)[OUTPUTS[1]]
        a, _ = self._plant.linearize(t, x, applied, self._p)
        if not np.isfinite(a).all():
            return 1  # the linearization itself says what is not finite
        length = self._flight.dt / self._flight.minor_steps
        return steps_for_modes(np.linalg.eigvals(a).astype(complex), length, self._asked)
