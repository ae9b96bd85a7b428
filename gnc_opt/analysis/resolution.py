r"""Resolution: how many integration steps a linearization needs.

How finely a loop is integrated is decided by its nominal run. At rest that run has no error, however few the steps, and
its derivatives may have a large one: a light mode of 20 rad/s turns into a growing one with one step in 0.1 s. So modes
are asked themselves: n steps of the Runge-Kutta method in a time h make of :math:`e^{\lambda h}` the power
:math:`R(\lambda h / n)^n`,

.. math:: R(z) = 1 + z + \frac{z^2}{2} + \frac{z^3}{6} + \frac{z^4}{24} + \frac{z^5}{120} + \frac{z^6}{600} .

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.2: the stability function of
Dormand and Prince's method of order 5.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gnc_opt.analysis.linearization import OUTPUTS, Linearization
from gnc_opt.arrays import Array
from gnc_opt.model.model import Model
from gnc_opt.simulation.accuracy import MAX_SUBSTEPS
from gnc_opt.simulation.flight import Flight

_STABILITY = (1 / 600, 1 / 120, 1 / 24, 1 / 6, 1 / 2, 1.0, 1.0)


def steps_for_modes(modes: Any, length: float, asked: float) -> int:
    """Return how many steps in a length (s) modes (1/s, complex) need, `MAX_SUBSTEPS` at most.

    ``asked`` is the error over the length, relative to the larger one of 1 and the size of the mode after it.
    """
    z = np.asarray(modes, dtype=complex) * length
    truth = np.exp(z)
    for n in range(1, MAX_SUBSTEPS):
        with np.errstate(over="ignore", invalid="ignore"):
            error = np.abs(np.polyval(_STABILITY, z / n) ** n - truth)
        if np.all(error <= asked * np.maximum(1.0, np.abs(truth))):
            return n
    return MAX_SUBSTEPS


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
